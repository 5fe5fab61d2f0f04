"""Gains of currents, voltages and commands, estimated with the prior of the inertias.

A joint whose effort is not measured has a signal s in its place, of which efforts are g s with g
unknown:

    s_j = a_j (Y_j φ + h_j + Y_e μ) + noise,    a_j = 1 / g_j

What scales a_j is φ, which is known as well as its prior says, and the effort h of payloads that
are known. The effects μ that any joint may have are free; their columns are projected out. What is
left are log |a_j| and the bodies, moved along geodesics from where the model has them, P = L exp(X)
Lᵀ with L Lᵀ = P₀: the norm of X is the geometric distance ([Lee2019] Eq. (2.2.10)), so that bodies
twice as heavy are as far as bodies half as heavy, and gains are not drawn to either side. The noise
of a joint is profiled out on the scale of its own signal: a gain of zero explains nothing.
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
"""Deviation of log |gain| among signals of one kind, as motors differ."""

_STEPS = 50  # of a fit at most
_LEVEL = 1e-6  # slope of the posterior where a fit is done
_LONGEST = 1.0  # of log |a| or a geodesic in the first step
_FITS = 4  # all but the first with independent samples by the residuals of the one before
_FIRST_SHARE = 0.05  # of the samples that are independent in the first one
_NOTHING = 1e-12  # share of a signal's variance that no noise is below
_TOTAL_MASS = 0.05  # share to which a model file knows all bodies together: robots are weighed
_CLEARLY = 3.0  # deviations of a negative gain that is taken for one


@dataclass(frozen=True, eq=False)
class SignalGains:
    """Conversion of joints' signals to efforts."""

    gains: Array  # (nv,) N·m or N for a unit of the signal; negative where its sign is the other
    deviations: Array  # (nv,) standard deviations of log |gain|
    phi: Array  # (nb, 10) inertial parameters that go with them
    worth: Array  # (nv,) independent samples of what stays unexplained
    bodies: Array  # (nv,) deviations of log |gain| by how well bodies are known, all else certain


@dataclass(frozen=True, eq=False)
class SignalRows:
    """One joint's triangular factor of the columns [N, Y, h, s].

    N are those of free effects, Y of inertial parameters, h of the effort of known payloads, s of
    the signal. Rows below those of N have N projected out.
    """

    columns: NDArray[np.intp]  # (m,) inertial parameters that matter at the joint
    free: int  # number of columns N
    factor: Array  # (k, n)
    samples: int  # rows of the logs behind it
    variance: float  # of the signal
    mix: Array  # (p, n) of which of the logs' columns these are made
    blocks: tuple[JointRows, ...]  # rows of blocks of the logs

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        joint: int,
        d: int,
        free: Sequence[Effect],
        *,
        held: Effect | None = None,
    ) -> SignalRows:
        """Return the rows of a joint, over d inertial parameters.

        The column of `held` is what known payloads need.
        """
        data = dataset.data[joint]
        order, known = [], []
        for effect in free:
            local = data.local(dataset.effect_columns(effect))
            if (local >= 0).all():
                order += local.tolist()
                known += np.diag(effect_prior(dataset, effect)[1]).tolist()
        k, last = len(order), len(data.columns)
        inertial = np.flatnonzero(data.columns < d)
        mix = np.zeros((last + 1, k + len(inertial) + 2))
        mix[[*order, *inertial], range(mix.shape[1] - 2)] = 1.0
        mix[last, -1] = 1.0
        if held is not None:
            mix[data.local(dataset.effect_columns(held)), -2] = 1.0
        variance = float(dataset.effort_std[joint] ** 2)
        prior = np.eye(k, mix.shape[1]) * np.sqrt(np.array(known) * variance)[:, None]
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
        """Return (r,) rows of the effort of the bodies and of known payloads, for φ (d,)."""
        return self.factor[self.free :, self.free : -1] @ np.append(phi[self.columns], 1.0)

    def slopes(self, slope: Array) -> Array:
        """Return (r, d) slopes of `load` with coordinates of the bodies, for those of φ (d, d)."""
        return self.factor[self.free :, self.free : -2] @ slope[self.columns]

    def left(self, a: float, phi: Array) -> Array:
        """Return (r,) residual rows of the bodies with an inverse gain a, sign reversed."""
        return a * self.load(phi) - self.factor[self.free :, -1]

    def least_squares_gain(self, phi: Array) -> float:
        """Return the inverse gain a of this joint with these bodies; negative if significant."""
        load = self.load(phi)
        size = max(float(load @ load), np.finfo(float).tiny)
        a = float(load @ self.factor[self.free :, -1]) / size
        left = self.left(a, phi)
        error = float(np.sqrt(left @ left / (_FIRST_SHARE * self.samples * size)))
        return a if a < -_CLEARLY * error else float(max(abs(a), error))

    def cost(self, a: float, phi: Array, worth: float) -> float:
        """Return twice the negative log-likelihood, for so many independent samples."""
        left = self.left(a, phi)
        return worth * float(np.log(left @ left / self.samples / self.variance + _NOTHING))

    def effective(self, a: float, phi: Array) -> float:
        """Return how many independent samples the residual is worth."""
        N, others = np.split(self.factor[: self.free], [self.free], axis=1)
        body = np.concatenate([a * phi[self.columns], [a, -1.0]])
        x = self.mix @ np.append(np.linalg.lstsq(N, -others @ body, rcond=None)[0], body)
        return effective_samples([rows.A @ x[:-1] + rows.b[:, 0] * x[-1] for rows in self.blocks])


@dataclass(frozen=True, eq=False)
class GainPriors:
    """Prior of the gains of joints' signals."""

    expected: Array  # (nv,) their sizes, N·m or N for a unit of the signal
    deviations: Array  # (nv,) of their logarithms; inf where nothing is known


def signal_gains(
    rows: Sequence[SignalRows], model: RobotModel, priors: GainPriors, kinds: Sequence[str]
) -> SignalGains:
    """Find the gains of signals, by rows of each joint.

    A gain that neither gravity nor inertia shows, as that of a light wrist, is drawn to those of
    the other joints' signals of its kind (`kinds`, nv); its deviation says how little is known of
    it.
    """
    known, about = priors.deviations, -np.log(priors.expected)
    told = np.diag(np.maximum(known, _NOTHING) ** -2.0 + _NOTHING)
    for kind in dict.fromkeys(kinds):
        same = np.array([each == kind for each in kinds]) & ~np.isfinite(known)
        count = int(np.count_nonzero(same))
        told[np.ix_(same, same)] += (np.eye(count) - 1.0 / max(1, count)) / ALIKE**2
    phi, d = model.total_phi.ravel(), model.phi.size
    told_alone = [each.least_squares_gain(phi) for each in rows]
    a = np.where(np.isfinite(known), np.exp(about), told_alone)
    bodies, signs = _GeodesicBodies.of(model), np.sign(a)
    z = np.concatenate([np.zeros(d), np.log(np.abs(a))])
    worth = _FIRST_SHARE * np.array([each.samples for each in rows])
    for fit in range(_FITS):
        if fit:
            phi, a = bodies.at(z[:d])[0], signs * np.exp(z[d:])
            worth = np.array([each.effective(own, phi) for each, own in zip(rows, a, strict=True)])
        system = partial(
            _system, rows=rows, bodies=bodies, told=(told, about), signs=signs, worth=worth
        )
        options = {"initial_trust_radius": _LONGEST, "gtol": _LEVEL, "maxiter": _STEPS}
        z = minimize(
            lambda z, system=system: system(z)[:2],
            z,
            jac=True,
            hess=lambda z, system=system: system(z)[2],
            method="trust-exact",
            options=options,
        ).x
    # What stays unexplained varies with the motion, as in `fit_model`: it is worth few samples.
    _, _, information, grams = system(z)
    inverse = np.linalg.inv(information)
    covariance = inverse + inverse @ np.tensordot(worth / WORTH, grams, 1) @ inverse
    deviations = np.sqrt(np.diag(covariance)[d:])
    found, slope = bodies.at(z[:d])
    spread, least = np.linalg.inv(bodies.information), np.finfo(float).tiny
    scales = [
        load @ joint.slopes(slope) / max(float(load @ load), least)
        for joint, load in ((each, each.load(found)) for each in rows)
    ]
    known = np.sqrt([scale @ spread @ scale for scale in scales])
    moved = found.reshape(-1, PARAMETERS_PER_BODY)
    return SignalGains(signs * np.exp(-z[d:]), deviations, moved, worth, known)


def _system(
    z: Array,
    *,
    rows: Sequence[SignalRows],
    bodies: _GeodesicBodies,
    told: tuple[Array, Array],
    signs: Array,
    worth: Array,
) -> tuple[float, Array, Array, Array]:
    """Return the negative log-posterior of z, its slope, information, and each joint's part of it.

    z (d + nv,) are coordinates of the bodies and log |a|, noise is profiled out, and the
    information (d + nv, d + nv) is that of Gauss and Newton. `told` are the information (nv, nv)
    of what is known of log |a|, and about which values (nv,).
    """
    d, size = len(z) - len(signs), len(z)
    phi, slope = bodies.at(z[:d])
    known, grams = block_diag(bodies.information, told[0]), np.zeros((len(signs), size, size))
    from_known = z - np.append(np.zeros(d), told[1])
    gradient = known @ from_known
    cost = 0.5 * float(from_known @ gradient)
    for j, (joint, a) in enumerate(zip(rows, (signs * np.exp(z[d:])).tolist(), strict=True)):
        left, load = joint.left(a, phi), joint.load(phi)
        J = np.zeros((len(load), size))
        J[:, :d] = a * joint.slopes(slope)
        J[:, d + j] = a * load
        noise = left @ left + joint.samples * joint.variance * _NOTHING
        grams[j] = worth[j] / noise * J.T @ J
        gradient += worth[j] / noise * J.T @ left
        cost += 0.5 * joint.cost(a, phi, worth[j])
    return cost, gradient, known + grams.sum(axis=0), grams


@dataclass(frozen=True, eq=False)
class _GeodesicBodies:
    """Bodies as end points of geodesics from where a model has them."""

    factors: Array  # (nb, 4, 4) lower factors L of P₀ = L Lᵀ
    information: Array  # (d, d) of the coordinates x of X, in an orthonormal basis of Sym(4)

    @classmethod
    def of(cls, model: RobotModel) -> _GeodesicBodies:
        """Return bodies near a model's, with its uncertainty."""
        phi = model.with_volume.total_phi
        factors = np.asarray(np.linalg.cholesky(pseudo_inertia(phi)), float)
        d = model.phi.size
        free = cls(factors, np.eye(d) / SPREAD**2)
        slope = free.at(np.zeros(d))[1]
        if model.information is not None:
            whole = model.information
            others = np.linalg.pinv(whole[d:, d:], hermitian=True)  # which are free here
            known = whole[:d, :d] - whole[:d, d:] @ others @ whole[d:, :d]
            return replace(free, information=slope.T @ known @ slope)
        total = slope[::PARAMETERS_PER_BODY].sum(axis=0) / phi[:, 0].sum()
        told = np.outer(total, total) / _TOTAL_MASS**2
        return replace(free, information=free.information + told)

    def at(self, x: Array) -> tuple[Array, Array]:
        """Return φ (d,) and its slope (d, d) with the coordinates x (d,)."""
        X = np.einsum("bi,iac->bac", x.reshape(-1, PARAMETERS_PER_BODY), SYMMETRIC_BASIS)
        w, V = np.linalg.eigh(X)
        e, gap = np.exp(w), w[:, :, None] - w[:, None, :]
        same = np.abs(gap) < 1e-6  # where the divided difference of exp is its slope
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
