"""Base of the transmissions."""

from __future__ import annotations

import abc

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Sizes, instance, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.logs.motion import Motion

_STEP = 2e-3  # rad or m: fourth order differences err by about 1e-12
_MOST_ITERATIONS = 50
_MOST_CONDITION = 1e12


class Transmission(abc.ABC):
    """A smooth map from n actuator coordinates to k joint positions, for many samples at once."""

    @property
    @abc.abstractmethod
    def num_actuators(self) -> int:
        """Number n of actuator coordinates q."""

    @property
    @abc.abstractmethod
    def num_joints(self) -> int:
        """Number k of joint positions θ."""

    @abc.abstractmethod
    def joint_positions(self, q: Array) -> Array:
        """θ = T(q), (N, k), of q (N, n)."""

    @abc.abstractmethod
    def jacobian(self, q: Array) -> Array:
        """J = ∂T/∂q, (N, k, n), of q (N, n)."""

    def inside(self, q: Array) -> Array:
        """Actuator coordinates (N, n) moved to where the map is known; themselves by default."""
        return q

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """J̇ (N, k, n) at q (N, n) and q̇ = v (N, n); fourth order differences unless overridden."""
        speed = np.abs(v).max(axis=1, initial=0.0)[:, None]
        step = _STEP * v / np.where(speed > 0, speed, 1.0)
        near = self.jacobian(q + step) - self.jacobian(q - step)
        far = self.jacobian(q + 2 * step) - self.jacobian(q - 2 * step)
        return (8 * near - far) / (12 * _STEP) * speed[:, :, None]

    def along(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """θ (N, k), J and J̇ (N, k, n) along a motion of the actuators.

        Args:
            q: (N, n) actuator coordinates.
            v: (N, n) their velocities.
        """
        return self.joint_positions(q), self.jacobian(q), self.jacobian_rate(q, v)

    @property
    def constant_jacobian(self) -> Array | None:
        """J (k, n) where it is the same everywhere; None where it depends on q."""
        return None

    def joint_motion(self, motion: Motion) -> Motion:
        """Return the joints' motion, of a motion of the actuators."""
        q, v, vd = self._motion(motion, self.num_actuators)
        J = self.jacobian(q)
        acceleration = times(J, vd) + times(self.jacobian_rate(q, v), v)
        return Motion(self.joint_positions(q), times(J, v), acceleration, motion.time)

    def actuator_motion(self, motion: Motion, *, start: ArrayLike = 0.0) -> Motion:
        """Return the actuators' motion, of a motion of the joints that fits the transmission.

        Velocities and accelerations that do not fit are taken in the sense of least squares.

        Args:
            motion: (N, k) positions, velocities and accelerations of the joints.
            start: (n,) or (N, n) actuator positions near the solution, for maps with several.

        Raises:
            ArgumentError: No actuator position reaches the joints' positions, or the transmission
                is singular there.
        """
        theta, w, wd = self._motion(motion, self.num_joints)
        q = self.actuator_positions(theta, start=start)
        inverse = np.asarray(np.linalg.pinv(self._regular_jacobian(q)), float)
        v = times(inverse, w)
        vd = times(inverse, wd - times(self.jacobian_rate(q, v), v))
        return Motion(q, v, vd, motion.time)

    def actuator_efforts(self, q: ArrayLike, efforts: ArrayLike) -> Array:
        """τ_q = Jᵀ τ_θ (N, n), of the joints' efforts (N, k), N·m or N, at q (N, n).

        Raises:
            ArgumentError: The shapes do not fit.
        """
        sizes: Sizes = {}
        q = self._checked(q, "q", self.num_actuators, sizes)
        efforts = self._checked(efforts, "efforts", self.num_joints, sizes)
        return times(np.swapaxes(self.jacobian(q), 1, 2), efforts)

    def joint_efforts(self, q: ArrayLike, efforts: ArrayLike) -> Array:
        """τ_θ = J⁻ᵀ τ_q (N, k), of the actuators' efforts (N, n), N·m or N, at q (N, n).

        Raises:
            ArgumentError: There are more joints than actuators, so that their efforts are not
                determined, or the transmission is singular.
        """
        sizes: Sizes = {}
        q = self._checked(q, "q", self.num_actuators, sizes)
        efforts = self._checked(efforts, "efforts", self.num_actuators, sizes)
        if self.num_joints != self.num_actuators:
            raise ArgumentError(
                f"{self.num_actuators} efforts of actuators do not determine those of "
                f"{self.num_joints} joints.",
                advice="Compare efforts on the actuators' side, with `actuator_efforts` and "
                "`regressor`.",
            )
        J = self._regular_jacobian(q)
        solved = np.linalg.solve(np.swapaxes(J, 1, 2), efforts[:, :, None])
        return np.asarray(solved[:, :, 0], float)

    def regressor(self, q: ArrayLike, regressor: ArrayLike) -> Array:
        """Y_q = Jᵀ Y_θ (N, n, p), of the tree's regressor (N, k, p) at `joint_motion`'s samples.

        Raises:
            ArgumentError: The shapes do not fit.
        """
        sizes: Sizes = {}
        q = self._checked(q, "q", self.num_actuators, sizes)
        rows = real_array(regressor, "regressor", ("N", self.num_joints, "p"), sizes)
        return np.swapaxes(self.jacobian(q), 1, 2) @ rows

    def _checked(
        self, values: ArrayLike, name: str, width: int, sizes: Sizes | None = None
    ) -> Array:
        """Values (N, width) of all actuators or joints."""
        return real_array(values, name, ("N", width), sizes)

    def _motion(self, motion: Motion, width: int) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations (N, width)."""
        instance(motion, "motion", Motion)
        sizes: Sizes = {}
        q, v, vd = (
            self._checked(values, f"motion.{name}", width, sizes)
            for name, values in (("q", motion.q), ("v", motion.v), ("vd", motion.vd))
        )
        return q, v, vd

    def _regular_jacobian(self, q: Array) -> Array:
        J = self.jacobian(q)
        if len(q) and np.any((condition := np.linalg.cond(J)) > _MOST_CONDITION):
            at = q[int(np.argmax(condition))].tolist()
            raise ArgumentError(
                f"The transmission is singular at q = {at}: some motion does nothing."
            )
        return J

    def actuator_positions(self, theta: Array, *, start: ArrayLike = 0.0) -> Array:
        """Return q (N, n) with T(q) = θ (N, k), by Gauss-Newton on all samples together.

        A start (n,) or (N, n) near the solution chooses one of several.

        Raises:
            ArgumentError: No actuator position reaches the joints' positions.
        """
        theta = real_array(theta, "theta", ("N", self.num_joints))
        q, wanted = real_array(start, "start"), (len(theta), self.num_actuators)
        if q.shape not in ((), wanted[1:], wanted):
            raise ArgumentError(f"A start has the shape {wanted[1:]} or {wanted}; got {q.shape}.")
        q = self.inside(np.broadcast_to(q, wanted).copy())
        size = 1.0 + np.abs(theta).max(initial=0.0)
        for _ in range(_MOST_ITERATIONS):
            inverse = np.asarray(np.linalg.pinv(self.jacobian(q)), float)
            step = times(inverse, theta - self.joint_positions(q))
            q = self.inside(q + step)
            if np.abs(step).max(initial=0.0) < 1e-13 * size:
                break
        error = np.abs(theta - self.joint_positions(q)).max(initial=0.0)
        if not error < 1e-9 * size:
            raise ArgumentError(
                f"Some joint positions cannot be reached by the actuators; they miss by {error:g}.",
                advice="Check the transmission and its offsets, or give a nearer start.",
            )
        return q


def times(matrices: Array, vectors: Array) -> Array:
    """Products (N, m) of matrices (N, m, n) and vectors (N, n)."""
    return np.einsum("nij,nj->ni", matrices, vectors)
