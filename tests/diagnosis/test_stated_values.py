"""Values that a model states and that are others: named where they are wrong, and nowhere else."""

import re

import numpy as np
import pytest
from pinocchio_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import explain

DRY, WET = np.array([0.5, 0.3]), np.array([0.3, 0.2])
SHOULDER, ELBOW = JOINTS = ("shoulder", "elbow")


def file_with(folder, dry, wet):
    """The pendulum, whose file states dry (2,) and viscous friction (2,)."""
    stated = iter(zip(dry, wet, strict=True))

    def with_dynamics(found):
        F, c = next(stated)
        return f'{found[0]}<dynamics friction="{F}" damping="{c}"/>'

    text = (MODELS / "double_pendulum.urdf").read_text(encoding="utf-8")
    path = folder / "pendulum.urdf"
    path.write_text(re.sub(r'<axis xyz="[^"]*" ?/>', with_dynamics, text), encoding="utf-8")
    return load_model(path)


def recorded(seed, dry=DRY, wet=WET):
    """A log with dry friction F v / √(v² + ε²) and viscous friction."""

    def friction(seen):
        return dry * seen.v / np.hypot(seen.v, 5e-3) + wet * seen.v

    return effort_log("double_pendulum", seed, friction, share=0.02, rate=100.0).log


def test_wrong_values_of_a_file_are_named_where_they_are(tmp_path):
    found = explain(file_with(tmp_path, DRY * [0.6, 1.0], WET * [1.0, 1.6]), [recorded(0)])
    steps = {step.effect: step for step in found.steps}
    assert {effect: step.where for effect, step in steps.items()} == {
        "coulomb_friction": (SHOULDER,),
        "viscous_friction": (ELBOW,),
    }
    coulomb = steps["coulomb_friction"].parameters[SHOULDER]["coulomb"]
    viscous = steps["viscous_friction"].parameters[ELBOW]["viscous"]
    assert (coulomb, viscous) == pytest.approx((DRY[0], WET[1]), rel=0.1)
    assert found.verdict in ("explained", "undecided")
    assert any("with other values" in note for note in found.notes)


def test_right_values_of_a_file_are_no_steps(tmp_path):
    assert not explain(file_with(tmp_path, DRY, WET), [recorded(4)]).steps


def test_friction_that_is_another_than_when_it_was_fitted_has_its_own_name():
    fitted = explain(load_model(MODELS / "double_pendulum.urdf"), [recorded(6)]).model
    (step,) = explain(fitted, [recorded(7, dry=DRY * [1.0, 1.6])]).steps
    assert (step.effect, step.where) == ("coulomb_friction", (ELBOW,))
    assert step.parameters[ELBOW]["coulomb"] == pytest.approx(1.6 * DRY[1], rel=0.05)
    assert not explain(fitted, [recorded(8)]).steps
