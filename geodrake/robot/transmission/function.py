"""Transmissions by functions of one's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from geodrake.boundary.arguments import Sizes, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.robot.transmission.base import Transmission


@dataclass(frozen=True, eq=False)
class FunctionTransmission(Transmission):
    """θ = T(q) by functions of one's own: linkages, cams, cables around rolling surfaces.

    Attributes:
        size: Numbers (k, n) of joint positions and actuator coordinates.
        position: T, from (N, n) to (N, k).
        derivative: J, from (N, n) to (N, k, n).
        derivative_rate: J̇, from q and q̇ (N, n) to (N, k, n); by differences of J if None.
    """

    size: tuple[int, int]
    position: Callable[[Array], Array]
    derivative: Callable[[Array], Array]
    derivative_rate: Callable[[Array, Array], Array] | None = None

    def __post_init__(self) -> None:
        k, n = real_array(self.size, "size", (2,)).tolist()
        object.__setattr__(self, "size", (int(k), int(n)))
        if self.size != (k, n) or not 0 < n <= k:
            raise ArgumentError(
                f"size must be numbers (k, n) of joints and actuators, 0 < n ≤ k; it is {(k, n)}."
            )
        for name in ("position", "derivative", "derivative_rate"):
            given = getattr(self, name)
            if not (callable(given) or (given is None and name == "derivative_rate")):
                raise ArgumentError(f"{name} must be a function; it is {given!r}.")

    @property
    def num_actuators(self) -> int:
        """Number n of actuator coordinates q."""
        return self.size[1]

    @property
    def num_joints(self) -> int:
        """Number k of joint positions θ."""
        return self.size[0]

    def joint_positions(self, q: Array) -> Array:
        """θ = T(q)."""
        q = self._checked(q, "q", self.num_actuators)
        return real_array(self.position(q), "what position gives", (len(q), self.num_joints))

    def jacobian(self, q: Array) -> Array:
        """J(q)."""
        q = self._checked(q, "q", self.num_actuators)
        return real_array(self.derivative(q), "what derivative gives", (len(q), *self.size))

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """J̇(q, q̇)."""
        sizes: Sizes = {}
        q = self._checked(q, "q", self.num_actuators, sizes)
        v = self._checked(v, "v", self.num_actuators, sizes)
        if self.derivative_rate is None:
            return super().jacobian_rate(q, v)
        rate = self.derivative_rate(q, v)
        return real_array(rate, "what derivative_rate gives", (len(q), *self.size))
