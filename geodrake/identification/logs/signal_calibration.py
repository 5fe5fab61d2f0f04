"""Calibrate signals such as currents and commands, and convert them to efforts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Role, catalogue
from geodrake.effects.base import Parameter, RobotEffect
from geodrake.effects.declarations import when_sliding
from geodrake.effects.lookup import servo_effects
from geodrake.effects.robot_motion import RobotMotion, log_number
from geodrake.errors import LogError
from geodrake.identification.logs.effort_gains import (
    ALIKE,
    GainPriors,
    SignalGains,
    SignalRows,
    signal_gains,
)
from geodrake.identification.logs.joint_motions import JointMotions, motions_of
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.identification.logs.servo_fit import LOWERED, Expected, ServoFit, fit_servo
from geodrake.identification.logs.servo_motion import PARAMETERS
from geodrake.logs.filtering import HIGHEST_BANDWIDTH
from geodrake.logs.folds import validation_blocks
from geodrake.logs.log_checks import check_saturation
from geodrake.logs.motion import PASSIVE, SIGNAL_KINDS, JointLog, Motion, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.uniform_log import UniformLog, make_uniform
from geodrake.logs.units_of_values import effort_hint, position_unit_hint
from geodrake.model.carried_payloads import carried_phi, carrying
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal, signal_of
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of
from geodrake.model.signal_efforts import in_efforts, kind_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CarriedColumn(RobotEffect):
    """Effort of the known payloads of a log, as a column beside those of effects.

    With unknown gains it cannot be subtracted from the measured signal.
    """

    # Number of a log -> name of a body -> inertial parameters (10,) of its payload.
    carried: Mapping[int, Mapping[str, Array]] = field(default_factory=dict, compare=False)

    name = "carried"
    parameters = (Parameter("share", "1"),)
    depends_on = frozenset({"q", "v", "vd", "bodies"})

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Return the column (N, 1) at every joint."""
        effort = np.zeros_like(motion.v)
        for body, phi in self.carried.get(motion.log, {}).items():
            effort += motion.body_columns(body) @ phi
        return {joint: effort[:, j : j + 1] for j, joint in enumerate(motion.joints)}


_LEAST_MOTION_BANDWIDTH = 20.0  # of simulations, Hz


def calibrate_efforts(
    model: RobotModel, logs: Sequence[JointLog], *, simulate: bool = True
) -> tuple[RobotModel, list[JointLog], list[str]]:
    """Return the model with effort signals, logs with efforts, and notes.

    Unknown gains are estimated with the model's inertias; see `effort_gains`. Logs have their
    joints in the model's order. Without `simulate`, servos are those of a linear fit, about three
    times as fast.

    Raises:
        LogError: The kinds of a joint's signals differ between logs or from the model, there is no
            signal, a servo saturates nearly all the time, or no signal matches the motion.
    """
    if not logs:
        return model, [], []
    kinds = _kinds(model, logs)
    if all(kind == "effort" for kind in kinds) and not model.effort_signals:
        return model, list(logs), []
    raw_logs, logs = logs, list(logs)
    if model.effort_signals:
        logs = [_known_efforts(model, log) for log in logs]
    pairs = zip(raw_logs, logs, strict=True)
    notes = [note for pair in pairs for note in _limit_notes(model, *pair)]
    kinds = _kinds(model, logs)  # now only of joints that the model does not convert
    if all(kind == "effort" for kind in kinds):
        return model, logs, notes
    signals = calibrated(model, logs, kinds, simulate=simulate)
    _check_known(signals, logs)
    model = replace(model, effort_signals=(*model.effort_signals, *signals))
    return (
        model,
        [_known_efforts(model, log) for log in logs],
        [*notes, gain_words(model, signals, logs)],
    )


def _check_known(signals: Sequence[EffortSignal], logs: Sequence[JointLog]) -> None:
    """Raise for motor signals that are unrelated to the efforts of the motion."""
    measured = [signal for signal in signals if signal.kind in SIGNAL_KINDS]
    if not measured or len(measured) < len(signals) or not all(map(_is_unknown, measured)):
        return
    kinds = " and ".join(dict.fromkeys(f"{signal.kind}s" for signal in measured))
    looks = (position_unit_hint, effort_hint)
    hint = next((hint for log in logs for look in looks if (hint := look(log))), "")
    raise LogError(
        f"The {kinds} of {', '.join(signal.joint for signal in measured)} do not match the "
        "motion with any gains.",
        advice=hint
        or "Do they belong to these joints, in time and with the right sign? Do the joints move "
        "under load? Otherwise give the gains with --gain JOINT=VALUE.",
    )


def _is_unknown(signal: EffortSignal) -> bool:
    return signal.deviation >= abs(signal.gain)


def _limit_notes(model: RobotModel, commanded: JointLog, limited: JointLog) -> list[str]:
    """Return notes on commanded efforts of a log that exceed motor limits."""
    notes = []
    for j, joint in enumerate(commanded.joints):
        signal = signal_of(model.effort_signals, joint)
        if signal is None or signal.kind != EFFORT:
            continue
        command = commanded.effort[:, j]
        beyond = np.isfinite(command) & (limited.effort[:, j] != command)
        if beyond.any():
            notes.append(
                f"{commanded.name}: in {100.0 * np.mean(beyond):.2g} % of the rows the commanded "
                f"effort of {joint} exceeds the motor's limit in the model, which is used "
                "instead"
            )
    return notes


def _known_efforts(model: RobotModel, log: JointLog) -> JointLog:
    """Return the log with efforts of joints whose signals the model can convert."""
    signals = model.effort_signals
    has_integral = any(each.integral and kind_of(log, each.joint) == COMMAND for each in signals)
    converted = in_efforts(log, signals, _raw_efforts(model, log) if has_integral else None)
    check_saturation(converted, log)
    return converted


def _raw_efforts(model: RobotModel, log: JointLog) -> Array:
    """Return the model's efforts (N, n), N·m or N, with known payloads, at raw positions."""
    q, timed = log.position.copy(), np.isfinite(log.time)
    for column in q.T:
        valid = np.isfinite(column) & timed
        if valid.any():
            column[:] = np.interp(log.time, log.time[valid], column[valid])
    efforts = np.full(q.shape, np.nan)
    if np.count_nonzero(timed) > 1 and np.isfinite(q[timed]).all():
        time = log.time[timed]
        v = np.gradient(q[timed], time, axis=0)
        motion = Motion(model.positions(q[timed]), v, np.gradient(v, time, axis=0))
        efforts[timed] = carrying(model, log.payloads).effort(motion)
    return efforts


def gain_words(
    model: RobotModel, signals: Sequence[EffortSignal], logs: Sequence[JointLog] = ()
) -> str:
    """Return a sentence with the fitted gains, relative to data sheets if known."""
    words = []
    for signal in signals:
        slides = signal.joint in model.sliding_joints
        unit = when_sliding(signal.unit) if slides else signal.unit
        unknown = _is_unknown(signal)
        gain = "unknown," if unknown else f"{signal.gain:.3g}"
        words.append(f"{signal.joint} {gain} ± {signal.deviation:.2g} {unit}")
        published = published_gain(logs, signal.joint, signal.kind)
        if published is not None and not unknown:
            value, _, motor = published
            share, spread = signal.gain / value, signal.deviation / value
            words[-1] += f" ({share:.2g} ± {spread:.1g} times the published value of {motor})"
    kinds = " and ".join(dict.fromkeys(f"{signal.kind}s" for signal in signals))
    return (
        f"efforts are computed from {kinds}, with gains estimated with the model's inertias: "
        f"{', '.join(words)}"
    )


def calibrated(
    model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str], *, simulate: bool = True
) -> tuple[EffortSignal, ...]:
    """Fit the signals of all joints without measured efforts.

    `kinds` (nv,) are the kinds of the joints' signals. The linear fit models the effort of a servo
    as a gain times its tracking error; simulations then start from it. It is cached for a
    simulation of the same logs.

    Raises:
        LogError: A servo has a negative stiffness.
    """
    cached_logs, linear = _LINEAR.pop(model, ((), None))
    if linear is None or len(cached_logs) != len(logs) or not all(map(_is_same, cached_logs, logs)):
        linear = _linear(model, logs, kinds)
    prepared, gains = linear
    signals, deviations = dict[int, EffortSignal](), gains.deviations * np.abs(gains.gains)
    for j, (joint, kind) in enumerate(zip(model.joints, kinds, strict=True)):
        if kind != EFFORT:
            gain = float(abs(gains.gains[j]) if kind == COMMAND else gains.gains[j])
            signals[j] = EffortSignal(joint, kind, gain, float(deviations[j]))
    servos, simulated = [j for j, kind in enumerate(kinds) if kind == COMMAND], set[int]()
    if not simulate:
        _LINEAR[model] = tuple(logs), linear
    elif servos:
        motions, groups = servo_motions(model, logs, servos, prepared), _groups(model, kinds)
        starts = {j: data.pieces().linear_servo(signals[j]) for j, data in motions.items()}
        for j, data in motions.items():
            usual = float(np.median([starts[k].gain for k in servos if groups[k] == groups[j]]))
            share = min(signals[j].uncertainty, float(gains.bodies[j]))
            fit = servo_by_motion(model, logs, data, starts[j], usual=usual, bodies=share)
            if fit is not None:
                signals[j] = signal_by_motion(signals[j], fit)
                simulated.add(j)
    for j in servos:  # with an integral, only a simulation identifies the sign
        if gains.gains[j] < 0.0 and j not in simulated:
            raise LogError(
                f"The servo of {model.joints[j]} has a negative stiffness, "
                f"{gains.gains[j]:.3g} ± {deviations[j]:.2g} N·m/rad.",
                advice="Does its command or position have the wrong sign, or belong to another "
                "joint?",
                joint=model.joints[j],
            )
    return tuple(signals.values())


_Prepared = tuple[Sequence[UniformLog], Sequence[Trajectory]]
"""Logs with signals in place of efforts, before and after their preparation for a linear fit."""

_Linear = tuple[_Prepared, SignalGains]
"""Such logs, and gains of a linear fit."""

_LINEAR = WeakKeyDictionary[RobotModel, tuple[tuple[JointLog, ...], _Linear]]()
"""Linear fits of the last logs of a model, reused when these logs are simulated."""


def _is_same(log: JointLog, other: JointLog) -> bool:
    """Return whether logs have identical values, apart from notes."""
    names = [field.name for field in fields(log) if field.name != "notes"]
    return all(getattr(log, name) is getattr(other, name) for name in names)


def _linear(model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]) -> _Linear:
    """Fit the gains of signals of the given `kinds` (nv,)."""
    uniform, trajectories = _prepared(logs, kinds)
    usual = [kind for kind in catalogue() if kind.complexity == 0]
    free = [kind.shaped(joint)[0] for joint in model.single_joints for kind in usual]
    free += [effect for effect in effects_of(model) if effect.role is not Role.BODY]
    free = list(dict.fromkeys(free))
    payloads = None
    if any(log.payloads for log in logs):
        carried = [(log_number(log.name), carried_phi(model, log.payloads)) for log in logs]
        payloads = CarriedColumn({n: _by_body(model, phi) for n, phi in carried})
    effects = free if payloads is None else [*free, payloads]
    folds = validation_blocks(trajectories)
    dataset = reduce_logs(model, trajectories, folds, effects=effects)
    d = model.phi.size
    rows = [SignalRows.of(dataset, j, d, free, payloads=payloads) for j in range(len(kinds))]
    gains = signal_gains(rows, model, _gain_priors(model, logs, kinds), _groups(model, kinds))
    return (uniform, trajectories), gains


def _prepared(logs: Sequence[JointLog], kinds: Sequence[str]) -> _Prepared:
    uniform = [make_uniform(log) for log in signals_as_efforts(logs, kinds)]
    return uniform, prepare_logs(uniform)


def _groups(model: RobotModel, kinds: Sequence[str]) -> list[str]:
    """Return labels (nv,) of groups of signals with similar gains."""
    pairs = zip(model.joints, kinds, strict=True)
    return [f"{kind} {joint in model.sliding_joints}" for joint, kind in pairs]


def _gain_priors(model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]) -> GainPriors:
    """Return the prior gains: of efforts from the logs, of other signals from data sheets."""
    deviations = np.max([log.gain_deviations for log in logs], axis=0)
    spread = np.where([kind == EFFORT for kind in kinds], np.maximum(deviations, 1e-6), np.inf)
    expected = np.ones(len(kinds))
    for j, (joint, kind) in enumerate(zip(model.joints, kinds, strict=True)):
        published = published_gain(logs, joint, kind)
        if published is not None:
            expected[j] = published[0]
            spread[j] = _log_deviation(*published[:2])
    return GainPriors(expected, spread)


def published_gain(
    logs: Sequence[JointLog], joint: str, kind: str
) -> tuple[float, float, str] | None:
    """Return a published gain of a signal, its deviation, and the motor's name."""
    for log in logs:
        motor = log.motors.get(joint)
        gain = None if motor is None else motor.gain(kind)
        if motor is not None and gain is not None:
            return (*gain, motor.name)
    return None


def expected_servo(logs: Sequence[JointLog], joint: str, usual: float, linear: float) -> Expected:
    """Return priors of a servo from data sheets, or from a usual stiffness.

    The prior is wide enough for the stiffness of the `linear` fit: that of a wrist may be a
    thousandth of that of a shoulder.
    """
    priors = {"stiffness": (usual, max(ALIKE, abs(float(np.log(linear / usual)))))}
    motors = [log.motors[joint] for log in logs if joint in log.motors]
    for motor in motors[:1]:
        for name, value in (("stiffness", motor.gain(COMMAND)), ("armature", motor.armature)):
            if value is not None:
                priors[name] = value[0], _log_deviation(*value[:2])
        if motor.stall_torque is not None:
            priors["limit"] = motor.stall_torque[0], LOWERED
    return priors


def _log_deviation(value: float, deviation: float) -> float:
    """Return the standard deviation of a value's logarithm, at least 0.001."""
    return max(float(np.sqrt(np.log1p((deviation / value) ** 2))), 1e-3)


def _by_body(model: RobotModel, phi: Array) -> dict[str, Array]:
    """Return the nonzero inertial parameters (10,) by body name."""
    return {body: own for body, own in zip(model.bodies, phi, strict=True) if own.any()}


def servo_motions(
    model: RobotModel,
    logs: Sequence[JointLog],
    joints: Sequence[int],
    prepared: _Prepared | None = None,
) -> dict[int, JointMotions]:
    """Return the data for simulations of servo joints, at sufficient bandwidth.

    The bodies are those of the model, not of a linear fit. `prepared` are the logs as prepared for
    such a fit, if there was one.
    """
    kinds = [COMMAND if j in joints else EFFORT for j in range(len(model.joints))]
    uniform, first = _prepared(logs, kinds) if prepared is None else prepared
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in first)
    bandwidth, motion_bandwidth = first[0].bandwidths
    motion_bandwidth = min(max(motion_bandwidth, _LEAST_MOTION_BANDWIDTH), highest)
    sharp = prepare_logs(uniform, bandwidth=bandwidth, motion_bandwidth=motion_bandwidth)
    return motions_of(replace(model, effects=()), logs, sharp, joints)


def servo_by_motion(
    model: RobotModel,
    logs: Sequence[JointLog],
    motions: JointMotions,
    signal: EffortSignal,
    *,
    usual: float | None = None,
    bodies: float = 0.0,
) -> ServoFit | None:
    """Fit the servo of a joint to its motion in logs; return None if that predicts no better.

    Args:
        motions: The joint along the logs.
        signal: The servo of a linear fit, or of the model.
        usual: Usual stiffness of such servos, N·m/rad or N/m, for joints without a data sheet; by
            default that of the signal.
        bodies: Relative uncertainty of the bodies.
    """
    limit = float(model.effort_limits[model.joints.index(signal.joint)])
    return fit_servo(
        motions,
        signal,
        limit if limit > 0.0 else np.inf,
        expected=expected_servo(logs, signal.joint, usual or signal.gain, signal.gain),
        bodies=bodies,
    )


def signal_by_motion(signal: EffortSignal, fit: ServoFit) -> EffortSignal:
    """Return the signal of a servo with the parameters of a fit to its motion."""
    gain, rate, *_, delay, _, _, integral, band = fit.parameters.tolist()
    spread = fit.deviations
    return replace(
        signal,
        gain=gain,
        deviation=float(spread[0]),
        damping=rate,
        damping_deviation=float(spread[1]) if rate else 0.0,
        delay=delay,
        integral=integral,
        integral_deviation=float(spread[-2]),
        dead_band=band,
        dead_band_deviation=float(spread[-1]),
        limit=fit.limit,
        rate_share=fit.rate_share,
        effect_deviations={
            kind.name: float(spread[PARAMETERS.index(name)])
            for name, kind in servo_effects().items()
            if kind in catalogue()
        },
    )


def with_servo_motions(
    model: RobotModel, logs: Sequence[JointLog]
) -> tuple[RobotModel, dict[str, ServoFit]]:
    """Fit servos, friction, rotor inertias and offsets to the motion of each servo joint.

    Each joint is simulated alone, under its commands; see `fit_servo`. Joints that are not
    predicted better keep their parameters. The relative uncertainty of a stiffness stays the same.
    Logs have commands, and their joints in the model's order.

    Returns:
        The model, and the fits by joint.
    """
    joints = [j for j, servo in enumerate(servos_of(model)) if servo is not None]
    signals = {signal.joint: signal for signal in model.effort_signals}
    fits = dict[str, ServoFit]()
    for j, motions in servo_motions(model, logs, joints).items():
        signal = signals[joint := model.joints[j]]
        fit = servo_by_motion(model, logs, motions, signal)
        if fit is not None:
            gain_deviation = signal.uncertainty * fit.parameters[0]
            signals[joint] = replace(signal_by_motion(signal, fit), deviation=gain_deviation)
            fits[joint] = fit.with_gain_uncertainty(signal.uncertainty)
    kinds = tuple(servo_effects().values())
    effects = [
        fitted
        for fitted in model.effects
        if not (isinstance(fitted.effect, kinds) and fitted.effect.where[0] in fits)
    ]
    for joint, fit in fits.items():
        values = zip(PARAMETERS, fit.parameters.tolist(), fit.deviations.tolist(), strict=True)
        for name, value, deviation in values:
            if name in servo_effects() and value:
                effects.append(servo_effects()[name].fitted(joint, value, deviation))
    return replace(model, effects=tuple(effects), effort_signals=tuple(signals.values())), fits


def signals_as_efforts(logs: Sequence[JointLog], kinds: Sequence[str]) -> list[JointLog]:
    """Return logs with signals of the given `kinds` (nv,) in place of efforts.

    The signal of a servo is its tracking error. Known payloads are dropped, as their effort cannot
    be subtracted from a signal of unknown gain.
    """
    converted = []
    for log in logs:
        effort = log.effort.copy()
        for j, kind in enumerate(kinds):
            if kind == COMMAND and log.command is not None:
                effort[:, j] = log.command[:, j] - log.position[:, j]
        passive = dict.fromkeys(log.passive, PASSIVE)
        converted.append(replace(log, effort=effort, effort_kinds=passive, payloads=()))
    return converted


def _kinds(model: RobotModel, logs: Sequence[JointLog]) -> tuple[str, ...]:
    """Return (nv,) the kind of each joint's effort signal."""
    all_kinds = []
    for joint in model.joints:
        kinds = {kind_of(log, joint): log.name for log in logs}
        if len(kinds) > 1:
            words = " and ".join(f"{kind} in {name!r}" for kind, name in kinds.items())
            raise LogError(
                f"The effort of {joint} is measured by {words}.",
                advice="Use logs of one kind together.",
                joint=joint,
            )
        kind = next(iter(kinds))
        signal = signal_of(model.effort_signals, joint)
        if signal is not None and kind not in (signal.kind, EFFORT):
            knows = f"its gain from {signal.kind}"
            if signal.kind == EFFORT:
                knows = "its motor's limit for commanded efforts"
            raise LogError(
                f"Log {kinds[kind]!r} has the {kind} of {joint}, but the model knows {knows}.",
                advice="Start from the model file, or set the kind of the column with --kind.",
                joint=joint,
            )
        all_kinds.append(kind)
    return tuple(all_kinds)
