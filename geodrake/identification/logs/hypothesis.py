"""A hypothesis: the model with certain effects, fitted and validated fold by fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import FIXED
from geodrake.identification.logs.cross_validation import CrossValidation, HeldOut
from geodrake.identification.logs.dataset import Dataset, Delay, JointData
from geodrake.identification.logs.evidence import effective_samples_of_each
from geodrake.identification.logs.unknowns import Unknowns, effect_prior
from geodrake.inertia import PARAMETERS_PER_BODY

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_ROUNDED = 1.0 + 1e-9  # what is narrowed to a width may be wider by rounding

_AT_ONCE = 16
"""So many fits have their residuals computed together."""

_SETTLED = 0.3
"""Weights are settled if they change by less than this share."""
_MOST_REFITS = 8
_FIRST_SHARE = 0.05
"""A fit begins with this share of the samples as effective ones."""


@dataclass(frozen=True, eq=False)
class Hypothesis(Short):
    """The model with the effects among `unknowns`, and what it gets wrong on held-out data.

    Attributes:
        dataset: The reduced logs.
        unknowns: What the fit may move.
        weights: (nv,) weight of a squared residual: effective share of the samples / mse.
        delay: Index of the dataset's effort delay, for every joint.
        looseness: Factor by which the inertial prior is widened.
        cv: The fits.
        effective: (nv,) effective number of samples.
    """

    dataset: Dataset
    unknowns: Unknowns
    weights: Array
    delay: tuple[int, ...]
    looseness: float
    cv: CrossValidation
    effective: Array

    @property
    def held_out(self) -> HeldOut:
        """Held-out errors."""
        return self.cv.held_out

    @property
    def nrms(self) -> float:
        """Held-out error over effort standard deviation, root mean square over joints."""
        return float(np.sqrt(np.mean(self.held_out.mse / self.dataset.effort_std**2)))

    @property
    def has_fixed_bodies(self) -> bool:
        """Return whether bodies stay as the model has them."""
        return self.looseness <= _ROUNDED * FIXED

    def with_effects(self, effects: Sequence[Effect]) -> Hypothesis:
        """This hypothesis and further effects, refitted."""
        unknowns = self.unknowns
        for effect in effects:
            columns = self.dataset.effect_columns(effect)
            mean, information = effect_prior(self.dataset, effect)
            unknowns = unknowns.with_effect(effect, columns, information, mean)
        return settle(replace(self, unknowns=unknowns))

    def without(self, effects: Sequence[Effect]) -> Hypothesis:
        """This hypothesis less some effects, refitted."""
        return settle(replace(self, unknowns=self._less(effects)))

    def _less(self, gone: Sequence[Effect]) -> Unknowns:
        unknowns = self.unknowns
        for effect in gone:
            unknowns = unknowns.without_effect(effect)
        return unknowns

    def loosened(self, factor: float) -> Hypothesis:
        """This hypothesis with the inertial prior `factor` times as wide, refitted."""
        unknowns = self.unknowns.loosened(factor, 10 * len(self.dataset.bodies))
        return settle(replace(self, unknowns=unknowns, looseness=self.looseness * factor))

    def moved_columns(self, dataset: Dataset) -> Indices:
        """(p,) columns of the unknowns in another dataset of the same bodies and effects."""
        columns = [np.arange(len(dataset.bodies) * PARAMETERS_PER_BODY)]
        columns += [dataset.effect_columns(effect) for effect in self.unknowns.effects]
        return np.concatenate(columns)

    def moved(self, dataset: Dataset, *, delay: Delay, iterations: int = 2) -> Hypothesis:
        """This hypothesis on another dataset of the same bodies that has its effects, refitted.

        Args:
            dataset: The dataset.
            delay: Index of the delay among those of the dataset.
            iterations: As in `settle`.
        """
        unknowns = replace(self.unknowns, columns=self.moved_columns(dataset))
        delays = dataset.delay_of_each(delay)
        moved = replace(self, dataset=dataset, unknowns=unknowns, delay=delays)
        return settle(moved, iterations=iterations)


def residual_blocks(
    dataset: Dataset, columns: Indices, x: Array, *, delay: Delay = 0
) -> list[list[Array]]:
    """Held-out residuals: per joint, one array per block.

    Args:
        dataset: The reduced logs.
        columns: (p,) columns in use.
        x: (F, p) parameters for each fold.
        delay: Index of the effort column.
    """
    return [
        [block[:, 0] for block in _residuals(data, late, [(columns, x)])]
        for data, late in zip(dataset.data, dataset.delay_of_each(delay), strict=True)
    ]


def effective_per_joint(
    dataset: Dataset, columns: Indices, held_out: HeldOut, *, delay: Delay = 0
) -> Array:
    """(nv,) effective samples of the held-out residuals.

    Args:
        dataset: The reduced logs.
        columns: (p,) columns that were fitted.
        held_out: The fit without each fold.
        delay: Index of the effort column that was fitted.
    """
    return effective_of_each(dataset, [(columns, held_out.x)], delay=delay)[0]


def effective_of_each(
    dataset: Dataset, fits: Sequence[tuple[Indices, Array]], *, delay: Delay = 0
) -> Array:
    """(m, nv) effective samples of the held-out residuals of each of m fits.

    Args:
        dataset: The reduced logs.
        fits: Columns (p,) in use and parameters (F, p) for each fold.
        delay: Index of the effort column.
    """
    delays, found = dataset.delay_of_each(delay), [np.empty((0, len(dataset.joints)))]
    samples = dataset.samples.sum(axis=0)
    for first in range(0, len(fits), _AT_ONCE):
        part = fits[first : first + _AT_ONCE]
        blocks = [_residuals(*joint, part) for joint in zip(dataset.data, delays, strict=True)]
        kept = np.array([max(1, sum(map(len, joint))) for joint in blocks])
        found.append(effective_samples_of_each(blocks).T * (samples / kept))
    return np.concatenate(found)


def _residuals(data: JointData, delay: int, fits: Sequence[tuple[Indices, Array]]) -> list[Array]:
    """Held-out residuals (K_i, m) of m fits at a joint, one array per block."""
    x = np.stack([data.parameters(columns, values) for columns, values in fits], axis=-1)
    return [
        rows.b[:, delay, None] - rows.A @ x[fold]
        for fold, blocks in enumerate(data.rows)
        for rows in blocks
    ]


def settle(hypothesis: Hypothesis, *, iterations: int = 2) -> Hypothesis:
    """Refit with weights that follow from the held-out residuals themselves.

    The weight of a joint is the inverse of its squared error (half its own, half what the same
    relative error of all joints would be, so that no joint is given up), reduced to its effective
    samples so that coloured residuals do not outvote the prior.

    Args:
        hypothesis: The hypothesis.
        iterations: How often effective samples are counted at most, each time with weights that
            agree with the errors; fewer where the weights stay.
    """
    dataset, unknowns, delay = hypothesis.dataset, hypothesis.unknowns, hypothesis.delay
    weights, effective = hypothesis.weights, hypothesis.effective
    samples = dataset.samples.sum(0)
    for _ in range(iterations):
        cv, weights = _refitted(hypothesis, weights, effective / samples)
        effective = effective_per_joint(dataset, unknowns.columns, cv.held_out, delay=delay)
        before, weights = weights, _deserved_weights(dataset, cv.held_out, effective / samples)
        if _alike(weights, before):
            break
    # Bodies that are fixed are those of the model; payloads beside them are to be physical still.
    only_bodies = len(unknowns.inertia_blocks) == len(dataset.bodies)
    physical = cv if hypothesis.has_fixed_bodies and only_bodies else _physical(hypothesis, cv)
    if physical is not cv:
        cv = physical
        effective = effective_per_joint(dataset, unknowns.columns, cv.held_out, delay=delay)
        weights = _deserved_weights(dataset, cv.held_out, effective / samples)
    return replace(hypothesis, weights=weights, cv=cv, effective=effective)


def _physical(hypothesis: Hypothesis, cv: CrossValidation) -> CrossValidation:
    """The fits with physical bodies, begun at those of the hypothesis if it has the same folds."""
    was, start = hypothesis.cv, None
    if len(was.held_out.x) == len(hypothesis.dataset.folds):
        start = hypothesis.unknowns.carried(was.unknowns, was.held_out.x)
    return cv.physical(start)


def _refitted(
    hypothesis: Hypothesis, weights: Array, share: Array
) -> tuple[CrossValidation, Array]:
    """The fits with weights (nv,) that agree with their errors, at effective shares (nv,)."""
    for _ in range(_MOST_REFITS):
        cv = CrossValidation(
            hypothesis.dataset,
            hypothesis.unknowns,
            weights,
            delay=hypothesis.delay,
            physical=False,
        )
        before, weights = weights, _deserved_weights(hypothesis.dataset, cv.held_out, share)
        if _alike(weights, before):
            break
    return cv, weights


def _deserved_weights(dataset: Dataset, held_out: HeldOut, share: Array) -> Array:
    """(nv,) weights of squared residuals that held-out errors deserve; see `settle`.

    Args:
        dataset: The reduced logs.
        held_out: Errors.
        share: (nv,) effective samples, as a share of all.
    """
    mse = np.maximum(held_out.mse, 1e-12 * dataset.effort_std**2)
    relative = np.mean(mse / dataset.effort_std**2)
    return np.asarray(share / np.sqrt(mse * relative * dataset.effort_std**2))


def _alike(weights: Array, before: Array) -> bool:
    return bool(np.all(np.abs(np.log(weights / before)) < _SETTLED))


def first_hypothesis(dataset: Dataset, unknowns: Unknowns, *, delay: Delay = 0) -> Hypothesis:
    """Return the model as it came, its parameters refitted within their prior.

    Args:
        dataset: The reduced logs.
        unknowns: The model's parameters, with their prior.
        delay: Index of the effort column to fit.
    """
    weights = _FIRST_SHARE / dataset.effort_std**2
    cv = CrossValidation(dataset, unknowns, weights, delay=delay)
    effective = _FIRST_SHARE * dataset.samples.sum(0)
    first = Hypothesis(dataset, unknowns, weights, cv.delay, 1.0, cv, effective)
    return settle(first, iterations=3)
