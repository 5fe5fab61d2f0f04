"""Friction of joints, and of actuators that move two joints."""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import (
    Array,
    Effect,
    FileTerm,
    JointEffect,
    JointMotion,
    JointPairEffect,
    Parameter,
    Proposer,
    RobotMotion,
    Rows,
    Shape,
)
from geodrake.effects.gradient import RobotGradient, sign_slope
from geodrake.effects.sensors import EffortOffset
from geodrake.errors import ArgumentError


@dataclass(frozen=True)
class ViscousFriction(JointEffect):
    """Viscous friction of a joint ([Lee2019] Eq. (5.2.2)).

    effort = c v, with c ≥ 0 in N·m·s/rad.
    """

    name = "viscous_friction"
    file_term = FileTerm("damping", joint="damping", servo="damping")
    taken_out_as = "friction"
    law = "c v"
    complexity = 0
    parameters = (Parameter("viscous", "N·m·s/rad", lower=0.0),)
    signature = "grows in proportion to the joint's speed and changes sign with it"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[v]."""
        return [joint.v]


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Dry friction of a joint ([Lee2019] Eq. (5.2.2)).

    effort = F sgn v, with F ≥ 0 in N·m.
    """

    name = "coulomb_friction"
    file_term = FileTerm("dry friction", joint="friction", servo="coulomb")
    taken_out_as = "friction"
    law = "F sgn v, smoothed below a speed that `explain` finds where it matters"
    complexity = 0
    companion = ViscousFriction
    jumps = True
    parameters = (Parameter("coulomb", "N·m", lower=0.0),)
    signature = "a step of constant height wherever the joint reverses"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[sgn v]."""
        return [joint.sign_v]


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """Dry and viscous friction that differ between the directions.

    effort = F₊ + c₊ v where v > 0, and −F₋ + c₋ v where v < 0; F in N·m, c in N·m·s/rad, all ≥ 0.

    It contains Coulomb and viscous friction (F₊ = F₋, c₊ = c₋), and so replaces that pair. It
    always dissipates: it is zero at rest, and effort · v ≥ 0.
    """

    name = "asymmetric_friction"
    taken_out_as = "friction"
    law = "F₊, F₋, c₊, c₋ by direction"
    complexity = 1
    contains = (CoulombFriction, ViscousFriction, EffortOffset)
    jumps = True
    parameters = (
        Parameter("coulomb_positive", "N·m", lower=0.0),
        Parameter("coulomb_negative", "N·m", lower=0.0),
        Parameter("viscous_positive", "N·m·s/rad", lower=0.0),
        Parameter("viscous_negative", "N·m·s/rad", lower=0.0),
    )
    signature = "a step at reversals, and slopes or heights that differ between the directions"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[max(sgn v, 0), min(sgn v, 0), max(v, 0), min(v, 0)]."""
        s, v = joint.sign_v, joint.v
        return [np.maximum(s, 0.0), np.minimum(s, 0.0), np.maximum(v, 0.0), np.minimum(v, 0.0)]


@dataclass(frozen=True)
class FrictionOvercompensation(JointEffect):
    """Excess of a drive's friction compensation over the actual dry friction.

    effort = −F sgn v, with F ≥ 0 in N·m.

    Drives may compensate dry friction by an effort that logs do not contain. If it exceeds the
    friction, the logged effort is reduced in the direction of motion. The drive then pushes the
    joint, which can make it oscillate under a weak controller. It is no friction of the robot.
    """

    name = "friction_overcompensation"
    of_motor = True
    taken_out_as = "friction"
    law = "−F sgn v: the drive compensates more dry friction than exists"
    complexity = 1
    contains = (CoulombFriction, AsymmetricFriction)
    jumps = True
    by_drive = True
    parameters = (Parameter("excess", "N·m", lower=0.0),)
    signature = "a step of constant height wherever the joint reverses, along the motion"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[−sgn v]."""
        return [-joint.sign_v]


_SHARES = tuple(np.geomspace(0.01, 0.3, 4).tolist())  # of the peak speed


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """Additional dry friction at low speed.

    effort = (S − F) exp(−|v / v_s|^α) sgn v, with the excess S − F ≥ 0 in N·m.

    It adds to `coulomb_friction`, which contributes F to the Stribeck curve
    (F + (S − F) exp(−|v / v_s|^α)) sgn v, and to `viscous_friction`.

    Attributes:
        stribeck_velocity: v_s, rad/s or m/s.
        exponent: α; 1 (Tustin) and 2 (Gaussian) are usual.
    """

    stribeck_velocity: float
    exponent: float = 1.0

    name = "stribeck_friction"
    taken_out_as = "friction"
    law = "(S − F) exp(−|v/v_s|^α) sgn v, on top of Coulomb friction"
    jumps = True
    shapes = (
        Shape("stribeck_velocity", "rad/s", grid=_SHARES, scale="speed"),
        Shape("exponent", grid=(1.0, 2.0)),
    )
    parameters = (Parameter("excess", "N·m", lower=0.0),)
    signature = "extra friction near reversals that fades as the joint speeds up"
    depends_on = frozenset({"v"})
    positive = ("stribeck_velocity", "exponent")
    refines = ((CoulombFriction,), (CoulombFriction, ViscousFriction))

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[exp(−|v / v_s|^α) sgn v]."""
        fading = np.exp(-(np.abs(joint.v / self.stribeck_velocity) ** self.exponent))
        return [fading * joint.sign_v]


_LEAST_RATIO = 1.25  # of the exponent to 1, that of viscous friction, or the inverse


@dataclass(frozen=True)
class NonlinearViscousFriction(JointEffect):
    """Friction that grows with a power of speed: lubricants (α < 1), drag (α = 2).

    effort = c |v|^α sgn v, with c ≥ 0 in N·m·(s/rad)^α.
    """

    exponent: float

    name = "nonlinear_viscous_friction"
    file_term = FileTerm("damping of the power {exponent:g}")
    taken_out_as = "friction"
    law = "c |v|^α sgn v"
    shapes = (Shape("exponent", grid=(0.5, 1.5, 2.0, 3.0)),)
    parameters = (Parameter("viscous", "N·m·(s/rad)^α", lower=0.0),)
    signature = "follows the joint's speed along a curve and changes sign with it"
    depends_on = frozenset({"v"})
    positive = ("exponent",)

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[|v|^α sgn v]."""
        return [np.abs(joint.v) ** self.exponent * joint.sign_v]

    @property
    def distinct(self) -> bool:
        """Whether the exponent is far enough from 1, viscous friction."""
        return bool(abs(np.log(self.exponent)) >= np.log(_LEAST_RATIO))

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """Dry and viscous friction if α < 1; otherwise nothing."""
        return ((CoulombFriction, ViscousFriction),) if self.exponent < 1.0 else ()


@dataclass(frozen=True)
class LoadDependentFriction(JointEffect):
    """Dry friction proportional to the effort that the gear transmits.

    effort = k |τ_model| sgn v, with k ≥ 0, dimensionless.

    τ_model is the effort of the rigid-body model. Noise and friction in the measured effort would
    bias k.
    """

    name = "load_dependent_friction"
    of_motor = True
    taken_out_as = "friction"
    label = "load-dependent friction"
    law = "k |τ_model| sgn v"
    complexity = 1
    jumps = True
    parameters = (Parameter("load_factor", "1", lower=0.0),)
    signature = "a step at reversals whose height grows with the load on the joint"
    depends_on = frozenset({"v", "load"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[|τ_model| sgn v]."""
        return [np.abs(joint.load) * joint.sign_v]


@dataclass(frozen=True)
class GearEfficiency(JointEffect):
    """Gear losses proportional to the load, different for driving and braking.

    effort = k_d |τ_model| sgn v where τ_model v > 0, and k_b |τ_model| sgn v elsewhere; both ≥ 0
    and dimensionless. The efficiency is 1 / (1 + k_d) if the motor drives the load, and 1 − k_b if
    the load drives the motor.

    It contains load-dependent friction (k_d = k_b). At a moving joint the two differ by
    ½ (k_d − k_b) τ_model, like bodies that are heavier by that share. As with `effort_scale`, it
    can be identified only with independently known inertias. A diagnosis tries it only then.
    """

    name = "gear_efficiency"
    of_motor = True
    taken_out_as = "friction"
    label = "efficiency of a gear"
    law = (
        "k |τ_model| sgn v, with separate k for driving and braking; needs trusted inertia, "
        "a known payload in one log, or known ground forces"
    )
    contains = (LoadDependentFriction,)
    jumps = True
    parameters = (
        Parameter("driving_loss", "1", lower=0.0),
        Parameter("braking_loss", "1", lower=0.0),
    )
    signature = "a step at reversals that grows with the load, more where the joint drives"
    depends_on = frozenset({"v", "load"})
    needs_known_inertia = True
    refines = ((LoadDependentFriction,),)

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[|τ_model| sgn v where τ_model v > 0, and elsewhere]."""
        forward, backward = np.maximum(joint.sign_v, 0.0), np.minimum(joint.sign_v, 0.0)
        positive, negative = np.maximum(joint.load, 0.0), np.maximum(-joint.load, 0.0)
        return [
            positive * forward + negative * backward,
            positive * backward + negative * forward,
        ]


Direction = Callable[[Array], Array]
"""Smoothed sign of a speed."""


@dataclass(frozen=True)
class SharedActuatorEffect(JointPairEffect):
    """An effect of an actuator that turns with vᵢ + s vⱼ. Subclasses define `shared` and `rows`.

    A diagnosis tries it at adjacent joints, and at other pairs whose residuals both correlate with
    the motion of one actuator, beyond their correlation with the joint's own motion.
    """

    proposer = Proposer.SHARED_ACTUATOR

    @staticmethod
    @abc.abstractmethod
    def shared(v: Array, turned_v: Array, turned_vd: Array, direction: Direction) -> Array:
        """Return columns (..., k) at a joint; their parameters are ≥ 0 for the correct sign s.

        Args:
            v: (...) velocity of the joint.
            turned_v: (...) signed velocity s vⱼ of the other joint.
            turned_vd: (...) signed acceleration s v̇ⱼ of the other joint.
        """


@dataclass(frozen=True)
class CoupledFriction(SharedActuatorEffect):
    """Friction of an actuator whose speed is w = vᵢ + s vⱼ, as in a coupled wrist.

    effort of joint i = F sgn w + c w, and s times that at joint j, so that the power is
    (F sgn w + c w) w; F ≥ 0 in N·m and c ≥ 0 in N·m·s/rad.

    Attributes:
        joints: The joints i and j.
        sign: s, 1 or −1. Describe other ratios by a transmission.
    """

    sign: int = 1

    name = "coupled_friction"
    file_term = FileTerm("dry friction of tendons")
    of_motor = True
    taken_out_as = "friction"
    law = (
        "friction of an actuator with velocity v_i ± v_j; between joints that are not "
        "neighbours, found in the residual"
    )
    complexity = 1
    shapes = (Shape("sign", grid=(1, -1)),)
    jumps = True
    parameters = (
        Parameter("coulomb", "N·m", lower=0.0),
        Parameter("viscous", "N·m·s/rad", lower=0.0),
    )
    signature = "steps at both joints at once, where the sum or difference of their speeds reverses"
    depends_on = frozenset({"v"})

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sign not in (-1, 1):
            raise ArgumentError(f"{self.name} needs the sign 1 or −1; it got {self.sign}.")

    def rows(self, motion: RobotMotion) -> Rows:
        """[sgn w, w] at joint i and s [sgn w, w] at joint j."""
        i, j = map(motion.index, self.joints)
        w = motion.v[:, i] + self.sign * motion.v[:, j]
        width = np.hypot(motion.sign_width[i], motion.sign_width[j])
        columns = np.stack([motion.direction(w, width), w], -1)
        return {self.joints[0]: columns, self.joints[1]: self.sign * columns}

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient:
        """Return the gradient; both joints' speeds enter through w."""
        i, j = map(motion.index, self.joints)
        w = motion.v[:, i] + self.sign * motion.v[:, j]
        width = np.hypot(motion.sign_width[i], motion.sign_width[j])
        total = weights[:, i] + self.sign * weights[:, j]
        by_w = total[:, 0] * sign_slope(motion.direction(w, width), width) + total[:, 1]
        gradient = RobotGradient.zero(motion)
        gradient.v[:, i], gradient.v[:, j] = by_w, self.sign * by_w
        return gradient

    @staticmethod
    def shared(v: Array, turned_v: Array, turned_vd: Array, direction: Direction) -> Array:
        """[sgn w, w] with w = v + s vⱼ, for either joint; s is factored out at joint j."""
        del turned_vd
        w = v + turned_v
        return np.stack([direction(w), w], -1)


@dataclass(frozen=True)
class FrictionDrift(JointEffect):
    """Additional dry and viscous friction at the start of a log, which decays.

    effort = e^{−t/T} (F sgn v + c v), with F in N·m and c in N·m·s/rad, t s after the log began.

    It adds to `coulomb_friction` and `viscous_friction`, which describe the steady state. F and c
    are positive if grease warms up, but may have either sign. Without time it is zero.

    Attributes:
        time_constant: T, s.
    """

    time_constant: float

    name = "friction_drift"
    taken_out_as = "friction"
    law = "e^(−t/T) (F sgn v + c v): additional friction of a gear until it is warm"
    proposer = Proposer.WARMING
    shapes = (
        Shape("time_constant", "s", grid=(0.1, 0.3, 1.0, 3.0), scale="duration", usual=300.0),
    )
    parameters = (Parameter("coulomb_change", "N·m"), Parameter("viscous_change", "N·m·s/rad"))
    signature = "friction that changes between the start and the end of a log"
    depends_on = frozenset({"v", "time"})
    positive = ("time_constant",)
    refines = ((CoulombFriction,), (ViscousFriction,), ())

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Return zeros, the steady state."""
        return [np.zeros_like(joint.v), np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Rows:
        """Return e^{−t/T} [sgn v, v]."""
        if motion.time is None:
            return super().rows(motion)
        joint = motion.joint(self.joint)
        decay = self.course(motion.time)
        return {self.joint: decay[:, None] * np.stack([joint.sign_v, joint.v], -1)}

    def course(self, along: Array) -> Array:
        """Return the decay e^{−t/T} at times (N,) since the log began, s."""
        return np.exp(-along / self.time_constant)


@dataclass(frozen=True)
class ThermalFriction(JointEffect):
    """Change of dry and viscous friction with the temperature of a joint.

    effort = (T − T₀) (F sgn v + c v), with F in N·m/°C and c in N·m·s/(rad·°C), at T °C.

    It adds to `coulomb_friction` and `viscous_friction`, which have the values at T₀. F and c are
    negative if grease thins, but may have either sign. Unknown temperatures are taken to be T₀. For
    logs without temperatures, `friction_drift` varies with time instead.

    Attributes:
        reference: T₀, °C; a diagnosis takes the mean of the logs.
    """

    reference: float

    name = "thermal_friction"
    taken_out_as = "friction"
    law = "(T − T₀) (F sgn v + c v), where the log has the joint's temperature T"
    shapes = (Shape("reference", "°C", grid=(1.0,), scale="temperature", usual=25.0),)
    parameters = (
        Parameter("coulomb_slope", "N·m/°C"),
        Parameter("viscous_slope", "N·m·s/(rad·°C)"),
    )
    signature = "friction that varies with the logged temperature of the joint"
    depends_on = frozenset({"v", "temperature"})
    free_shapes = 0  # another T₀ only changes the other friction effects
    refines = ((CoulombFriction,), (ViscousFriction,))

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Return zeros, as at T₀."""
        return [np.zeros_like(joint.v), np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Rows:
        """Return (T − T₀) [sgn v, v]; zero if T is unknown."""
        if motion.temperature is None:
            return super().rows(motion)
        joint, warmer = motion.joint(self.joint), motion.warmer(self.joint, self.reference)
        return {self.joint: warmer[:, None] * np.stack([joint.sign_v, joint.v], -1)}


@dataclass(frozen=True)
class Hysteresis(JointEffect):
    """Dahl friction: dry friction that depends on the distance since the last reversal.

    effort = F z, with F ≥ 0 in N·m and the bristle deflection z in [−1, 1]:

        ż = (v − |v| z) / θ,

    After a reversal z goes from −sgn v to sgn v as 1 − 2 e^{−Δq/θ}. At rest it acts as a spring of
    stiffness F/θ. LuGre friction is this effect together with `viscous_friction` for its damping
    and `stribeck_friction` for its dependence on speed.

    The initial z of a log is unknown. It is taken as sgn v for a moving joint and 0 for a joint at
    rest; the error vanishes after a few θ. Samples that are not a time series have z = sgn v.

    Attributes:
        breakaway_angle: θ, rad or m.
    """

    breakaway_angle: float

    name = "hysteresis"
    law = "F z with Dahl's bristles z, ż = (v − |v| z) / θ"
    proposer = Proposer.BRISTLES
    shapes = (
        Shape(
            "breakaway_angle", "rad", grid=(0.003, 0.01, 0.03, 0.1, 0.3), scale="reach", usual=0.02
        ),
    )
    parameters = (Parameter("coulomb", "N·m", lower=0.0),)
    signature = "dry friction that builds up over an angle after a reversal"
    depends_on = frozenset({"q", "v", "history"})
    state_count = 1
    positive = ("breakaway_angle",)

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[sgn v], the limit long after a reversal."""
        return [joint.sign_v]

    def rows(self, motion: RobotMotion) -> Rows:
        """[z]."""
        if self in motion.states:
            return {self.joint: motion.states[self]}
        if motion.before is None:
            return super().rows(motion)
        return {self.joint: self.states_along(motion)}

    def states_along(self, motion: RobotMotion) -> Array:
        """Return the bristle deflection z (N, 1) along the motion and its history."""
        i = motion.index(self.joint)
        before = motion.q[:0] if motion.before is None else motion.before
        q = np.concatenate([before[:, i], motion.q[:, i]])
        start = 0.0
        if motion.time is not None and len(motion.time) > 1 and len(q) > 1:
            speed = (q[1] - q[0]) / (motion.time[1] - motion.time[0])
            start = float(motion.direction(speed, motion.sign_width[i]))
        return self.bend(q, start)[len(before) :, None]

    def state_rates(self, motion: RobotMotion, state: Array) -> Array:
        """Return ż, (N, 1)."""
        v = motion.v[:, motion.index(self.joint), None]
        return np.asarray((v - np.abs(v) * state) / self.breakaway_angle)

    def bend(self, q: Array, start: float = 0.0) -> Array:
        """Return the bristle deflection z (N,) along positions (N,), exact between reversals."""
        step = np.diff(q, prepend=q[:1])
        decay = np.exp(-np.abs(step) / self.breakaway_angle)
        z = np.sign(step) * (1.0 - decay)
        z[:1] = start
        # z_k = decay_k z_{k−1} + z_k for all k, by composing the maps pairwise log₂ N times.
        stride = 1
        while stride < len(z):
            z[stride:] = decay[stride:] * z[:-stride] + z[stride:]
            decay[stride:] = decay[stride:] * decay[:-stride]
            stride *= 2
        return z

    def course(self, along: Array) -> Array:
        """Return the bristle deflection z along positions (N,), starting at 0."""
        return self.bend(along)
