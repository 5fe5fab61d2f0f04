"""A seven-joint arm of which two joints move, by Pinocchio: brakes hold the others.

Encoders have steps, velocities noise, and what a brake or dry friction at rest takes off an effort
is anybody's guess.
"""

from pathlib import Path

import numpy as np
import pytest

from geodrake import load_model
from geodrake.diagnosis import add, compare, explain
from geodrake.errors import ArgumentError
from geodrake.identification import IdentificationSettings, identify_model
from geodrake.logs import JointLog

pinocchio = pytest.importorskip("pinocchio")

ARM = Path(__file__).parents[2] / "models" / "arm7.urdf"
MOVING = (1, 3)
COULOMB, VISCOUS = np.array([1.8, 1.1]), np.array([0.7, 0.5])
STEP, NOISE = 1e-4, 0.05


def braked_log(seed, *, seconds=40.0):
    """Two joints swing; at the others efforts are off by up to 1 N·m for no reason of the model."""
    rng = np.random.default_rng(seed)
    robot = pinocchio.buildModelFromUrdf(str(ARM))
    data, time = robot.createData(), np.arange(0.0, seconds, 0.01)
    q, v, vd = np.zeros((3, len(time), robot.nv))
    q += rng.uniform(-0.7, 0.7, robot.nv)
    for j in MOVING:
        for rate in 2.0 * np.pi * rng.uniform(0.1, 0.5, 4):
            size, angle = rng.uniform(0.1, 0.35), rate * time + rng.uniform(0.0, 6.3)
            q[:, j] += size * np.sin(angle)
            v[:, j] += size * rate * np.cos(angle)
            vd[:, j] -= size * rate**2 * np.sin(angle)
    effort = np.array([pinocchio.rnea(robot, data, *row) for row in zip(q, v, vd, strict=True)])
    effort += np.where(np.isin(np.arange(robot.nv), MOVING), 0.0, rng.uniform(-1.0, 1.0, robot.nv))
    effort[:, MOVING] += COULOMB * np.sign(v[:, MOVING]) + VISCOUS * v[:, MOVING]
    return JointLog(
        f"braked {seed}",
        tuple(robot.names)[1:],
        time,
        np.round(q / STEP) * STEP,
        effort + NOISE * rng.normal(size=effort.shape),
        velocity=v + 0.02 * rng.normal(size=v.shape),
    )


@pytest.fixture(scope="module")
def model():
    return load_model(ARM)


def test_friction_of_the_joints_that_move_is_all_that_is_found(model):
    found = explain(model, [braked_log(0, seconds=24.0)])
    assert found.model.joints == ("joint_2", "joint_4")
    assert {step.effect for step in found.steps} == {"coulomb_friction", "viscous_friction"}
    values = {f.effect.name: [] for f in found.model.effects}
    for fitted in found.model.effects:
        values[fitted.effect.name].append(fitted.parameters[0])
    np.testing.assert_allclose(values["coulomb_friction"], COULOMB, rtol=0.05)
    np.testing.assert_allclose(values["viscous_friction"], VISCOUS, rtol=0.1)
    assert found.verdict == "explained"
    (note,) = (note for note in found.notes if "--no-auto-lock" in note)
    assert all(f"joint_{k} at" in note for k in (1, 3, 5, 6, 7))


def test_identification_holds_the_same_joints(model):
    settings = IdentificationSettings(gamma=100.0)
    found = identify_model(model, [braked_log(1)], settings)
    assert found.model.joints == found.prior.joints == ("joint_2", "joint_4")
    weighed = IdentificationSettings(gamma=100.0, total_mass=float(model.phi[:, 0].sum()))
    assert identify_model(model, [braked_log(1)], weighed).model.joints == model.joints


@pytest.mark.parametrize(
    ("effect", "place", "words"),
    [
        ("payload", "link_7", "link_7 is part of link_4, as nothing moves between them"),
        ("coulomb_friction", "joint_5", "joint_5 is fixed by .* hardly moves"),
    ],
)
def test_nothing_is_added_where_nothing_moves(model, effect, place, words):
    with pytest.raises(ArgumentError, match=words):
        add(effect, model, [braked_log(3, seconds=20.0)], where=[place])


def test_a_joint_at_rest_counts_by_what_gravity_holds(model):
    """Its own deviation is next to nothing, and no measure of 1 N·m."""
    log = braked_log(2)
    errors = compare(model, [log], hold_resting=False, bandwidth=2.0).errors
    resting = [joint for k, joint in enumerate(errors.joints) if k not in MOVING]
    moving = [errors.joints[k] for k in MOVING]
    deviation = log.effort.std(axis=0)
    assert errors.joints[6].std > 2.0 * deviation[6]
    assert max(joint.nrms for joint in resting) <= 1.1
    assert errors.joints[0].nrms < 0.1  # its axis is upright: a robot that fell would load it
    np.testing.assert_allclose([j.std for j in moving], deviation[list(MOVING)], rtol=0.05)
