"""A hypothesis: the model with certain effects, fitted and validated fold by fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.identification.logs.cross_validation import CrossValidation, HeldOut
from geodrake.identification.logs.dataset import Dataset, Delay
from geodrake.identification.logs.evidence import effective_samples_of_each
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.inertia import PARAMETERS_PER_BODY

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_SETTLED = 0.3  # weights are settled if they change by less than this share
_MOST_REFITS = 8
_FIRST_SHARE = 0.05  # of the samples that count as effective ones in the first fit


@dataclass(frozen=True, eq=False)
class Hypothesis(Short):
    """The model with the effects among `unknowns`, and what it gets wrong on held-out data."""

    dataset: Dataset
    unknowns: Unknowns
    weights: Array  # (nv,) of squared residuals: effective share of the samples / mse
    delay: tuple[int, ...]  # index of the dataset's effort delay of each joint
    looseness: float  # factor by which the prior of the bodies is widened
    cv: CrossValidation
    effective: Array  # (nv,) effective number of samples

    @property
    def held_out(self) -> HeldOut:
        """Held-out errors."""
        return self.cv.held_out

    @property
    def nrms(self) -> float:
        """Held-out error over effort standard deviation, root mean square over joints."""
        return float(np.sqrt(np.mean(self.held_out.mse / self.dataset.effort_std**2)))

    def loosened(self, factor: float) -> Hypothesis:
        """Return this hypothesis with the prior of bodies `factor` times as wide, refitted."""
        unknowns = self.unknowns.loosened(factor, PARAMETERS_PER_BODY * len(self.dataset.bodies))
        return settle(replace(self, unknowns=unknowns, looseness=self.looseness * factor))

    def moved_columns(self, dataset: Dataset) -> Indices:
        """(p,) columns of the unknowns in another dataset of the same bodies and effects."""
        columns = [np.arange(len(dataset.bodies) * PARAMETERS_PER_BODY)]
        columns += [dataset.effect_columns(effect) for effect in self.unknowns.effects]
        return np.concatenate(columns)

    def moved(self, dataset: Dataset, *, delay: Delay, iterations: int = 2) -> Hypothesis:
        """Return this hypothesis on another dataset of the same bodies and effects, refitted."""
        unknowns = replace(self.unknowns, columns=self.moved_columns(dataset))
        delays = dataset.delay_of_each(delay)
        moved = replace(self, dataset=dataset, unknowns=unknowns, delay=delays)
        return settle(moved, iterations=iterations)


def residual_blocks(
    dataset: Dataset, columns: Indices, x: Array, *, delay: Delay = 0
) -> list[list[Array]]:
    """Return held-out residuals: per joint, one array (K_i,) per block.

    Args:
        columns: (p,) columns in use.
        x: (F, p) parameters for each fold.
    """
    return [
        [
            rows.b[:, late] - rows.A @ own
            for own, blocks in zip(data.parameters(columns, x), data.rows, strict=True)
            for rows in blocks
        ]
        for data, late in zip(dataset.data, dataset.delay_of_each(delay), strict=True)
    ]


def effective_per_joint(dataset: Dataset, columns: Indices, x: Array, *, delay: Delay = 0) -> Array:
    """Return (nv,) effective samples of the held-out residuals, as in `residual_blocks`."""
    blocks = residual_blocks(dataset, columns, x, delay=delay)
    return effective_of_rows(blocks, dataset.samples.sum(axis=0))


def effective_of_rows(blocks: Sequence[Sequence[Array]], rows: Array) -> Array:
    """Return (nv,) effective samples of rows (nv,), by the residuals of those that are kept."""
    kept = np.array([max(1, sum(map(len, joint))) for joint in blocks])
    return effective_samples_of_each(blocks) * (rows / kept)


def settle(hypothesis: Hypothesis, *, iterations: int = 2) -> Hypothesis:
    """Refit with weights that follow from the held-out residuals themselves.

    The weight of a joint is the inverse of its squared error (half its own, half what the same
    relative error of all joints would be, so that no joint is given up), reduced to its effective
    samples so that coloured residuals do not outvote the prior.

    Args:
        iterations: How often effective samples are counted at most, each time with weights that
            agree with the errors; fewer where the weights stay.
    """
    dataset, unknowns, delay = hypothesis.dataset, hypothesis.unknowns, hypothesis.delay
    samples, variance = dataset.samples.sum(axis=0), dataset.effort_std**2
    weights, effective = hypothesis.weights, hypothesis.effective
    x, mse = unknowns.mean, hypothesis.held_out.mse

    def deserved(cv: CrossValidation) -> Array:
        mse = np.maximum(cv.held_out.mse, 1e-12 * variance)
        return np.asarray(effective / samples / np.sqrt(mse * np.mean(mse / variance) * variance))

    def counted(cv: CrossValidation) -> Array:
        return effective_per_joint(dataset, unknowns.columns, cv.held_out.x, delay=delay)

    for _ in range(iterations):
        for _ in range(_MOST_REFITS):
            power = weights * samples * mse * dataset.inertias(unknowns.columns, x) ** 2
            unknowns = unknowns.pulled(dataset, x, power)
            cv = CrossValidation(dataset, unknowns, weights, delay=delay, physical=False)
            x, mse = cv.held_out.x.mean(0), cv.held_out.mse
            before, weights = weights, deserved(cv)
            if _alike(weights, before):
                break
        effective = counted(cv)
        before, weights = weights, deserved(cv)
        if _alike(weights, before):
            break
    if not cv.is_physical:
        cv = CrossValidation(dataset, unknowns, cv.weights, delay=delay)
        effective = counted(cv)
        weights = deserved(cv)
    return replace(hypothesis, unknowns=unknowns, weights=weights, cv=cv, effective=effective)


def most_likely(settled: Hypothesis) -> tuple[Unknowns, Array]:
    """Return unknowns and weights (nv,) of maximum likelihood, for fits with their information.

    Weights are those of the residuals of a settled hypothesis, each joint by its own; the pull of
    joints without motors is what goes with them.
    """
    dataset, unknowns, held_out = settled.dataset, settled.unknowns, settled.held_out
    for _ in range(_MOST_REFITS if dataset.passive_inertia is not None else 0):
        samples, x = held_out.samples.sum(0), held_out.x.mean(0)
        weights = settled.effective / samples / held_out.mse
        power = settled.effective * dataset.inertias(unknowns.columns, x) ** 2
        unknowns = unknowns.pulled(dataset, x, power)
        cv = CrossValidation(dataset, unknowns, weights, delay=settled.delay, physical=False)
        before, held_out = held_out, cv.held_out
        if _alike(held_out.mse, before.mse):
            break
    return unknowns, settled.effective / held_out.samples.sum(0) / held_out.mse


def _alike(weights: Array, before: Array) -> bool:
    return bool(np.all(np.abs(np.log(weights / before)) < _SETTLED))


def first_hypothesis(dataset: Dataset, unknowns: Unknowns, *, delay: Delay = 0) -> Hypothesis:
    """Return the model as it came, its parameters refitted within their prior."""
    weights = _FIRST_SHARE / dataset.effort_std**2
    cv = CrossValidation(dataset, unknowns, weights, delay=delay)
    effective = _FIRST_SHARE * dataset.samples.sum(0)
    first = Hypothesis(dataset, unknowns, weights, cv.delay, 1.0, cv, effective)
    return settle(first, iterations=3)
