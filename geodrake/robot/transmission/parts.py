"""Parts to build transmissions from: gears, rolling joints, side by side and in sequence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from geodrake.boundary.arguments import instances, number, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.robot.transmission.base import Transmission
from geodrake.robot.transmission.linear import LinearTransmission


def gears(ratios: ArrayLike) -> LinearTransmission:
    """Joints θ_i = q_i / N_i of motors that turn N_i times as fast; a negative N_i reverses.

    Args:
        ratios: (n,) gear ratios N, motor turns for one of the joint.

    Raises:
        ArgumentError: A ratio is zero or not finite.
    """
    N = real_array(ratios, "ratios", ("n",))
    if not N.all():
        raise ArgumentError(f"Gear ratios must not be zero; got {N.tolist()}.")
    return LinearTransmission.of(np.diag(1.0 / N))


def rolling_joint(share: float = 0.5) -> LinearTransmission:
    """Two parallel joints that one coordinate turns: θ = (s q, (1 − s) q).

    Two bodies that roll on each other, with the radii r₁ and r₂ around the axes of the tree, turn
    by angles in the ratio r₂ : r₁; with equal ones, by half each.

    Args:
        share: s = r₂ / (r₁ + r₂) of the first joint, between 0 and 1.

    Raises:
        ArgumentError: The share is out of its range.
    """
    number(share, "share", lower=0.0, upper=1.0)
    return LinearTransmission.of([[share], [1.0 - share]])


@dataclass(frozen=True)
class SideBySide(Transmission):
    """Several transmissions that do not share actuators or joints, in their order."""

    parts: tuple[Transmission, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", instances(self.parts, "parts", Transmission))
        if not self.parts:
            raise ArgumentError("A transmission has at least one part.")

    @property
    def num_actuators(self) -> int:
        """Sum over the parts."""
        return sum(part.num_actuators for part in self.parts)

    @property
    def num_joints(self) -> int:
        """Sum over the parts."""
        return sum(part.num_joints for part in self.parts)

    @property
    def constant_jacobian(self) -> Array | None:
        """The parts' Jacobians as blocks, where all are constant."""
        blocks = [part.constant_jacobian for part in self.parts]
        given = [block for block in blocks if block is not None]
        return np.asarray(block_diag(*given)) if len(given) == len(blocks) else None

    def joint_positions(self, q: Array) -> Array:
        """The parts' positions, one after another."""
        inputs = self._split(q)
        return np.hstack([p.joint_positions(x) for p, x in zip(self.parts, inputs, strict=True)])

    def jacobian(self, q: Array) -> Array:
        """The parts' Jacobians as blocks."""
        inputs = self._split(q)
        return self._blocks([p.jacobian(x) for p, x in zip(self.parts, inputs, strict=True)])

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """The parts' rates as blocks."""
        inputs = zip(self.parts, self._split(q), self._split(v), strict=True)
        return self._blocks([part.jacobian_rate(x, xd) for part, x, xd in inputs])

    def inside(self, q: Array) -> Array:
        """The parts' own."""
        return np.hstack([p.inside(x) for p, x in zip(self.parts, self._split(q), strict=True)])

    def _split(self, q: Array) -> list[Array]:
        ends = np.cumsum([part.num_actuators for part in self.parts])
        return np.split(q, ends[:-1], axis=1)

    def _blocks(self, blocks: Sequence[Array]) -> Array:
        full = np.zeros((len(blocks[0]), self.num_joints, self.num_actuators))
        row = column = 0
        for block in blocks:
            _, k, n = block.shape
            full[:, row : row + k, column : column + n] = block
            row, column = row + k, column + n
        return full


@dataclass(frozen=True)
class InSequence(Transmission):
    """One transmission after another, from the actuators to the joints: θ = T_last(…T_first(q)).

    Attributes:
        stages: The transmissions, the actuators' one first.
    """

    stages: tuple[Transmission, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", instances(self.stages, "stages", Transmission))
        if not self.stages:
            raise ArgumentError("A transmission has at least one stage.")
        for inner, outer in pairwise(self.stages):
            if inner.num_joints != outer.num_actuators:
                raise ArgumentError(
                    f"A stage gives {inner.num_joints} positions, but the next one takes "
                    f"{outer.num_actuators}."
                )

    @property
    def num_actuators(self) -> int:
        """That of the first stage."""
        return self.stages[0].num_actuators

    @property
    def num_joints(self) -> int:
        """That of the last stage."""
        return self.stages[-1].num_joints

    def inside(self, q: Array) -> Array:
        """Where the first stage is known."""
        return self.stages[0].inside(q)

    @property
    def constant_jacobian(self) -> Array | None:
        """The product of the stages' Jacobians, where all are constant."""
        product: Array = np.eye(self.num_actuators)
        for stage in self.stages:
            if (J := stage.constant_jacobian) is None:
                return None
            product = J @ product
        return product

    def joint_positions(self, q: Array) -> Array:
        """The stages' maps in turn."""
        for stage in self.stages:
            q = stage.joint_positions(q)
        return q

    def jacobian(self, q: Array) -> Array:
        """The product of the stages' Jacobians."""
        J = self.stages[0].jacobian(q)
        for inner, outer in pairwise(self.stages):
            q = inner.joint_positions(q)
            J = outer.jacobian(q) @ J
        return J

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """J̇ = J̇₂ J₁ + J₂ J̇₁, stage by stage."""
        J, rate = self.stages[0].jacobian(q), self.stages[0].jacobian_rate(q, v)
        for inner, outer in pairwise(self.stages):
            v = np.einsum("nij,nj->ni", inner.jacobian(q), v)
            q = inner.joint_positions(q)
            J2 = outer.jacobian(q)
            J, rate = J2 @ J, outer.jacobian_rate(q, v) @ J + J2 @ rate
        return rate
