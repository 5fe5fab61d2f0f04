"""Values that a model states and that are others: named where they are wrong, and nowhere else."""

import re

import numpy as np
import pytest
from pinocchio_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import explain

DRY, WET = np.array([0.5, 0.8, 0.4, 0.3, 0.2, 0.1]), np.array([0.6, 0.9, 0.3, 0.2, 0.1, 0.08])


def file_with(folder, dry, wet):
    """The six-joint arm, whose file states dry (6,) and viscous friction (6,)."""
    stated = iter(zip(dry.tolist(), wet.tolist(), strict=True))

    def with_dynamics(found):
        F, c = next(stated)
        return f'{found[0]}<dynamics friction="{F}" damping="{c}"/>'

    text = (MODELS / "arm6.urdf").read_text(encoding="utf-8")
    text = re.sub(r'<axis xyz="[^"]*" ?/>', with_dynamics, text)
    path = folder / "arm6.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def recorded(seed, dry=DRY, wet=WET):
    """A log of the arm with dry friction F v / √(v² + ε²) and viscous friction."""

    def friction(seen):
        return dry * seen.v / np.hypot(seen.v, 5e-3) + wet * seen.v

    return effort_log("arm6", seed, friction, share=0.02, rate=100.0).log


@pytest.fixture(scope="module")
def joints():
    """Names of the arm's joints."""
    return load_model(MODELS / "arm6.urdf").joints


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(s, marks=pytest.mark.thorough) for s in (1, 2, 3))]
)
def test_wrong_values_of_a_file_are_named_where_they_are(seed, joints, tmp_path):
    rng = np.random.default_rng(seed)
    dry, wet = DRY.copy(), WET.copy()
    some, others = rng.choice(6, 2, replace=False), rng.choice(6, 2, replace=False)
    dry[some] *= rng.choice([0.5, 0.6, 1.6, 2.0], 2)
    wet[others] *= rng.choice([0.5, 0.6, 1.6, 2.0], 2)
    found = explain(load_model(file_with(tmp_path, dry, wet)), [recorded(seed)])
    steps = {step.effect: step for step in found.steps}
    assert set(steps) == {"coulomb_friction", "viscous_friction"}
    assert set(steps["coulomb_friction"].where) == {joints[j] for j in some}
    assert set(steps["viscous_friction"].where) == {joints[j] for j in others}
    for name, right, at in (("coulomb", DRY, some), ("viscous", WET, others)):
        values = steps[f"{name}_friction"].parameters
        for j in at:
            assert values[joints[j]][name] == pytest.approx(right[j], rel=0.1)
    assert found.verdict in ("explained", "undecided")
    assert any("with other values" in note for note in found.notes)


def test_right_values_of_a_file_are_no_steps(tmp_path):
    assert not explain(load_model(file_with(tmp_path, DRY, WET)), [recorded(4)]).steps


def test_friction_that_is_another_than_when_it_was_fitted_has_its_own_name(joints):
    fitted = explain(load_model(MODELS / "arm6.urdf"), [recorded(6)]).model
    later = explain(fitted, [recorded(7, dry=np.where(np.arange(6) == 1, 1.3, DRY))])
    (step,) = later.steps
    assert (step.effect, step.where) == ("coulomb_friction", (joints[1],))
    assert step.parameters[joints[1]]["coulomb"] == pytest.approx(1.3, rel=0.05)
    assert not explain(fitted, [recorded(8)]).steps
