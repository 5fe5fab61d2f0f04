"""Elastic joints: logs of links that move as planned, and of motors that lead them by the bend.

The link's motion is known, its effort is Pinocchio's, and the motor is where the spring's end is:
nothing here is to first order.
"""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from pinocchio_logs import MODELS, perturbed, random_motion, robot
from scipy.interpolate import make_interp_spline

from geodrake import load_model
from geodrake.diagnosis import add
from geodrake.effects import CoulombFriction, FittedEffect, JointElasticity, ViscousFriction
from geodrake.logs import JointLog, Motion
from geodrake.model import save_model

ARM = load_model(MODELS / "arm6.urdf")
DRY = np.array([4.0, 5.0, 3.0, 0.15, 0.15, 0.08])  # N·m


def elastic_motion(joint, stiffness, seed, *, off=0.0, duration=24.0):
    """Time, motor positions, velocities and accelerations, and the effort (N, n) of the links."""
    rng, file = np.random.default_rng(seed), robot("arm6")
    plant = perturbed(file, rng, off)
    data, time = plant.createData(), np.arange(0.0, duration, 1.0 / 250.0)
    motion = [x.copy() for x in random_motion(file, rng)(time)]
    effort = np.array([pin.rnea(plant, data, *x) for x in zip(*motion, strict=True)])
    bend = make_interp_spline(time, effort[:, joint] / stiffness, k=5)
    for order, values in enumerate(motion):
        values[:, joint] += bend(time, order)
    return time, *motion, effort


def elastic_log(joint, stiffness, seed, *, friction=0.0, duration=24.0):
    """A log of such a robot, with white noise and friction of all motors."""
    time, q, v, _, effort = elastic_motion(joint, stiffness, seed, off=0.2, duration=duration)
    effort = effort + friction * DRY * (np.tanh(v / 0.01) + 0.7 * v)
    rng, noise = np.random.default_rng(seed), 0.01 * effort.std(0)
    noisy = [x + size * rng.normal(size=q.shape) for x, size in ((q, 1e-5), (effort, noise))]
    return JointLog(
        f"elastic {seed}", ARM.joints, time, *noisy, v + 2e-4 * rng.normal(size=q.shape)
    )


@pytest.mark.parametrize("joint", [1, 4])
def test_effort_of_a_stiff_joint(joint):
    """What is left of the error is of second order in the compliance."""
    errors = []
    for stiffness in (2e4, 4e4):
        time, q, v, vd, effort = elastic_motion(joint, stiffness, 3, duration=4.0)
        fitted = FittedEffect(JointElasticity(ARM.joints[joint]), np.array([1.0 / stiffness]))
        elastic = dataclasses.replace(ARM, effects=(fitted,))
        motion, inner = Motion(q, v, vd, time), slice(20, -20)
        rigid = (ARM.effort(motion) - effort)[inner]
        left = (elastic.effort(motion) - effort)[inner]
        errors.append(np.abs(left).max() / np.abs(rigid).max())
    assert errors[0] < 0.05
    assert errors[1] == pytest.approx(0.5 * errors[0], rel=0.2)


def test_added_beside_friction_that_is_known_and_saved(tmp_path):
    """What the spring bends by is told by its motor's motion, not by the friction.

    That a soft joint is found is in the benchmark of hidden effects.
    """
    log = elastic_log(1, 3000.0, 1, friction=1.0, duration=12.0)
    known = [
        FittedEffect(effect(joint), np.array([size]))
        for joint, dry in zip(ARM.joints, DRY, strict=True)
        for effect, size in ((CoulombFriction, dry), (ViscousFriction, 0.7 * dry))
    ]
    found = add("joint_elasticity", dataclasses.replace(ARM, effects=tuple(known)), [log])
    (step,) = found.steps
    assert "shoulder_pitch" in step.where
    compliance = step.parameters["shoulder_pitch"]["compliance"]
    assert compliance == pytest.approx(1.0 / 3000.0, rel=0.1)
    save_model(found.model, tmp_path / "arm.yaml")
    again = load_model(tmp_path / "arm.yaml")
    assert [f.effect for f in again.effects] == [f.effect for f in found.model.effects]
