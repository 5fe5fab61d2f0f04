"""What servos were told, as columns beside those of effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter
from geodrake.effects.robot_motion import RobotMotion, log_number
from geodrake.logs.motion import JointLog


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
class CommandColumn(JointEffect):
    """The command of a joint as it was some time before, less that of now; or its rate.

    [c(t − δ) − c(t)] or [dc/dt(t − δ)]. It is no effect of the robot, but a column of logs beside
    those of effects: what a servo makes of its command is linear in it.
    """

    command: Commands = field(default_factory=lambda: Commands({}))
    delay: float = 0.0
    is_rate: bool = False

    name = "command"
    parameters = (Parameter("share", "1"),)
    depends_on = frozenset({"time"})

    def columns(self, joint: JointMotion) -> tuple[Array]:
        """[1], where there are no instants."""
        return (np.ones_like(joint.v),)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """The column (N, 1) at the joint."""
        time = motion.time
        if time is None:
            return super().rows(motion)
        late = self.command.at(motion.log, time - self.delay)
        if self.is_rate:
            column = np.gradient(late, time) if len(time) > 1 else np.zeros(len(time))
        else:
            column = late - self.command.at(motion.log, time)
        return {self.joint: column[:, None]}
