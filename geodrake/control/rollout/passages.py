"""Passages of logs in which the robot moves, which are simulated, and what acts on it in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicHermiteSpline

from geodrake.control.systems.position_servo import PositionServo
from geodrake.effects.sensors import delayed_by
from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.contact_rows import contacts_in, row_scales
from geodrake.identification.logs.reduce import peak_speeds
from geodrake.inertia import Array
from geodrake.logs.motion import MEMORY, JointLog, Motion, Trajectory
from geodrake.logs.smoothing import Segment, Stretch
from geodrake.logs.temperatures import Temperatures
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import (
    NO_SERVO,
    ServoError,
    ServoGains,
    command_delays,
    servo_gains,
    servos_of,
)
from geodrake.model.signal_efforts import integral_effort, late_commands
from geodrake.robot.transmission import times

FASTEST = 1e6
"""Peak speeds of the log, beyond which no robot is simulated any more."""

_LEAST_SPEED = 1e-3  # rad/s or m/s, that counts as a peak
_SIGN_WIDTH = 5e-3  # share of a joint's peak speed below which dry friction fades
_MOVING = 0.05  # share of the peak speeds that the mean speed of a passage must have
_APART = 1e-9  # s, between instants of a trajectory
_INDEPENDENT = 1e-9  # share of the largest, that counts as another direction of forces at contacts
_COMMANDS = ("commanded_position", "commanded_velocity")


@dataclass(frozen=True, eq=False)
class Passage:
    """Some seconds of a log in which the robot moves."""

    log: str
    began: float  # the log's first time stamp, s
    # The samples, with the efforts that acted there: a model's delays are taken out.
    segment: Segment
    stretch: Stretch  # the part of the log without gaps that the passage is from
    start: int  # number of its first sample in the stretch

    @property
    def time(self) -> Array:
        """(K,) instants since the log began, s."""
        return self.segment.time - self.began

    @property
    def logged(self) -> Array:
        """(K, nv) positions as they were logged, not smoothed."""
        first = self.stretch.first + self.start
        return self.stretch.piece[first : first + len(self.segment)].position

    def motion(self, model: RobotModel, most: int | None = None) -> Motion:
        """Return the measured motion of a model, with what was before as far as effects look back.

        It ends after the first few samples if no more are asked for.
        """
        first, before = self.segment[:most], self.stretch[max(0, self.start - MEMORY) : self.start]
        return Motion(
            model.positions(first.position),
            first.velocity,
            first.acceleration,
            self.time[:most],
            model.positions(before.position),
        )


Span = tuple[str, float, float]


def chosen_passages(
    case: Case, horizon: float, most: int, within: Sequence[Span] | None = None
) -> list[Passage]:
    """Choose passages of a length, spread evenly over all in which the robot of a case moves.

    Args:
        within: Logs, and first and last instants of theirs, s, outside of which none is; anywhere
            if None.
    """
    peak = peak_speeds(case.trajectories)
    found = [
        Passage(trajectory.name, trajectory.began, segment, stretch, start)
        for trajectory in case.trajectories
        for stretch in trajectory.segments
        for start, segment in _moving(stretch, horizon, peak, case.model.delays)
        if within is None
        or any(
            name == trajectory.name and first <= segment.time[0] and segment.time[-1] <= last
            for name, first, last in within
        )
    ]
    if not found:
        raise LogError(
            f"No log has {horizon:g} s of motion without a gap.",
            advice="Use a shorter horizon, or a longer log.",
        )
    count = min(most, len(found))
    chosen = np.unique(np.linspace(0, len(found) - 1, count).round().astype(int))
    logs = {trajectory.name: trajectory for trajectory in case.trajectories}
    return [_on_ground(case.model, logs[found[k].log], found[k]) for k in chosen.tolist()]


def _on_ground(model: RobotModel, trajectory: Trajectory, passage: Passage) -> Passage:
    """Return a passage in whose efforts are forces at contacts that nobody measured.

    They are those with which the model comes nearest to the measured motion, instant by instant.
    """
    if trajectory.contacts is None:
        return passage
    model, segment = carrying(model, trajectory.payloads), passage.segment
    J, flags = contacts_in(model, trajectory.contacts, segment)
    scales = row_scales(model, trajectory)
    J = (J * flags[:, :, None, None]).reshape(len(J), -1, len(scales)) / scales
    left = (model.effort(passage.motion(model)) - segment.effort) / scales
    inverse = np.asarray(np.linalg.pinv(np.swapaxes(J, 1, 2), rcond=_INDEPENDENT), float)
    forces = times(inverse, left)
    ground = scales * times(np.swapaxes(J, 1, 2), forces)
    return replace(passage, segment=replace(segment, effort=segment.effort + ground))


def _moving(
    stretch: Stretch, seconds: float, peak: Array, delays: Array
) -> Iterator[tuple[int, Segment]]:
    """Yield the passages of a stretch, one after another, with the numbers of first samples."""
    count = round(seconds / stretch.period) + 1
    if count < 2:
        raise ArgumentError(
            f"A horizon of {seconds:g} s is shorter than the sampling period of "
            f"{stretch.period:.4g} s.",
            advice="Use a longer one.",
        )
    ahead = round(float(np.abs(delays).max()) / stretch.period) + 1
    for start in range(ahead, len(stretch) - count - ahead, count):
        near = stretch[start - ahead : start + count + ahead]
        inner = near[ahead : ahead + count]
        speed = np.abs(inner.velocity) / np.maximum(peak, 1e-300)
        if speed.mean(0).max() > _MOVING:
            effort = delayed_by(-delays, near.effort, stretch.period)
            yield start, replace(inner, effort=effort[ahead:][:count])


class LoggedRobot:
    """The robot of a log: its model, and the efforts that act on it.

    In place of the log's efforts may be servos at joints that follow its commands. Efforts are
    straight lines between the log's samples, and commands cubics (`late_commands`).

    Args:
        model: The model, with what it carries in the log.
        commands: Whether servos close the loop.
    """

    def __init__(
        self,
        model: RobotModel,
        log: JointLog,
        temperatures: Temperatures | None,
        *,
        commands: bool,
    ) -> None:
        self.model, self.temperatures = model, temperatures
        count = len(model.joints)
        self._log, self._servos, self._delays = log, servos_of(model), command_delays(model)
        self._follows = commands
        self._told = told_joints(model, log) if commands else np.zeros(count, bool)
        self._servoed = bool(self._told.any())
        pairs = zip(servo_gains(model) if self._servoed else NO_SERVO, NO_SERVO, strict=True)
        self.gains = ServoGains(*(np.where(self._told, own, none) for own, none in pairs))

    def of(self, model: RobotModel) -> LoggedRobot:
        """Return the robot with another model."""
        return LoggedRobot(model, self._log, self.temperatures, commands=self._follows)

    def add(self, builder: DiagramBuilder, state: OutputPort) -> OutputPort:
        """Add the systems that make the efforts (n), N·m or N, and return their output.

        Args:
            state: Positions and velocities (2n) as they are measured, in the model's order.
        """
        zero = PiecewisePolynomial(np.zeros(len(self._told)))
        names = ("feedforward", *(_COMMANDS if self._servoed else ()))
        self._sources = {name: builder.AddSystem(TrajectorySource(zero)) for name in names}
        if not self._servoed:
            return self._sources["feedforward"].get_output_port()
        servo = PositionServo(**self.gains._asdict())
        self._servo = builder.AddSystem(servo)
        builder.Connect(state, servo.GetInputPort("estimated_state"))
        for name, source in self._sources.items():
            builder.Connect(source.get_output_port(), servo.GetInputPort(name))
        return servo.get_output_port()

    def begin(self, passage: Passage) -> None:
        """Have a passage act, in the time since its log began."""
        lines = PiecewisePolynomial.FirstOrderHold(passage.time, self._beside(passage).T)
        curves = [lines]
        if self._servoed:
            time = self._bends(passage)
            command, rate = self._commands(passage, time)
            cubic = PiecewisePolynomial.CubicHermite(time, command.T, rate.T)
            curves += [cubic, cubic.MakeDerivative()]
        for source, curve in zip(self._sources.values(), curves, strict=True):
            source.UpdateTrajectory(curve)

    def remember(self, passage: Passage, root: Context) -> None:
        """Set integrals to what they have grown to in the log, by its efforts."""
        if self.gains.ki.any():
            context = self._servo.GetMyMutableContextFromRoot(root)
            context.SetContinuousState(self.begun(passage))

    def along(self, passage: Passage) -> tuple[Array, Array]:
        """Return what acts in a passage whose motors move as they were measured.

        Returns:
            Efforts (K, n), N·m or N, without the integrals and limits of servos, and commanded less
            measured positions (K, n), rad or m, 0 without a servo.
        """
        command, known, beside = self.told(passage, passage.time)
        behind = np.where(self._told, command - passage.segment.position, 0.0)
        rate = known - passage.segment.velocity
        error = ServoError(behind, rate, np.zeros_like(behind), beside)
        return self.gains.unlimited(error), behind

    def told(self, passage: Passage, time: Array) -> Array:
        """Return what acts (3, K, n) at instants (K,).

        That is commands, what servos know of their rates, and efforts beside servos.
        """
        beside = self._beside(passage)
        efforts = [np.interp(time, passage.time, column) for column in beside.T]
        command, rate = self._commands(passage, time)
        return np.array([command, self.gains.rate_share * rate, np.transpose(efforts)])

    def begun(self, passage: Passage) -> Array:
        """Return the integrals (n,) when a passage begins, rad·s or m·s."""
        ki, instants = self.gains.ki, self._log.time - passage.began
        begun, known = np.zeros(len(ki)), np.isfinite(instants)
        for j, effort in self._integrals.items():
            begun[j] = np.interp(passage.time[0], instants[known], effort[known]) / ki[j]
        return begun

    @cached_property
    def _integrals(self) -> dict[int, Array]:
        """Joint -> (N,) what the integral of its servo gives along the log, N·m or N."""
        servos = {j: self._servos[j] for j in np.flatnonzero(self.gains.ki).tolist()}
        return {j: integral_effort(self._log, j, servo) for j, servo in servos.items() if servo}

    def _beside(self, passage: Passage) -> Array:
        """Return the efforts (K, n) of joints without a servo."""
        return np.where(self._told, 0.0, np.asarray(passage.segment.effort))

    def _bends(self, passage: Passage) -> Array:
        """Return the instants (K,) at which late commands bend, and both ends of the passage."""
        first, last = passage.time[0], passage.time[-1]
        bends = [np.array([first, last])]
        for curve in self._curves.values():
            late = curve.x - passage.began
            bends.append(late[(late > first + _APART) & (late < last - _APART)])
        time = np.unique(np.concatenate(bends))
        return time[np.append(np.diff(time) > _APART, True)]

    def _commands(self, passage: Passage, time: Array) -> tuple[Array, Array]:
        """Return late commands and their rates (K, n) at instants (K,)."""
        commands, rates = np.zeros((2, len(time), len(self._told)))
        for j, curve in self._curves.items():
            since = np.clip(passage.began + time, curve.x[0], curve.x[-1])
            commands[:, j] = curve(since)
            rates[:, j] = np.where(since == passage.began + time, curve(since, 1), 0.0)
        return commands, rates

    @cached_property
    def _curves(self) -> dict[int, CubicHermiteSpline]:
        """Joint that is commanded -> the curve of its command; constant beyond its ends."""
        delays = {j: self._delays[j] for j in np.flatnonzero(self._told).tolist()}
        late = {j: late_commands(self._log, j, delay) for j, delay in delays.items()}
        return {j: CubicHermiteSpline(*rows) for j, rows in late.items()}


def told_joints(model: RobotModel, log: JointLog) -> NDArray[np.bool_]:
    """Return (n,) whether each joint has a servo, and a command in a log."""
    if log.command is None:
        return np.zeros(len(model.joints), bool)
    known = (np.isfinite(log.command) & np.isfinite(log.time)[:, None]).sum(axis=0) > 1
    return np.array([servo is not None for servo in servos_of(model)]) & known


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of the rollouts of a case."""

    case: Case
    commands: bool  # whether servos close the loop

    @cached_property
    def robots(self) -> dict[str, LoggedRobot]:
        """The robot of each log, by its name."""
        logs = {log.name: log for log in self.case.options.logs}
        return {
            each.name: LoggedRobot(
                carrying(self.case.model, each.payloads),
                logs[each.name],
                each.temperatures,
                commands=self.commands,
            )
            for each in self.case.trajectories
        }

    @cached_property
    def fastest(self) -> Array:
        """(nv,) peak speeds of the measured motion, rad/s or m/s."""
        return np.maximum(peak_speeds(self.case.trajectories), _LEAST_SPEED)

    @cached_property
    def sign_width(self) -> Array:
        """(nv,) speeds below which dry friction fades, rad/s or m/s."""
        return self.case.model.sign_widths(_SIGN_WIDTH * self.fastest)
