"""Where nothing explains the rest, `explain` says what it goes with and what to do."""

import json
import time

import numpy as np
import pytest
from effort_logs import effort_log
from excitation_robots import MODELS
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.diagnosis.drafting import rest_correlates
from geodrake.diagnosis.drafting.vocabulary import short_vocabulary, vocabulary
from geodrake.diagnosis.explain import investigate
from geodrake.identification.logs.case import open_case
from geodrake.logs.files import write_log
from geodrake.model.saved_model import load_model

ARM = MODELS / "arm6.urdf"
WORDS = "its direction of motion times the position of elbow_pitch"
OPTION = "--draft-effect my_effect.py"


def brake(seen):
    """Friction of the wrist's pitch that another joint's position tightens."""
    return {4: 0.3 * np.sign(seen.v[:, 4]) * (1.5 + seen.q[:, 2])}


@pytest.fixture(scope="module")
def log():
    """10,000 samples of six joints."""
    return effort_log("arm6", 1, brake, duration=40.0, share=0.02).log


def test_the_brake_is_told_by_joint_and_motion_in_less_time_than_the_search(log):
    begin = time.process_time()
    found = investigate(open_case(load_model(ARM), [log], candidates=True))
    searched = time.process_time() - begin
    assert found.explanation.verdict == "unexplained"
    begin = time.process_time()
    correlates = rest_correlates(found)
    assert time.process_time() - begin < searched  # about half of it
    assert {c.joint for c in correlates} == {"wrist_pitch"}
    assert correlates[0].words == WORDS
    assert correlates[0].share > 0.95


def test_nothing_is_left_of_noise():
    log = effort_log("double_pendulum", 1, duration=16.0, share=0.02).log
    case = open_case(load_model(MODELS / "double_pendulum.urdf"), [log], candidates=True)
    assert rest_correlates(investigate(case)) == ()


def test_the_short_vocabulary_has_nothing_twice_and_nothing_else():
    joints = ("a", "b", "c")
    short = short_vocabulary("a", joints)
    every = vocabulary("a", joints, dict.fromkeys(joints, (-1.0, 1.0)))
    assert len({frozenset(term.factors) for term in short}) == len(short) < len(every) / 2
    assert {frozenset(t.factors) for t in short} <= {frozenset(t.factors) for t in every}


def run(*arguments):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return result.output


def test_command_report_and_numbers_tell_it_and_what_to_do(log, tmp_path):
    path, page, numbers = (tmp_path / f"log.{suffix}" for suffix in ("csv", "html", "json"))
    write_log(log, path)
    output = run("explain", ARM, path, "--report", page, "--json", numbers)
    (verdict,) = [line for line in output.splitlines() if line.startswith("Verdict: ")]
    assert verdict.endswith("writes the formula as an effect.")
    assert OPTION in verdict
    words = f"wrist_pitch: 99.9 % of what is left goes with {WORDS}."
    lines = output.splitlines()
    assert lines[lines.index("What is left goes with") + 1] == f"- {words}"
    shown = " ".join(page.read_text().replace("\N{NO-BREAK SPACE}", " ").split())
    assert words in shown
    assert OPTION in shown
    correlates = json.loads(numbers.read_text())["correlates"]
    assert correlates[0]["joint"] == "wrist_pitch"
    assert correlates[0]["words"] == WORDS


def test_the_option_is_not_advised_to_who_took_it_nor_without_need(tmp_path):
    def tightened(seen):
        return {1: 0.5 * np.sign(seen.v[:, 1]) * (1.5 + seen.q[:, 0])}

    path, target = tmp_path / "log.csv", tmp_path / "my_effect.py"
    write_log(effort_log("double_pendulum", 1, tightened, duration=12.0, share=0.02).log, path)
    output = run("explain", MODELS / "double_pendulum.urdf", path, "--draft-effect", target)
    assert "that nothing explains" in output
    assert OPTION not in output
    page, numbers = tmp_path / "demo.html", tmp_path / "demo.json"
    assert OPTION not in run("demo", "--report", page, "--json", numbers)
    assert OPTION not in page.read_text()
    assert json.loads(numbers.read_text())["correlates"] == []
