"""Elastic joints and backlash: efforts, columns, and confusion with other effects."""

import dataclasses
from dataclasses import replace
from functools import cache
from math import cos, sin

import numpy as np
import pinocchio as pin
import pytest
from pendulum_logs import PENDULUM
from pinocchio_logs import MODELS, perturbed, random_motion, robot
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from diagrams.benchmarks.servo_gains import make_servo_log, servo_draws, servo_file
from geodrake import load_model
from geodrake.diagnosis import add, explain
from geodrake.effects import (
    Backlash,
    CoulombFriction,
    FittedEffect,
    JointElasticity,
    ViscousFriction,
)
from geodrake.effects.motor_and_transmission import link_lag
from geodrake.logs import JointLog, Motion
from geodrake.model import save_model

pytest.importorskip("pinocchio")


ARM = load_model(MODELS / "arm6.urdf")
DRY = np.array([4.0, 5.0, 3.0, 0.15, 0.15, 0.08])  # N·m


def elastic_motion(joint, stiffness, seed, *, off=0.0, duration=24.0):
    """Return time, motion of the motors, and efforts (N, n) of the links."""
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
    """Return a log of such a robot with white noise and friction of all motors."""
    time, q, v, _, effort = elastic_motion(joint, stiffness, seed, off=0.2, duration=duration)
    effort = effort + friction * DRY * (np.tanh(v / 0.01) + 0.7 * v)
    rng, noise = np.random.default_rng(seed), 0.01 * effort.std(0)
    noisy = [x + size * rng.normal(size=q.shape) for x, size in ((q, 1e-5), (effort, noise))]
    return JointLog(
        f"elastic {seed}", ARM.joints, time, *noisy, v + 2e-4 * rng.normal(size=q.shape)
    )


@pytest.mark.parametrize("joint", [1, 4])
def test_effort_of_a_stiff_joint(joint):
    """The remaining error is of second order in the compliance."""
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


MODEL = load_model(PENDULUM)
RATES = 2 * np.pi * np.array([0.31, 0.53, 0.83])
SIZES, PHASES = np.array([1.0, 0.6, 0.3]), np.array([0.0, 1.0, 2.0])


def motor(t):
    """Return position, velocity and acceleration of the elbow's motor."""
    angle = np.multiply.outer(t, RATES) + PHASES
    return (
        np.sin(angle) @ SIZES,
        np.cos(angle) @ (SIZES * RATES),
        -np.sin(angle) @ (SIZES * RATES**2),
    )


def at_elbow(q, v, vd):
    """Return efforts (N, 2) with the shoulder at rest."""
    still = np.zeros_like(q)
    return MODEL.effort(Motion(*(np.stack([still, x], 1) for x in (q, v, vd))))


@cache
def constants():
    """Return the inertia about the elbow and the moment of the weight there, N·m."""
    one, none = np.ones(1), np.zeros(1)
    weight = at_elbow(one * np.pi / 2, none, none)[0, 1]
    return at_elbow(none, none, one)[0, 1] - at_elbow(none, none, none)[0, 1], weight


@cache
def played(half_width, seconds=16.0, rate=2000.0):
    """Return time, the link's positions and velocities, and the motor's torque."""
    inertia, weight = constants()
    stiffness = 4e4 * inertia
    damping = np.sqrt(stiffness * inertia)
    waves = list(zip(SIZES.tolist(), RATES.tolist(), PHASES.tolist(), strict=True))

    def torque(t, y, link_v):
        """With plain numbers, as the solver asks for it often."""
        lag = sum(a * sin(w * t + p) for a, w, p in waves) - y
        over = lag - min(max(lag, -half_width), half_width)
        if over == 0.0:
            return 0.0
        speed = sum(a * w * cos(w * t + p) for a, w, p in waves) - link_v
        push = stiffness * over + damping * speed
        return max(push, 0.0) if over > 0.0 else min(push, 0.0)

    def rates(t, y):
        q, v = y.tolist()
        return [v, (torque(t, q, v) - weight * sin(q)) / inertia]

    time = np.arange(0.0, seconds, 1.0 / rate)
    q, v, _ = motor(0.0)
    step = 5e-4
    y = solve_ivp(rates, time[[0, -1]], [q - half_width, v], "LSODA", time, max_step=step).y
    pushes = zip(time.tolist(), *y.tolist(), strict=True)
    return time, y, np.array([torque(*each) for each in pushes])


def smooth(values, width=400):
    """Return means over a fifth of a second."""
    return np.convolve(values, np.hanning(width) / np.hanning(width).sum(), "valid")


def test_effort(half_width=2e-3):
    """The filtered column has the impacts and pauses that SciPy finds."""
    time, _, torque = played(half_width)
    q, v, vd = motor(time)
    motion = Motion(*(np.stack([0.0 * q, x], 1) for x in (q, v, vd)), time)
    missing = torque - MODEL.effort(motion)[:, 1]
    column = Backlash("elbow", half_width).regressor(MODEL.motion(motion))[:, 1, 0]
    seen, explained = smooth(missing), smooth(column)
    share = explained @ seen / (explained @ explained)
    assert share == pytest.approx(1.0, abs=0.12)
    assert np.square(seen - share * explained).sum() < 0.15 * np.square(seen).sum()


def test_lag_falls_freely():
    """After a load changes its sign at a constant rate r, 2 h = r t³ / 6."""
    time = np.arange(-0.5, 0.5, 1e-3)
    lag = link_lag(1e-3, 30.0 * time, time)
    apart = (time > 0.0) & (lag < 1e-3)
    np.testing.assert_allclose(lag[time < 0.0], -1e-3)
    np.testing.assert_allclose(lag[apart], 30.0 * time[apart] ** 3 / 6 - 1e-3, atol=2e-5)
    assert time[apart][-1] == pytest.approx((12.0 * 1e-3 / 30.0) ** (1 / 3), abs=2e-3)


@pytest.mark.parametrize("has_slopes", [True, False])
def test_a_column_follows_no_noise_of_the_motion(has_slopes):
    """A link that hangs still lies at one side, whatever the noise of its acceleration.

    So it does beside a joint of several degrees, which has no slopes.
    """
    time, rng = np.arange(0.0, 4.0, 1e-3), np.random.default_rng(1)
    still = np.zeros((len(time), 2))
    noise = np.stack([0.0 * time, rng.normal(size=len(time))], 1)
    seen = MODEL.motion(Motion(still, still, noise, time))
    backlash = Backlash("elbow", 1e-5)
    assert np.ptp(backlash.regressor(seen)) > 0.1
    kept = 20.0 * np.sqrt(2.0 * 1e-3)  # of white noise, below 20 Hz
    known = replace(seen, bandwidth=20.0, acceleration_noise=np.array([0.0, 2.0 * kept]))
    if not has_slopes:
        known.effort_slopes.acceleration[:, :, 0] = np.nan
    assert np.ptp(backlash.regressor(known)) < 1e-12


@pytest.mark.thorough
def test_noise_of_coarse_encoders_is_no_share_of_a_wide_gap():
    """Loads of an upright axis are accelerations, whose noise is in column and error."""
    draw = servo_draws(3, 416, hobby=True)[2]
    found = explain(servo_file(draw.robot).model, [make_servo_log(draw).log])
    assert "backlash" not in {step.effect for step in found.steps}
