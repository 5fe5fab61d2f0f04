"""Payloads, and wrong inertias of bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geodrake.effects.base import (
    Array,
    BodyEffect,
    Effect,
    Parameter,
    Proposer,
    RobotMotion,
    Role,
    Rows,
    Shape,
    Values,
)
from geodrake.effects.episode import Episode
from geodrake.effects.gradient import RobotGradient
from geodrake.errors import ArgumentError
from geodrake.inertia import to_mass_com_inertia
from geodrake.inertia.parameters import PARAMETER_NAMES, PARAMETER_UNITS
from geodrake.manifolds import Manifold, PhysicalInertia

_NEVER_NEGATIVE = ("m", "Ixx", "Iyy", "Izz")


@dataclass(frozen=True)
class Payload(BodyEffect):
    """Rigid body fixed to a link.

    effort = Y_B(q, v, v̇) φ, with the regressor of the link's own inertial parameters and the
    payload's φ about the link's origin, expressed in the link's frame; P(φ) ≻ 0.
    """

    name = "payload"
    law = "ten inertial parameters, P ≻ 0"
    complexity = 1
    role = Role.BODY
    summary = "mass"
    parameters = tuple(
        Parameter(name, unit, lower=0.0 if name in _NEVER_NEGATIVE else -np.inf)
        for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)
    )
    signature = "an additional body on a link"
    depends_on = frozenset({"q", "v", "vd"})

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Return the unit of a parameter, or of the reported mass or centre of mass."""
        return {"mass": "kg", **{f"com_{axis}": "m" for axis in "xyz"}}.get(
            name, super().unit_of(name)
        )

    def reported(self, parameters: Array, deviations: Array) -> tuple[Values, Values]:
        """Return mass and centre of mass, and their standard deviations."""
        mass, com, _ = to_mass_com_inertia(parameters)
        # To first order, with mass and first moment treated as independent.
        spread = np.hypot(deviations[1:4], com * deviations[0]) / mass
        return _by_name(float(mass), com), _by_name(float(deviations[0]), spread)

    @property
    def manifold(self) -> Manifold:
        """Inertial parameters of a physically valid body."""
        return PhysicalInertia()

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the link's ten inertial columns at every joint."""
        columns = motion.body_columns(self.body)
        return {joint: columns[:, i] for i, joint in enumerate(motion.joints)}

    def regressor(self, motion: RobotMotion) -> Array:
        """Return the link's inertial regressor, (N, nv, 10)."""
        return motion.body_columns(self.body)

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient:
        """Return the weights, as the gradient by the link's inertial regressor."""
        return replace(RobotGradient.zero(motion), bodies={self.body: weights})


def _by_name(mass: float, com: Array) -> Values:
    x, y, z = com.tolist()
    return {"mass": mass, "com_x": x, "com_y": y, "com_z": z}


@dataclass(frozen=True)
class TemporaryPayload(Episode):
    """Rigid body that a link picks up or puts down during a log.

    effort = w(t) Y_B(q, v, v̇) φ, with the weight w of the episode (see `Episode`) and φ as for
    `Payload`.

    Attributes:
        start: Time of picking up, s since the log began; None if before the log.
        end: Time of putting down, s since the log began; None if after the log.
        rise: Duration of either change, s.
        log: Number of the log, from `log_number`; 0 for any.
    """

    start: float | None = None
    end: float | None = None
    rise: float = 0.01
    log: int = 0

    name = "temporary_payload"
    law = "w(t) Y φ: a payload that is picked up or put down in a log"
    complexity = 2
    proposer = Proposer.HANDLING
    summary = Payload.summary
    shapes = tuple(Shape(name, "s") for name in ("start", "end", "rise"))
    parameters = Payload.parameters
    signature = "a load that changes at some instant"
    depends_on = frozenset({"q", "v", "vd", "time"})

    @property
    def place(self) -> str:
        """Return the body, and the times of the payload."""
        return f"{self.body}, {self.when}"

    @property
    def free_shapes(self) -> int:
        """Return the number of free start and end times."""
        return (self.start is not None) + (self.end is not None)

    @property
    def reported_shape(self) -> dict[str, float]:
        """Start and end."""
        shape = super().reported_shape.items()
        return {name: value for name, value in shape if name in ("start", "end")}

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Return the unit of a parameter, or of a reported value."""
        return "s" if name in ("start", "end", "rise") else Payload.unit_of(name)

    def reported(self, parameters: Array, deviations: Array) -> tuple[Values, Values]:
        """Return mass, centre of mass, start and end, and the standard deviations."""
        values, reported_deviations = Payload(self.body).reported(parameters, deviations)
        return values | self.reported_shape, reported_deviations

    @property
    def manifold(self) -> Manifold:
        """Inertial parameters of a physically valid body."""
        return Payload(self.body).manifold

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the link's ten inertial columns at every joint, during the episode."""
        weight = np.zeros(len(motion.v))
        if motion.time is not None and self.is_of(motion.log):
            weight = self.weight(motion.time)
        columns = weight[:, None, None] * motion.body_columns(self.body)
        return {joint: columns[:, i] for i, joint in enumerate(motion.joints)}


@dataclass(frozen=True)
class WrongInertia(Effect):
    """Inertial parameters of bodies that are far from the model's, in the geometric distance.

    effort = Y_rb(q, v, v̇) (φ − φ₀), with the model's φ₀.

    Its columns are those of the bodies, which every fit includes. A diagnosis finds it by widening
    the bodies' prior, and a model contains it in its bodies. Instances are therefore never created.
    """

    name = "wrong_inertia"
    law = "the model's inertias, free of their prior"
    role = Role.INERTIA
    places = "bodies"
    parameters = ()
    signature = "the inertia of links differs from the model's"
    depends_on = frozenset({"q", "v", "vd"})
    complexity = 3

    def __post_init__(self) -> None:
        raise ArgumentError(
            f"{self.name} cannot be constructed: it stands for the inertias of a model's bodies.",
            advice=f"Use geodrake add {self.name}, which refits them.",
        )

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Return the unit of a body's reported mass."""
        return "kg" if name == "mass" else super().unit_of(name)

    def rows(self, motion: RobotMotion) -> Rows:
        """Return no columns in addition to those of the bodies."""
        del motion
        return {}
