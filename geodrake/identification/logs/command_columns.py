"""What servos were told, as columns beside those of effects."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter
from geodrake.effects.robot_motion import RobotMotion, log_number
from geodrake.logs.motion import JointLog
from geodrake.model.servo_integrals import error_integral

_BEFORE = 1.0  # s before a log, for which commands were as at its beginning


@dataclass(frozen=True, eq=False)
class Commands:
    """The commands of a joint in several logs.

    Attributes:
        series: Number of a log -> instants since it began (N,), s, and commands (N,), rad or m.
    """

    series: Mapping[int, tuple[Array, Array]]

    @classmethod
    def of(cls, logs: Sequence[JointLog], joint: str) -> Commands:
        """The commands of a joint.

        Args:
            logs: Logs, some with commands.
            joint: The joint.
        """
        series = {}
        for log in logs:
            if log.command is None or joint not in log.joints:
                continue
            column = log.command[:, log.joints.index(joint)]
            known = np.isfinite(column) & np.isfinite(log.time)
            if known.any():
                began = log.time[np.isfinite(log.time)][0]
                series[log_number(log.name)] = (log.time[known] - began, column[known])
        return cls(series)

    def at(self, log: int, time: Array) -> Array:
        """(N,) the command of a log at some instants; 0 in a log without.

        Args:
            log: Number of the log.
            time: (N,) instants since it began, s.
        """
        if log not in self.series:
            return np.zeros(len(time))
        return np.interp(time, *self.series[log])


@dataclass(frozen=True)
class LoggedColumn(JointEffect):
    """A column of logs beside those of effects: no effect of the robot."""

    depends_on = frozenset({"time"})

    @abstractmethod
    def column(self, log: int, time: Array) -> Array:
        """(N,) the column in a log.

        Args:
            log: Number of the log.
            time: (N,) instants since it began, s.
        """

    def columns(self, joint: JointMotion) -> tuple[Array]:
        """[1], where there are no instants."""
        return (np.ones_like(joint.v),)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """The column (N, 1) at the joint."""
        if motion.time is None:
            return super().rows(motion)
        return {self.joint: self.column(motion.log, motion.time)[:, None]}


@dataclass(frozen=True)
class CommandColumn(LoggedColumn):
    """The command of a joint as it was some time before, less that of now; or its rate.

    [c(t − δ) − c(t)] or [dc/dt(t − δ)]. What a servo makes of its command is linear in it.
    """

    command: Commands = field(default_factory=lambda: Commands({}))
    delay: float = 0.0
    is_rate: bool = False

    name = "command"
    parameters = (Parameter("share", "1"),)

    def column(self, log: int, time: Array) -> Array:
        """(N,) that difference, rad or m; or that rate, rad/s or m/s."""
        late = self.command.at(log, time - self.delay)
        if not self.is_rate:
            return late - self.command.at(log, time)
        return np.gradient(late, time) if len(time) > 1 else np.zeros(len(time))


@dataclass(frozen=True, eq=False)
class Integrals:
    """What a joint of several logs was behind its command by, and the command, both integrated.

    Attributes:
        error: Number of a log -> instants (N,) since it began, s, and integrals (N,), rad·s or m·s.
        command: The same of commands; before a log begins the command is as it is there.
    """

    error: Mapping[int, tuple[Array, Array]]
    command: Mapping[int, tuple[Array, Array]]

    @classmethod
    def of(cls, logs: Sequence[JointLog], joint: str) -> Integrals:
        """Those of a joint.

        Args:
            logs: Logs, some with commands.
            joint: The joint.
        """
        errors, commands = {}, {}
        for number, (time, told) in Commands.of(logs, joint).series.items():
            log = next(each for each in logs if log_number(each.name) == number)
            began = log.time[np.isfinite(log.time)][0]
            position = log.position[:, log.joints.index(joint)]
            known = np.isfinite(position) & np.isfinite(log.time)
            if not known.any():
                continue
            behind = told - np.interp(time, log.time[known] - began, position[known])
            errors[number] = time, error_integral(time, behind)
            before = np.append(time[0] - _BEFORE, time)
            summed = error_integral(before, np.append(told[0], told))
            commands[number] = before, summed
        return cls(errors, commands)


@dataclass(frozen=True)
class IntegralColumn(LoggedColumn):
    """The integral of what a joint is behind a late command, ∫(c(t − δ) − q) dt.

    It begins at 0 with each log, up to a constant.
    """

    integrals: Integrals = field(default_factory=lambda: Integrals({}, {}))
    delay: float = 0.0

    name = "command_integral"
    parameters = (Parameter("share", "1/s"),)

    def column(self, log: int, time: Array) -> Array:
        """(N,) the integral, rad·s or m·s; 0 in a log without commands."""
        if log not in self.integrals.error:
            return np.zeros(len(time))
        series = self.integrals.command[log]
        late = np.interp(time - self.delay, *series) - np.interp(time, *series)
        return np.interp(time, *self.integrals.error[log]) + late


@dataclass(frozen=True)
class LogConstant(LoggedColumn):
    """1 in one log and 0 in all others: what an integral has come to when a log begins."""

    log: int = 0

    name = "log_constant"
    parameters = (Parameter("constant", "rad"),)

    def column(self, log: int, time: Array) -> Array:
        """(N,) ones or zeros."""
        return np.full(len(time), float(log == self.log))
