"""Ambiguous steps, unexplained errors, and motions that distinguish rivals."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from commands import run
from excitation_robots import MODELS
from pinocchio_logs import effort_log
from rich.console import Console
from scipy.signal import lfilter

from geodrake.cli.excite import rivals_in
from geodrake.diagnosis import Candidate, Diagnosis, Explanation, Step, add, explain
from geodrake.diagnosis.ambiguity import distinguishing_commands
from geodrake.diagnosis.results import FittedRival
from geodrake.effects import catalogue
from geodrake.excitation import motion_limits
from geodrake.excitation.tell_apart import placed_rivals, separation_of
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError
from geodrake.logs import write_log
from geodrake.model import load_model
from geodrake.report import page_of, render, show_page
from geodrake.report.views import numbers_of

MODEL = load_model(MODELS / "double_pendulum.urdf")


def spring(seen):
    return {1: 0.2 * seen.q[:, 1]}


def slow_log(hidden, share=0.02):
    return effort_log("double_pendulum", 1, hidden, duration=16.0, share=share, pace=0.3).log


@pytest.fixture(scope="module")
def case():
    """Return a log with a spring and its explanation, which a counterweight may replace."""
    log = slow_log(spring, 0.05)
    return log, explain(MODEL, [log])


def test_the_error_of_a_rival_is_that_of_adding_it(case):
    log, found = case
    (step,) = found.steps
    rival = step.rivals[0]
    assert {step.effect, rival.effect} == {"joint_spring", "gravity_compensator"}
    assert rival.instead_of == (step.effect,)
    assert set(rival.names) <= set(step.indistinguishable_from)
    instead = add(rival.effect, MODEL, [log], where=rival.where).steps[0]
    assert rival.error == pytest.approx(instead.error_after, rel=0.05)
    assert rival.error_of_choice == pytest.approx(step.error_after, rel=0.05)
    probabilities = step.probabilities_of_rivals
    assert 0.01 < probabilities[0] < 0.5 < step.probability < 1.0
    assert sum(probabilities) + step.probability == pytest.approx(
        1.0 - step.false_alarm_probability
    )


COMMAND = "geodrake excite MODEL --tell-apart"
FITTED = FittedRival(
    "joint_spring + effort_offset", ("shoulder",), ("rotor_inertia",), 0.5, 0.4, 0.2, 0.5
)


@pytest.fixture
def told(case):
    """Return an explanation with a rival at another place than the step."""
    _, found = case
    names = ("effort_offset", "joint_spring")
    step = replace(
        found.steps[0],
        effect="rotor_inertia",
        where=("elbow",),
        indistinguishable_from=names,
        rivals=(FITTED,),
        false_alarm_probability=0.0,
    )
    return replace(found, steps=(step,))


def test_terminal_report_and_numbers_tell_them(told):
    console = Console(file=io.StringIO(), markup=False, highlight=False, width=200)
    show_page(console, page_of(told))
    words = "rotor inertia, or joint spring + effort offset 33 %"
    assert words in " ".join(console.file.getvalue().split())
    assert words in render(page_of(told)).replace("\N{NO-BREAK SPACE}", " ")
    (step,) = numbers_of(told)["steps"]
    assert step["indistinguishable_from"] == ("effort_offset", "joint_spring")
    assert step["rivals"] == [
        {
            "effect": "joint_spring + effort_offset",
            "where": ("shoulder",),
            "instead_of": ("rotor_inertia",),
            "error": 0.5,
            "error_of_choice": 0.4,
            "tie_probability": 0.2,
            "odds": 0.5,
            "probability": pytest.approx(1.0 / 3.0, abs=0.01),
        }
    ]


def test_a_fitted_rival_keeps_its_own_place(told):
    rivals = ("effort_offset@shoulder", "joint_spring@shoulder")
    commands = [f"{COMMAND} rotor_inertia@elbow,{rival}" for rival in rivals]
    assert list(distinguishing_commands(told)) == commands


PENDULUM = MODELS / "double_pendulum.urdf"
WORDS = "its direction of motion times the position of "
OPTION = "--draft-effect my_effect.py"


def test_what_goes_with_time_alone_or_with_nothing_does_not_go_with_the_motion():
    """One joint oscillates, and the other has coloured noise."""
    rng = np.random.default_rng(3)

    def hidden(seen):
        noise = lfilter([1.0], [1.0, -0.97], rng.normal(size=len(seen.time)))
        return {0: 0.5 * np.sin(11.0 * seen.time), 1: 0.1 * noise}

    log = effort_log("double_pendulum", 2, hidden, duration=24.0, share=0.01).log
    found = explain(load_model(PENDULUM), [log])
    assert found.verdict == "unexplained"
    assert max(found.of_motion.values()) < 0.05


def tightened(seen):
    """Return friction of the elbow that increases with the shoulder's position."""
    return {1: 0.5 * np.sign(seen.v[:, 1]) * (1.5 + seen.q[:, 0])}


def plain(seen):
    """Return friction of the elbow that does not depend on the shoulder."""
    return {1: 0.75 * np.sign(seen.v[:, 1])}


def mostly_tightened(seen):
    """Return such friction of a brake that is loose in the middle of the range."""
    return {1: 0.5 * np.sign(seen.v[:, 1]) * (0.5 + seen.q[:, 0])}


def test_a_name_is_unsure_beside_an_error_that_nothing_explains():
    """Dry friction explains the mean of the brake, but not the rest."""
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
    lines = done.output.splitlines()
    (advice,) = [line for line in lines if line.startswith("Next: ")]
    assert advice == f"Next: {OPTION} searches for a formula of the remaining error"
    told = lines[lines.index("What the remaining error varies with") + 3]
    assert re.fullmatch(rf"elbow +{re.escape(WORDS)}shoulder +9\S* %", told)
    shown = " ".join(page.read_text().replace("\N{NO-BREAK SPACE}", " ").split())
    assert f"{WORDS}shoulder" in shown
    assert OPTION in shown
    correlates = json.loads(numbers.read_text())["correlates"]
    assert correlates[0]["joint"] == "elbow"
    assert correlates[0]["words"] == WORDS + "shoulder"


PREFIX = "geodrake excite MODEL --tell-apart "
JOINTS = ("shoulder", "elbow")
START = ErrorTable(tuple(JointError(joint, 0.5, 1.0, 0.1) for joint in JOINTS))
SHOWN = Comparison(START, (), (), ())


def diagnosis(*found):
    """Return candidates as (effect, where, tied), the best first."""
    candidates = tuple(Candidate(e, w, 1.0, 0.1, 9.0, 1e-6, tied) for e, w, tied in found)
    return Diagnosis("explained", candidates, START, START, SHOWN, ())


def explanation(*steps, model=MODEL):
    """Return steps as (effect, where, rivals), each rival as (effect, where)."""
    rows = tuple(
        Step(
            effect, where, 1.0, 0.1, {}, {}, tuple(name for name, _ in rivals), 1e-6, 1.0, {}, {},
            tuple(FittedRival(*rival, (effect,), 0.1, 0.1, 0.2, 0.5) for rival in rivals),
        )
        for effect, where, rivals in steps
    )  # fmt: skip
    return Explanation("explained", rows, START, START, START, model, SHOWN, SHOWN, ())


def commands(found):
    """Return the commands that are printed, without their prefix."""
    return [each.removeprefix(PREFIX) for each in distinguishing_commands(found)]


@pytest.mark.parametrize(
    ("best", "tied", "words"),
    [
        (
            ("coulomb_friction", ("elbow",)),
            ("load_dependent_friction", ("elbow",)),
            "coulomb_friction,load_dependent_friction@elbow",
        ),
        (("joint_spring", ("elbow",)), ("gravity_tilt", ()), "joint_spring@elbow,gravity_tilt"),
        (
            ("coulomb_friction + viscous_friction", ("elbow",)),
            ("asymmetric_friction", ("elbow",)),
            "coulomb_friction,asymmetric_friction@elbow",
        ),
        (
            ("coupled_friction", JOINTS),
            ("coulomb_friction", ("shoulder",)),
            "coupled_friction@shoulder+elbow,coulomb_friction@shoulder",
        ),
        (
            ("payload + coulomb_friction", ("elbow", "lower_link")),
            ("gravity_tilt", ()),
            "payload@lower_link,gravity_tilt",
        ),
    ],
)
def test_commands_that_can_be_run(best, tied, words):
    assert commands(diagnosis((*best, True), (*tied, True))) == [words]
    separation, _ = separation_of(MODEL, *rivals_in(words), motion_limits(MODEL), noise=0.1)
    assert separation.pairs


@pytest.mark.parametrize(
    "rival", ["wrong_inertia", "effort_delay", "an_effect_of_ones_own", "coulomb_friction"]
)
def test_what_no_motion_settles_has_no_command(rival):
    best = ("coulomb_friction", ("elbow",), True)
    assert commands(diagnosis(best, (rival, ("elbow",), True))) == []


ARM = load_model(MODELS / "arm6.urdf")


PLACES = {
    "joint": [("base_yaw",), ("elbow_pitch",), ("wrist_spin",), ("elbow_pitch", "wrist_spin")],
    "joint_pair": [("base_yaw", "shoulder_pitch"), ("wrist_pitch", "wrist_spin")],
    "body": [("column",), ("flange",), ("upper_arm", "flange")],
    "robot": [()],
}
STEPS = [(cls.name, where) for cls in catalogue() for where in PLACES.get(cls.places, [])]


@pytest.mark.parametrize(("effect", "where"), STEPS)
def test_every_command_is_understood(effect, where):
    limits, told = motion_limits(ARM), set()
    kinds = {cls.name: cls.places for cls in catalogue()}
    for cls in catalogue():
        place = where if cls.places == kinds[effect] else PLACES.get(cls.places, [()])[0]
        found = explanation((effect, where, ((cls.name, place),)), model=ARM)
        for command in commands(found):
            rivals = placed_rivals(ARM, *rivals_in(command), limits)
            assert [rival.name for rival in rivals] == [effect, cls.name]
            told.add(cls.name)
    settled = {cls.name for cls in catalogue()} - {
        "effort_delay",
        "wrong_inertia",
        "contact",
        "temporary_payload",
        effect,
    }
    of_one_log = effect in ("contact", "temporary_payload")
    assert told == (set() if of_one_log else settled)


def test_not_too_many():
    rivals = ("effort_offset", "joint_spring", "rotor_inertia", "torque_ripple", "effort_scale")
    found = explanation(("coulomb_friction", ("elbow",), [(r, ("elbow",)) for r in rivals]))
    assert len(commands(found)) == 4


def test_the_terminal_tells_the_commands_that_a_motion_can_settle():
    rivals = ("nonlinear_viscous_friction", ("elbow",)), ("wrong_inertia", ("lower_link",))
    found = explanation(("viscous_friction", ("elbow",), rivals), ("gravity_tilt", (), ()))
    told = "viscous_friction,nonlinear_viscous_friction@elbow"
    assert commands(found) == [told]
    console = Console(file=io.StringIO(), markup=False, highlight=False, width=160)
    show_page(console, page_of(found))
    assert f"- {PREFIX}{told} --save motion_1.csv" in console.file.getvalue().splitlines()
