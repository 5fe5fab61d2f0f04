"""Logs without efforts: the gains of what was measured in their place, and the efforts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Role
from geodrake.effects.base import Effect
from geodrake.effects.robot_motion import log_number
from geodrake.effects.shape import when_sliding
from geodrake.errors import LogError
from geodrake.identification.logs.command_columns import (
    CommandColumn,
    Commands,
    IntegralColumn,
    Integrals,
    LogConstant,
)
from geodrake.identification.logs.criteria import PENALTY
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.effort_gains import (
    SignalGains,
    SignalRows,
    effects_beside_gains,
    signal_gains,
)
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.payload_column import CarriedBodies, CarriedColumn
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.identification.logs.servo_fit import (
    LONGEST_DELAY,
    JointMotions,
    fit_servo,
    motions_of,
)
from geodrake.logs.filtering import HIGHEST_BANDWIDTH
from geodrake.logs.folds import validation_blocks
from geodrake.logs.learnable import check_saturation
from geodrake.logs.motion import JointLog, Motion, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.model.carried_payloads import carrying
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal, signal_of
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import in_efforts, kind_of

Array = NDArray[np.float64]

_SHARP = 20.0  # Hz
_ROUNDS = 2  # of choosing how servos take commands, and of bodies and gains with that
_DELAYS = 16  # that are tried
_USUAL_DELAY = 0.01  # s, mean of how late servos are


def with_efforts(
    model: RobotModel, logs: Sequence[JointLog]
) -> tuple[RobotModel, list[JointLog], list[str]]:
    """Logs with efforts at all joints, and the model that knows what makes efforts of its signals.

    Gains that the model does not know are found by its inertias; see `effort_gains`.

    Args:
        model: The model.
        logs: Logs, joints in the model's order.

    Returns:
        Model, logs, and what was found in words.

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
    """Notes on efforts that motors were asked for and that are beyond their limits.

    Args:
        model: The model, which knows the limits.
        asked: A log of it.
        given: The same with what motors give.
    """
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
    """The log with efforts at joints of whose signals the model knows what makes efforts.

    Raises:
        LogError: A servo is at its limit nearly all the time.
    """
    signals = model.effort_signals
    summed = any(each.integral and kind_of(log, each.joint) == COMMAND for each in signals)
    known = in_efforts(log, signals, _needed(model, log) if summed else None)
    check_saturation(known)
    return known


def _needed(model: RobotModel, log: JointLog) -> Array:
    """(N, n) efforts, N·m or N, that a model needs for positions of a log, noise and all.

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
    """What was found of signals, in words.

    Args:
        model: The model.
        signals: The signals.
    """
    words = []
    for signal in signals:
        slides = signal.joint in model.sliding_joints
        unit = when_sliding(signal.unit) if slides else signal.unit
        words.append(f"{signal.joint} {signal.gain:.3g} ± {signal.deviation:.2g} {unit}")
    kinds = " and ".join(dict.fromkeys(f"{signal.kind}s" for signal in signals))
    return f"efforts are those of {kinds}, by gains from the model's inertias: {', '.join(words)}"


def calibrated(
    model: RobotModel,
    logs: Sequence[JointLog],
    kinds: Sequence[str],
) -> tuple[EffortSignal, ...]:
    """What makes efforts of the signals of all joints whose efforts were not measured.

    Args:
        model: The model.
        logs: Logs, joints in the model's order.
        kinds: (nv,) what stands for the efforts of each joint.

    Raises:
        LogError: A servo pushes away from where it is told to go.
    """
    known = signals_as_efforts(logs, kinds)
    trajectories = prepare_logs(known)
    told = _commands(model, logs, kinds)
    own = [effect for effect in effects_of(model) if effect.role is not Role.BODY]
    beside = tuple(dict.fromkeys((*effects_beside_gains(model), *own)))
    carried = any(log.payloads for log in logs)
    held = CarriedColumn(CarriedBodies.of(model, logs)) if carried else None
    columns: list[Effect] = [column for each in told.values() for column in each.columns]
    columns += [] if held is None else [held]
    folds = validation_blocks(trajectories)
    dataset = reduce_logs(model, trajectories, folds, effects=(*beside, *columns))
    deviations = np.max([log.gain_deviations for log in logs], axis=0)
    prior = np.where([kind == "effort" for kind in kinds], np.maximum(deviations, 1e-6), np.inf)
    plain = _Choice(dataset, model.phi.size, beside, told, held)
    alike = [f"{k} {j in model.sliding_joints}" for j, k in zip(model.joints, kinds, strict=True)]
    settle = partial(_settled, model=model, prior=prior, alike=alike)
    if not told:
        return settle(plain).signals(model, kinds)
    bandwidth = trajectories[0].bandwidths[0]
    sharp = prepare_logs(known, bandwidth=bandwidth, motion_bandwidth=_sharp(trajectories))

    def by_motion(found: _Settled) -> tuple[EffortSignal, ...]:
        signals = found.signals(model, kinds)
        bodies = replace(model, phi=found.gains.phi, effects=())
        motions = motions_of(bodies, logs, sharp, tuple(told))
        places = {model.joints[j]: j for j in told}
        return tuple(
            s
            if (j := places.get(s.joint)) is None
            else _by_motion(motions[j], s, float(model.effort_limits[j]))
            for s in signals
        )

    without, summed = settle(plain), settle(replace(plain, integral=True))
    if summed.cost + PENALTY * len(told) < without.cost:
        found = by_motion(summed)
        if any(signal.integral for signal in found):
            return found
    return by_motion(without)


@dataclass(frozen=True, eq=False)
class _Settled:
    """What a linear fit says of all signals.

    Attributes:
        choice: How servos take their commands.
        rows: What logs say of each joint, so chosen.
        gains: Gains of all joints.
    """

    choice: _Choice
    rows: Sequence[SignalRows]
    gains: SignalGains

    @property
    def cost(self) -> float:
        """That of the choice; less for a likelier one."""
        return self.choice.cost(self.gains)

    def signals(self, model: RobotModel, kinds: Sequence[str]) -> tuple[EffortSignal, ...]:
        """What makes efforts of the signals of joints whose efforts were not measured.

        Args:
            model: The model.
            kinds: (nv,) what stands for the efforts of each joint.

        Raises:
            LogError: A servo pushes away from where it is told to go.
        """
        return tuple(
            self.choice.signal(model.joints[j], kind, j, self.rows[j], self.gains)
            for j, kind in enumerate(kinds)
            if kind != "effort"
        )


def _settled(choice: _Choice, *, model: RobotModel, prior: Array, alike: Sequence[str]) -> _Settled:
    """Bodies, gains, and how servos take their commands, in turn.

    Args:
        choice: The choice to begin with.
        model: The model.
        prior: (nv,) as for `signal_gains`.
        alike: (nv,) which signals are alike.
    """
    rows = choice.rows()
    gains = signal_gains(rows, model, prior, alike)
    if choice.integral:
        # What is wrong with a delay of 0 shows more in an error that an integral keeps small.
        gains = replace(gains, phi=model.total_phi)
    for _ in range(_ROUNDS if choice.told else 0):
        choice = choice.at(gains)
        rows = choice.rows()
        gains = signal_gains(rows, model, prior, alike)
    return _Settled(choice, rows, gains)


def _sharp(trajectories: Sequence[Trajectory]) -> float:
    """Bandwidth of the motion that simulations are compared with, Hz."""
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in trajectories)
    return min(max(trajectories[0].bandwidths[1], _SHARP), highest)


def _by_motion(motions: JointMotions, signal: EffortSignal, limit: float) -> EffortSignal:
    """The servo of a joint by how it moves, if that is predicted better for it.

    An integral counts only where windows of the motion ask for it, and so does the limit of the
    joint's effort.

    Args:
        motions: The joint.
        signal: The servo by a linear fit.
        limit: Largest effort of the joint, N·m or N.
    """
    fit = fit_servo(motions, signal, limit if limit > 0.0 else np.inf)
    if fit is None:
        return replace(signal, integral=0.0, integral_deviation=0.0)
    share = np.hypot(signal.uncertainty, fit.deviations[0] / fit.parameters[0])
    gain, rate, *_, delay = fit.parameters.tolist()
    spread = fit.deviations[1] if rate else 0.0
    return replace(
        signal,
        gain=gain,
        deviation=float(share * gain),
        damping=rate,
        damping_deviation=float(spread),
        delay=delay,
        integral=fit.integral,
        integral_deviation=fit.integral_deviation,
        # A servo that damps the motion within its limit is at it for another error than this.
        limit=np.inf if fit.own else fit.limit,
    )


def signals_as_efforts(logs: Sequence[JointLog], kinds: Sequence[str]) -> list[JointLog]:
    """Logs with signals in the place of efforts: of servos, how far the command is from there.

    What known payloads need is not taken off a signal of unknown gain: they are left out.

    Args:
        logs: Logs, joints in the model's order.
        kinds: (nv,) what stands for the efforts of each joint.
    """
    found = []
    for log in logs:
        effort = log.effort.copy()
        for j, kind in enumerate(kinds):
            if kind == COMMAND and log.command is not None:
                effort[:, j] = log.command[:, j] - log.position[:, j]
        found.append(replace(log, effort=effort, effort_kinds={}, payloads=()))
    return found


def _kinds(model: RobotModel, logs: Sequence[JointLog]) -> tuple[str, ...]:
    """(nv,) what stands for the efforts of each joint.

    Raises:
        LogError: Logs or model disagree.
    """
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
class _Told:
    """Columns of the commands of one joint, for every delay that is tried.

    Attributes:
        late: Columns c(t − δ) − c(t).
        rates: Columns dc/dt(t − δ).
        integrals: Columns ∫(c(t − δ) − q) dt.
        constants: What integrals begin with in logs, of all but the first one.
    """

    late: tuple[CommandColumn, ...]
    rates: tuple[CommandColumn, ...]
    integrals: tuple[IntegralColumn, ...]
    constants: tuple[LogConstant, ...]

    @property
    def columns(self) -> tuple[Effect, ...]:
        """All of them; the first of `late`, which is zero, left out."""
        return (*self.late[1:], *self.rates, *self.integrals, *self.constants)


def _commands(
    model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]
) -> dict[int, _Told]:
    """Columns of commands, by joint."""
    delays = np.linspace(0.0, LONGEST_DELAY, _DELAYS).tolist()
    found = {}
    for j, kind in enumerate(kinds):
        if kind == COMMAND:
            joint, command = model.joints[j], Commands.of(logs, model.joints[j])
            integrals = Integrals.of(logs, joint)
            found[j] = _Told(
                tuple(CommandColumn(joint, command, delay) for delay in delays),
                tuple(CommandColumn(joint, command, delay, is_rate=True) for delay in delays),
                tuple(IntegralColumn(joint, integrals, delay) for delay in delays),
                tuple(LogConstant(joint, log_number(log.name)) for log in logs[1:]),
            )
    return found


@dataclass(frozen=True, eq=False)
class _Choice:
    """How servos take their commands: how late, whether damping knows its rate, and an integral.

    All servos of a robot are alike in that.

    Attributes:
        dataset: The logs.
        d: Number of inertial parameters.
        beside: Effects that are free.
        told: Columns of commands, by joint.
        held: The column of known payloads' efforts, if there are some.
        delay: Index of the delay.
        rate: Whether the rate counts.
        integral: Whether they have an integral.
    """

    dataset: Dataset
    d: int
    beside: tuple[Effect, ...]
    told: dict[int, _Told]
    held: CarriedColumn | None = None
    delay: int = 0
    rate: bool = False
    integral: bool = False

    def at(self, gains: SignalGains) -> _Choice:
        """The likeliest choice with these bodies and gains."""
        choices = [
            replace(self, delay=delay, rate=rate)
            for rate in (False, True)
            for delay in range(_DELAYS)
        ]
        return min(choices, key=lambda choice: choice.cost(gains))

    def cost(self, gains: SignalGains) -> float:
        """Twice the negative log-likelihood of this choice with some bodies and gains."""
        seconds, phi = LONGEST_DELAY * self.delay / (_DELAYS - 1), gains.phi.ravel()
        rows = {j: self.joint(j) for j in self.told}
        # Where an integral holds a joint up, so little is left of the error that its sign may go.
        if self.integral and any(each.least_squares_gain(phi) < 0.0 for each in rows.values()):
            return np.inf
        return 2.0 * seconds / _USUAL_DELAY + sum(
            each.least_cost(phi, gains.worth[j]) + PENALTY * self.rate for j, each in rows.items()
        )

    def joint(self, j: int) -> SignalRows:
        """The rows of a joint."""
        free, added = list[Effect](self.beside), None
        if j in self.told:
            added = self.told[j].late[self.delay] if self.delay else None
            free += self.told[j].constants if self.integral else ()
            free += [self.told[j].integrals[self.delay]] if self.integral else []
            free += [self.told[j].rates[self.delay]] if self.rate else []
        return SignalRows.of(self.dataset, j, self.d, free, added=added, held=self.held)

    def rows(self) -> list[SignalRows]:
        """The rows of all joints."""
        return [self.joint(j) for j in range(len(self.dataset.joints))]

    def signal(
        self, joint: str, kind: str, j: int, rows: SignalRows, gains: SignalGains
    ) -> EffortSignal:
        """What makes efforts of the signal of a joint."""
        gain, deviation = float(gains.gains[j]), float(gains.deviations[j] * abs(gains.gains[j]))
        if kind != COMMAND:
            return EffortSignal(joint, kind, gain, deviation)
        if gain < 0.0:
            raise LogError(
                f"The servo of {joint} pushes away from its command, with {gain:.3g} ± "
                f"{deviation:.2g} N·m/rad.",
                advice="Has its command or its position the wrong sign, or is it of another joint?",
                joint=joint,
            )
        shares, deviations = rows.free_parameters(1.0 / gain, gains.phi.ravel(), gains.worth[j])
        found = [(0.0, 0.0), (0.0, 0.0)]
        for k, at in enumerate((-1, -1 - self.rate)):
            if (self.rate, self.integral)[k] and shares[at] < 0.0:
                found[k] = -gain * float(shares[at]), gain * float(deviations[at])
        (damping, spread), (integral, integral_spread) = found
        return EffortSignal(
            joint,
            kind,
            gain,
            deviation,
            damping,
            spread,
            self.told[j].late[self.delay].delay,
            integral=integral,
            integral_deviation=integral_spread,
        )
