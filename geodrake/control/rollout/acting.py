"""What acts on a simulated robot: the efforts of a log, or its commands through servos."""

from __future__ import annotations

import abc
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from geodrake.control.motors import ServoError, ServoGains, servo_effort
from geodrake.control.rollout.passages import Passage
from geodrake.control.systems.position_servo import PositionServo
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import command_delays, servo_gains, servos_of
from geodrake.model.signal_efforts import integral_effort

Array = NDArray[np.float64]

_APART = 1e-9  # s, between instants of a trajectory
_INPUTS = ("commanded_position", "commanded_velocity", "feedforward")


@dataclass(frozen=True, eq=False)
class EffortAlong:
    """What acts along a measured motion, and what servos add where motors are elsewhere.

    Attributes:
        effort: (K, n) efforts, N·m or N, without the integrals and limits of servos.
        behind: (K, n) commanded less measured position, rad or m; 0 without a servo.
        gains: Those of the servos (n,); 0 without one.
        begun: (n,) their integrals at first, rad·s or m·s.
    """

    effort: Array
    behind: Array
    gains: ServoGains
    begun: Array


class Acting(abc.ABC):
    """What acts on the joints of a model while a passage of a log is simulated."""

    @abc.abstractmethod
    def add(self, builder: DiagramBuilder, state: OutputPort) -> OutputPort:
        """Adds the systems that make the efforts.

        Args:
            builder: The builder of the simulation.
            state: Positions and velocities (2n) as they are measured, in the model's order.

        Returns:
            The efforts (n), N·m or N.
        """

    @abc.abstractmethod
    def begin(self, passage: Passage) -> None:
        """Has a passage act, in the time since its log began."""

    @abc.abstractmethod
    def along(self, passage: Passage) -> EffortAlong:
        """What acts in a passage whose motors move as they were measured."""

    def remember(self, passage: Passage, root: Context) -> None:
        """Sets what acts to the state in which a passage begins; most have none."""
        del passage, root


class LoggedEffort(Acting):
    """The efforts of a log."""

    def __init__(self, count: int) -> None:
        self._source = TrajectorySource(PiecewisePolynomial(np.zeros(count)))

    def add(self, builder: DiagramBuilder, state: OutputPort) -> OutputPort:
        """See `Acting`."""
        del state
        self._source = builder.AddSystem(self._source)
        return self._source.get_output_port()

    def begin(self, passage: Passage) -> None:
        """See `Acting`."""
        effort = np.asarray(passage.segment.effort)
        self._source.UpdateTrajectory(_lines(passage.time, effort))

    def along(self, passage: Passage) -> EffortAlong:
        """See `Acting`."""
        effort = np.asarray(passage.segment.effort)
        behind, none = np.zeros_like(effort), np.zeros(effort.shape[1])
        return EffortAlong(effort, behind, ServoGains(none, none, none, none + np.inf, none), none)


class ServoedCommand(Acting):
    """The commands of a log, through the servos of a model; at other joints the log's efforts.

    Commands and their rates are straight lines between the log's samples.

    Raises:
        ModelError: The model has no servos, or joints of several degrees of freedom.
    """

    def __init__(self, model: RobotModel, log: JointLog) -> None:
        *gains, limit = servo_gains(model)
        self._log, self._delays = log, command_delays(model)
        self._servos, self._told = servos_of(model), told_joints(model, log)
        kp, kd, self._ki = (np.where(self._told, gain, 0.0) for gain in gains)
        limits = np.where(self._told, limit, np.inf)
        self._gains = ServoGains(kp, kd, self._ki, limits, np.zeros(len(kp)))

    def add(self, builder: DiagramBuilder, state: OutputPort) -> OutputPort:
        """See `Acting`."""
        gains = self._gains
        servo = PositionServo(gains.kp, kd=gains.kd, ki=gains.ki, limit=gains.limit)
        self._servo = builder.AddSystem(servo)
        builder.Connect(state, self._servo.GetInputPort("estimated_state"))
        zero = PiecewisePolynomial(np.zeros(len(self._ki)))
        self._sources = [builder.AddSystem(TrajectorySource(zero)) for _ in _INPUTS]
        for name, source in zip(_INPUTS, self._sources, strict=True):
            builder.Connect(source.get_output_port(), self._servo.GetInputPort(name))
        return self._servo.get_output_port()

    def begin(self, passage: Passage) -> None:
        """See `Acting`."""
        for source, course in zip(self._sources, self._courses(passage), strict=True):
            source.UpdateTrajectory(course)

    def along(self, passage: Passage) -> EffortAlong:
        """See `Acting`."""
        segment, beside = passage.segment, self._beside(passage)
        command, rate = self._commands(passage, passage.time)
        behind = np.where(self._told, command - segment.position, 0.0)
        error = ServoError(behind, rate - segment.velocity, np.zeros_like(behind), beside)
        unlimited = replace(self._gains, limit=np.full(len(self._ki), np.inf))
        effort = servo_effort(unlimited, error)
        return EffortAlong(effort, behind, self._gains, self._begun(passage))

    def remember(self, passage: Passage, root: Context) -> None:
        """Integrals are what they have grown to in the log, by its efforts."""
        if not self._ki.any():
            return
        context = self._servo.GetMyMutableContextFromRoot(root)
        state = context.get_mutable_continuous_state_vector()
        state.SetFromVector(self._begun(passage))

    def _begun(self, passage: Passage) -> Array:
        """(n,) integrals when a passage begins, rad·s or m·s; 0 of servos without one."""
        begun, instants = np.zeros(len(self._ki)), self._log.time - passage.began
        known = np.isfinite(instants)
        for j, effort in self._integrals.items():
            begun[j] = np.interp(passage.time[0], instants[known], effort[known]) / self._ki[j]
        return begun

    @cached_property
    def _integrals(self) -> dict[int, Array]:
        """Joint -> (N,) what the integral of its servo gives along the log, N·m or N."""
        servos = {j: self._servos[j] for j in np.flatnonzero(self._ki).tolist()}
        return {j: integral_effort(self._log, j, servo) for j, servo in servos.items() if servo}

    def _courses(self, passage: Passage) -> tuple[PiecewisePolynomial, ...]:
        """Late commands, their rates, and efforts beside the servos, in the order of inputs."""
        time = self._bends(passage)
        command, rate = self._commands(passage, time)
        beside = self._beside(passage)
        return _lines(time, command), _lines(time, rate), _lines(passage.time, beside)

    def _beside(self, passage: Passage) -> Array:
        """(K, n) efforts of joints without a servo."""
        return np.where(self._told, 0.0, np.asarray(passage.segment.effort))

    def _bends(self, passage: Passage) -> Array:
        """(K,) instants of a passage at which late commands bend, with its first and its last."""
        first, last = passage.time[0], passage.time[-1]
        bends = [np.array([first, last])]
        for late, _, _ in self._late(passage).values():
            bends.append(late[(late > first + _APART) & (late < last - _APART)])
        time = np.unique(np.concatenate(bends))
        return time[np.append(np.diff(time) > _APART, True)]

    def _commands(self, passage: Passage, time: Array) -> tuple[Array, Array]:
        """Late commands and their rates (K, n) at instants (K,) of a passage."""
        commands, rates = np.zeros((2, len(time), len(self._told)))
        for j, (late, column, rate) in self._late(passage).items():
            commands[:, j], rates[:, j] = np.interp(time, late, column), np.interp(time, late, rate)
        return commands, rates

    def _late(self, passage: Passage) -> dict[int, tuple[Array, Array, Array]]:
        """Of each joint that is told: instants when commands act, commands, and their rates."""
        whole, command, found = self._log.time - passage.began, self._log.command, {}
        for j in np.flatnonzero(self._told).tolist():
            column = np.empty(0) if command is None else command[:, j]
            known = np.isfinite(column) & np.isfinite(whole)
            late = whole[known] + self._delays[j]
            rate = np.gradient(column[known], late) if len(late) > 1 else np.zeros(len(late))
            found[j] = late, column[known], rate
        return found


def acting_in(model: RobotModel, log: JointLog, *, commands: bool) -> Acting:
    """What acts in a log.

    Args:
        commands: Whether servos follow the commands of the log, where it has any.
    """
    if commands and told_joints(model, log).any():
        return ServoedCommand(model, log)
    return LoggedEffort(len(model.joints))


def told_joints(model: RobotModel, log: JointLog) -> NDArray[np.bool_]:
    """(n,) whether each joint has a servo, and a command in a log."""
    if log.command is None:
        return np.zeros(len(model.joints), bool)
    known = (np.isfinite(log.command) & np.isfinite(log.time)[:, None]).any(axis=0)
    return np.array([servo is not None for servo in servos_of(model)]) & known


def picked(builder: DiagramBuilder, port: OutputPort, places: NDArray[np.intp]) -> OutputPort:
    """Some elements of an output.

    Args:
        places: Which elements, in which order.
    """
    if np.array_equal(places, np.arange(port.size())):
        return port
    gain = builder.AddSystem(MatrixGain(np.eye(port.size())[places]))
    builder.Connect(port, gain.get_input_port())
    return gain.get_output_port()


def _lines(time: Array, values: Array) -> PiecewisePolynomial:
    """Straight lines through values (K, n) at instants (K,)."""
    return PiecewisePolynomial.FirstOrderHold(time, values.T)
