"""A hypothesis: the model with certain effects, fitted and validated fold by fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import FIXED, IMPROBABLE
from geodrake.identification.logs.cross_validation import CrossValidation, HeldOut
from geodrake.identification.logs.dataset import Dataset, Delay, JointData, Settled
from geodrake.identification.logs.evidence import (
    chi2_tail,
    effective_samples_of_each,
    log_likelihood_gain,
)
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
        released: Effects of the model whose parameters were let go.
    """

    dataset: Dataset
    unknowns: Unknowns
    weights: Array
    delay: tuple[int, ...]
    looseness: float
    cv: CrossValidation
    effective: Array
    released: tuple[Effect, ...] = ()
    _stripped: dict[tuple[Effect, ...], Hypothesis] = field(
        default_factory=dict, init=False, repr=False
    )

    @property
    def held_out(self) -> HeldOut:
        """Held-out errors."""
        return self.cv.held_out

    @property
    def nrms(self) -> float:
        """Held-out error over effort standard deviation, root mean square over joints."""
        return float(np.sqrt(np.mean(self.held_out.mse / self.dataset.effort_std**2)))

    def _loss_of(self, held_out: HeldOut) -> float:
        """Held-out squared error of all folds, each joint's over the variance of its effort."""
        return float((held_out.sse / self.dataset.effort_std**2).sum())

    @property
    def has_fixed_bodies(self) -> bool:
        """Whether bodies stay as the model has them."""
        return self.looseness <= _ROUNDED * FIXED

    @property
    def inertial_penalty(self) -> float:
        """How improbable the bodies are, as twice a log-likelihood.

        The width of the inertial prior is not known well. So the squared distance q from the
        model's bodies, by the assumed one, counts as by a t distribution: d log(1 + q / d).
        """
        q, d = self._assumed_distance, PARAMETERS_PER_BODY * len(self.dataset.bodies)
        return float(d * np.log1p(q / d))

    @property
    def is_within_prior(self) -> bool:
        """Whether the bodies are where they may well be, by what is known about them."""
        d = PARAMETERS_PER_BODY * len(self.dataset.bodies)
        return chi2_tail(self._assumed_distance, d) > IMPROBABLE

    @property
    def _assumed_distance(self) -> float:
        """`squared_distance` by the assumed width of the prior."""
        return self.looseness**2 * self.squared_distance()

    def squared_distance(self, x: Array | None = None) -> float:
        """How improbable the bodies are: their squared distance from the model's by the prior.

        Args:
            x: (p,) parameters of a fit, the inertial ones first; those of the hypothesis if None.
        """
        d = PARAMETERS_PER_BODY * len(self.dataset.bodies)
        step = (self.cv.fit_all() if x is None else x)[:d] - self.unknowns.mean[:d]
        return float(step @ self.unknowns.information[:d, :d] @ step)

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

    def stripped(self, *gone: Effect) -> Hypothesis:
        """This hypothesis less some of its effects, refitted with the weights of its fits.

        The last one is kept, as several questions are asked of it.
        """
        if gone not in self._stripped:
            self._stripped.clear()
            unknowns, kept = self._less(gone), np.ones(len(self.unknowns.columns), bool)
            for effect in gone:
                kept[self.unknowns.span(effect)] = False
            cv = self.cv.less(unknowns, np.flatnonzero(kept))
            self._stripped[gone] = replace(self, unknowns=unknowns, cv=cv)
        return self._stripped[gone]

    def exchanged(self, gone: Sequence[Effect], come: Sequence[Effect]) -> Hypothesis:
        """This hypothesis with effects in the place of others, refitted.

        The weights begin with those of this hypothesis, so that both are compared fairly.

        Args:
            gone: Some of the effects.
            come: Effects that replace them.
        """
        return replace(self, unknowns=self._less(gone)).with_effects(come)

    def _less(self, gone: Sequence[Effect]) -> Unknowns:
        unknowns = self.unknowns
        for effect in gone:
            unknowns = unknowns.without_effect(effect)
        return unknowns

    def loosened(self, factor: float) -> Hypothesis:
        """This hypothesis with the inertial prior `factor` times as wide, refitted."""
        unknowns = self.unknowns.loosened(factor, 10 * len(self.dataset.bodies))
        return settle(replace(self, unknowns=unknowns, looseness=self.looseness * factor))

    def with_widths(self, widths: Sequence[float]) -> list[Hypothesis]:
        """This hypothesis with other widths of the inertial prior, refitted.

        Only those are returned that lower its errors in a quick fit: with the weights as they are,
        and bodies that need not be physical.

        Args:
            widths: Widths as shares of the assumed one.
        """
        before, found = self.held_out, []
        for factor in (width / self.looseness for width in widths if width != self.looseness):
            unknowns = self.unknowns.loosened(factor, 10 * len(self.dataset.bodies))
            quick = CrossValidation(
                self.dataset, unknowns, self.weights, delay=self.delay, physical=False
            ).held_out
            gain = log_likelihood_gain(before.mse, quick.mse, self.effective).sum()
            if gain > 0.0 or self._loss_of(before) > self._loss_of(quick):
                found.append(self.loosened(factor))
        return found

    def release(self, effect: Effect) -> Hypothesis:
        """This hypothesis with the parameters of an effect let go, refitted."""
        _, information = effect_prior(self.dataset, effect)
        unknowns = self.unknowns.released(effect, information)
        return settle(replace(self, unknowns=unknowns, released=(*self.released, effect)))

    def delayed(self, delay: Delay) -> Hypothesis:
        """This hypothesis against the effort with another delay, of all joints or of each."""
        return settle(replace(self, delay=self.dataset.delay_of_each(delay)))

    def quick_gains(self, delays: Sequence[Delay]) -> list[float]:
        """Twice the held-out log-likelihood ratio of other delays, the weights as they are."""
        before, after = self.held_out.mse, [self.cv.at_delay(delay).mse for delay in delays]
        return [float(log_likelihood_gain(before, mse, self.effective).sum()) for mse in after]

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
    # A search asks the same again and again, by other ways.
    question = _fingerprint(unknowns, weights, effective), delay, iterations
    if question in dataset.settled:
        known = dataset.settled[question]
        held_out = HeldOut(known.sse, dataset.samples, known.x)
        cv = CrossValidation(dataset, unknowns, known.fitted, delay=delay, held_out=held_out)
        return replace(hypothesis, weights=known.weights, cv=cv, effective=known.effective)
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
    sse, x = cv.held_out.sse, cv.held_out.x
    dataset.settled[question] = Settled(cv.weights, sse, x, weights, effective)
    return replace(hypothesis, weights=weights, cv=cv, effective=effective)


def _physical(hypothesis: Hypothesis, cv: CrossValidation) -> CrossValidation:
    """The fits with physical bodies, begun at those of the hypothesis if it has the same folds."""
    was, start = hypothesis.cv, None
    if len(was.held_out.x) == len(hypothesis.dataset.folds):
        start = hypothesis.unknowns.carried(was.unknowns, was.held_out.x)
    return cv.physical(start)


def _fingerprint(unknowns: Unknowns, weights: Array, effective: Array) -> bytes:
    """What a fit depends on, in a few bytes."""
    digest = blake2b(digest_size=16)
    for array in (
        unknowns.columns,
        unknowns.mean,
        unknowns.information,
        unknowns.lower,
        unknowns.upper,
        weights,
        effective,
    ):
        digest.update(array.tobytes())
    return digest.digest()


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
    """The model as it came, its parameters refitted within their prior.

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
