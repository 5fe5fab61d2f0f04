"""Efforts of currents and commands: gains by inertias, and servos by the motion."""

from dataclasses import replace

import numpy as np
import pytest
from pinocchio_logs import MODELS, effort_log
from scipy.integrate import solve_ivp
from servo_logs import LATE, PENDULUM, TRUTH, command, servo_log

from diagrams.benchmarks.servo_gains import HIDDEN, ServoDraw, score_servo
from geodrake import load_model
from geodrake.control import PositionServo, roll_out
from geodrake.control.export_proof import export_to
from geodrake.effects import CoulombFriction, FittedEffect, RotorInertia, ViscousFriction
from geodrake.effects.of_files import SquaredLoadFriction
from geodrake.errors import LogError
from geodrake.identification.logs import signal_calibration
from geodrake.identification.logs.case import prepare_case
from geodrake.identification.logs.effort_gains import ALIKE, _GeodesicBodies
from geodrake.identification.logs.joint_motions import JointMotions, motions_of
from geodrake.identification.logs.servo_fit import fit_servo
from geodrake.identification.logs.servo_motion import calc_command_before
from geodrake.identification.logs.signal_calibration import (
    calibrate_efforts,
    calibrated,
    expected_servo,
    gain_words,
    signals_as_efforts,
)
from geodrake.logs import JointLog, KnownPayload, Motion
from geodrake.logs.preparation import prepare_logs
from geodrake.model import EffortSignal, save_model
from geodrake.model.carried_payloads import carrying
from geodrake.model.servos import ServoError, ServoGains
from geodrake.model.signal_efforts import error_integral, in_efforts, servo_effort
from geodrake.report import Units
from geodrake.report.explaining import signals_table

INTEGRAL = 90.0


def pendulum(folder, effort=100):
    path = folder / "pendulum.urdf"
    path.write_text(PENDULUM.replace('effort="100"', f'effort="{effort}"'))
    return load_model(path)


def alone(model, log):
    sharp = prepare_logs(signals_as_efforts([log], ["command"]), bandwidth=5.0, motion_bandwidth=20)
    return motions_of(model, [log], sharp, [0])[0]


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return pendulum(tmp_path_factory.mktemp("pendulum"))


@pytest.fixture(scope="module")
def summed():
    return servo_log(integral=INTEGRAL)


@pytest.fixture(scope="module")
def log():
    return servo_log()


def test_it_finds_what_mujoco_has(model, log):
    fit = fit_servo(alone(model, log), EffortSignal("hinge", "command", 50.0))
    kp, rate, damping, coulomb, armature, late, offset, load, _, _ = fit.parameters
    assert kp == pytest.approx(TRUTH[0], rel=0.01)
    assert damping + rate == pytest.approx(TRUTH[2], rel=0.05)
    assert coulomb == pytest.approx(TRUTH[3], rel=0.05)
    assert armature == pytest.approx(TRUTH[4], rel=0.25)
    assert late - rate / kp == pytest.approx(LATE, abs=0.002)
    assert offset == 0.0 and load < 0.01
    assert fit.error < 2e-3 * fit.moved
    assert fit.error < 0.1 * fit.start
    assert np.isinf(fit.limit)


def test_intervals_of_slow_logs_hold_friction_and_rotors():
    """A double pendulum at 50 Hz has encoders with 4096 steps.

    Delay, damping and inertia compensate each other; with a fixed delay, few are inside.
    """
    draw = ServoDraw("double_pendulum", "mujoco", False, 0, 1, duration=20.0, hobby=True)
    row = score_servo(draw)
    values = [value for value in row["values"] if value["what"] in HIDDEN]
    assert [value["what"] for value in values].count("rotor_inertia") == 2
    assert sum(value["inside"] for value in values) >= len(values) - 1
    assert max(value["deviation"] / value["truth"] for value in values) < 1.0


def test_what_varies_with_the_motion_is_worth_few_samples(model, log):
    motions = alone(model, log)
    white = 1e-4 * np.random.default_rng(0).normal(size=len(motions.measured))
    q = np.concatenate(motions.rows)[:, 4]
    assert motions.noise(white) < 5.0 * np.mean(white**2)
    repeats = 1e-4 * (q - q.mean()) / q.std()
    assert motions.noise(repeats) > 0.2 * len(q) / 4.0 * np.mean(repeats**2)


def test_a_stiffness_may_be_far_from_those_of_other_joints():
    value, spread = expected_servo([], "wrist", 100.0, 0.2)["stiffness"]
    assert value * np.exp(-3.0 * spread) < 0.2 / 20.0
    assert expected_servo([], "wrist", 100.0, 50.0)["stiffness"][1] == ALIKE


def test_it_finds_friction_by_the_square_of_the_load(model, log):
    """It is neither dry friction nor proportional to the load."""
    motions = alone(model, log)
    moved = motions.simulated(motions.servo([60.0, 0.0, 4.0, 0.2, 0.08, 0.0, 0.0, 0.03]))
    told = replace(motions, positions=(moved,))
    fit = fit_servo(told, EffortSignal("hinge", "command", 50.0))
    assert fit.parameters[[0, 3, 7]] == pytest.approx([60.0, 0.2, 0.03], rel=0.03)
    motion = Motion(*(np.array([x]).T for x in ([0.7, -0.4, 0.9], [0.3, -0.2, -0.3], [2, 5, 1])))
    load = model.effort(motion)
    row = SquaredLoadFriction("hinge", 3.0).effort(model.motion(motion), np.array([0.03]))
    assert load[0, 0] > 3.0 and load[2, 0] > 3.0  # it drives, and brakes by as much as counts
    counts = np.array([[load[0, 0]], [load[1, 0]], [3.0]])
    np.testing.assert_allclose(row, 0.03 * counts**2 * np.sign(motion.v), rtol=1e-6)


def test_friction_by_the_load_is_that_of_bodies_that_speed_up():
    """Without weight, steps of the command alone load the gear."""
    period, count = 0.002, 1000
    kp, d, F, armature, k, M = 20.0, 1.0, 0.3, 0.05, 0.02, 0.4

    def rates(t, state):
        x, v = state
        push = kp * (1.0 - x) - d * v
        if v <= 0.0 and push <= F:
            return [0.0, 0.0]
        # push = (M + I) a + F + k (M a)², while it moves forwards
        square, linear, rest = k * M**2, M + armature, F - push
        return [v, 2.0 * -rest / (linear + np.sqrt(linear**2 - 4.0 * square * rest))]

    time = period * np.arange(count)
    stop = lambda t, state: state[1] if t > 0.01 else 1.0  # noqa: E731
    stop.terminal, stop.direction = True, -1.0
    exact = solve_ivp(rates, (0.0, time[-1]), np.zeros(2), t_eval=time, events=stop, rtol=1e-9)
    rows = np.zeros((count, 8))
    rows[:, 1], rows[:, 7] = M, 1.0
    motions = JointMotions((rows,), (np.zeros(count),), (period,))
    servo = [kp, 0.0, d, F, armature, 0.0, 0.0]
    seen = slice(len(exact.t))
    moved = motions.simulated(motions.servo([*servo, k]))[seen]
    assert len(exact.t) > 50
    np.testing.assert_allclose(moved, exact.y[0], atol=3e-3)
    assert np.abs(motions.simulated(motions.servo(servo))[seen] - exact.y[0]).max() > 0.02


@pytest.mark.parametrize("published, kept", [(1e3, True), (0.5, False)])
def test_a_data_sheet_limits_what_the_motion_does_not(tmp_path, published, kept):
    """It states the torque, less friction, which grows with the load beyond what was seen."""
    motions = alone(pendulum(tmp_path, 1e3), servo_log(seconds=6.0))
    signal = EffortSignal("hinge", "command", 50.0)
    fit = fit_servo(motions, signal, expected={"limit": (published, 0.7)})
    seen = min(published, np.abs(motions.needed).max())
    gross = published + fit.parameters[3] + fit.parameters[7] * seen**2
    assert (fit.limit == gross) == kept


def test_a_joint_that_falls_over_is_far_off_and_no_servo():
    """It stands on its head, and the servo at the start of the search is too weak to hold it."""
    period, count = 0.02, 1000
    rows = np.zeros((count, 8))
    rows[:, 1], rows[:, 2], rows[:, 4] = 0.5, -800.0, np.sin(3.0 * period * np.arange(count))
    rows[:, 0], rows[:, 7] = 5.0 * rows[:, 4], rows[:, 4]
    motions = JointMotions((rows,), (rows[:, 4],), (period,))
    at = motions.servo([5.0, 0.0, 0.1])
    found = motions.simulated(at)
    slopes = motions.with_slopes(at, np.arange(len(at)) < 6)[1]
    assert np.isfinite(found @ found) and np.isfinite(slopes.T @ slopes).all()
    assert np.abs(found - rows[:, 4]).max() == pytest.approx(1e3)
    few = rows[:200] * np.where(np.arange(8) == 2, 125.0, 1.0)
    alone = JointMotions((few,), (few[:, 4],), (period,))
    assert fit_servo(alone, EffortSignal("hinge", "command", 0.5)) is None


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


def test_where_a_joint_stands_says_nothing_of_a_servo():
    """Offsets of stretches, as of heavier bodies, once led to a gain with a tenth of the error."""
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


@pytest.fixture(scope="module")
def fitted(model, summed):
    return calibrate_efforts(model, [summed])


@pytest.mark.parametrize("integral", [0.0, INTEGRAL])
def test_a_linear_fit_of_the_motion_is_where_searches_begin(model, log, summed, integral):
    """The gain by inertias is useless for a servo whose integral holds the joint up."""
    motions = alone(model, summed if integral else log)
    found = motions.linear_servo(EffortSignal("hinge", "command", 0.5))
    assert found.gain == pytest.approx(TRUTH[0], rel=0.1)
    assert found.integral == pytest.approx(integral, rel=0.1)


def test_logs_whose_columns_were_looked_at_are_fitted_once(model, log, monkeypatch):
    """Notes on columns do not matter; other values need another fit."""
    made = []
    linear = signal_calibration._linear
    monkeypatch.setattr(
        signal_calibration, "_linear", lambda *given: made.append(1) or linear(*given)
    )
    calibrate_efforts(model, [log], simulate=False)
    calibrate_efforts(model, [replace(log, notes=("of rows",))], simulate=False)
    assert len(made) == 1
    calibrate_efforts(model, [replace(log, position=log.position.copy())], simulate=False)
    assert len(made) == 2


def test_it_finds_the_integral_that_mujoco_has(fitted):
    """Bodies are those of the file, gains as uncertain as in a single log."""
    (signal,) = fitted[0].effort_signals
    for value, truth in ((signal.gain, TRUTH[0]), (signal.integral, INTEGRAL)):
        assert value == pytest.approx(truth, rel=0.1)
    spread = np.hypot(signal.integral_deviation, signal.uncertainty * signal.integral)
    assert 0.0 < signal.integral_deviation < spread
    assert abs(signal.integral - INTEGRAL) < 2.0 * spread


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
    _, (known,), _ = calibrate_efforts(replace(model, effort_signals=(signal,)), [log])
    np.testing.assert_allclose(known.effort[3:-3, 0], needed[3:-3], atol=0.02)


def test_it_is_saved_shown_and_named_by_exports(fitted, summed, tmp_path):
    model = fitted[0]
    save_model(model, tmp_path / "fitted.yaml")
    assert load_model(tmp_path / "fitted.yaml").effort_signals == model.effort_signals
    table = signals_table(model.effort_signals, Units())
    assert "integral" in str(table) and "N·m/(rad·s)" in str(table)
    assert "limit" not in table.head
    vague = replace(model.effort_signals[0], limit=7.25, gain=39666.0, deviation=291172.0)
    shown = signals_table((vague,), Units())
    assert shown.head[-1] == "limit" and "7.25 N·m" in str(shown)
    assert "unknown, ± 29" in str(shown)
    assert f"{vague.joint} unknown, ± 2.9e+05" in gain_words(model, [vague])
    for form, cost in (("mjcf", [summed]), ("isaac", [])):
        notes = " ".join(export_to(form, model, tmp_path / form, cost).notes)
        assert f"servos of {form} have no integral gain, such as that of hinge" in notes
        assert ("% without it" in notes) == bool(cost)


def test_the_true_servo_moves_the_model_as_mujoco(model, summed):
    """The Drake diagram starts with the integral before each window."""
    names = (ViscousFriction, TRUTH[2]), (CoulombFriction, TRUTH[3]), (RotorInertia, TRUTH[4])
    effects = tuple(FittedEffect(kind("hinge"), np.array([value])) for kind, value in names)
    signal = EffortSignal("hinge", "command", TRUTH[0], delay=LATE, integral=INTEGRAL)
    true = replace(model, effects=effects, effort_signals=(signal,))
    servo = PositionServo.of(true)
    assert servo.gains(servo.CreateDefaultContext()).ki == pytest.approx([INTEGRAL])
    departures = [
        roll_out(replace(true, effort_signals=(each,)), [summed], most=2, commands=True).relative
        for each in (signal, replace(signal, integral=0.0), replace(signal, integral=45.0))
    ]
    assert departures[0] < 0.02 and departures[0] < 0.3 * min(departures[1:])


def test_damping_of_the_motion_alone_is_within_the_limit_of_mujoco_s_actuator(model, tmp_path):
    """In simulation, in efforts of a log, and after being saved; exports need no rate for it."""
    own, log = 1.0, servo_log(limit=5.0, feedback=True)
    names = (ViscousFriction, own), (CoulombFriction, TRUTH[3]), (RotorInertia, TRUTH[4])
    effects = tuple(FittedEffect(kind("hinge"), np.array([value])) for kind, value in names)
    values = {"damping": TRUTH[2] - own, "delay": LATE, "limit": 5.0, "rate_share": 0.0}
    signal = EffortSignal("hinge", "command", TRUTH[0], **values)
    true = replace(model, effects=effects, effort_signals=(signal,))
    knowing = replace(signal, rate_share=1.0)
    departures = [
        roll_out(replace(true, effort_signals=(each,)), [log], most=2, commands=True).relative
        for each in (signal, replace(signal, limit=np.inf), knowing)
    ]
    assert departures[0] < 0.02 and departures[0] < 0.3 * min(departures[1:])
    save_model(true, tmp_path / "true.yaml")
    assert load_model(tmp_path / "true.yaml").effort_signals == (signal,)
    assert "of 0 dc/dt − v" in str(signals_table((signal,), Units()))
    for each, name, told in ((signal, "alone", False), (knowing, "knowing", True)):
        exported = export_to("mjcf", replace(true, effort_signals=(each,)), tmp_path / name, [])
        assert ("damps the motion, but" in " ".join(exported.notes)) == told


def gains(kp, kd, ki, limit, band=0.0):
    return ServoGains(*(np.array([each]) for each in (kp, kd, ki, limit, band, 1.0)))


@pytest.mark.parametrize("band", [0.0, 0.03])
def test_simulation_is_that_of_position_servo(band):
    """Its law in SciPy's integration, with bodies' b, M, D and K, part of the time at the limit."""
    period, count = 0.002, 2500
    time = period * np.arange(count)
    b, M, K, D, d, armature, late = 0.7, 0.4, 3.0, 0.2, 3.0, 0.1, 0.007
    kp, kr, ki, limit = 40.0, 2.0, 30.0, 9.0
    servo = gains(kp, kr, ki, limit, band)

    def error(t, state):
        x, v, z = state
        parts = (np.sin(3.0 * (t - late)) - x, 3.0 * np.cos(3.0 * (t - late)) - v, z, 0.0)
        return ServoError(*(np.array([each]) for each in parts))

    def rates(t, state):
        told, (x, v, _) = error(t, state), state
        force = servo.effort(told)[0] - d * v - b - K * x - D * v
        return [v, force / (M + armature), servo.integral_rate(told)[0]]

    exact = solve_ivp(rates, (0.0, time[-1]), np.zeros(3), t_eval=time, max_step=4e-3, rtol=1e-6)
    efforts = [servo.effort(error(*each))[0] for each in zip(time, exact.y.T, strict=True)]
    assert 0.1 < np.mean(np.abs(efforts) >= limit) < 0.6
    rows = np.zeros((count, 8))
    rows[:, :4], rows[:, 7] = (b, M, K, D), np.sin(3.0 * time)
    motions = JointMotions((rows,), (exact.y[0],), (period,))
    parameters = [kp, kr, d, 0.0, armature, late, 0.0, 0.0, ki, band]
    after, size = time > 2.0, np.abs(exact.y[0]).max()  # before the log there was no command
    off = motions.residual(motions.servo(parameters, limit=limit))[after]
    assert np.abs(off).max() < 5e-3 * size
    assert np.abs(motions.residual(motions.servo(parameters))).max() > 0.05 * size
    without = motions.residual(motions.servo(parameters[:9], limit=limit))[after]
    assert not band or np.abs(without).max() > 0.01 * size


def test_it_finds_a_dead_band(model, log, tmp_path):
    """Dry friction does not act where weight pulls; the model with it moves like the log."""
    motions = alone(model, log)
    servo = [60.0, 0.0, 4.0, 0.2, 0.08, 0.0, 0.0, 0.0, 0.0, 0.02]
    told = replace(motions, positions=(motions.simulated(motions.servo(servo)),))
    signal = EffortSignal("hinge", "command", 50.0)
    fit = fit_servo(told, signal)
    assert fit.parameters[[0, 3, 9]] == pytest.approx([60.0, 0.2, 0.02], rel=0.03)
    assert fit.deviations[9] < 0.01
    found = signal_calibration.signal_by_motion(signal, fit)
    known = replace(model, effort_signals=(found,))
    save_model(known, tmp_path / "known.yaml")
    assert load_model(tmp_path / "known.yaml").effort_signals == (found,)
    assert "0.02" in str(signals_table((found,), Units()))
    (exported,) = (export_to("mjcf", known, tmp_path / "mjcf", []),)
    assert "dead band" in " ".join(exported.notes)
    moved = replace(log, position=log.position[:, :1])
    effort = servo_effort(moved, 0, replace(found, delay=0.0, damping=0.0))
    e = log.command[:, 0] - log.position[:, 0]
    expected = found.gain * np.sign(e) * np.maximum(np.abs(e) - found.dead_band, 0.0)
    np.testing.assert_allclose(effort, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("limit", "own", "band"),
    [(np.inf, 0.0, 0.0), (7.0, 0.2, 0.0), (7.0, 0.9, 0.0), (np.inf, 0.0, 0.01)],
)
def test_slopes_are_finite_differences(limit, own, band, tmp_path):
    """Each of two stretches begins with an effort of the integral."""
    log = servo_log(integral=60.0, limit=limit, seconds=7.0)
    whole = alone(pendulum(tmp_path, 100 if np.isinf(limit) else limit), log)
    motions = JointMotions(
        (whole.rows[0][:600], whole.rows[0][900:1400]),
        (whole.positions[0][:600], whole.positions[0][900:1400]),
        whole.periods * 2,
    )
    at = motions.servo([55.0, 1.0, 3.0, 0.8, 0.1, 0.0123, 0.3, 0.02, 50.0, band], limit=limit)
    at[11:] = own, 1.5, -0.7
    free = np.array(
        [*range(9), 12, 13, *np.flatnonzero([*[False] * 9, band, limit < 9, limit < 9])]
    )
    every = motions.with_slopes(at, np.ones(len(at), bool))[1]
    slopes = every[:, free]
    expected = np.empty_like(slopes)
    for k, number in enumerate(free):
        step = 1e-6 * np.abs(at[number]) * np.eye(len(at))[number]
        both = motions.simulated(at + step) - motions.simulated(at - step)
        expected[:, k] = both / (2.0 * step[number])
    assert not slopes[600:, 9].any() and not slopes[:600, 10].any()
    error, most = np.abs(slopes - expected), np.abs(slopes).max(0)
    if np.isinf(limit) and not band:
        assert (error <= 2e-5 * most).all()
    else:  # where it begins to act within a step, there is no slope: few rows
        plain = at.copy()
        plain[9:11] = 0.0, np.inf
        assert np.abs(motions.simulated(at) - motions.simulated(plain)).max() > 0.009
        assert (np.median(error, axis=0) < 1e-3 * most).all()
        assert (error.max(0) < 0.05 * most).all()


@pytest.mark.parametrize("feedback", [False, True])
def test_an_integral_is_found_beside_a_limit_that_hides_it(feedback, tmp_path):
    """A linear fit of what a servo is behind says nothing of one that is at its limit."""
    limit = 6.0
    log = servo_log(integral=INTEGRAL, limit=limit, seconds=12.0, feedback=feedback)
    known, (made,), _ = calibrate_efforts(pendulum(tmp_path, limit), [log])
    (signal,) = known.effort_signals
    assert 0.05 < np.mean(np.abs(made.effort) >= limit) < 0.9
    assert signal.gain == pytest.approx(TRUTH[0], rel=0.05)
    assert signal.integral == pytest.approx(INTEGRAL, rel=0.1)
    assert signal.limit == limit


def test_velocity_feedback_is_within_the_limit(tmp_path):
    """As in MuJoCo's position actuators."""
    motions = alone(pendulum(tmp_path, 5.0), servo_log(limit=5.0, seconds=20.0, feedback=True))
    fit = fit_servo(motions, EffortSignal("hinge", "command", 50.0), 5.0)
    assert fit.limit == 5.0
    assert fit.parameters[0] == pytest.approx(TRUTH[0], rel=0.02)
    feedback, damping = fit.parameters[1:3]
    assert feedback == pytest.approx(TRUTH[2] - 1.0, rel=0.1)
    assert damping == pytest.approx(1.0, abs=0.3)
    assert fit.rate_share < 0.1
    found = fit_servo(motions, EffortSignal("hinge", "command", 50.0))
    assert found.limit == pytest.approx(5.0, rel=0.02) and found.error < 1.1 * fit.error


def test_a_joint_that_stands_exactly_still_has_no_servo():
    """Nor has one without effort; nothing is divided by zero."""
    rows = np.zeros((400, 8))
    rows[:, 1] = 0.5
    motions = JointMotions((rows,), (rows[:, 4],), (0.004,))
    for integral in (0.0, 3.0):
        assert fit_servo(motions, EffortSignal("a", "command", 5.0, integral=integral), 3.0) is None


def test_a_servo_that_is_always_at_its_limit_is_refused(tmp_path):
    asked, model = servo_log(limit=2.0, seconds=6.0), pendulum(tmp_path, 2.0)
    saturated = "servo of hinge in log 'servo' is saturated: its command "
    with pytest.raises(LogError, match=f"{saturated}is far from its position, "):
        prepare_case(model, [asked], candidates=False)
    known = replace(model, effort_signals=(EffortSignal("hinge", "command", 50.0, limit=2.0),))
    held = replace(asked, command=np.full_like(asked.command, 9.0))
    with pytest.raises(LogError, match=f"{saturated}never changes, .*If it is off, use --passive"):
        prepare_case(known, [held], candidates=False)


def test_an_integral_in_a_log_is_held_as_that_of_position_servo():
    time = np.linspace(0.0, 6.0, 3001)
    error = 0.2 * np.sin(2.0 * time) + 0.05
    servo, z = gains(40.0, 0.0, 50.0, 9.0), np.zeros(len(time))
    for k, step in enumerate(np.diff(time)):
        acting = (error[k], 0.0, z[k], 0.0)
        z[k + 1] = z[k] + step * servo.integral_rate(ServoError(*map(np.atleast_1d, acting)))[0]
    found = error_integral(time, error, 40.0 * error, 50.0, 9.0)
    np.testing.assert_allclose(found, z, atol=1e-3)
    assert np.abs(error_integral(time, error) - z).max() > 0.05
    nothing = np.full(3, np.nan)
    assert not error_integral(np.arange(3.0), nothing, nothing, 1.0, 1.0).any()


def test_an_integral_that_makes_a_joint_swing_up_ends_its_search():
    """Its gradients overflow."""
    rows, time = np.zeros((6000, 8)), 0.005 * np.arange(6000)
    rows[:, 7], rows[:, 4] = np.sin(2.0 * time), 0.9 * np.sin(2.0 * time - 0.2)
    rows[:, 5] = np.gradient(rows[:, 4], time)
    rows[:, 6] = np.gradient(rows[:, 5], time)
    rows[:, 0], rows[:, 1] = 0.005 * rows[:, 6], 0.005
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(rows))
    motions = JointMotions((rows,), (rows[:, 4] + noise,), (0.005,))
    fit = fit_servo(motions, EffortSignal("a", "command", 40.0, integral=3e4), 5.0)
    assert fit is None or fit.error < 0.1 * fit.moved


def test_commands_between_rows_bend_as_smooth_ones_do():
    """Straight lines would resemble a servo that knows their rate, with less friction."""
    rate, period = 2.0 * np.pi * 2.0, 0.02
    rows = np.zeros((200, 8))
    rows[:, 7] = np.sin(rate * period * np.arange(200))
    at = np.linspace(2.0, 197.0, 777)
    found = np.array([calc_command_before(rows, each, period) for each in at.tolist()])
    straight = np.interp(at, np.arange(200), rows[:, 7])
    expected = np.sin(rate * period * at)
    off = np.abs(found[:, 0] - expected).max()
    assert off < 0.1 * np.abs(straight - expected).max()
    np.testing.assert_allclose(found[:, 1], rate * np.cos(rate * period * at), atol=0.03 * rate)


GAINS = np.array([12.0, -7.5, 3.0, 5.0, 1.5, 0.8])


ARM = load_model(MODELS / "arm6.urdf")


def friction(seen):
    """Return dry and viscous friction in another formula than the library's."""
    return 2.0 * seen.v / np.sqrt(seen.v**2 + 1e-4) + 1.5 * seen.v


@pytest.fixture(scope="module")
def torques():
    return effort_log("arm6", 3, friction, off=0.05, duration=12.0, rate=100.0).log


def currents(log, gains):
    kinds = dict.fromkeys(log.joints, "current")
    return replace(log, effort=log.effort / gains, effort_kinds=kinds)


@pytest.fixture(scope="module")
def found(torques):
    return calibrated(ARM, [currents(torques, GAINS)], ["current"] * 6)


def test_gains_lie_in_their_intervals_and_near(found):
    """Bodies are 5 % off, every joint has friction, and one sign is reversed."""
    ratio = np.array([s.gain for s in found]) / GAINS
    spread = np.array([s.uncertainty for s in found])
    told = spread < 0.4  # light wrists hardly show theirs
    assert told[:3].all()
    np.testing.assert_allclose(ratio[told], 1.0, atol=0.1)
    assert (np.abs(np.log(np.abs(ratio))) < 2.0 * spread).all()


@pytest.mark.parametrize("are_magnitudes", [True, False])
def test_currents_that_do_not_go_with_the_motion_are_refused(torques, are_magnitudes):
    """Late ones, with and without their sign: no gain makes efforts of them."""
    log = currents(torques, GAINS)
    late = np.roll(log.effort, 400, axis=0)
    log = replace(log, effort=np.abs(late) if are_magnitudes else late)
    with pytest.raises(LogError, match=r"The currents of .* do not match the motion") as error:
        calibrate_efforts(ARM, [log])
    assert ("seem to be magnitudes" in error.value.advice) == are_magnitudes


def test_unit_and_signs_of_currents_do_not_matter(torques, found):
    units = 1e3 * np.array([1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    other = calibrated(ARM, [currents(torques, GAINS * units)], ["current"] * 6)
    for a, b, unit in zip(found, other, units, strict=True):
        assert b.gain == pytest.approx(unit * a.gain, rel=1e-3)
        assert b.uncertainty == pytest.approx(a.uncertainty, rel=1e-2)


def test_measured_efforts_tell_the_scale_of_the_others(torques, found):
    log = currents(torques, GAINS)
    effort = log.effort.copy()
    effort[:, 1] *= GAINS[1]
    kinds = {joint: kind for joint, kind in log.effort_kinds.items() if joint != log.joints[1]}
    mixed = replace(log, effort=effort, effort_kinds=kinds)
    names = ["current", "effort", *["current"] * 4]
    known = {s.joint: s.uncertainty for s in calibrated(ARM, [mixed], names)}
    alone = {s.joint: s.uncertainty for s in found}
    assert log.joints[1] not in known
    assert known[log.joints[2]] < alone[log.joints[2]]


def test_known_gains_are_taken_as_they_are(torques):
    signals = tuple(
        EffortSignal(joint, "current", gain, 0.02 * abs(gain))
        for joint, gain in zip(torques.joints, GAINS.tolist(), strict=True)
    )
    model, logs, notes = calibrate_efforts(
        replace(ARM, effort_signals=signals), [currents(torques, GAINS)]
    )
    np.testing.assert_allclose(logs[0].effort, torques.effort)
    np.testing.assert_allclose(logs[0].gain_deviations, 0.02)
    assert model.effort_signals == signals and not notes


def test_logs_of_two_kinds_are_refused_together(torques):
    with pytest.raises(LogError, match=r"current in .* and effort in"):
        calibrate_efforts(ARM, [currents(torques, GAINS), replace(torques, name="other")])


def test_a_model_of_voltages_refuses_currents(torques):
    signals = tuple(EffortSignal(joint, "voltage", 2.0) for joint in torques.joints)
    with pytest.raises(LogError, match="knows its gain from voltage"):
        calibrate_efforts(replace(ARM, effort_signals=signals), [currents(torques, GAINS)])
    motor = EffortSignal(torques.joints[0], "effort", 1.0, limit=9.0)
    with pytest.raises(LogError, match="its motor's limit for commanded efforts"):
        calibrate_efforts(replace(ARM, effort_signals=(motor,)), [currents(torques, GAINS)])


def test_rows_beyond_the_limit_of_a_motor_are_noted(torques):
    asked = np.abs(torques.effort[:, 0])
    motor = EffortSignal(torques.joints[0], "effort", 1.0, limit=float(np.quantile(asked, 0.75)))
    able = replace(ARM, effort_signals=(motor,))
    _, (given,), (note,) = calibrate_efforts(able, [torques])
    assert np.abs(given.effort[:, 0]).max() == motor.limit
    assert (
        f"in 25 % of the rows the commanded effort of {motor.joint} exceeds the motor's limit"
        in note
    )
    assert note in prepare_case(able, [torques], candidates=False).notes
    assert calibrate_efforts(able, [given])[2] == []


def test_slopes_of_geodesic_bodies_are_those_of_differences():
    bodies = _GeodesicBodies.of(ARM)
    x = 0.3 * np.random.default_rng(0).normal(size=ARM.phi.size)
    x[:10] = 0.0  # where eigenvalues meet
    slope = bodies.at(x)[1]
    step = 1e-6
    columns = [
        (bodies.at(x + step * e)[0] - bodies.at(x - step * e)[0]) / (2.0 * step)
        for e in np.eye(len(x))
    ]
    np.testing.assert_allclose(slope, np.stack(columns, 1), atol=1e-6 * np.abs(slope).max())
