"""What a step cannot be told from comes with the numbers that show it."""

import io
from dataclasses import replace

import numpy as np
import pytest
from excitation_robots import MODELS
from pinocchio_logs import effort_log
from rich.console import Console

from geodrake.diagnosis import add, diagnose, explain
from geodrake.diagnosis.ambiguity import distinguishing_commands
from geodrake.diagnosis.results import FittedRival
from geodrake.model import load_model
from geodrake.report import page_of, render, show_page
from geodrake.report.views import numbers_of

MODEL = load_model(MODELS / "double_pendulum.urdf")


def spring(seen):
    return {1: 0.2 * seen.q[:, 1]}


def dry_friction(seen):
    return {1: 0.5 * np.sign(seen.v[:, 1])}


def slow_log(hidden, share=0.02):
    return effort_log("double_pendulum", 1, hidden, duration=16.0, share=share, pace=0.3).log


@pytest.fixture(scope="module")
def case():
    """A log with a spring, beside noise, and its explanation: a counterweight may be there."""
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


def test_what_adds_the_same_is_no_rival():
    """Dry friction alone, as the pair of dry and viscous friction of which one part is none."""
    log = slow_log(dry_friction)
    named = [candidate.effect for candidate in diagnose(MODEL, [log]).candidates]
    assert named[0] == "coulomb_friction"
    assert "coulomb_friction + viscous_friction" not in named
    (step,) = explain(MODEL, [log]).steps
    assert "viscous_friction" not in step.indistinguishable_from


COMMAND = "geodrake excite MODEL --tell-apart"
FITTED = FittedRival(
    "joint_spring + effort_offset", ("shoulder",), ("rotor_inertia",), 0.5, 0.4, 0.2, 0.5
)


@pytest.fixture
def told(case):
    """An explanation with a rival that is elsewhere than the step."""
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
    words = "or: joint spring + effort offset 33 %"
    assert words in " ".join(console.file.getvalue().split())
    assert words.split(": ")[1] in render(page_of(told)).replace("\N{NO-BREAK SPACE}", " ").replace(
        "<wbr>", ""
    )
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


def test_probabilities_are_those_of_all_that_it_may_be(told):
    """The finding, what stands in its place, and nothing."""
    (step,) = told.steps
    step = replace(step, false_alarm_probability=0.1)
    assert step.probabilities_of_rivals == (pytest.approx(0.5 * step.probability),)
    assert step.probability + sum(step.probabilities_of_rivals) == pytest.approx(0.9)


def test_rivals_are_weighed_beside_what_else_was_found():
    """What a rival leaves is told as it is beside an effect that was found only later."""

    def hidden(seen):
        return {0: 2.0 * np.sign(seen.v[:, 0]), 1: 1.5 * seen.q[:, 1]}

    found = explain(MODEL, [slow_log(hidden)])
    assert len(found.steps) > 1
    for step in found.steps:
        assert step.probability > 0.2
        for rival in step.rivals:
            assert rival.error_of_choice == pytest.approx(found.end.nrms, rel=0.05)


def test_a_fitted_rival_keeps_its_own_place(told):
    rivals = ("effort_offset@shoulder", "joint_spring@shoulder")
    commands = [f"{COMMAND} rotor_inertia@elbow,{rival}" for rival in rivals]
    assert list(distinguishing_commands(told)) == commands


def test_a_rival_at_more_joints_is_told_apart_where_the_step_is(told):
    (step,) = told.steps
    wider = replace(FITTED, effect="effort_offset", where=("shoulder", "elbow"))
    step = replace(step, rivals=(wider,), indistinguishable_from=("effort_offset",))
    commands = distinguishing_commands(replace(told, steps=(step,)))
    assert list(commands) == [f"{COMMAND} rotor_inertia,effort_offset@elbow"]
