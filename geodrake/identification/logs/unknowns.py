"""Unknowns of a fit: columns of a dataset with prior, bounds and physical blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import LARGEST
from geodrake.identification.logs.dataset import Dataset, Delay, is_body
from geodrake.identification.problem import FitProblem
from geodrake.inertia import PARAMETERS_PER_BODY, from_mass_com_inertia, pullback_metric
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Unknown parameters of a fit, p in all."""

    columns: Indices  # (p,) of the dataset; a link and its payload share columns
    mean: Array  # (p,) prior mean
    information: Array  # (p, p) prior information, inverse of the prior covariance
    lower: Array  # (p,) lower bounds
    upper: Array  # (p,) upper bounds
    inertia_blocks: tuple[int, ...]  # first unknown of every physical body
    effects: tuple[Effect, ...] = ()  # effects among the unknowns
    starts: tuple[int, ...] = ()  # first unknown of every effect
    pull: Array | float = 0.0  # (p,) added to the right-hand side; see `Dataset.passive_pull`

    def on(self, dataset: Dataset) -> Unknowns:
        """Return these unknowns in the columns of another dataset of the same bodies."""
        bodies = np.arange(len(dataset.bodies) * PARAMETERS_PER_BODY)
        effects = [dataset.effect_columns(effect) for effect in self.effects]
        return replace(self, columns=np.concatenate([bodies, *effects]))

    def pulled(self, dataset: Dataset, x: Array, power: Array) -> Unknowns:
        """Return these unknowns with the pull at parameters (p,); see `Dataset.passive_pull`."""
        return replace(self, pull=dataset.passive_pull(self.columns, x, power))

    def pulled_mean(self, share: float) -> Array:
        """Return the prior mean (p,) shifted by a share of the pull."""
        if not np.any(self.pull):
            return self.mean
        return self.mean + share * np.linalg.solve(self.information, self.pull)

    @property
    def is_inertial(self) -> NDArray[np.bool_]:
        """(p,) whether an unknown belongs to a body."""
        inertial = np.zeros(len(self.columns), bool)
        for start in self.inertia_blocks:
            inertial[start : start + PARAMETERS_PER_BODY] = True
        return inertial

    @property
    def scalar_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (p,), infinite for those of bodies, which P ≻ 0 bounds."""
        inertial = self.is_inertial
        return np.where(inertial, -np.inf, self.lower), np.where(inertial, np.inf, self.upper)

    def span(self, effect: Effect) -> slice:
        """Return the slice of an effect's parameters."""
        start = self.starts[self.effects.index(effect)]
        return slice(start, start + len(effect.parameters))

    def with_effect(
        self, effect: Effect, columns: Indices, information: Array, mean: Array | None = None
    ) -> Unknowns:
        """Return these unknowns and an effect of k columns, prior information (k, k), mean (k,)."""
        start, k = len(self.columns), len(effect.parameters)
        return Unknowns(
            np.concatenate([self.columns, columns]),
            np.concatenate([self.mean, np.zeros(k) if mean is None else mean]),
            block_diag(self.information, information),
            np.concatenate([self.lower, [p.lower for p in effect.parameters]]),
            np.concatenate([self.upper, [p.upper for p in effect.parameters]]),
            (*self.inertia_blocks, start) if is_body(effect) else self.inertia_blocks,
            (*self.effects, effect),
            (*self.starts, start),
            np.append(self.pull, np.zeros(k)) if np.ndim(self.pull) else self.pull,
        )

    def released(self, effect: Effect, information: Array, mean: Array | None = None) -> Unknowns:
        """Return these unknowns with another prior of one effect, independent of the others.

        The new prior has `information` (k, k) and a mean (k,), by default zero.
        """
        span = self.span(effect)
        inside = np.zeros(len(self.columns), bool)
        inside[span] = True
        cross = self.information[np.ix_(~inside, inside)]
        prior = np.zeros_like(self.information)
        # The others keep their marginal information.
        prior[np.ix_(~inside, ~inside)] = self.information[np.ix_(~inside, ~inside)] - (
            cross @ np.linalg.solve(self.information[span, span], cross.T)
        )
        prior[span, span] = information
        means = self.mean.copy()
        means[span] = 0.0 if mean is None else mean
        return replace(self, mean=means, information=prior)

    def loosened(self, factor: float, inertial: int) -> Unknowns:
        """Return these unknowns with the prior of the first `inertial` ones widened by a factor."""
        scale = np.ones(len(self.columns))
        scale[:inertial] = 1.0 / factor
        return replace(self, information=self.information * scale[:, None] * scale)


def inertial_unknowns(phi: Array, information: Array) -> Unknowns:
    """Return all bodies as unknowns with prior mean φ (nb, 10) and information (10·nb, 10·nb)."""
    p = phi.size
    unbounded = np.full(p, np.inf)
    blocks = tuple(range(0, p, PARAMETERS_PER_BODY))
    return Unknowns(np.arange(p), phi.ravel().copy(), information, -unbounded, unbounded, blocks)


def pullback_information(phi: Array, spread: float) -> Array:
    """Return the prior information G(φ)/spread² (10·nb, 10·nb) about bodies φ (nb, 10).

    `spread` is the standard deviation of the geometric distance along any direction: 0.1 means that
    mass and lengths are known to about 10 %. G is the metric of [Lee2019] Eq. (3.5.51).
    """
    return block_diag(*pullback_metric(phi)) / spread**2


def payload_reference(phi: Array) -> Array:
    """Return a typical payload (10,) of a robot with bodies φ (nb, 10).

    It has a tenth of the robot's mass, and a third of the radius of gyration of its bodies about
    their origins.
    """
    mass = phi[:, 0].sum()
    square = 0.5 * phi[:, 4:7].sum() / mass
    return from_mass_com_inertia(0.1 * mass, np.zeros(3), 0.1 * mass * square / 9.0 * np.eye(3))


def effect_prior(dataset: Dataset, effect: Effect) -> tuple[Array, Array]:
    """Return the weak prior mean (k,) and information (k, k) of a new effect.

    A payload has an uncertainty of 10 in geometric distance around the dataset's `payload`. Any
    other parameter causes at most `LARGEST` times the standard deviation of its joint's effort, and
    is bounded by its own spread.
    """
    if is_body(effect):
        return np.zeros(PARAMETERS_PER_BODY), pullback_information(dataset.payload[None], 10.0)
    peak = dataset.column_peak[dataset.effect_columns(effect)] / LARGEST
    usual = np.array([parameter.usual for parameter in effect.parameters])
    spread = np.array([parameter.spread for parameter in effect.parameters])
    return usual, np.diag(np.maximum(peak**2, np.maximum(spread**-2.0, 1e-300)))


def fold_factors(
    dataset: Dataset, columns: Indices, weights: Array, *, delay: Delay = 0
) -> list[Array]:
    """Return the triangular factor (p + 1, p + 1) of all joints' weighted [A | b] of each fold.

    `weights` (nv,) are those of the joints' squared residuals, and `columns` (p,) those of A. Each
    joint is factored first, as few columns affect it.
    """
    blocks = [list[Array]() for _ in dataset.folds]
    delays = dataset.delay_of_each(delay)
    for data, weight, delay_index in zip(dataset.data, weights, delays, strict=True):
        seen = np.append(np.flatnonzero(data.local(columns) >= 0), len(columns))
        factors = data.factors_of(columns[seen[:-1]], delay_index)
        for fold, rows in zip(blocks, factors, strict=True):
            factor = np.linalg.qr(rows, "r") if len(rows) > len(seen) else rows
            wide = np.zeros((len(factor), len(columns) + 1))
            wide[:, seen] = np.sqrt(weight) * factor
            fold.append(wide)
    return [triangular_factor([np.vstack(fold)]) for fold in blocks]


def fit_problem(
    dataset: Dataset,
    unknowns: Unknowns,
    weights: Array,
    *,
    without: int | None = None,
    factors: Sequence[Array] | None = None,
) -> FitProblem:
    """Return the convex program of a fit of the unknowns to all folds, or to all but one.

    `weights` (nv,) are those of the joints' squared residuals, and `factors` those of
    `fold_factors`, if already computed.
    """
    kept = [fold for fold in range(len(dataset.folds)) if fold != without]
    if factors is None:
        factors = fold_factors(dataset, unknowns.columns, weights)
    triangle = triangular_factor([factors[fold] for fold in kept])
    lower, upper = unknowns.scalar_bounds
    bodies = unknowns.inertia_blocks if np.any(unknowns.pull) else ()  # may become unphysical
    reference = {k: unknowns.mean[k : k + PARAMETERS_PER_BODY] for k in bodies}
    reference |= {unknowns.span(e).start: dataset.payload for e in unknowns.effects if is_body(e)}
    return FitProblem(
        factor=triangle,
        inertia_blocks=unknowns.inertia_blocks,
        prior_mean=unknowns.pulled_mean(float(dataset.fold_shares[kept].sum())),
        prior_information=unknowns.information,
        lower=lower,
        upper=upper,
        reference=reference,
    )
