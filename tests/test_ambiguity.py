"""What is ambiguous leads to a command, and the command can be run."""

import io
from dataclasses import replace
from types import SimpleNamespace

import pytest
from excitation_robots import MODELS
from rich.console import Console

from geodrake.cli.tables import show_diagnosis
from geodrake.cli.tell_apart import separation_of
from geodrake.cli.wording import Wording
from geodrake.diagnosis.ambiguity import telling_commands
from geodrake.diagnosis.results import Candidate, Diagnosis
from geodrake.excitation import motion_limits
from geodrake.saved_model import load_model

PREFIX = "geodrake excite MODEL --tell-apart "
JOINTS = ("shoulder", "elbow")


def diagnosis(*found):
    """Candidates as (effect, where, tied), the best first."""
    candidates = tuple(Candidate(e, w, 1.0, 0.1, 9.0, 1e-6, tied) for e, w, tied in found)
    return Diagnosis("explained", candidates, None, None, None, ())


def explanation(*steps):
    """Steps as (effect, where, rivals)."""
    rows = [
        SimpleNamespace(effect=e, where=w, indistinguishable_from=rivals) for e, w, rivals in steps
    ]
    return SimpleNamespace(steps=tuple(rows))


@pytest.mark.parametrize(
    ("best", "tied", "words"),
    [
        (
            ("coulomb_friction", ("elbow",)),
            ("load_dependent_friction", ("elbow",)),
            "coulomb_friction,load_dependent_friction@elbow",
        ),
        (
            ("coulomb_friction", JOINTS),
            ("load_dependent_friction", JOINTS),
            "coulomb_friction,load_dependent_friction",
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
        (("payload", ("forearm",)), ("gravity_tilt", ()), "payload@forearm,gravity_tilt"),
    ],
)
def test_commands_that_can_be_run(best, tied, words):
    (command,) = telling_commands(diagnosis((*best, True), (*tied, True)))
    assert command == PREFIX + words
    model = load_model(MODELS / "double_pendulum.urdf")
    if "@forearm" in words:
        words = words.replace("forearm", model.bodies[-1])
    separation, _ = separation_of(words, model, motion_limits(model), noise=0.1)
    assert separation.pairs


@pytest.mark.parametrize(
    "rival", ["wrong_inertia", "effort_delay", "an_effect_of_ones_own", "coulomb_friction"]
)
def test_what_no_motion_settles_has_no_command(rival):
    best = ("coulomb_friction", ("elbow",), True)
    assert not telling_commands(diagnosis(best, (rival, ("elbow",), True)))


def test_only_ties_count_and_each_once():
    best = ("viscous_friction", ("elbow",), True)
    others = [("effort_offset", ("elbow",), tied) for tied in (False, True, True)]
    assert telling_commands(diagnosis(best, others[0])) == ()
    assert len(telling_commands(diagnosis(best, *others))) == 1
    assert telling_commands(diagnosis()) == ()


def test_steps_of_an_explanation():
    found = explanation(
        ("viscous_friction", ("elbow",), ("nonlinear_viscous_friction", "wrong_inertia")),
        ("gravity_tilt", (), ()),
    )
    assert telling_commands(found) == (
        PREFIX + "viscous_friction,nonlinear_viscous_friction@elbow",
    )


def test_not_too_many():
    rivals = ("effort_offset", "joint_spring", "rotor_inertia", "torque_ripple", "effort_scale")
    found = explanation(("coulomb_friction", ("elbow",), rivals))
    assert len(telling_commands(found)) == 4


def test_the_terminal_tells_the_command():
    model = load_model(MODELS / "double_pendulum.urdf")
    found = diagnosis(
        ("coulomb_friction", ("elbow",), True), ("load_dependent_friction", ("elbow",), True)
    )
    errors = SimpleNamespace(nrms=0.5)
    console = Console(file=io.StringIO(), markup=False, highlight=False, width=160)
    show_diagnosis(console, replace(found, start=errors, refitted=errors), Wording(model))
    expected = f"- {PREFIX}coulomb_friction,load_dependent_friction@elbow"
    assert expected in console.file.getvalue().splitlines()
