"""Servos at their limit: simulated as saturated, found beside it, refused if they always are."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from servo_logs import PENDULUM, TRUTH, servo_log

from geodrake import load_model
from geodrake.control.systems.position_servo import (
    ServoError,
    ServoGains,
    integral_rate,
    servo_effort,
)
from geodrake.errors import LogError
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.servo_fit import JointMotions, fit_servo, motions_of
from geodrake.identification.logs.signal_calibration import signals_as_efforts, with_efforts
from geodrake.logs.preparation import prepare_logs
from geodrake.model import EffortSignal
from geodrake.model.signal_efforts import error_integral, limited_integral


def pendulum(folder, effort):
    path = folder / "pendulum.urdf"
    path.write_text(PENDULUM.replace('effort="100"', f'effort="{effort}"'))
    return load_model(path)


def alone(model, log):
    sharp = prepare_logs(signals_as_efforts([log], ["command"]), bandwidth=5.0, motion_bandwidth=20)
    return motions_of(model, [log], sharp, [0])[0]


def gains(kp, kd, ki, limit):
    return ServoGains(*(np.array([each]) for each in (kp, kd, ki, limit, 0.0)))


@pytest.mark.parametrize("ki", [0.0, 30.0])
def test_simulation_is_that_of_position_servo(ki):
    """Its law in SciPy's integration, part of the time at the limit."""
    period, count = 0.002, 1500
    time = period * np.arange(count)
    b, M, kp, kr, d, limit = 0.7, 0.5, 40.0, 2.0, 3.0, 9.0
    servo = gains(kp, kr, ki, limit)

    def error(t, state):
        x, v, z = state
        parts = (np.sin(3.0 * t) - x, 3.0 * np.cos(3.0 * t) - v, z, 0.0)
        return ServoError(*(np.array([each]) for each in parts))

    def rates(t, state):
        told = error(t, state)
        force = servo_effort(servo, told)[0] - d * state[1] - b
        return [state[1], force / M, integral_rate(servo, told)[0]]

    exact = solve_ivp(rates, (0.0, time[-1]), np.zeros(3), t_eval=time, max_step=4e-3, rtol=1e-6)
    efforts = [servo_effort(servo, error(*each))[0] for each in zip(time, exact.y.T, strict=True)]
    assert 0.1 < np.mean(np.abs(efforts) >= limit) < 0.6
    rows = np.zeros((count, 8))
    rows[:, :2], rows[:, 7] = (b, M), np.sin(3.0 * time)
    motions = JointMotions((rows,), (exact.y[0],), (period,))
    parameters = [kp, kr, d, 0.0, 0.0, 0.0, ki]
    size = np.abs(exact.y[0]).max()
    assert np.abs(motions.residual(motions.servo(parameters, limit=limit))).max() < 5e-3 * size
    assert np.abs(motions.residual(motions.servo(parameters))).max() > 0.05 * size


@pytest.mark.parametrize("own", [False, True])
def test_slopes_are_finite_differences(own, tmp_path):
    log = servo_log(integral=60.0, limit=7.0, seconds=5.0)
    motions = alone(pendulum(tmp_path, 7.0), log)
    at = motions.servo([55.0, 1.0, 3.0, 0.8, 0.1, 0.0123, 50.0], limit=7.0)
    at[8:] = own, 1.5
    free = np.array([0, 1, 2, 3, 4, 5, 6, 9])
    slopes = motions.slopes(at, np.ones(len(at)), np.isin(np.arange(len(at)), free))
    unlimited = np.where(np.arange(len(at)) == 7, np.inf, at)
    assert np.abs(motions.simulated(at) - motions.simulated(unlimited)).max() > 0.01
    for k, number in enumerate(free):
        step = 1e-7 * at[number] * np.eye(len(at))[number]
        both = motions.simulated(at + step) - motions.simulated(at - step)
        error = slopes[:, k] - both / (2.0 * step[number])
        # Where the limit begins to act within a step, there is no slope: few rows.
        assert np.median(np.abs(error)) < 1e-3 * np.abs(slopes[:, k]).max()
        assert np.abs(error).max() < 0.05 * np.abs(slopes[:, k]).max()


@pytest.mark.parametrize(
    ("integral", "limit"), [(0.0, 7.0), pytest.param(90.0, 7.0, marks=pytest.mark.thorough)]
)
def test_gains_are_those_of_a_servo_at_its_limit(integral, limit, tmp_path):
    model = pendulum(tmp_path, limit)
    known, (log,), _ = with_efforts(model, [servo_log(integral=integral, limit=limit)])
    (signal,) = known.effort_signals
    assert signal.limit == limit
    assert signal.gain == pytest.approx(TRUTH[0], rel=0.05)
    assert signal.integral == pytest.approx(integral, rel=0.05)
    at_limit = np.mean(np.abs(log.effort) >= limit)
    assert np.abs(log.effort).max() == limit and 0.05 < at_limit < 0.9


def test_velocity_feedback_is_within_the_limit(tmp_path):
    """As in MuJoCo's position actuators. A rate that comes late does the same for the joint."""
    motions = alone(pendulum(tmp_path, 5.0), servo_log(limit=5.0, seconds=12.0, feedback=True))
    fit = fit_servo(motions, EffortSignal("hinge", "command", 50.0), 5.0)
    assert fit.limit == 5.0
    assert fit.parameters[0] == pytest.approx(TRUTH[0], rel=0.05)
    assert sum(fit.parameters[1:3]) == pytest.approx(TRUTH[2], rel=0.1)
    assert fit.own or fit.parameters[1] == pytest.approx(TRUTH[2] - 1.0, rel=0.1)
    found = fit_servo(motions, EffortSignal("hinge", "command", 50.0))
    assert found.limit == pytest.approx(5.0, rel=0.02) and found.error < 1.1 * fit.error


@pytest.mark.thorough  # by default, test_velocity_feedback_is_within_the_limit
@pytest.mark.parametrize("integral", [0.0, 90.0])
@pytest.mark.parametrize("told", [14.0, 1e4])
def test_a_limit_that_the_model_does_not_have_is_found(integral, told, tmp_path):
    model = pendulum(tmp_path, told)
    known, (log,), _ = with_efforts(model, [servo_log(integral=integral, limit=7.0)])
    (signal,) = known.effort_signals
    assert signal.limit == pytest.approx(7.0, rel=0.01)
    assert signal.gain == pytest.approx(TRUTH[0], rel=0.05)
    assert signal.integral == pytest.approx(integral, rel=0.05)
    assert np.abs(log.effort).max() == signal.limit


def test_a_limit_that_the_servo_does_not_keep_is_none(tmp_path):
    motions = alone(pendulum(tmp_path, 5.0), servo_log(seconds=9.0))
    fit = fit_servo(motions, EffortSignal("hinge", "command", 50.0), 5.0)
    assert fit.limit == np.inf
    assert fit.parameters[0] == pytest.approx(TRUTH[0], rel=0.03)


def test_a_joint_that_stands_exactly_still_has_no_servo():
    """Of no effort, too: no number is divided by what is not there."""
    rows = np.zeros((400, 8))
    rows[:, 1] = 0.5
    motions = JointMotions((rows,), (rows[:, 4],), (0.004,))
    for integral in (0.0, 3.0):
        assert fit_servo(motions, EffortSignal("a", "command", 5.0, integral=integral), 3.0) is None


def test_a_servo_that_is_always_at_its_limit_is_refused(tmp_path):
    with pytest.raises(LogError, match="it is saturated"):
        open_case(pendulum(tmp_path, 2.0), [servo_log(limit=2.0)], candidates=False)


def test_an_integral_in_a_log_is_held_as_that_of_position_servo():
    time = np.linspace(0.0, 6.0, 3001)
    error = 0.2 * np.sin(2.0 * time) + 0.05
    servo, z = gains(40.0, 0.0, 50.0, 9.0), np.zeros(len(time))
    for k, step in enumerate(np.diff(time)):
        acting = (error[k], 0.0, z[k], 0.0)
        z[k + 1] = z[k] + step * integral_rate(servo, ServoError(*map(np.atleast_1d, acting)))[0]
    found = limited_integral(time, error, 40.0 * error, 50.0, 9.0)
    np.testing.assert_allclose(found, z, atol=1e-3)
    assert np.abs(error_integral(time, error) - z).max() > 0.05
    nothing = np.full(3, np.nan)
    assert not limited_integral(np.arange(3.0), nothing, nothing, 1.0, 1.0).any()
