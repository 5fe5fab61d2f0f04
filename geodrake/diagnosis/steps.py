"""Steps of an explanation: its findings in order, with errors and values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.final_fit import searched_model
from geodrake.diagnosis.findings import (
    DELAY,
    INERTIA,
    Finding,
    StagedFinding,
    affected_joints,
    late_joints,
    moved_bodies,
    unknown_probabilities,
    where_of,
)
from geodrake.diagnosis.posterior import Certainty, nrms_of
from geodrake.diagnosis.refinements import delays_of
from geodrake.diagnosis.results import FittedRival, Step
from geodrake.diagnosis.search import SearchResult
from geodrake.diagnosis.terms import Term
from geodrake.effects import FittedEffect, Role
from geodrake.effects.body_motion import RobotBodies
from geodrake.identification.logs.case import Case, error_table, series
from geodrake.identification.logs.evidence import fold_agreement
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.identification.logs.model_fit import ModelFit, settled_effect, with_settled_effects
from geodrake.model.effort_signal import signal_of
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Values = dict[str, dict[str, float]]

_SMALL = 1e-4
"""Relative step of numerical derivatives of reported values."""
_LEAST_SIZE, _LEAST_DELAY = 1e-6, 1e-9  # deviations of a parameter, and s, that count as zero


def steps_of(
    case: Case,
    result: SearchResult,
    start: Hypothesis,
    stages: Sequence[StagedFinding],
    *,
    fit: ModelFit,
    end: ErrorTable,
) -> tuple[Step, ...]:
    """Return the steps from the model refitted within its prior to the final fit.

    `start` is the state before the first step, and `end` the held-out errors of the physically
    consistent final fit.
    """
    hypotheses = [start, *(stage.validated for stage in stages)]
    errors = [*(h.held_out for h in hypotheses[:-1]), fit.held_out]
    tables = [*(error_table(case.dataset, held_out) for held_out in errors[:-1]), end]
    parts = unknown_probabilities(result, [stage.finding for stage in stages], tables)
    steps = []
    for i, stage in enumerate(stages):
        finding, before, after = stage.finding, tables[i], tables[i + 1]
        certainty, h, last = finding.certainty, stage.validated, i == len(stages) - 1
        weight = affected_joints(result, finding) / np.maximum(errors[i].mse, np.finfo(float).tiny)
        values, deviations = _values(result, finding, fit)
        rivals = _rivals(certainty, finding, result)
        unknown = parts[i]
        steps.append(
            Step(
                finding.name,
                where_of(result, finding, fit.model.phi),
                before.nrms,
                after.nrms,
                values,
                deviations,
                tuple(dict.fromkeys(name for r in rivals for name in r.names)),
                float(np.clip(certainty.chance, 0.0, 1.0)) * (1.0 - unknown),
                fold_agreement(errors[i].sse @ weight, errors[i + 1].sse @ weight),
                before.by_joint(),
                after.by_joint(),
                rivals,
                unknown,
                _systematic(result, finding, fit),
                () if last else series(h.dataset, h.unknowns, h.held_out, delay=h.delay),
                None if last else _model(case, h, fit),
            )
        )
    return tuple(steps)


def _rivals(certainty: Certainty, finding: Finding, found: SearchResult) -> tuple[FittedRival, ...]:
    nrms = nrms_of(found.model, found.fit)
    return tuple(
        FittedRival(
            rival.effect,
            rival.where,
            (finding.name,),
            rival.nrms,
            nrms,
            rival.probability / max(rival.probability + certainty.probability, 1e-300),
            rival.probability / max(certainty.probability, 1e-300),
        )
        for rival in certainty.rivals
    )


def _model(case: Case, after: Hypothesis, fit: ModelFit) -> RobotModel:
    """Return the model after a step, with the final delays."""
    delays = tuple(each for each in fit.model.effects if each.effect.role is Role.DELAY)
    model = with_settled_effects(searched_model(case.model, after))
    return replace(model, effects=(*model.effects, *delays))


def _values(result: SearchResult, finding: Finding, fit: ModelFit) -> tuple[Values, Values]:
    """Return place -> parameter -> value, and the same of standard deviations, SI units."""
    if finding.name == INERTIA:
        masses = dict(zip(fit.model.bodies, fit.model.phi[:, 0].tolist(), strict=True))
        moved = moved_bodies(result.case, fit.model.phi, finding)
        return {b: {"mass": masses[b], "distance_from_prior": d} for b, d in moved.items()}, {}
    if finding.name == DELAY:
        _, spread = delays_of(result.model, result.fit)
        joints = result.model.dataset.joints
        joint_of = {joint: joints.index(joint) for joint in late_joints(result)}
        joint_of = joint_of or {"all joints": 0}
        delays = fit.model.delays
        values = {place: {"delay": float(delays[j])} for place, j in joint_of.items()}
        return values, {place: {"delay": float(spread[j])} for place, j in joint_of.items()}
    values, deviations = Values(), Values()
    for fitted in _fitted_of(finding, fit):
        reported, spreads = _reported(fitted, fit.model.bodies_at_rest)
        values.setdefault(fitted.effect.place, {}).update(reported)
        deviations.setdefault(fitted.effect.place, {}).update(spreads)
    return values, deviations


def _systematic(result: SearchResult, finding: Finding, fit: ModelFit) -> Values:
    """Return deviations of parameters by effort gains and unexplained errors."""
    values = Values()
    for fitted in _fitted_of(finding, fit):
        effect, span = fitted.effect, fit.unknowns.span(fitted.effect)
        shifts = [_factor(fit.unexplained_covariance[span, span])]
        if effect.role is not Role.SCALE:
            gains = _factor(result.model.gain_moments(result.fit))
            shifts.append(gains @ fit.gain_shifts[:, span])
        # Uncertainty of a servo's delay and damping is uncertainty of these effects.
        for place in effect.where:
            signal = signal_of(result.case.model.effort_signals, place)
            if signal is not None and effect.name in signal.effect_deviations:
                shifts.append(np.array([[signal.effect_deviations[effect.name]]]))
        if any(shift.any() for shift in shifts):
            extra = _deviations_by(fitted, np.concatenate(shifts), fit.model.bodies_at_rest)
            values.setdefault(effect.place, {}).update(extra)
    return values


def vanished(case: Case, finding: Finding, fit: ModelFit) -> Sequence[Term] | None:
    """Return the terms of a finding that are zero in the final fit; None if there is none.

    A delay has no terms. A term of the model itself is a change of its value, which may be to zero.
    """
    if finding.name == DELAY:
        change = np.abs(fit.model.delays - case.model.delays).max()
        return finding.terms if change <= _LEAST_DELAY else None
    zero = {
        fitted.effect
        for fitted in _fitted_of(finding, fit)
        if fitted.deviations is not None
        and (np.abs(fitted.parameters) <= _LEAST_SIZE * fitted.deviations).all()
    }
    return [t for t in finding.terms if t.effect in zero and not t.is_own] or None


def _fitted_of(finding: Finding, fit: ModelFit) -> list[FittedEffect]:
    return [fitted for fitted in fit.model.effects if fitted.effect in finding.effects]


def _reported(
    fitted: FittedEffect, bodies: RobotBodies
) -> tuple[dict[str, float], dict[str, float]]:
    """Return reported values and standard deviations of an effect, by name, SI units."""
    fitted = settled_effect(fitted, bodies)
    unknown = np.full(len(fitted.parameters), np.nan)
    deviations = unknown if fitted.deviations is None else fitted.deviations
    return fitted.effect.reported(fitted.parameters, deviations)


def _deviations_by(fitted: FittedEffect, shifts: Array, bodies: RobotBodies) -> dict[str, float]:
    """Return first-order deviations of an effect's reported values by causes other than noise.

    `shifts` (s, k) are the changes of its parameters by s independent causes, such as a gain that
    is off by one standard deviation. Values without a deviation, such as shapes, are left out.
    """
    values, deviations = _reported(fitted, bodies)
    squares = {name: 0.0 for name in values if name in deviations}
    for shift in _SMALL * shifts:
        moved, _ = _reported(replace(fitted, parameters=fitted.parameters + shift), bodies)
        for name in squares:
            squares[name] += ((moved[name] - values[name]) / _SMALL) ** 2
    return {name: float(np.sqrt(square)) for name, square in squares.items()}


def _factor(covariance: Array) -> Array:
    """Return (k, k) independent shifts as rows, with a covariance (k, k)."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T)
