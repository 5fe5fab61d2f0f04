"""What a terminal of 80 columns and a pipe show: every joint, every value, and the worst joint."""

import io
import re
from dataclasses import replace
from html import escape
from itertools import product

import numpy as np
import pytest
from commands import run
from report_results import LOG, diagnosis
from report_results import URDF as MODEL
from typer.main import get_command

from geodrake import load_model
from geodrake.cli.app import app
from geodrake.diagnosis import add, compare
from geodrake.errors import LogError
from geodrake.logs import read_log
from geodrake.report import About, Units, page_of, render, show_page
from geodrake.report.numbers import number
from geodrake.report.terminal import ResultsConsole


def printed(result, model, *, terminal=True):
    looks = {"force_terminal": terminal, "color_system": None, "legacy_windows": False}
    width = 80 if terminal else 160
    console = ResultsConsole(file=io.StringIO(), markup=False, width=width, **looks)
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


def test_terminal_and_page_say_the_same(model, added, compared):
    for result in (added, compared):
        page = page_of(result, About(units=Units.of(model)))
        html = render(page).replace("\N{NO-BREAK SPACE}", " ")
        text = " ".join(printed(result, model).split())
        for words in (page.headline, *page.lead):
            assert words in text and escape(words) in html
    for joint in compared.errors.joints:
        for value in (joint.std, joint.rms, joint.floor, joint.nrms):
            assert number(value) in text and number(value) in html


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
    with pytest.raises(LogError, match=r"too short.* Positions seem to be in degrees"):
        compare(model, degrees, bandwidth=2.0)


@pytest.mark.parametrize("name", get_command(app).commands)
def test_help_of_80_columns_cuts_nothing_and_shows_few_options_first(name):
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
