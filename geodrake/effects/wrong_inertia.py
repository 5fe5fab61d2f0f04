"""Links whose inertia differs from the model's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from geodrake.effects.base import Array, Effect, RobotMotion, Role
from geodrake.errors import ArgumentError


@dataclass(frozen=True)
class WrongInertia(Effect):
    """Inertial parameters of bodies that are far from the model's, in the geometric distance.

    effort = Y_rb(q, v, v̇) (φ − φ₀), with the model's φ₀.

    Its columns are those of the bodies, which every fit has: a diagnosis finds it by widening their
    prior, and a model has it in its bodies. So nobody makes an instance.
    """

    name = "wrong_inertia"
    law = "the model's inertias, let go from their prior"
    list_position = 61
    role = Role.INERTIA
    places = "bodies"
    parameters = ()
    signature = "the inertia of links differs from the model's"
    depends_on = frozenset({"q", "v", "vd"})
    complexity = 3

    def __post_init__(self) -> None:
        raise ArgumentError(
            f"{self.name} is no effect beside the bodies of a model: it is their inertias.",
            advice=f"Let geodrake add {self.name} refit them.",
        )

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Unit of the mass of a body that results report."""
        return "kg" if name == "mass" else super().unit_of(name)

    @property
    def where(self) -> tuple[str, ...]:
        """Nothing: it is in the bodies."""
        return ()

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Nothing beside the columns of the bodies."""
        del motion
        return {}
