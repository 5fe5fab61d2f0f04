"""Fit problems: triangular data, physical bodies, bounds and a prior."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from geodrake.boundary.arguments import instance, instances, integer, integers, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical, pseudo_inertia
from geodrake.inertia.parameters import from_dual
from geodrake.robot.reduction import triangular_factor


def whitened_factor(A: ArrayLike, b: ArrayLike, *, sigma: ArrayLike | None = None) -> Array:
    """Return the triangular factor [R r; 0 ρ] (p + 1, p + 1) of the whitened data [A | b]/σ.

    ‖A x − b‖²_{Σ⁻¹} = ‖R x − r‖² + ρ² for every x. The arguments are those of `identify`.
    """
    return triangular_factor([whitened(A, b, sigma=sigma)])


def whitened(A: ArrayLike, b: ArrayLike, *, sigma: ArrayLike | None = None) -> Array:
    """Return the rows [A | b]/σ, (m, p + 1), of the arguments of `whitened_factor`."""
    A = real_array(A, "A", ("m", "n"))
    b = real_array(b, "b", (len(A),))
    deviations = real_array(1.0 if sigma is None else sigma, "sigma")
    if deviations.ndim:
        deviations = real_array(deviations, "sigma", (len(A),))
    if not np.all(deviations > 0):
        raise ArgumentError(
            f"sigma has values that are not positive (smallest: {np.min(deviations):g}).",
            advice="Use positive standard deviations in the units of b.",
        )
    return np.column_stack([A, b]) / np.broadcast_to(deviations, b.shape)[:, None]


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearConstraints:
    """Constraints `lower ≤ matrix x ≤ upper` with a matrix (k, p); limits (k,) may be infinite."""

    matrix: Array
    lower: Array
    upper: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FitProblem(Short):
    """Convex fit of a vector x of inertial parameters and scalar effect parameters.

    Minimizes, subject to P ≻ 0 for every inertia block φ_i of x, bounds and constraints,

        ‖R x − r‖² + (x − x₀)ᵀ Λ (x − x₀) + Σ_i γ_i d(φ_i ‖ φ_i⁰)² + Σ_k γ_k d(x_k ‖ x_k⁰)²

    ([Lee2019] Eqs. (3.5.43), (3.5.47)); with `residual_bound` c it minimizes the last two terms
    subject to ‖R x − r‖² ≤ c instead (Eq. (3.5.52)). P ≻ 0 is enforced as
    P(φ_i) ⪰ margin · P(reference_i), because solvers return points on the boundary.
    """

    factor: Array  # (k, p + 1) factor [R | r] of the whitened data, such as `whitened_factor`
    inertia_blocks: tuple[int, ...]  # first columns of the blocks of ten inertial parameters
    prior_mean: Array  # (p,) x₀
    prior_information: Array  # (p, p) positive semidefinite Λ
    # (p,) bounds of the scalar parameters, −inf and inf for none.
    lower: Array = field(default_factory=lambda: np.array(-np.inf))
    upper: Array = field(default_factory=lambda: np.array(np.inf))
    # First column of a block -> (φ⁰ (10,), γ) of its entropic divergence.
    entropic: Mapping[int, tuple[Array, float]] = field(default_factory=dict)
    # First column of a block -> physical φ (10,) of the expected size; by default φ⁰ of `entropic`,
    # or the prior mean.
    reference: Mapping[int, Array] = field(default_factory=dict)
    # Column of a positive scalar -> (x⁰, w). A regularizer of weight γ adds γ w d(x, x⁰)²
    # ([Lee2019] Remark 3.13); without one, x⁰ only sets the scale.
    scalar_priors: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    # Column of a positive scalar -> (x⁰, γ) of its entropic divergence x/x⁰ − log(x/x⁰) − 1
    # (Eq. (5.3.33)).
    entropic_scalars: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    constraints: LinearConstraints | None = None
    residual_bound: float | None = None  # c of the point-to-set form; None for the sum
    margin: float = 1e-4  # smallest allowed eigenvalue of P(reference)⁻¹ P(φ)

    def __post_init__(self) -> None:
        """Check all fields, and complete bounds and references."""
        put = object.__setattr__
        put(self, "factor", real_array(self.factor, "factor", ("m", "n")))
        p = self.factor.shape[1] - 1
        put(self, "prior_mean", real_array(self.prior_mean, "prior_mean", (p,)))
        put(self, "prior_information", _information(self.prior_information, p))
        put(self, "inertia_blocks", _blocks(self.inertia_blocks, p))
        inertial = {k for start in self.inertia_blocks for k in range(start, start + 10)}
        for name in ("lower", "upper"):
            bound = real_array(getattr(self, name), name, finite=False)
            if bound.shape not in ((), (p,)):
                raise ArgumentError(f"{name} must have shape ({p},); got {bound.shape}.")
            put(self, name, np.broadcast_to(bound, p))
        if len(empty := np.flatnonzero(~(self.lower <= self.upper))):
            raise ArgumentError(
                f"Parameters {empty.tolist()} have a lower bound above the upper one."
            )
        if np.isfinite([self.lower[[*inertial]], self.upper[[*inertial]]]).any():
            raise ArgumentError(
                "Bounds are for scalar parameters, but an inertial parameter has one.",
                advice="State it as a row of `constraints`.",
            )
        put(self, "entropic", self._priors("entropic", set(self.inertia_blocks), (10,)))
        put(self, "reference", self._references())
        for name in ("scalar_priors", "entropic_scalars"):
            put(self, name, self._priors(name, set(range(p)) - inertial, ()))
        if self.constraints is not None:
            _check_constraints(self.constraints, p)
        if self.residual_bound is not None:
            number(self.residual_bound, "residual_bound", lower=0.0, strict=True, finite=False)
        number(self.margin, "margin", lower=0.0, upper=1.0, strict=True)

    @property
    def size(self) -> int:
        """Number p of parameters."""
        return len(self.prior_mean)

    def residual(self, x: ArrayLike) -> float:
        """Return the squared residual ‖R x − r‖² at parameters x (p,)."""
        errors = self.factor @ np.append(real_array(x, "x", (self.size,)), -1.0)
        return float(errors @ errors)

    def _priors(self, name: str, allowed: Set[int], shape: tuple[int, ...]) -> dict[int, Any]:
        """Return the checked (value, weight) pairs of a field, by column."""
        priors = {}
        for column, pair in instance(getattr(self, name), name, Mapping).items():
            if integer(column, f"a column of {name}") not in allowed:
                raise ArgumentError(
                    f"{name} has column {column}, but inertia blocks start at "
                    f"{list(self.inertia_blocks)}."
                    if shape
                    else f"{name} has column {column}, which is not a scalar parameter."
                )
            if len(instances(pair, f"{name}[{column}]", object)) != 2:
                raise ArgumentError(
                    f"{name}[{column}] must be a (value, weight) pair; got {pair!r}."
                )
            value: Any = real_array(pair[0], f"{name}[{column}]", shape)
            if not shape:
                value = number(float(value), f"x⁰ at column {column}", lower=0.0, strict=True)
            weight = number(pair[1], f"the weight at column {column}", lower=0.0, strict=True)
            priors[column] = (value, weight)
        return priors

    def _references(self) -> dict[int, Array]:
        instance(self.reference, "reference", Mapping)
        references = {}
        for start in self.inertia_blocks:
            given = self.reference.get(start, self.prior_mean[start : start + 10])
            given, _ = self.entropic.get(start, (given, None))
            references[start] = real_array(given, f"reference[{start}]", (10,))
        physical = is_physical(np.reshape(list(references.values()), (-1, 10)))
        if wrong := np.array(self.inertia_blocks, int)[~physical].tolist():
            raise ArgumentError(
                f"The inertia blocks at columns {wrong} have no physical reference: their "
                "prior mean is not a body of positive density.",
                advice="Give `reference` inertial parameters of the expected size for them.",
                columns=wrong,
            )
        return references


def _information(values: ArrayLike, p: int) -> Array:
    matrix = real_array(values, "prior_information", (p, p))
    scale = np.abs(matrix).max(initial=0.0)
    if not np.allclose(matrix, matrix.T, rtol=1e-8, atol=1e-10 * scale):
        raise ArgumentError("prior_information is not symmetric.")
    if np.any(np.diagonal(matrix) < 0):
        raise ArgumentError("prior_information has negative diagonal values.")
    return 0.5 * (matrix + matrix.T)


def _blocks(starts: tuple[int, ...], p: int) -> tuple[int, ...]:
    starts = integers(starts, "inertia_blocks")
    ordered = sorted(starts)
    gaps = np.diff([*ordered, p]) if ordered else np.empty(0)
    if (ordered and ordered[0] < 0) or np.any(gaps < PARAMETERS_PER_BODY):
        raise ArgumentError(
            f"Inertia blocks of ten columns starting at {ordered} overlap or exceed the {p} "
            "columns."
        )
    return starts


def _check_constraints(constraints: LinearConstraints, p: int) -> None:
    instance(constraints, "constraints", LinearConstraints)
    k = len(real_array(constraints.matrix, "constraints.matrix", ("m", p)))
    lower = real_array(constraints.lower, "constraints.lower", (k,), finite=False)
    upper = real_array(constraints.upper, "constraints.upper", (k,), finite=False)
    if empty := np.flatnonzero(~(lower <= upper)).tolist():
        limits = ", ".join(f"{lower[i]:g} and {upper[i]:g}" for i in empty)
        raise ArgumentError(
            f"Constraints {empty} have lower values above the upper ones: {limits}.",
            rows=empty,
        )


def check_residual_bound(problem: FitProblem) -> None:
    """Raise if the residual bound is below the least-squares minimum."""
    bound = problem.residual_bound
    if bound is None:
        return
    minimum = least_residual(problem.factor[:, :-1], problem.factor[:, -1])
    if not bound > minimum:
        raise unreachable_bound(bound, minimum, "any parameters")


def least_residual(A: Array, b: Array) -> float:
    """Return the minimum of ‖A x − b‖² over all parameters x, physical or not."""
    norms = np.linalg.norm(A, axis=0)
    scaled = A / np.where(norms > 0, norms, 1.0)
    return float(np.square(scaled @ np.linalg.lstsq(scaled, b)[0] - b).sum())


def unreachable_bound(
    bound: float, minimum: float, who: str = "physical bodies inside all constraints"
) -> ArgumentError:
    """Return the error of a residual bound below the minimum."""
    return ArgumentError(
        f"residual_bound is {bound:.10g}, but the smallest squared residual of {who} is "
        f"{minimum:.10g}.",
        advice="Use a larger bound.",
        minimum=minimum,
    )


_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyConstraints(Short):
    """Linear constraints on inertial parameters; −inf and inf stand for no bound."""

    # (nb, 4, 4) matrices Q with [x;1]ᵀ Q [x;1] ≥ 0 inside an ellipsoid that contains all of a
    # body's mass: tr(P(φ_i) Q_i) ≥ 0 ([Lee2019] Eq. (3.5.46)).
    ellipsoids: ArrayLike | None = None
    total_mass: float | None = None  # sum of all masses, kg
    mass_bounds: ArrayLike | None = None  # (nb, 2) bounds of the masses, kg
    # (nb, 3, 2) bounds of each centre of mass in the body's frame, m.
    com_bounds: ArrayLike | None = None

    def rows(self, prior: Array, size: int) -> LinearConstraints | None:
        """Return the constraints on x = [Φ, extra] (size,) with a prior Φ⁰ (nb, 10), or None."""
        parts = list(self._parts(prior))
        if not parts:
            return None
        matrix, lower, upper = (np.concatenate(part) for part in zip(*parts, strict=True))
        used = np.isfinite(lower) | np.isfinite(upper)
        if not used.any():
            return None
        wide = np.pad(matrix[used], ((0, 0), (0, size - prior.size)))
        return LinearConstraints(matrix=wide, lower=lower[used], upper=upper[used])

    def _parts(self, prior: Array) -> Iterator[tuple[Array, Array, Array]]:
        """Yield rows (k, 10·nb) on the bodies, with their lower and upper limits (k,)."""
        mass, none = np.zeros_like(prior), np.full(len(prior), np.inf)
        mass[:, 0] = 1.0
        if self.ellipsoids is not None:
            yield block_diag(*_ellipsoid_rows(self.ellipsoids, prior)), 0.0 * prior[:, 0], none
        if self.total_mass is not None:
            number(self.total_mass, "total_mass", lower=0.0, strict=True, finite=False)
            total = np.array([float(self.total_mass)])
            yield mass.reshape(1, -1), total, total
        if self.mass_bounds is not None:
            bounds = checked_bounds("mass_bounds", self.mass_bounds, (len(prior), 2))
            if wrong := np.flatnonzero(bounds[:, 1] <= 0).tolist():
                raise ArgumentError(
                    f"mass_bounds allow no positive mass of bodies {wrong}; masses are in kg.",
                    bodies=wrong,
                )
            yield block_diag(*mass), bounds[:, 0], bounds[:, 1]
        if self.com_bounds is not None:
            bounds = checked_bounds("com_bounds", self.com_bounds, (len(prior), 3, 2))
            # h_k − l m ≥ 0 and u m − h_k ≥ 0 are linear, where h/m would not be.
            for axis, (side, sign) in product(range(3), enumerate((1.0, -1.0))):
                limit = bounds[:, axis, side]
                finite = np.isfinite(limit)
                rows = -sign * np.where(finite, limit, 0.0)[:, None] * mass
                rows[:, 1 + axis] = sign
                yield block_diag(*rows), np.where(finite, 0.0, -none), none


def _ellipsoid_rows(ellipsoids: ArrayLike, prior: Array) -> Array:
    """Return covectors (nb, 10) of tr(P(φ_i) Q_i)."""
    Q = real_array(ellipsoids, "ellipsoids", (len(prior), 4, 4))
    Q = 0.5 * (Q + np.swapaxes(Q, 1, 2))
    if wrong := np.flatnonzero(np.linalg.eigvalsh(Q[:, :3, :3])[:, -1] >= 0).tolist():
        raise ArgumentError(
            f"The ellipsoids of bodies {wrong} are not bounded regions [x;1]ᵀQ[x;1] ≥ 0.",
            advice="Q is positive inside: use −Q if yours is negative there.",
            bodies=wrong,
        )
    P = pseudo_inertia(prior)
    inside, size = (np.einsum("bij,bji->b", *pair) for pair in ((Q, P), (np.abs(Q), np.abs(P))))
    if wrong := np.flatnonzero(inside < -_ROUNDING * size).tolist():
        raise ArgumentError(
            f"The ellipsoids of bodies {wrong} do not contain the prior's bodies: tr(P Q) is "
            f"{', '.join(f'{value:.3g}' for value in inside[wrong])} instead of at least 0.",
            advice="Check that prior and ellipsoids have the same frames and units; otherwise "
            "enlarge the ellipsoids, or move the prior inside.",
            bodies=wrong,
            trace=inside[wrong].tolist(),
        )
    return from_dual(Q)


def checked_bounds(name: str, bounds: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return bounds as an array of a shape whose last axis is (lower, upper); ±inf are allowed."""
    array = real_array(bounds, name, shape, finite=False)
    low, high = array[..., 0], array[..., 1]
    usable = (low <= high) & (low < np.inf) & (high > -np.inf)
    if not usable.all():
        places = np.argwhere(~usable).tolist()
        raise ArgumentError(
            f"{name} has lower values above the upper ones at {places}.",
            places=places,
        )
    return array
