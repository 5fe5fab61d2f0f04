"""Servos with an integral, found by the motion: against exact integration, and MuJoCo's logs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from servo_logs import LATE, PENDULUM, TRUTH, servo_log

from geodrake import load_model
from geodrake.control import PositionServo, command_rollout
from geodrake.control.export_proof import export_to
from geodrake.effects import CoulombFriction, FittedEffect, RotorInertia, ViscousFriction
from geodrake.identification.logs.servo_fit import JointMotions, fit_servo, motions_of
from geodrake.identification.logs.signal_calibration import signals_as_efforts, with_efforts
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog, Motion
from geodrake.logs.preparation import prepare_logs
from geodrake.model import EffortSignal
from geodrake.model.carried_payloads import carrying
from geodrake.model.saved_model import load_model as load_saved
from geodrake.model.saved_model import save_model
from geodrake.model.signal_efforts import (
    constants_beside_friction,
    error_integral,
    runs_between_gaps,
    servo_effort,
)
from geodrake.report.explaining import signals_table
from geodrake.report.numbers import Units

INTEGRAL = 90.0


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return load_model(path)


@pytest.fixture(scope="module")
def log():
    return servo_log(integral=INTEGRAL)


@pytest.fixture(scope="module")
def fitted(model, log):
    return with_efforts(model, [log])


def alone(model, log):
    sharp = prepare_logs(signals_as_efforts([log], ["command"]), bandwidth=5.0, motion_bandwidth=20)
    return motions_of(model, [log], sharp, [0])[0]


def with_gaps(log, instants, length):
    """The log without the rows of a time, s, after each instant."""
    time = log.time - log.time[0]
    kept = np.all([(time < at) | (time > at + length) for at in instants], axis=0)
    columns = ("time", "position", "effort", "command")
    return replace(log, **{name: getattr(log, name)[kept] for name in columns})


def test_simulation_is_that_of_the_equation():
    """A linear servo with an integral that has begun before, by SciPy."""
    period, count = 0.002, 2500
    time = period * np.arange(count)
    b, M, K, D = 0.7, 0.5, 3.0, 0.2
    kp, kr, d, armature, late, ki, w = 40.0, 2.0, 3.0, 0.1, 0.007, 60.0, 0.3

    def told(t):
        return np.sin(3.0 * t) * (t > 0.0)

    def rates(t, state):
        x, v, z = state
        c, rate = told(t - late), 3.0 * np.cos(3.0 * (t - late)) * (t > late)
        force = kp * (c - x) + kr * (rate - v) + w + ki * z - d * v - b - K * x - D * v
        return [v, force / (M + armature), c - x]

    rows = np.zeros((count, 8))
    rows[:, :4], rows[:, 7] = (b, M, K, D), told(time)
    exact = solve_ivp(rates, (0.0, time[-1]), np.zeros(3), t_eval=time, rtol=1e-8, atol=1e-9)
    motions = JointMotions((rows,), (exact.y[0],), (period,))
    servo = motions.servo([kp, kr, d, 0.0, armature, late, ki])
    servo[-1] = w
    size = np.abs(exact.y[0]).max()
    assert np.abs(motions.residual(servo)).max() < 2e-3 * size
    plain = motions.servo([kp, kr, d, 0.0, armature, late])
    assert np.abs(motions.residual(plain)).max() > 0.1 * size


def test_slopes_are_finite_differences(model, log):
    """Of two stretches, each with an effort of its own that the integral begins with."""
    whole = alone(model, log)
    motions = JointMotions(
        (whole.rows[0][:600], whole.rows[0][900:1400]),
        (whole.positions[0][:600], whole.positions[0][900:1400]),
        whole.periods * 2,
    )
    at = motions.servo([55.0, 1.0, 3.0, 0.8, 0.1, 0.0123, 80.0])
    at[-2:] = 1.5, -0.7
    free = np.flatnonzero(np.isfinite(at) & (at != 0.0))
    slopes = motions.slopes(at, np.ones(len(at)), np.isin(np.arange(len(at)), free))
    for k, number in enumerate(free):
        step = 1e-6 * np.abs(at[number]) * np.eye(len(at))[number]
        both = motions.simulated(at + step) - motions.simulated(at - step)
        expected = both / (2.0 * step[number])
        np.testing.assert_allclose(slopes[:, k], expected, atol=2e-5 * np.abs(expected).max())
    assert not slopes[600:, 7].any() and not slopes[:600, 8].any()


def test_it_finds_what_mujoco_has(fitted):
    """By a log alone: bodies are those of the file, gains as uncertain as these are."""
    (signal,) = fitted[0].effort_signals
    for value, truth in ((signal.gain, TRUTH[0]), (signal.integral, INTEGRAL)):
        assert value == pytest.approx(truth, rel=0.1)
    spread = np.hypot(signal.integral_deviation, signal.uncertainty * signal.integral)
    assert 0.0 < signal.integral_deviation < spread
    assert abs(signal.integral - INTEGRAL) < 2.0 * spread


def test_a_linear_fit_without_it_finds_it_too(model, log):
    fit = fit_servo(alone(model, log), EffortSignal("hinge", "command", 50.0))
    assert fit.parameters[6] == pytest.approx(INTEGRAL, rel=0.05)
    assert fit.parameters[0] == pytest.approx(TRUTH[0], rel=0.05)
    assert fit.error < 2e-3 * fit.moved


def test_a_servo_without_one_gets_none(model):
    """And bodies that are wrong by a constant effort, which an integral would hide, give none."""
    motions = alone(model, servo_log(seconds=9.0))
    fit = fit_servo(motions, EffortSignal("hinge", "command", 50.0, integral=40.0))
    assert fit.parameters[6] == 0.0 and fit.deviations[6] == 0.0
    assert fit.parameters[0] == pytest.approx(TRUTH[0], rel=0.02)
    rows = [each + 0.3 * np.eye(8)[0] for each in motions.rows]
    fit = fit_servo(replace(motions, rows=tuple(rows)), EffortSignal("hinge", "command", 50.0))
    assert fit is None or fit.parameters[6] == 0.0


def test_efforts_contain_the_integral(fitted, log):
    """Those of the log are what bodies and friction need, with no constant left."""
    model, (known,), _ = fitted
    q, t = log.position[:, 0], log.time
    v = np.gradient(q, t)
    needed = (0.05 + 2.0 * 0.4**2 + TRUTH[4]) * np.gradient(v, t) + 2.0 * 9.81 * 0.4 * np.sin(q)
    needed += TRUTH[2] * v + TRUTH[3] * np.sign(v)
    smooth = np.ones(25) / 25
    left = np.convolve(known.effort[:, 0] - needed, smooth, "valid")
    assert np.std(left) < 0.12 * np.std(needed)
    assert abs(np.mean(left)) < 0.03 * np.std(needed)
    without = replace(model.effort_signals[0], integral=0.0)
    late = with_efforts(replace(model, effort_signals=(without,)), [log])[1][0].effort[:, 0]
    assert np.std(np.convolve(late - needed, smooth, "valid")) > 0.5 * np.std(needed)


def test_an_integral_has_grown_to_what_a_payload_needs(model):
    """Of a log that says what was carried; errors are those of the equation for its effort."""
    period, kp = 4e-3, 60.0
    t = period * np.arange(2500)
    q = (1.0 + 0.3 * np.sin(2.0 * t))[:, None]
    v = np.gradient(q, period, axis=0)
    motion = Motion(q, v, np.gradient(v, period, axis=0))
    payload = KnownPayload("rod", 1.0, (0.0, 0.0, -0.5))
    needed = carrying(model, (payload,)).effort(motion)[:, 0]
    rate, error = np.gradient(needed, period), np.zeros(len(t))
    for k in range(len(t) - 1):
        error[k + 1] = error[k] + period * (rate[k] - INTEGRAL * error[k]) / kp
    command, nothing = q + error[:, None], np.full(q.shape, np.nan)
    log = JointLog("log", ("hinge",), t, q, nothing, command=command, payloads=(payload,))
    signal = EffortSignal("hinge", "command", kp, integral=INTEGRAL)
    _, (known,), _ = with_efforts(replace(model, effort_signals=(signal,)), [log])
    np.testing.assert_allclose(known.effort[3:-3, 0], needed[3:-3], atol=0.02)


def test_integrals_of_errors_and_constants():
    time = np.array([0.0, 1.0, 2.0, 4.0])
    grown = error_integral(time, np.array([1.0, 3.0, np.nan, 1.0]))
    np.testing.assert_allclose(grown, [0.0, 2.0, 4.0, 8.0])  # straight over what is not known
    v, runs = np.sin(np.linspace(0.0, 9.0, 200)), np.repeat([0, 1], 100)
    effort = 0.7 - 1.1 * runs + 0.2 * v + 0.4 * np.sign(v)
    effort[3] = np.nan
    found = constants_beside_friction(effort, v, runs)
    np.testing.assert_allclose(found, 0.7 - 1.1 * runs)
    assert not constants_beside_friction(np.full(3, np.nan), np.ones(3), np.arange(3)).any()


def test_integrals_begin_anew_after_long_gaps(model, log):
    """What a joint was behind in a gap of a second is not known, and not made up."""
    signal = EffortSignal("hinge", "command", TRUTH[0], delay=LATE, integral=INTEGRAL)
    known = replace(model, effort_signals=(signal,))
    short = with_gaps(log, [5.0, 9.0], 1.0)
    runs = runs_between_gaps(short.time, short.position[:, 0])
    assert [np.count_nonzero(runs == k) > 500 for k in range(runs[-1] + 1)] == 3 * [True]
    whole, parts = (with_efforts(known, [each])[1][0] for each in (log, short))
    expected = np.interp(short.time, log.time, whole.effort[:, 0])
    off = np.sqrt(np.mean((parts.effort[:, 0] - expected) ** 2))
    assert off < 0.02 * np.std(expected)


def test_each_stretch_begins_where_the_fit_sees_it(model, log):
    """Or nobody would know what its integral begins with."""
    motions = alone(model, with_gaps(log, [3.0, 6.0, 9.0, 12.0], 0.1))
    counts = [len(rows) for rows in motions.rows]
    for tested in np.split(motions.tested, np.cumsum(counts)[:-1]):
        assert not tested[0] and tested[-1] and 0.4 < np.mean(tested) < 0.6
    whole = alone(model, log)
    assert np.count_nonzero(np.diff(whole.tested)) == 7


@pytest.mark.thorough  # by default, test_each_stretch_begins_where_the_fit_sees_it
@pytest.mark.parametrize("length", [0.05, 0.1, 1.0])
@pytest.mark.parametrize("count", [4, 12])
def test_it_is_found_in_logs_with_gaps(model, length, count):
    log = servo_log(integral=INTEGRAL, seconds=41.0)
    gaps = np.linspace(0.0, 40.0, count + 2)[1:-1]
    motions = alone(model, with_gaps(log, gaps, length))
    fit = fit_servo(motions, EffortSignal("hinge", "command", 50.0))
    assert fit.parameters[6] == pytest.approx(INTEGRAL, rel=0.05)
    assert fit.parameters[0] == pytest.approx(TRUTH[0], rel=0.05)


def test_it_is_saved_shown_and_named_by_exports(fitted, log, tmp_path):
    model = fitted[0]
    save_model(model, tmp_path / "fitted.yaml")
    assert load_saved(tmp_path / "fitted.yaml").effort_signals == model.effort_signals
    table = signals_table(model.effort_signals, Units())
    assert "integral" in str(table) and "N·m/(rad·s)" in str(table)
    assert "limit" not in table.head
    limited = replace(model.effort_signals[0], limit=7.25)
    assert signals_table((limited,), Units()).head[-1] == "limit"
    assert "7.25 N·m" in str(signals_table((limited,), Units()))
    for form, cost in (("mjcf", [log]), ("isaac", [])):
        notes = " ".join(export_to(form, model, tmp_path / form, cost).notes)
        assert f"servos of {form} have no integral, such as that of hinge" in notes
        assert ("of its motion without it" in notes) == bool(cost)


def test_a_log_too_short_for_a_rollout_is_exported_with_the_note(model, log, tmp_path):
    signal = EffortSignal("hinge", "command", TRUTH[0], delay=LATE, integral=INTEGRAL)
    columns = ("time", "position", "effort", "command")
    short = replace(log, **{name: getattr(log, name)[:110] for name in columns})
    known = replace(model, effort_signals=(signal,))
    notes = " ".join(export_to("mjcf", known, tmp_path, [short], bandwidth=60.0).notes)
    assert "have no integral, such as that of hinge; PositionServo" in notes


def test_the_true_servo_moves_the_model_as_mujoco(model, log):
    """In a Drake diagram, from what the integral has grown to before each window."""
    names = (ViscousFriction, TRUTH[2]), (CoulombFriction, TRUTH[3]), (RotorInertia, TRUTH[4])
    effects = tuple(FittedEffect(kind("hinge"), np.array([value])) for kind, value in names)
    signal = EffortSignal("hinge", "command", TRUTH[0], delay=LATE, integral=INTEGRAL)
    true = replace(model, effects=effects, effort_signals=(signal,))
    servo = PositionServo.of(true)
    assert servo.gains(servo.CreateDefaultContext()).ki == pytest.approx([INTEGRAL])
    departures = [
        command_rollout(replace(true, effort_signals=(each,)), [log], most=2).relative
        for each in (signal, replace(signal, integral=0.0), replace(signal, integral=45.0))
    ]
    assert departures[0] < 0.02 and departures[0] < 0.3 * min(departures[1:])


def test_late_commands_are_integrated_late(log):
    signal = EffortSignal("hinge", "command", 60.0, delay=LATE, integral=INTEGRAL)
    plain = servo_effort(log, 0, replace(signal, integral=0.0))
    summed = (servo_effort(log, 0, signal) - plain) / INTEGRAL
    rate = np.gradient(summed, log.time)[10:-10]
    np.testing.assert_allclose(rate, (plain / 60.0)[10:-10], atol=2e-4)
