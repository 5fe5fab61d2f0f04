"""One score of an assignment of columns: how well the model predicts held-out efforts with it.

All joints are fitted together. Bodies are near those of the model,

    Σ_b (tr P₀⁻¹P − log det P₀⁻¹P − 4) / σ²,

which is the squared geometric distance over σ² where they are near, and infinite for what is no
body ([Lee2019] section 3.5). Friction, offsets and rotors are free, and the base may be tilted, and
gains and zeros be off, as much as is usual. A joint's noise is profiled out on the scale of its
column, so that a gain of zero explains nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.design import (
    USUAL_REST,
    EffectRows,
    JointDesign,
    Parameters,
    joint_designs,
    nuisance_information,
)
from geodrake.diagnosis.columns.limits import spread
from geodrake.diagnosis.columns.samples import ColumnSamples
from geodrake.identification.logs.criteria import LEAST_NOISE, SPREAD
from geodrake.identification.logs.unknowns import payload_reference
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.inertia.kernels import BASIS, calc_pseudo_inertia

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CARRIED = 3.0
"""A body that may hold a payload is known to within this geometric distance."""

_ROUNDS, _QUICK_ROUNDS = 60, 8  # of Newton's method at most, in which weights change too
_MOST_KEPT = 200_000_000  # bytes of normal matrices
_SCREENINGS = 3  # fits of a screening
_SETTLED = 0.1  # of twice a log-likelihood: how little the last of them gains
_FIRST = 0.1  # of the samples are independent, before residuals say
_FURTHEST = 0.5  # that errors of gains go in a step, of their logarithms
_INSIDE = 0.9  # of the way to where a body is none
_RATE_AGREEMENT = 0.05  # of a velocity's RMS: measured ones are the derivatives but for that
_WIDE = 2.0  # deviation of a small error that is to be found, rad or as a share
_FIXED = 1e12  # information of what is known
_ROUNDING = 1e-14  # of a diagonal of ones


@dataclass(frozen=True, eq=False)
class ColumnFit:
    """A fit by one assignment.

    Attributes:
        assignment: The assignment.
        x: (p,) parameters.
        mse: (n,) mean squared errors of each column of efforts, in its own unit: held-out ones,
            but for a quick fit.
        effective: (n,) independent samples that its residuals are worth.
        rates: (n,) mean squared errors of each column of velocities over its mean square; ones
            where there are none.
        prior: What parameters pay that go far.
        fitted: (n,) mean squared errors of the data that were fitted.
    """

    assignment: Assignment
    x: Array
    mse: Array
    effective: Array
    rates: Array
    prior: float
    fitted: Array

    def gain_over(self, other: ColumnFit, samples: Array) -> float:
        """Twice the log-likelihood ratio, less what parameters pay that go far.

        It is the lesser one of what data gain that were fitted, and of what held-out ones do.

        Args:
            other: The fit by another assignment.
            samples: (n,) independent samples of the velocities.
        """
        effective = np.minimum(self.effective, other.effective)
        efforts = min(
            effective @ np.log(other.mse / self.mse), effective @ np.log(other.fitted / self.fitted)
        )
        rates = samples @ np.log(other.rates / self.rates)
        return float(efforts + rates + other.prior - self.prior)


@dataclass(eq=False)
class ColumnJudge:
    """Fits of the same samples by any assignment.

    Attributes:
        samples: The samples.
        parameters: What fits may move.
    """

    samples: ColumnSamples
    parameters: Parameters
    _designs: dict[tuple[object, ...], tuple[JointDesign, ...]] = field(default_factory=dict)
    _screened: dict[tuple[object, ...], ColumnFit] = field(default_factory=dict)
    _summaries: dict[tuple[object, ...], tuple[JointDesign, ...]] = field(default_factory=dict)
    _limited: dict[tuple[object, ...], JointDesign] = field(default_factory=dict)
    _rows: EffectRows = field(default_factory=dict)

    def keep(self, assignment: Assignment) -> None:
        """Keep the designs for the motion of an assignment, and forget all others."""
        kept = self._unlimited(assignment)
        self._designs, self._screened = {assignment.motion_key: kept}, {}
        self._limited = {
            assignment.limit_key(j): kept[j].limited(self.samples, assignment, j)
            for j in assignment.limited_joints
        }

    def designs(self, assignment: Assignment) -> tuple[JointDesign, ...]:
        """Normal matrices for the motion of an assignment, fold by fold.

        Args:
            assignment: The assignment.
        """
        return self._within_limits(assignment, self._unlimited(assignment))

    def _unlimited(self, assignment: Assignment) -> tuple[JointDesign, ...]:
        """Those of efforts as they are in the log."""
        found = self._designs.get(assignment.motion_key)
        return self._made(assignment, slopes=True) if found is None else found

    def _within_limits(
        self, assignment: Assignment, designs: tuple[JointDesign, ...]
    ) -> tuple[JointDesign, ...]:
        """Those of efforts that motors can give."""
        found = list(designs)
        is_kept = designs is self._designs.get(assignment.motion_key)
        for j in assignment.limited_joints:
            known = self._limited.get(assignment.limit_key(j)) if is_kept else None
            found[j] = known or designs[j].limited(self.samples, assignment, j)
        return tuple(found)

    def summaries(self, assignment: Assignment, *, slopes: bool) -> tuple[JointDesign, ...]:
        """Those of all folds together, which further fits of the same motion find again.

        Args:
            assignment: The assignment.
            slopes: Whether errors of zeros have their columns.
        """
        if kept := self._designs.get(assignment.motion_key):
            return self._within_limits(assignment, kept)
        key = (
            *assignment.motion_key,
            slopes,
            *map(assignment.limit_key, assignment.limited_joints),
        )
        found = self._summaries.get(key)
        if found is None:
            made = self._made(assignment, slopes=slopes)
            found = tuple(d.summary for d in self._within_limits(assignment, made))
            each = sum(design.grams.nbytes for design in found)
            if (len(self._summaries) + 1) * each < _MOST_KEPT:
                self._summaries[key] = found
        return found

    def _made(self, assignment: Assignment, *, slopes: bool) -> tuple[JointDesign, ...]:
        return joint_designs(self.samples, self.parameters, assignment, self._rows, slopes=slopes)

    def screened(
        self, assignment: Assignment, base: ColumnFit, wide: Collection[int] = ()
    ) -> ColumnFit:
        """Errors of the data that were fitted, for bodies whose prior is that near the model's.

        Args:
            assignment: The assignment.
            base: A fit whose errors say how much each joint counts at first.
            wide: Parameters of small errors that may be large.
        """
        key = (assignment.effort_key, *wide)
        found = self._screened.get(key)
        if found is None:
            designs = self.summaries(assignment, slopes=bool(wide))
            found = _System.of(self, designs, assignment, wide).screened(base)
            self._screened[key] = found
        return replace(found, assignment=assignment, rates=self.rate_errors(assignment))

    def quick(
        self, assignment: Assignment, base: ColumnFit, wide: Collection[int] = ()
    ) -> ColumnFit:
        """Return a fit with errors of the data that it was fitted to.

        Args:
            assignment: The assignment.
            base: A fit whose errors say how much each joint counts at first.
            wide: Parameters of small errors that may be large.
        """
        system = _System.of(self, self.summaries(assignment, slopes=bool(wide)), assignment, wide)
        return system.fitted(base.effective, _QUICK_ROUNDS, base.mse, held_out=False)

    def fit(
        self,
        assignment: Assignment,
        base: ColumnFit | None = None,
        *,
        wide: Collection[int] = (),
    ) -> ColumnFit:
        """Return the fit by an assignment, whose residuals say how many samples are independent.

        Args:
            assignment: The assignment.
            base: A fit whose errors say how much each joint counts at first.
            wide: Parameters of small errors that may be large.
        """
        designs = self.designs(assignment)
        system = _System.of(self, designs, assignment, wide)
        effective = np.full(len(designs), _FIRST * len(self.samples))
        mse = self.samples.effort.var(axis=0)
        if base is not None:
            effective, mse = base.effective, base.mse
        first = system.fitted(effective, _ROUNDS, mse, held_out=False)
        return system.fitted(system.effective(first), _ROUNDS, first.mse, start=first.x)

    def needed(self, fit: ColumnFit) -> list[Array]:
        """Per joint (K,) efforts that bodies and effects of a fit need.

        Args:
            fit: A fit to the kept samples.
        """
        assignment, designs = fit.assignment, self.designs(fit.assignment)
        left = _System.of(self, designs, assignment, ()).residuals(fit)
        return [
            r + gain * design.X[:, len(design.columns) + 1 + column]
            for r, design, gain, column in zip(
                left, designs, assignment.gain, assignment.effort, strict=True
            )
        ]

    def spared(self, base: ColumnFit, parameters: Indices) -> float:
        """What a fit pays for parameters that data say and the prior does not, as evidence does.

        It is the logarithm of how many times smaller the volume of their covariance has become.

        Args:
            base: The fit.
            parameters: Indices of the parameters.
        """
        designs = self.designs(base.assignment)
        A, H = _System.of(self, designs, base.assignment, ()).curvature(base)
        both = [_log_volume(M, parameters) for M in (H, A)]
        return float(max(both[0] - both[1], 0.0))

    def rate_errors(self, assignment: Assignment) -> Array:
        """(n,) mean squared errors of measured velocities' columns, over their mean squares."""
        samples, found = self.samples, np.ones(len(assignment.gain))
        if samples.rate is None:
            return found
        share = assignment.scale / (assignment.time * assignment.rate)
        at = assignment.position
        error = np.mean((samples.rate[:, at] - samples.v[:, at] * share) ** 2, axis=0)
        size = np.mean(samples.rate[:, at] ** 2, axis=0)
        slow = np.mean(samples.v[:, at] ** 2, axis=0) < samples.width[at] ** 2
        relative = np.maximum(error / np.maximum(size, 1e-300), _RATE_AGREEMENT**2)
        found[at] = np.where(slow | (size == 0.0), 1.0, relative)
        return found


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations of all joints.

    Attributes:
        judge: What it belongs to.
        designs: Of all joints.
        assignment: The assignment.
        columns: Per joint, its parameters, its gain's error last.
        maps: Per joint, from these and the efforts to the columns of its design, for no error of
            its gain.
        mean: (p,) prior mean.
        information: (p, p) prior information, zero for bodies that `spread` is of.
        lower: (p,) lower bounds.
        spread: (nb,) geometric distance to within which bodies are known; inf where `information`
            says it.
    """

    judge: ColumnJudge
    designs: tuple[JointDesign, ...]
    assignment: Assignment
    columns: tuple[Indices, ...]
    maps: tuple[Array, ...]
    mean: Array
    information: Array
    lower: Array
    spread: Array

    @classmethod
    def of(
        cls,
        judge: ColumnJudge,
        designs: tuple[JointDesign, ...],
        assignment: Assignment,
        wide: Collection[int],
    ) -> _System:
        parameters, n = judge.parameters, len(designs)
        mean, information = parameters.mean.copy(), parameters.information.copy()
        sizes = np.abs(assignment.gain) * judge.samples.effort.std(axis=0)[assignment.effort]
        diagonal = np.arange(len(mean))
        information[diagonal, diagonal] += nuisance_information(parameters, designs, sizes)
        for k in (*wide, *(parameters.tilt().tolist() if assignment.tilted else ())):
            information[k, k] = _WIDE**-2.0
        gone, lower = parameters.taken_out(assignment.without), parameters.lower.copy()
        left = np.maximum((USUAL_REST * mean[gone]) ** 2.0, 1.0 / _FIXED)
        mean[gone], lower[gone] = 0.0, -np.inf
        information[gone] = information[:, gone] = 0.0
        information[gone, gone] = 1.0 / left
        model = parameters.model
        spread = np.full(len(model.bodies), SPREAD if model.information is None else np.inf)
        for body in assignment.carrying:
            own = slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1))
            mean[own] += payload_reference(model.total_phi)
            spread[body] = CARRIED
        for b in np.flatnonzero(np.isfinite(spread)).tolist():
            own = slice(PARAMETERS_PER_BODY * b, PARAMETERS_PER_BODY * (b + 1))
            information[own] = information[:, own] = 0.0
        columns, maps = [], []
        for j, design in enumerate(designs):
            m = len(design.columns)
            T = np.zeros((m + 1 + n, m + 2))
            T[range(m), range(m)] = 1.0
            T[m, m + 1] = -1.0
            T[m + 1 + assignment.effort[j], m + 1] = assignment.gain[j]
            if j in assignment.apart:
                T[: np.searchsorted(design.columns, model.phi.size)] = 0.0
                T[np.searchsorted(design.columns, parameters.shared) : m + 1] = 0.0
            columns.append(np.append(design.columns, parameters.gains()[j]))
            maps.append(T)
        return cls(
            judge,
            designs,
            assignment,
            tuple(columns),
            tuple(maps),
            mean,
            information,
            lower,
            spread,
        )

    def totals(self, x: Array) -> Array:
        """(n, p + 1, p + 1) normal matrices of all folds, efforts last, for errors near x's."""
        return self._dense(x, [design.total for design in self.designs])

    def folds(self, x: Array) -> Iterator[Array]:
        """The same of each fold."""
        for f in range(len(self.designs[0].grams)):
            yield self._dense(x, [design.grams[f] for design in self.designs])

    def _dense(self, x: Array, grams: list[Array]) -> Array:
        p = len(self.mean)
        found = np.zeros((len(grams), p + 1, p + 1))
        for out, columns, T, gram in zip(found, self.columns, self._maps(x), grams, strict=True):
            at, m = np.append(columns, p), len(columns) - 1
            scale, ends = T.diagonal()[:m], T[:, m:]  # a map is diagonal but for its last columns
            mapped = gram @ ends
            beside = scale[:, None] * mapped[:m]
            inner = scale[:, None] * gram[:m, :m] * scale
            out[at[:, None], at] = np.block([[inner, beside], [beside.T, ends.T @ mapped]])
        return found

    def _maps(self, x: Array) -> Iterator[Array]:
        """Per joint the map of parameters near x, where its gain's error acts on what x needs.

        An effort is what is needed times the exponential of its gain's error.
        """
        for j, (columns, base) in enumerate(zip(self.columns, self.maps, strict=True)):
            T, m = base.copy(), len(columns) - 1
            if j not in self.assignment.apart:
                error = x[columns[m]]
                T[: m + 1] *= np.exp(error)
                needed = T[: m + 1] @ np.append(x[columns[:m]], [0.0, -1.0])
                T[: m + 1, m] = needed
                T[: m + 1, m + 1] += error * needed
            yield T

    def curvature(self, fit: ColumnFit) -> tuple[Array, Array]:
        """(p, p) of half the cost of a fit by this assignment, and of that of the prior alone."""
        assignment = self.assignment
        samples = np.array([len(design.rows) for design in self.designs], float)
        mse = fit.fitted[assignment.effort] * np.square(assignment.gain)
        weight = fit.effective[assignment.effort] / samples / mse
        H, _ = self._prior(fit.x)
        return H + np.tensordot(weight, self.totals(fit.x), 1)[:-1, :-1], H

    def screened(self, base: ColumnFit) -> ColumnFit:
        """See `ColumnJudge.screened`."""
        assignment, each = self.assignment, base.effective[self.assignment.effort]
        samples = np.array([len(design.rows) for design in self.designs], float)
        totals = self.totals(self.mean)
        power = totals[:, -1, -1] / samples
        least, scale = power * LEAST_NOISE**2 + 1e-300, np.square(assignment.gain)
        mse = np.minimum(base.fitted[assignment.effort] * scale, power)
        lower = self.lower
        x, held = self.mean, np.zeros(len(self.mean), bool)
        H, b = self._prior(self.mean)
        for _ in range(_SCREENINGS):
            total = np.tensordot(each / samples / np.maximum(mse, least), totals, 1)
            x = bounded(H + total[:-1, :-1], b + total[:-1, -1], lower, held)
            held = held | (x < lower)
            x = np.where(held, lower, x)
            mse = np.maximum(_squares(totals, x) / samples, least)
        far, by_column = x - self.mean, np.zeros(len(samples))
        by_column[assignment.effort] = self._spread(mse) / scale
        return ColumnFit(
            assignment,
            x,
            by_column,
            base.effective,
            base.rates,
            float(far @ H @ far),
            by_column,
        )

    def _prior(self, x: Array) -> tuple[Array, Array]:
        """Curvature (p, p) of half the prior's cost at x, and what it adds to the right side."""
        H, b, k = self.information.copy(), self.information @ self.mean, PARAMETERS_PER_BODY
        phi = self._bodies(x)
        G = _metric(phi)
        sides = 2.0 * np.einsum("bij,bj->bi", G, phi) - self._pull
        for body, metric, side in zip(self._near.tolist(), G, sides, strict=True):
            own = slice(k * body, k * (body + 1))
            H[own, own] = metric / self.spread[body] ** 2
            b[own] = side / self.spread[body] ** 2
        return H, b

    def prior_cost(self, x: Array) -> float:
        """Return what parameters pay that go far."""
        far = x - self.mean
        ratio = _turned(self._prior_whitening, self._bodies(x))
        values = np.maximum(np.linalg.eigvalsh(ratio), 1e-300)
        cost = np.sum(values - 1.0 - np.log(values), axis=1) / self.spread[self._near] ** 2
        return float(far @ self.information @ far + cost.sum())

    def _bodies(self, x: Array) -> Array:
        """(nb, 10) inertial parameters of the bodies that `spread` is of."""
        d = self.judge.parameters.model.phi.size
        return np.asarray(x[:d].reshape(-1, PARAMETERS_PER_BODY)[self._near])

    @cached_property
    def _near(self) -> Indices:
        """(nb,) indices of the bodies that `spread` is of."""
        return np.flatnonzero(np.isfinite(self.spread))

    @cached_property
    def _pull(self) -> Array:
        """(nb, 10) metrics at the prior mean times that mean."""
        start = self._bodies(self.mean)
        return np.asarray(np.einsum("bij,bj->bi", _metric(start), start))

    @cached_property
    def _prior_whitening(self) -> Array:
        """(nb, 4, 4) inverse Cholesky factors of the bodies at the prior mean."""
        return _whitening(self._bodies(self.mean))

    def _stepped(self, x: Array, to: Array) -> Array:
        """From x towards other parameters, as far as bodies remain some and steps tell of gains."""
        here, there = self._bodies(x), self._bodies(to)
        ratio = _turned(_whitening(here), there)
        least = np.linalg.eigvalsh(ratio)[:, 0] - 1.0  # of the change, by how much there is
        share = np.where(least < -_INSIDE, _INSIDE / np.maximum(-least, 1e-300), 1.0)
        found, d = to.copy(), self.judge.parameters.model.phi.size
        bodies = found[:d].reshape(-1, PARAMETERS_PER_BODY)
        bodies[self._near] = here + share[:, None] * (there - here)
        gains = self.judge.parameters.gains()
        found[gains] = x[gains] + np.clip(to[gains] - x[gains], -_FURTHEST, _FURTHEST)
        return found

    def fitted(
        self,
        effective: Array,
        rounds: int,
        mse: Array,
        *,
        held_out: bool = True,
        start: Array | None = None,
    ) -> ColumnFit:
        """Return the fit.

        Args:
            effective: (n,) independent samples of the columns of efforts.
            rounds: Most steps of Newton's method.
            mse: (n,) squared errors of the columns that say how much each counts at first.
            held_out: Whether errors are those of data left out of the fit.
            start: (p,) parameters to start from; those of the model by default.
        """
        assignment, lower = self.assignment, self.lower
        samples = np.array([len(design.rows) for design in self.designs], float)
        each = effective[assignment.effort]
        power = self.totals(self.mean)[:, -1, -1] / samples
        least = power * LEAST_NOISE**2 + 1e-300
        scale = np.square(assignment.gain)
        x = self.mean.copy() if start is None else start
        totals = self.totals(x)
        mse = np.minimum(mse[assignment.effort] * scale, power)
        held = np.zeros(len(x), bool) if start is None else (x == lower)
        cost = np.inf
        for _ in range(rounds):
            weight = each / samples / np.maximum(mse, least)
            H, b = self._prior(x)
            total = np.tensordot(weight, totals, 1)
            A, side = H + total[:-1, :-1], b + total[:-1, -1]
            x = self._stepped(x, bounded(A, side, lower, held))
            held = held_next(A, side, x, lower, held)
            x = np.maximum(x, lower)
            totals = self.totals(x)
            mse = np.maximum(_squares(totals, x) / samples, least)
            cost, before = float(each @ np.log(mse)) + self.prior_cost(x), cost
            if abs(before - cost) < _SETTLED:
                break
        fitted = mse
        if held_out:
            weight = each / samples / np.maximum(mse, least)
            H, b = self._prior(x)
            total = np.tensordot(weight, totals, 1)
            squares = np.zeros(len(samples))
            for own in self.folds(x):
                rest = total - np.tensordot(weight, own, 1)
                to = bounded(H + rest[:-1, :-1], b + rest[:-1, -1], lower, held)
                squares += _squares(own, self._stepped(x, to))
            mse = squares / samples
        by_column, own = np.zeros((2, len(samples)))
        by_column[assignment.effort] = self._spread(np.maximum(mse, least)) / scale
        own[assignment.effort] = self._spread(np.maximum(fitted, least)) / scale
        rates, prior = self.judge.rate_errors(assignment), self.prior_cost(x)
        return ColumnFit(assignment, x, by_column, effective, rates, prior, own)

    def _spread(self, mse: Array) -> Array:
        """(n,) mean squared errors, those of efforts beyond a limit counted as they are."""
        pairs = zip(mse.tolist(), self.designs, strict=True)
        return np.array([spread(error, design.beyond) for error, design in pairs])

    def residuals(self, fit: ColumnFit) -> list[Array]:
        """Per joint (K,) what is needed by a fit, less the efforts."""
        each = zip(self.columns, self._maps(fit.x), self.designs, strict=True)
        return [design.X @ (T @ np.append(fit.x[columns], -1.0)) for columns, T, design in each]

    def effective(self, fit: ColumnFit) -> Array:
        """(n,) independent samples that the residuals of each column of efforts are worth."""
        left = self.residuals(fit)
        found = np.zeros(len(left))
        rows = [design.rows for design in self.designs]
        found[self.assignment.effort] = self.judge.samples.effective(left, rows)
        return found


def _whitening(phi: Array) -> Array:
    """(nb, 4, 4) inverses of the Cholesky factors of pseudo-inertias."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(calc_pseudo_inertia(phi))))


def _turned(L: Array, phi: Array) -> Array:
    """(nb, 4, 4) symmetric matrices similar to P₀⁻¹P, of the whitenings L of P₀."""
    return np.asarray(L @ calc_pseudo_inertia(phi) @ np.swapaxes(L, 1, 2))


def _metric(phi: Array) -> Array:
    """(b, 10, 10) matrices ½ tr(P⁻¹ P(e_i) P⁻¹ P(e_j)) of bodies that are some."""
    solved = np.linalg.inv(calc_pseudo_inertia(phi))[:, None] @ BASIS
    flat = solved.reshape(len(phi), PARAMETERS_PER_BODY, 16)
    turned = np.swapaxes(solved, 2, 3).reshape(flat.shape)
    return np.asarray(0.5 * flat @ np.swapaxes(turned, 1, 2))


def _squares(grams: Array, x: Array) -> Array:
    """(n,) sums of squared residuals from normal matrices (n, p + 1, p + 1)."""
    own = np.append(x, -1.0)
    return np.maximum((grams @ own) @ own, 0.0)


def bounded(A: Array, b: Array, lower: Array, held: NDArray[np.bool_]) -> Array:
    """Solution (p,) of a positive definite system, some of the unknowns at their lower bounds.

    Args:
        A: (p, p) the system.
        b: (p,) its right side.
        lower: (p,) lower bounds.
        held: (p,) which unknowns are at theirs.
    """
    if not held.any():
        return _solved(A, b)
    x, free = np.where(held, lower, 0.0), np.flatnonzero(~held)
    b = b - A[:, held] @ x[held]
    x[free] = _solved(A[free[:, None], free], b[free])
    return x


def held_next(
    A: Array, b: Array, x: Array, lower: Array, held: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(p,) which unknowns are held at their lower bounds next, for the least of ½ xᵀAx − bᵀx.

    Those that have gone below theirs are, and those that were and are not drawn inside.

    Args:
        A: (p, p) the system.
        b: (p,) its right side.
        x: (p,) where a step led.
        lower: (p,) lower bounds.
        held: (p,) which unknowns were held in it.
    """
    return np.where(held, A @ x >= b, x < lower)


def _log_volume(A: Array, parameters: NDArray[np.intp]) -> float:
    """Log determinant of the covariance of some parameters, of all parameters' information A."""
    scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), 1e-300))
    scaled = A * scale * scale[:, None]
    np.fill_diagonal(scaled, 1.0 + _ROUNDING)
    others = np.setdiff1d(np.arange(len(A)), parameters)
    without = float(np.linalg.slogdet(scaled[np.ix_(others, others)])[1])
    whole = float(np.linalg.slogdet(scaled)[1])
    return without - whole + 2.0 * float(np.log(scale[parameters]).sum())


def _solved(A: Array, b: Array) -> Array:
    """Solution of a positive definite system whose unknowns are in units of any size."""
    scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), 1e-300))
    scaled = A * scale * scale[:, None]
    rounding = _ROUNDING
    while True:
        np.fill_diagonal(scaled, 1.0 + rounding)
        _, x, info = dposv(scaled, scale * b)
        if info == 0:
            return np.asarray(scale * x)
        rounding *= 10.0
