"""Servos found by the motion: against exact integration, and against MuJoCo's actuators."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from servo_logs import LATE, PENDULUM, TRUTH, command, servo_log

from geodrake import load_model
from geodrake.errors import LogError
from geodrake.identification.logs.servo_fit import (
    JointMotions,
    fit_servo,
    motions_of,
)
from geodrake.identification.logs.signal_calibration import (
    calibrated,
    signals_as_efforts,
    with_efforts,
)
from geodrake.logs.preparation import prepare_logs
from geodrake.model import EffortSignal
from geodrake.model.signal_efforts import in_efforts, servo_effort


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return load_model(path)


@pytest.fixture(scope="module")
def log():
    return servo_log()


@pytest.fixture(scope="module")
def motions(model, log):
    sharp = prepare_logs(signals_as_efforts([log], ["command"]), bandwidth=5.0, motion_bandwidth=20)
    return motions_of(model, [log], sharp, [0])[0]


def test_simulation_is_that_of_the_equation():
    """A linear servo whose bodies have b, M, D and K of their own, by SciPy."""
    period, count = 0.002, 2500
    time = period * np.arange(count)
    b, M, K, D = 0.7, 0.5, 3.0, 0.2
    kp, kr, d, armature, late = 40.0, 2.0, 3.0, 0.1, 0.007

    def told(t):
        return np.sin(3.0 * t)

    rows = np.zeros((count, 8))
    rows[:, :4], rows[:, 7] = (b, M, K, D), told(time)

    def rates(t, state):
        x, v = state
        c, rate = told(t - late), 3.0 * np.cos(3.0 * (t - late))
        force = kp * (c - x) + kr * (rate - v) - d * v - b - K * x - D * v
        return [v, force / (M + armature)]

    exact = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-10)
    motions = JointMotions((rows,), (exact.y[0],), (period,))
    residual = motions.residual(motions.servo([kp, kr, d, 0.0, armature, late]))
    after = time > 2.0  # before the log there was no command
    assert np.abs(residual[after]).max() < 2e-3 * np.abs(exact.y[0]).max()


def test_a_joint_sticks_until_friction_is_overcome():
    rows = np.zeros((400, 8))
    rows[:, 1] = 1.0
    rows[:, 7] = 0.01 * np.arange(400) / 400
    motions = JointMotions((rows,), (np.zeros(400),), (0.005,))
    x = motions.simulated(motions.servo([100.0, 0.0, 20.0, 0.5]))
    assert not x[:199].any()
    assert x[-1] == pytest.approx(0.01 - 0.005, abs=2e-3)


def test_slopes_are_finite_differences(motions):
    few = JointMotions(
        tuple(rows[:800] for rows in motions.rows),
        tuple(q[:800] for q in motions.positions),
        motions.periods,
    )
    at = few.servo([55.0, 1.0, 3.0, 0.8, 0.1, 0.0123])
    slopes = few.slopes(at, np.ones(len(at)), np.arange(len(at)) < 6)
    for k, step in enumerate(np.diag(1e-6 * at)[:6]):
        both = few.simulated(at + step) - few.simulated(at - step)
        expected = both / (2.0 * step[k])
        np.testing.assert_allclose(slopes[:, k], expected, atol=1e-5 * np.abs(expected).max())


def test_it_finds_what_mujoco_has(motions):
    fit = fit_servo(motions, EffortSignal("hinge", "command", 50.0))
    kp, rate, damping, coulomb, armature, late, _ = fit.parameters
    assert kp == pytest.approx(TRUTH[0], rel=0.01)
    assert damping + rate == pytest.approx(TRUTH[2], rel=0.05)
    assert coulomb == pytest.approx(TRUTH[3], rel=0.05)
    assert armature == pytest.approx(TRUTH[4], rel=0.25)
    assert late - rate / kp == pytest.approx(LATE, abs=0.002)
    assert fit.error < 2e-3 * fit.moved
    assert fit.error < 0.1 * fit.start


def test_it_is_never_worse_than_where_it_began(motions):
    """Positions that no servo makes: a fit to half of them may be bad for the other half."""
    wild = tuple(
        q + np.cumsum(np.random.default_rng(0).normal(size=len(q))) for q in motions.positions
    )
    parts = JointMotions(motions.rows, wild, motions.periods)
    fit = fit_servo(parts, EffortSignal("hinge", "command", 50.0))
    if fit is not None:
        begun = parts.rms(parts.servo(fit.parameters))
        assert fit.error == pytest.approx(begun) and fit.error < fit.start


def test_a_joint_that_falls_over_is_far_off_and_no_servo():
    """It stands on its head, and the servo that the search begins with is too weak to hold it."""
    period, count = 0.02, 1000
    rows = np.zeros((count, 8))
    rows[:, 1], rows[:, 2], rows[:, 4] = 0.5, -800.0, np.sin(3.0 * period * np.arange(count))
    rows[:, 0], rows[:, 7] = 5.0 * rows[:, 4], rows[:, 4]
    motions = JointMotions((rows,), (rows[:, 4],), (period,))
    at = motions.servo([5.0, 0.0, 0.1])
    found = motions.simulated(at, coarse=True)
    slopes = motions.slopes(at, np.ones(len(at)), np.arange(len(at)) < 6, coarse=True)
    assert np.isfinite(found @ found) and np.isfinite(slopes.T @ slopes).all()
    assert np.abs(found - rows[:, 4]).max() == pytest.approx(1e3)
    few = rows[:200] * np.where(np.arange(8) == 2, 125.0, 1.0)
    alone = JointMotions((few,), (few[:, 4],), (period,))
    assert fit_servo(alone, EffortSignal("hinge", "command", 0.5)) is None


def test_a_log_of_commands_gives_servos_and_efforts(model, log):
    (signal,) = calibrated(model, [log], ["command"])
    assert signal.kind == "command"
    assert abs(signal.gain - TRUTH[0]) < 2.0 * signal.deviation
    assert signal.gain == pytest.approx(TRUTH[0], rel=0.1)
    known, (efforts,), notes = with_efforts(model, [log])
    assert known.effort_signals == (signal,)
    assert np.isfinite(efforts.effort).all() and "commands" in notes[0]


def test_efforts_of_a_servo_are_its_equation(log):
    signal = EffortSignal("hinge", "command", 60.0, damping=2.0, delay=LATE, limit=5.0)
    effort = servo_effort(log, 0, signal)
    inner = slice(10, -10)
    t = log.time
    rate = (command(t - LATE + 1e-5) - command(t - LATE - 1e-5)) / 2e-5
    velocity = np.gradient(log.position[:, 0], t)
    exact = 60.0 * (command(t - LATE) - log.position[:, 0]) + 2.0 * (rate - velocity)
    np.testing.assert_allclose(effort[inner], np.clip(exact, -5.0, 5.0)[inner], atol=0.02)
    same = in_efforts(log, [signal])
    np.testing.assert_array_equal(same.effort[:, 0], effort)


def test_a_limit_is_held(log):
    signal = EffortSignal("hinge", "command", 60.0, limit=0.5)
    assert np.abs(in_efforts(log, [signal]).effort).max() == 0.5


def test_a_joint_with_nothing_is_refused(model, log):
    with pytest.raises(LogError):
        prepare_logs(with_efforts(model, [replace(log, command=None)])[1])


def test_where_a_joint_stands_says_nothing_of_a_servo():
    """Offsets of stretches, as of heavier bodies, made a tenth of the error no gain at all."""
    rng = np.random.default_rng(0)
    stretches = tuple(np.zeros((n, 8)) for n in (400, 300))
    motions = JointMotions(stretches, tuple(rows[:, 0] for rows in stretches), (0.004, 0.004))
    before, after = 1e-3 * rng.normal(size=700), 1e-4 * rng.normal(size=700)
    gain = motions.gain_of(before, after)
    assert gain > 700.0
    offset = np.repeat([2e-3, -5e-3], [400, 300])
    assert motions.gain_of(before + offset, after + offset) == pytest.approx(gain)
    assert motions.gain_of(before, after + offset, motions.tested) == pytest.approx(
        motions.gain_of(before, after, motions.tested)
    )
