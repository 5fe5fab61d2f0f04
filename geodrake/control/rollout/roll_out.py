"""Rollouts: windows chosen, simulated, and compared with what was measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import function, instance, instances, integer, number, typed
from geodrake.boundary.showing import Short, Shown
from geodrake.control.rollout.passages import (
    Conditions,
    Passage,
    Span,
    chosen_passages,
    told_joints,
)
from geodrake.control.rollout.simulation import simulations
from geodrake.control.rollout.stepping import Stepping, steps_alone
from geodrake.effects import Role
from geodrake.effects.lookup import effect_of
from geodrake.errors import LogError
from geodrake.identification.logs.case import Case, checked_logs, open_case
from geodrake.inertia import Array
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of

BROKEN = 1e3
"""By so much a simulation departs that broke off, rad or m."""

HORIZON = 0.5
"""Length of a window, s."""

MOST_WINDOWS = 12
"""Windows that are simulated, spread evenly over the logs."""

_COMPARED = 6  # windows for what servos are like before and after a fit
_SHORTEST, _LONGEST = 1e-3, 1e3  # horizons, s
_AT_REST = 1e-9  # rad or m: rounding of a smoothed position
Progress = Callable[[str, float], None]


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

    names: tuple[str, ...]  # of the joints
    windows: tuple[Window, ...]
    horizon: float  # length of the windows, s
    # What was done to the logs, noticed about the model, and assumed in the simulation.
    notes: tuple[str, ...] = ()
    commands: bool = False  # whether servos closed the loop

    @cached_property
    def joints(self) -> tuple[JointDeparture, ...]:
        """How far each joint departs over the windows."""
        departures = [np.nan_to_num(w.departure, nan=np.inf) for w in self.windows]
        squares = np.array([np.mean(np.square(d), 0) for d in departures])
        moved = [np.mean(np.square(w.measured - w.measured[0]), 0) for w in self.windows]
        rms, moves = np.sqrt(squares.mean(0)).tolist(), np.sqrt(np.mean(moved, 0)).tolist()
        worst = [self.windows[k] for k in squares.argmax(0)]
        return tuple(
            JointDeparture(name, departs, moves, (most.log, float(most.time[0])))
            for name, departs, moves, most in zip(self.names, rms, moves, worst, strict=True)
        )

    @property
    def broken(self) -> int:
        """Windows in which the simulation could not go on to the end, or left all reason."""
        return sum(bool(np.isnan(w.simulated).any()) for w in self.windows)

    def part(self, chosen: Sequence[bool]) -> Rollout:
        """Return the rollout of some of the W windows alone."""
        windows = [w for w, taken in zip(self.windows, chosen, strict=True) if taken]
        return replace(self, windows=tuple(windows))

    @property
    def under(self) -> str:
        """Inputs of the simulation: "efforts" or "commands"."""
        return "commands" if self.commands else "efforts"

    @property
    def relative(self) -> float:
        """Root mean square of departure over motion, over joints that move."""
        shares = np.array([joint.relative for joint in self.joints])
        moving = shares[~np.isnan(shares)]
        return float(np.sqrt(np.mean(np.square(moving)))) if len(moving) else np.inf


def roll_out(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    horizon: float = HORIZON,
    most: int = MOST_WINDOWS,
    bandwidth: float | None = None,
    commands: bool = False,
    progress: Progress | None = None,
) -> Rollout:
    """Simulate a model under the efforts of logs, or under their commands, window by window.

    What acts are the measured efforts, advanced by the model's delays. A rigid robot is simulated
    in all windows at a time, by implicit steps (`rollout.stepping`); any other one by a Drake
    diagram of the plant with the model's inertias and `EffectForce`. Either is in the time of the
    log, so that friction that drifts has drifted, and contacts act in their log when they did.
    Hidden states, such as the bend of bristles, start as the measured motion before the window
    leaves them. Soft joints and play are motors and links with a spring or a dead band between
    them; what was measured is the motors', and links start where their measured load has them.
    Where joints follow others, or are behind a transmission, efforts are those of leaders and
    actuators (`DrivenPlant`).

    Under commands, a joint with a servo (`RobotModel.effort_signals` of the kind "command") gets
    the effort that the servo makes of the command of the log, late by its delay, and of the
    *simulated* position and velocity. Measured positions count where a window starts, and
    afterwards only as what is compared. Joints without a servo, or without a command in a log, get
    the efforts of the log all the same.

    Args:
        model: The model; servos that it does not know are found by its inertias first.
        logs: Logs or their files; under commands, one with commands at least.
        horizon: Length of a window, s.
        most: Most windows; they are spread evenly over all that moves.
        bandwidth: Bandwidth of the filter that the initial states are smoothed with, Hz; by default
            that of the model's fit to the same logs, or chosen from the data.
        commands: Whether servos close the loop, under the commands of logs.
        progress: Called with each window: its log, and the share that is done.

    Raises:
        ArgumentError: The horizon is not from 1 ms to 1000 s, or there are no windows.
        LogError: A log cannot be used, or none moves for as long as a window, or has commands of
            servos that are to be followed.
        ModelError: Joints follow others or are behind a transmission, and the model has soft joints
            or effects with hidden states.
    """
    check_windows(horizon, most, progress)
    instance(commands, "commands", bool)
    case = open_case(model, logs, candidates=False, bandwidth=bandwidth)
    return case_rollout(case, horizon=horizon, most=most, commands=commands, progress=progress)


def commanded_motions(
    model: RobotModel,
    after: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    between: Sequence[RobotModel] = (),
) -> tuple[Rollout, ...] | None:
    """Compare the motion of a robot under the commands of logs, before and after a fit.

    Args:
        between: Models on the way, as after the steps of an explanation.

    Returns:
        Rollouts of all models in their order, with the same servos and in the same passages; None
        if they have none.
    """
    logs = checked_logs(model, logs, (), None, None)
    models = (model, *instances(between, "between", RobotModel))
    if not any(servos_of(instance(after, "after", RobotModel))):
        return None
    case = open_case(after, logs, candidates=False)
    if not any(told_joints(case.model, log).any() for log in case.options.logs):
        return None
    same = (
        replace(each, effort_signals=after.effort_signals, bandwidths=after.bandwidths)
        for each in models
    )
    cases = [*(replace(case, model=each) for each in same), case]
    return tuple(case_rollout(each, most=_COMPARED, commands=True) for each in cases)


@typed
def case_rollout(
    case: Case,
    *,
    horizon: float = HORIZON,
    most: int = MOST_WINDOWS,
    commands: bool = False,
    progress: Progress | None = None,
    within: Sequence[Span] | None = None,
) -> Rollout:
    """Return the rollout of the model of a case, whose logs are prepared; see `roll_out`.

    Args:
        within: Logs, and first and last instants of theirs, s, outside of which nothing is
            simulated.
    """
    model, logs = case.model, case.options.logs
    if commands and not any(told_joints(model, log).any() for log in logs):
        raise LogError(
            "No log has commands of a servo that the model knows.",
            advice="Use efforts instead of --commands, or logs with columns <joint>.command.",
        )
    chosen = chosen_passages(case, horizon, most, within)
    notes = dict.fromkeys([*(_unheard(case) if commands else ()), *_fitted_forces(case)])
    conditions = Conditions(case, commands)
    simulation, together = simulations(conditions, chosen), steps_alone(model)
    groups = dict[str | Passage, list[Passage]]()
    for passage in chosen:
        groups.setdefault(_alike(case, passage.log) if together else passage, []).append(passage)
    found, done = dict[Passage, Array](), 0
    for group in groups.values():
        if progress is not None:
            first = group[0]
            progress(f"{first.log} {first.segment.time[0]:.1f} s", done / len(chosen))
        done += len(group)
        if together:
            found |= zip(group, Stepping(conditions, group).positions(), strict=True)
            continue
        (passage,) = group
        found[passage] = simulation(passage.log).positions(passage)
        notes |= dict.fromkeys(simulation(passage.log).notes)
    windows = (Window(p.log, p.segment.time, p.segment.position, found[p]) for p in chosen)
    return Rollout(model.joints, tuple(windows), horizon, (*case.notes, *notes), commands)


def _alike(case: Case, log: str) -> str:
    """Return the name of a log whose passages are simulated by themselves, or no name."""
    episodes = any(fitted.effect.role is Role.EPISODE for fitted in case.model.effects)
    carries = any(trajectory.payloads for trajectory in case.trajectories)
    return log if episodes or carries else ""


def _unheard(case: Case) -> list[str]:
    """Return a note on delays of efforts that servos make themselves."""
    model = case.model
    told = np.any([told_joints(model, log) for log in case.options.logs], axis=0)
    late = [model.joints[j] for j in np.flatnonzero(model.delays * told)]
    if not late:
        return []
    name = effect_of(Role.DELAY).name
    return [f"{name} of {', '.join(late)} is ignored: servos have no delay"]


def _fitted_forces(case: Case) -> list[str]:
    """Return a note for each log on forces at contacts that nobody measured."""
    return [
        f"{trajectory.name}: forces at {', '.join(trajectory.contacts.frames)} are those that fit "
        "the measured motion best, which hides some of the model's errors"
        for trajectory in case.trajectories
        if trajectory.contacts is not None
    ]


def check_windows(horizon: float, most: int, progress: Progress | None) -> None:
    """Refuse windows that cannot be."""
    number(horizon, "horizon", lower=_SHORTEST, upper=_LONGEST)
    integer(most, "most", lower=1, upper=np.inf)
    if progress is not None:
        function(progress, "progress")
