"""Columns of logs beside those of effects: what servos were told, and what robots carried."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter, RobotEffect
from geodrake.effects.robot_motion import RobotMotion, log_number
from geodrake.logs.motion import JointLog
from geodrake.model.signal_efforts import error_integral

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
    """The commands c of a joint in several logs, and how far q is behind them, both integrated.

    Series of a log are by its number. In a log without commands everything is 0.
    """

    told: Mapping[int, Series]  # c, rad or m
    summed: Mapping[int, Series]  # ∫c dt, rad·s or m·s; before a log begins c is as it is there
    behind: Mapping[int, Series]  # ∫(c − q) dt, rad·s or m·s

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
        return cls(commands, summed, behind)

    def late(self, delay: float, log: int, time: Array) -> Array:
        """Return (N,) c(t − δ) − c(t), rad or m."""
        return _at(self.told, log, time - delay) - _at(self.told, log, time)

    def rate(self, delay: float, log: int, time: Array) -> Array:
        """Return (N,) dc/dt(t − δ), rad/s or m/s."""
        late = _at(self.told, log, time - delay)
        return np.gradient(late, time) if len(time) > 1 else np.zeros(len(time))

    def integral(self, delay: float, log: int, time: Array) -> Array:
        """(N,) ∫(c(t − δ) − q) dt, rad·s or m·s; it begins at 0 with each log, up to a constant."""
        late = _at(self.summed, log, time - delay) - _at(self.summed, log, time)
        return _at(self.behind, log, time) + late


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
