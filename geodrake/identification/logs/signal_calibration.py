"""Logs without efforts: the gains of what was measured in their place, and the efforts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Role
from geodrake.effects.base import Effect
from geodrake.effects.shape import when_sliding
from geodrake.errors import LogError
from geodrake.identification.logs.command_columns import CommandColumn, Commands
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
from geodrake.logs.motion import JointLog, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.model.effort_signal import COMMAND, EffortSignal, signal_of
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
            the model, or there is nothing at all.
    """
    if not logs:
        return model, [], []
    kinds = _kinds(model, logs)
    if all(kind == "effort" for kind in kinds) and not model.effort_signals:
        return model, list(logs), []
    logs = [in_efforts(log, model.effort_signals) for log in logs]
    kinds = _kinds(model, logs)  # of joints that the model does not know
    if all(kind == "effort" for kind in kinds):
        return model, logs, []
    found = calibrated(model, logs, kinds)
    model = replace(model, effort_signals=(*model.effort_signals, *found))
    return model, [in_efforts(log, found) for log in logs], [gain_words(model, found)]


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
    choice = _Choice(dataset, model.phi.size, beside, told, held)
    alike = [f"{k} {j in model.sliding_joints}" for j, k in zip(model.joints, kinds, strict=True)]
    rows = choice.rows()
    gains = signal_gains(rows, model, prior, alike)
    for _ in range(_ROUNDS if told else 0):
        choice = choice.at(gains)
        rows = choice.rows()
        gains = signal_gains(rows, model, prior, alike)
    found = [
        choice.signal(model.joints[j], kind, j, rows[j], gains)
        for j, kind in enumerate(kinds)
        if kind != "effort"
    ]
    if not told:
        return tuple(found)
    bodies = replace(model, phi=gains.phi, effects=())
    bandwidth = trajectories[0].bandwidths[0]
    sharp = prepare_logs(known, bandwidth=bandwidth, motion_bandwidth=_sharp(trajectories))
    motions = motions_of(bodies, logs, sharp, tuple(told))
    by_joint = {model.joints[j]: motions[j] for j in told}
    return tuple(_by_motion(by_joint[s.joint], s) if s.joint in by_joint else s for s in found)


def _sharp(trajectories: Sequence[Trajectory]) -> float:
    """Bandwidth of the motion that simulations are compared with, Hz."""
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in trajectories)
    return min(max(trajectories[0].bandwidths[1], _SHARP), highest)


def _by_motion(motions: JointMotions, signal: EffortSignal) -> EffortSignal:
    """The servo of a joint by how it moves, if that is predicted better for it."""
    fit = fit_servo(motions, signal)
    if fit is None:
        return signal
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
        if signal is not None and kind not in (signal.kind, "effort"):
            raise LogError(
                f"Log {kinds[kind]!r} has the {kind} of {joint}; the model knows what makes "
                f"efforts of its {signal.kind}.",
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
    """

    late: tuple[CommandColumn, ...]
    rates: tuple[CommandColumn, ...]

    @property
    def columns(self) -> tuple[CommandColumn, ...]:
        """All of them; the first of `late`, which is zero, left out."""
        return (*self.late[1:], *self.rates)


def _commands(
    model: RobotModel, logs: Sequence[JointLog], kinds: Sequence[str]
) -> dict[int, _Told]:
    """Columns of commands, by joint."""
    delays = np.linspace(0.0, LONGEST_DELAY, _DELAYS).tolist()
    found = {}
    for j, kind in enumerate(kinds):
        if kind == COMMAND:
            joint, command = model.joints[j], Commands.of(logs, model.joints[j])
            found[j] = _Told(
                tuple(CommandColumn(joint, command, delay) for delay in delays),
                tuple(CommandColumn(joint, command, delay, is_rate=True) for delay in delays),
            )
    return found


@dataclass(frozen=True, eq=False)
class _Choice:
    """How servos take their commands: how late, and whether their damping knows its rate.

    All servos of a robot are alike in that.

    Attributes:
        dataset: The logs.
        d: Number of inertial parameters.
        beside: Effects that are free.
        told: Columns of commands, by joint.
        held: The column of known payloads' efforts, if there are some.
        delay: Index of the delay.
        rate: Whether the rate counts.
    """

    dataset: Dataset
    d: int
    beside: tuple[Effect, ...]
    told: dict[int, _Told]
    held: CarriedColumn | None = None
    delay: int = 0
    rate: bool = False

    def at(self, gains: SignalGains) -> _Choice:
        """The likeliest choice with these bodies and gains."""
        phi = gains.phi.ravel()
        costs = {}
        for rate in (False, True):
            for delay in range(_DELAYS):
                trial = replace(self, delay=delay, rate=rate)
                seconds = LONGEST_DELAY * delay / (_DELAYS - 1)
                costs[delay, rate] = 2.0 * seconds / _USUAL_DELAY + sum(
                    trial.joint(j).least_cost(phi, gains.worth[j]) + PENALTY * rate
                    for j in self.told
                )
        delay, rate = min(costs, key=costs.__getitem__)
        return replace(self, delay=delay, rate=rate)

    def joint(self, j: int) -> SignalRows:
        """The rows of a joint."""
        free, added = list[Effect](self.beside), None
        if j in self.told:
            added = self.told[j].late[self.delay] if self.delay else None
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
        damping = spread = 0.0
        if self.rate:
            shares, deviations = rows.free_parameters(1.0 / gain, gains.phi.ravel(), gains.worth[j])
            damping, spread = -gain * shares[-1], abs(gain) * deviations[-1]
        late = self.told[j].late[self.delay].delay
        return EffortSignal(
            joint, kind, gain, deviation, max(damping, 0.0), spread if damping > 0 else 0.0, late
        )
