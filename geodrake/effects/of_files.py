"""Effects from model files and servo fits, which no diagnosis proposes."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from geodrake.effects.base import (
    Array,
    BodyEffect,
    Effect,
    FileTerm,
    FittedEffect,
    JointEffect,
    JointMotion,
    JointPairEffect,
    Parameter,
    RobotMotion,
    Rows,
    Shape,
)
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.gradient import RobotGradient
from geodrake.errors import ArgumentError
from geodrake.manifolds import Interval
from geodrake.robot.files.checks import ADDED_MASS, added_mass_matrix, rotation


class _FileEffect:
    """An effect from a model file, without fitted shape parameters."""

    free_shapes = 0


@dataclass(frozen=True)
class _Numbered(_FileEffect, Effect):
    """An effect whose shape is a list of numbers, which results do not report.

    Its `shape` has those other than 0 by name.
    """

    numbers: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.numbers) != (count := len(self.names_of(self.where))):
            raise ArgumentError(
                f"{self.name} of {self.place} needs {count} numbers; it got {len(self.numbers)}."
            )

    @classmethod
    @abc.abstractmethod
    def names_of(cls, where: Sequence[str]) -> list[str]:
        """Return the names of the numbers of an effect at a place."""

    @property
    def shape(self) -> dict[str, Any]:
        """Return the numbers other than 0 by name."""
        names = self.names_of(self.where)
        return {name: x for name, x in zip(names, self.numbers, strict=True) if x}

    @property
    def reported_shape(self) -> dict[str, float]:
        """Empty: the numbers are those of the file."""
        return {}

    @classmethod
    def fields_of(cls, where: Sequence[str], shape: Mapping[str, Any]) -> dict[str, Any]:
        """Return the numbers for a shape as in `shape`."""
        names = cls.names_of(where)
        if unknown := sorted(shape.keys() - {*names}):
            raise ArgumentError(f"{cls.name} has no shape parameter {unknown[0]!r}.")
        return {"numbers": tuple(float(shape.get(name, 0.0)) for name in names)}


@dataclass(frozen=True)
class PolynomialSpring(_FileEffect, JointEffect):
    """Spring across a joint as defined by MuJoCo: effort = p + k₁ x + k₂ x² + k₃ x³, x = q − q_c.

    Unlike those of `joint_spring`, the coefficients may have either sign.
    """

    center: float = 0.0  # q_c, rad or m

    name = "polynomial_spring"
    file_term = FileTerm("spring")
    law = "p + k₁ x + k₂ x² + k₃ x³, x = q − q_c"
    complexity = 3
    shapes = (Shape("center", "rad"),)
    parameters = (
        Parameter("preload", "N·m"),
        Parameter("stiffness", "N·m/rad"),
        Parameter("stiffness_2", "N·m/rad²"),
        Parameter("stiffness_3", "N·m/rad³"),
    )
    signature = "follows the joint's position, whatever its speed"
    depends_on = frozenset({"q"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[1, x, x², x³]."""
        x = joint.q - self.center
        return [np.ones_like(x), x, x**2, x**3]


BRAKING_SHARE = 0.45
"""k · braking_load of a fitted gear: friction grows by at most 0.9 times the load."""


@dataclass(frozen=True)
class SquaredLoadFriction(_FileEffect, JointEffect):
    """Dry friction that grows with the square of a gear's load, as in hobby servos.

    effort = k l² sgn v, with k ≥ 0 in 1/(N·m), and l = τ_model, the effort that the bodies need. If
    the bodies drive the gear (τ_model v < 0), |l| is limited to `braking_load`.

    The term is that of model M6 in M. Duclusaud et al., Extended Friction Models for the Physics
    Simulation of Servo Actuators (2024). Without the limit a braking gear would lock: friction
    decelerates the bodies, which increases the load and thus the friction. With
    k · braking_load < 1/2 friction grows more slowly than the load, so the acceleration is unique.
    """

    braking_load: float  # N·m or N

    name = "squared_load_friction"
    file_term = FileTerm(servo="load")
    of_motor = True
    taken_out_as = "friction"
    label = "squared-load friction"
    law = "k τ_model² sgn v, with |τ_model| bounded where the bodies drive the gear"
    complexity = 1
    jumps = True
    shapes = (Shape("braking_load", "N·m"),)
    parameters = (Parameter("squared_load_factor", "1/(N·m)", lower=0.0),)
    signature = "a step at reversals whose height grows with the square of the load on the joint"
    depends_on = frozenset({"v", "load"})
    positive = ("braking_load",)

    @classmethod
    def fitted(cls, joint: str, value: float, deviation: float) -> FittedEffect:
        """Return the effect for a factor k and its standard deviation, 1/(N·m)."""
        effect = cls(joint, BRAKING_SHARE / value)
        return FittedEffect(effect, np.array([value]), np.array([deviation]))

    @property
    def manifold(self) -> Interval:
        """Interval of k for which the load can drive the gear without locking it."""
        return Interval((0.0,), (0.5 / self.braking_load,))

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[l² sgn v]."""
        along = np.maximum(joint.load * np.sign(joint.sign_v), -self.braking_load)
        return [np.square(along) * joint.sign_v]


@dataclass(frozen=True)
class JointCoupling(JointPairEffect):
    """Coupling of two joints by a tendon with stiffness and damping, of length cᵢ qᵢ + cⱼ qⱼ.

    effort of joint i = k qⱼ + d vⱼ and effort of joint j = k qᵢ + d vᵢ, from the energy k qᵢ qⱼ,
    where k is cᵢ cⱼ times the stiffness of the tendon, and d likewise. Its diagonal terms are
    `joint_spring` and `viscous_friction` of each joint. A tendon over more joints has a coupling
    for each pair.
    """

    name = "joint_coupling"
    file_term = FileTerm("coupling by tendons")
    law = "k q_j + d v_j on joint i, and k q_i + d v_i on joint j"
    complexity = 3
    parameters = (Parameter("stiffness", "N·m/rad"), Parameter("damping", "N·m·s/rad"))
    signature = "at each of two joints, follows the position and the speed of the other one"
    depends_on = frozenset({"q", "v"})

    def rows(self, motion: RobotMotion) -> Rows:
        """[qⱼ, vⱼ] at joint i and [qᵢ, vᵢ] at joint j."""
        i, j = map(motion.joint, self.joints)
        return motion.at_both(self.joints, *(np.stack([x.q, x.v], -1) for x in (j, i)))

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Return the gradient; each joint's columns depend on q and v of the other joint."""
        if not set(motion.joints).issuperset(self.joints):
            return None
        gradient = RobotGradient.zero(motion)
        i, j = map(motion.index, self.joints)
        for joint, other in ((i, j), (j, i)):
            gradient.q[:, other] = weights[:, joint, 0]
            gradient.v[:, other] = weights[:, joint, 1]
        return gradient


@dataclass(frozen=True)
class _FluidForces(_FileEffect, BodyEffect):
    """Forces of air or water on a body moving at v and ω relative to it, in axes at P.

    With force f and moment g, effort = −J_Pᵀ f − J_ωᵀ g. Subclasses define `resistance`.
    """

    size_x: float = 1.0  # m; y and z follow
    size_y: float = 1.0
    size_z: float = 1.0
    x: float = 0.0  # position of P from Bo along x of the body's frame, m; y and z follow
    y: float = 0.0
    z: float = 0.0
    # Real part of the quaternion of the axes in the body's frame; its vector follows.
    turn_w: float = 1.0
    turn_x: float = 0.0
    turn_y: float = 0.0
    turn_z: float = 0.0
    wind_x: float = 0.0  # velocity of the medium along x of the world, m/s; y and z follow
    wind_y: float = 0.0
    wind_z: float = 0.0

    complexity = 3
    shapes = (
        *(Shape(name, "m") for name in ("size_x", "size_y", "size_z", "x", "y", "z")),
        *(Shape(f"turn_{axis}") for axis in "wxyz"),
        *(Shape(name, "m/s") for name in ("wind_x", "wind_y", "wind_z")),
    )
    parameters = (
        Parameter("density", "kg/m³", lower=0.0),
        Parameter("viscosity", "Pa·s", lower=0.0),
    )
    signature = "grows with a body's speed and its square, at all joints up to it"
    depends_on = frozenset({"q", "v", "bodies"})

    @property
    def reported_shape(self) -> dict[str, float]:
        """Empty: the shape is that of the file."""
        return {}

    @property
    def size(self) -> Array:
        """(3,) sizes along the axes, m."""
        return np.array([self.size_x, self.size_y, self.size_z])

    @abc.abstractmethod
    def resistance(self, v: Array, w: Array) -> tuple[Array, Array]:
        """Return −f/ρ and −f/β, and −g/ρ and −g/β (N, 3, 2), at v and ω (N, 3)."""

    def rows(self, motion: RobotMotion) -> Rows:
        """Return columns of density and viscosity at the joints that move the body."""
        body = motion.body_motions(self.name).motion(self.body)
        J = body.jacobian_at(np.array([self.x, self.y, self.z]))
        turn = np.array([self.turn_w, self.turn_x, self.turn_y, self.turn_z])
        axes = np.moveaxis(body.rotation @ rotation(turn), 1, 2)
        speed = motion.v[..., None]
        wind = np.array([self.wind_x, self.wind_y, self.wind_z])
        v, w = axes @ ((J @ speed)[..., 0] - wind)[..., None], axes @ (body.angular @ speed)
        force, moment = self.resistance(v[..., 0], w[..., 0])
        along = np.moveaxis(axes @ J, 1, 2) @ force
        columns = along + np.moveaxis(axes @ body.angular, 1, 2) @ moment
        return {motion.joints[dof]: columns[:, dof] for dof in body.dofs}


@dataclass(frozen=True)
class MediumDrag(_FluidForces):
    """Drag of air or water on a body approximated by its inertia box (MuJoCo, "Fluid").

    In a medium of density ρ and viscosity β, with sizes b of the box and d = (b₁ + b₂ + b₃)/3,

        fᵢ = −½ ρ bⱼ bₖ |vᵢ| vᵢ − 3 π β d vᵢ
        gᵢ = −ρ bᵢ (bⱼ⁴ + bₖ⁴)/64 |ωᵢ| ωᵢ − π β d³ ωᵢ
    """

    name = "medium_drag"
    file_term = FileTerm("medium")
    law = "drag of a medium on a box: ρ of the squares of v and ω, β of v and ω"

    def resistance(self, v: Array, w: Array) -> tuple[Array, Array]:
        """Return the coefficients of ρ and β in force and moment."""
        b = self.size
        d, (j, k) = b.mean(), (np.roll(b, -1), np.roll(b, -2))
        force = 0.5 * j * k * np.abs(v) * v, 3.0 * np.pi * d * v
        moment = b * (j**4 + k**4) / 64.0 * np.abs(w) * w, np.pi * d**3 * w
        return np.stack(force, -1), np.stack(moment, -1)


_LEAST = 1e-15  # as in MuJoCo
_NEVER = 1e100  # m, length of a way on the wrong side


@dataclass(frozen=True)
class EllipsoidDrag(_FluidForces):
    """Forces of air or water on an ellipsoid (MuJoCo, "Fluid", ellipsoid model).

    With the semi-axes r, their products q = (r₂r₃, r₃r₁, r₁r₂), volume V, D = ⅔ (r₁ + r₂ + r₃), the
    area A projected along v, its maximum A₊, and the coefficients c of the file,

        f = ρ [−|v| (c_b A + c_s (A₊ − A)) v + c_k A cos α (q²v × v) × v + c_m V ω × v + m v × ω]
            − 3 π β D v
        g = ρ [−|c_a I ω + c_s (I₊ − I) ω| ω + m v × v + j ω × ω] − π β D³ ω

    with cos α = |q v|² / (|v| |q² v|²), A = π |q² v| / |q v|, virtual masses m and inertias j, and
    Iᵢ = 8/15 π rᵢ max(rⱼ, rₖ)⁴ with the maximum I₊.
    """

    blunt: float = 0.5  # c_b; c_s, c_a, c_k and c_m follow
    slender: float = 0.25
    angular: float = 1.5
    kutta: float = 1.0
    magnus: float = 1.0
    mass_x: float = 0.0  # m₁, m³; m₂ and m₃ follow
    mass_y: float = 0.0
    mass_z: float = 0.0
    inertia_x: float = 0.0  # j₁, m⁵; j₂ and j₃ follow
    inertia_y: float = 0.0
    inertia_z: float = 0.0

    name = "ellipsoid_drag"
    file_term = FileTerm("medium of ellipsoids")
    law = "drag, lift and added mass of an ellipsoid: ρ of squares of v and ω, β of v and ω"
    shapes = (
        *_FluidForces.shapes,
        *(Shape(name) for name in ("blunt", "slender", "angular", "kutta", "magnus")),
        *(Shape(f"mass_{axis}", "m³") for axis in "xyz"),
        *(Shape(f"inertia_{axis}", "m⁵") for axis in "xyz"),
    )

    def resistance(self, v: Array, w: Array) -> tuple[Array, Array]:
        """Return the coefficients of ρ and β in force and moment."""
        r, (least, mid, most) = self.size, np.sort(self.size)
        q, D = np.roll(r, -1) * np.roll(r, -2), 2.0 * r.mean()
        speed = np.sqrt((v * v).sum(-1, keepdims=True))
        qv_squared = ((q * v) ** 2).sum(-1, keepdims=True)  # |q v|²
        normal = q * q * v
        normal_squared = (normal * normal).sum(-1, keepdims=True)
        area = np.pi * np.sqrt(normal_squared / np.maximum(qv_squared, _LEAST))
        cosine = qv_squared / np.maximum(speed * normal_squared, _LEAST)
        drag = speed * (self.blunt * area + self.slender * (np.pi * most * mid - area))
        lift = _cross(_cross(normal, v), v)
        momentum = np.array([self.mass_x, self.mass_y, self.mass_z]) * v
        angular_momentum = np.array([self.inertia_x, self.inertia_y, self.inertia_z]) * w
        force = drag * v - self.kutta * area * cosine * lift - _cross(momentum, w)
        force = force - self.magnus * (4.0 / 3.0 * np.pi * least * mid * most) * _cross(w, v)
        inertia = 8.0 / 15.0 * np.pi * r * np.maximum(np.roll(r, -1), np.roll(r, -2)) ** 4
        largest = 8.0 / 15.0 * np.pi * mid * most**4
        angular_drag = (self.angular * inertia + self.slender * (largest - inertia)) * w
        moment = np.sqrt((angular_drag * angular_drag).sum(-1, keepdims=True)) * w
        moment = moment - _cross(momentum, v) - _cross(angular_momentum, w)
        viscous_force, viscous_moment = 3.0 * np.pi * D * v, np.pi * D**3 * w
        return np.stack([force, viscous_force], -1), np.stack([moment, viscous_moment], -1)


@dataclass(frozen=True)
class AddedMass(_Numbered, BodyEffect):
    """Inertia of the still fluid around a body, by Kirchhoff's equations.

    With the velocity v of Bo, ω and the matrix A in the body's frame, the fluid has the momentum
    [h; l] = s A [v; ω], and the body needs the force f = ḣ + ω × h and the moment
    g = l̇ + ω × l + v × h about Bo. effort = J_Boᵀ f + J_ωᵀ g. Gravity does not act on it. The
    numbers are the entries of A in the order of `ADDED_MASS`.
    """

    name = "added_mass"
    file_term = FileTerm("added mass")
    law = "s of the inertia that still fluid adds to a body, a matrix (6, 6)"
    complexity = 3
    parameters = (Parameter("share", "1", lower=0.0),)
    signature = "grows with a body's acceleration and the square of its speed, without weight"
    depends_on = frozenset({"q", "v", "vd", "bodies"})

    @classmethod
    def names_of(cls, where: Sequence[str]) -> list[str]:
        """Return the names of the entries of A."""
        return [*ADDED_MASS]

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the column of the share at the joints that move the body."""
        bodies = motion.body_motions(self.name)
        body = bodies.motion(self.body)
        axes = np.moveaxis(body.rotation, 1, 2)
        J = np.concatenate([axes @ body.linear, axes @ body.angular], axis=1)
        velocity = (J @ motion.v[..., None])[..., 0]
        v, w = velocity[:, :3], velocity[:, 3:]
        turning, a = bodies.acceleration(self.body, motion.v, motion.vd)
        A = added_mass_matrix(self.numbers)
        momentum, rate = velocity @ A, np.concatenate([a - _cross(w, v), turning], axis=1) @ A
        h, angular_momentum = momentum[:, :3], momentum[:, 3:]
        carried = [_cross(w, h), _cross(w, angular_momentum) + _cross(v, h)]
        wrench = rate + np.concatenate(carried, axis=1)
        column = np.moveaxis(J, 1, 2) @ wrench[..., None]
        return {motion.joints[dof]: column[:, dof] for dof in body.dofs}


def _cross(a: Array, b: Array) -> Array:
    """Return cross products (N, 3)."""
    first, second = [1, 2, 0], [2, 0, 1]
    return np.asanyarray(a[..., first] * b[..., second] - a[..., second] * b[..., first])


_WORLD = "world"
_LEAST_LENGTH = 1e-150  # m, so that its inverse is finite


@dataclass(frozen=True)
class _BodyPair(Effect):
    """An effect between two bodies, or a body and the world."""

    bodies: tuple[str, str]  # names of the two bodies, or "world"
    places: ClassVar[str] = "body_pair"

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.bodies) != 2 or self.bodies[0] == self.bodies[1]:
            raise ArgumentError(f"{self.name} needs two different bodies; it got {self.bodies}.")


@dataclass(frozen=True)
class CarriedWeight(_FileEffect, _BodyPair):
    """Weight of a body that needs no effort: compensated gravity, buoyancy, gravity switched off.

    effort = m (J_P − J′_P)ᵀ g, with mass m in kg at point P of the body and gravity g. It cancels
    the weight −m J_Pᵀ g that the body has in the model. J′_P is the Jacobian at P of the second
    body, which carries the weight, so that joints inboard of that body still bear it.
    """

    x: float = 0.0  # position of P from Bo along x of the first body's frame, m; y and z follow
    y: float = 0.0
    z: float = 0.0

    name = "carried_weight"
    file_term = FileTerm("carried weight")
    law = "m (J − J′)ᵀ g at a point of a body that another one carries, against its weight"
    complexity = 3
    shapes = tuple(Shape(axis, "m") for axis in "xyz")
    parameters = (Parameter("mass", "kg"),)
    signature = "follows the posture at all joints up to a body, as if it weighed less"
    depends_on = frozenset({"q", "bodies"})

    def rows(self, motion: RobotMotion) -> Rows:
        """[(J_P − J′_P)ᵀ g] at the joints that move either body."""
        bodies, (body, carrier_name) = motion.body_motions(self.name), self.bodies
        p, J, dofs = _point(bodies, body, np.array([self.x, self.y, self.z]))
        if carrier_name != _WORLD:
            carrier = bodies.motion(carrier_name)
            J, dofs = J - carrier.jacobian_along(p - carrier.position), (*dofs, *carrier.dofs)
        column = np.moveaxis(J, 1, 2) @ bodies.gravity
        return {motion.joints[dof]: column[:, dof, None] for dof in sorted(set(dofs))}


@dataclass(frozen=True)
class Strut(_FileEffect, _BodyPair):
    """Spring and damper between a point P of a body and a point Q of another, or of the world.

    With the distance L of P and Q, effort = (k L + p + d L̇) ∂L/∂q: a counterbalance or gas spring
    of stiffness k in N/m, preload p = −k L₀ in N and damping d in N·s/m.
    """

    x: float = 0.0  # position of P from Bo along x of the first body's frame, m; y and z follow
    y: float = 0.0
    z: float = 0.0
    other_x: float = 0.0  # position of Q in the frame of the second body, likewise
    other_y: float = 0.0
    other_z: float = 0.0

    name = "strut"
    file_term = FileTerm("tendon")
    law = "(k L + p + d L̇) ∂L/∂q, L the distance of two points"
    complexity = 3
    shapes = tuple(Shape(name, "m") for name in ("x", "y", "z", "other_x", "other_y", "other_z"))
    parameters = (
        Parameter("stiffness", "N/m", lower=0.0),
        Parameter("preload", "N"),
        Parameter("damping", "N·s/m", lower=0.0),
    )
    signature = "follows the posture at all joints between two bodies"
    depends_on = frozenset({"q", "v", "bodies"})

    def rows(self, motion: RobotMotion) -> Rows:
        """Return columns of stiffness, preload and damping at the joints that move either body."""
        bodies = motion.body_motions(self.name)
        points = [self.x, self.y, self.z], [self.other_x, self.other_y, self.other_z]
        (p, J, first), (other_p, other_J, second) = (
            _point(bodies, body, np.array(point))
            for body, point in zip(self.bodies, points, strict=True)
        )
        length, along = _direction(other_p - p)
        slope = (along[:, None, :] @ (other_J - J))[:, 0]
        return _along(motion, length, slope, sorted({*first, *second}))


PART = {
    **dict.fromkeys(("ax", "ay", "az", "bx", "by", "bz"), "m"),  # A and B in their bodies
    "weight": "1",  # share of the part's length in that of the tendon
    "radius": "m",  # of a sphere or cylinder between A and B; 0 for none
    "is_cylinder": "1",
    **dict.fromkeys(("gx", "gy", "gz"), "m"),  # its center in its body
    **dict.fromkeys(("gw", "gi", "gj", "gk"), "1"),  # quaternion of its axes
    **dict.fromkeys(("sx", "sy", "sz"), "m"),  # point on the side of the tendon, in these axes
}
"""Numbers of a part of a `Tendon` -> unit."""

_ENDS = "low", "high"  # lengths between which a tendon is slack, m; 0 for none


@dataclass(frozen=True)
class Tendon(_Numbered):
    """Spring and damper along a tendon of parts, each between two points A and B.

    effort = (k L + p + d L̇) ∂L/∂q, with the length L = Σ wᵢ Lᵢ, stiffness k in N/m, preload
    p = −k L₀ in N and damping d in N·s/m. Lᵢ is the distance of A and B, or the shortest way around
    a sphere or an infinite cylinder between them, as in MuJoCo. With a point on its side, the way
    does not cross the ray from the center away from that point. The spring of a slack tendon has
    L − `high` above that, L − `low` below that, and 0 between in the place of L.
    """

    bodies: tuple[str, ...]  # of A, of B and of the sphere or cylinder, of each part; or "world"

    name = "tendon"
    file_term = FileTerm("tendon of several parts")
    places = "body_path"
    law = "(k L + p + d L̇) ∂L/∂q, L the weighted length of several parts, perhaps around shapes"
    complexity = 3
    parameters = Strut.parameters
    signature = Strut.signature
    depends_on = Strut.depends_on

    @property
    def place(self) -> str:
        """Return the bodies."""
        return " & ".join(dict.fromkeys(body for body in self.bodies if body != _WORLD))

    @classmethod
    def names_of(cls, where: Sequence[str]) -> list[str]:
        """Return the names of the numbers, such as `ax_0` of the first part."""
        return [*_ENDS, *(f"{name}_{k}" for k in range(len(where) // 3) for name in PART)]

    def rows(self, motion: RobotMotion) -> Rows:
        """Return columns of stiffness, preload and damping at the joints that move the bodies."""
        length, slope, moving = np.zeros(1), np.zeros((1, 1)), set[int]()
        low, high, *of_parts = self.numbers
        for k, numbers in enumerate(np.array(of_parts).reshape(-1, len(PART))):
            own, own_slope, dofs = self._part(motion, self.bodies[3 * k : 3 * k + 3], numbers)
            weight = numbers[6]
            length, slope = length + weight * own, slope + weight * own_slope
            moving |= dofs
        if high > low:
            length = np.maximum(length - high, 0.0) + np.minimum(length - low, 0.0)
        return _along(motion, length, slope, sorted(moving))

    def _part(
        self, motion: RobotMotion, names: Sequence[str], numbers: Array
    ) -> tuple[Array, Array, set[int]]:
        """Return the length (N,) of a part, its slopes (N, nv), and moving velocities."""
        bodies, (radius, is_cylinder) = motion.body_motions(self.name), numbers[7:9]
        (a, J_a, first), (b, J_b, second) = (
            _point(bodies, body, point)
            for body, point in zip(names, (numbers[:3], numbers[3:6]), strict=False)
        )
        length, along = _direction(b - a)
        slope = (along[:, None, :] @ (J_b - J_a))[:, 0]
        if not radius:
            return length, slope, {*first, *second}
        center, _, third = _point(bodies, names[2], numbers[9:12])
        R = _turn(bodies, names[2])[0] @ rotation(numbers[12:16])
        local = [(np.moveaxis(R, 1, 2) @ (x - center)[..., None])[..., 0] for x in (a, b)]
        side = numbers[16:19] if numbers[16:19].any() else None
        wraps, points, arc = wrapped(local[0], local[1], radius, side, is_cylinder=is_cylinder > 0)
        at = [(R @ x[..., None])[..., 0] + center for x in points]
        (to_arc, u), (from_arc, w) = _direction(at[0] - a), _direction(b - at[1])
        J_0, J_1 = (_at_point(bodies, names[2], x) for x in at)
        around = (u[:, None, :] @ (J_0 - J_a) + w[:, None, :] @ (J_b - J_1))[:, 0]
        length = np.where(wraps, to_arc + arc + from_arc, length)
        return length, np.where(wraps[:, None], around, slope), {*first, *second, *third}


def _along(motion: RobotMotion, length: Array, slope: Array, dofs: Sequence[int]) -> Rows:
    """Return columns of stiffness, preload and damping along a length (N,)."""
    rate = (slope * motion.v).sum(-1)
    law = np.stack([length, np.ones_like(length), rate], -1)
    return {motion.joints[dof]: slope[:, dof, None] * law for dof in dofs}


def _direction(separation: Array) -> tuple[Array, Array]:
    """Return lengths (N,) and unit vectors (N, 3)."""
    length = np.sqrt((separation * separation).sum(-1))
    return length, separation / np.maximum(length, _LEAST_LENGTH)[:, None]


def _at_point(bodies: RobotBodies, body: str, p_W: Array) -> Array:
    """Return the Jacobian (N, 3, nv) of a body's points at positions (N, 3) in the world."""
    if body == _WORLD:
        return np.zeros((1, 3, bodies.tree.num_velocities))
    motion = bodies.motion(body)
    return motion.jacobian_along(p_W - motion.position)


def wrapped(
    a: Array, b: Array, radius: float, side: Array | None, *, is_cylinder: bool
) -> tuple[Array, tuple[Array, Array], Array]:
    """Return where the way from a to b (N, 3) leads around a sphere, or a cylinder along z.

    Returns:
        Whether it does (N,), where it begins and ends to touch (N, 3), and the length between.
    """
    shape = np.broadcast_shapes(a.shape, b.shape)  # a point of the world has one row
    a, b = (np.broadcast_to(p, shape, subok=True) for p in (a, b))
    if is_cylinder:
        x, y = np.eye(3)[:2, None]
    else:
        x = _direction(a)[1]
        y = _direction(_cross(_cross(a, b), a))[1]
    ends = [np.stack([(p * x).sum(-1), (p * y).sum(-1)], -1) for p in (a, b)]
    towards = None if side is None else np.stack([(side * x).sum(-1), (side * y).sum(-1)], -1)
    wraps, points, arc = _around_circle(ends[0], ends[1], radius, towards)
    flat = [p[:, :1] * x + p[:, 1:] * y for p in points]
    if not is_cylinder:
        return wraps, (flat[0], flat[1]), arc
    up, height = np.eye(3)[2], b[:, 2] - a[:, 2]
    first, last = (_direction(p - end)[0] for p, end in zip(points, ends, strict=True))
    rise = height / np.maximum(first + arc + last, _LEAST_LENGTH)
    heights = a[:, 2] + rise * first, a[:, 2] + rise * (first + arc)
    low, high = (p + z[:, None] * up for p, z in zip(flat, heights, strict=True))
    return wraps, (low, high), arc * np.sqrt(1.0 + rise * rise)


def _around_circle(
    a: Array, b: Array, radius: float, side: Array | None
) -> tuple[Array, tuple[Array, Array], Array]:
    """Return `wrapped` in a plane, for points (N, 2) and a circle about the origin."""
    sizes = [np.sqrt((p * p).sum(-1)) for p in (a, b)]
    step = b - a
    square = np.maximum((step * step).sum(-1), _LEAST_LENGTH)
    share = np.minimum(np.maximum(-(step * a).sum(-1) / square, 0.0), 1.0)
    nearest = a + share[:, None] * step
    passes = (nearest * nearest).sum(-1) <= radius**2
    if side is not None:
        passes = np.logical_or(passes, _leads_behind(a, b, side))
    ways = []
    for sign in (1.0, -1.0):
        turns = [np.arccos(np.minimum(radius / np.maximum(size, _LEAST), 1.0)) for size in sizes]
        first = np.arctan2(a[:, 1], a[:, 0]) + sign * turns[0]
        last = np.arctan2(b[:, 1], b[:, 0]) - sign * turns[1]
        p, q = (radius * np.stack([np.cos(x), np.sin(x)], -1) for x in (first, last))
        arc = np.remainder(sign * (last - first), 2.0 * np.pi)
        length = _direction(p - a)[0] + radius * arc + _direction(b - q)[0]
        if side is not None:
            opposite = np.arctan2(-side[:, 1], -side[:, 0])
            behind = np.remainder(sign * (opposite - first), 2.0 * np.pi) < arc
            for ends in ((a, p), (q, b)):
                behind = np.logical_or(behind, _leads_behind(*ends, side))
            length = np.where(behind, _NEVER, length)
        ways.append((length, p, q, radius * arc))
    (length, p, q, arc), (other_length, other_p, other_q, other_arc) = ways
    first_way = length < other_length
    p, q = (np.where(first_way[:, None], *each) for each in ((p, other_p), (q, other_q)))
    outside = np.logical_and(sizes[0] >= radius, sizes[1] >= radius)
    return np.logical_and(passes, outside), (p, q), np.where(first_way, arc, other_arc)


def _leads_behind(a: Array, b: Array, side: Array) -> Any:
    """Return whether the line from a to b (N, 2) crosses the ray from the origin against `side`."""
    (aside, ahead), (other_aside, other_ahead) = (
        (side[:, 0] * p[:, 1] - side[:, 1] * p[:, 0], (side * p).sum(-1)) for p in (a, b)
    )
    ahead_there = (other_ahead * aside - ahead * other_aside) * (aside - other_aside)
    return np.logical_and(aside * other_aside < 0.0, ahead_there < 0.0)


@dataclass(frozen=True)
class BallSpring(_FileEffect, _BodyPair):
    """Spring of a ball joint, against the rotation of a body relative to another, or the world.

    effort = k (J_ω − J′_ω)ᵀ φ with the rotation vector φ from the spring's rest orientation.
    """

    # Real part of the quaternion of the first body in the second at rest; its vector follows.
    turn_w: float = 1.0
    turn_x: float = 0.0
    turn_y: float = 0.0
    turn_z: float = 0.0

    name = "ball_spring"
    file_term = FileTerm("spring of a ball joint")
    law = "k (J − J′)ᵀ φ, φ the rotation of a body in another one"
    complexity = 3
    shapes = tuple(Shape(f"turn_{axis}") for axis in "wxyz")
    parameters = (Parameter("stiffness", "N·m/rad", lower=0.0),)
    signature = "follows the orientation at all joints between two bodies"
    depends_on = frozenset({"q", "bodies"})

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the column [(J_ω − J′_ω)ᵀ φ] at the joints that move either body."""
        bodies = motion.body_motions(self.name)
        (R, J, first), (other_R, other_J, second) = (_turn(bodies, body) for body in self.bodies)
        rest = rotation(np.array([self.turn_w, self.turn_x, self.turn_y, self.turn_z]))
        relative = np.moveaxis(other_R @ rest, 1, 2) @ R
        i, j = [2, 0, 1], [1, 2, 0]
        axis = 0.5 * (relative[:, i, j] - relative[:, j, i])
        sine = np.sqrt((axis * axis).sum(-1))
        angle = np.arctan2(sine, 0.5 * (np.trace(relative, axis1=1, axis2=2) - 1.0))
        vector = axis * (angle / np.maximum(sine, _LEAST_LENGTH))[:, None]
        column = np.moveaxis(J - other_J, 1, 2) @ (R @ vector[..., None])
        return {motion.joints[dof]: column[:, dof] for dof in sorted({*first, *second})}


def _turn(bodies: RobotBodies, body: str) -> tuple[Array, Array, tuple[int, ...]]:
    """Return the rotation (N, 3, 3) of a body, its Jacobian, and indices of its velocities."""
    if body == _WORLD:
        return np.eye(3)[None], np.zeros((1, 3, bodies.tree.num_velocities)), ()
    motion = bodies.motion(body)
    return motion.rotation, motion.angular, motion.dofs


def _point(bodies: RobotBodies, body: str, p_BoP_B: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Return the position (N, 3) of a body's point, its Jacobian, and indices of its velocities."""
    if body == _WORLD:
        return p_BoP_B[None], np.zeros((1, 3, bodies.tree.num_velocities)), ()
    motion = bodies.motion(body)
    return motion.position + motion.rotation @ p_BoP_B, motion.jacobian_at(p_BoP_B), motion.dofs
