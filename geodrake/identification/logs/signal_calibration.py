"""Logs without efforts: the gains of what was measured in their place, and the efforts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Role, catalogue
from geodrake.effects.base import Effect, JointEffect, JointMotion, Parameter, RobotEffect
from geodrake.effects.declarations import when_sliding
from geodrake.effects.robot_motion import RobotMotion, log_number
from geodrake.errors import LogError
from geodrake.identification.logs.criteria import PENALTY
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.effort_gains import (
    ALIKE,
    GainPriors,
    SignalGains,
    SignalRows,
    signal_gains,
)
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.identification.logs.servo_fit import (
    LONGEST_DELAY,
    USUAL_DELAY,
    Expected,
    JointMotions,
    ServoFit,
    fit_servo,
    motions_of,
)
from geodrake.logs.filtering import HIGHEST_BANDWIDTH
from geodrake.logs.folds import validation_blocks
from geodrake.logs.log_checks import check_saturation
from geodrake.logs.motion import PASSIVE, JointLog, Motion, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.model.carried_payloads import carried_phi, carrying
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal, signal_of
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import error_integral, in_efforts, kind_of

Array = NDArray[np.float64]

_BEFORE = 1.0  # s before a log, for which commands were as at its beginning

Series = tuple[Array, Array]
"""Instants (N,) since a log began, s, and values (N,)."""


@dataclass(frozen=True)
class LoggedColumn(JointEffect):
    """A column of logs at a joint: its values (N,) by the log's number and instants (N,), s."""

    values: Callable[[int, Array], Array]

    name = "logged"
    parameters = (Parameter("share", "1"),)
    depends_on = frozenset({"time"})

    def columns(self, joint: JointMotion) -> tuple[Array]:
        """Return [1], where there are no instants."""
        return (np.ones_like(joint.v),)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Return the column (N, 1) at the joint."""
        if motion.time is None:
            return super().rows(motion)
        return {self.joint: self.values(motion.log, motion.time)[:, None]}


@dataclass(frozen=True, eq=False)
class Commands:
    """The commands c of a joint in several logs, as columns for every delay that is tried.

    Series of a log are by its number. In a log without commands everything is 0.
    """

    joint: str
    told: Mapping[int, Series]  # c, rad or m
    summed: Mapping[int, Series]  # ∫c dt, rad·s or m·s; before a log begins c is as it is there
    behind: Mapping[int, Series]  # ∫(c − q) dt, rad·s or m·s
    later: tuple[int, ...]  # numbers of all logs but the first one

    @classmethod
    def of(cls, logs: Sequence[JointLog], joint: str) -> Commands:
        """Return those of a joint in logs, some with commands."""
        commands, summed, behind = dict[int, Series](), dict[int, Series](), dict[int, Series]()
        for log in logs:
            if log.command is None or joint not in log.joints:
                continue
            j, number = log.joints.index(joint), log_number(log.name)
            told, position = log.command[:, j], log.position[:, j]
            known, there = (np.isfinite(log.time) & np.isfinite(x) for x in (told, position))
            if not known.any():
                continue
            instants = log.time - log.time[np.isfinite(log.time)][0]
            time, told = instants[known], told[known]
            commands[number] = time, told
            if there.any():
                lag = told - np.interp(time, instants[there], position[there])
                behind[number] = time, error_integral(time, lag)
                before = np.append(time[0] - _BEFORE, time)
                summed[number] = before, error_integral(before, np.append(told[0], told))
        later = tuple(log_number(log.name) for log in logs[1:])
        return cls(joint, commands, summed, behind, later)

    @cached_property
    def late(self) -> tuple[LoggedColumn, ...]:
        """c(t − δ) − c(t), rad or m; the first of them is zero."""

        def late(delay: float, log: int, time: Array) -> Array:
            return _at(self.told, log, time - delay) - _at(self.told, log, time)

        return self._delayed(late)

    @cached_property
    def rates(self) -> tuple[LoggedColumn, ...]:
        """dc/dt(t − δ), rad/s or m/s."""

        def rate(delay: float, log: int, time: Array) -> Array:
            late = _at(self.told, log, time - delay)
            return np.gradient(late, time) if len(time) > 1 else np.zeros(len(time))

        return self._delayed(rate)

    @cached_property
    def integrals(self) -> tuple[LoggedColumn, ...]:
        """∫(c(t − δ) − q) dt, rad·s or m·s; it begins at 0 with each log, up to `constants`."""

        def integral(delay: float, log: int, time: Array) -> Array:
            late = _at(self.summed, log, time - delay) - _at(self.summed, log, time)
            return _at(self.behind, log, time) + late

        return self._delayed(integral)

    @cached_property
    def constants(self) -> tuple[LoggedColumn, ...]:
        """Ones in each log but the first."""

        def is_log(number: int, log: int, time: Array) -> Array:
            return np.full(len(time), float(log == number))

        return tuple(LoggedColumn(self.joint, partial(is_log, number)) for number in self.later)

    @property
    def all(self) -> tuple[LoggedColumn, ...]:
        """All of them that are not zero."""
        return (*self.late[1:], *self.rates, *self.integrals, *self.constants)

    def _delayed(self, values: Callable[[float, int, Array], Array]) -> tuple[LoggedColumn, ...]:
        return tuple(LoggedColumn(self.joint, partial(values, delay)) for delay in _DELAYS)


def _at(series: Mapping[int, Series], log: int, time: Array) -> Array:
    return np.interp(time, *series[log]) if log in series else np.zeros(len(time))


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
_ROUNDS = 2  # of choosing how servos take commands, and of bodies and gains with that
_DELAYS = tuple(np.linspace(0.0, LONGEST_DELAY, 16).tolist())  # that are tried, s


def calibrate_efforts(
    model: RobotModel, logs: Sequence[JointLog], *, simulate: bool = True
) -> tuple[RobotModel, list[JointLog], list[str]]:
    """Return the model that makes efforts of signals, logs with efforts, and what was found.

    Gains that the model does not know are found by its inertias; see `effort_gains`. Logs have
    their joints in the model's order. Servos are those of simulated joints; where columns are only
    looked at, the linear fit alone will do, some three times as fast.

    Raises:
        LogError: Something else stands for the efforts of a joint in one log than in another or in
            the model, or there is nothing at all, or a servo is at its limit nearly all the time.
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
    model = replace(model, effort_signals=(*model.effort_signals, *found))
    return (
        model,
        [_known_efforts(model, log) for log in logs],
        [*notes, gain_words(model, found, logs)],
    )


def _limit_notes(model: RobotModel, asked: JointLog, given: JointLog) -> list[str]:
    """Return notes on efforts of a log that motors were `asked` for, beyond what they gave."""
    notes = []
    for at, joint in enumerate(asked.joints):
        signal = signal_of(model.effort_signals, joint)
        if signal is None or signal.kind != EFFORT:
            continue
        beyond = np.isfinite(asked.effort[:, at]) & (given.effort[:, at] != asked.effort[:, at])
        if beyond.any():
            notes.append(
                f"{asked.name}: in {100.0 * np.mean(beyond):.2g} % of the rows {joint} is asked "
                "for more than its motor gives, by the limit in the model; what it gives counts"
            )
    return notes


def _known_efforts(model: RobotModel, log: JointLog) -> JointLog:
    """Return the log with efforts at joints of whose signals the model knows what makes efforts."""
    signals = model.effort_signals
    summed = any(each.integral and kind_of(log, each.joint) == COMMAND for each in signals)
    known = in_efforts(log, signals, _needed(model, log) if summed else None)
    check_saturation(known)
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
    """Return what was found of signals, in words, and beside data sheets of motors."""
    words = []
    for signal in signals:
        slides = signal.joint in model.sliding_joints
        unit = when_sliding(signal.unit) if slides else signal.unit
        unknown = signal.deviation >= abs(signal.gain)
        value = "unknown," if unknown else f"{signal.gain:.3g}"
        words.append(f"{signal.joint} {value} ± {signal.deviation:.2g} {unit}")
        if (told := published_gain(logs, signal.joint, signal.kind)) is not None and not unknown:
            share, spread = signal.gain / told[0], signal.deviation / told[0]
            words[-1] += f" ({share:.2g} ± {spread:.1g} of what is published of {told[2]})"
    kinds = " and ".join(dict.fromkeys(f"{signal.kind}s" for signal in signals))
    return f"efforts are those of {kinds}, by gains from the model's inertias: {', '.join(words)}"


_LINEAR = WeakKeyDictionary[RobotModel, "tuple[tuple[JointLog, ...], _Calibration]"]()
"""Linear fits of logs whose columns were looked at, until the logs are compared with the model."""


def calibrated(
    model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str], *, simulate: bool = True
) -> tuple[EffortSignal, ...]:
    """Find what makes efforts of the signals of all joints whose efforts were not measured.

    `kinds` (nv,) are what stands for the efforts of each joint. Joints with servos are simulated,
    or the linear fit stays, which counts for a simulation of the same logs afterwards.

    Raises:
        LogError: A servo pushes away from where it is told to go.
    """
    of, linear = _LINEAR.pop(model, ((), None))
    if linear is None or of != tuple(logs):
        linear = _Calibration.of(model, logs, kinds)
    if simulate:
        return tuple(linear.by_motion().values())
    _LINEAR[model] = tuple(logs), linear
    choice, gains = linear.found
    return tuple(choice.signals(gains).values())


def _gain_priors(model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]) -> GainPriors:
    """Return what logs say of their efforts' gains, and data sheets of those of signals."""
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
    """Return what a data sheet says of a signal's gain, its deviation, and the motor's name."""
    for log in logs:
        motor = log.motors.get(joint)
        told = None if motor is None else motor.gain(kind)
        if motor is not None and told is not None:
            return (*told, motor.name)
    return None


def expected_servo(logs: Sequence[JointLog], joint: str, stiffness: float) -> Expected:
    """Return what data sheets say of a joint's servo, or else about which stiffness is usual."""
    found = {"stiffness": (stiffness, ALIKE)}
    motors = [log.motors[joint] for log in logs if joint in log.motors]
    for motor in motors[:1]:
        for name, told in (("stiffness", motor.gain(COMMAND)), ("armature", motor.armature)):
            if told is not None:
                found[name] = told[0], _log_deviation(*told[:2])
    return found


def published_limit(logs: Sequence[JointLog], joint: str) -> float:
    """Return the most effort that a joint's motor gives by its data sheet; infinite if unknown."""
    motors = [log.motors[joint] for log in logs if joint in log.motors]
    stall = motors[0].stall_torque if motors else None
    return np.inf if stall is None else stall[0]


def _log_deviation(value: float, deviation: float) -> float:
    """Return the deviation of the logarithm of a value; what is exact is known to a thousandth."""
    return max(float(np.sqrt(np.log1p((deviation / value) ** 2))), 1e-3)


def _by_body(model: RobotModel, phi: Array) -> dict[str, Array]:
    """Name -> inertial parameters (10,) of bodies (nb, 10) that are something."""
    return {body: own for body, own in zip(model.bodies, phi, strict=True) if own.any()}


def sharp_trajectories(
    logs: Sequence[JointLog], trajectories: Sequence[Trajectory]
) -> tuple[Trajectory, ...]:
    """Return logs, prepared as `trajectories` are, with motion as sharp as simulations need it."""
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in trajectories)
    bandwidth, motion = trajectories[0].bandwidths
    sharp = min(max(motion, _SHARP), highest)
    return tuple(prepare_logs(logs, bandwidth=bandwidth, motion_bandwidth=sharp))


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
        expected=expected_servo(logs, signal.joint, signal.gain if usual is None else usual),
        bodies=bodies,
        published=published_limit(logs, signal.joint),
    )


def signal_by_motion(signal: EffortSignal, fit: ServoFit) -> EffortSignal:
    """Return the signal of a servo with the numbers of a fit to its motion."""
    gain, rate, *_, delay, _, _, integral = fit.parameters.tolist()
    spread = fit.deviations
    return replace(
        signal,
        gain=gain,
        deviation=float(spread[0]),
        damping=rate,
        damping_deviation=float(spread[1]) if rate else 0.0,
        delay=delay,
        integral=integral,
        integral_deviation=float(spread[-1]),
        # A servo that damps the motion within its limit is at it for another error than this.
        limit=np.inf if fit.own else fit.limit,
    )


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
    """Return (nv,) what stands for the efforts of each joint."""
    found = []
    for joint in model.joints:
        kinds = {kind_of(log, joint): log.name for log in logs}
        if len(kinds) > 1:
            words = " and ".join(f"{kind} in {name!r}" for kind, name in kinds.items())
            raise LogError(
                f"What was measured of {joint}'s effort is {words}.",
                advice="Use logs of one kind together.",
                joint=joint,
            )
        kind = next(iter(kinds))
        signal = signal_of(model.effort_signals, joint)
        if signal is not None and kind not in (signal.kind, EFFORT):
            knows = f"what makes efforts of its {signal.kind}"
            if signal.kind == EFFORT:
                knows = "which efforts its motor gives of those that it is asked for"
            raise LogError(
                f"Log {kinds[kind]!r} has the {kind} of {joint}; the model knows {knows}.",
                advice="Start from the model file, or say what the column is by --kind.",
                joint=joint,
            )
        found.append(kind)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Calibration:
    """How servos take their commands, and what a linear fit says of all signals with that.

    Servos may be late, their damping may know the command's rate, and they may have an integral:
    all of a robot are alike in that.
    """

    model: RobotModel
    logs: Sequence[JointLog]
    # The logs with signals in the place of efforts, and what was made of these.
    samples: tuple[Sequence[JointLog], Sequence[Trajectory], Dataset]
    kinds: Sequence[str]  # (nv,) what stands for the efforts of each joint
    beside: tuple[Effect, ...]  # effects that are free
    commanded: Mapping[int, Commands]  # by the index of the joint
    held: CarriedColumn | None = None  # the column of known payloads' efforts, if there are some
    delay: int = 0  # which of `_DELAYS`
    rate: bool = False
    integral: bool = False
    # Rows by the joint, and how its servo takes commands: choices come up again and again.
    known: dict[tuple[int, ...], SignalRows] = field(default_factory=dict)

    @classmethod
    def of(cls, model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]) -> _Calibration:
        """Return the first choice, of servos that are not late and know no rates."""
        known = signals_as_efforts(logs, kinds)
        trajectories = prepare_logs(known)
        commanded = {
            j: Commands.of(logs, model.joints[j]) for j, k in enumerate(kinds) if k == COMMAND
        }
        usual = [kind for kind in catalogue() if kind.complexity == 0]
        free = [kind.shaped(joint)[0] for joint in model.single_joints for kind in usual]
        free += [effect for effect in effects_of(model) if effect.role is not Role.BODY]
        free = list(dict.fromkeys(free))
        held = None
        if any(log.payloads for log in logs):
            each = [(log_number(log.name), carried_phi(model, log.payloads)) for log in logs]
            held = CarriedColumn({n: _by_body(model, phi) for n, phi in each})
        columns: list[Effect] = [column for each in commanded.values() for column in each.all]
        columns += [] if held is None else [held]
        folds = validation_blocks(trajectories)
        dataset = reduce_logs(model, trajectories, folds, effects=(*free, *columns))
        samples = known, trajectories, dataset
        return cls(model, logs, samples, kinds, tuple(free), commanded, held)

    @cached_property
    def alike(self) -> list[str]:
        """(nv,) kinds of signals whose gains are alike."""
        pairs = zip(self.model.joints, self.kinds, strict=True)
        return [f"{kind} {joint in self.model.sliding_joints}" for joint, kind in pairs]

    def fit(self) -> SignalGains:
        """Return bodies and gains by this choice."""
        priors = _gain_priors(self.model, self.logs, self.kinds)
        rows = [self.joint(j) for j in range(len(self.kinds))]
        return signal_gains(rows, self.model, priors, self.alike)

    @cached_property
    def found(self) -> tuple[_Calibration, SignalGains]:
        """The likeliest choice with bodies and gains, which are found in turn."""
        choice, gains = self, self.fit()
        # What is wrong with a delay of 0 shows more in an error that an integral keeps small.
        looked = replace(gains, phi=self.model.total_phi) if self.integral else gains
        for _ in range(_ROUNDS if self.commanded else 0):
            choices = [
                replace(self, delay=delay, rate=rate)
                for rate in (False, True)
                for delay in range(len(_DELAYS))
            ]
            last, choice = choice, min(choices, key=partial(_Calibration.cost, gains=looked))
            if (choice.delay, choice.rate) == (last.delay, last.rate):
                break
            gains = looked = choice.fit()
        return choice, gains

    def by_motion(self) -> dict[int, EffortSignal]:
        """Return what makes efforts of signals, of servos by how their joints move."""
        (plain, gains), joints = self.found, tuple(self.commanded)
        if not joints:
            return plain.signals(gains)
        known, trajectories, _ = self.samples
        sharp = sharp_trajectories(known, trajectories)
        # Bodies are those of the model that is saved, not as the linear fit moves them.
        motions = motions_of(replace(self.model, effects=()), self.logs, sharp, joints)
        summed, other = replace(self, integral=True).found
        servos = dict[int, EffortSignal]()
        if summed.cost(other) + PENALTY * len(joints) < plain.cost(gains):
            servos = summed.moved(other, motions)
            if any(servo.integral for servo in servos.values()):
                plain, gains, motions = summed, other, {}
        servos |= plain.moved(gains, {j: own for j, own in motions.items() if j not in servos})
        linear = plain.signals(gains).items()
        found = {j: replace(signal, integral=0.0, integral_deviation=0.0) for j, signal in linear}
        return found | servos

    def moved(
        self, gains: SignalGains, motions: Mapping[int, JointMotions]
    ) -> dict[int, EffortSignal]:
        """Return servos of joints whose motion is predicted better for them."""
        signals, servos = self.signals(gains), dict[int, EffortSignal]()
        for j, own in motions.items():
            same = [signals[k].gain for k in self.commanded if self.alike[k] == self.alike[j]]
            fit = servo_by_motion(
                self.model,
                self.logs,
                own,
                signals[j],
                usual=float(np.median(same)),
                bodies=min(signals[j].uncertainty, float(gains.bodies[j])),
            )
            if fit is not None:
                servos[j] = signal_by_motion(signals[j], fit)
        return servos

    def cost(self, gains: SignalGains) -> float:
        """Return twice the negative log-likelihood with some bodies and gains."""
        phi, total = gains.phi.ravel(), 2.0 * _DELAYS[self.delay] / USUAL_DELAY
        for j in self.commanded:
            rows = self.joint(j)
            a = rows.least_squares_gain(phi)
            # Where an integral holds a joint up, so little is left of the error that its sign may
            # go.
            if self.integral and a < 0.0:
                return np.inf
            total += rows.cost(a, phi, gains.worth[j]) + PENALTY * self.rate
        return float(total)

    def joint(self, j: int) -> SignalRows:
        """Return the rows of a joint."""
        key = (j, self.delay, self.rate, self.integral)
        if key not in self.known:
            self.known[key] = self._rows(j)
        return self.known[key]

    def _rows(self, j: int) -> SignalRows:
        free, added = list(self.beside), None
        if j in self.commanded:
            own = self.commanded[j]
            added = own.late[self.delay] if self.delay else None
            free += [*own.constants, own.integrals[self.delay]] if self.integral else []
            free += [own.rates[self.delay]] if self.rate else []
        d = self.model.phi.size
        return SignalRows.of(self.samples[2], j, d, free, added=added, held=self.held)

    def signals(self, gains: SignalGains) -> dict[int, EffortSignal]:
        """Return what makes efforts of the signals of joints whose efforts are unknown, by index.

        Raises:
            LogError: A servo pushes away from where it is told to go.
        """
        unknown = {j: kind for j, kind in enumerate(self.kinds) if kind != EFFORT}
        return {j: self._signal(j, kind, gains) for j, kind in unknown.items()}

    def _signal(self, j: int, kind: str, gains: SignalGains) -> EffortSignal:
        joint, gain = self.model.joints[j], float(gains.gains[j])
        deviation = float(gains.deviations[j] * abs(gain))
        if kind != COMMAND:
            return EffortSignal(joint, kind, gain, deviation)
        if gain < 0.0:
            raise LogError(
                f"The servo of {joint} pushes away from its command, with {gain:.3g} ± "
                f"{deviation:.2g} N·m/rad.",
                advice="Has its command or its position the wrong sign, or is it of another joint?",
                joint=joint,
            )
        phi, worth = gains.phi.ravel(), float(gains.worth[j])
        shares, deviations = self.joint(j).free_parameters(1.0 / gain, phi, worth)
        found = {}
        for name, is_there, at in (
            ("damping", self.rate, -1),
            ("integral", self.integral, -1 - self.rate),
        ):
            if is_there and shares[at] < 0.0:
                found[name] = -gain * float(shares[at])
                found[f"{name}_deviation"] = gain * float(deviations[at])
        return EffortSignal(joint, kind, gain, deviation, delay=_DELAYS[self.delay], **found)
