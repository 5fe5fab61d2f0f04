"""Gains of currents, voltages and commands, found by what is known of the inertias.

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
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import catalogue
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import SPREAD, WORTH
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.evidence import effective_samples_of_each
from geodrake.identification.logs.unknowns import effect_prior
from geodrake.inertia import PARAMETERS_PER_BODY, from_pseudo_inertia, pseudo_inertia
from geodrake.model.robot_model import RobotModel
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]

_STEPS, _CLOSE = 50, 1e-7  # Gauss–Newton steps at most, and a cost that falls by so little is least
_LONGEST = 1.0  # of log |a| or a geodesic in one step
_SHORTEST = 1e-4  # share of a step that is tried
_ROUNDS = 3  # fits whose residuals say how many samples are independent
_FIRST_SHARE = 0.05  # of the samples that are independent in the first one
_NOTHING = 1e-12  # share of a signal's variance that no noise is below
_TOTAL_MASS = 0.05  # share to which a model file knows all bodies together: robots are weighed
_ALIKE = 1.5  # deviation of log |gain| among signals of one kind, as motors differ
_CLEARLY = 3.0  # deviations of a negative gain that is taken for one


@dataclass(frozen=True, eq=False)
class SignalGains:
    """What efforts the signals of joints are.

    Attributes:
        gains: (nv,) N·m or N for a unit of the signal; negative where its sign is the other one.
        deviations: (nv,) standard deviations of log |gain|.
        phi: (nb, 10) inertial parameters that go with them.
        nrms: (nv,) what stays unexplained, RMS over the deviation of the signal.
        worth: (nv,) independent samples of what stays unexplained.
    """

    gains: Array
    deviations: Array
    phi: Array
    nrms: Array
    worth: Array


def effects_beside_gains(model: RobotModel) -> tuple[Effect, ...]:
    """The effects that any joint may have, at each joint of the model."""
    kinds = [kind for kind in catalogue() if kind.beside_gains]
    return tuple(kind.shaped(joint)[0] for joint in model.single_joints for kind in kinds)


def signal_gains(
    rows: Sequence[SignalRows], model: RobotModel, known: Array, kinds: Sequence[str] = ()
) -> SignalGains:
    """The gains of signals.

    A gain that neither gravity nor inertia shows, as that of a light wrist, is drawn to those of
    the other joints' signals of its kind; its deviation says how little is known of it.

    Args:
        rows: What logs say of each joint.
        model: The model, whose inertias are known.
        known: (nv,) standard deviations of log |gain| about 0, of signals that are efforts or
            nearly so; inf where nothing is known of the gain.
        kinds: Kinds (nv,) of the signals; all alike if empty.
    """
    bodies = _GeodesicBodies.of(model)
    a = np.array([each.least_squares_gain(model.total_phi.ravel()) for each in rows])
    a = np.where(np.isfinite(known), 1.0, a)
    told = _told(known, kinds or ("",) * len(rows))
    worth = _FIRST_SHARE * np.array([each.samples for each in rows])
    at = _GainPoint(rows, bodies, told, worth, np.zeros(model.phi.size), a)
    for _ in range(_ROUNDS):
        at = at.converged()
        at = replace(at, worth=at.effective())
    return at.converged().result()


def _told(known: Array, kinds: Sequence[str]) -> Array:
    """(nv, nv) information of log |a|: by what is known, and as signals of a kind are alike."""
    precision = np.where(np.isfinite(known), np.maximum(known, _NOTHING), np.inf) ** -2.0
    told = np.diag(precision + _NOTHING)
    for kind in dict.fromkeys(kinds):
        same = np.array([each == kind for each in kinds]) & ~np.isfinite(known)
        count = int(np.count_nonzero(same))
        told[np.ix_(same, same)] += (np.eye(count) - 1.0 / max(1, count)) / _ALIKE**2
    return told


@dataclass(frozen=True, eq=False)
class SignalRows:
    """One joint's rows [N, Y, h, s] with the columns N of free effects projected out.

    Attributes:
        columns: (m,) inertial parameters that matter at the joint.
        Y: (r, m) rows of these.
        h: (r,) rows of the effort of known payloads.
        s: (r,) rows of the signal.
        N: (k, k + m + 2) rows that give the free effects' parameters for all others.
        samples: Rows of the logs behind them.
        variance: Of the signal.
        blocks: Rows [N, Y, h, s] of blocks of the logs, for autocorrelations.
    """

    columns: NDArray[np.intp]
    Y: Array
    h: Array
    s: Array
    N: Array
    samples: int
    variance: float
    blocks: tuple[Array, ...]

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        joint: int,
        d: int,
        free: Sequence[Effect],
        *,
        added: Effect | None = None,
        held: Effect | None = None,
    ) -> SignalRows:
        """The rows of a joint.

        Args:
            dataset: Logs whose efforts are the signals, reduced.
            joint: Index of the joint.
            d: Number of inertial parameters.
            free: Effects whose columns are projected out.
            added: An effect whose column is added to the signal.
            held: What has the effort of known payloads as its column.
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
        if added is not None:
            mix[data.local(dataset.effect_columns(added)), -1] = 1.0
        factors = [factor[:, : last + 1] @ mix for factor in data.factors]
        samples = int(data.samples.sum())
        blocks = (np.hstack([part.A, part.b[:, :1]]) for fold in data.rows for part in fold)
        variance = float(dataset.effort_std[joint] ** 2)
        prior = np.eye(k, mix.shape[1]) * np.sqrt(np.array(known) * variance)[:, None]
        R = triangular_factor([prior, *factors])
        return cls(
            data.columns[inertial],
            R[k:, k:-2],
            R[k:, -2],
            R[k:, -1],
            R[:k],
            samples,
            variance,
            tuple(block @ mix for block in blocks),
        )

    def load(self, phi: Array) -> Array:
        """(r,) rows of the effort of the bodies and of known payloads, for φ (d,)."""
        return self.Y @ phi[self.columns] + self.h

    def least_squares_gain(self, phi: Array) -> float:
        """Gain a with these bodies, of this joint alone; negative if it clearly is."""
        load = self.load(phi)
        size = max(float(load @ load), np.finfo(float).tiny)
        a = float(load @ self.s) / size
        left = a * load - self.s
        error = float(np.sqrt(left @ left / (_FIRST_SHARE * self.samples * size)))
        return a if a < -_CLEARLY * error else float(max(abs(a), error))

    def least_cost(self, phi: Array, worth: float) -> float:
        """Twice the negative log-likelihood with these bodies and the gain that suits them best.

        Args:
            phi: (d,) inertial parameters.
            worth: Independent samples of the residual.
        """
        left = self.least_squares_gain(phi) * self.load(phi) - self.s
        return worth * float(np.log(left @ left / self.samples / self.variance + _NOTHING))

    def free_parameters(self, a: float, phi: Array, worth: float) -> tuple[Array, Array]:
        """Parameters (k,) of the free columns on the scale of the signal, and their deviations.

        Args:
            a: The inverse gain.
            phi: (d,) inertial parameters.
            worth: Independent samples of the residual.
        """
        k, body = len(self.N), np.concatenate([a * phi[self.columns], [a, -1.0]])
        N = self.N[:, :k]
        left = a * self.load(phi) - self.s
        noise = left @ left / max(worth, 1.0)
        spread = noise * np.diag(np.linalg.pinv(N.T @ N, hermitian=True))
        return np.linalg.lstsq(N, -self.N[:, k:] @ body, rcond=None)[0], np.sqrt(spread)

    def effective(self, a: float, phi: Array) -> float:
        """How many independent samples the residual is worth.

        Args:
            a: The inverse gain.
            phi: (d,) inertial parameters.
        """
        free = self.free_parameters(a, phi, 1.0)[0]
        x = np.concatenate([free, a * phi[self.columns], [a, -1.0]])
        series = [[(rows @ x)[:, None] for rows in self.blocks]]
        return float(effective_samples_of_each(series)[0, 0])


@dataclass(frozen=True, eq=False)
class _GeodesicBodies:
    """Bodies as end points of geodesics from where a model has them.

    Attributes:
        factors: (nb, 4, 4) lower factors L of P₀ = L Lᵀ.
        information: (d, d) of the coordinates x of X, in an orthonormal basis of Sym(4).
    """

    factors: Array
    information: Array

    @classmethod
    def of(cls, model: RobotModel) -> _GeodesicBodies:
        """Bodies about those of a model, as well known as it says."""
        factors = np.asarray(np.linalg.cholesky(pseudo_inertia(model.total_phi)), float)
        d = model.phi.size
        free = cls(factors, np.eye(d) / SPREAD**2)
        slope = free.at(np.zeros(d))[1]
        if model.information is not None:
            whole = model.information
            others = np.linalg.pinv(whole[d:, d:], hermitian=True)  # which are free here
            known = whole[:d, :d] - whole[:d, d:] @ others @ whole[d:, :d]
            return replace(free, information=slope.T @ known @ slope)
        total = slope[::PARAMETERS_PER_BODY].sum(axis=0) / model.total_phi[:, 0].sum()
        told = np.outer(total, total) / _TOTAL_MASS**2
        return replace(free, information=free.information + told)

    def at(self, x: Array) -> tuple[Array, Array]:
        """φ (d,) and its slope (d, d) with the coordinates x (d,)."""
        X = np.einsum("bi,iac->bac", x.reshape(-1, PARAMETERS_PER_BODY), _SYMMETRIC)
        w, V = np.linalg.eigh(X)
        e, gap = np.exp(w), w[:, :, None] - w[:, None, :]
        same = np.abs(gap) < 1e-6  # where the divided difference of exp is its slope
        mean = np.exp(0.5 * (w[:, :, None] + w[:, None, :]))
        rise = np.where(same, mean, (e[:, :, None] - e[:, None, :]) / np.where(same, 1.0, gap))
        inner = np.einsum("bka,ikl,blc->biac", V, _SYMMETRIC, V)  # Vᵀ E V of each direction E
        LV = self.factors @ V
        P = np.einsum("bak,bk,bck->bac", LV, e, LV)
        dP = np.einsum("bak,bikl,bcl->biac", LV, inner * rise[:, None], LV)
        slope = np.zeros((len(P), PARAMETERS_PER_BODY, len(P), PARAMETERS_PER_BODY))
        each = np.arange(len(P))
        slope[each, :, each] = np.swapaxes(from_pseudo_inertia(dP), 1, 2)
        return from_pseudo_inertia(P).ravel(), slope.reshape(x.size, x.size)


def _orthonormal_symmetric() -> Array:
    """(10, 4, 4) orthonormal basis of the symmetric matrices."""
    found = []
    for i in range(4):
        for j in range(i + 1):
            E = np.zeros((4, 4))
            E[i, j] = E[j, i] = 1.0 if i == j else np.sqrt(0.5)
            found.append(E)
    return np.array(found)


_SYMMETRIC = _orthonormal_symmetric()


@dataclass(frozen=True, eq=False)
class _GainPoint:
    """Bodies and gains on the way to the likeliest ones.

    Attributes:
        rows: What the logs say of each joint.
        bodies: What is known of the bodies.
        told: (nv, nv) information of log |a|.
        worth: (nv,) independent samples of each joint's residual.
        x: (d,) coordinates of the bodies.
        a: (nv,) inverse gains.
    """

    rows: Sequence[SignalRows]
    bodies: _GeodesicBodies
    told: Array
    worth: Array
    x: Array
    a: Array

    @cached_property
    def _phi(self) -> tuple[Array, Array]:
        return self.bodies.at(self.x)

    @cached_property
    def mse(self) -> Array:
        """(nv,) mean squared residual of each joint over the variance of its signal."""
        left = [a * rows.load(self._phi[0]) - rows.s for rows, a in self._pairs]
        return np.array(
            [r @ r / rows.samples / rows.variance for r, rows in zip(left, self.rows, strict=True)]
        )

    @property
    def _pairs(self) -> list[tuple[SignalRows, float]]:
        return list(zip(self.rows, self.a.tolist(), strict=True))

    def effective(self) -> Array:
        """(nv,) independent samples of each residual."""
        return np.array([rows.effective(a, self._phi[0]) for rows, a in self._pairs])

    @cached_property
    def cost(self) -> float:
        """Twice the negative log-likelihood, noise profiled out, with what is known before."""
        gains = np.log(np.abs(self.a))
        told = gains @ self.told @ gains
        noise = self.worth @ np.log(self.mse + _NOTHING)
        return float(noise + told + self.x @ self.bodies.information @ self.x)

    @cached_property
    def _system(self) -> tuple[Array, Array, Array]:
        """Gauss–Newton information and slope of half the cost, and what is unexplained."""
        d, (phi, slope) = len(self.x), self._phi
        size = d + len(self.a)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        information[:d, :d] = self.bodies.information
        gradient[:d] = self.bodies.information @ self.x
        information[d:, d:] = self.told
        gradient[d:] = self.told @ np.log(np.abs(self.a))
        unexplained = np.zeros((size, size))
        for j, (rows, a) in enumerate(self._pairs):
            load = rows.load(phi)
            J = np.zeros((len(load), size))
            J[:, :d] = a * rows.Y @ slope[rows.columns]
            J[:, d + j] = a * load
            weight = self.worth[j] / (rows.samples * rows.variance * (self.mse[j] + _NOTHING))
            information += weight * J.T @ J
            gradient += weight * J.T @ (a * load - rows.s)
            unexplained += self.worth[j] / WORTH * weight * J.T @ J
        return information, gradient, unexplained

    def converged(self) -> _GainPoint:
        """After Gauss–Newton steps, each as long as the cost falls."""
        here, d = self, len(self.x)
        for _ in range(_STEPS):
            step = -np.linalg.solve(*here._system[:2])
            share = min(1.0, _LONGEST / max(float(np.abs(step).max()), _NOTHING))
            there = here.moved(share * step[:d], share * step[d:])
            while not there.cost < here.cost and share > _SHORTEST:
                share *= 0.5
                there = here.moved(share * step[:d], share * step[d:])
            if not there.cost < here.cost - _CLOSE:
                break
            here = there
        return here

    def moved(self, x: Array, log_a: Array) -> _GainPoint:
        """Another point, by steps of the coordinates and of log |a|."""
        return replace(self, x=self.x + x, a=self.a * np.exp(log_a))

    def result(self) -> SignalGains:
        """What is told of it.

        What stays unexplained goes with the motion, as in `systematic.unexplained_covariance`: it
        is worth few samples, however long logs are.
        """
        information, _, unexplained = self._system
        d, inverse = len(self.x), np.linalg.inv(information)
        covariance = inverse + inverse @ unexplained @ inverse
        return SignalGains(
            1.0 / self.a,
            np.sqrt(np.diag(covariance)[d:]),
            self._phi[0].reshape(-1, PARAMETERS_PER_BODY),
            np.sqrt(self.mse),
            self.worth,
        )
