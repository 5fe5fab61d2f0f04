"""Logs without efforts: gains of the signals that replace them, and the efforts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import FittedEffect, Role, catalogue
from geodrake.effects.base import JointEffect, Parameter, RobotEffect
from geodrake.effects.declarations import when_sliding
from geodrake.effects.file_terms import Damping, DryFriction, LoadFriction, Offset, Rotor
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
from geodrake.logs.units_of_values import effort_sign_hint, position_unit_hint
from geodrake.model.carried_payloads import carried_phi, carrying
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal, signal_of
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of
from geodrake.model.signal_efforts import in_efforts, kind_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CarriedColumn(RobotEffect):
    """The effort that known payloads of a log need.

    It is no effect of the robot, but a column of logs beside those of effects: where the gains of
    efforts are not known, it cannot be taken off what was measured.
    """

    # Number of a log -> name of a body -> inertial parameters (10,) of what it carries there.
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


_SHARP = 20.0  # Hz


def calibrate_efforts(
    model: RobotModel, logs: Sequence[JointLog], *, simulate: bool = True
) -> tuple[RobotModel, list[JointLog], list[str]]:
    """Return the model with effort signals, logs with efforts, and notes.

    Gains that the model does not know are found by its inertias; see `effort_gains`. Logs have
    their joints in the model's order. Servos are those of simulated joints; where columns are only
    looked at, the linear fit alone will do, some three times as fast.

    Raises:
        LogError: Something else stands for the efforts of a joint in one log than in another or in
            the model, or there is nothing at all, or a servo is at its limit nearly all the time,
            or no signal goes with the motion.
    """
    if not logs:
        return model, [], []
    kinds = _kinds(model, logs)
    if all(kind == "effort" for kind in kinds) and not model.effort_signals:
        return model, list(logs), []
    asked, logs = logs, list(logs)
    if model.effort_signals:
        logs = [_known_efforts(model, log) for log in logs]
    notes = [note for pair in zip(asked, logs, strict=True) for note in _limit_notes(model, *pair)]
    kinds = _kinds(model, logs)  # of joints that the model does not know
    if all(kind == "effort" for kind in kinds):
        return model, logs, notes
    found = calibrated(model, logs, kinds, simulate=simulate)
    _check_known(found, logs)
    model = replace(model, effort_signals=(*model.effort_signals, *found))
    return (
        model,
        [_known_efforts(model, log) for log in logs],
        [*notes, gain_words(model, found, logs)],
    )


def _check_known(found: Sequence[EffortSignal], logs: Sequence[JointLog]) -> None:
    """Raise for motor signals that are unrelated to the efforts of the motion."""
    measured = [signal for signal in found if signal.kind in SIGNAL_KINDS]
    if not measured or len(measured) < len(found) or not all(map(_is_unknown, measured)):
        return
    kinds = " and ".join(dict.fromkeys(f"{signal.kind}s" for signal in measured))
    looks = (position_unit_hint, effort_sign_hint)
    hint = next((hint for log in logs for look in looks if (hint := look(log))), "")
    raise LogError(
        f"The {kinds} of {', '.join(signal.joint for signal in measured)} do not match the "
        "motion with any gains.",
        advice=hint
        or "Are they of these joints, synchronous and with the right sign? Do the joints move "
        "under load? Otherwise give the gains with --gain JOINT=VALUE.",
    )


def _is_unknown(signal: EffortSignal) -> bool:
    return signal.deviation >= abs(signal.gain)


def _limit_notes(model: RobotModel, asked: JointLog, given: JointLog) -> list[str]:
    """Return notes on commanded efforts of a log that exceed motor limits."""
    notes = []
    for at, joint in enumerate(asked.joints):
        signal = signal_of(model.effort_signals, joint)
        if signal is None or signal.kind != EFFORT:
            continue
        beyond = np.isfinite(asked.effort[:, at]) & (given.effort[:, at] != asked.effort[:, at])
        if beyond.any():
            notes.append(
                f"{asked.name}: in {100.0 * np.mean(beyond):.2g} % of the rows the commanded "
                f"effort of {joint} exceeds the motor's limit in the model, which is used "
                "instead"
            )
    return notes


def _known_efforts(model: RobotModel, log: JointLog) -> JointLog:
    """Return the log with efforts of joints whose signals the model can convert."""
    signals = model.effort_signals
    summed = any(each.integral and kind_of(log, each.joint) == COMMAND for each in signals)
    known = in_efforts(log, signals, _needed(model, log) if summed else None)
    check_saturation(known, log)
    return known


def _needed(model: RobotModel, log: JointLog) -> Array:
    """Return (N, n) efforts, N·m or N, that a model needs for positions of a log, noise and all.

    What the robot carried in the log needs its share of them.
    """
    q, known = log.position.copy(), np.isfinite(log.time)
    for column in q.T:
        there = np.isfinite(column) & known
        if there.any():
            column[:] = np.interp(log.time, log.time[there], column[there])
    needed = np.full(q.shape, np.nan)
    if np.count_nonzero(known) > 1 and np.isfinite(q[known]).all():
        time = log.time[known]
        v = np.gradient(q[known], time, axis=0)
        motion = Motion(model.positions(q[known]), v, np.gradient(v, time, axis=0))
        needed[known] = carrying(model, log.payloads).effort(motion)
    return needed


def gain_words(
    model: RobotModel, signals: Sequence[EffortSignal], logs: Sequence[JointLog] = ()
) -> str:
    """Return the fitted gains in words, with data sheets of motors."""
    words = []
    for signal in signals:
        slides = signal.joint in model.sliding_joints
        unit = when_sliding(signal.unit) if slides else signal.unit
        unknown = _is_unknown(signal)
        value = "unknown," if unknown else f"{signal.gain:.3g}"
        words.append(f"{signal.joint} {value} ± {signal.deviation:.2g} {unit}")
        if (told := published_gain(logs, signal.joint, signal.kind)) is not None and not unknown:
            share, spread = signal.gain / told[0], signal.deviation / told[0]
            words[-1] += f" ({share:.2g} ± {spread:.1g} times the published value of {told[2]})"
    kinds = " and ".join(dict.fromkeys(f"{signal.kind}s" for signal in signals))
    return (
        f"efforts are computed from {kinds}, with gains estimated with the model's inertias: "
        f"{', '.join(words)}"
    )


def calibrated(
    model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str], *, simulate: bool = True
) -> tuple[EffortSignal, ...]:
    """Fit the signals of all joints without measured efforts.

    `kinds` (nv,) are what stands for the efforts of each joint. A linear fit takes efforts of
    servos for a gain times how far the command is away; how their joints move says the rest, from
    that on. The linear fit counts for a simulation of the same logs afterwards.

    Raises:
        LogError: A servo pushes away from where it is told to go.
    """
    of, linear = _LINEAR.pop(model, ((), None))
    if linear is None or len(of) != len(logs) or not all(map(_is_same, of, logs)):
        linear = _linear(model, logs, kinds)
    trajectories, gains = linear
    found, deviations = dict[int, EffortSignal](), gains.deviations * np.abs(gains.gains)
    for j, (joint, kind) in enumerate(zip(model.joints, kinds, strict=True)):
        if kind != EFFORT:
            gain = float(abs(gains.gains[j]) if kind == COMMAND else gains.gains[j])
            found[j] = EffortSignal(joint, kind, gain, float(deviations[j]))
    servos, moved = [j for j, kind in enumerate(kinds) if kind == COMMAND], set[int]()
    if not simulate:
        _LINEAR[model] = tuple(logs), linear
    elif servos:
        motions, alike = servo_motions(model, logs, servos, trajectories), _alike(model, kinds)
        starts = {j: own.pieces().linear_servo(found[j]) for j, own in motions.items()}
        for j, own in motions.items():
            same = [starts[k].gain for k in servos if alike[k] == alike[j]]
            share, usual = min(found[j].uncertainty, float(gains.bodies[j])), float(np.median(same))
            fit = servo_by_motion(model, logs, own, starts[j], usual=usual, bodies=share)
            if fit is not None:
                found[j] = signal_by_motion(found[j], fit)
                moved.add(j)
    for j in servos:  # where an integral holds a joint up, the motion alone tells its sign
        if gains.gains[j] < 0.0 and j not in moved:
            raise LogError(
                f"The servo of {model.joints[j]} has a negative stiffness, "
                f"{gains.gains[j]:.3g} ± {deviations[j]:.2g} N·m/rad.",
                advice="Does its command or position have the wrong sign, or belong to another "
                "joint?",
                joint=model.joints[j],
            )
    return tuple(found.values())


_Linear = tuple[Sequence[Trajectory], SignalGains]
"""Prepared logs with signals in the place of efforts, and gains by a linear fit."""

_LINEAR = WeakKeyDictionary[RobotModel, tuple[tuple[JointLog, ...], _Linear]]()
"""Linear fits of logs whose columns were looked at, until the logs are compared with the model."""


def _is_same(log: JointLog, other: JointLog) -> bool:
    """Return whether logs have identical values, apart from notes."""
    names = [field.name for field in fields(log) if field.name != "notes"]
    return all(getattr(log, name) is getattr(other, name) for name in names)


def _linear(model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]) -> _Linear:
    """Fit gains of logs' signals, whose `kinds` (nv,) are those of the joints."""
    trajectories = prepare_logs(signals_as_efforts(logs, kinds))
    usual = [kind for kind in catalogue() if kind.complexity == 0]
    free = [kind.shaped(joint)[0] for joint in model.single_joints for kind in usual]
    free += [effect for effect in effects_of(model) if effect.role is not Role.BODY]
    free = list(dict.fromkeys(free))
    held = None
    if any(log.payloads for log in logs):
        each = [(log_number(log.name), carried_phi(model, log.payloads)) for log in logs]
        held = CarriedColumn({n: _by_body(model, phi) for n, phi in each})
    effects = free if held is None else [*free, held]
    folds = validation_blocks(trajectories)
    dataset = reduce_logs(model, trajectories, folds, effects=effects)
    d = model.phi.size
    rows = [SignalRows.of(dataset, j, d, free, held=held) for j in range(len(kinds))]
    gains = signal_gains(rows, model, _gain_priors(model, logs, kinds), _alike(model, kinds))
    return trajectories, gains


def _alike(model: RobotModel, kinds: Sequence[str]) -> list[str]:
    """Return (nv,) kinds of signals whose gains are alike."""
    pairs = zip(model.joints, kinds, strict=True)
    return [f"{kind} {joint in model.sliding_joints}" for joint, kind in pairs]


def _gain_priors(model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]) -> GainPriors:
    """Return the priors of gains of efforts, from logs, and of signals, from data sheets."""
    deviations = np.max([log.gain_deviations for log in logs], axis=0)
    known = np.where([kind == EFFORT for kind in kinds], np.maximum(deviations, 1e-6), np.inf)
    expected = np.ones(len(kinds))
    for j, (joint, kind) in enumerate(zip(model.joints, kinds, strict=True)):
        published = published_gain(logs, joint, kind)
        if published is not None:
            expected[j] = published[0]
            known[j] = _log_deviation(*published[:2])
    return GainPriors(expected, known)


def published_gain(
    logs: Sequence[JointLog], joint: str, kind: str
) -> tuple[float, float, str] | None:
    """Return a published gain of a signal, its deviation, and the motor's name."""
    for log in logs:
        motor = log.motors.get(joint)
        told = None if motor is None else motor.gain(kind)
        if motor is not None and told is not None:
            return (*told, motor.name)
    return None


def expected_servo(logs: Sequence[JointLog], joint: str, usual: float, linear: float) -> Expected:
    """Return the servo in data sheets, or a usual stiffness.

    Servos are alike only as far as the stiffness by a linear fit allows: that of a wrist may be a
    thousandth of that of a shoulder.
    """
    found = {"stiffness": (usual, max(ALIKE, abs(float(np.log(linear / usual)))))}
    motors = [log.motors[joint] for log in logs if joint in log.motors]
    for motor in motors[:1]:
        for name, told in (("stiffness", motor.gain(COMMAND)), ("armature", motor.armature)):
            if told is not None:
                found[name] = told[0], _log_deviation(*told[:2])
        if motor.stall_torque is not None:
            found["limit"] = motor.stall_torque[0], LOWERED
    return found


def _log_deviation(value: float, deviation: float) -> float:
    """Return the deviation of a value's logarithm; at least a thousandth."""
    return max(float(np.sqrt(np.log1p((deviation / value) ** 2))), 1e-3)


def _by_body(model: RobotModel, phi: Array) -> dict[str, Array]:
    """Name -> inertial parameters (10,) of bodies (nb, 10) that are something."""
    return {body: own for body, own in zip(model.bodies, phi, strict=True) if own.any()}


def servo_motions(
    model: RobotModel,
    logs: Sequence[JointLog],
    joints: Sequence[int],
    trajectories: Sequence[Trajectory] | None = None,
) -> dict[int, JointMotions]:
    """Return the data for simulations of joints with servos, at sufficient bandwidth.

    Bodies are those of the model that is saved, not as a linear fit moves them. The logs may have
    been prepared for such a fit, as `trajectories`.
    """
    kinds = [COMMAND if j in joints else EFFORT for j in range(len(model.joints))]
    known = signals_as_efforts(logs, kinds)
    before = prepare_logs(known) if trajectories is None else trajectories
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in before)
    bandwidth, motion = before[0].bandwidths
    sharp = min(max(motion, _SHARP), highest)
    prepared = prepare_logs(known, bandwidth=bandwidth, motion_bandwidth=sharp)
    return motions_of(replace(model, effects=()), logs, prepared, joints)


def servo_by_motion(
    model: RobotModel,
    logs: Sequence[JointLog],
    motions: JointMotions,
    signal: EffortSignal,
    *,
    usual: float | None = None,
    bodies: float = 0.0,
) -> ServoFit | None:
    """Return the servo of a joint by how it moves in logs, if that is predicted better for it.

    Args:
        motions: The joint along the logs.
        signal: The servo by a linear fit, or as it was known.
        usual: Stiffness of such servos, N·m/rad or N/m, if no data sheet says it; by default that
            of the signal.
        bodies: Share to which bodies are known.
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
    """Return the signal of a servo with the numbers of a fit to its motion."""
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
            for name, kind in BESIDE.items()
            if kind is not LoadFriction
        },
    )


BESIDE: Mapping[str, type[JointEffect]] = {
    "damping": Damping,
    "coulomb": DryFriction,
    "armature": Rotor,
    "offset": Offset,
    "load": LoadFriction,
}
"""Parameters of a `ServoFit` that are effects of the joint."""


def with_servo_motions(
    model: RobotModel, logs: Sequence[JointLog]
) -> tuple[RobotModel, dict[str, ServoFit]]:
    """Return the model with servos and friction by which its joints move as in logs.

    Each joint with a servo is simulated alone, under its commands; see `fit_servo`. Its friction,
    rotor inertia and offset are those of the simulation; joints that are simulated no better stay
    as they are. How well a stiffness is known stays the share of it that it was.

    Args:
        model: The model, which knows its servos.
        logs: Logs with commands, their joints in the model's order.

    Returns:
        The model, and what was found by the joint.
    """
    moved = [j for j, servo in enumerate(servos_of(model)) if servo is not None]
    signals = {signal.joint: signal for signal in model.effort_signals}
    fits = dict[str, ServoFit]()
    for j, motions in servo_motions(model, logs, moved).items():
        signal = signals[joint := model.joints[j]]
        fit = servo_by_motion(model, logs, motions, signal)
        if fit is not None:
            deviation = signal.uncertainty * fit.parameters[0]
            signals[joint] = replace(signal_by_motion(signal, fit), deviation=deviation)
            fits[joint] = fit.with_gain_uncertainty(signal.uncertainty)
    kinds = tuple(BESIDE.values())
    effects = [
        fitted
        for fitted in model.effects
        if not (isinstance(fitted.effect, kinds) and fitted.effect.where[0] in fits)
    ]
    for joint, fit in fits.items():
        for name, kind in BESIDE.items():
            value, unsure = (
                each[[PARAMETERS.index(name)]] for each in (fit.parameters, fit.deviations)
            )
            if value.any() and kind is LoadFriction:
                effects.append(LoadFriction.fitted(joint, value.item(), unsure.item()))
            elif value.any():
                effects.append(FittedEffect(kind.shaped(joint)[0], value, unsure))
    return replace(model, effects=tuple(effects), effort_signals=tuple(signals.values())), fits


def signals_as_efforts(logs: Sequence[JointLog], kinds: Sequence[str]) -> list[JointLog]:
    """Return logs with signals in the place of efforts: of servos, how far the command is away.

    What known payloads need is not taken off a signal of unknown gain: they are left out. `kinds`
    (nv,) are what stands for the efforts of each joint.
    """
    found = []
    for log in logs:
        effort = log.effort.copy()
        for j, kind in enumerate(kinds):
            if kind == COMMAND and log.command is not None:
                effort[:, j] = log.command[:, j] - log.position[:, j]
        found.append(
            replace(
                log, effort=effort, effort_kinds=dict.fromkeys(log.passive, PASSIVE), payloads=()
            )
        )
    return found


def _kinds(model: RobotModel, logs: Sequence[JointLog]) -> tuple[str, ...]:
    """Return (nv,) the kind of each joint's effort signal."""
    found = []
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
        found.append(kind)
    return tuple(found)
