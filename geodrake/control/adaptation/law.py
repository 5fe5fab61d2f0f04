"""Update laws: how the estimate of the parameters moves with the covector b of a controller."""

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
    """How an estimate p̂ moves with a covector b for which V̇_t ≤ (p̂ − p)ᵀ b.

    With V = V_t + `parameter_error`, V never rises, [Lee2019] Proposition 5.7.

    Every function is a door that refuses estimates that the law cannot move, arrays of another
    shape, and numbers that are not finite (ArgumentError). Behind it is a kernel of the same name
    with `calc_`, which trusts its arrays: for every sample of a controller. A law of your own
    defines the kernels.
    """

    @property
    def dimension(self) -> int | None:
        """Number n of parameters; None if any will do."""
        return None

    @property
    def slowness(self) -> float:
        """γ, of which adaptation is as fast as γ⁻¹; 1 if the law does not say."""
        return 1.0

    def with_slowness(self, gamma: float) -> UpdateLaw:
        """Return the same law with another γ."""
        raise ArgumentError(f"{type(self).__name__} has no γ, so it cannot be set to {gamma}.")

    def contains(self, parameters: ArrayLike) -> bool:
        """Return whether an estimate (n,) is one that the law can move."""
        estimate = real_array(parameters, "parameters", self._shape, finite=False)
        return bool(np.isfinite(estimate).all()) and self.calc_contains(estimate)

    def rate(self, parameters: ArrayLike, b: ArrayLike) -> Array:
        """Return the rate (n,) of an estimate (n,) under a covector b (n,), such as Yᵀ r."""
        return self.calc_rate(*self._inside(parameters, b))

    def step(self, parameters: ArrayLike, b: ArrayLike, dt: float) -> Array:
        """Return the estimate (n,) after b (n,) has acted for dt seconds."""
        return self.calc_step(*self._inside(parameters, b), number(dt, "dt"))

    def parameter_error(self, truth: ArrayLike, parameters: ArrayLike) -> Array:
        """Return V_p, what a Lyapunov function has for the error of estimates (..., n)."""
        sizes: Sizes = {}
        truth = real_array(truth, "truth", self._shape, sizes)
        estimates = real_array(parameters, "parameters", ("...", *self._shape), sizes)
        for each in (truth, *estimates.reshape(-1, truth.size)):
            self._check_inside(each)
        return self.calc_parameter_error(truth, estimates)

    @property
    def _shape(self) -> tuple[int | str]:
        return ("n" if self.dimension is None else self.dimension,)

    def _inside(self, parameters: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
        """Return an estimate (n,) that the law can move, and a covector (n,)."""
        sizes: Sizes = {}
        p = real_array(parameters, "parameters", self._shape, sizes)
        b = real_array(b, "b", self._shape, sizes)
        self._check_inside(p)
        return p, b

    def _check_inside(self, p: Array) -> None:
        """Refuse parameters (n,) that the law cannot move."""
        if not self.calc_contains(p):
            raise ArgumentError(
                f"parameters must be inside the law's manifold; they are {p.tolist()}.",
                advice="Start inside, and use geodesic or shorter steps.",
                name="parameters",
            )

    @property
    def compiled(self) -> Steps | None:
        """Return what `calc_limited_step` needs; None where a step is more than that and γ."""
        return None

    def calc_contains(self, parameters: Array) -> bool:
        """Kernel of `contains`, of finite estimates."""
        return True

    def calc_reach(self, parameters: Array, rows: Array) -> float:
        """Return a rate, 1/s, that no error Y p̃ exceeds as it drives the law, b = Yᵀ Y p̃.

        Rows Y are (k, n). It is zero for a law that does not know one.
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

    See `natural_adaptation`, `pullback_adaptation` and `euclidean_adaptation`, which differ in the
    manifold alone.

    Attributes:
        manifold: Where the parameters live. g is the Hessian of its barrier, without the factors 2
            of [Lee2019] (B.4.20), and a weight w of a factor divides its speed, Eq. (B.4.19).
        gamma: γ > 0; adaptation is as fast as γ⁻¹.
        integrator: "geodesic" steps stay inside of the manifold however long they are; "euler" is
            p̂ + dt p̂̇, the source's, and may leave it.
        leakage: σ ≥ 0, 1/s, of a pull γ σ (∇h(p̂) − ∇h(p₀)) that is added to b, wherever b is not
            zero: the σ-modification of P. A. Ioannou and P. V. Kokotović, Automatica 20(5), 1984,
            in this metric. V̇ has another −γ σ (D(p‖p̂) + D(p̂‖p₀) − D(p‖p₀)), and may only rise
            where p̂ is nearer to the truth than p₀ is.
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
        """That of the manifold."""
        return self.manifold.dimension

    @cached_property
    def compiled(self) -> Steps | None:
        """Return the factors of a robot's bodies and lower bounds, and no limits."""
        robot = self.manifold.robot if isinstance(self.manifold, Product) else None
        if robot is None or self.integrator != "geodesic" or self.leakage > 0:
            return None
        return robot, np.zeros((0, self.dimension)), np.zeros(0)

    def calc_contains(self, parameters: Array) -> bool:
        """Return whether an estimate (n,) is inside of the manifold."""
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
        """γ⁻¹ tr(Y g(p̂)⁻¹ Yᵀ), 1/s, of rows Y (k, n), which is at least the greatest eigenvalue."""
        products = self.manifold.calc_mirror_span(parameters, rows).products
        return float(np.trace(products)) / self.gamma

    def calc_parameter_error(self, truth: Array, parameters: Array) -> Array:
        """Return γ D(p‖p̂) (...), [Lee2019] Eq. (5.4.49)."""
        return np.asarray(self.gamma * self.manifold.calc_divergence(truth, parameters))


Steps = tuple[Factors, Array, Array]
"""Factors of a manifold, and limits G p ≤ g."""


@compiled
def calc_limited_step(p: Array, b: Array, steps: Steps, time: float, out: Array) -> bool:
    """Write where a covector b (n,) takes an estimate in dt/γ; return whether that is all.

    It is not where the step is very long, ends near the edge of the manifold, or beyond a limit.
    """
    factors, G, g = steps
    if not calc_natural_steps(p, b, factors, time, out):
        return False
    return not (np.dot(G, out) > g).any()


def natural_adaptation(
    manifold: Manifold, gamma: float = 1.0, *, integrator: Integrator = "geodesic"
) -> AdaptationLaw:
    """Return the natural law, [Lee2019] Eq. (5.4.51): estimates stay physical and no unit matters.

    Args:
        manifold: Such as `parameter_manifold(model)`.
    """
    return AdaptationLaw(manifold, gamma, integrator)


def pullback_adaptation(manifold: Manifold, at: ArrayLike, gamma: float = 1.0) -> AdaptationLaw:
    """Return the law with the constant gain Γ = γ g(p̂₀), [Lee2019] §5.5.

    Args:
        at: (n,) the initial estimate p̂₀, inside of the manifold.
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

    Units matter, and nothing keeps the estimate physical.
    """
    identity = np.eye(integer(dimension, "dimension", lower=1, upper=_MOST))
    return AdaptationLaw(ConstantMetric(identity, identity), gamma)


_NOT_INVERSE = 1e-3  # error of the product of a matrix and its inverse, on a unit diagonal


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
        off = (matrix @ inverse) / scale[:, None] * scale - np.eye(len(matrix))
        if np.abs(off).max(initial=0.0) > _NOT_INVERSE:
            raise ArgumentError(
                "inverse is not the inverse of matrix; their product differs by "
                f"{np.abs(off).max():.2g} from the identity."
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "inverse", inverse)

    @classmethod
    def of(cls, manifold: Manifold, x: ArrayLike) -> ConstantMetric:
        """Return the metric of another manifold at one of its points x (n,), used everywhere.

        The inverse comes from the manifold too, so that it is as precise as there.
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
        """Return Γ⁻¹ b, whatever x is."""
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
