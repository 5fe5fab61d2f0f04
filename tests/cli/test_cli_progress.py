"""Progress on stderr, and results on a terminal of 80 columns and in a pipe."""

import io
import json
import os
import re
import signal
import time
from dataclasses import replace
from html import escape
from itertools import product
from unittest.mock import Mock

import numpy as np
import pytest
from commands import run
from pendulum_logs import PENDULUM, friction, pendulum_log
from processes import run_forked
from report_results import LOG, diagnosis
from report_results import URDF as MODEL
from typer.main import get_command

from geodrake import load_model
from geodrake.boundary.interrupts import StopSearch
from geodrake.cli.app import app
from geodrake.cli.progress import STOPPING, _Lines, progress
from geodrake.diagnosis import add, compare, explain
from geodrake.errors import LogError
from geodrake.logs import read_log, write_log
from geodrake.report import About, Units, page_of, render, show_page
from geodrake.report.numbers import number
from geodrake.report.page import Section, Table, cells
from geodrake.report.terminal import ResultsConsole, show_section

WAITING = re.compile(r".* \(\d+ s\)")  # said on a busy machine


def test_lines_in_a_pipe_are_plain_or_none(capsys):
    for quiet in (False, True):
        with progress("Reading a file", quiet=quiet) as shown:
            shown("Searching", 0.5)
            shown.history("1  payload on \x1b[31mflange: nrms 0.1")
        out, err = capsys.readouterr()
        assert out == ""
        assert bool(err) != quiet
        if err:
            assert err.startswith("1  payload on ")
            assert err.endswith("flange: nrms 0.1\n")
            assert not any(ord(letter) < 32 for letter in err.rstrip("\n"))


def test_progress_shows_share_and_time_left_after_a_pause(capsys):
    with progress("Reading a file") as shown:
        shown.begin -= 10.0
        shown.printed -= 10.0
        shown("Simulating", 0.5)
        shown("Simulating", 0.6)
    assert capsys.readouterr().err == "Simulating (50 %, 10 s, about 10 s left)\n"


def test_silent_work_shows_its_time(capsys, monkeypatch):
    monkeypatch.setattr("geodrake.cli.progress._SILENT", 0.02)
    monkeypatch.setattr("geodrake.cli.progress._PAUSE", 0.01)
    with progress("Reading a file") as shown:
        shown("Comparing")
        time.sleep(0.3)
    assert "Comparing (0 s)" in capsys.readouterr().err


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """Return the paths of a model and a short log with friction."""
    path = tmp_path_factory.mktemp("pendulum") / "log.csv"
    write_log(pendulum_log(1, friction((0.3, 0.2), (0.2, 0.1)), seconds=10.0), path)
    return str(PENDULUM), str(path)


def test_an_interrupt_before_the_first_step_leaves_no_result(monkeypatch, pendulum):
    monkeypatch.setattr("geodrake.diagnosis.search.climb", Mock(side_effect=StopSearch))
    model, log = pendulum
    with pytest.raises(StopSearch):
        explain(load_model(model), [log])


@pytest.mark.parametrize("twice", [False, True])
def test_an_interrupt_keeps_results_and_a_second_one_ends_at_once(tmp_path, pendulum, twice):
    def begin():
        said = _Lines.history

        def interrupted(self, line):
            said(self, line)
            if re.match(r"1  .*friction.*: nrms 0\.\d+$", line) or (twice and line == STOPPING):
                os.kill(os.getpid(), signal.SIGINT)

        _Lines.history = interrupted

    targets = ("--json", "found.json", "--save", "model.yaml")
    code, out, err = run_forked(["explain", *pendulum, *targets], begin)
    first, *rest = (line for line in err.splitlines() if not WAITING.fullmatch(line))
    assert code == 130 and first.startswith("1  ") and rest[0] == STOPPING, err
    if twice:
        assert (out, rest[1:], list(tmp_path.iterdir())) == ("", ["Interrupted."], [])
        return
    assert "Traceback" not in err and "Interrupted: more may be missing" in out
    numbers = json.loads((tmp_path / "found.json").read_text())
    assert numbers["interrupted"] is True and numbers["steps"]
    assert numbers["error"]["end_nrms"] < numbers["error"]["start_nrms"]
    assert load_model(tmp_path / "model.yaml").effects


def terminal_of(width, *, force_terminal=True):
    looks = {"force_terminal": force_terminal, "color_system": None, "legacy_windows": False}
    return ResultsConsole(file=io.StringIO(), markup=False, width=width, **looks)


def printed(result, model, *, terminal=True):
    console = terminal_of(80 if terminal else 160, force_terminal=terminal)
    show_page(console, page_of(result, About("arm", ("log",), units=Units.of(model))))
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


def test_nothing_is_wider_than_the_terminal_or_cut(model, added, compared):
    results = added, compared, diagnosis(model.joints)
    for result, terminal in product(results, (True, False)):
        text = printed(result, model, terminal=terminal)
        long = [line for line in text.splitlines() if len(line) > 80 and "excite" not in line]
        assert not (terminal and long)
        assert "…" not in text.replace(" … ", "")
        assert terminal or not re.search("[─━│\x1b]", text)


def test_a_table_that_is_too_wide_is_printed_in_two(model, added):
    for terminal, parts in ((True, 2), (False, 1)):
        text = printed(added, model, terminal=terminal)
        rows = re.findall(r"^viscous_friction  .*", text, re.M)
        assert len(rows) == parts
        assert "all 6 joints" in rows[0] and re.search(r"\d %", rows[-1])


@pytest.mark.parametrize("width", [60, 80, 120])
def test_long_names_are_wrapped_and_numbers_are_whole(width):
    joints = [f"left_arm_{name}_motor_side_joint" for name in ("shoulder_pitch", "elbow_pitch")]
    numbers = "2.497 ± 0.029 ± 0.021", "−0.01002 ± 0.00012 ± 0.00007", "0.1201 ± 0.0014 ± 0.0008"
    head, console = ("joint", "mass, kg", "CoM x, m", "CoM y, m"), terminal_of(width)
    table = Table(head, [cells(joint, *numbers) for joint in joints])
    show_section(console, Section("Payload", tables=(table,)))
    text = console.file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert all(text.count(number) == 2 for number in numbers)
    parts = sum({*line} == {"─"} for line in text.splitlines())
    names = "".join(line.split("  ")[0] for line in text.splitlines())
    assert names.count("".join(joints)) == parts == {60: 3, 80: 2, 120: 1}[width]


def test_terminal_and_page_say_the_same(model, added, compared):
    for result in (added, compared):
        page = page_of(result, About(units=Units.of(model)))
        html = render(page).replace("\N{NO-BREAK SPACE}", " ")
        text = " ".join(printed(result, model).split())
        for words in page.answer.values():
            assert words in text and escape(words) in html
    for joint in compared.errors.joints:
        for value in (joint.std, joint.rms, joint.floor, joint.nrms):
            assert number(value) in text and number(value) in html


def test_degrees_are_named_where_a_log_is_too_short(model):
    log, part = read_log(LOG), slice(0, 120)
    position = np.rad2deg(log.position[part]) + 90.0
    signals = {"time": log.time[part], "position": position, "effort": log.effort[part]}
    with pytest.raises(LogError, match=r"too short.* Positions seem to be in degrees"):
        compare(model, replace(log, **signals, velocity=None), bandwidth=2.0)


@pytest.mark.parametrize("name", get_command(app).commands)
def test_help_fits_80_columns_and_shows_few_options_first(name):
    command = get_command(app).commands[name]
    found = run(name, "--help-all", env={"COLUMNS": "80"})
    assert "--quiet" in found.output
    texts = "".join(f"{each.metavar}{each.help}" for each in command.params)
    texts += command.epilog or ""
    assert found.output.count("…") == texts.count("…")
    assert max(map(len, found.output.splitlines())) <= 80
    assert not re.search(r"<(bool|[Pp]ath|str|list)", found.output)  # metavariables, not types
    short = run(name, "--help", env={"COLUMNS": "80"}).output
    assert "--quiet" not in short and "Advanced" not in short
    assert len(short.splitlines()) <= 60
    options = short.split("─ Options")[1].split("╰")[0]
    assert len(re.findall(r"^│ [ *]{0,8}--", options, re.M)) <= 10
    assert run(name, "--help-all", env={"COLUMNS": "80"}).output == found.output
