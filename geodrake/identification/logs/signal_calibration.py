"""Logs without efforts: the gains of what was measured in their place, and the efforts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Role, catalogue
from geodrake.effects.base import Effect
from geodrake.effects.declarations import when_sliding
from geodrake.effects.robot_motion import log_number
from geodrake.errors import LogError
from geodrake.identification.logs.criteria import PENALTY
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.effort_gains import SignalGains, SignalRows, signal_gains
from geodrake.identification.logs.logged_columns import CarriedColumn, Commands, LoggedColumn
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.identification.logs.servo_fit import (
    LONGEST_DELAY,
    JointMotions,
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
from geodrake.model.signal_efforts import in_efforts, kind_of

Array = NDArray[np.float64]

_SHARP = 20.0  # Hz
_ROUNDS = 2  # of choosing how servos take commands, and of bodies and gains with that
_DELAYS = tuple(np.linspace(0.0, LONGEST_DELAY, 16).tolist())  # that are tried, s
_USUAL_DELAY = 0.01  # s, mean of how late servos are


def with_efforts(
    model: RobotModel, logs: Sequence[JointLog]
) -> tuple[RobotModel, list[JointLog], list[str]]:
    """Return the model that makes efforts of signals, logs with efforts, and what was found.

    Gains that the model does not know are found by its inertias; see `effort_gains`. Logs have
    their joints in the model's order.

    Raises:
        LogError: Something else stands for the efforts of a joint in one log than in another or in
            the model, or there is nothing at all, or a servo is at its limit nearly all the time.
    """
    if not logs:
        return model, [], []
    kinds = _kinds(model, logs)
    if all(kind == "effort" for kind in kinds) and not model.effort_signals:
        return model, list(logs), []
    asked, logs = logs, [_known_efforts(model, log) for log in logs]
    notes = [note for pair in zip(asked, logs, strict=True) for note in _limit_notes(model, *pair)]
    kinds = _kinds(model, logs)  # of joints that the model does not know
    if all(kind == "effort" for kind in kinds):
        return model, logs, notes
    found = calibrated(model, logs, kinds)
    model = replace(model, effort_signals=(*model.effort_signals, *found))
    return model, [_known_efforts(model, log) for log in logs], [*notes, gain_words(model, found)]


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


def gain_words(model: RobotModel, signals: Sequence[EffortSignal]) -> str:
    """Return what was found of signals, in words."""
    words = []
    for signal in signals:
        slides = signal.joint in model.sliding_joints
        unit = when_sliding(signal.unit) if slides else signal.unit
        words.append(f"{signal.joint} {signal.gain:.3g} ± {signal.deviation:.2g} {unit}")
    kinds = " and ".join(dict.fromkeys(f"{signal.kind}s" for signal in signals))
    return f"efforts are those of {kinds}, by gains from the model's inertias: {', '.join(words)}"


def calibrated(
    model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]
) -> tuple[EffortSignal, ...]:
    """Find what makes efforts of the signals of all joints whose efforts were not measured.

    Args:
        kinds: (nv,) what stands for the efforts of each joint.

    Raises:
        LogError: A servo pushes away from where it is told to go.
    """
    known = signals_as_efforts(logs, kinds)
    trajectories = prepare_logs(known)
    commanded = {
        j: _CommandColumns.of(logs, model.joints[j]) for j, k in enumerate(kinds) if k == COMMAND
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
    deviations = np.max([log.gain_deviations for log in logs], axis=0)
    prior = np.where([kind == EFFORT for kind in kinds], np.maximum(deviations, 1e-6), np.inf)
    alike = [f"{k} {j in model.sliding_joints}" for j, k in zip(model.joints, kinds, strict=True)]
    gains = partial(signal_gains, model=model, known=prior, kinds=alike)
    plain = _Calibration.of(_Choice(dataset, model, tuple(free), commanded, held), gains)
    if not commanded:
        return plain.signals(kinds)
    bandwidth = trajectories[0].bandwidths[0]
    sharp = prepare_logs(known, bandwidth=bandwidth, motion_bandwidth=_sharp(trajectories))

    def by_motion(found: _Calibration) -> tuple[EffortSignal, ...]:
        bodies = replace(model, phi=found.gains.phi, effects=())
        motions = motions_of(bodies, logs, sharp, tuple(commanded))
        places = {model.joints[j]: j for j in commanded}
        return tuple(
            s
            if (j := places.get(s.joint)) is None
            else _by_motion(motions[j], s, float(model.effort_limits[j]))
            for s in found.signals(kinds)
        )

    summed = _Calibration.of(replace(plain.first, integral=True), gains)
    if summed.cost + PENALTY * len(commanded) < plain.cost:
        found = by_motion(summed)
        if any(signal.integral for signal in found):
            return found
    return by_motion(plain)


def _by_body(model: RobotModel, phi: Array) -> dict[str, Array]:
    """Name -> inertial parameters (10,) of bodies (nb, 10) that are something."""
    return {body: own for body, own in zip(model.bodies, phi, strict=True) if own.any()}


def _sharp(trajectories: Sequence[Trajectory]) -> float:
    """Return the bandwidth of the motion that simulations are compared with, Hz."""
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in trajectories)
    return min(max(trajectories[0].bandwidths[1], _SHARP), highest)


def _by_motion(motions: JointMotions, signal: EffortSignal, limit: float) -> EffortSignal:
    """Return the servo of a joint by how it moves, if that is predicted better for it.

    An integral counts only where windows of the motion ask for it, and so does the limit of the
    joint's effort, N·m or N. `signal` is the servo by a linear fit.
    """
    fit = fit_servo(motions, signal, limit if limit > 0.0 else np.inf)
    if fit is None:
        return replace(signal, integral=0.0, integral_deviation=0.0)
    gain, rate, *_, delay, integral = fit.parameters.tolist()
    spread = fit.deviations
    return replace(
        signal,
        gain=gain,
        deviation=float(np.hypot(signal.uncertainty * gain, spread[0])),
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
class _CommandColumns:
    """Columns of the commands of one joint, for every delay that is tried."""

    late: tuple[LoggedColumn, ...]  # c(t − δ) − c(t)
    rates: tuple[LoggedColumn, ...]  # dc/dt(t − δ)
    integrals: tuple[LoggedColumn, ...]  # ∫(c(t − δ) − q) dt
    constants: tuple[LoggedColumn, ...]  # what integrals begin with in logs but the first one

    @classmethod
    def of(cls, logs: Sequence[JointLog], joint: str) -> _CommandColumns:
        """Return those of a joint."""
        commands = Commands.of(logs, joint)
        late, rates, integrals = (
            tuple(LoggedColumn(joint, partial(values, delay)) for delay in _DELAYS)
            for values in (commands.late, commands.rate, commands.integral)
        )
        constants = (
            LoggedColumn(joint, partial(_is_log, log_number(log.name))) for log in logs[1:]
        )
        return cls(late, rates, integrals, tuple(constants))

    @property
    def all(self) -> tuple[LoggedColumn, ...]:
        """All of them; the first of `late`, which is zero, left out."""
        return (*self.late[1:], *self.rates, *self.integrals, *self.constants)


def _is_log(number: int, log: int, time: Array) -> Array:
    """Return (N,) ones in one log, and zeros in all others."""
    return np.full(len(time), float(log == number))


@dataclass(frozen=True, eq=False)
class _Choice:
    """How servos take their commands: how late, whether damping knows its rate, and an integral.

    All servos of a robot are alike in that.
    """

    dataset: Dataset
    model: RobotModel
    beside: tuple[Effect, ...]  # effects that are free
    commanded: dict[int, _CommandColumns]  # by the index of the joint
    held: CarriedColumn | None = None  # the column of known payloads' efforts, if there are some
    delay: int = 0  # which of `_DELAYS`
    rate: bool = False
    integral: bool = False

    def at(self, gains: SignalGains) -> _Choice:
        """Return the likeliest choice with these bodies and gains."""
        choices = [
            replace(self, delay=delay, rate=rate)
            for rate in (False, True)
            for delay in range(len(_DELAYS))
        ]
        return min(choices, key=lambda choice: choice.cost(gains))

    def cost(self, gains: SignalGains) -> float:
        """Return twice the negative log-likelihood of this choice with some bodies and gains."""
        phi, total = gains.phi.ravel(), 2.0 * _DELAYS[self.delay] / _USUAL_DELAY
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
        free, added = list(self.beside), None
        if j in self.commanded:
            own = self.commanded[j]
            added = own.late[self.delay] if self.delay else None
            free += [*own.constants, own.integrals[self.delay]] if self.integral else []
            free += [own.rates[self.delay]] if self.rate else []
        d = self.model.phi.size
        return SignalRows.of(self.dataset, j, d, free, added=added, held=self.held)

    def rows(self) -> list[SignalRows]:
        """Return the rows of all joints."""
        return [self.joint(j) for j in range(len(self.dataset.joints))]


@dataclass(frozen=True, eq=False)
class _Calibration:
    """What a linear fit says of all signals."""

    first: _Choice  # how servos take their commands, before anything is known
    choice: _Choice  # and afterwards
    rows: Sequence[SignalRows]  # what logs say of each joint, so chosen
    gains: SignalGains  # of all joints

    @classmethod
    def of(cls, first: _Choice, fit: Callable[[Sequence[SignalRows]], SignalGains]) -> _Calibration:
        """Return bodies, gains, and how servos take their commands, which are found in turn."""
        choice, rows = first, first.rows()
        gains = fit(rows)
        if choice.integral:
            # What is wrong with a delay of 0 shows more in an error that an integral keeps small.
            gains = replace(gains, phi=choice.model.total_phi)
        for _ in range(_ROUNDS if choice.commanded else 0):
            choice = choice.at(gains)
            rows = choice.rows()
            gains = fit(rows)
        return cls(first, choice, rows, gains)

    @property
    def cost(self) -> float:
        """Return that of the choice; less for a likelier one."""
        return self.choice.cost(self.gains)

    def signals(self, kinds: Sequence[str]) -> tuple[EffortSignal, ...]:
        """Return what makes efforts of the signals (nv,) of joints whose efforts are unknown.

        Raises:
            LogError: A servo pushes away from where it is told to go.
        """
        return tuple(self._signal(j, kind) for j, kind in enumerate(kinds) if kind != EFFORT)

    def _signal(self, j: int, kind: str) -> EffortSignal:
        joint, choice = self.choice.model.joints[j], self.choice
        gain = float(self.gains.gains[j])
        deviation = float(self.gains.deviations[j] * abs(gain))
        if kind != COMMAND:
            return EffortSignal(joint, kind, gain, deviation)
        if gain < 0.0:
            raise LogError(
                f"The servo of {joint} pushes away from its command, with {gain:.3g} ± "
                f"{deviation:.2g} N·m/rad.",
                advice="Has its command or its position the wrong sign, or is it of another joint?",
                joint=joint,
            )
        phi, worth = self.gains.phi.ravel(), float(self.gains.worth[j])
        shares, deviations = self.rows[j].free_parameters(1.0 / gain, phi, worth)
        found = {}
        for name, is_there, at in (
            ("damping", choice.rate, -1),
            ("integral", choice.integral, -1 - choice.rate),
        ):
            if is_there and shares[at] < 0.0:
                found[name] = -gain * float(shares[at])
                found[f"{name}_deviation"] = gain * float(deviations[at])
        return EffortSignal(joint, kind, gain, deviation, delay=_DELAYS[choice.delay], **found)
