"""Transmissions with constant ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Sizes, instance, instances, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.robot.transmission.base import Transmission


@dataclass(frozen=True, eq=False)
class LinearTransmission(Transmission, Short):
    """θ = J q + θ₀ with a constant J, of `of` or `from_ratios`: gears, belts, coupled wrists.

    Attributes:
        matrix: (k, n) J.
        offset: (k,) θ₀, rad or m.

    Raises:
        ArgumentError: The shapes do not fit, a value is not finite, or some actuator moves nothing
            of its own.
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
                f"matrix must be of rank n = {J.shape[1]}; its rank is {rank}.",
                advice="Leave out actuators that move nothing that others do not.",
            )

    @classmethod
    def of(cls, matrix: ArrayLike, offset: ArrayLike = 0.0) -> LinearTransmission:
        """Make it of J (k, n) and θ₀ (k,) or one number for all, rad or m.

        Raises:
            ArgumentError: As of the class.
        """
        J, shift = real_array(matrix, "matrix", ("k", "n")), real_array(offset, "offset")
        return cls(J, np.full(len(J), shift) if shift.ndim == 0 else shift)

    @classmethod
    def from_ratios(
        cls,
        joints: Sequence[str],
        actuators: Sequence[str],
        ratios: Mapping[str, Mapping[str, float]],
    ) -> LinearTransmission:
        """By name: `{"knee": {"knee": 1.0}, "knee_rotor": {"knee": 10.6}}`.

        Args:
            joints: Names of the tree's k velocities, such as `geodrake.robot.joint_names(plant)`.
            ratios: Joint -> actuator -> how far the joint turns when the actuator turns by one.
                Joints that are not named do not move.

        Raises:
            ArgumentError: A name is not known, or a ratio is no number.
        """
        joints, actuators = instances(joints, "joints", str), instances(actuators, "actuators", str)
        J = np.zeros((len(joints), len(actuators)))
        for joint, terms in instance(ratios, "ratios", Mapping).items():
            for actuator, ratio in instance(terms, f"ratios[{joint!r}]", Mapping).items():
                for name, known in ((joint, joints), (actuator, actuators)):
                    if name not in known:
                        raise ArgumentError(f"There is no {name!r} among {', '.join(known)}.")
                place = joints.index(joint), actuators.index(actuator)
                J[place] = number(ratio, f"ratios[{joint!r}][{actuator!r}]")
        return cls.of(J)

    @property
    def num_actuators(self) -> int:
        """Number n of actuator coordinates q."""
        return self.matrix.shape[1]

    @property
    def num_joints(self) -> int:
        """Number k of joint positions θ."""
        return self.matrix.shape[0]

    @property
    def constant_jacobian(self) -> Array:
        """J."""
        return self.matrix

    def joint_positions(self, q: Array) -> Array:
        """θ = J q + θ₀."""
        return self._checked(q, "q", self.num_actuators) @ self.matrix.T + self.offset

    def jacobian(self, q: Array) -> Array:
        """J, the same for all samples."""
        q = self._checked(q, "q", self.num_actuators)
        return np.broadcast_to(self.matrix, (len(q), *self.matrix.shape))

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """Zero."""
        sizes: Sizes = {}
        q = self._checked(q, "q", self.num_actuators, sizes)
        self._checked(v, "v", self.num_actuators, sizes)
        return np.zeros((len(q), *self.matrix.shape))
