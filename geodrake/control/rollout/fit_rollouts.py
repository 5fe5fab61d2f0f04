"""A fit of what only the simulated motion shows: soft joints, play, their servos and motors.

A linear fit sees a soft joint to first order in its compliance, through a filter, and play hardly.
How the simulated robot moves shows both. The fit starts at the model's values and sees every other
block of windows; it counts only where it predicts the other windows better, by more than chance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance
from geodrake.boundary.showing import Short, Shown
from geodrake.control.rollout.linearized_motion import LinearizedMotion
from geodrake.control.rollout.motion_search import (
    MotionSearch,
    RolloutValue,
    blind_to,
    blinds,
    is_soft,
    rollout_values,
    values_at,
    with_values,
)
from geodrake.control.rollout.passages import Conditions, Passage, chosen_passages
from geodrake.control.rollout.roll_out import (
    BROKEN,
    HORIZON,
    MOST_WINDOWS,
    Progress,
    Rollout,
    case_rollout,
    check_windows,
)
from geodrake.control.rollout.simulation import simulations
from geodrake.errors import LogError
from geodrake.identification.logs.case import Case, checked_logs, open_case
from geodrake.identification.logs.criteria import TIE
from geodrake.identification.logs.evidence import tie_probability
from geodrake.identification.logs.servo_fit import ServoFit
from geodrake.identification.logs.servo_motion import PARAMETERS
from geodrake.identification.logs.signal_calibration import BESIDE, with_servo_motions
from geodrake.inertia import Array
from geodrake.logs.motion import JointLog
from geodrake.model.effort_signal import COMMAND, SERVO, signal_of
from geodrake.model.robot_model import RobotModel

Mask = NDArray[np.bool_]

_FEWEST = 2  # windows to fit, and to test
_BLOCKS = 4  # of the windows of one log, every other of which is held out
_SERVO = {"stiffness": "gain", "rate": "damping"}  # else they have the names of `EffortSignal`


@dataclass(frozen=True)
class FittedValue(Short):
    """A value of an effect, or of a servo, that rollouts were fitted by."""

    effect: str  # its name, or "servo"
    joint: str
    name: str  # name of the value; of a servo as in `EffortSignal`
    before: float  # the model's value, where the fit began, SI
    after: float
    deviation: float  # its standard deviation, for what else the model has


@dataclass(frozen=True, eq=False)
class RolloutFit(Shown):
    """A model's soft joints, play, servos and motors, fitted to its simulated motion.

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
        """Notes on the logs, on the model, and on assumptions of the simulation.

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


def fit_rollouts(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    horizon: float = HORIZON,
    most: int = MOST_WINDOWS,
    bandwidth: float | None = None,
    commands: bool = False,
    progress: Progress | None = None,
) -> RolloutFit:
    """Fit a model's soft joints and play, their servos and motors, to how it moves in simulation.

    Values that effects declare (`DeflectionEffect.rollout_values`: compliance, damping and half
    width of a dead band) are fitted by least squares of what windows depart by, from the model's
    values on; all else of the model stays. Every other block of windows, or of several logs every
    other log, is held out. The fit is taken if it departs less in those, by more than chance: they
    are compared window by window, as the folds of a diagnosis are. Else the model stays as it was.

    Simulations are those of `roll_out`, under the efforts of logs, or under their commands, where
    servos close the loop. Soft joints would make up for what these are off by: where the
    servo of one has deviations, its gains and its delay are fitted, too, held by their deviations,
    and by 10 ms for a delay, and with them what resists its motor, friction and the rotor's
    inertia, as far as these have deviations, held to a factor of e. Limits stay. The stiffer a
    servo is, the less of a soft joint shows in the motion, and the more counts what commands are
    between samples.

    Without soft joints it is the servos that are fitted under commands, and friction, rotor
    inertia and offset of their joints, each simulated alone along whole logs; see `fit_servo`. Of
    one log every other quarter is held out. What is taken is then fitted to all logs.

    Deviations are for all else that the model has. That of a gain stays the share of it that it
    was, as a motion tells the gain for given inertias only.

    Args:
        most: Most windows, fitted and held out together; all else is as for `roll_out`.

    Raises:
        ArgumentError: The horizon is not from 1 ms to 1000 s, or there are no windows.
        LogError: A log cannot be used, there are fewer windows than two to fit and two to test, or
            no log has commands of servos that are to be followed.
        ModelError: The model has no soft joint, no play and, under commands, no servo, or one that
            cannot be simulated.
    """
    check_windows(horizon, most, progress)
    instance(commands, "commands", bool)
    checked_logs(model, logs, (), None, None)
    soft = not commands or is_soft(model)
    values = rollout_values(model, commands=commands) if soft else ()
    case = open_case(model, logs, candidates=False, bandwidth=bandwidth)

    def simulated(model: RobotModel, name: str) -> Rollout:
        told = progress and (lambda words, share: progress(f"{name}: {words}", share))
        return case_rollout(
            replace(case, model=model),
            horizon=horizon,
            most=most,
            commands=commands,
            progress=told,
        )

    before = simulated(case.model, "before")
    tested = held_out([window.log for window in before.windows])
    if progress is not None:
        progress("fitting", 0.5)
    if soft:
        passages = chosen_passages(case, horizon, most)
        better, told, chance = _soft_joints(case, values, passages, before, tested)
    else:
        better, told, chance = _servos(case, before, tested)
    after = simulated(better, "after")
    fit = RolloutFit(better, told, before, after, tuple(tested.tolist()), chance(after))
    if not fit.taken:
        return replace(fit, model=case.model)
    if soft:
        return fit
    found, fits = with_servo_motions(case.model, case.options.logs)
    return replace(fit, model=found, values=_servo_values(case.model, fits))


Found = tuple[RobotModel, tuple[FittedValue, ...], Callable[[Rollout], float]]
"""A better model, its values, and what gives the chance that its rollout is truly no better."""


def _soft_joints(
    case: Case,
    values: tuple[RolloutValue, ...],
    passages: Sequence[Passage],
    before: Rollout,
    tested: Mask,
) -> Found:
    """Fit values of soft joints, their servos and motors to the windows that are not tested."""
    usable = np.array([bool(np.isfinite(window.simulated).all()) for window in before.windows])
    fitted, seen = np.flatnonzero(usable & ~tested), np.flatnonzero(usable & tested)
    if min(len(fitted), len(seen)) < _FEWEST:
        raise LogError(
            f"Only {len(fitted)} windows for fitting and {len(seen)} for testing have motion "
            f"and can be simulated; {_FEWEST} of each are needed.",
            advice="Use a longer log, a shorter horizon, or more windows.",
        )
    simulation = simulations(Conditions(case, before.commands), passages)

    def search(chosen: NDArray[np.intp]) -> MotionSearch:
        windows = [LinearizedMotion.of(simulation(passages[k].log), passages[k]) for k in chosen]
        return MotionSearch(case.model, values, windows, departures(before, chosen))

    def departures(rollout: Rollout, chosen: NDArray[np.intp]) -> list[Array]:
        return [rollout.windows[k].simulated - passages[k].logged for k in chosen]

    x, deviations = search(fitted).fit()
    found, changes = values_at(values, x)
    deviations = changes * deviations
    told = tuple(
        FittedValue(v.effect, v.joint, v.name, v.value, *now)
        for v, *now in zip(values, found.tolist(), deviations.tolist(), strict=True)
    )
    better = better_model(case.model, values, found, deviations)
    return better, told, lambda after: _chance(search(seen), x, departures(after, seen))


def better_model(
    model: RobotModel, values: Sequence[RolloutValue], found: Array, deviations: Array
) -> RobotModel:
    """Return the model with what was found, and with what is known of it.

    What else the model knows is as for values that are given: the efforts that led to it took its
    former ones for what they are not.
    """
    better = with_values(model, values, found.tolist(), deviations.tolist())
    if model.information is None:
        return better
    information, start = model.information.copy(), model.phi.size
    changed = {value.at for value in values}
    for at, fitted in enumerate(better.effects):
        place = slice(start, start + len(fitted.parameters))
        start = place.stop
        if at in changed and fitted.deviations is not None:
            unsure = np.flatnonzero(fitted.deviations)
            own, variances = place.start + unsure, np.square(fitted.deviations[unsure])
            information[own], information[:, own] = 0.0, 0.0
            information[own, own] = 1.0 / np.maximum(variances, np.finfo(float).tiny)
    return replace(better, information=information)


def _chance(search: MotionSearch, x: Array, after: Sequence[Array]) -> float:
    """Return the chance that held-out windows are truly predicted no better than before.

    They are compared at the joints whose values are fitted: others feel them too, but there they
    are lost in larger errors. Either model may begin with other states, by its own dynamics.

    Args:
        x: (k,) steps of the values from those before.
        after: Of each window (N, nv) simulated − logged positions afterwards.
    """
    before, now = ([slopes for _, slopes in search.near(y, slopes=True)] for y in (0.0 * x, x))
    departures = search.departures
    earlier = blinds(before, departures)
    scale = earlier[0].scale
    later = [blind_to(each, scale) for each in now]
    joints = list(search.model.joints)
    own = sorted({joints.index(value.joint) for value in search.values})
    losses = [
        np.array([np.sum(np.square(blind(d).reshape(d.shape)[:, own])) for blind, d in pairs])
        for pairs in (
            zip(earlier, departures, strict=True),
            zip(later, [np.nan_to_num(d, nan=BROKEN) for d in after], strict=True),
        )
    ]
    if not losses[1].sum() < losses[0].sum():
        return 1.0
    return tie_probability(losses[1], losses[0])


# Servos and what resists them, where no joint is soft.


def _servos(case: Case, before: Rollout, tested: Mask) -> Found:
    """Fit servos and what resists them to what is not tested, joint by joint."""
    better, fits = with_servo_motions(case.model, _seen(case.options.logs, before, tested))
    if not fits:
        raise LogError(
            "No joint moves in the simulation under its commands as it was measured.",
            advice="Do commands and positions have the same unit? geodrake log LOG --model MODEL.",
        )

    def losses(rollout: Rollout) -> Array:
        held = [window for window, out in zip(rollout.windows, tested, strict=True) if out]
        departures = (np.nan_to_num(window.departure, nan=BROKEN) for window in held)
        return np.concatenate([np.sum(np.square(each), axis=0) for each in departures])

    def chance(after: Rollout) -> float:
        return tie_probability(losses(after), losses(before))

    return better, _servo_values(case.model, fits), chance


def held_out(logs: Sequence[str]) -> Mask:
    """Return (W,) which windows are held out: every other log, or block of the windows of one log.

    Args:
        logs: (W,) names of the windows' logs, one log after the other.
    """
    names = list(dict.fromkeys(logs))
    if len(names) > 1:
        return np.array([names.index(log) % 2 == 1 for log in logs])
    return np.arange(len(logs)) * _BLOCKS // max(len(logs), 1) % 2 == 1


def _seen(logs: Sequence[JointLog], rollout: Rollout, tested: Mask) -> list[JointLog]:
    """Return what a fit sees of logs: those, or of a single one those quarters, without a test."""
    pairs = list(zip(rollout.windows, tested.tolist(), strict=True))
    used = {window.log for window, held in pairs if not held}
    unseen = {window.log for window, held in pairs if held}
    if unseen.isdisjoint(used):
        return [log for log in logs if log.name not in unseen]
    (log,) = (log for log in logs if log.name in used)
    since = log.time - log.time[np.isfinite(log.time)][0]
    spans = [(window.time[0], window.time[-1]) for window, held in pairs if held]
    cuts = [window.time[0] for window, _ in pairs]
    ends = [min([cut for cut in cuts if cut > last], default=last) for _, last in spans]
    out = np.any([(since >= a) & (since < b) for (a, _), b in zip(spans, ends, strict=True)], 0)
    position = np.where(out[:, None], np.nan, log.position)
    return [replace(log, position=position)]


def _servo_values(model: RobotModel, fits: dict[str, ServoFit]) -> tuple[FittedValue, ...]:
    """Return what was found of servos, and of their joints."""
    found = []
    for joint, fit in fits.items():
        servo = signal_of(model.effort_signals, joint)
        for name, value, unsure in zip(PARAMETERS, fit.parameters, fit.deviations, strict=True):
            if name in BESIDE:
                kind = BESIDE[name]
                before = next(
                    (
                        float(fitted.parameters[0])
                        for fitted in model.effects
                        if isinstance(fitted.effect, kind) and fitted.effect.where == (joint,)
                    ),
                    0.0,
                )
                told = kind.name, kind.parameters[0].name
            else:
                of_signal = _SERVO.get(name, name)
                before, told = float(getattr(servo, of_signal)), (SERVO, of_signal)
            if value or before:
                found.append(
                    FittedValue(told[0], joint, told[1], before, float(value), float(unsure))
                )
    return tuple(found)
