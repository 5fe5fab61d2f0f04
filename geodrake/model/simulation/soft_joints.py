"""Springs and dead bands between the motors and the links of a plant.

The rotor of a geared joint spins about its axis only, as in Spong's model of a flexible joint:

    M(q) q̈ + C q̇ − τ_g = τ,    B θ̈ + f(θ, θ̇) = u − τ,    τ = torque(θ − q, θ̇ − q̇)

M. W. Spong, "Modeling and Control of Elastic Joint Robots", ASME J. Dyn. Sys., Meas., Control
109(4), 1987. A dead band has sides that are stiff springs with strong dampers, which only push.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Effect
from geodrake.effects.deflection import DeflectionEffect, Give
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.model.simulation.terms import PlantMotion

LEAST_MOTOR = 0.01
"""Share of the link's inertia that a motor has at least, as without one it could not be moved."""

_SIDE_DAMPING = 0.7  # of the sides of a dead band, at which links stay rather than bounce
_SIDE_GIVE = 0.1  # of half a dead band: by how much its sides yield to the usual load
_LEAST_YIELD = 1e-5  # rad or m, of which little is seen; stiffer sides only cost time
_USUAL_ACCELERATION = 10.0  # rad/s² or m/s², of the link, whose effort beside the weight that is
_RAMP = 0.1  # of that yield, over which the sides' damping comes on
_POSTURES = 32  # in which the weight of a link is looked for


@dataclass(frozen=True)
class Coupling:
    """What holds one motor and its link together.

    Attributes:
        stiffness: Beyond the dead band, N·m/rad or N/m.
        play: Half width of the dead band, rad or m; 0 for none.
        damping: N·m·s/rad or N·s/m.
        ramp: Way beyond the dead band over which the damping comes on, rad or m.
    """

    stiffness: float
    play: float
    damping: float
    ramp: float

    def torque(self, lag: float, rate: float) -> float:
        """Return the torque on the link, N·m or N.

        Args:
            lag: Position of the motor less that of the link, rad or m.
        """
        if self.play == 0.0:
            return self.stiffness * lag + self.damping * rate
        side = 1.0 if lag > 0.0 else -1.0
        over = side * lag - self.play
        share = min(over / self.ramp, 1.0)
        push = self.stiffness * over + share * self.damping * (side * rate)
        return side * push if over > 0.0 and push > 0.0 else 0.0

    def lag(self, torque: float) -> float:
        """Return the lag (rad or m) under a steady torque (N·m or N)."""
        return float(torque / self.stiffness + self.play * np.sign(torque))


@dataclass(frozen=True, eq=False)
class SoftJoints:
    """The m joints of a plant whose links are not where their motors are.

    Attributes:
        velocities: (m,) their velocities.
        positions: (m,) their positions.
        effects: Of each, what gives way, and where its parameters are among those of all effects.
        link_inertia: (m,) 1 / (M⁻¹)_jj in the default posture, kg·m² or kg.
        motor_inertia: (m,) that of the motors, kg·m² or kg.
        usual_load: (m,) efforts that sides of dead bands are made for, N·m or N.
        damping: Of springs that do not say it, as a share of the critical one.
    """

    names: tuple[str, ...]
    velocities: NDArray[np.intp]
    positions: NDArray[np.intp]
    effects: tuple[tuple[tuple[DeflectionEffect, slice], ...], ...]
    link_inertia: Array
    motor_inertia: Array
    usual_load: Array
    damping: float

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.names)

    def couplings(self, mu: Array) -> list[Coupling]:
        """Return what holds motors and links together, by the parameters (k,) of all effects.

        Springs have the damping 2 ζ √(k I), with I the inertia of motor and link against each
        other. Sides of a dead band without a spring yield by a tenth of half the band, and at least
        by 10 µrad (µm), to the usual load: the largest weight, and what moves the link at
        10 rad/s² (m/s²).
        """
        return self.held_by([_give_of((e, mu[at]) for e, at in each) for each in self.effects])

    def held_by(self, gives: Sequence[Give]) -> list[Coupling]:
        """Return what holds motors and links together that give way (m,) in some manner."""
        against = 1.0 / (1.0 / self.link_inertia + 1.0 / self.motor_inertia)
        found = []
        for i, (give, inertia) in enumerate(zip(gives, against.tolist(), strict=True)):
            if not give:
                raise ArgumentError(
                    f"Joint {self.names[i]!r} was made soft, and gives way no more: its link would "
                    "be one with the motor.",
                    advice="Give it a small compliance, or build the diagram without the effect.",
                )
            yields = max(_SIDE_GIVE * give.play, _LEAST_YIELD)
            if give.compliance > 0.0:
                stiffness = 1.0 / give.compliance
                share = self.damping if give.damping is None else give.damping
            else:
                stiffness, share = self.usual_load[i] / yields, _SIDE_DAMPING
            damping = 2.0 * share * (stiffness * inertia) ** 0.5
            found.append(Coupling(stiffness, give.play, damping, _RAMP * yields))
        return found

    def torques(self, mu: Array, lag: Array, rate: Array) -> Array:
        """Return (m,) torques on the links, N·m or N."""
        each = zip(self.couplings(mu), lag, rate, strict=True)
        return np.array([coupling.torque(s, ds) for coupling, s, ds in each])


def _give_of(effects: Iterable[tuple[DeflectionEffect, Array]]) -> Give:
    return sum((effect.give(values) for effect, values in effects), start=Give())


def giving(
    effects: Sequence[Effect], mu: Array, parts: Sequence[slice]
) -> dict[str, list[tuple[DeflectionEffect, slice]]]:
    """Return joint -> what gives way there, and where its parameters are among all μ (k,)."""
    found: dict[str, list[tuple[DeflectionEffect, slice]]] = {}
    for effect, place in zip(effects, parts, strict=True):
        if isinstance(effect, DeflectionEffect):
            found.setdefault(effect.joint, []).append((effect, place))
    return {j: each for j, each in found.items() if _give_of((e, mu[at]) for e, at in each)}


def links_of(motion: PlantMotion, phi: Array) -> tuple[Array, Array]:
    """Return what turns one joint alone feels of its link, 1 / (M⁻¹)_jj (nv,), and usual loads.

    Those are the largest weights that are found, and what moves links as usual (nv,), N·m or N.
    """
    plant, rng, still = motion.plant, np.random.default_rng(0), np.zeros(len(motion.joints))
    q = plant.GetPositions(plant.CreateDefaultContext())
    M = motion.dynamics(q, still, phi)[0]
    inertia = np.asarray(1.0 / np.diag(np.linalg.inv(M)))
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    bounded = np.isfinite(lower) & np.isfinite(upper)
    weights = []
    for _ in range(_POSTURES):
        posture = q.copy()
        posture[bounded] = rng.uniform(lower[bounded], upper[bounded])
        weights.append(np.abs(motion.dynamics(posture, still, phi)[2]))
    return inertia, np.max(weights, axis=0) + _USUAL_ACCELERATION * inertia
