"""A fit of servos and of what resists them, judged by rollouts of the whole robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geodrake.control.rollout.results import BROKEN, FittedValue, Rollout, RolloutFit, Window
from geodrake.control.rollout.roll_out import Progress, named_rollout
from geodrake.errors import LogError
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.evidence import tie_probability
from geodrake.identification.logs.servo_fit import ServoFit
from geodrake.identification.logs.servo_motion import PARAMETERS
from geodrake.identification.logs.signal_calibration import BESIDE, with_servo_motions
from geodrake.logs.motion import JointLog
from geodrake.model.effort_signal import SERVO, signal_of
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BLOCKS = 4  # of the windows of one log, every other of which is held out
_SERVO = {"stiffness": "gain", "rate": "damping"}  # else they have the names of `EffortSignal`


def fit_servos(
    case: Case, *, horizon: float, most: int, progress: Progress | None = None
) -> RolloutFit:
    """Fit servos of a model and what resists them to how its joints move under commands.

    Each joint is simulated alone along logs, least squares of its positions; see `fit_servo`. Every
    other log is held out, or of one log every other quarter. What is found counts if rollouts of
    the whole robot there depart less, by more than chance would have it of joints and windows; it
    is then fitted to all logs.

    Raises:
        LogError: No joint moves under its commands in simulation as it was measured to.
    """
    simulated = partial(
        named_rollout, case, horizon=horizon, most=most, commands=True, progress=progress
    )
    before = simulated(case.model, "before")
    tested = held_out([window.log for window in before.windows])
    seen = _seen(case.asked.logs, before, tested)
    if progress is not None:
        progress("fitting", 0.5)
    half, fits = with_servo_motions(case.model, seen)
    if not fits:
        raise LogError(
            "No joint moves in the simulation under its commands as it was measured.",
            advice="Do commands and positions have the same unit? geodrake log LOG --model MODEL.",
        )
    after = simulated(half, "after")
    losses = [
        np.concatenate([_losses(w) for w, held in zip(each.windows, tested, strict=True) if held])
        for each in (before, after)
    ]
    chance, values = tie_probability(losses[1], losses[0]), _values(case.model, fits)
    fit = RolloutFit(case.model, values, before, after, tuple(tested.tolist()), chance)
    if not fit.taken:
        return fit
    found, fits = with_servo_motions(case.model, case.asked.logs)
    return replace(fit, model=found, values=_values(case.model, fits))


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


def _losses(window: Window) -> Array:
    """Return the sums of squares (nv,) by which the joints of a window depart."""
    departure = np.nan_to_num(window.simulated - window.measured, nan=BROKEN)
    return np.asarray(np.sum(np.square(departure), axis=0))


def _values(model: RobotModel, fits: dict[str, ServoFit]) -> tuple[FittedValue, ...]:
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
