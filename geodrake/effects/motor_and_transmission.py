"""Springs across joints, and effects of motors and gears: ripple, rotors, elasticity, backlash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from geodrake.compiling import compiled, contiguous
from geodrake.effects.base import (
    Array,
    FittedEffect,
    JointEffect,
    JointMotion,
    Parameter,
    Proposer,
    RobotMotion,
    Rows,
    Shape,
    Values,
)
from geodrake.effects.deflection import SPRING_DAMPING, Deflection, DeflectionEffect, Give
from geodrake.effects.friction import Direction, SharedActuatorEffect
from geodrake.effects.gradient import RobotGradient
from geodrake.errors import ArgumentError
from geodrake.logs.filtering import HIGHEST_BANDWIDTH, design_filter


@dataclass(frozen=True)
class JointSpring(JointEffect):
    """Spring across a joint: a cable loom, a balancing spring, a rubber stop.

    effort = k (q − q_c)^n + p, with stiffness k ≥ 0 in N·m/radⁿ and preload p in N·m.

    The preload, which is the effort at q_c, is linear and so stands in for the rest position q₀: of
    a linear spring k (q − q₀) it is p = k (q_c − q₀). A hardening spring
    k (q − q₀) + k₃ (q − q₀)³ is a linear and a cubic one with q_c = q₀.

    Attributes:
        exponent: n, 1 or 3.
        center: q_c, rad or m. It changes nothing but p while n = 1, and keeps k and p apart when it
            is amid the motion.
    """

    exponent: int = 1
    center: float = 0.0

    name = "joint_spring"
    law = "k (q − q_c)ⁿ + preload"
    complexity = 1
    shapes = (Shape("exponent", grid=(1, 3)), Shape("center", "rad"))
    parameters = (Parameter("stiffness", "N·m/radⁿ", lower=0.0), Parameter("preload", "N·m"))
    signature = "follows the joint's position, whatever its speed"
    depends_on = frozenset({"q"})

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponent not in (1, 3) or not np.isfinite(self.center):
            raise ArgumentError(
                f"{self.name} needs exponent 1 or 3 and a finite center; got {self.exponent} "
                f"and {self.center}."
            )

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[(q − q_c)^n, 1]."""
        return [(joint.q - self.center) ** self.exponent, np.ones_like(joint.q)]


@dataclass(frozen=True)
class GravityCompensator(JointEffect):
    """Balancer of a joint: a counterweight, or a spring whose lever turns with the joint.

    effort = k sin(q − q₀) = s sin q + c cos q, with s = k cos q₀ and c = −k sin q₀ in N·m.

    It is for joints that turn. Unlike the weight of a link, it depends on its own joint alone and
    has no inertia.
    """

    name = "gravity_compensator"
    law = "k sin(q − q₀)"
    complexity = 1
    parameters = (Parameter("sine", "N·m"), Parameter("cosine", "N·m"))
    signature = "one wave per turn of the joint, whatever its speed and the other joints"
    depends_on = frozenset({"q"})
    turning_only = True

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[sin q, cos q]."""
        return [np.sin(joint.q), np.cos(joint.q)]


@dataclass(frozen=True)
class TorqueRipple(JointEffect):
    """Effort that repeats over the joint's position: cogging, commutation, gear teeth.

    effort = a cos nq + b sin nq, with a and b in N·m.

    Attributes:
        order: n, waves in a turn (at a prismatic joint 2π waves in 1/n m); no integer where a gear
            is between. A diagnosis finds it in the residual's spectrum over position.
    """

    order: float

    name = "torque_ripple"
    of_motor = True
    law = "a cos n q + b sin n q, n from the residual's spectrum over position"
    proposer = Proposer.WAVES
    shapes = (Shape("order", usual=6.0),)
    parameters = (Parameter("cosine", "N·m"), Parameter("sine", "N·m"))
    signature = "waves over the joint's position, independent of speed"
    depends_on = frozenset({"q"})
    positive = ("order",)

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[cos nq, sin nq]."""
        angle = self.order * joint.q
        return [np.cos(angle), np.sin(angle)]


@dataclass(frozen=True)
class RotorInertia(JointEffect):
    """Reflected inertia of a rotor behind a gear.

    effort = I v̇, with I = (gear ratio)² · rotor inertia ≥ 0 in kg·m² (kg at a prismatic joint).
    """

    name = "rotor_inertia"
    of_motor = True
    taken_out_as = "rotor inertia"
    law = "I v̇"
    complexity = 0
    parameters = (Parameter("inertia", "kg·m²", lower=0.0),)
    signature = "follows the joint's own acceleration"
    depends_on = frozenset({"vd"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[v̇]."""
        return [joint.vd]


@dataclass(frozen=True)
class CoupledRotorInertia(SharedActuatorEffect):
    """Inertial coupling of two joints by a rotor that turns with vᵢ and vⱼ.

    effort of joint i = I v̇ⱼ and effort of joint j = I v̇ᵢ, from the kinetic energy I vᵢ vⱼ: one
    symmetric pair of entries of the mass matrix. I is in kg·m², and negative where the rotor turns
    with the difference. What the same rotor adds to each joint alone is `rotor_inertia` of either
    joint, so |I| ≤ √(Iᵢ Iⱼ) of those two.
    """

    name = "coupled_rotor_inertia"
    of_motor = True
    taken_out_as = "rotor inertia"
    law = "I v̇_j on joint i and I v̇_i on joint j; of any two joints, like `coupled_friction`"
    complexity = 1
    parameters = (Parameter("inertia", "kg·m²"),)
    signature = "at each of two joints, follows the acceleration of the other one"
    depends_on = frozenset({"vd"})

    def rows(self, motion: RobotMotion) -> Rows:
        """[v̇ⱼ] at joint i and [v̇ᵢ] at joint j."""
        i, j = map(motion.joint, self.joints)
        return motion.at_both(self.joints, j.vd[:, None], i.vd[:, None])

    @staticmethod
    def shared(v: Array, turned_v: Array, turned_vd: Array, direction: Direction) -> Array:
        """[s v̇ⱼ]."""
        del v, turned_v, direction
        return turned_vd[..., np.newaxis]

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Of either column by the other joint's v̇."""
        if not set(motion.joints).issuperset(self.joints):
            return None
        i, j = map(motion.index, self.joints)
        gradient = RobotGradient.zero(motion)
        gradient.vd[:, i], gradient.vd[:, j] = weights[:, j, 0], weights[:, i, 0]
        return gradient


@dataclass(frozen=True)
class JointElasticity(DeflectionEffect):
    """Elastic joint between a motor, whose position is measured, and its link: two masses.

    effort = −c (∂τ/∂q τ_j + ∂τ/∂v τ̇_j + M τ̈_j), with the compliance c = 1/k ≥ 0 in rad/(N·m).

    The link is at q − τ_j/k, with τ_j the effort that the rigid bodies need at the joint, and needs
    the effort of its own motion, here to first order in c. That is right below the frequency at
    which link and spring resonate. Friction and rotor inertia belong to the motor and stay as they
    are. Rates of τ_j are those along the log; where samples are no series in time, the joint bends
    as at rest.

    A simulation has motor and link as two bodies with a spring, at any frequency.

    Attributes:
        damping: Of that spring, as a share of the critical one; None for the usual one. A fit of
            efforts does not see it, one of rollouts does.
    """

    damping: float | None = None

    name = "joint_elasticity"
    of_motor = True
    law = "deflection of the link by load / k, to first order in 1/k"
    complexity = 1
    proposer = Proposer.BENDING
    shapes = (Shape("damping", "1"),)
    parameters = (Parameter("compliance", "rad/(N·m)", lower=0.0),)
    signature = "follows the change of effort with the joint's deflection, at all joints"
    free_shapes = 0  # as efforts do not show the damping

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.damping is not None and self.damping < 0.0:
            raise ArgumentError(f"damping of {self.name} must not be negative; got {self.damping}.")

    def deflection(self, motion: RobotMotion) -> Deflection:
        """Return the load of the joint, as a spring of unit stiffness gives way to it."""
        loads = motion.once((Deflection, ""), lambda: Deflection.along(motion.load, motion.time))
        return loads.of(motion.index(self.joint))

    def give(self, parameters: Array) -> Give:
        """Return a spring of the compliance."""
        return Give(compliance=max(parameters[0], 0.0), damping=self.damping)

    def rollout_values(self, parameters: Array) -> Values:
        """Return the compliance and damping of a spring that gives way at all."""
        if not parameters[0] > 0.0:
            return {}
        damping = SPRING_DAMPING if self.damping is None else self.damping
        return {
            "compliance": float(parameters[0]),
            **({"damping": damping} if damping > 0.0 else {}),
        }

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return a spring of this compliance and damping."""
        effect = replace(self, damping=values.get("damping", self.damping))
        return FittedEffect(
            effect, np.array([values["compliance"]]), np.array([deviations["compliance"]])
        )


_SUBSTEPS = 4
_SLOWER = 0.5  # share of the bandwidth at which a load changes its sign by motion, not by noise
_UNSURE = 2.0  # deviations of the noise of a load, below which its sign is not known


@dataclass(frozen=True)
class Backlash(DeflectionEffect):
    """Dead band between a motor, whose position is measured, and its link.

    effort = −g (∂τ/∂q s + ∂τ/∂v ṡ + M s̈), with the lag s(t) of the link; g is 1 where the gap is
    as wide as the shape says. A small share of a wide gap is no play: noise of accelerations looks
    like that where loads are small.

    The link lies at the side of the gap to which its load pushes it, s = ±h. When the load τ_j
    changes its sign the link comes loose, is carried by nothing, M_jj s̈ = τ_j, and strikes the
    other side, where it stays. The motor thus feels no load for a while, and then a blow. A load
    within the noise of the accelerations does not loosen the link. Where samples are no series in
    time, there is only the posture s = h sgn τ_j.

    A simulation has motor and link as two bodies, between stiff and damped sides.

    Attributes:
        half_width: h, rad or m.
    """

    half_width: float

    name = "backlash"
    of_motor = True
    law = "a dead band between the measured motor and its link"
    proposer = Proposer.PLAY
    shapes = (Shape("half_width", "rad", grid=(1e-4, 3e-4, 1e-3, 3e-3, 1e-2)),)
    parameters = (Parameter("gap_share", "1", lower=0.0, spread=0.2, usual=1.0),)
    signature = "where the load changes sign, no load for a moment and then an impact"
    positive = ("half_width",)

    def deflection(self, motion: RobotMotion) -> Deflection:
        """At the side to which the load pushes the link, or loose between both sides."""
        load, time = motion.load[:, motion.index(self.joint)], motion.time
        if time is None or len(time) < 3:
            return Deflection.along(self.half_width * np.sign(load), time)
        period = motion.once((Backlash, ""), lambda: float(np.median(np.diff(time))))
        load, unsure = motion.once((Backlash, self.joint), lambda: self._loosening(motion, period))
        lag = link_lag(self.half_width, load, time, unsure)
        bend = np.diff(lag, 2, prepend=lag[:1], append=lag[-1:])
        return Deflection(lag, np.gradient(lag, period), bend / period**2)

    def _loosening(self, motion: RobotMotion, period: float) -> tuple[Array, Array]:
        """Return accelerations (N,) of a loose link, and those up to which it does not get loose.

        Gaps of any width have the same.
        """
        at = motion.index(self.joint)
        load, inertias = motion.load[:, at], motion.effort_slopes.acceleration[:, at]  # (N, nv)
        power = np.square(np.broadcast_to(motion.acceleration_noise, inertias.shape[1]))
        known = np.nan_to_num(inertias)  # without joints of several degrees
        noise = np.sqrt(np.square(known) @ power)
        bandwidth = _SLOWER * motion.bandwidth
        if bandwidth * period < HIGHEST_BANDWIDTH:
            load = design_filter(period, bandwidth).smooth(load)
        inertia = np.maximum(inertias[:, at], 1e-9)
        return load / inertia, _UNSURE * noise / inertia

    def give(self, parameters: Array) -> Give:
        """Play of half the width h to either side, times the share g."""
        return Give(play=max(parameters[0], 0.0) * self.half_width)

    def rollout_values(self, parameters: Array) -> Values:
        """Return half the width of the gap."""
        width = float(parameters[0]) * self.half_width
        return {"half_width": width} if width > 0.0 else {}

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return the effect with another width of the gap."""
        width = values["half_width"]
        share = np.array([deviations["half_width"] / width])
        return FittedEffect(replace(self, half_width=width), np.ones(1), share)


def link_lag(h: float, acceleration: Array, time: Array, unsure: ArrayLike = 0.0) -> Array:
    """Return the lag (N,) within ±h of a link at instants (N,), s.

    When it is loose, it falls behind with accelerations (N,) τ_j / M_jj, rad/s². It comes loose
    only where their magnitude reaches `unsure`, rad/s², one for all or (N,).
    """
    limits = np.broadcast_to(unsure, len(acceleration))
    return np.asarray(_lag(h, *map(contiguous, (acceleration, limits, time))))


@compiled
def _lag(h: float, acceleration: Array, unsure: Array, time: Array) -> Array:
    """Return the lag (N,) within ±h of a link; see `link_lag`."""
    lags = np.empty(len(acceleration))
    s, speed, last = np.copysign(h, acceleration[0]), 0.0, len(acceleration) - 1
    for i in range(len(acceleration)):
        a, b = acceleration[i], acceleration[min(i + 1, last)]
        dt = (time[min(i + 1, last)] - time[i]) / _SUBSTEPS
        lags[i] = s
        if abs(s) == h and (abs(a) < unsure[i] or (a * s > 0.0 and b * s > 0.0)):
            continue  # it lies at its side
        for k in range(_SUBSTEPS):
            speed += dt * (a + (b - a) * (k + 0.5) / _SUBSTEPS)
            s += dt * speed
            if abs(s) >= h:
                s, speed = np.copysign(h, s), 0.0
    return lags
