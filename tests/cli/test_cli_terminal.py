"""What a terminal of 80 columns and a pipe show: every joint, every value, and the worst joint."""

import io
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from typer.testing import CliRunner

from geodrake import load_model
from geodrake.cli.app import app
from geodrake.cli.tables import _Console, show_comparison, show_diagnosis, show_explanation
from geodrake.diagnosis import compare, diagnose
from geodrake.diagnosis.add import add
from geodrake.errors import LogError
from geodrake.logs.files import read_log
from geodrake.report.numbers import Units, number
from geodrake.report.sections import joints_section

DEMO = files("geodrake") / "demo"
MODEL, LOG = str(DEMO / "demo.urdf"), str(DEMO / "demo.csv")


def printed(show, result, model, *, terminal=True):
    looks = {"force_terminal": terminal, "color_system": None, "legacy_windows": False}
    console = _Console(file=io.StringIO(), markup=False, width=80 if terminal else 160, **looks)
    show(console, result, Units.of(model))
    return console.file.getvalue()


@pytest.fixture(scope="module")
def model():
    return load_model(MODEL)


@pytest.fixture(scope="module")
def compared(model):
    return compare(model, LOG)


@pytest.fixture(scope="module")
def added(model):
    return add("viscous_friction", model, [LOG])


def test_the_worst_joint_of_a_comparison_is_named(model, compared):
    worst = max(compared.errors.joints, key=lambda joint: joint.nrms)
    text = printed(show_comparison, compared, model)
    assert f"Worst joint: {worst.joint}, RMS {number(worst.rms)} N·m" in text


def test_the_worst_joint_of_a_diagnosis_is_named(model):
    text = printed(show_diagnosis, diagnose(model, LOG), model)
    assert "Worst joint: wrist_spin" in text or "Worst joint: wrist_roll" in text


def test_the_worst_joint_at_first_and_at_last_is_named(model, added):
    text = " ".join(printed(show_explanation, added, added.model).split())
    for when, errors in (("at first", added.start), ("at last", added.end)):
        worst = max(errors.joints, key=lambda joint: joint.nrms)
        assert f"{when} {worst.joint}, RMS {number(worst.rms)} N·m" in text


def test_every_joint_has_its_value(added):
    (step,) = added.steps
    assert len(step.where) > 2
    table = printed(show_explanation, added, added.model).split("value ± standard deviation")[1]
    lines = table.split("Verdict")[0].splitlines()
    for joint in step.where:
        assert any(line.startswith(joint) and "±" in line for line in lines)


@pytest.mark.parametrize("terminal", [True, False])
def test_nothing_is_wider_than_the_terminal_or_cut(model, added, compared, terminal):
    for show, result in ((show_explanation, added), (show_comparison, compared)):
        text = printed(show, result, model, terminal=terminal)
        commands = "geodrake excite"
        long = [line for line in text.splitlines() if len(line) > 80 and commands not in line]
        assert not (terminal and long)
        assert "…" not in text.replace(" … ", "")


def test_terminal_and_page_round_alike(model, compared):
    (table,) = joints_section({"RMS": compared.errors}, Units.of(model)).tables
    page = " ".join(cell.text for row in table.rows for cell in row)
    text = printed(show_comparison, compared, model)
    for joint in compared.errors.joints:
        for value in (joint.std, joint.rms, joint.floor, joint.nrms):
            assert number(value) in text and number(value) in page


def test_one_log_need_not_be_in_a_list(model, compared):
    assert compare(model, LOG).errors.nrms == compare(model, [LOG]).errors.nrms
    assert compared.errors.nrms == compare(model, read_log(LOG)).errors.nrms


def test_degrees_are_named_where_a_log_is_too_short(model):
    log = read_log(LOG)
    part = slice(0, 120)
    degrees = replace(
        log,
        time=log.time[part],
        position=np.rad2deg(log.position[part]) + 90.0,
        effort=log.effort[part],
        velocity=None,
    )
    with pytest.raises(LogError, match=r"too short.* Positions are in degrees by the look of it"):
        compare(model, degrees)


def test_demo_says_how_long_it_takes_only_where_it_begins():
    refused = CliRunner().invoke(app, ["demo", "--report", "no_folder/page.html"])
    assert refused.exit_code == 2 and refused.stderr.startswith("Error: Cannot write")
