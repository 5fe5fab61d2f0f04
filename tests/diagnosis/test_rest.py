"""Where nothing explains the rest, `explain` says what it goes with and what to do."""

import json
import time

import numpy as np
import pytest
from effort_logs import effort_log
from excitation_robots import MODELS
from scipy.signal import lfilter
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.diagnosis import explain, rest_correlates
from geodrake.diagnosis.explain import investigate
from geodrake.identification.logs.case import open_case
from geodrake.logs.files import write_log
from geodrake.model.saved_model import load_model

ARM, PENDULUM = MODELS / "arm6.urdf", MODELS / "double_pendulum.urdf"
WORDS = "its direction of motion times the position of "
OPTION = "--draft-effect my_effect.py"


@pytest.mark.thorough  # the command below is of a smaller robot
def test_the_brake_is_told_by_joint_and_motion_in_less_time_than_the_search():
    """Friction of the wrist's pitch that another joint's position tightens."""

    def brake(seen):
        return {4: 0.3 * np.sign(seen.v[:, 4]) * (1.5 + seen.q[:, 2])}

    log = effort_log("arm6", 1, brake, duration=24.0, share=0.02).log
    begin = time.process_time()
    found = investigate(open_case(load_model(ARM), [log], candidates=True))
    searched = time.process_time() - begin
    assert found.explanation.verdict == "unexplained"
    begin = time.process_time()
    correlates = rest_correlates(found)
    assert time.process_time() - begin < searched  # about half of it
    assert {c.joint for c in correlates} == {"wrist_pitch"}
    assert correlates[0].words == WORDS + "elbow_pitch"
    assert correlates[0].share > 0.95
    shares = found.explanation.of_motion
    assert shares.pop("wrist_pitch") > 0.7
    assert max(shares.values()) == 0.0


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


def run(*arguments):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return result.output


def tightened(seen):
    """Friction of the elbow that the shoulder's position tightens."""
    return {1: 0.5 * np.sign(seen.v[:, 1]) * (1.5 + seen.q[:, 0])}


def plain(seen):
    """Friction of the elbow that nothing tightens."""
    return {1: 0.75 * np.sign(seen.v[:, 1])}


def mostly_tightened(seen):
    """The same of a brake that is loose in the middle."""
    return {1: 0.5 * np.sign(seen.v[:, 1]) * (0.5 + seen.q[:, 0])}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_name_is_unsure_beside_an_error_that_nothing_explains(seed):
    """Dry friction takes away what the brake does in the mean, and the rest is left."""
    model = load_model(PENDULUM)
    logs = [
        effort_log("double_pendulum", seed, hidden, duration=12.0, share=0.02).log
        for hidden in (mostly_tightened, plain)
    ]
    unsure, sure = (explain(model, [log]).steps for log in logs)
    assert all(step.probability < 0.9 for step in unsure)
    assert all(step.unknown_probability > 0.1 for step in unsure)
    assert unsure
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
    output = run("explain", PENDULUM, path, "--report", page, "--json", numbers)
    (verdict,) = [line for line in output.splitlines() if line.startswith("Verdict: ")]
    assert verdict.endswith("writes the formula as an effect.")
    assert OPTION in verdict
    lines = output.splitlines()
    told = lines[lines.index("What is left goes with") + 1]
    assert told.startswith("- elbow: 9")
    assert told.endswith(f" % of what is left goes with {WORDS}shoulder.")
    shown = " ".join(page.read_text().replace("\N{NO-BREAK SPACE}", " ").split())
    assert told.removeprefix("- ") in shown
    assert OPTION in shown
    correlates = json.loads(numbers.read_text())["correlates"]
    assert correlates[0]["joint"] == "elbow"
    assert correlates[0]["words"] == WORDS + "shoulder"


@pytest.mark.thorough
def test_the_option_is_not_advised_to_who_took_it(tmp_path):
    path, target = file_of(tightened, tmp_path / "log.csv"), tmp_path / "my_effect.py"
    output = run("explain", PENDULUM, path, "--draft-effect", target)
    assert "that nothing explains" in output
    assert OPTION not in output


@pytest.mark.parametrize(
    "hidden",
    [
        pytest.param(None, marks=pytest.mark.thorough),
        lambda seen: {1: 0.5 * np.sign(seen.v[:, 1])},
    ],
)
@pytest.mark.thorough
def test_the_option_is_not_advised_without_need(hidden, tmp_path):
    """Nothing is left but noise, of a right model or beside friction that was found."""
    path, page, numbers = (tmp_path / f"log.{suffix}" for suffix in ("csv", "html", "json"))
    output = run("explain", PENDULUM, file_of(hidden, path), "--report", page, "--json", numbers)
    assert OPTION not in output
    assert OPTION not in page.read_text()
    told = json.loads(numbers.read_text())
    assert told["verdict"] == ("explained" if hidden else "adequate")
    assert told["correlates"] == []
