"""Update laws of parameter estimates, driven by the covector b of a controller."""

from __future__ import annotations

import abc
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import (
    Sizes,
    instance,
    integer,
    number,
    one_of,
    positive,
    positive_definite,
    real_array,
)
from geodrake.boundary.showing import Short
from geodrake.compiling import compiled
from geodrake.errors import ArgumentError
from geodrake.manifolds import Manifold, Product
from geodrake.manifolds.base import Array
from geodrake.manifolds.robot_kernels import Factors, calc_natural_steps

_MOST = 10_000  # parameters of one law

Integrator = Literal["geodesic", "euler"]


class UpdateLaw(abc.ABC):
    """Update of an estimate p̂ by a covector b for which V̇_t ≤ (p̂ − p)ᵀ b.

    With V = V_t + `parameter_error`, V never rises, [Lee2019] Proposition 5.7.

    The public methods check their arguments: estimates outside the law's domain, wrong shapes and
    non-finite values raise an ArgumentError. Each calls a kernel of the same name with `calc_`,
    which does not check, for use in every sample of a controller. Subclasses define the kernels.
    """

    @property
    def dimension(self) -> int | None:
        """Number n of parameters; None if arbitrary."""
        return None

    @property
    def slowness(self) -> float:
        """γ; the adaptation rate is proportional to 1/γ. 1 if not defined."""
        return 1.0

    def with_slowness(self, gamma: float) -> UpdateLaw:
        """Return the same law with another γ."""
        raise ArgumentError(f"{type(self).__name__} has no γ, so it cannot be set to {gamma}.")

    def contains(self, parameters: ArrayLike) -> bool:
        """Return whether an estimate (n,) is in the law's domain."""
        estimate = real_array(parameters, "parameters", self._shape, finite=False)
        return bool(np.isfinite(estimate).all()) and self.calc_contains(estimate)

    def rate(self, parameters: ArrayLike, b: ArrayLike) -> Array:
        """Return the rate (n,) of an estimate (n,) under a covector b (n,), such as Yᵀ r."""
        return self.calc_rate(*self._inside(parameters, b))

    def step(self, parameters: ArrayLike, b: ArrayLike, dt: float) -> Array:
        """Return the estimate (n,) after b (n,) has acted for dt seconds."""
        return self.calc_step(*self._inside(parameters, b), number(dt, "dt"))

    def parameter_error(self, truth: ArrayLike, parameters: ArrayLike) -> Array:
        """Return V_p, the part of a Lyapunov function due to errors of estimates (..., n)."""
        sizes: Sizes = {}
        truth = real_array(truth, "truth", self._shape, sizes)
        estimates = real_array(parameters, "parameters", ("...", *self._shape), sizes)
        for p in (truth, *estimates.reshape(-1, truth.size)):
            self._check_inside(p)
        return self.calc_parameter_error(truth, estimates)

    @property
    def _shape(self) -> tuple[int | str]:
        return ("n" if self.dimension is None else self.dimension,)

    def _inside(self, parameters: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
        """Return an estimate (n,) and a covector (n,), checked."""
        sizes: Sizes = {}
        p = real_array(parameters, "parameters", self._shape, sizes)
        b = real_array(b, "b", self._shape, sizes)
        self._check_inside(p)
        return p, b

    def _check_inside(self, p: Array) -> None:
        """Raise if parameters (n,) are outside the law's domain."""
        if not self.calc_contains(p):
            raise ArgumentError(
                f"parameters must be inside the law's manifold; they are {p.tolist()}.",
                advice="Start inside, and use geodesic or shorter steps.",
                name="parameters",
            )

    @property
    def compiled(self) -> Steps | None:
        """Arguments of `calc_limited_step`; None if it cannot perform this law's steps."""
        return None

    def calc_contains(self, parameters: Array) -> bool:
        """Kernel of `contains`, for finite estimates."""
        return True

    def calc_reach(self, parameters: Array, rows: Array) -> float:
        """Return an upper bound, 1/s, of the decay rate of Y p̃ under b = Yᵀ Y p̃, Y (k, n).

        It is zero if unknown.
        """
        return 0.0

    @abc.abstractmethod
    def calc_rate(self, parameters: Array, b: Array) -> Array:
        """Kernel of `rate`."""

    @abc.abstractmethod
    def calc_step(self, parameters: Array, b: Array, dt: float) -> Array:
        """Kernel of `step`."""

    @abc.abstractmethod
    def calc_parameter_error(self, truth: Array, parameters: Array) -> Array:
        """Kernel of `parameter_error`."""


@dataclass(frozen=True, eq=False)
class AdaptationLaw(UpdateLaw):
    """The geometric adaptation law of a manifold.

        p̂̇ = −γ⁻¹ g(p̂)⁻¹ b,   V_p = γ D(p‖p̂)                      [Lee2019] Eq. (5.4.49), (5.4.51)

    See `natural_adaptation`, `pullback_adaptation` and `euclidean_adaptation`, which differ only in
    the manifold.

    Attributes:
        manifold: Manifold of the parameters. g is the Hessian of its barrier, without the factors 2
            of [Lee2019] (B.4.20). A factor's weight w divides its rate, Eq. (B.4.19).
        gamma: γ > 0; the adaptation rate is proportional to 1/γ.
        integrator: "geodesic" steps of any length stay inside the manifold; "euler", as in
            [Lee2019], is p̂ + dt p̂̇ and may leave it.
        leakage: σ ≥ 0, 1/s. γ σ (∇h(p̂) − ∇h(p₀)) is added to b unless b is zero: the σ-modification
            of P. A. Ioannou and P. V. Kokotović, Automatica 20(5), 1984, in this metric. It adds
            −γ σ (D(p‖p̂) + D(p̂‖p₀) − D(p‖p₀)) to V̇, so that V may rise only if p̂ is closer to the
            truth than p₀.
        toward: (n,) p₀, such as the parameters of the model.
    """

    manifold: Manifold
    gamma: float = 1.0
    integrator: Integrator = "geodesic"
    leakage: float = 0.0
    toward: ArrayLike | None = None

    def __post_init__(self) -> None:
        instance(self.manifold, "manifold", Manifold)
        positive(self.gamma, "gamma")
        one_of(self.integrator, "integrator", ("geodesic", "euler"))
        if number(self.leakage, "leakage", lower=0.0) > 0:
            toward = real_array(self.toward, "toward", (self.manifold.dimension,))
            if not self.manifold.contains(toward):
                raise ArgumentError("The point of leakage must be inside the manifold.")

    @property
    def slowness(self) -> float:
        """γ."""
        return self.gamma

    def with_slowness(self, gamma: float) -> AdaptationLaw:
        """Return the same law with another γ."""
        return replace(self, gamma=gamma)

    @property
    def dimension(self) -> int:
        """Dimension of the manifold."""
        return self.manifold.dimension

    @cached_property
    def compiled(self) -> Steps | None:
        """Factors of the manifold, without limits; None if `calc_limited_step` does not apply."""
        robot = self.manifold.robot if isinstance(self.manifold, Product) else None
        if robot is None or self.integrator != "geodesic" or self.leakage > 0:
            return None
        return robot, np.zeros((0, self.dimension)), np.zeros(0)

    def calc_contains(self, parameters: Array) -> bool:
        """Return whether an estimate (n,) is inside the manifold."""
        return bool(self.manifold.calc_contains(parameters))

    def calc_rate(self, parameters: Array, b: Array) -> Array:
        """Return −γ⁻¹ g(p̂)⁻¹ b (n,), [Lee2019] Eq. (5.4.51)."""
        pull = self.calc_pull(parameters, b)
        return self.manifold.calc_inverse_metric_times(parameters, pull) / -self.gamma

    def calc_step(self, parameters: Array, b: Array, dt: float) -> Array:
        """Return the estimate (n,) after dt seconds, by the integrator."""
        if self.integrator == "euler":
            return parameters + dt * self.calc_rate(parameters, b)
        pull = self.calc_pull(parameters, b)
        return self.manifold.calc_natural_step(parameters, pull, dt / self.gamma)

    def calc_pull(self, parameters: Array, b: Array) -> Array:
        """Return b (n,) with leakage."""
        if self.leakage == 0 or not b.any():
            return b
        here, there = self.manifold.gradient(np.array([parameters, self.toward], float))
        return b + self.gamma * self.leakage * (here - there)

    def calc_reach(self, parameters: Array, rows: Array) -> float:
        """Return γ⁻¹ tr(Y g(p̂)⁻¹ Yᵀ), 1/s, for Y (k, n), a bound of the largest eigenvalue."""
        products = self.manifold.calc_mirror_span(parameters, rows).products
        return float(np.trace(products)) / self.gamma

    def calc_parameter_error(self, truth: Array, parameters: Array) -> Array:
        """Return γ D(p‖p̂) (...), [Lee2019] Eq. (5.4.49)."""
        return np.asarray(self.gamma * self.manifold.calc_divergence(truth, parameters))


Steps = tuple[Factors, Array, Array]
"""Factors of a manifold, and limits G p ≤ g."""


@compiled
def calc_limited_step(p: Array, b: Array, steps: Steps, time: float, out: Array) -> bool:
    """Write the estimate after a step along b (n,) for time dt/γ; return whether it is valid.

    It is not if the step is very long, or ends near the manifold's boundary or beyond a limit.
    """
    factors, G, g = steps
    if not calc_natural_steps(p, b, factors, time, out):
        return False
    return not (np.dot(G, out) > g).any()


def natural_adaptation(
    manifold: Manifold, gamma: float = 1.0, *, integrator: Integrator = "geodesic"
) -> AdaptationLaw:
    """Return the natural law, [Lee2019] Eq. (5.4.51), independent of units.

    On a `parameter_manifold(model)`, estimates remain physical.
    """
    return AdaptationLaw(manifold, gamma, integrator)


def pullback_adaptation(manifold: Manifold, at: ArrayLike, gamma: float = 1.0) -> AdaptationLaw:
    """Return the law with the constant gain Γ = γ g(p̂₀), [Lee2019] §5.5.

    Args:
        at: (n,) initial estimate p̂₀, inside the manifold.
    """
    n = instance(manifold, "manifold", Manifold).dimension
    at = real_array(at, "at", (n,))
    if not manifold.contains(at):
        raise ArgumentError(
            f"A pullback law needs an initial estimate ({manifold.dimension},) inside the "
            f"manifold; got {at.tolist()}."
        )
    return AdaptationLaw(ConstantMetric.of(manifold, at), gamma)


def euclidean_adaptation(dimension: int, gamma: float = 1.0) -> AdaptationLaw:
    """Return the law with the gain Γ = γ 𝟙, [Lee2019] Eq. (5.4.48).

    It depends on units, and the estimate may become unphysical.
    """
    identity = np.eye(integer(dimension, "dimension", lower=1, upper=_MOST))
    return AdaptationLaw(ConstantMetric(identity, identity), gamma)


_INVERSE_TOLERANCE = 1e-3  # error of the product of a matrix and its inverse, scaled


@dataclass(frozen=True, eq=False)
class ConstantMetric(Manifold, Short):
    """ℝⁿ with h = ½ xᵀ Γ x: no bounds, straight geodesics and D(x‖y) = ½ (x − y)ᵀ Γ (x − y).

    Attributes:
        matrix: (n, n) symmetric positive definite Γ.
    """

    matrix: Array
    inverse: Array

    def __post_init__(self) -> None:
        sizes: Sizes = {}
        matrix = positive_definite(self.matrix, "matrix", ("n", "n"), sizes)
        inverse = real_array(self.inverse, "inverse", ("n", "n"), sizes)
        scale = np.sqrt(np.diagonal(matrix))
        error = (matrix @ inverse) / scale[:, None] * scale - np.eye(len(matrix))
        if np.abs(error).max(initial=0.0) > _INVERSE_TOLERANCE:
            raise ArgumentError(
                "inverse is not the inverse of matrix; their product differs by "
                f"{np.abs(error).max():.2g} from the identity."
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "inverse", inverse)

    @classmethod
    def of(cls, manifold: Manifold, x: ArrayLike) -> ConstantMetric:
        """Return the constant metric that equals another manifold's metric at x (n,).

        The inverse is that of the manifold, which is more accurate than inverting the matrix.
        """
        x = real_array(x, "x", (instance(manifold, "manifold", Manifold).dimension,))
        inverse = manifold.inverse_metric_times(x, np.eye(manifold.dimension))
        return cls(manifold.metric(x), 0.5 * (inverse + inverse.T))

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.matrix)

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Return whether x is finite (...)."""
        return np.asarray(np.isfinite(x).all(-1))

    def calc_barrier(self, x: Array) -> Array:
        """Return ½ xᵀ Γ x."""
        return np.asarray(0.5 * (x * (x @ self.matrix)).sum(-1))

    def calc_gradient(self, x: Array) -> Array:
        """Return Γ x, (..., n)."""
        return np.asarray(x @ self.matrix)

    def calc_metric(self, x: Array) -> Array:
        """Return Γ, (..., n, n)."""
        return np.broadcast_to(self.matrix, (*np.shape(x)[:-1], *self.matrix.shape)).copy()

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """Return Γ⁻¹ b."""
        return np.asarray(b @ self.inverse)

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Return ½ (x − y)ᵀ Γ (x − y)."""
        return self.calc_barrier(x - y)

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """Return infinity."""
        return np.full(np.broadcast_shapes(np.shape(x), np.shape(v))[:-1], np.inf)

    def calc_retract(self, x: Array, v: Array) -> Array:
        """Return x + v."""
        return x + v
