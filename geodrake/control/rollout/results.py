"""What a rollout, and a fit of rollouts, finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.boundary.showing import Short, Shown
from geodrake.identification.logs.criteria import TIE
from geodrake.inertia import Array
from geodrake.model.effort_signal import COMMAND, SERVO
from geodrake.model.robot_model import RobotModel

_AT_REST = 1e-9  # rad or m: rounding of a smoothed position

BROKEN = 1e3
"""By so much a simulation departs that broke off, rad or m."""


@dataclass(frozen=True, eq=False)
class Window(Short):
    """One simulated stretch of a log."""

    log: str
    time: Array  # (K,) instants, s
    measured: Array  # (K, nv) positions, rad or m
    simulated: Array  # (K, nv) positions; NaN from where the simulation broke off

    @property
    def departure(self) -> Array:
        """(K, nv) simulated − measured position."""
        return self.simulated - self.measured


@dataclass(frozen=True)
class JointDeparture:
    """How far one joint departs from what was measured."""

    joint: str
    rms: float  # RMS of simulated − measured position over all windows, rad or m
    moved: float  # RMS of the joint's motion since the start of its window, rad or m
    worst: tuple[str, float]  # log and start of the window in which it departs most, s

    @property
    def relative(self) -> float:
        """RMS departure over RMS motion: 1 for a simulated joint that stands; NaN if it rests."""
        return self.rms / self.moved if self.moved > _AT_REST else np.nan


@dataclass(frozen=True, eq=False)
class Rollout(Shown):
    """A model simulated under logged efforts or commands."""

    joints: tuple[JointDeparture, ...]
    windows: tuple[Window, ...]
    horizon: float  # length of the windows, s
    broken: int  # windows in which the simulation could not go on to the end, or left all reason
    # What was done to the logs, noticed about the model, and assumed in the simulation.
    notes: tuple[str, ...] = ()
    commands: bool = False  # whether servos closed the loop

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        windows: Sequence[Window],
        horizon: float,
        notes: tuple[str, ...] = (),
        commands: bool = False,
    ) -> Rollout:
        """Return a rollout with the departures that the windows of the named joints have."""
        departures = [np.nan_to_num(w.departure, nan=np.inf) for w in windows]
        squares = np.array([np.mean(np.square(d), 0) for d in departures])
        moved = np.array([np.mean(np.square(w.measured - w.measured[0]), 0) for w in windows])
        rms, moves = np.sqrt(squares.mean(0)).tolist(), np.sqrt(moved.mean(0)).tolist()
        worst = [windows[k] for k in squares.argmax(0)]
        joints = tuple(
            JointDeparture(name, departs, moves, (most.log, float(most.time[0])))
            for name, departs, moves, most in zip(names, rms, moves, worst, strict=True)
        )
        broken = sum(bool(np.isnan(w.simulated).any()) for w in windows)
        return cls(joints, tuple(windows), horizon, broken, notes, commands)

    def part(self, chosen: Sequence[bool]) -> Rollout:
        """Return the rollout of some of the W windows alone."""
        windows = [w for w, taken in zip(self.windows, chosen, strict=True) if taken]
        names = [joint.joint for joint in self.joints]
        return Rollout.of(names, windows, self.horizon, self.notes, self.commands)

    @property
    def under(self) -> str:
        """What the model was simulated under."""
        return "commands" if self.commands else "efforts"

    @property
    def relative(self) -> float:
        """Root mean square of departure over motion, over joints that move."""
        shares = np.array([joint.relative for joint in self.joints])
        moving = shares[~np.isnan(shares)]
        return float(np.sqrt(np.mean(np.square(moving)))) if len(moving) else np.inf


@dataclass(frozen=True)
class FittedValue(Short):
    """A value of an effect, or of a servo, that rollouts were fitted by."""

    effect: str  # its name; "servo" for that
    joint: str
    name: str  # name of the value; of a servo as in `EffortSignal`
    before: float  # the model's value, where the fit began, SI
    after: float
    deviation: float  # its standard deviation, for what else the model has


@dataclass(frozen=True, eq=False)
class RolloutFit(Shown):
    """What a model's soft joints, their play, servos and motors are by its simulated motion.

    `before` and `after` say what they are under: logged efforts, or logged commands.
    """

    model: RobotModel  # the model with what was fitted, or as it was if that was not taken
    values: tuple[FittedValue, ...]
    before: Rollout  # the rollout of the model as it was, over all windows
    after: Rollout  # that with what was fitted, taken or not
    tested: tuple[bool, ...]  # which windows the fit did not see
    chance: float  # chance that it is truly no better in those

    @property
    def taken(self) -> bool:
        """Whether it predicts those better, by more than chance."""
        before, after = self.held_out
        worse = after.relative > before.relative or after.broken > before.broken
        return self.chance <= TIE and not worse

    @property
    def held_out(self) -> tuple[Rollout, Rollout]:
        """Before and after, over the windows that the fit did not see."""
        return self.before.part(self.tested), self.after.part(self.tested)

    @property
    def fitted(self) -> tuple[Rollout, Rollout]:
        """Before and after, over the windows that it saw."""
        seen = [not tested for tested in self.tested]
        return self.before.part(seen), self.after.part(seen)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the logs, noticed about the model, and assumed in the simulation.

        Servos of joints that were not fitted are taken for what they were found to be.
        """
        fitted = {value.joint for value in self.values if value.effect == SERVO}
        unsure = [
            signal.joint
            for signal in self.model.effort_signals
            if signal.kind == COMMAND
            and (signal.deviation or signal.damping_deviation or signal.integral_deviation)
            and signal.joint not in fitted
        ]
        if not (unsure and self.after.commands):
            return self.after.notes
        words = "elasticity and backlash may compensate for their errors"
        return (*self.after.notes, f"servo gains of {', '.join(unsure)} are uncertain: {words}")
