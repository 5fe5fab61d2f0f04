"""Fits of reduced logs with any regularizer, and the weight that held-out errors ask for."""

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
"""Information in the scale of `effect_prior` below which an effect is unidentified."""

_PROBE = 0.1
"""The scale of a regularizer is measured at this geometric distance."""

_DECADES = (4, 3, 2, 1, 0, -1)
"""A sweep tries these powers of ten of γ, relative to that of inertias known to within `SPREAD`."""

_LEAST_DECADE = 0
"""A sweep chooses at least this power of ten.

Below, what the model lacks goes into its inertias, and held-out errors on the same kind of motion
even reward that.
"""

_SWEPT_AS = {"riemannian": "entropic"}
"""The γ of these regularizers is chosen by another: both agree to second order, one is convex."""


def log_unknowns(dataset: Dataset, model: RobotModel) -> Unknowns:
    """Return bodies known as well as a model file knows them, and effects that the data decide.

    Payloads come next to the bodies. The model's parameters are the prior mean; what an earlier fit
    left known is not used: the prior of an identification is its regularizer.
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
    """Logs to be fitted with one regularizer or another.

    A payload counts as a body of its own, with what the model says of it as its prior. Positive
    parameters of effects that the model has, such as friction and rotor inertias, have a prior too:
    they are known to within their own size. Others are not regularized, but for a prior so weak
    that it only decides where the data say nothing.
    """

    dataset: Dataset
    unknowns: Unknowns  # what the fits move; its means are the prior
    # (nv,) weight of a squared residual of each joint, so that the weighted squared residual counts
    # effective samples.
    weights: Array
    # Mass of all bodies and payloads together, kg; None if it is not known.
    total_mass: float | None = None
    # (p,) parameters near which the likelihood of joints without motors is taken, and (nv,) the
    # `power` of their residuals, as in `Dataset.passive_pull`; the prior's, and none.
    near: Array | None = None
    power: Array | None = None

    @property
    def prior(self) -> Array:
        """(nb, 10) prior of the bodies, and of payloads after them."""
        return self.unknowns.mean[: self._inertial].reshape(-1, PARAMETERS_PER_BODY)

    @property
    def folds(self) -> range:
        """The folds by number."""
        return range(len(self.dataset.folds))

    @property
    def _inertial(self) -> int:
        """Number of the parameters of bodies and payloads, which come first."""
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

        Exactly one is given of γ and the residual bound, the greatest weighted squared residual. A
        MathematicalProgram certifies the fit if asked to.
        """
        with drake_messages():  # an error says it all when a solver gives up
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
        """Fit all regularizers to all folds at the training residual of one and its γ."""
        # Scalars are held as firmly as bodies are, by each regularizer.
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
        """Return rows (k, p + 1) of the inertias m at k joints without motors.

        They are what −2 n log m is to second order near m₀: n (m/m₀ − 2)², but for a constant.
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
        """Return (extra, 2) the model's positive parameters and weights; or None.

        The weights make the parameters known to within their own size, whatever γ. Without one, as
        with a residual bound, γ is that of inertias known to within `SPREAD`.
        """
        all_three = self.unknowns.lower, self.unknowns.upper, self.unknowns.mean
        lower, upper, values = (each[self._inertial :] for each in all_three)
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
        """Return the least weighted squared residual that any parameters reach, physical or not."""
        return least_residual(*self.data(without))

    def held_out(self, results: Sequence[IdentificationResult]) -> HeldOut:
        """Return the errors in every fold of the fits (F,) without it."""
        x = np.array([result.x for result in results])
        return hold_out(self.dataset, self.unknowns.columns, x)

    def loss(self, regularizer: str, gamma: float) -> Array:
        """Return (F,) parts of the folds in the joints' summed squared nrms; inf if a fit fails."""
        try:
            parts = [self.solve(regularizer, gamma=gamma, without=f) for f in self.folds]
        except IdentificationError:
            return np.full(len(self.folds), np.inf)
        held_out = self.held_out(parts)
        mean = held_out.sse / self.dataset.rows
        return np.asarray((mean / self.dataset.effort_std**2).sum(1))


def regularizer_scale(prior: Array, regularizer: str) -> float:
    """Return the mean d² over squared geometric distance near a prior (nb, 10) of physical bodies.

    It is about 1 but for a Euclidean regularizer.
    """
    kind = REGULARIZERS[regularizer]()
    directions = np.linalg.inv(np.linalg.cholesky(pullback_metric(prior)))
    found = []
    for body, rows in enumerate(directions):
        for row in rows:
            moved = prior.copy()
            moved[body] += _PROBE * row
            found.append(kind.divergence(moved, prior) / _PROBE**2)
    return float(np.mean(found))


@dataclass(frozen=True)
class Weighing:
    """One γ of a sweep."""

    gamma: float
    nrms: float  # held-out nrms with it; inf where a fit failed


def weigh(fits: LogFits, regularizer: str) -> tuple[float, tuple[Weighing, ...]]:
    """Return the largest γ that is not clearly worse than the best, and the errors of each.

    Decades of γ are tried, then half decades around the best; none below `_LEAST_DECADE` is chosen.
    "Clearly" is one standard error of the difference over the folds, so that where the data say
    little the prior stays. Tried ones come with the largest γ first.

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
        Weighing(start * 10.0**decade, float(np.sqrt(losses[decade].sum() / joints)))
        for decade in sorted(losses, reverse=True)
    ]
    return start * 10.0**chosen, tuple(sweep)
