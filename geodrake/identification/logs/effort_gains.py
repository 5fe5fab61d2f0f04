"""Estimate gains of currents, voltages and commands with the prior of the inertias.

A joint without a measured effort has a signal s instead, and its effort is g s with an unknown g:

    s_j = a_j (Y_j φ + h_j + Y_e μ) + noise,    a_j = 1 / g_j

The prior of φ and the effort h of known payloads set the scale of a_j. The effects μ that any joint
may have are free, and their columns are projected out. The unknowns are log |a_j| and the bodies on
geodesics from the model's, P = L exp(X) Lᵀ with L Lᵀ = P₀. The norm of X is the geometric distance
([Lee2019] Eq. (2.2.10)), in which bodies twice and half as heavy are equally far, so that the prior
does not bias gains. The noise of a joint is profiled out on the scale of its signal: a zero gain
explains nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import minimize

from geodrake.effects.base import Effect
from geodrake.identification.coordinates import SYMMETRIC_BASIS
from geodrake.identification.logs.criteria import SPREAD, WORTH
from geodrake.identification.logs.dataset import Dataset, JointRows
from geodrake.identification.logs.evidence import effective_samples
from geodrake.identification.logs.unknowns import effect_prior
from geodrake.inertia import PARAMETERS_PER_BODY, from_pseudo_inertia, pseudo_inertia
from geodrake.model.robot_model import RobotModel
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]

ALIKE = 1.5
"""Standard deviation of log |gain| among signals of one kind."""

_STEPS = 50  # largest number of steps of a fit
_LEVEL = 1e-6  # gradient tolerance of the posterior
_LONGEST = 1.0  # initial trust radius, of log |a| and geodesics
_FITS = 4  # fits, each with the effective samples of the residuals before
_FIRST_SHARE = 0.05  # effective samples over samples in the first fit
_NOTHING = 1e-12  # least noise variance, relative to the signal's
_TOTAL_MASS = 0.05  # relative uncertainty of a robot's total mass in its file
_CLEARLY = 3.0  # standard deviations at which a negative gain is significant


@dataclass(frozen=True, eq=False)
class SignalGains:
    """Conversion of joints' signals to efforts."""

    gains: Array  # (nv,) N·m or N per unit of the signal; negative if its sign is opposite
    deviations: Array  # (nv,) standard deviations of log |gain|
    phi: Array  # (nb, 10) inertial parameters of the same fit
    worth: Array  # (nv,) effective samples of the residual
    bodies: Array  # (nv,) standard deviations of log |gain| due to the bodies alone


@dataclass(frozen=True, eq=False)
class SignalRows:
    """Triangular factor of the columns [N, Y, h, s] of one joint.

    N are the columns of free effects, Y those of inertial parameters, h the effort of known
    payloads, and s the signal. Rows below those of N have N projected out.
    """

    columns: NDArray[np.intp]  # (m,) inertial parameters that affect the joint
    free: int  # number of columns N
    factor: Array  # (k, n)
    samples: int  # rows of the logs
    variance: float  # of the signal
    mix: Array  # (p, n) map from the columns of the dataset to these columns
    blocks: tuple[JointRows, ...]  # rows of the logs by block

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        joint: int,
        d: int,
        free: Sequence[Effect],
        *,
        payloads: Effect | None = None,
    ) -> SignalRows:
        """Return the rows of a joint, over d inertial parameters and the column of `payloads`."""
        data = dataset.data[joint]
        order, information = [], []
        for effect in free:
            local = data.local(dataset.effect_columns(effect))
            if (local >= 0).all():
                order += local.tolist()
                information += np.diag(effect_prior(dataset, effect)[1]).tolist()
        k, last = len(order), len(data.columns)
        inertial = np.flatnonzero(data.columns < d)
        mix = np.zeros((last + 1, k + len(inertial) + 2))
        mix[[*order, *inertial], range(mix.shape[1] - 2)] = 1.0
        mix[last, -1] = 1.0
        if payloads is not None:
            mix[data.local(dataset.effect_columns(payloads)), -2] = 1.0
        variance = float(dataset.effort_std[joint] ** 2)
        prior = np.eye(k, mix.shape[1]) * np.sqrt(np.array(information) * variance)[:, None]
        factors = [factor[:, : last + 1] @ mix for factor in data.factors]
        return cls(
            data.columns[inertial],
            k,
            triangular_factor([prior, *factors]),
            int(data.samples.sum()),
            variance,
            mix,
            tuple(part for fold in data.rows for part in fold),
        )

    def load(self, phi: Array) -> Array:
        """Return the rows (r,) of the effort of the bodies φ (d,) and of known payloads."""
        return self.factor[self.free :, self.free : -1] @ np.append(phi[self.columns], 1.0)

    def slopes(self, slope: Array) -> Array:
        """Return the slopes (r, d) of `load` from those of φ (d, d)."""
        return self.factor[self.free :, self.free : -2] @ slope[self.columns]

    def residual(self, a: float, phi: Array) -> Array:
        """Return the rows (r,) of predicted − measured signal for an inverse gain a."""
        return a * self.load(phi) - self.factor[self.free :, -1]

    def least_squares_gain(self, phi: Array) -> float:
        """Return the inverse gain of the joint for given bodies; negative only if significant."""
        load = self.load(phi)
        size = max(float(load @ load), np.finfo(float).tiny)
        a = float(load @ self.factor[self.free :, -1]) / size
        residual = self.residual(a, phi)
        error = float(np.sqrt(residual @ residual / (_FIRST_SHARE * self.samples * size)))
        return a if a < -_CLEARLY * error else float(max(abs(a), error))

    def cost(self, a: float, phi: Array, worth: float) -> float:
        """Return twice the negative log-likelihood of `worth` effective samples."""
        residual = self.residual(a, phi)
        noise = residual @ residual / self.samples / self.variance
        return worth * float(np.log(noise + _NOTHING))

    def effective(self, a: float, phi: Array) -> float:
        """Return the effective number of samples of the residual."""
        N, others = np.split(self.factor[: self.free], [self.free], axis=1)
        body = np.concatenate([a * phi[self.columns], [a, -1.0]])
        x = self.mix @ np.append(np.linalg.lstsq(N, -others @ body, rcond=None)[0], body)
        return effective_samples([rows.A @ x[:-1] + rows.b[:, 0] * x[-1] for rows in self.blocks])


@dataclass(frozen=True, eq=False)
class GainPriors:
    """Prior of the gains of joints' signals."""

    expected: Array  # (nv,) |gain|, N·m or N per unit of the signal
    deviations: Array  # (nv,) standard deviations of log |gain|; inf if unknown


def signal_gains(
    rows: Sequence[SignalRows], model: RobotModel, priors: GainPriors, kinds: Sequence[str]
) -> SignalGains:
    """Estimate the gains of signals from the rows of each joint.

    A gain that neither gravity nor inertia identifies, such as that of a light wrist, is drawn to
    those of other joints of its kind (`kinds`, nv), with a large standard deviation.
    """
    spread, prior_mean = priors.deviations, -np.log(priors.expected)
    information = np.diag(np.maximum(spread, _NOTHING) ** -2.0 + _NOTHING)
    for kind in dict.fromkeys(kinds):
        same = np.array([other == kind for other in kinds]) & ~np.isfinite(spread)
        count = int(np.count_nonzero(same))
        information[np.ix_(same, same)] += (np.eye(count) - 1.0 / max(1, count)) / ALIKE**2
    phi, d = model.total_phi.ravel(), model.phi.size
    least_squares = [joint.least_squares_gain(phi) for joint in rows]
    a = np.where(np.isfinite(spread), np.exp(prior_mean), least_squares)
    bodies, signs = _GeodesicBodies.of(model), np.sign(a)
    z = np.concatenate([np.zeros(d), np.log(np.abs(a))])
    worth = _FIRST_SHARE * np.array([joint.samples for joint in rows])
    for fit in range(_FITS):
        if fit:
            phi, a = bodies.at(z[:d])[0], signs * np.exp(z[d:])
            pairs = zip(rows, a, strict=True)
            worth = np.array([joint.effective(inverse, phi) for joint, inverse in pairs])
        prior = information, prior_mean
        system = partial(_system, rows=rows, bodies=bodies, prior=prior, signs=signs, worth=worth)
        options = {"initial_trust_radius": _LONGEST, "gtol": _LEVEL, "maxiter": _STEPS}
        z = minimize(
            lambda z, system=system: system(z)[:2],
            z,
            jac=True,
            hess=lambda z, system=system: system(z)[2],
            method="trust-exact",
            options=options,
        ).x
    # The residual varies with the motion, as in `fit_model`, and so has few effective samples.
    _, _, posterior, grams = system(z)
    inverse = np.linalg.inv(posterior)
    covariance = inverse + inverse @ np.tensordot(worth / WORTH, grams, 1) @ inverse
    deviations = np.sqrt(np.diag(covariance)[d:])
    phi, slope = bodies.at(z[:d])
    body_covariance, least = np.linalg.inv(bodies.information), np.finfo(float).tiny
    scales = [
        load @ joint.slopes(slope) / max(float(load @ load), least)
        for joint, load in ((joint, joint.load(phi)) for joint in rows)
    ]
    of_bodies = np.sqrt([scale @ body_covariance @ scale for scale in scales])
    per_body = phi.reshape(-1, PARAMETERS_PER_BODY)
    return SignalGains(signs * np.exp(-z[d:]), deviations, per_body, worth, of_bodies)


def _system(
    z: Array,
    *,
    rows: Sequence[SignalRows],
    bodies: _GeodesicBodies,
    prior: tuple[Array, Array],
    signs: Array,
    worth: Array,
) -> tuple[float, Array, Array, Array]:
    """Return the negative log-posterior of z, its gradient, information, and parts of each joint.

    z (d + nv,) are the coordinates of the bodies and log |a|. Noise is profiled out, and the
    information (d + nv, d + nv) is the Gauss–Newton one. `prior` is the information (nv, nv) and
    mean (nv,) of log |a|.
    """
    d, size = len(z) - len(signs), len(z)
    phi, slope = bodies.at(z[:d])
    information = block_diag(bodies.information, prior[0])
    grams = np.zeros((len(signs), size, size))
    change = z - np.append(np.zeros(d), prior[1])
    gradient = information @ change
    cost = 0.5 * float(change @ gradient)
    for j, (joint, a) in enumerate(zip(rows, (signs * np.exp(z[d:])).tolist(), strict=True)):
        residual, load = joint.residual(a, phi), joint.load(phi)
        J = np.zeros((len(load), size))
        J[:, :d] = a * joint.slopes(slope)
        J[:, d + j] = a * load
        noise = residual @ residual + joint.samples * joint.variance * _NOTHING
        grams[j] = worth[j] / noise * J.T @ J
        gradient += worth[j] / noise * J.T @ residual
        cost += 0.5 * joint.cost(a, phi, worth[j])
    return cost, gradient, information + grams.sum(axis=0), grams


@dataclass(frozen=True, eq=False)
class _GeodesicBodies:
    """Bodies as end points of geodesics from a model's bodies."""

    factors: Array  # (nb, 4, 4) lower factors L of P₀ = L Lᵀ
    information: Array  # (d, d) of the coordinates x of X in an orthonormal basis of Sym(4)

    @classmethod
    def of(cls, model: RobotModel) -> _GeodesicBodies:
        """Return a model's bodies with their uncertainty."""
        phi = model.with_volume.total_phi
        factors = np.asarray(np.linalg.cholesky(pseudo_inertia(phi)), float)
        d = model.phi.size
        bodies = cls(factors, np.eye(d) / SPREAD**2)
        slope = bodies.at(np.zeros(d))[1]
        if model.information is not None:
            full = model.information
            effects = np.linalg.pinv(full[d:, d:], hermitian=True)  # marginalized, as free here
            marginal = full[:d, :d] - full[:d, d:] @ effects @ full[d:, :d]
            return replace(bodies, information=slope.T @ marginal @ slope)
        total = slope[::PARAMETERS_PER_BODY].sum(axis=0) / phi[:, 0].sum()
        of_mass = np.outer(total, total) / _TOTAL_MASS**2
        return replace(bodies, information=bodies.information + of_mass)

    def at(self, x: Array) -> tuple[Array, Array]:
        """Return φ (d,) at the coordinates x (d,), and its slope (d, d)."""
        X = np.einsum("bi,iac->bac", x.reshape(-1, PARAMETERS_PER_BODY), SYMMETRIC_BASIS)
        w, V = np.linalg.eigh(X)
        e, gap = np.exp(w), w[:, :, None] - w[:, None, :]
        same = np.abs(gap) < 1e-6  # the divided difference is the derivative
        mean = np.exp(0.5 * (w[:, :, None] + w[:, None, :]))
        rise = np.where(same, mean, (e[:, :, None] - e[:, None, :]) / np.where(same, 1.0, gap))
        inner = np.einsum("bka,ikl,blc->biac", V, SYMMETRIC_BASIS, V)  # Vᵀ E V of each direction E
        LV = self.factors @ V
        P = np.einsum("bak,bk,bck->bac", LV, e, LV)
        dP = np.einsum("bak,bikl,bcl->biac", LV, inner * rise[:, None], LV)
        slope = np.zeros((len(P), PARAMETERS_PER_BODY, len(P), PARAMETERS_PER_BODY))
        each = np.arange(len(P))
        slope[each, :, each] = np.swapaxes(from_pseudo_inertia(dP), 1, 2)
        return from_pseudo_inertia(P).ravel(), slope.reshape(x.size, x.size)
