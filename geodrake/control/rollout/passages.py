"""Passages of logs in which the robot moves, and the efforts or commands that act in them."""

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
"""Speed, relative to the log's peak speed, at which a simulation is stopped."""

_LEAST_SPEED = 1e-3  # rad/s or m/s, lower bound of peak speeds
_SIGN_WIDTH = 5e-3  # speed below which dry friction fades, relative to a joint's peak speed
_MOVING = 0.05  # minimum mean speed of a passage, relative to the peak speed
_SPACING = 1e-9  # s, minimum interval between knots of a trajectory
_RANK_TOLERANCE = 1e-9  # relative singular value of independent contact forces
_COMMANDS = ("commanded_position", "commanded_velocity")


@dataclass(frozen=True, eq=False)
class Passage:
    """Part of a log in which the robot moves."""

    log: str
    began: float  # the log's first time stamp, s
    segment: Segment  # samples, with efforts advanced by the model's delays
    stretch: Stretch  # gap-free part of the log that contains the passage
    start: int  # index of its first sample in the stretch

    @property
    def time(self) -> Array:
        """(K,) time since the log began, s."""
        return self.segment.time - self.began

    @property
    def logged(self) -> Array:
        """(K, nv) logged positions, not smoothed."""
        first = self.stretch.first + self.start
        return self.stretch.piece[first : first + len(self.segment)].position

    def motion(self, model: RobotModel, most: int | None = None) -> Motion:
        """Return `most` measured samples, or all, with the preceding positions effects need."""
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
    """Return at most `most` passages of a duration, spread evenly over those with motion.

    Args:
        horizon: Duration of a passage, s.
        within: Spans (log, first time, last time), s, that must contain the passages, if any.
    """
    peak = peak_speeds(case.trajectories)
    passages = [
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
    if not passages:
        raise LogError(
            f"No log has {horizon:g} s of motion without a gap.",
            advice="Use a shorter horizon, or a longer log.",
        )
    count = min(most, len(passages))
    chosen = np.unique(np.linspace(0, len(passages) - 1, count).round().astype(int))
    logs = {trajectory.name: trajectory for trajectory in case.trajectories}
    chosen_list = [passages[k] for k in chosen.tolist()]
    return [_with_contacts(case.model, logs[passage.log], passage) for passage in chosen_list]


def _with_contacts(model: RobotModel, trajectory: Trajectory, passage: Passage) -> Passage:
    """Add the efforts of unmeasured contact forces to a passage.

    The forces are those that minimize the model's residual at each sample.
    """
    if trajectory.contacts is None:
        return passage
    model, segment = carrying(model, trajectory.payloads), passage.segment
    J, flags = contacts_in(model, trajectory.contacts, segment)
    scales = row_scales(model, trajectory)
    J = (J * flags[:, :, None, None]).reshape(len(J), -1, len(scales)) / scales
    residual = (model.effort(passage.motion(model)) - segment.effort) / scales
    inverse = np.asarray(np.linalg.pinv(np.swapaxes(J, 1, 2), rcond=_RANK_TOLERANCE), float)
    forces = times(inverse, residual)
    contact_effort = scales * times(np.swapaxes(J, 1, 2), forces)
    return replace(passage, segment=replace(segment, effort=segment.effort + contact_effort))


def _moving(
    stretch: Stretch, seconds: float, peak: Array, delays: Array
) -> Iterator[tuple[int, Segment]]:
    """Yield the consecutive passages of a stretch with motion, and indices of first samples."""
    count = round(seconds / stretch.period) + 1
    if count < 2:
        raise ArgumentError(
            f"A horizon of {seconds:g} s is shorter than the sampling period of "
            f"{stretch.period:.4g} s.",
            advice="Use a longer one.",
        )
    margin = round(float(np.abs(delays).max()) / stretch.period) + 1
    for start in range(margin, len(stretch) - count - margin, count):
        padded = stretch[start - margin : start + count + margin]
        segment = padded[margin : margin + count]
        speed = np.abs(segment.velocity) / np.maximum(peak, 1e-300)
        if speed.mean(0).max() > _MOVING:
            effort = delayed_by(-delays, padded.effort, stretch.period)
            yield start, replace(segment, effort=effort[margin:][:count])


class LoggedRobot:
    """The robot of a log: its model, and the logged efforts or servos that drive it.

    Servos at joints may follow the log's commands. Efforts are interpolated linearly between
    samples, commands by cubics (`late_commands`).

    Args:
        model: The model, with the payloads of the log.
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
        self._uses_commands = commands
        self._commanded = commanded_joints(model, log) if commands else np.zeros(count, bool)
        self._has_servos = bool(self._commanded.any())
        pairs = zip(servo_gains(model) if self._has_servos else NO_SERVO, NO_SERVO, strict=True)
        self.gains = ServoGains(*(np.where(self._commanded, gain, zero) for gain, zero in pairs))

    def of(self, model: RobotModel) -> LoggedRobot:
        """Return the robot with another model."""
        return LoggedRobot(model, self._log, self.temperatures, commands=self._uses_commands)

    def add(self, builder: DiagramBuilder, state: OutputPort) -> OutputPort:
        """Add the systems that generate the efforts (n), N·m or N, and return their output.

        Args:
            state: Measured positions and velocities (2n), in the model's order.
        """
        zero = PiecewisePolynomial(np.zeros(len(self._commanded)))
        names = ("feedforward", *(_COMMANDS if self._has_servos else ()))
        self._sources = {name: builder.AddSystem(TrajectorySource(zero)) for name in names}
        if not self._has_servos:
            return self._sources["feedforward"].get_output_port()
        servo = PositionServo(**self.gains._asdict())
        self._servo = builder.AddSystem(servo)
        builder.Connect(state, servo.GetInputPort("estimated_state"))
        for name, source in self._sources.items():
            builder.Connect(source.get_output_port(), servo.GetInputPort(name))
        return servo.get_output_port()

    def set_inputs(self, passage: Passage) -> None:
        """Set efforts and commands to those of a passage, over the time since its log began."""
        effort = self._feedforward(passage)
        curves = [PiecewisePolynomial.FirstOrderHold(passage.time, effort.T)]
        if self._has_servos:
            time = self._knots(passage)
            command, rate = self._commands(passage, time)
            cubic = PiecewisePolynomial.CubicHermite(time, command.T, rate.T)
            curves += [cubic, cubic.MakeDerivative()]
        for source, curve in zip(self._sources.values(), curves, strict=True):
            source.UpdateTrajectory(curve)

    def set_integrals(self, passage: Passage, root: Context) -> None:
        """Set the servos' integrals to their values at the start of a passage."""
        if self.gains.ki.any():
            context = self._servo.GetMyMutableContextFromRoot(root)
            context.SetContinuousState(self.initial_integrals(passage))

    def measured_inputs(self, passage: Passage) -> tuple[Array, Array]:
        """Return the inputs of a passage whose motors move as measured.

        Returns:
            Efforts (K, n), N·m or N, without the integrals and limits of servos; and commanded
            minus measured positions (K, n), rad or m, 0 without a servo.
        """
        command, rate, feedforward = self.inputs(passage, passage.time)
        error = np.where(self._commanded, command - passage.segment.position, 0.0)
        rate_error = rate - passage.segment.velocity
        servo_error = ServoError(error, rate_error, np.zeros_like(error), feedforward)
        return self.gains.unlimited(servo_error), error

    def inputs(self, passage: Passage, time: Array) -> Array:
        """Return the inputs (3, K, n) at times (K,).

        They are commands, rates of commands times the servos' `rate_share`, and efforts of joints
        without a servo.
        """
        feedforward = self._feedforward(passage)
        efforts = [np.interp(time, passage.time, column) for column in feedforward.T]
        command, rate = self._commands(passage, time)
        return np.array([command, self.gains.rate_share * rate, np.transpose(efforts)])

    def initial_integrals(self, passage: Passage) -> Array:
        """Return the servos' integrals (n,) at the start of a passage, rad·s or m·s."""
        ki, time = self.gains.ki, self._log.time - passage.began
        integrals, valid = np.zeros(len(ki)), np.isfinite(time)
        for j, effort in self._integral_efforts.items():
            integrals[j] = np.interp(passage.time[0], time[valid], effort[valid]) / ki[j]
        return integrals

    @cached_property
    def _integral_efforts(self) -> dict[int, Array]:
        """Joint -> (N,) effort of its servo's integral along the log, N·m or N."""
        servos = {j: self._servos[j] for j in np.flatnonzero(self.gains.ki).tolist()}
        return {j: integral_effort(self._log, j, servo) for j, servo in servos.items() if servo}

    def _feedforward(self, passage: Passage) -> Array:
        """Return the efforts (K, n) of joints without a servo."""
        return np.where(self._commanded, 0.0, np.asarray(passage.segment.effort))

    def _knots(self, passage: Passage) -> Array:
        """Return the knots (K,) of the delayed commands, and both ends of the passage."""
        first, last = passage.time[0], passage.time[-1]
        knots = [np.array([first, last])]
        for curve in self._curves.values():
            time = curve.x - passage.began
            knots.append(time[(time > first + _SPACING) & (time < last - _SPACING)])
        time = np.unique(np.concatenate(knots))
        return time[np.append(np.diff(time) > _SPACING, True)]

    def _commands(self, passage: Passage, time: Array) -> tuple[Array, Array]:
        """Return delayed commands and their rates (K, n) at times (K,)."""
        commands, rates = np.zeros((2, len(time), len(self._commanded)))
        for j, curve in self._curves.items():
            clipped = np.clip(passage.began + time, curve.x[0], curve.x[-1])
            commands[:, j] = curve(clipped)
            rates[:, j] = np.where(clipped == passage.began + time, curve(clipped, 1), 0.0)
        return commands, rates

    @cached_property
    def _curves(self) -> dict[int, CubicHermiteSpline]:
        """Commanded joint -> its delayed command, constant beyond the ends."""
        delays = {j: self._delays[j] for j in np.flatnonzero(self._commanded).tolist()}
        delayed = {j: late_commands(self._log, j, delay) for j, delay in delays.items()}
        return {j: CubicHermiteSpline(*rows) for j, rows in delayed.items()}


def commanded_joints(model: RobotModel, log: JointLog) -> NDArray[np.bool_]:
    """Return (n,) whether each joint has a servo, and a command in a log."""
    if log.command is None:
        return np.zeros(len(model.joints), bool)
    has_command = (np.isfinite(log.command) & np.isfinite(log.time)[:, None]).sum(axis=0) > 1
    return np.array([servo is not None for servo in servos_of(model)]) & has_command


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
            trajectory.name: LoggedRobot(
                carrying(self.case.model, trajectory.payloads),
                logs[trajectory.name],
                trajectory.temperatures,
                commands=self.commands,
            )
            for trajectory in self.case.trajectories
        }

    @cached_property
    def peak_speed(self) -> Array:
        """(nv,) peak speeds of the measured motion, rad/s or m/s."""
        return np.maximum(peak_speeds(self.case.trajectories), _LEAST_SPEED)

    @cached_property
    def sign_width(self) -> Array:
        """(nv,) speeds below which dry friction fades, rad/s or m/s."""
        return self.case.model.sign_widths(_SIGN_WIDTH * self.peak_speed)
