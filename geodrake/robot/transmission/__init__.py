"""Transmissions: how the joints θ of a tree follow from fewer, or other, actuator coordinates q.

    θ = T(q),   θ̇ = J q̇,   θ̈ = J q̈ + J̇ q̇,   τ_q = Jᵀ τ_θ,   Y_q = Jᵀ Y_θ     [Lee2019] Eq. (3.6.57)

The tree has a joint for everything that turns: a geared rotor is a body of its own, on a joint that
turns N times as fast as the one it drives; the two bodies of a rolling joint each turn by half;
two motors of a wrist move its joints together. Its regressor Y_θ, for joint coordinates, then
becomes the regressor Y_q of what is measured, with all gyroscopic and inertial coupling of the
rotors. Friction and inertia *on the actuator's side* are effects in q, q̇, q̈ as they stand.
"""

from geodrake.robot.transmission.base import (
    InSequence,
    LinearTransmission,
    SideBySide,
    Transmission,
    gears,
    rolling_joint,
)
from geodrake.robot.transmission.statements import Drive

__all__ = [
    "Drive",
    "InSequence",
    "LinearTransmission",
    "SideBySide",
    "Transmission",
    "gears",
    "rolling_joint",
]
