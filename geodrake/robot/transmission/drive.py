"""Drives: named actuators that move named joints, the parts of a robot's transmission."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geodrake.boundary.arguments import instance, instances
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.robot.transmission.base import Transmission
from geodrake.robot.transmission.loop import LoopTransmission
from geodrake.robot.transmission.statements import Statement


@dataclass(frozen=True, eq=False)
class Drive(Short):
    """Actuators, the joints that they move together, and how.

    Attributes:
        actuators: Names of the n actuators, as logs have them.
        joints: Names of the k joints of the model file, n ≤ k.
        map: θ = T(q) from the actuators to the joints.
        slides: Whether each actuator slides, so that its positions are in m and its efforts in N;
            None for each as the joint in whose place it stands.
        range: Positions (n,) of the actuators between which the map holds, rad or m.
        statement: What it was made of, which is saved; None for one of functions of your own.
        followers: How many of the joints, the last ones, only follow others by constant ratios.
    """

    actuators: tuple[str, ...]
    joints: tuple[str, ...]
    map: Transmission
    slides: tuple[bool, ...] | None = None
    range: tuple[Array, Array] | None = None
    statement: Statement | None = None
    followers: int = field(default=0, compare=False)

    def __post_init__(self) -> None:
        instance(self.map, "map", Transmission)
        for what, count in (
            ("actuators", self.map.num_actuators),
            ("joints", self.map.num_joints),
        ):
            names = instances(getattr(self, what), what, str)
            object.__setattr__(self, what, names)
            if len(names) != count or len(set(names)) < len(names):
                raise ArgumentError(
                    f"A drive of {self.map.num_actuators} actuators and {self.map.num_joints} "
                    f"joints needs as many different {what}; it has {', '.join(names)}."
                )

    @property
    def is_loop(self) -> bool:
        """Whether it is a closed loop of the model file, and nothing that a user states."""
        return isinstance(self.map, LoopTransmission)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Least and greatest positions (n,) for which the map holds, rad or m."""
        if self.range is not None:
            return self.range
        most = np.full(len(self.actuators), np.inf)
        return -most, most

    @classmethod
    def of(cls, statement: Statement) -> Drive:
        """Return the drive that a part of a transmission file states."""
        range_, slides = statement.range(), statement.slides()
        return cls(
            statement.actuator_names(),
            statement.joint_names(),
            statement.transmission(),
            None if slides is None else (slides,) * len(statement.actuator_names()),
            None if range_ is None else (np.array([range_[0]]), np.array([range_[1]])),
            statement,
        )
