"""What is identifiable from given logs: directions, bodies and effects, [Lee2019] §4.5.1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import function
from geodrake.effects import Effect
from geodrake.excitation.identifiability.results import (
    IdentifiableBlock,
    LogIdentifiability,
    ParameterCombination,
)
from geodrake.excitation.identifiable import IdentifiableParameters, identifiable_parameters
from geodrake.excitation.target import Target, make_target
from geodrake.identification.logs.case import Case, open_case
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.hypothesis import first_hypothesis, settle
from geodrake.identification.logs.log_fits import log_unknowns
from geodrake.identification.models.identify import with_effects
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]

_ITERATIONS = 6  # refits until the weights of the joints stay
_NOTHING = 1e-9  # share of a direction that is rounding


def log_identifiability(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    effects: Sequence[Effect] = (),
    threshold: float = 1e-2,
    noise: ArrayLike | None = None,
    bandwidth: float | None = None,
    blocks: int | None = None,
    progress: Callable[[str], None] = lambda words: None,
) -> LogIdentifiability:
    """What is identifiable of a model from logs's inertias and effects.

    Args:
        model: The model; its parameters are the nominal ones.
        logs: Logs or their files.
        effects: Effects to identify beside those of the model.
        threshold: ε_λ, largest variance of what counts as identifiable; 10⁻² is a deviation of
            a tenth.
        noise: Deviation of a filtered effort: one, or one a joint, N·m or N. By default what the
            refitted model leaves on held-out data, counted by effective samples.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Blocks into which every log is cut for validation.
        progress: Called with what is going on, in words.

    Raises:
        LogError: A log cannot be used.
        ArgumentError: The model has one of the effects already, the noise is not positive, or the
            threshold keeps nothing.
    """
    function(progress, "progress")
    wanted = with_effects(model, effects)
    case = open_case(wanted, logs, candidates=False, bandwidth=bandwidth, blocks=blocks)
    progress("Fitting, for the noise and the sizes of effects")
    fitted, left = _fitted(case)
    target = make_target(fitted, noise=left if noise is None else noise)
    progress("Decomposing")
    factor = _factor(case, target, target.noise)
    found = identifiable_parameters(target, factor, threshold=threshold)
    floor = np.maximum(case.dataset.noise_floor, 1e-6 * case.dataset.effort_std)
    ideal = identifiable_parameters(target, _factor(case, target, floor), kept=len(found.variances))
    bodies, parameters = _blocks(found)
    return LogIdentifiability(
        model=fitted,
        identifiable=found,
        bodies=bodies,
        effects=parameters,
        combinations=_combinations(found),
        noise=target.noise,
        floor=case.dataset.noise_floor,
        floor_variances=ideal.variances,
        samples=case.dataset.samples.sum(0),
        notes=case.notes,
    )


def _fitted(case: Case) -> tuple[RobotModel, Array]:
    """The model with effects of unknown size fitted, and the noise (nv,) of a sample.

    The noise is the RMS of what the refitted model leaves, as if every sample were independent.
    """
    dataset, model = case.dataset, case.model
    unknowns = log_unknowns(dataset, model)
    found = settle(first_hypothesis(dataset, unknowns), iterations=_ITERATIONS)
    mse = np.maximum(found.held_out.mse, dataset.noise_floor**2)
    mse = np.maximum(mse, 1e-12 * dataset.effort_std**2)
    samples = dataset.samples.sum(0)
    noise = np.sqrt(mse * samples / np.minimum(found.effective, samples))
    x = found.cv.fit_all
    effects = []
    for known in model.effects:
        values = known.parameters
        if known.effect in unknowns.effects and not is_payload(known.effect):
            values = np.where(values, values, x[unknowns.span(known.effect)])
        effects.append(replace(known, parameters=values))
    return replace(model, effects=tuple(effects)), np.asarray(noise)


def _factor(case: Case, target: Target, noise: Array) -> Array:
    """(p, p) triangular factor of the whitened, filtered regressor in the target's columns."""
    dataset = case.dataset
    columns = [target.columns, *(dataset.effect_columns(f.effect) for f in target.further)]
    wanted = np.concatenate(columns)
    rows = []
    for data, deviation in zip(dataset.data, noise, strict=True):
        local = data.local(wanted)
        stacked = data.factors.reshape(-1, data.factors.shape[2])
        here = np.zeros((len(stacked), len(wanted)))
        here[:, local >= 0] = stacked[:, local[local >= 0]]
        rows.append(here / deviation)
    return triangular_factor(rows)


def _blocks(
    found: IdentifiableParameters,
) -> tuple[tuple[IdentifiableBlock, ...], tuple[IdentifiableBlock, ...]]:
    """Bodies, and parameters of effects."""
    target = found.target
    counts, possible = found.counts, found.shares.sum(axis=1)
    count = len(target.columns) // PARAMETERS_PER_BODY
    numbers = zip(counts.tolist(), possible.tolist(), strict=True)
    bodies = tuple(
        IdentifiableBlock(name, (), *pair)
        for name, pair in zip(target.bodies, numbers, strict=False)
    )
    parameters, at = [], len(target.columns)
    for fitted in target.further:
        effect, several = fitted.effect, len(fitted.effect.parameters) > 1
        for parameter, value in zip(effect.parameters, fitted.parameters, strict=True):
            k = count + at - len(target.columns)
            parameters.append(
                IdentifiableBlock(
                    f"{parameter.name} of {effect.name}" if several else effect.name,
                    effect.where,
                    count=float(counts[k]),
                    possible=float(possible[k]),
                    value=float(value),
                    deviation=_deviation(found.directions[at], found.variances),
                    effect=effect.name,
                    parameter=parameter.name,
                )
            )
            at += 1
    return bodies, tuple(parameters)


def _combinations(found: IdentifiableParameters) -> tuple[ParameterCombination, ...]:
    """Base parameters with their deviations."""
    target, rows = found.target, found.base_directions
    sizes = np.linalg.norm(rows, axis=1)  # (H₀⁻¹)ᵢᵢ is what one unit of length allows
    values = target.base.values(target.prior)
    deviations = [_deviation(row, found.variances) for row in rows]
    return tuple(
        ParameterCombination(words, float(value), deviation, float(deviation / size))
        for words, value, deviation, size in zip(
            target.labels, values, deviations, sizes, strict=True
        )
    )


def _deviation(row: Array, variances: Array) -> float:
    """Deviation of row · w for w with independent entries; infinite variances count if seen."""
    seen = np.abs(row) > _NOTHING * np.abs(row).max(initial=0.0)
    return float(np.sqrt(np.sum(row[seen] ** 2 * variances[seen])))
