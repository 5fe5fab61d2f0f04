"""Fits of reduced logs with any regularizer: of all folds, or of all but one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
"""Logs say nothing of an effect if the information of `effect_prior` is below this."""

_PROBE = 0.1
"""The scale of a regularizer is measured at this geometric distance."""


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

    @property
    def prior(self) -> Array:
        """(nb, 10) prior of the bodies, and of payloads after them."""
        return self.unknowns.mean[: self._inertial].reshape(-1, PARAMETERS_PER_BODY)

    @property
    def folds(self) -> range:
        """The folds by number."""
        return range(len(self.dataset.folds))

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
        A, b = self.data(without)
        with drake_messages():  # an error says it all when a solver gives up
            return identify(
                A,
                b,
                self.prior,
                regularizer=regularizer,
                gamma=gamma,
                residual_bound=residual_bound,
                extra_bounds=self.extra_bounds,
                extra_prior=self.extra_prior(regularizer, gamma),
                total_mass=self.total_mass,
                certify=certify,
            )

    def data(self, without: int | None = None) -> tuple[Array, Array]:
        """Return whitened A (k, p) and b (k,) of all folds, or of all but one, for `identify`.

        The last rows are the weak prior of the effects.
        """
        factor = fit_problem(self.dataset, self.unknowns, self.weights, without=without).factor
        roots = np.sqrt(np.diagonal(self.unknowns.information)) * ~self.unknowns.is_inertial
        prior = np.diag(roots)[self._inertial :]
        A, mean = np.vstack([factor[:, :-1], prior]), self.unknowns.mean
        return A, np.concatenate([factor[:, -1], prior @ mean])

    @property
    def extra_bounds(self) -> Array | None:
        """(extra, 2) least and greatest values of the effects' parameters; None without any."""
        bounds = np.column_stack([self.unknowns.lower, self.unknowns.upper])[self._inertial :]
        return bounds if len(bounds) else None

    def extra_prior(self, regularizer: str, gamma: float | None) -> Array | None:
        """Return (extra, 2) what the model has of positive parameters, and weights; None of none.

        The weights make the parameters known to within their own size, whatever γ. Without one, as
        with a residual bound, γ is that of inertias known to within `SPREAD`.
        """
        lower, upper, values = (
            each[self._inertial :]
            for each in (self.unknowns.lower, self.unknowns.upper, self.unknowns.mean)
        )
        known = (lower >= 0.0) & (values > 0.0) & (values <= upper)
        if not known.any():
            return None
        if gamma is None:
            gamma = 1.0 / (SPREAD**2 * regularizer_scale(self.prior, regularizer))
        weights, kind = np.ones(len(values)), regularizer_of(regularizer)
        near = kind.scalar_divergence((1.0 + _PROBE) * values[known], values[known])
        weights[known] = _PROBE**2 / (gamma * near)
        return np.column_stack([np.where(known, values, np.nan), weights])

    def compare(self, reference: str, gamma: float) -> RegularizerComparison:
        """Fit all regularizers to all folds at the training residual of one and its γ."""
        A, b = self.data()
        with drake_messages():
            return compare_regularizers(
                A,
                b,
                self.prior,
                gamma=gamma,
                reference=reference,
                extra_bounds=self.extra_bounds,
                extra_priors=self.extra_priors(reference, gamma),
                total_mass=self.total_mass,
                certify=False,
            )

    def extra_priors(self, reference: str, gamma: float) -> dict[str, Array | None]:
        """Name of every regularizer -> its `extra_prior`, at the γ that holds bodies as firmly."""
        firm = gamma * regularizer_scale(self.prior, reference)
        return {
            name: self.extra_prior(name, firm / regularizer_scale(self.prior, name))
            for name in REGULARIZERS
        }

    def least_residual(self, without: int | None = None) -> float:
        """Return the least weighted squared residual that any parameters reach, physical or not."""
        return least_residual(*self.data(without))

    def held_out(self, results: Sequence[IdentificationResult]) -> HeldOut:
        """Return the errors in every fold of the fits (F,) without it."""
        x = np.array([result.fit.x for result in results])
        return hold_out(self.dataset, self.unknowns.columns, x)

    def held_out_at(self, regularizer: str, gamma: float) -> HeldOut:
        """Return the errors in every fold of the fit with one γ without it."""
        return self.held_out([self.solve(regularizer, gamma=gamma, without=f) for f in self.folds])

    @property
    def _inertial(self) -> int:
        """Number of the parameters of bodies and payloads, which come first."""
        return len(self.unknowns.inertia_blocks) * PARAMETERS_PER_BODY


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
