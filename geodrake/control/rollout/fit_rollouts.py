"""Fit of soft joints, backlash, and their servos and motors to simulated motion.

A linear fit of efforts is sensitive to elasticity only to first order and within the filter's
bandwidth, and hardly sensitive to backlash. Simulated motion depends on both. The fit starts at the
model's values and uses every other block of windows. It is accepted if it predicts the other
windows significantly better.
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
    is_soft,
    rollout_values,
    start_projection,
    start_projections,
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
from geodrake.effects.lookup import servo_effects
from geodrake.errors import LogError
from geodrake.identification.logs.case import Case, checked_logs, prepare_case
from geodrake.identification.logs.criteria import TIE
from geodrake.identification.logs.evidence import tie_probability
from geodrake.identification.logs.servo_fit import ServoFit
from geodrake.identification.logs.servo_motion import PARAMETERS
from geodrake.identification.logs.signal_calibration import with_servo_motions
from geodrake.inertia import Array
from geodrake.logs.motion import JointLog
from geodrake.model.effort_signal import COMMAND, SERVO, signal_of
from geodrake.model.robot_model import RobotModel

Mask = NDArray[np.bool_]

_FEWEST = 2  # windows for fitting, and for testing
_BLOCKS = 4  # of the windows of a single log; every other block is held out
_SIGNAL_FIELDS = {"stiffness": "gain", "rate": "damping"}  # names that differ in `EffortSignal`


@dataclass(frozen=True)
class FittedValue(Short):
    """A fitted value of an effect or servo."""

    effect: str  # name of the effect, or "servo"
    joint: str
    name: str  # name of the value; for servos as in `EffortSignal`
    before: float  # the model's value, SI
    after: float
    deviation: float  # standard deviation, given the rest of the model


@dataclass(frozen=True, eq=False)
class RolloutFit(Shown):
    """Result of fitting soft joints, servos and motors to simulated motion."""

    model: RobotModel  # with the fitted values if accepted, otherwise the original one
    values: tuple[FittedValue, ...]
    before: Rollout  # of the original model, over all windows
    after: Rollout  # with the fitted values, accepted or not
    tested: tuple[bool, ...]  # which windows were held out
    chance: float  # probability that the fit is not better in held-out windows

    @property
    def taken(self) -> bool:
        """Whether the fit is accepted: significantly better in the held-out windows."""
        before, after = self.held_out
        worse = after.relative > before.relative or after.broken > before.broken
        return self.chance <= TIE and not worse

    @property
    def held_out(self) -> tuple[Rollout, Rollout]:
        """Rollouts before and after, over the held-out windows."""
        return self.before.part(self.tested), self.after.part(self.tested)

    @property
    def fitted(self) -> tuple[Rollout, Rollout]:
        """Rollouts before and after, over the windows used for fitting."""
        fitted = [not tested for tested in self.tested]
        return self.before.part(fitted), self.after.part(fitted)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the logs, the model, assumptions of the simulation, and uncertain servos."""
        fitted = {value.joint for value in self.values if value.effect == SERVO}
        uncertain = [
            signal.joint
            for signal in self.model.effort_signals
            if signal.kind == COMMAND
            and (signal.deviation or signal.damping_deviation or signal.integral_deviation)
            and signal.joint not in fitted
        ]
        if not (uncertain and self.after.commands):
            return self.after.notes
        words = "elasticity and backlash may compensate for their errors"
        return (*self.after.notes, f"servo gains of {', '.join(uncertain)} are uncertain: {words}")


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
    """Fit a model's soft joints, backlash, servos and motors to its simulated motion.

    The values that effects declare (`DeflectionEffect.rollout_values`: compliance, damping and half
    width of a dead band) are fitted to the departures of windows by least squares, starting at the
    model's values. The rest of the model does not change. Every other block of windows, or every
    other log, is held out. The fit is accepted if held-out departures are significantly smaller,
    compared window by window like the folds of a diagnosis. Otherwise the model does not change.

    Simulations are those of `roll_out`, under logged efforts, or under logged commands with servos.
    Soft joints would compensate for errors of their servos. If the servo of a soft joint has
    standard deviations, its gains and delay are therefore also fitted, with priors of these
    deviations and 10 ms for the delay. So are friction and rotor inertia of its motor, if they have
    standard deviations, with a prior of a factor of e. Effort limits do not change. With a stiff
    servo, the motion shows less of the soft joint, and depends more on commands between samples.

    Without soft joints, the servos are fitted under commands, together with friction, rotor inertia
    and offset of their joints, each simulated separately along whole logs; see `fit_servo`. Of a
    single log, every other quarter is held out. An accepted fit is repeated with all data.

    Standard deviations are conditional on the rest of the model. The relative deviation of a gain
    does not change, as motion determines it only for given inertias.

    Args:
        most: Maximum number of windows, for fitting and testing together. See `roll_out` for the
            other arguments.

    Raises:
        ArgumentError: The horizon is not from 1 ms to 1000 s, or there are no windows.
        LogError: A log is invalid, there are fewer than two windows for fitting or testing, or no
            log has commands of servos under `commands`.
        ModelError: The model has no soft joint, no backlash and, under commands, no servo, or it
            cannot be simulated.
    """
    check_windows(horizon, most, progress)
    instance(commands, "commands", bool)
    checked_logs(model, logs, (), None, None)
    soft = not commands or is_soft(model)
    values = rollout_values(model, commands=commands) if soft else ()
    case = prepare_case(model, logs, candidates=False, bandwidth=bandwidth)

    def simulate(model: RobotModel, name: str) -> Rollout:
        named_progress = progress and (lambda words, share: progress(f"{name}: {words}", share))
        return case_rollout(
            replace(case, model=model),
            horizon=horizon,
            most=most,
            commands=commands,
            progress=named_progress,
        )

    before = simulate(case.model, "before")
    tested = held_out([window.log for window in before.windows])
    if progress is not None:
        progress("fitting", 0.5)
    if soft:
        passages = chosen_passages(case, horizon, most)
        fitted, fitted_values, chance = _fit_soft_joints(case, values, passages, before, tested)
    else:
        fitted, fitted_values, chance = _fit_servos(case, before, tested)
    after = simulate(fitted, "after")
    fit = RolloutFit(fitted, fitted_values, before, after, tuple(tested.tolist()), chance(after))
    if not fit.taken:
        return replace(fit, model=case.model)
    if soft:
        return fit
    fitted, fits = with_servo_motions(case.model, case.options.logs)
    return replace(fit, model=fitted, values=_servo_values(case.model, fits))


Fit = tuple[RobotModel, tuple[FittedValue, ...], Callable[[Rollout], float]]
"""Model, values, and a function from its rollout to the probability that it is not better."""


def _fit_soft_joints(
    case: Case,
    values: tuple[RolloutValue, ...],
    passages: Sequence[Passage],
    before: Rollout,
    tested: Mask,
) -> Fit:
    """Fit values of soft joints, their servos and motors to the windows that are not held out."""
    valid = np.array([bool(np.isfinite(window.simulated).all()) for window in before.windows])
    training, testing = np.flatnonzero(valid & ~tested), np.flatnonzero(valid & tested)
    if min(len(training), len(testing)) < _FEWEST:
        raise LogError(
            f"Only {len(training)} windows for fitting and {len(testing)} for testing have motion "
            f"and can be simulated; {_FEWEST} of each are needed.",
            advice="Use a longer log, a shorter horizon, or more windows.",
        )
    simulation = simulations(Conditions(case, before.commands), passages)

    def search(chosen: NDArray[np.intp]) -> MotionSearch:
        windows = [LinearizedMotion.of(simulation(passages[k].log), passages[k]) for k in chosen]
        return MotionSearch(case.model, values, windows, departures(before, chosen))

    def departures(rollout: Rollout, chosen: NDArray[np.intp]) -> list[Array]:
        return [rollout.windows[k].simulated - passages[k].logged for k in chosen]

    x, deviations = search(training).fit()
    new, changes = values_at(values, x)
    deviations = changes * deviations
    fitted_values = tuple(
        FittedValue(v.effect, v.joint, v.name, v.value, after, deviation)
        for v, after, deviation in zip(values, new.tolist(), deviations.tolist(), strict=True)
    )
    model = fitted_model(case.model, values, new, deviations)
    return (
        model,
        fitted_values,
        lambda after: _chance(search(testing), x, departures(after, testing)),
    )


def fitted_model(
    model: RobotModel, values: Sequence[RolloutValue], new: Array, deviations: Array
) -> RobotModel:
    """Return the model with new values and their information.

    Correlations with other parameters are removed, as these were fitted with the old values.
    """
    fitted_model = with_values(model, values, new.tolist(), deviations.tolist())
    if model.information is None:
        return fitted_model
    information, start = model.information.copy(), model.phi.size
    changed = {value.index for value in values}
    for i, fitted in enumerate(fitted_model.effects):
        first = start
        start += len(fitted.parameters)
        if i in changed and fitted.deviations is not None:
            uncertain = np.flatnonzero(fitted.deviations)
            rows, variances = first + uncertain, np.square(fitted.deviations[uncertain])
            information[rows], information[:, rows] = 0.0, 0.0
            information[rows, rows] = 1.0 / np.maximum(variances, np.finfo(float).tiny)
    return replace(fitted_model, information=information)


def _chance(search: MotionSearch, x: Array, after: Sequence[Array]) -> float:
    """Return the probability that held-out windows are not predicted better than before.

    Only joints with fitted values are compared; at others the effect is lost in larger errors. The
    initial states may differ between the models.

    Args:
        x: (k,) steps of the values.
        after: (N, nv) simulated − logged positions of each window after the fit.
    """
    slopes_before, slopes_after = (
        [slopes for _, slopes in search.linearized(y, slopes=True)] for y in (0.0 * x, x)
    )
    departures = search.departures
    projections_before = start_projections(slopes_before, departures)
    scale = projections_before[0].scale
    projections_after = [start_projection(slopes, scale) for slopes in slopes_after]
    joints = list(search.model.joints)
    compared = sorted({joints.index(value.joint) for value in search.values})
    losses = [
        np.array(
            [np.sum(np.square(project(d).reshape(d.shape)[:, compared])) for project, d in pairs]
        )
        for pairs in (
            zip(projections_before, departures, strict=True),
            zip(projections_after, [np.nan_to_num(d, nan=BROKEN) for d in after], strict=True),
        )
    ]
    if not losses[1].sum() < losses[0].sum():
        return 1.0
    return tie_probability(losses[1], losses[0])


def _fit_servos(case: Case, before: Rollout, tested: Mask) -> Fit:
    """Fit servos, friction and rotor inertia of each joint to the data that are not held out."""
    model, fits = with_servo_motions(case.model, _training_logs(case.options.logs, before, tested))
    if not fits:
        raise LogError(
            "No joint moves in the simulation under its commands as it was measured.",
            advice="Do commands and positions have the same unit? geodrake log LOG --model MODEL.",
        )

    def losses(rollout: Rollout) -> Array:
        windows = rollout.part(tested.tolist()).windows
        departures = (np.nan_to_num(window.departure, nan=BROKEN) for window in windows)
        return np.concatenate([np.sum(np.square(d), axis=0) for d in departures])

    def chance(after: Rollout) -> float:
        return tie_probability(losses(after), losses(before))

    return model, _servo_values(case.model, fits), chance


def held_out(logs: Sequence[str]) -> Mask:
    """Return (W,) which windows are held out: every other log, or block of a single log."""
    names = list(dict.fromkeys(logs))
    if len(names) > 1:
        return np.array([names.index(log) % 2 == 1 for log in logs])
    return np.arange(len(logs)) * _BLOCKS // max(len(logs), 1) % 2 == 1


def _training_logs(logs: Sequence[JointLog], rollout: Rollout, tested: Mask) -> list[JointLog]:
    """Return the logs that are not held out, or a single log with held-out quarters masked."""
    pairs = list(zip(rollout.windows, tested.tolist(), strict=True))
    training = {window.log for window, is_tested in pairs if not is_tested}
    testing = {window.log for window, is_tested in pairs if is_tested}
    if testing.isdisjoint(training):
        return [log for log in logs if log.name not in testing]
    (log,) = (log for log in logs if log.name in training)
    time = log.time - log.time[np.isfinite(log.time)][0]
    spans = [(window.time[0], window.time[-1]) for window, is_tested in pairs if is_tested]
    starts = [window.time[0] for window, _ in pairs]
    ends = [min([start for start in starts if start > last], default=last) for _, last in spans]
    intervals = zip(spans, ends, strict=True)
    is_held_out = np.any([(time >= start) & (time < end) for (start, _), end in intervals], 0)
    position = np.where(is_held_out[:, None], np.nan, log.position)
    return [replace(log, position=position)]


def _servo_values(model: RobotModel, fits: dict[str, ServoFit]) -> tuple[FittedValue, ...]:
    """Return the fitted values of servos and of effects at their joints."""
    values = []
    for joint, fit in fits.items():
        servo = signal_of(model.effort_signals, joint)
        for name, after, deviation in zip(PARAMETERS, fit.parameters, fit.deviations, strict=True):
            if (kind := servo_effects().get(name)) is not None:
                effect, field = kind.name, kind.parameters[0].name
                before = next(
                    (
                        float(fitted.parameters[0])
                        for fitted in model.effects
                        if isinstance(fitted.effect, kind) and fitted.effect.where == (joint,)
                    ),
                    0.0,
                )
            else:
                effect, field = SERVO, _SIGNAL_FIELDS.get(name, name)
                before = float(getattr(servo, field))
            if after or before:
                value = FittedValue(effect, joint, field, before, float(after), float(deviation))
                values.append(value)
    return tuple(values)
