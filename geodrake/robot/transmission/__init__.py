"""Transmissions: maps from actuator coordinates q to the joints θ of a tree.

    θ = T(q),   θ̇ = J q̇,   θ̈ = J q̈ + J̇ q̇,   τ_q = Jᵀ τ_θ,   Y_q = Jᵀ Y_θ     [Lee2019] Eq. (3.6.57)

The tree has a joint for each rotating body. A geared rotor is a body on a joint that turns N times
as fast as the driven one, the two bodies of a rolling joint turn by half each, and two motors of a
wrist move its joints together. The tree's regressor Y_θ then becomes the regressor Y_q of measured
efforts, with all gyroscopic and inertial coupling of the rotors. Friction and inertia *on the
actuator's side* are effects in q, q̇ and q̈.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from geodrake.boundary.arguments import Sizes, instance, instances, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.logs.motion import Motion

_STEP = 2e-3  # rad or m; fourth-order differences have errors of about 1e-12
_MOST_ITERATIONS = 50


class Transmission(abc.ABC):
    """A smooth map from n actuator coordinates to k joint positions, for many samples at once.

    A user-defined one, such as a cam, defines `shape`, `joint_positions` and `jacobian`.
    """

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, int]:
        """Return the numbers (k, n) of joint positions θ and actuator coordinates q."""

    @property
    def num_joints(self) -> int:
        """Return the number k of joint positions θ."""
        return self.shape[0]

    @property
    def num_actuators(self) -> int:
        """Return the number n of actuator coordinates q."""
        return self.shape[1]

    @abc.abstractmethod
    def joint_positions(self, q: Array) -> Array:
        """Return θ = T(q), (N, k), for q (N, n)."""

    @abc.abstractmethod
    def jacobian(self, q: Array) -> Array:
        """Return J = ∂T/∂q, (N, k, n), for q (N, n)."""

    @property
    def range(self) -> tuple[Array, Array]:
        """Return the limits (n,) of the actuator positions where the map is defined."""
        most = np.full(self.num_actuators, np.inf)
        return -most, most

    def inside(self, q: Array) -> Array:
        """Return actuator coordinates (N, n) moved into the domain of the map."""
        return q

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """Return J̇ (N, k, n) at q and v (N, n), by fourth-order differences unless overridden."""
        speed = np.abs(v).max(axis=1, initial=0.0)[:, None]
        step = _STEP * v / np.where(speed > 0, speed, 1.0)
        near = self.jacobian(q + step) - self.jacobian(q - step)
        far = self.jacobian(q + 2 * step) - self.jacobian(q - 2 * step)
        return (8 * near - far) / (12 * _STEP) * speed[:, :, None]

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return θ (N, k), J and J̇ (N, k, n) for a motion of the actuators; v is 0 if None."""
        rate = np.zeros((len(q), *self.shape)) if v is None else self.jacobian_rate(q, v)
        return self.joint_positions(q), self.jacobian(q), rate

    @property
    def constant_jacobian(self) -> Array | None:
        """Return J (k, n) if it is constant; None if it depends on q."""
        return None

    def joint_motion(self, motion: Motion) -> Motion:
        """Return the joints' motion for a motion of the actuators."""
        instance(motion, "motion", Motion)
        sizes: Sizes = {}
        q, v, vd = (
            real_array(getattr(motion, name), f"motion.{name}", ("N", self.num_actuators), sizes)
            for name in ("q", "v", "vd")
        )
        J = self.jacobian(q)
        acceleration = times(J, vd) + times(self.jacobian_rate(q, v), v)
        return Motion(self.joint_positions(q), times(J, v), acceleration, motion.time)

    def regressor(self, q: ArrayLike, regressor: ArrayLike) -> Array:
        """Return Y_q = Jᵀ Y_θ (N, n, p) from the tree's regressor (N, k, p) for `joint_motion`."""
        sizes: Sizes = {}
        q = self._q(q, sizes)
        rows = real_array(regressor, "regressor", ("N", self.num_joints, "p"), sizes)
        return np.swapaxes(self.jacobian(q), 1, 2) @ rows

    def _q(self, q: ArrayLike, sizes: Sizes | None = None) -> Array:
        """Return checked coordinates (N, n) of the actuators."""
        return real_array(q, "q", ("N", self.num_actuators), sizes)

    def actuator_positions(self, theta: Array, *, start: ArrayLike = 0.0) -> Array:
        """Return q (N, n) with T(q) = θ (N, k), by the Gauss–Newton method.

        The start (n,) or (N, n) selects one of several solutions.
        """
        theta = real_array(theta, "theta", ("N", self.num_joints))
        q, wanted = real_array(start, "start"), (len(theta), self.num_actuators)
        if q.shape not in ((), wanted[1:], wanted):
            raise ArgumentError(
                f"The initial guess must have shape {wanted[1:]} or {wanted}; got {q.shape}."
            )
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
                f"The actuators cannot reach some joint positions; the error is {error:g}.",
                advice="Check the transmission and its offsets, or use a closer initial guess.",
            )
        return q


class JointlyEvaluated(Transmission):
    """A transmission that defines `along`, which all other methods use."""

    @abc.abstractmethod
    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return θ (N, k), J and J̇ (N, k, n) for a motion of the actuators; v is 0 if None."""

    def joint_positions(self, q: Array) -> Array:
        """Return θ = T(q)."""
        return self.along(q)[0]

    def jacobian(self, q: Array) -> Array:
        """Return J."""
        return self.along(q)[1]

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """Return J̇."""
        return self.along(q, instance(v, "v", np.ndarray))[2]


def times(matrices: Array, vectors: Array) -> Array:
    """Return products (N, m) of matrices (N, m, n) and vectors (N, n)."""
    return np.einsum("nij,nj->ni", matrices, vectors)


@dataclass(frozen=True, eq=False)
class LinearTransmission(JointlyEvaluated, Short):
    """θ = J q + θ₀ with a constant J, such as gears, belts and coupled wrists.

    Attributes:
        matrix: (k, n) J.
        offset: (k,) θ₀, rad or m.
    """

    matrix: Array
    offset: Array

    def __post_init__(self) -> None:
        sizes: Sizes = {}
        J = real_array(self.matrix, "matrix", ("k", "n"), sizes)
        object.__setattr__(self, "matrix", J)
        object.__setattr__(self, "offset", real_array(self.offset, "offset", ("k",), sizes))
        if (rank := np.linalg.matrix_rank(J) if J.size else 0) < J.shape[1]:
            raise ArgumentError(
                f"matrix must have rank n = {J.shape[1]}; its rank is {rank}.",
                advice="Remove redundant actuators.",
            )

    @classmethod
    def of(cls, matrix: ArrayLike, offset: ArrayLike = 0.0) -> LinearTransmission:
        """Return the transmission with J (k, n) and θ₀, (k,) or a scalar, rad or m."""
        J, shift = real_array(matrix, "matrix", ("k", "n")), real_array(offset, "offset")
        return cls(J, np.full(len(J), shift) if shift.ndim == 0 else shift)

    @classmethod
    def from_ratios(
        cls,
        joints: Sequence[str],
        actuators: Sequence[str],
        ratios: Mapping[str, Mapping[str, float]],
    ) -> LinearTransmission:
        """Return the transmission with ratios by name.

        Args:
            joints: Names of the tree's k velocities, such as `geodrake.robot.joint_names(plant)`.
            ratios: Joint -> actuator -> ∂θ/∂q, 0 for missing names, such as
                `{"knee": {"knee": 1.0}, "knee_rotor": {"knee": 10.6}}`.
        """
        joints, actuators = instances(joints, "joints", str), instances(actuators, "actuators", str)
        J = np.zeros((len(joints), len(actuators)))
        for joint, terms in instance(ratios, "ratios", Mapping).items():
            for actuator, ratio in instance(terms, f"ratios[{joint!r}]", Mapping).items():
                for name, known in ((joint, joints), (actuator, actuators)):
                    if name not in known:
                        raise ArgumentError(f"{name!r} is none of {', '.join(known)}.")
                place = joints.index(joint), actuators.index(actuator)
                J[place] = number(ratio, f"ratios[{joint!r}][{actuator!r}]")
        return cls.of(J)

    @property
    def shape(self) -> tuple[int, int]:
        """Return the shape of J."""
        return self.matrix.shape[0], self.matrix.shape[1]

    @property
    def constant_jacobian(self) -> Array:
        """Return J."""
        return self.matrix

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return θ = J q + θ₀, the constant J, and J̇ = 0."""
        sizes: Sizes = {}
        q = self._q(q, sizes)
        if v is not None:
            real_array(v, "v", ("N", self.num_actuators), sizes)
        J = np.broadcast_to(self.matrix, (len(q), *self.shape))
        return q @ self.matrix.T + self.offset, J, np.zeros(J.shape)


def gears(ratios: ArrayLike) -> LinearTransmission:
    """Return θ_i = q_i / N_i for motors that turn N_i times as fast; a negative N_i reverses."""
    N = real_array(ratios, "ratios", ("n",))
    if not N.all():
        raise ArgumentError(f"Gear ratios must not be zero; got {N.tolist()}.")
    return LinearTransmission.of(np.diag(1.0 / N))


def rolling_joint(share: float = 0.5) -> LinearTransmission:
    """Return θ = (s q, (1 − s) q) for two parallel joints and one coordinate, with s from 0 to 1.

    Two bodies that roll on each other, with radii r₁ and r₂ around the axes of the tree, turn in
    the ratio r₂ : r₁, so s = r₂ / (r₁ + r₂).
    """
    number(share, "share", lower=0.0, upper=1.0)
    return LinearTransmission.of([[share], [1.0 - share]])


@dataclass(frozen=True)
class SideBySide(JointlyEvaluated):
    """Several transmissions without shared actuators or joints, stacked in order."""

    parts: tuple[Transmission, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", instances(self.parts, "parts", Transmission))
        if not self.parts:
            raise ArgumentError("A transmission needs at least one part.")

    @property
    def shape(self) -> tuple[int, int]:
        """Return the sums over the parts."""
        return sum(p.num_joints for p in self.parts), sum(p.num_actuators for p in self.parts)

    @property
    def constant_jacobian(self) -> Array | None:
        """Return the parts' Jacobians as blocks if all are constant."""
        given = [p.constant_jacobian for p in self.parts if p.constant_jacobian is not None]
        return np.asarray(block_diag(*given)) if len(given) == len(self.parts) else None

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the parts' positions in order, and J and J̇ as blocks."""
        rates = [None] * len(self.parts) if v is None else self._split(v)
        inputs = zip(self.parts, self._split(q), rates, strict=True)
        theta, J, rate = zip(*(part.along(x, xd) for part, x, xd in inputs), strict=True)
        return np.hstack(theta), self._blocks(J), self._blocks(rate)

    @property
    def range(self) -> tuple[Array, Array]:
        """Return the values of all parts."""
        low, high = zip(*(part.range for part in self.parts), strict=True)
        return np.concatenate(low), np.concatenate(high)

    def inside(self, q: Array) -> Array:
        """Return the values of all parts."""
        inputs = zip(self.parts, self._split(q), strict=True)
        return np.hstack([part.inside(x) for part, x in inputs])

    def _split(self, q: Array) -> list[Array]:
        ends = np.cumsum([part.num_actuators for part in self.parts])
        return np.split(q, ends[:-1], axis=1)

    def _blocks(self, blocks: Sequence[Array]) -> Array:
        full = np.zeros((len(blocks[0]), *self.shape))
        row = column = 0
        for block in blocks:
            _, k, n = block.shape
            full[:, row : row + k, column : column + n] = block
            row, column = row + k, column + n
        return full


@dataclass(frozen=True)
class InSequence(JointlyEvaluated):
    """A composition of transmissions, from the actuators to the joints: θ = T_last(…T_first(q)).

    Attributes:
        stages: The transmissions, starting at the actuators.
    """

    stages: tuple[Transmission, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", instances(self.stages, "stages", Transmission))
        if not self.stages:
            raise ArgumentError("A transmission needs at least one stage.")
        for inner, outer in pairwise(self.stages):
            if inner.num_joints != outer.num_actuators:
                raise ArgumentError(
                    f"A stage has {inner.num_joints} outputs, but the next one "
                    f"{outer.num_actuators} inputs."
                )

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of joints of the last stage and actuators of the first."""
        return self.stages[-1].num_joints, self.stages[0].num_actuators

    @property
    def range(self) -> tuple[Array, Array]:
        """Return the limits of the first stage."""
        return self.stages[0].range

    def inside(self, q: Array) -> Array:
        """Return coordinates moved into the domain of the first stage."""
        return self.stages[0].inside(q)

    @property
    def constant_jacobian(self) -> Array | None:
        """Return the product of the stages' Jacobians if all are constant."""
        product: Array = np.eye(self.num_actuators)
        for stage in self.stages:
            if (J := stage.constant_jacobian) is None:
                return None
            product = J @ product
        return product

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return θ, J = J₂ J₁ and J̇ = J̇₂ J₁ + J₂ J̇₁, stage by stage."""
        theta, J, rate = self.stages[0].along(q, v)
        for stage in self.stages[1:]:
            theta, outer, outer_rate = stage.along(theta, None if v is None else times(J, v))
            J, rate = outer @ J, outer_rate @ J + outer @ rate
        return theta, J, rate
