"""The robot that hides something, in MuJoCo on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from diagrams.benchmarks.floating.draws import DRIVES, FOOT, GAIN, LIMB, PAYLOAD, Draw
from diagrams.benchmarks.floating.robots import ROBOTS, Robot, by_name, robot_text

Array = npt.NDArray[np.float64]
STEP = 5e-4  # s
BALL = 2e-3  # m, radius of what touches the ground
_SOFTNESS = (0.01, 1.0)  # time constant, s, and damping ratio of a contact
_TOLERANCE = 1e-15  # of MuJoCo's solver of contacts
_GROUND = "ground"


@dataclass(frozen=True)
class Secret:
    """What the simulated robot has and its file has not.

    Attributes:
        mass, place, inertia: Of the payload: kg, m in the trunk's axes, kg·m² of its cube.
        limb: The heavier link; "" for none.
        scale, shift: Its mass and inertia over those of the file, and its centre's way, m.
        friction, damping, rotor: Of each joint: N·m, N·m·s/rad, kg·m².
        gain: Joint whose effort is logged too large or small, and the factor; None for none.
        offset: Foot whose sensor is off, and by which wrench; None for none.
    """

    mass: float = 0.0
    place: tuple[float, ...] = (0.0, 0.0, 0.0)
    inertia: float = 0.0
    limb: str = ""
    scale: float = 1.0
    shift: tuple[float, ...] = (0.0, 0.0, 0.0)
    friction: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()
    rotor: tuple[float, ...] = ()
    gain: tuple[str, float] | None = None
    offset: tuple[str, tuple[float, ...]] | None = None


def secret_of(draw: Draw) -> Secret:
    """Return what a draw hides."""
    robot, rng = ROBOTS[draw.robot], draw.rng("secret")
    plain = compiled(draw.robot, Secret())
    weight, joints = float(plain.body_mass.sum()), joint_names(plain)
    match draw.hidden:
        case s if s == PAYLOAD:
            mass, size = float(rng.uniform(*robot.payload)) * weight, robot.reach
            place = rng.uniform((-size, -size, 0.0), (size, size, 2.0 * size))
            inertia = mass * size**2 / 6.0
            return Secret(mass=mass, place=tuple(place.tolist()), inertia=inertia)
        case s if s == LIMB:
            limb = str(rng.choice(robot.limbs))
            length = 2.0 * float(np.linalg.norm(plain.body(limb).ipos))
            shift = rng.normal(size=3)
            shift *= 0.1 * length / np.linalg.norm(shift)
            return Secret(limb=limb, scale=1.4, shift=tuple(shift.tolist()))
        case s if s == DRIVES:
            stiff = np.array([by_name(robot.stiffness, joint) for joint in joints])
            rotor = np.array([by_name(robot.rotor, joint) for joint in joints])
            dry, viscous = (
                share * stiff * rng.uniform(0.7, 1.4, len(joints)) for share in robot.friction
            )
            rotor = rotor * rng.uniform(0.7, 1.4, len(joints))
            return Secret(
                friction=tuple(dry.tolist()),
                damping=tuple(viscous.tolist()),
                rotor=tuple(rotor.tolist()),
            )
        case s if s == GAIN:
            legs = [joint for leg in robot.feet.values() for joint in leg]
            return Secret(gain=(str(rng.choice(legs)), float(rng.choice((0.85, 1.15)))))
        case s if s == FOOT:
            size = 9.81 * weight * np.array([0.02] * 2 + [0.05] + [2e-3] * 3)
            wrench = size * rng.uniform(0.6, 1.4, 6) * rng.choice((-1.0, 1.0), 6)
            return Secret(offset=(str(rng.choice(list(robot.feet))), tuple(wrench.tolist())))
    return Secret()


def compiled(name: str, secret: Secret) -> mujoco.MjModel:
    """Return the robot on the ground with what it hides of its mechanics."""
    robot = ROBOTS[name]
    spec = mujoco.MjSpec.from_string(robot_text(name))
    spec.compiler.fusestatic = False
    spec.worldbody.first_body().add_freejoint()
    spec.option.timestep, spec.option.tolerance = STEP, _TOLERANCE
    spec.worldbody.add_geom(
        name=_GROUND, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=1, conaffinity=0
    )
    for foot in robot.feet:
        for place in sole_points(robot):
            spec.body(foot).add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[BALL, 0, 0],
                pos=place,
                mass=0.0,
                contype=0,
                conaffinity=1,
                condim=3,
                friction=[0.8, 0.005, 0.0001],
                solref=list(_SOFTNESS),
            )
    if secret.mass:
        payload = spec.body(robot.trunk).add_body(name="payload", pos=secret.place)
        payload.mass, payload.inertia = secret.mass, np.full(3, secret.inertia)
        payload.explicitinertial = True
    if secret.limb:
        limb = spec.body(secret.limb)
        limb.mass *= secret.scale
        limb.inertia, limb.fullinertia = (
            secret.scale * limb.inertia,
            secret.scale * limb.fullinertia,
        )
        limb.ipos += secret.shift
    joints = spec.joints[1:]
    for joint, dry, viscous, rotor in zip(
        joints, secret.friction, secret.damping, secret.rotor, strict=bool(secret.rotor)
    ):
        joint.frictionloss, joint.damping[0], joint.armature = dry, viscous, rotor
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    return spec.compile()


def sole_points(robot: Robot) -> list[tuple[float, float, float]]:
    """Return centres of the balls that touch the ground, in a foot's frame."""
    if not any(robot.sole):
        return [(0.0, 0.0, 0.0)]
    length, width = robot.sole
    return [(x, y, BALL) for x in (-length, length) for y in (-width, width)]


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return all joints but the free one."""
    return tuple(model.joint(k).name for k in range(1, model.njnt))


def foot_wrench(
    model: mujoco.MjModel, data: mujoco.MjData, feet: tuple[str, ...]
) -> tuple[Array, Array]:
    """Return which feet touch the ground, and its wrenches on them about and in their frames.

    Returns:
        (F,) bool, and (F, 6) force and torque.
    """
    bodies = [model.body(foot).id for foot in feet]
    touching, wrenches = np.zeros(len(feet), bool), np.zeros((len(feet), 6))
    found = np.zeros(6)
    for k in range(data.ncon):
        contact: Any = data.contact[k]
        ground, foot = contact.geom1, contact.geom2
        sign = 1.0
        if model.geom(foot).name == _GROUND:
            ground, foot, sign = foot, ground, -1.0
        at = bodies.index(int(model.geom_bodyid[foot]))
        mujoco.mj_contactForce(model, data, k, found)
        axes = contact.frame.reshape(3, 3).T
        force, torque = sign * axes @ found[:3], sign * axes @ found[3:]
        turn = data.xmat[bodies[at]].reshape(3, 3)
        arm = contact.pos - data.xpos[bodies[at]]
        wrenches[at, :3] += turn.T @ force
        wrenches[at, 3:] += turn.T @ (torque + np.cross(arm, force))
        touching[at] |= found[0] > 0.0
    return touching, wrenches
