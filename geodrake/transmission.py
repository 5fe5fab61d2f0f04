"""Transmissions: how the joints θ of a tree follow from fewer, or other, actuator coordinates q.

    θ = T(q),   θ̇ = J q̇,   θ̈ = J q̈ + J̇ q̇,   τ_q = Jᵀ τ_θ,   Y_q = Jᵀ Y_θ     [Lee2019] Eq. (3.6.57)

The tree has a joint for everything that turns: a geared rotor is a body of its own, on a joint that
turns N times as fast as the one it drives; the two bodies of a rolling joint each turn by half;
two motors of a wrist move its joints together. Its regressor Y_θ, for joint coordinates, then
becomes the regressor Y_q of what is measured, with all gyroscopic and inertial coupling of the
rotors. Friction and inertia *on the actuator's side* are effects in q, q̇, q̈ as they stand.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.motion import Motion

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

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """J̇ (N, k, n) at q (N, n) and q̇ = v (N, n); fourth order differences unless overridden."""
        speed = np.abs(v).max(axis=1, initial=0.0)[:, None]
        step = _STEP * v / np.where(speed > 0, speed, 1.0)
        near = self.jacobian(q + step) - self.jacobian(q - step)
        far = self.jacobian(q + 2 * step) - self.jacobian(q - 2 * step)
        return (8 * near - far) / (12 * _STEP) * speed[:, :, None]

    def joint_motion(self, motion: Motion) -> Motion:
        """The joints' motion, of a motion of the actuators."""
        q, v, vd = (self._checked(x, self.num_actuators) for x in (motion.q, motion.v, motion.vd))
        J = self.jacobian(q)
        acceleration = _times(J, vd) + _times(self.jacobian_rate(q, v), v)
        return Motion(self.joint_positions(q), _times(J, v), acceleration, motion.time)

    def actuator_motion(self, motion: Motion, *, start: ArrayLike = 0.0) -> Motion:
        """The actuators' motion, of a motion of the joints that fits the transmission.

        Velocities and accelerations that do not fit are taken in the sense of least squares.

        Args:
            motion: (N, k) positions, velocities and accelerations of the joints.
            start: (n,) or (N, n) actuator positions near the solution, for maps with several.

        Raises:
            ArgumentError: No actuator position reaches the joints' positions, or the transmission
                is singular there.
        """
        theta, w, wd = (self._checked(x, self.num_joints) for x in (motion.q, motion.v, motion.vd))
        q = self._actuator_positions(theta, start)
        inverse = np.asarray(np.linalg.pinv(self._regular_jacobian(q)), float)
        v = _times(inverse, w)
        vd = _times(inverse, wd - _times(self.jacobian_rate(q, v), v))
        return Motion(q, v, vd, motion.time)

    def actuator_efforts(self, q: ArrayLike, efforts: ArrayLike) -> Array:
        """τ_q = Jᵀ τ_θ (N, n), of the joints' efforts (N, k) at q (N, n).

        Raises:
            ArgumentError: The shapes do not fit.
        """
        q = self._checked(q, self.num_actuators)
        efforts = self._checked(efforts, self.num_joints, samples=len(q))
        return _times(np.swapaxes(self.jacobian(q), 1, 2), efforts)

    def joint_efforts(self, q: ArrayLike, efforts: ArrayLike) -> Array:
        """τ_θ = J⁻ᵀ τ_q (N, k), of the actuators' efforts (N, n) at q (N, n).

        Raises:
            ArgumentError: There are more joints than actuators, so that their efforts are not
                determined, or the transmission is singular.
        """
        q = self._checked(q, self.num_actuators)
        efforts = self._checked(efforts, self.num_actuators, samples=len(q))
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
        q, rows = self._checked(q, self.num_actuators), np.asarray(regressor, float)
        if rows.ndim != 3 or rows.shape[:2] != (len(q), self.num_joints):
            raise ArgumentError(
                f"The regressor has the shape {rows.shape}, expected ({len(q)}, "
                f"{self.num_joints}, p): a row for each joint."
            )
        return np.swapaxes(self.jacobian(q), 1, 2) @ rows

    def _checked(self, values: ArrayLike, width: int, *, samples: int | None = None) -> Array:
        array = np.asarray(values, float)
        if array.ndim != 2 or array.shape[1] != width or samples not in (None, len(array)):
            raise ArgumentError(
                f"Got the shape {array.shape}, expected ({samples or 'N'}, {width}); there are "
                f"{self.num_actuators} actuators and {self.num_joints} joints."
            )
        return array

    def _regular_jacobian(self, q: Array) -> Array:
        J = self.jacobian(q)
        if len(q) and np.any((condition := np.linalg.cond(J)) > _MOST_CONDITION):
            at = q[int(np.argmax(condition))].tolist()
            raise ArgumentError(
                f"The transmission is singular at q = {at}: some motion does nothing."
            )
        return J

    def _actuator_positions(self, theta: Array, start: ArrayLike) -> Array:
        """Gauss-Newton on T(q) = θ, all samples together."""
        q, wanted = np.asarray(start, float), (len(theta), self.num_actuators)
        if q.shape not in ((), wanted[1:], wanted):
            raise ArgumentError(f"A start has the shape {wanted[1:]} or {wanted}; got {q.shape}.")
        q = np.broadcast_to(q, wanted).copy()
        size = 1.0 + np.abs(theta).max(initial=0.0)
        for _ in range(_MOST_ITERATIONS):
            inverse = np.asarray(np.linalg.pinv(self.jacobian(q)), float)
            step = _times(inverse, theta - self.joint_positions(q))
            q += step
            if np.abs(step).max(initial=0.0) < 1e-13 * size:
                break
        error = np.abs(theta - self.joint_positions(q)).max(initial=0.0)
        if not error < 1e-9 * size:
            raise ArgumentError(
                f"Some joint positions cannot be reached by the actuators; they miss by {error:g}.",
                advice="Check the transmission and its offsets, or give a nearer start.",
            )
        return q


@dataclass(frozen=True, eq=False)
class LinearTransmission(Transmission):
    """θ = J q + θ₀ with a constant J, of `of` or `from_ratios`: gears, belts, coupled wrists.

    Attributes:
        matrix: (k, n) J.
        offset: (k,) θ₀, rad or m.
    """

    matrix: Array
    offset: Array

    @classmethod
    def of(cls, matrix: ArrayLike, offset: ArrayLike = 0.0) -> LinearTransmission:
        """From J (k, n) and θ₀ (k,) or one number.

        Raises:
            ArgumentError: The shapes do not fit, a value is not finite, or some actuator moves
                nothing of its own.
        """
        J = np.asarray(matrix, float)
        if J.ndim != 2 or not np.isfinite(J).all() or np.linalg.matrix_rank(J) < J.shape[1]:
            raise ArgumentError(
                f"J must be finite, of shape (k, n) and of rank n; got the shape {J.shape}.",
                advice="Leave out actuators that move nothing that others do not.",
            )
        shift = np.asarray(offset, float)
        if shift.shape not in ((), (len(J),)) or not np.isfinite(shift).all():
            raise ArgumentError(f"Expected {len(J)} finite offsets or one; got {shift.tolist()}.")
        return cls(J, np.broadcast_to(shift, (len(J),)).copy())

    @classmethod
    def from_ratios(
        cls,
        joints: Sequence[str],
        actuators: Sequence[str],
        ratios: Mapping[str, Mapping[str, float]],
    ) -> LinearTransmission:
        """By name: `{"knee": {"knee": 1.0}, "knee_rotor": {"knee": 10.6}}`.

        Args:
            joints: Names of the tree's k velocities, such as `geodrake.plant.joint_names(plant)`.
            actuators: Names of the n actuator coordinates.
            ratios: Joint -> actuator -> how far the joint turns when the actuator turns by one.
                Joints that are not named do not move.

        Raises:
            ArgumentError: A name is not known.
        """
        J = np.zeros((len(joints), len(actuators)))
        for joint, terms in ratios.items():
            for actuator, ratio in terms.items():
                for name, known in ((joint, joints), (actuator, actuators)):
                    if name not in known:
                        raise ArgumentError(f"There is no {name!r} among {', '.join(known)}.")
                J[joints.index(joint), actuators.index(actuator)] = ratio
        return cls.of(J)

    @property
    def num_actuators(self) -> int:
        """Number n of actuator coordinates q."""
        return self.matrix.shape[1]

    @property
    def num_joints(self) -> int:
        """Number k of joint positions θ."""
        return self.matrix.shape[0]

    def joint_positions(self, q: Array) -> Array:
        """θ = J q + θ₀."""
        return q @ self.matrix.T + self.offset

    def jacobian(self, q: Array) -> Array:
        """J, the same for all samples."""
        return np.broadcast_to(self.matrix, (len(q), *self.matrix.shape))

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """Zero."""
        return np.zeros((len(q), *self.matrix.shape))


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
        return self.position(q)

    def jacobian(self, q: Array) -> Array:
        """J(q)."""
        return self.derivative(q)

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """J̇(q, q̇)."""
        if self.derivative_rate is None:
            return super().jacobian_rate(q, v)
        return self.derivative_rate(q, v)


def _times(matrices: Array, vectors: Array) -> Array:
    """Products (N, m) of matrices (N, m, n) and vectors (N, n)."""
    return np.einsum("nij,nj->ni", matrices, vectors)
