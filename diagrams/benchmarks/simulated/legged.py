"""Logs of a robot on its feet in MuJoCo: what it hides, how it moves, and what sensors say."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from diagrams.benchmarks.simulated.engines import GRAVITY, Array, Generator, bare, number_of
from diagrams.benchmarks.simulated.recording import coloured
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

    def rng(self, purpose: str) -> Generator:
        """Return a generator of random numbers for a purpose of this draw."""
        words = f"{self.robot} {self.hidden} {purpose}"
        return np.random.default_rng([self.seed, self.number, number_of(words)])


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
    root = bare(installed_model(robot.path))
    for link in root.iter("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            _mend(link, inertial)
    for joint in root.iter("joint"):
        if joint.get("name", "").startswith(robot.fixed or "no joint"):
            joint.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")


def _mend(link: ET.Element, inertial: ET.Element) -> None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None or float(mass.get("value", "0")) <= _NEGLIGIBLE:
        link.remove(inertial)
    elif not any(float(value) for value in inertia.attrib.values()):
        inertia.attrib.update(dict.fromkeys(("ixx", "iyy", "izz"), str(_POINT_INERTIA)))


def by_names(values: Mapping[str, float], joints: tuple[str, ...]) -> Array:
    """Return the value (n,) of the first pattern that each joint's name has."""
    return np.array(
        [
            next(x for pattern, x in values.items() if fnmatchcase(joint, pattern))
            for joint in joints
        ]
    )


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
    if draw.hidden == PAYLOAD:
        mass, size = float(rng.uniform(*robot.payload)) * weight, robot.reach
        place = rng.uniform((-size, -size, 0.0), (size, size, 2.0 * size))
        return Secret(mass=mass, place=tuple(place.tolist()), inertia=mass * size**2 / 6.0)
    if draw.hidden == LIMB:
        limb, shift = str(rng.choice(robot.limbs)), rng.normal(size=3)
        length = 2.0 * float(np.linalg.norm(plain.body(limb).ipos))
        shift *= 0.1 * length / np.linalg.norm(shift)
        return Secret(limb=limb, scale=1.4, shift=tuple(shift.tolist()))
    if draw.hidden == DRIVES:
        usual = [share * by_names(robot.stiffness, joints) for share in robot.friction]
        usual.append(by_names(robot.rotor, joints))
        values = (tuple((x * rng.uniform(0.7, 1.4, len(joints))).tolist()) for x in usual)
        return Secret(**dict(zip(("friction", "damping", "rotor"), values, strict=True)))
    if draw.hidden == GAIN:
        legs = [joint for leg in robot.feet.values() for joint in leg]
        return Secret(gain=(str(rng.choice(legs)), float(rng.choice((0.85, 1.15)))))
    if draw.hidden == FOOT:
        size = -GRAVITY[2] * weight * np.array([0.02] * 2 + [0.05] + [2e-3] * 3)
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


_RATE = 100.0  # Hz, of targets
_RAMP = 2.0  # s, until a motion is whole
_WAVES = ((0.15, 0.4), (0.4, 0.9), (0.9, 1.8))  # Hz
_SHARES = (0.5, 0.35, 0.15)
_STANCE = 0.6  # share of a trot's period in which a foot stands
_ITERATIONS = 4
_DAMPING = 1e-8
_ROOM = 0.8  # of the way to the nearer limit of a joint, which a swing takes


def standing(model: mujoco.MjModel, robot: Robot) -> Array:
    """Return positions of the root and the joints where the feet stand on the ground."""
    data = mujoco.MjData(model)
    names = joint_names(model)
    data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    data.qpos[7:] = [robot.posture.get(joint, 0.0) for joint in names]
    mujoco.mj_kinematics(model, data)
    heights = [data.body(foot).xpos[2] for foot in robot.feet]
    data.qpos[2] = -min(heights)
    return data.qpos.copy()


def joint_targets(
    name: str, motion: str, duration: float, rng: Generator
) -> tuple[Array, Callable[[Array], Array], Callable[[Array], Array]]:
    """Return where a robot starts, and targets of its joints and their rates by time."""
    robot, model = ROBOTS[name], compiled(name, Secret())
    start = standing(model, robot)
    time = np.arange(0.0, duration + 2.0 / _RATE, 1.0 / _RATE)
    ramp = np.clip(time / _RAMP, 0.0, 1.0)
    ramp = ramp**2 * (3.0 - 2.0 * ramp)
    share = 0.5 if motion == TROT else 1.0
    sway = np.column_stack([share * half * _waves(robot.pace * time, rng) for half in robot.sway])
    sway *= ramp[:, None]
    lifts = np.zeros((len(time), len(robot.feet)))
    if motion == TROT:
        lifts = _lifts(robot, time, rng) * ramp[:, None]
    legs = _Legs(model, robot, start)
    swing = np.zeros((len(time), model.nv))
    for k in sorted({*range(6, model.nv)} - {k for leg in legs.columns for k in leg}):
        room = _ROOM * np.abs(model.jnt_range[k - 5] - start[k + 1]).min()
        swing[:, k] = min(robot.swing, room) * ramp * _waves(robot.pace * time, rng)
    wanted = np.array(
        [
            legs.reach(place, other, lift)
            for place, other, lift in zip(sway, swing[:, 6:], lifts, strict=True)
        ]
    )
    spline = CubicSpline(time, wanted)
    return start, spline, spline.derivative()


class _Legs:
    """Joints of legs for places of the trunk and the feet, each from those before."""

    def __init__(self, model: mujoco.MjModel, robot: Robot, start: Array) -> None:
        self._model, self._data, self._start = model, mujoco.MjData(model), start
        self._data.qpos[:] = start
        mujoco.mj_kinematics(model, self._data)
        self._feet = [model.body(foot).id for foot in robot.feet]
        self._places = self._data.xpos[self._feet].copy()
        self._turns = self._data.xmat[self._feet].reshape(-1, 3, 3).copy()
        self._has_soles = any(robot.sole)
        self.columns = [
            [int(model.joint(joint).dofadr[0]) for joint in leg] for leg in robot.feet.values()
        ]

    def reach(self, sway: Array, other: Array, lift: Array) -> Array:
        """Return positions of all joints.

        Args:
            sway: (6,) way of the trunk from where it stands, and its angles.
            other: Ways of all joints; those of legs do not count.
            lift: Height of each foot.
        """
        data, start = self._data, self._start
        legs = np.concatenate([np.add(leg, 1) for leg in self.columns])
        before = data.qpos[legs].copy()
        data.qpos[:3] = start[:3] + sway[:3]
        mujoco.mju_euler2Quat(data.qpos[3:7], sway[3:], "xyz")
        data.qpos[7:] = start[7:] + other
        data.qpos[legs] = before
        for _ in range(_ITERATIONS):
            self._step(lift)
        return np.asarray(data.qpos[7:].copy())

    def _step(self, lift: Array) -> None:
        """Bring each foot nearer to its place."""
        model, data = self._model, self._data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        along, about = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for k, (foot, leg) in enumerate(zip(self._feet, self.columns, strict=True)):
            mujoco.mj_jacBody(model, data, along, about, foot)
            away = self._places[k] + [0.0, 0.0, lift[k]] - data.xpos[foot]
            jacobian = along[:, leg]
            if self._has_soles:
                quaternion, angle = np.zeros(4), np.zeros(3)
                turn = self._turns[k] @ data.xmat[foot].reshape(3, 3).T
                mujoco.mju_mat2Quat(quaternion, turn.ravel())
                mujoco.mju_quat2Vel(angle, quaternion, 1.0)
                away = np.concatenate([away, angle])
                jacobian = np.vstack([jacobian, about[:, leg]])
            damped = jacobian.T @ jacobian + _DAMPING * np.eye(len(leg))
            data.qpos[np.add(leg, 1)] += np.linalg.solve(damped, jacobian.T @ away)


def _waves(time: Array, rng: Generator) -> Array:
    """Return a sum of waves between −1 and 1, of random frequencies and phases, 0 at first."""
    found = np.zeros_like(time)
    for (low, high), share in zip(_WAVES, _SHARES, strict=True):
        frequency, phase = rng.uniform(low, high), rng.uniform(0.0, 2.0 * np.pi)
        found += share * np.sin(2.0 * np.pi * frequency * time + phase)
    return found


def _lifts(robot: Robot, time: Array, rng: Generator) -> Array:
    """Return the height of each foot in a trot, whose diagonal feet swing together."""
    period = (robot.period or 1.0) * rng.uniform(0.9, 1.1)
    found = np.zeros((len(time), len(robot.feet)))
    for k in range(len(robot.feet)):
        phase = time / period + (0.5 if k in (1, 2) else 0.0)
        swing = (phase % 1.0 - _STANCE) / (1.0 - _STANCE)
        found[:, k] = robot.lift * np.where(swing > 0.0, np.sin(np.pi * swing.clip(0.0)) ** 2, 0.0)
    return found


_SETTLING = 1.0  # s, simulated before a log begins
_ENCODER, _TACHO = 2e-4, 5e-3  # rad, rad/s
_GYRO, _FORCE = 5e-3, 0.05  # rad/s, m/s²
_PLACE, _TURN = 1.5e-3, np.deg2rad(0.15)  # m, rad, of the slow error of the base
_WHITE = 0.1  # of it, white
_SLOWNESS = 5.0  # s
_VELOCITY = 0.01  # m/s, of the base
_EFFORT, _WRENCH = 0.01, 0.005  # of the range of a joint, of the weight
_ARM = 0.05  # m, of a foot sensor
_WRONG = 0.1
_EVERY = 17  # samples, of which one is checked
_UPRIGHT = 0.7
_HOLD, _BRAKE = 1000.0, 300.0  # N·m/m and N·m·s/m of the centre of mass, of an ankle
_XYZ = "xyz"


@dataclass(frozen=True, eq=False)
class Motion:
    """What happened, exactly."""

    model: mujoco.MjModel
    # joints, feet: Their names.
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    time: Array  # (N,) s
    # q, v, a: Positions, rates and accelerations of MuJoCo.
    q: Array
    v: Array
    a: Array
    effort: Array  # (N, n) efforts of the motors
    touching: Array  # (N, F) whether a foot touches the ground
    wrench: Array  # (N, F, 6) of the ground on it

    @property
    def rate(self) -> Array:
        """Rates of the positions: MuJoCo's own are those of half a step before."""
        return self.v + 0.5 * STEP * self.a


@dataclass(frozen=True, eq=False)
class Recording:
    """Files of a draw, and what is true of them."""

    # model, logs: Paths of the URDF and of the tables.
    model: Path
    logs: tuple[Path, ...]
    secret: Secret  # what the file has not
    # Deviation of each joint's logged effort in all logs, N·m; empty without.
    deviations: Mapping[str, float]
    same: tuple[str, ...]  # links that are welded to the trunk
    # How far MuJoCo's inverse dynamics are from the logged efforts before noise, with the feet's
    # wrenches, as a share of the largest effort.
    inverse_error: float


def simulate(draw: Draw, folder: Path) -> Recording:
    """Write the URDF and the logs of a draw into a folder."""
    secret = secret_of(draw)
    urdf = folder / f"{draw.robot}.urdf"
    urdf.write_text(robot_text(draw.robot), encoding="utf-8")
    paths, errors, tables = [], [], []
    for k, _ in enumerate(draw.motions):
        motion = run(draw, secret, k)
        errors.append(inverse_error(draw.robot, secret, motion))
        tables.append(pd.DataFrame(log_columns(draw, secret, motion, draw.rng(f"noise of {k}"))))
        paths.append(folder / f"log{k + 1}.csv")
        tables[-1].to_csv(paths[-1], index=False, float_format="%.10g")
    efforts = pd.concat(tables).filter(like=".effort")
    deviations = {name.removesuffix(".effort"): float(efforts[name].std()) for name in efforts}
    same = _welded(motion.model, ROBOTS[draw.robot].trunk)
    return Recording(urdf, tuple(paths), secret, deviations, same, max(errors))


def inverse_error(name: str, secret: Secret, motion: Motion) -> float:
    """Return how far inverse dynamics with measured wrenches are from efforts, at some samples.

    Contacts are off: what they do comes from the wrenches and MuJoCo's Jacobians alone.
    """
    model = compiled(name, secret)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, worst = mujoco.MjData(model), 0.0
    along, about = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for k in range(0, len(motion.time), _EVERY):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.q[k], motion.v[k], motion.a[k]
        mujoco.mj_inverse(model, data)
        left = data.qfrc_inverse.copy()
        left[6:] -= motion.effort[k]
        for foot, wrench in zip(motion.feet, motion.wrench[k], strict=True):
            body = model.body(foot).id
            axes = data.xmat[body].reshape(3, 3)
            mujoco.mj_jacBody(model, data, along, about, body)
            left -= along.T @ (axes @ wrench[:3]) + about.T @ (axes @ wrench[3:])
        worst = max(worst, float(np.abs(left).max()))
    return worst / float(np.abs(motion.effort).max())


def _welded(model: mujoco.MjModel, link: str) -> tuple[str, ...]:
    """Return all links that nothing moves against a link."""
    own = model.body_weldid[model.body(link).id]
    return tuple(model.body(k).name for k in np.flatnonzero(model.body_weldid == own))


def run(draw: Draw, secret: Secret, log: int) -> Motion:
    """Simulate a log of a draw."""
    robot, model = ROBOTS[draw.robot], compiled(draw.robot, secret)
    joints, feet = joint_names(model), tuple(robot.feet)
    length = draw.duration + _SETTLING
    start, target, rate = joint_targets(
        draw.robot, draw.motions[log], length, draw.rng(f"motion of {log}")
    )
    stiffness, damping = by_names(robot.stiffness, joints), by_names(robot.damping, joints)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    every = round(1.0 / (draw.rate * STEP))
    begin, steps = round(_SETTLING / STEP), round(length / STEP)
    times = np.arange(steps) * STEP
    wanted, rates = target(times), rate(times)
    mujoco.mj_forward(model, data)
    places = [data.body(foot).xpos[:2] for foot in feet]
    center, before = np.mean(places, axis=0), data.subtree_com[0, :2].copy()
    balance = [(joints.index(joint), *push) for joint, push in robot.balance.items()]
    found: list[tuple[Array, ...]] = []
    for k in range(steps):
        effort = stiffness * (wanted[k] - data.qpos[7:]) + damping * (rates[k] - data.qvel[6:])
        now = data.subtree_com[0, :2].copy()
        push = _HOLD * (now - center) + _BRAKE * (now - before) / STEP
        before = now
        for joint, axis, sign in balance:
            effort[joint] += sign * push[axis]
        data.qfrc_applied[6:] = effort
        if k < begin or k % every:
            mujoco.mj_step(model, data)
            continue
        mujoco.mj_forward(model, data)
        found.append(
            (
                data.qpos.copy(),
                data.qvel.copy(),
                data.qacc.copy(),
                effort,
                *foot_wrench(model, data, feet),
            )
        )
        mujoco.mj_step(model, data)
    stands = 1.0 - 2.0 * (data.qpos[4] ** 2 + data.qpos[5] ** 2)
    if not stands > _UPRIGHT:
        raise RuntimeError(f"{draw.robot} falls over: {draw}")
    stacked = [np.array(each) for each in zip(*found, strict=True)]
    time = np.arange(len(found)) / draw.rate
    return Motion(model, joints, feet, time, *stacked)


def log_columns(draw: Draw, secret: Secret, motion: Motion, rng: Generator) -> Mapping[str, Array]:
    """Return what sensors say of a motion, by the names of columns."""
    noise = draw.noise

    def measured(values: Array, deviation: float | Array) -> Array:
        return values + noise * deviation * rng.normal(size=values.shape)

    columns: dict[str, Array] = {"time": motion.time}
    effort = motion.effort.copy()
    if secret.gain is not None:
        effort[:, motion.joints.index(secret.gain[0])] *= secret.gain[1]
    effort = measured(effort, _EFFORT * np.ptp(effort, axis=0))
    q, v = measured(motion.q[:, 7:], _ENCODER), measured(motion.rate[:, 6:], _TACHO)
    for k, joint in enumerate(motion.joints):
        columns[f"{joint}.position"] = q[:, k]
        columns[f"{joint}.velocity"] = v[:, k]
        if draw.efforts:
            columns[f"{joint}.effort"] = effort[:, k]
    columns |= _base_columns(draw, motion, rng)
    return columns | _foot_columns(draw, secret, motion, rng)


def _base_columns(draw: Draw, motion: Motion, rng: Generator) -> dict[str, Array]:
    """Return columns of the base's estimator and of the IMU."""
    size, noise = len(motion.time), draw.noise
    place = motion.q[:, :3] + noise * _PLACE * _drift(draw, size, rng)
    turn = noise * _TURN * _drift(draw, size, rng)
    quaternion = np.empty((size, 4))
    force, along = np.empty((size, 3)), np.empty((size, 3))
    gravity = motion.model.opt.gravity
    for k in range(size):
        quaternion[k] = motion.q[k, 3:7]
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, quaternion[k])
        axes = axes.reshape(3, 3)
        force[k] = axes.T @ (motion.a[k, :3] - gravity)
        along[k] = axes.T @ motion.rate[k, :3]
        mujoco.mju_quatIntegrate(quaternion[k], turn[k], 1.0)
    about = motion.rate[:, 3:6]

    def measured(values: Array, deviation: float) -> Array:
        return values + noise * deviation * rng.normal(size=values.shape)

    return {
        **_axes("base.position", place),
        **{f"base.orientation.{n}": quaternion[:, i] for i, n in enumerate("wxyz")},
        **_axes("base.linear_velocity", measured(along, _VELOCITY)),
        **_axes("base.angular_velocity", measured(about, _GYRO)),
        **_axes("imu.angular_velocity", measured(about, _GYRO)),
        **_axes("imu.linear_acceleration", measured(force, _FORCE)),
    }


def _foot_columns(draw: Draw, secret: Secret, motion: Motion, rng: Generator) -> dict[str, Array]:
    """Return columns of contacts and of the sensors of feet."""
    weight = 9.81 * float(motion.model.body_mass.sum())
    deviation = draw.noise * _WRENCH * weight * np.array([1.0] * 3 + [_ARM] * 3)
    columns: dict[str, Array] = {}
    for k, foot in enumerate(motion.feet):
        if draw.contacts != NO_FLAGS:
            touching = motion.touching[:, k].copy()
            if draw.contacts == WRONG_FLAGS:
                touching ^= rng.random(len(touching)) < _WRONG
            columns[f"{foot}.contact"] = touching.astype(int)
        if draw.wrenches:
            wrench = motion.wrench[:, k] + deviation * rng.normal(size=(len(motion.time), 6))
            if secret.offset is not None and secret.offset[0] == foot:
                wrench = wrench + secret.offset[1]
            columns |= _axes(f"{foot}.force", wrench[:, :3])
            columns |= _axes(f"{foot}.torque", wrench[:, 3:])
    return columns


def _drift(draw: Draw, size: int, rng: Generator) -> Array:
    """Return (N, 3) noise that varies slowly with deviation one, and a little white noise."""
    memory = np.exp(-1.0 / (draw.rate * _SLOWNESS))
    slow = coloured(rng.normal(size=(size, 3)), memory)
    return slow + _WHITE * rng.normal(size=(size, 3))


def _axes(name: str, values: Array) -> dict[str, Array]:
    return {f"{name}.{axis}": values[:, i] for i, axis in enumerate(_XYZ)}
