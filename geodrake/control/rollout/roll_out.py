"""Rollouts of models in windows of logs."""

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
    commanded_joints,
)
from geodrake.control.rollout.simulation import simulations
from geodrake.control.rollout.stepping import Stepping, can_step
from geodrake.effects import Role
from geodrake.effects.lookup import effect_of
from geodrake.errors import LogError
from geodrake.identification.logs.case import Case, checked_logs, prepare_case
from geodrake.inertia import Array
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of

BROKEN = 1e3
"""Departure that counts for a simulation that broke off, rad or m."""

HORIZON = 0.5
"""Default length of a window, s."""

MOST_WINDOWS = 12
"""Default number of windows."""

_COMPARED = 6  # windows for comparisons before and after a fit
_SHORTEST, _LONGEST = 1e-3, 1e3  # horizons, s
_AT_REST = 1e-9  # rad or m, rounding error of smoothed positions
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Window(Short):
    """A simulated window of a log."""

    log: str
    time: Array  # (K,) s
    measured: Array  # (K, nv) positions, rad or m
    simulated: Array  # (K, nv) positions; NaN after the simulation broke off

    @property
    def departure(self) -> Array:
        """(K, nv) simulated − measured position."""
        return self.simulated - self.measured


@dataclass(frozen=True)
class JointDeparture:
    """Departure of one joint from its measured motion."""

    joint: str
    rms: float  # RMS of simulated − measured position over all windows, rad or m
    moved: float  # RMS of the measured displacement since the start of the window, rad or m
    worst: tuple[str, float]  # log and start, s, of the window with the largest departure

    @property
    def relative(self) -> float:
        """RMS departure over RMS motion; 1 if the simulation rests, NaN if the joint rests."""
        return self.rms / self.moved if self.moved > _AT_REST else np.nan


@dataclass(frozen=True, eq=False)
class Rollout(Shown):
    """A model simulated under logged efforts or commands."""

    names: tuple[str, ...]  # of the joints
    windows: tuple[Window, ...]
    horizon: float  # length of the windows, s
    notes: tuple[str, ...] = ()  # on the logs, the model, and assumptions of the simulation
    commands: bool = False  # whether servos closed the loop

    @cached_property
    def joints(self) -> tuple[JointDeparture, ...]:
        """Departure of each joint over the windows."""
        departures = [np.nan_to_num(w.departure, nan=np.inf) for w in self.windows]
        squares = np.array([np.mean(np.square(d), 0) for d in departures])
        displacements = [np.mean(np.square(w.measured - w.measured[0]), 0) for w in self.windows]
        rms, moved = np.sqrt(squares.mean(0)), np.sqrt(np.mean(displacements, 0))
        worst = [self.windows[k] for k in squares.argmax(0)]
        rows = zip(self.names, rms.tolist(), moved.tolist(), worst, strict=True)
        return tuple(
            JointDeparture(name, joint_rms, joint_moved, (window.log, float(window.time[0])))
            for name, joint_rms, joint_moved, window in rows
        )

    @property
    def broken(self) -> int:
        """Number of windows in which the simulation diverged or broke off."""
        return sum(bool(np.isnan(w.simulated).any()) for w in self.windows)

    def part(self, chosen: Sequence[bool]) -> Rollout:
        """Return the rollout restricted to some of the W windows."""
        windows = [w for w, is_chosen in zip(self.windows, chosen, strict=True) if is_chosen]
        return replace(self, windows=tuple(windows))

    @property
    def under(self) -> str:
        """Kind of inputs: "commands" or "efforts"."""
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

    The measured efforts are advanced by the model's delays. Rigid robots are simulated in all
    windows at once, by implicit steps (`rollout.stepping`); others by a Drake diagram of the plant
    with the model's inertias and `EffectForce`. The simulation uses the time of the log, so that
    drifting friction and contacts act as they did. Hidden states, such as bristle deflections,
    result from the measured motion before the window. Soft joints and backlash are modelled by
    motors and links with a spring or a dead band. The measured motion is that of the motors; links
    start with the deflection due to their measured load. If joints are coupled or driven by a
    transmission, efforts are those of leaders and actuators (`DrivenPlant`).

    Under commands, the effort of a joint with a servo (`RobotModel.effort_signals` of the kind
    "command") follows from the logged command, delayed by the servo, and the *simulated* position
    and velocity. Measured positions define the initial state and are otherwise only compared.
    Joints without a servo, or without a logged command, still use logged efforts.

    Args:
        model: The model; unknown servos are first identified with its inertias.
        logs: Logs or their files; under commands, at least one must have commands.
        horizon: Length of a window, s.
        most: Maximum number of windows, spread evenly over all motion.
        bandwidth: Bandwidth of the smoothing filter for initial states, Hz; by default that of the
            model's fit to the same logs, or chosen from the data.
        commands: Whether servos close the loop, under the commands of logs.
        progress: Called for each window with its log, and the fraction that is done.

    Raises:
        ArgumentError: The horizon is not from 1 ms to 1000 s, or there are no windows.
        LogError: A log is invalid, or none has motion for the length of a window, or commands of
            servos under `commands`.
        ModelError: The model has coupled joints or a transmission, and soft joints or effects with
            hidden states.
    """
    check_windows(horizon, most, progress)
    instance(commands, "commands", bool)
    case = prepare_case(model, logs, candidates=False, bandwidth=bandwidth)
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
        between: Intermediate models, such as those of the steps of an explanation.

    Returns:
        Rollouts of all models in order, with the same servos and windows; None without servos or
        commands.
    """
    logs = checked_logs(model, logs, (), None, None)
    models = (model, *instances(between, "between", RobotModel))
    if not any(servos_of(instance(after, "after", RobotModel))):
        return None
    case = prepare_case(after, logs, candidates=False)
    if not any(commanded_joints(case.model, log).any() for log in case.options.logs):
        return None
    with_servos = (
        replace(earlier, effort_signals=after.effort_signals, bandwidths=after.bandwidths)
        for earlier in models
    )
    cases = [*(replace(case, model=earlier) for earlier in with_servos), case]
    return tuple(case_rollout(case, most=_COMPARED, commands=True) for case in cases)


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
    """Return the rollout of a case's model; see `roll_out`, and `chosen_passages` for `within`."""
    model, logs = case.model, case.options.logs
    if commands and not any(commanded_joints(model, log).any() for log in logs):
        raise LogError(
            "No log has commands of a servo that the model knows.",
            advice="Use efforts instead of --commands, or logs with columns <joint>.command.",
        )
    chosen = chosen_passages(case, horizon, most, within)
    notes = dict.fromkeys([*(_delay_notes(case) if commands else ()), *_contact_notes(case)])
    conditions = Conditions(case, commands)
    simulation, is_rigid = simulations(conditions, chosen), can_step(model)
    groups = dict[str | Passage, list[Passage]]()
    for passage in chosen:
        key = _group_key(case, passage.log) if is_rigid else passage
        groups.setdefault(key, []).append(passage)
    simulated, done = dict[Passage, Array](), 0
    for group in groups.values():
        if progress is not None:
            first = group[0]
            progress(f"{first.log} {first.segment.time[0]:.1f} s", done / len(chosen))
        done += len(group)
        if is_rigid:
            simulated |= zip(group, Stepping(conditions, group).positions(), strict=True)
            continue
        (passage,) = group
        simulated[passage] = simulation(passage.log).positions(passage)
        notes |= dict.fromkeys(simulation(passage.log).notes)
    windows = (Window(p.log, p.segment.time, p.segment.position, simulated[p]) for p in chosen)
    return Rollout(model.joints, tuple(windows), horizon, (*case.notes, *notes), commands)


def _group_key(case: Case, log: str) -> str:
    """Return the key of passages simulated together: the log if logs differ, or "" for all."""
    has_episodes = any(fitted.effect.role is Role.EPISODE for fitted in case.model.effects)
    has_payloads = any(trajectory.payloads for trajectory in case.trajectories)
    return log if has_episodes or has_payloads else ""


def _delay_notes(case: Case) -> list[str]:
    """Return a note on effort delays at joints with servos."""
    model = case.model
    commanded = np.any([commanded_joints(model, log) for log in case.options.logs], axis=0)
    delayed = [model.joints[j] for j in np.flatnonzero(model.delays * commanded)]
    if not delayed:
        return []
    name = effect_of(Role.DELAY).name
    return [f"{name} of {', '.join(delayed)} is ignored: servos have no delay"]


def _contact_notes(case: Case) -> list[str]:
    """Return a note for each log with unmeasured contact forces."""
    return [
        f"{trajectory.name}: forces at {', '.join(trajectory.contacts.frames)} are those that fit "
        "the measured motion best, which hides some of the model's errors"
        for trajectory in case.trajectories
        if trajectory.contacts is not None
    ]


def check_windows(horizon: float, most: int, progress: Progress | None) -> None:
    """Raise if the arguments that define windows are invalid."""
    number(horizon, "horizon", lower=_SHORTEST, upper=_LONGEST)
    integer(most, "most", lower=1, upper=np.inf)
    if progress is not None:
        function(progress, "progress")
