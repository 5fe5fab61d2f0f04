"""What a rollout finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short, Shown

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Window(Short):
    """One simulated stretch of a log.

    Attributes:
        time: (K,) instants, s.
        measured: (K, nv) positions, rad or m.
        simulated: (K, nv) positions; NaN from where the simulation broke off.
    """

    log: str
    time: Array
    measured: Array
    simulated: Array

    @property
    def departure(self) -> Array:
        """(K, nv) simulated − measured position."""
        return self.simulated - self.measured


@dataclass(frozen=True)
class JointDeparture:
    """How far one joint departs from what was measured.

    Attributes:
        rms: RMS of simulated − measured position over all windows, rad or m.
        moved: RMS of what the joint moved since the start of its window, rad or m.
        worst: Log and start of the window in which it departs most, s.
    """

    joint: str
    rms: float
    moved: float
    worst: tuple[str, float]

    @property
    def relative(self) -> float:
        """RMS departure over RMS motion: 1 for a robot that stands still."""
        return self.rms / self.moved if self.moved > 0 else np.inf


@dataclass(frozen=True, eq=False)
class Rollout(Shown):
    """A model simulated under logged efforts or commands.

    Attributes:
        joints: Departures of every joint.
        horizon: Length of the windows, s.
        broken: Windows in which the simulation could not go on to the end, or left all reason.
        notes: What was done to the logs, noticed about the model, and assumed in the simulation.
        commands: Whether servos closed the loop under logged commands.
    """

    joints: tuple[JointDeparture, ...]
    windows: tuple[Window, ...]
    horizon: float
    broken: int
    notes: tuple[str, ...] = ()
    commands: bool = False

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        windows: Sequence[Window],
        horizon: float,
        notes: tuple[str, ...] = (),
    ) -> Rollout:
        """With the departures of joints that windows have.

        Args:
            horizon: Length of the windows, s.
            notes: What was done to the logs, noticed about the model, and assumed.
        """
        departures = [np.nan_to_num(w.departure, nan=np.inf) for w in windows]
        squares = np.array([np.mean(np.square(d), 0) for d in departures])
        moved = np.array([np.mean(np.square(w.measured - w.measured[0]), 0) for w in windows])
        joints = []
        for j, joint in enumerate(names):
            worst = windows[int(np.argmax(squares[:, j]))]
            joints.append(
                JointDeparture(
                    joint,
                    float(np.sqrt(squares[:, j].mean())),
                    float(np.sqrt(moved[:, j].mean())),
                    (worst.log, float(worst.time[0])),
                )
            )
        broken = sum(bool(np.isnan(w.simulated).any()) for w in windows)
        return cls(tuple(joints), tuple(windows), horizon, broken, notes)

    def part(self, chosen: Sequence[bool]) -> Rollout:
        """Some of the windows alone.

        Args:
            chosen: (W,) which.
        """
        windows = [w for w, taken in zip(self.windows, chosen, strict=True) if taken]
        names = [joint.joint for joint in self.joints]
        found = Rollout.of(names, windows, self.horizon, self.notes)
        return replace(found, commands=self.commands)

    @property
    def under(self) -> str:
        """What the model was simulated under."""
        return "commands" if self.commands else "efforts"

    @property
    def relative(self) -> float:
        """Root mean square over joints of departure over motion."""
        return float(np.sqrt(np.mean([joint.relative**2 for joint in self.joints])))
