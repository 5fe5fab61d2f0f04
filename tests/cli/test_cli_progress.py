"""Progress on stderr, quiet and plain where asked for; what is kept of an interrupted search."""

import json
import os
import re
import signal
import time

import pytest
from pendulum_logs import PENDULUM, friction, pendulum_log
from processes import run_forked

from geodrake.boundary.interrupts import StopSearch
from geodrake.cli.progress import STOPPING, _Lines, progress
from geodrake.diagnosis import explain
from geodrake.logs import write_log
from geodrake.model import load_model

WAITING = re.compile(r".* \(\d+ s\)")  # said on a busy machine


def test_lines_in_a_pipe_are_plain_or_none(capsys):
    with progress("Reading a file") as shown:
        shown("Searching", 0.5)
        shown.history("1  payload on \x1b[31mflange: nrms 0.7 -> 0.1")
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("1  payload on ") and err.endswith("flange: nrms 0.7 -> 0.1\n")
    assert not any(ord(letter) < 32 for letter in err.rstrip("\n"))
    with progress("Reading a file", quiet=True) as shown:
        shown("Searching", 0.5)
        shown.history("1  payload")
    assert capsys.readouterr() == ("", "")


def test_share_and_time_left_are_told_where_nothing_was_said_for_long(capsys, monkeypatch):
    with progress("Reading a file") as shown:
        shown.begin -= 10.0
        shown.told -= 10.0
        shown("Simulating", 0.5)
        shown("Simulating", 0.6)
    assert capsys.readouterr().err == "Simulating (50 %, 10 s, about 10 s left)\n"


def test_work_that_says_nothing_goes_on(capsys, monkeypatch):
    monkeypatch.setattr("geodrake.cli.progress._SILENT", 0.02)
    monkeypatch.setattr("geodrake.cli.progress._PAUSE", 0.01)
    with progress("Reading a file") as shown:
        shown("Comparing")
        time.sleep(0.3)
    assert "Comparing (0 s)" in capsys.readouterr().err


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """Model and log of a pendulum with friction, whose search takes less time than the demo's."""
    path = tmp_path_factory.mktemp("pendulum") / "log.csv"
    write_log(pendulum_log(1, friction((0.3, 0.2), (0.2, 0.1)), seconds=10.0), path)
    return str(PENDULUM), str(path)


def test_an_interrupt_before_the_first_step_leaves_no_result(monkeypatch, pendulum):
    def stopped(*_, **__):
        raise StopSearch

    monkeypatch.setattr("geodrake.diagnosis.search.climb", stopped)
    model, log = pendulum
    with pytest.raises(StopSearch):
        explain(load_model(model), [log])


@pytest.mark.parametrize("twice", [False, True])
def test_an_interrupt_keeps_what_was_found_and_a_second_ends_at_once(tmp_path, pendulum, twice):
    def begin():
        said = _Lines.history

        def interrupted(self, line):
            said(self, line)
            if re.match(r"1  .*friction.*: nrms 0\.\d+ -> ", line) or (twice and line == STOPPING):
                os.kill(os.getpid(), signal.SIGINT)

        _Lines.history = interrupted

    targets = ("--json", "found.json", "--save", "model.yaml")
    code, out, err = run_forked(["explain", *pendulum, *targets], begin)
    first, *rest = (line for line in err.splitlines() if not WAITING.fullmatch(line))
    assert code == 130 and first.startswith("1  ") and rest[0] == STOPPING, err
    if twice:
        assert (out, rest[1:], list(tmp_path.iterdir())) == ("", ["Interrupted."], [])
        return
    assert "Traceback" not in err and "The search was interrupted" in out
    numbers = json.loads((tmp_path / "found.json").read_text())
    assert numbers["interrupted"] is True and numbers["steps"]
    assert numbers["error"]["end_nrms"] < numbers["error"]["start_nrms"]
    assert load_model(tmp_path / "model.yaml").effects
