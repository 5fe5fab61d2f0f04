"""Fits of reduced logs with any regularizer: of all folds, or of all but one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.comparison import RegularizerComparison, compare_regularizers
from geodrake.identification.identify import (
    REGULARIZERS,
    IdentificationResult,
    identify,
    regularizer_of,
)
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.cross_validation import HeldOut, hold_out
from geodrake.identification.logs.dataset import Dataset, is_payload
from geodrake.identification.logs.model_fit import effects_of, fit_problem
from geodrake.identification.logs.unknowns import (
    Unknowns,
    effect_prior,
    inertial_unknowns,
    pullback_information,
)
from geodrake.inertia import PARAMETERS_PER_BODY, is_physical, pullback_metric
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.description import drake_messages

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_NOTHING = 1e-200
"""Logs say nothing of an effect if the information of `effect_prior` is below this."""

_PROBE = 0.1
"""The scale of a regularizer is measured at this geometric distance."""


def log_unknowns(dataset: Dataset, model: RobotModel) -> Unknowns:
    """Inertial parameters known as well as a model file knows them, effects that the data decide.

    What an earlier fit of the model left known is not used: the prior of an identification is its
    regularizer.

    Args:
        dataset: The logs, with columns for the model's effects.
        model: The model; its parameters are the prior mean.
    """
    unknowns = inertial_unknowns(model.phi, pullback_information(model.phi, SPREAD))
    means = {fitted.effect: fitted.parameters for fitted in model.effects}
    for effect in effects_of(model):
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
        return self.unknowns.mean[self._order[: self._inertial]].reshape(-1, PARAMETERS_PER_BODY)

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
        """The fit to all folds, or to all but one; see `geodrake.identification.identify`.

        Args:
            regularizer: Name of the regularizer.
            gamma: Weight of the regularizer; exactly one of gamma and residual_bound.
            residual_bound: Greatest weighted squared residual.
            without: The fold to leave out.
            certify: Whether a MathematicalProgram certifies it.
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
        """Whitened A (k, p) and b (k,) as `identify` takes them: bodies first, then the effects.

        The last rows are the weak prior of the effects.

        Args:
            without: The fold to leave out.
        """
        factor = fit_problem(self.dataset, self.unknowns, self.weights, without=without).factor
        scalar = self._order[self._inertial :]
        roots = np.zeros((len(scalar), len(self._order)))
        variances = np.diagonal(self.unknowns.information)[scalar]
        roots[:, self._inertial :] = np.diag(np.sqrt(variances))
        A = np.vstack([factor[:, self._order], roots])
        return A, np.concatenate([factor[:, -1], np.sqrt(variances) * self.unknowns.mean[scalar]])

    @property
    def extra_bounds(self) -> Array | None:
        """(extra, 2) least and greatest values of the effects' parameters; None without any."""
        scalar = self._order[self._inertial :]
        bounds = np.column_stack([self.unknowns.lower[scalar], self.unknowns.upper[scalar]])
        return bounds if len(bounds) else None

    def extra_prior(self, regularizer: str, gamma: float | None) -> Array | None:
        """(extra, 2) what the model has of positive parameters, and weights; None of none.

        The weights make the parameters known to within their own size, whatever γ. Without one, γ
        is that of inertias known to within `SPREAD`.

        Args:
            regularizer: Name of the regularizer.
            gamma: Weight of the regularizer, None with a residual bound.
        """
        scalar = self._order[self._inertial :]
        values = np.where(self.unknowns.lower[scalar] >= 0.0, self.unknowns.mean[scalar], 0.0)
        known = (values > 0.0) & (values <= self.unknowns.upper[scalar])
        if not known.any():
            return None
        if gamma is None:
            gamma = 1.0 / (SPREAD**2 * regularizer_scale(self.prior, regularizer))
        weights, kind = np.ones(len(values)), regularizer_of(regularizer)
        near = kind.scalar_divergence((1.0 + _PROBE) * values[known], values[known])
        weights[known] = _PROBE**2 / (gamma * near)
        return np.column_stack([np.where(known, values, np.nan), weights])

    def compare(self, reference: str, gamma: float) -> RegularizerComparison:
        """All regularizers, fitted to all folds at the training residual of one and its γ.

        Args:
            reference: Name of the regularizer that γ belongs to.
            gamma: Its weight.
        """
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
        """Name of every regularizer -> its `extra_prior`, at the γ that holds bodies as firmly.

        Args:
            reference: Name of the regularizer that γ belongs to.
            gamma: Its weight.
        """
        firm = gamma * regularizer_scale(self.prior, reference)
        return {
            name: self.extra_prior(name, firm / regularizer_scale(self.prior, name))
            for name in REGULARIZERS
        }

    def least_residual(self, without: int | None = None) -> float:
        """The least weighted squared residual that any parameters reach, physical or not."""
        A, b = self.data(without)
        scale = np.linalg.norm(A, axis=0)
        scaled = A / np.where(scale > 0, scale, 1.0)
        return float(np.square(scaled @ np.linalg.lstsq(scaled, b)[0] - b).sum())

    def parameters(self, result: IdentificationResult) -> Array:
        """(p,) parameters of a result in the order of the unknowns."""
        x = np.empty(len(self._order))
        x[self._order] = result.fit.x
        return x

    def information(self, result: IdentificationResult) -> Array:
        """(p, p) information of a result in the order of the unknowns."""
        matrix = np.empty(2 * self._order.shape)
        matrix[np.ix_(self._order, self._order)] = result.fit.information
        return matrix

    def held_out(self, results: Sequence[IdentificationResult]) -> HeldOut:
        """Errors in every fold of the fit without it.

        Args:
            results: (F,) the fits, each without its fold.
        """
        x = np.array([self.parameters(result) for result in results])
        return hold_out(self.dataset, self.unknowns.columns, x)

    def held_out_at(self, regularizer: str, gamma: float) -> HeldOut:
        """Errors in every fold of the fit with one γ without it.

        Args:
            regularizer: Name of the regularizer.
            gamma: Weight γ of d².
        """
        return self.held_out([self.solve(regularizer, gamma=gamma, without=f) for f in self.folds])

    @cached_property
    def _order(self) -> Indices:
        """Unknowns in the order of `identify`: inertia blocks, then the rest."""
        starts = np.array(self.unknowns.inertia_blocks)
        inertial = (starts[:, None] + np.arange(PARAMETERS_PER_BODY)).ravel()
        return np.append(inertial, np.setdiff1d(np.arange(len(self.unknowns.columns)), inertial))

    @cached_property
    def _inertial(self) -> int:
        return len(self.unknowns.inertia_blocks) * PARAMETERS_PER_BODY


def regularizer_scale(prior: Array, regularizer: str) -> float:
    """Mean d² over squared geometric distance, near the prior: about 1 but for a Euclidean one.

    Args:
        prior: (nb, 10) physical inertial parameters.
        regularizer: Name of the regularizer.
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
