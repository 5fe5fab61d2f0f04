"""Where nothing explains the rest, `explain` says what it varies with and what to do."""

import json

import numpy as np
import pytest
from commands import run
from excitation_robots import MODELS
from pinocchio_logs import effort_log
from scipy.signal import lfilter

from geodrake.diagnosis import explain
from geodrake.logs import write_log
from geodrake.model import load_model

PENDULUM = MODELS / "double_pendulum.urdf"
WORDS = "its direction of motion times the position of "
OPTION = "--draft-effect my_effect.py"


def test_what_goes_with_time_alone_or_with_nothing_does_not_go_with_the_motion():
    """An oscillation at one joint, coloured noise at the other."""
    rng = np.random.default_rng(3)

    def hidden(seen):
        noise = lfilter([1.0], [1.0, -0.97], rng.normal(size=len(seen.time)))
        return {0: 0.5 * np.sin(11.0 * seen.time), 1: 0.1 * noise}

    log = effort_log("double_pendulum", 2, hidden, duration=24.0, share=0.01).log
    found = explain(load_model(PENDULUM), [log])
    assert found.verdict == "unexplained"
    assert max(found.of_motion.values()) < 0.05


def tightened(seen):
    """Friction of the elbow that the shoulder's position tightens."""
    return {1: 0.5 * np.sign(seen.v[:, 1]) * (1.5 + seen.q[:, 0])}


def plain(seen):
    """Friction of the elbow that nothing tightens."""
    return {1: 0.75 * np.sign(seen.v[:, 1])}


def mostly_tightened(seen):
    """The same of a brake that is loose in the middle."""
    return {1: 0.5 * np.sign(seen.v[:, 1]) * (0.5 + seen.q[:, 0])}


def test_a_name_is_unsure_beside_an_error_that_nothing_explains():
    """Dry friction takes away what the brake does in the mean, and the rest is left."""
    model = load_model(PENDULUM)
    logs = [
        effort_log("double_pendulum", 1, hidden, duration=12.0, share=0.02).log
        for hidden in (mostly_tightened, plain)
    ]
    unsure, sure = (explain(model, [log]).steps for log in logs)
    assert all(step.probability < 0.9 for step in unsure)
    assert all(step.unknown_probability > 0.1 for step in unsure)
    for step in (*unsure, *sure):
        parts = step.probability, *step.probabilities_of_rivals, step.unknown_probability
        assert sum(parts) + step.false_alarm_probability == pytest.approx(1.0)
    (friction,) = sure
    assert friction.effect == "coulomb_friction"
    assert friction.unknown_probability == 0.0
    assert friction.probability > 0.99


def file_of(hidden, path):
    write_log(effort_log("double_pendulum", 1, hidden, duration=12.0, share=0.02).log, path)
    return path


def test_command_report_and_numbers_tell_it_and_what_to_do(tmp_path):
    page, numbers = tmp_path / "log.html", tmp_path / "log.json"
    path = file_of(tightened, tmp_path / "log.csv")
    done = run("explain", PENDULUM, path, "--report", page, "--json", numbers, "--details")
    assert done.exit_code == 0, done.output
    (verdict,) = [line for line in done.output.splitlines() if line.startswith("Verdict: ")]
    assert verdict.endswith("searches for a formula of the remaining error.")
    assert OPTION in verdict
    lines = done.output.splitlines()
    told = lines[lines.index("What the remaining error varies with") + 1]
    assert told.startswith("- elbow: 9")
    assert told.endswith(f" % of the remaining error varies with {WORDS}shoulder.")
    shown = " ".join(page.read_text().replace("\N{NO-BREAK SPACE}", " ").split())
    assert told.removeprefix("- ") in shown
    assert OPTION in shown
    correlates = json.loads(numbers.read_text())["correlates"]
    assert correlates[0]["joint"] == "elbow"
    assert correlates[0]["words"] == WORDS + "shoulder"
