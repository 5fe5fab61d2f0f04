"""Robots that hide something, and how they stand in MuJoCo on the ground."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from typing import Any
from zlib import crc32

import mujoco
import numpy as np
import numpy.typing as npt

from diagrams.public_data import installed_model

SWAY, TROT = "sway", "trot"
PAYLOAD, LIMB, DRIVES, GAIN, FOOT, QUIET = (
    "payload",
    "limb",
    "friction and rotors",
    "gain",
    "foot sensor",
    "quiet",
)
FLAGS, WRONG_FLAGS, NO_FLAGS = "logged", "a tenth wrong", "not logged"


@dataclass(frozen=True)
class Draw:
    """A robot, its secret, and its two logs."""

    robot: str
    hidden: str = QUIET
    motions: tuple[str, ...] = (SWAY, TROT)
    contacts: str = FLAGS
    wrenches: bool = False
    efforts: bool = True
    noise: float = 1.0  # noise of all sensors, relative to the usual; 0 for exact logs
    rate: float = 200.0
    duration: float = 40.0
    number: int = 0
    seed: int = 0

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a generator of random numbers for a purpose of this draw."""
        words = f"{self.robot} {self.hidden} {purpose}"
        return np.random.default_rng([self.seed, self.number, crc32(words.encode())])


_HIDDEN = (  # robot, secret, contacts, whether wrenches and efforts are logged
    ("a1", PAYLOAD, FLAGS, True, True),
    ("anymal", DRIVES, FLAGS, False, True),
    ("talos", PAYLOAD, FLAGS, False, True),
    ("a1", LIMB, FLAGS, False, True),
    ("anymal", GAIN, FLAGS, True, True),
    ("talos", DRIVES, FLAGS, True, True),
    ("a1", FOOT, FLAGS, True, True),
    ("anymal", PAYLOAD, NO_FLAGS, False, True),
    ("talos", GAIN, FLAGS, False, True),
    ("a1", DRIVES, WRONG_FLAGS, False, True),
    ("anymal", LIMB, FLAGS, True, True),
    ("talos", FOOT, FLAGS, True, True),
    ("a1", PAYLOAD, NO_FLAGS, True, False),
    ("anymal", DRIVES, NO_FLAGS, True, True),
    ("talos", LIMB, NO_FLAGS, False, True),
    ("a1", GAIN, WRONG_FLAGS, False, True),
    ("anymal", PAYLOAD, WRONG_FLAGS, False, True),
    ("talos", PAYLOAD, NO_FLAGS, True, False),
    ("a1", DRIVES, FLAGS, True, True),
    ("anymal", FOOT, NO_FLAGS, True, True),
)
_PLAIN = (
    ("a1", QUIET, FLAGS, False, True),
    ("anymal", QUIET, WRONG_FLAGS, False, True),
    ("talos", QUIET, FLAGS, True, True),
    ("a1", QUIET, NO_FLAGS, True, True),
)
_ALWAYS_STANDS = ("talos",)


def all_draws(seed: int, **fixed: object) -> list[Draw]:
    """Return twenty draws that hide something, with four between them that hide nothing."""
    rows = [*_HIDDEN]
    for k, quiet in enumerate(_PLAIN):
        rows.insert(6 * k + 5, quiet)
    return [
        Draw(
            *(robot, hidden),
            **{  # type: ignore[arg-type]
                "motions": (SWAY, SWAY if robot in _ALWAYS_STANDS else TROT),
                "contacts": contacts,
                "wrenches": wrenches,
                "efforts": efforts,
                "number": number,
                "seed": seed,
                **fixed,
            },
        )
        for number, (robot, hidden, contacts, wrenches, efforts) in enumerate(rows)
    ]


_NEGLIGIBLE = 1e-5  # kg
_POINT_INERTIA = 1e-5  # kg·m², of masses that a file calls points


@dataclass(frozen=True)
class Robot:
    """A robot with legs."""

    path: str
    trunk: str  # the link that carries a payload
    limbs: tuple[str, ...]  # links that may be heavier than the file says
    # Frame of each foot, with the joints of its leg from the trunk on.
    feet: Mapping[str, tuple[str, ...]]
    posture: Mapping[str, float]  # positions of joints where it stands, rad; 0 for others
    # stiffness, damping: Gains of joints by a pattern of their names, N·m/rad and N·m·s/rad.
    stiffness: Mapping[str, float]
    damping: Mapping[str, float]
    sway: tuple[float, ...]  # half range of the trunk along x, y, z, m, and about them, rad
    # Dry and viscous friction of a joint, N·m and N·m·s/rad, over its stiffness.
    friction: tuple[float, float]
    rotor: Mapping[str, float]  # reflected inertia of joints by a pattern of their names, kg·m²
    # Half length and half width of a sole, m; zeros for a foot that is a point.
    sole: tuple[float, float] = (0.0, 0.0)
    swing: float = 0.0  # half range of joints outside the legs, rad
    pace: float = 1.0  # speed of sways over that of a quadruped
    period: float | None = None  # of a trot, s; None where the robot only stands
    lift: float = 0.0  # height of a swinging foot, m
    fixed: tuple[str, ...] = ()  # how names of joints begin that are held fixed
    # Least and largest mass of a payload, as shares of the robot's.
    payload: tuple[float, float] = (0.05, 0.2)
    reach: float = 0.1  # how far it is from the trunk's origin along each axis at most, m
    # Axis along which a joint holds the centre of mass above the feet, and its sign.
    balance: Mapping[str, tuple[int, float]] = field(default_factory=dict)


def _legs(feet: Mapping[str, str], joints: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    return {foot: tuple(f"{leg}{joint}" for joint in joints) for leg, foot in feet.items()}


_A1_LEGS = ("FR", "FL", "RR", "RL")
_ANYMAL_LEGS = ("LF", "RF", "LH", "RH")
_TALOS_LEG = (0.0, 0.0, -0.411354, 0.859395, -0.448041, 0.0)
_TALOS_ARMS = {
    f"arm_{side}_{k}_joint": angle
    for side, sign in (("left", 1.0), ("right", -1.0))
    for k, angle in ((1, 0.25847 * sign), (2, 0.35 * sign), (4, -0.9), (7, 0.1))
}

ROBOTS: Mapping[str, Robot] = {
    "a1": Robot(
        path="a1_description/urdf/a1.urdf",
        trunk="trunk",
        limbs=tuple(f"{leg}_thigh" for leg in _A1_LEGS),
        feet=_legs(
            {f"{leg}_": f"{leg}_foot" for leg in _A1_LEGS},
            ("hip_joint", "thigh_joint", "calf_joint"),
        ),
        posture={
            f"{leg}_{joint}_joint": angle
            for leg in _A1_LEGS
            for joint, angle in (("thigh", 0.8), ("calf", -1.6))
        },
        stiffness={"*": 150.0},
        damping={"*": 3.0},
        sway=(0.03, 0.03, 0.025, 0.12, 0.1, 0.15),
        friction=(0.0035, 0.0012),
        rotor={"*": 0.008},
        period=0.5,
        lift=0.05,
    ),
    "anymal": Robot(
        path="anymal_b_simple_description/robots/anymal.urdf",
        trunk="base",
        limbs=tuple(f"{leg}_THIGH" for leg in _ANYMAL_LEGS),
        feet=_legs({f"{leg}_": f"{leg}_FOOT" for leg in _ANYMAL_LEGS}, ("HAA", "HFE", "KFE")),
        posture={
            f"{leg}_{joint}": angle * sign
            for leg in _ANYMAL_LEGS
            for joint, angle, sign in (
                ("HAA", 0.1, -1.0 if leg[0] == "L" else 1.0),
                ("HFE", 0.7, 1.0 if leg[1] == "F" else -1.0),
                ("KFE", -1.0, 1.0 if leg[1] == "F" else -1.0),
            )
        },
        stiffness={"*": 500.0},
        damping={"*": 12.0},
        sway=(0.05, 0.05, 0.035, 0.12, 0.1, 0.15),
        friction=(0.004, 0.002),
        rotor={"*": 0.05},
        period=0.7,
        lift=0.06,
    ),
    "talos": Robot(
        path="talos_data/robots/talos_reduced.urdf",
        trunk="torso_2_link",
        limbs=("arm_left_4_link", "arm_right_2_link", "leg_left_4_link", "leg_right_3_link"),
        feet=_legs(
            {"leg_left": "left_sole_link", "leg_right": "right_sole_link"},
            tuple(f"_{k}_joint" for k in range(1, 7)),
        ),
        posture={
            **{
                f"leg_{side}_{k}_joint": angle
                for side in ("left", "right")
                for k, angle in enumerate(_TALOS_LEG, 1)
            },
            **_TALOS_ARMS,
        },
        stiffness={
            "leg_*_[56]_*": 3000.0,
            "leg_*": 5000.0,
            "torso_*": 3000.0,
            "arm_*_[567]_*": 40.0,
            "arm_*": 300.0,
            "head_*": 50.0,
        },
        damping={
            "leg_*_5_*": 20.0,
            "leg_*_6_*": 8.0,
            "leg_*": 60.0,
            "torso_*": 60.0,
            "arm_*_[567]_*": 1.0,
            "arm_*": 8.0,
            "head_*": 1.0,
        },
        sway=(0.01, 0.03, 0.025, 0.03, 0.03, 0.05),
        friction=(0.001, 0.0006),
        rotor={
            "leg_*": 0.15,
            "torso_*": 0.15,
            "arm_*_[567]_*": 0.01,
            "arm_*": 0.05,
            "head_*": 0.01,
        },
        sole=(0.1, 0.06),
        swing=0.3,
        pace=0.6,
        fixed=("gripper",),
        payload=(0.05, 0.12),
        reach=0.08,
        balance={
            f"leg_{side}_{k}_joint": push
            for side in ("left", "right")
            for k, push in ((5, (0, 1.0)), (6, (1, -1.0)))
        },
    ),
}


@cache
def robot_text(name: str) -> str:
    """Return the URDF of a robot without meshes, friction and fingers, as far as MuJoCo reads it.

    Links of no mass lose their inertia, and masses that are points get a little.
    """
    robot = ROBOTS[name]
    root = ET.parse(installed_model(robot.path)).getroot()
    for link in root.iter("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
        inertial = link.find("inertial")
        if inertial is not None:
            _mend(link, inertial)
    for joint in root.iter("joint"):
        for stated in joint.findall("dynamics"):
            joint.remove(stated)
        if joint.get("name", "").startswith(robot.fixed or "no joint"):
            joint.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")


def _mend(link: ET.Element, inertial: ET.Element) -> None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None or float(mass.get("value", "0")) <= _NEGLIGIBLE:
        link.remove(inertial)
    elif not any(float(value) for value in inertia.attrib.values()):
        inertia.attrib.update(dict.fromkeys(("ixx", "iyy", "izz"), str(_POINT_INERTIA)))


def by_name(values: Mapping[str, float], joint: str) -> float:
    """Return the value of the first pattern that a joint's name has."""
    return next(value for pattern, value in values.items() if fnmatchcase(joint, pattern))


Array = npt.NDArray[np.float64]
STEP = 5e-4  # s
BALL = 2e-3  # m, radius of what touches the ground
_SOFTNESS = (0.01, 1.0)  # time constant, s, and damping ratio of a contact
_TOLERANCE = 1e-15  # of MuJoCo's solver of contacts
# Time constant and impedance of dry friction: MuJoCo's own let it grow with the speed up to some
# tenths of a radian per second.
_DRY = (2.0 * STEP, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
_GROUND = "ground"


@dataclass(frozen=True)
class Secret:
    """What the simulated robot has and its file has not."""

    # mass, place, inertia: Of the payload: kg, m in the trunk's axes, kg·m² of its cube.
    mass: float = 0.0
    place: tuple[float, ...] = (0.0, 0.0, 0.0)
    inertia: float = 0.0
    limb: str = ""  # the heavier link; "" for none
    # scale, shift: Its mass and inertia over those of the file, and its centre's way, m.
    scale: float = 1.0
    shift: tuple[float, ...] = (0.0, 0.0, 0.0)
    # friction, damping, rotor: Of each joint: N·m, N·m·s/rad, kg·m².
    friction: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()
    rotor: tuple[float, ...] = ()
    # Joint whose effort is logged too large or small, and the factor; None for none.
    gain: tuple[str, float] | None = None
    # Foot whose sensor is off, and by which wrench; None for none.
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
        payload = spec.body(robot.trunk).add_body(name="payload", pos=secret.place, ipos=[0, 0, 0])
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
        joint.solref_friction, joint.solimp_friction = _DRY
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
