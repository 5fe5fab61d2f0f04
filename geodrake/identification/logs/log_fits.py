"""Fits of reduced logs with any regularizer, and the choice of its weight by held-out errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.errors import IdentificationError
from geodrake.identification.comparison import RegularizerComparison, compare_regularizers
from geodrake.identification.identify import (
    REGULARIZERS,
    IdentificationResult,
    identify,
    regularizer_of,
)
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.dataset import Dataset, is_body, is_payload
from geodrake.identification.logs.hypothesis import HeldOut, hold_out
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.unknowns import (
    Unknowns,
    effect_prior,
    fit_problem,
    inertial_unknowns,
    pullback_information,
)
from geodrake.identification.problem import least_residual
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical, pullback_metric
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.description import drake_messages

_NOTHING = 1e-200
"""Information of `effect_prior` below which an effect is unidentified."""

_PROBE = 0.1
"""Geometric distance at which the scale of a regularizer is measured."""

_DECADES = (4, 3, 2, 1, 0, -1)
"""Powers of ten of γ in a sweep, relative to the γ of inertias with an uncertainty of `SPREAD`."""

_LEAST_DECADE = 0
"""Smallest power of ten that a sweep chooses.

Below it, inertias absorb missing effects, which held-out errors of similar motion even reward.
"""

_SWEPT_AS = {"riemannian": "entropic"}
"""Convex regularizers, equal to second order, that choose the γ of others."""


def log_unknowns(dataset: Dataset, model: RobotModel) -> Unknowns:
    """Return a model's parameters as unknowns: bodies with the prior of a file, weak effects.

    Payloads follow the bodies. The prior means are the model's parameters. The information of an
    earlier fit is not used, as the prior of an identification is its regularizer.
    """
    unknowns = inertial_unknowns(model.phi, pullback_information(model.phi, SPREAD))
    means = {fitted.effect: fitted.parameters for fitted in model.effects}
    for effect in sorted(effects_of(model), key=is_body, reverse=True):
        mean, columns = means[effect], dataset.effect_columns(effect)
        _, information = effect_prior(dataset, effect)
        if is_payload(effect):
            mean = mean if is_physical(mean) else dataset.payload
            information = pullback_information(mean[None], SPREAD)
        elif not np.any(information > _NOTHING):  # a joint at rest
            information = np.eye(len(mean))
        unknowns = unknowns.with_effect(effect, columns, information, mean)
    return unknowns


@dataclass(frozen=True, eq=False)
class LogFits:
    """Fits of reduced logs with any regularizer.

    A payload is a separate body with the model's value as prior. Positive parameters of the model's
    effects, such as friction and rotor inertias, have a prior of their own size. Other parameters
    have only a weak prior, for directions that the data do not identify.
    """

    dataset: Dataset
    unknowns: Unknowns  # free parameters, whose means are the prior
    # (nv,) weights of the joints' squared residuals, whose weighted sum is the number of effective
    # samples.
    weights: Array
    total_mass: float | None = None  # of all bodies and payloads, kg, if known
    # (p,) parameters at which the likelihood of joints without motors is expanded, by default the
    # prior, and (nv,) the `power` of `Dataset.passive_pull`, by default zero.
    near: Array | None = None
    power: Array | None = None

    @property
    def prior(self) -> Array:
        """(nb, 10) prior of the bodies, followed by payloads."""
        return self.unknowns.mean[: self._inertial].reshape(-1, PARAMETERS_PER_BODY)

    @property
    def folds(self) -> range:
        """Indices of the folds."""
        return range(len(self.dataset.folds))

    @property
    def _inertial(self) -> int:
        """Number of parameters of bodies and payloads, which come first."""
        return len(self.unknowns.inertia_blocks) * PARAMETERS_PER_BODY

    def solve(
        self,
        regularizer: str,
        *,
        gamma: float | None = None,
        residual_bound: float | None = None,
        without: int | None = None,
        certify: bool = False,
    ) -> IdentificationResult:
        """Fit all folds, or all but one; see `geodrake.identification.identify`.

        Pass exactly one of `gamma` and `residual_bound`, the largest weighted squared residual.
        """
        with drake_messages():  # the error of a failed solver is sufficient
            return identify(
                *self.data(without),
                self.prior,
                regularizer=regularizer,
                gamma=gamma,
                residual_bound=residual_bound,
                extra_bounds=self.extra_bounds,
                extra_prior=self.extra_prior(regularizer, gamma),
                total_mass=self.total_mass,
                certify=certify,
            )

    def compare(self, reference: str, gamma: float) -> RegularizerComparison:
        """Fit all regularizers to all folds, at the training residual of a reference and its γ."""
        # Each regularizer weighs scalars like bodies.
        firm = gamma * regularizer_scale(self.prior, reference)
        scales = {name: regularizer_scale(self.prior, name) for name in REGULARIZERS}
        with drake_messages():
            return compare_regularizers(
                *self.data(),
                self.prior,
                gamma=gamma,
                reference=reference,
                extra_bounds=self.extra_bounds,
                extra_priors={
                    name: self.extra_prior(name, firm / scale) for name, scale in scales.items()
                },
                total_mass=self.total_mass,
                certify=False,
            )

    def data(self, without: int | None = None) -> tuple[Array, Array]:
        """Return whitened A (k, p) and b (k,) of all folds, or of all but one, for `identify`.

        The last rows are the weak prior of the effects.
        """
        factor = fit_problem(self.dataset, self.unknowns, self.weights, without=without).factor
        factor = np.vstack([factor, self._passive_rows(without)])
        roots = np.sqrt(np.diagonal(self.unknowns.information)) * ~self.unknowns.is_inertial
        prior = np.diag(roots)[self._inertial :]
        A, mean = np.vstack([factor[:, :-1], prior]), self.unknowns.mean
        return A, np.concatenate([factor[:, -1], prior @ mean])

    def _passive_rows(self, without: int | None) -> Array:
        """Return rows (k, p + 1) for the inertias m at k joints without motors.

        They approximate −2 n log m to second order at m₀: n (m/m₀ − 2)² plus a constant.
        """
        near = self.unknowns.mean if self.near is None else self.near
        power = np.zeros(len(self.dataset.joints)) if self.power is None else self.power
        shares = self.dataset.passive_shares(self.unknowns.columns)
        at = np.flatnonzero(shares.any(axis=1))
        part = 1.0 if without is None else 1.0 - self.dataset.fold_shares[without]
        inertias = self.dataset.inertias(self.unknowns.columns, near)[at]
        rows = np.column_stack([shares[at] / inertias[:, None], np.full(len(at), 2.0)])
        return np.asarray(np.sqrt(part * power[at])[:, None] * rows)

    @property
    def extra_bounds(self) -> Array | None:
        """(extra, 2) bounds of the effects' parameters; None without any."""
        bounds = np.column_stack([self.unknowns.lower, self.unknowns.upper])[self._inertial :]
        return bounds if len(bounds) else None

    def extra_prior(self, regularizer: str, gamma: float | None) -> Array | None:
        """Return positive prior values and weights (extra, 2), or None without any.

        The weights give the parameters an uncertainty of their own size for any γ. Without `gamma`,
        it is that of inertias with an uncertainty of `SPREAD`.
        """
        effects = slice(self._inertial, None)
        lower, upper = self.unknowns.lower[effects], self.unknowns.upper[effects]
        values = self.unknowns.mean[effects]
        known = (lower >= 0.0) & (values > 0.0) & (values <= upper)
        if not known.any():
            return None
        if gamma is None:
            gamma = 1.0 / (SPREAD**2 * regularizer_scale(self.prior, regularizer))
        weights, kind = np.ones(len(values)), regularizer_of(regularizer)
        near = kind.scalar_divergence((1.0 + _PROBE) * values[known], values[known])
        weights[known] = _PROBE**2 / (gamma * near)
        return np.column_stack([np.where(known, values, np.nan), weights])

    def least_residual(self, without: int | None = None) -> float:
        """Return the smallest weighted squared residual of any parameters, physical or not."""
        return least_residual(*self.data(without))

    def held_out(self, results: Sequence[IdentificationResult]) -> HeldOut:
        """Return the held-out errors of fits (F,), each without one fold."""
        x = np.array([result.x for result in results])
        return hold_out(self.dataset, self.unknowns.columns, x)

    def loss(self, regularizer: str, gamma: float) -> Array:
        """Return the folds' parts (F,) of the joints' summed squared nrms; inf if a fit fails."""
        try:
            parts = [self.solve(regularizer, gamma=gamma, without=f) for f in self.folds]
        except IdentificationError:
            return np.full(len(self.folds), np.inf)
        held_out = self.held_out(parts)
        mean = held_out.sse / self.dataset.rows
        return np.asarray((mean / self.dataset.effort_std**2).sum(1))


def regularizer_scale(prior: Array, regularizer: str) -> float:
    """Return the mean ratio of d² to the squared geometric distance near a prior (nb, 10).

    It is about 1, except for the Euclidean regularizer.
    """
    kind = REGULARIZERS[regularizer]()
    directions = np.linalg.inv(np.linalg.cholesky(pullback_metric(prior)))
    ratios = []
    for body, rows in enumerate(directions):
        for row in rows:
            phi = prior.copy()
            phi[body] += _PROBE * row
            ratios.append(kind.divergence(phi, prior) / _PROBE**2)
    return float(np.mean(ratios))


@dataclass(frozen=True)
class GammaScore:
    """One γ of a sweep."""

    gamma: float
    nrms: float  # held-out nrms; inf if a fit failed


def choose_gamma(fits: LogFits, regularizer: str) -> tuple[float, tuple[GammaScore, ...]]:
    """Return the largest γ within one standard error of the best, and all scores by falling γ.

    The sweep tries decades of γ, then half decades around the best; it chooses none below
    `_LEAST_DECADE`. The standard error is that of the difference over the folds, so that
    uninformative data keep the prior.

    Raises:
        IdentificationError: No fit succeeded.
    """
    regularizer = _SWEPT_AS.get(regularizer, regularizer)
    start = 1.0 / (SPREAD**2 * regularizer_scale(fits.prior, regularizer))
    losses = dict[float, Array]()

    def best_of(decades: Sequence[float]) -> float:
        for decade in decades:
            losses[decade] = fits.loss(regularizer, start * 10.0**decade)
        return min(losses, key=lambda decade: losses[decade].sum())

    first = max(best_of(_DECADES), _LEAST_DECADE)
    best_of((first + 0.5, first - 0.5))
    allowed = {decade: loss for decade, loss in losses.items() if decade >= _LEAST_DECADE}
    best = min(allowed.values(), key=lambda loss: loss.sum())
    if not np.isfinite(best).all():
        raise IdentificationError(
            f"The {regularizer} regularizer has no solution with any weight.",
            advice="Use another regularizer or γ.",
        )

    def as_good(loss: Array) -> bool:
        worse = loss - best
        if not np.isfinite(worse).all():
            return False
        error = np.std(worse, ddof=1) * np.sqrt(len(worse)) if len(worse) > 1 else 0.0
        return bool(worse.sum() <= error)

    chosen = max(decade for decade, loss in allowed.items() if as_good(loss))
    joints = len(fits.dataset.joints)
    sweep = [
        GammaScore(start * 10.0**decade, float(np.sqrt(losses[decade].sum() / joints)))
        for decade in sorted(losses, reverse=True)
    ]
    return start * 10.0**chosen, tuple(sweep)
