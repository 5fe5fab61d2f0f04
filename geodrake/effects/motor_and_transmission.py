"""Springs across joints, and effects of motors and gears: ripple, rotors, elasticity, backlash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from geodrake.compiling import compiled, contiguous
from geodrake.effects.base import (
    Array,
    FileTerm,
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

    The preload p is the effort at q_c. It is a linear parameter that replaces the rest position q₀:
    p = k (q_c − q₀) for a linear spring k (q − q₀). A hardening spring k (q − q₀) + k₃ (q − q₀)³ is
    the sum of a linear and a cubic one with q_c = q₀.

    Attributes:
        exponent: n, 1 or 3.
        center: q_c, rad or m. For n = 1 it changes only p; near the middle of the motion it
            decorrelates k and p.
    """

    exponent: int = 1
    center: float = 0.0

    name = "joint_spring"
    file_term = FileTerm("spring", joint="stiffness")
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

    It exists at revolute joints only. Unlike the weight of a link, it depends only on its own joint
    and has no inertia.
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
    """Effort that is periodic in the joint's position: cogging, commutation, gear teeth.

    effort = a cos nq + b sin nq, with a and b in N·m.

    Attributes:
        order: n, waves per turn (at a prismatic joint, a wave has length 2π/n m). Behind a gear it
            is not an integer. A diagnosis finds it in the residual's spectrum over position.
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
    file_term = FileTerm("reflected rotor inertia", joint="armature", servo="armature")
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
    symmetric pair of entries of the mass matrix. I is in kg·m², and negative if the rotor turns
    with the difference. The diagonal entries of the same rotor are `rotor_inertia` of both joints,
    so |I| ≤ √(Iᵢ Iⱼ).
    """

    name = "coupled_rotor_inertia"
    file_term = FileTerm("rotor inertia of tendons")
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
        """Return the gradient; each column depends on the other joint's v̇."""
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

    The link is at q − τ_j/k, with τ_j the effort that the rigid bodies need at the joint. The
    effort is that of the link's motion to first order in c, which is accurate below the resonance
    of link and spring. Friction and rotor inertia belong to the motor and do not change. Rates of
    τ_j are taken along the log; without a time series the deflection is static.

    A simulation has motor and link as two bodies with a spring, valid at any frequency.

    Attributes:
        damping: Damping ratio of that spring; None for the default. Rollouts determine it; efforts
            do not.
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
    free_shapes = 0  # efforts do not depend on the damping

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.damping is not None and self.damping < 0.0:
            raise ArgumentError(f"damping of {self.name} must not be negative; got {self.damping}.")

    def deflection(self, motion: RobotMotion) -> Deflection:
        """Return the load of the joint, the deflection of a spring of unit stiffness."""
        loads = motion.once((Deflection, ""), lambda: Deflection.along(motion.load, motion.time))
        return loads.of(motion.index(self.joint))

    def give(self, parameters: Array) -> Give:
        """Return a spring with the fitted compliance."""
        return Give(compliance=max(parameters[0], 0.0), damping=self.damping)

    def rollout_values(self, parameters: Array) -> Values:
        """Return the positive ones of compliance and damping; empty for a rigid joint."""
        if not parameters[0] > 0.0:
            return {}
        damping = SPRING_DAMPING if self.damping is None else self.damping
        return {
            "compliance": float(parameters[0]),
            **({"damping": damping} if damping > 0.0 else {}),
        }

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return the spring with new compliance and damping."""
        effect = replace(self, damping=values.get("damping", self.damping))
        return FittedEffect(
            effect, np.array([values["compliance"]]), np.array([deviations["compliance"]])
        )


_SUBSTEPS = 4
_LOAD_BANDWIDTH = 0.5  # of the bandwidth; load changes above it are attributed to noise
_SIGNIFICANCE = 2.0  # standard deviations of the load noise, below which its sign is unknown


@dataclass(frozen=True)
class Backlash(DeflectionEffect):
    """Dead band between a motor, whose position is measured, and its link.

    effort = −g (∂τ/∂q s + ∂τ/∂v ṡ + M s̈), with the lag s(t) of the link; g = 1 if the shape has
    the true gap width. A small share g of a wide gap is not backlash: noise of accelerations looks
    like it if loads are small.

    The load pushes the link to one side of the gap, s = ±h. When the load τ_j changes sign, the
    link comes loose, moves freely with M_jj s̈ = τ_j, and hits the other side, where it stays. The
    motor thus has no load for a moment, followed by an impact. Loads within the noise of the
    accelerations do not loosen the link. Without a time series, s = h sgn τ_j.

    A simulation has motor and link as two bodies, between stiff and damped stops.

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
        """Return the lag of the link, at a side of the gap or loose between both."""
        load, time = motion.load[:, motion.index(self.joint)], motion.time
        if time is None or len(time) < 3:
            return Deflection.along(self.half_width * np.sign(load), time)
        period = motion.once((Backlash, ""), lambda: float(np.median(np.diff(time))))
        key = Backlash, self.joint
        load, threshold = motion.once(key, lambda: self._loosening(motion, period))
        lag = link_lag(self.half_width, load, time, threshold)
        bend = np.diff(lag, 2, prepend=lag[:1], append=lag[-1:])
        return Deflection(lag, np.gradient(lag, period), bend / period**2)

    def _loosening(self, motion: RobotMotion, period: float) -> tuple[Array, Array]:
        """Return the loose link's accelerations (N,), and the thresholds (N,) for coming loose.

        They do not depend on the gap width.
        """
        i = motion.index(self.joint)
        load, inertias = motion.load[:, i], motion.effort_slopes.acceleration[:, i]  # (N, nv)
        variance = np.square(np.broadcast_to(motion.acceleration_noise, inertias.shape[1]))
        finite = np.nan_to_num(inertias)  # NaN at joints of several degrees of freedom
        noise = np.sqrt(np.square(finite) @ variance)
        bandwidth = _LOAD_BANDWIDTH * motion.bandwidth
        if bandwidth * period < HIGHEST_BANDWIDTH:
            load = design_filter(period, bandwidth).smooth(load)
        inertia = np.maximum(inertias[:, i], 1e-9)
        return load / inertia, _SIGNIFICANCE * noise / inertia

    def give(self, parameters: Array) -> Give:
        """Return a dead band of half width g h."""
        return Give(play=max(parameters[0], 0.0) * self.half_width)

    def rollout_values(self, parameters: Array) -> Values:
        """Return the half width of the gap, if positive."""
        width = float(parameters[0]) * self.half_width
        return {"half_width": width} if width > 0.0 else {}

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return the backlash with a new half width of the gap."""
        width = values["half_width"]
        deviation = np.array([deviations["half_width"] / width])
        return FittedEffect(replace(self, half_width=width), np.ones(1), deviation)


def link_lag(h: float, acceleration: Array, time: Array, threshold: ArrayLike = 0.0) -> Array:
    """Return the lag (N,) within ±h of a link at times (N,), s.

    A loose link moves relative to its motor with accelerations (N,) τ_j / M_jj, rad/s². It comes
    loose only where their magnitude reaches the threshold, rad/s², scalar or (N,).
    """
    thresholds = np.broadcast_to(threshold, len(acceleration))
    return np.asarray(_lag(h, *map(contiguous, (acceleration, thresholds, time))))


@compiled
def _lag(h: float, acceleration: Array, threshold: Array, time: Array) -> Array:
    """Return the lag (N,) within ±h of a link; see `link_lag`."""
    lags = np.empty(len(acceleration))
    s, speed, last = np.copysign(h, acceleration[0]), 0.0, len(acceleration) - 1
    for i in range(len(acceleration)):
        a, b = acceleration[i], acceleration[min(i + 1, last)]
        dt = (time[min(i + 1, last)] - time[i]) / _SUBSTEPS
        lags[i] = s
        if abs(s) == h and (abs(a) < threshold[i] or (a * s > 0.0 and b * s > 0.0)):
            continue  # the link stays at its side
        for k in range(_SUBSTEPS):
            speed += dt * (a + (b - a) * (k + 0.5) / _SUBSTEPS)
            s += dt * speed
            if abs(s) >= h:
                s, speed = np.copysign(h, s), 0.0
    return lags
