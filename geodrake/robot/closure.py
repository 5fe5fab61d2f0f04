"""What a model file states of closed loops: frames of two bodies that are one."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.math import RigidTransform

from geodrake.inertia import Array

WORLD = "world"
"""Name of the world among the bodies of closures."""


@dataclass(frozen=True)
class CutJoint:
    """A joint that closes a loop and is not in the tree.

    Attributes:
        axis: (3,) its axis in the first frame of its closure.
        slides: Whether it is prismatic.
    """

    name: str
    axis: Array
    slides: bool


@dataclass(frozen=True)
class Closure:
    """Two frames of a robot's bodies that are one, or whose origins are.

    Attributes:
        name: What closes the loop, in words.
        bodies: Scoped names of the bodies.
        poses: Poses of the frames in them.
        turns: Whether the frames turn together; else only the origins are one.
        cut: The joint between the frames; None for none.
    """

    name: str
    bodies: tuple[str, str]
    poses: tuple[RigidTransform, RigidTransform]
    turns: bool
    cut: CutJoint | None = None
