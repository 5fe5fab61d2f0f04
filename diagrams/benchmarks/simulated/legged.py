"""Logs of legged robots simulated by MuJoCo: hidden effects, motions, and sensors."""

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
    """A robot, its hidden effect, and the settings of its logs."""

    robot: str
    hidden: str = QUIET
    motions: tuple[str, ...] = (SWAY, TROT)
    contacts: str = FLAGS
    wrenches: bool = False
    efforts: bool = True
    noise: float = 1.0  # scale of the noise of all sensors; 0 for exact logs
    rate: float = 200.0
    duration: float = 40.0
    number: int = 0
    seed: int = 0

    def rng(self, purpose: str) -> Generator:
        """Return a random generator for a purpose of this draw."""
        words = f"{self.robot} {self.hidden} {purpose}"
        return np.random.default_rng([self.seed, self.number, number_of(words)])


_HIDDEN = (  # robot, hidden effect, contacts, whether wrenches and efforts are logged
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
    """Return twenty draws with hidden effects, and four without between them."""
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
_POINT_INERTIA = 1e-5  # kg·m², of point masses in a file


@dataclass(frozen=True)
class Robot:
    """A robot with legs."""

    path: str
    trunk: str  # the link that carries a payload
    limbs: tuple[str, ...]  # links that may be heavier than in the file
    # Frame of each foot, with the joints of its leg from the trunk on.
    feet: Mapping[str, tuple[str, ...]]
    posture: Mapping[str, float]  # joint positions of the standing robot, rad; 0 for others
    # stiffness, damping: Gains of joints by a pattern of their names, N·m/rad and N·m·s/rad.
    stiffness: Mapping[str, float]
    damping: Mapping[str, float]
    sway: tuple[float, ...]  # half range of the trunk along x, y, z, m, and about them, rad
    # Dry and viscous friction of a joint, N·m and N·m·s/rad, relative to its stiffness.
    friction: tuple[float, float]
    rotor: Mapping[str, float]  # reflected inertia of joints by a pattern of their names, kg·m²
    # Half length and half width of a sole, m; zeros for a foot that is a point.
    sole: tuple[float, float] = (0.0, 0.0)
    swing: float = 0.0  # half range of joints outside the legs, rad
    pace: float = 1.0  # speed of sways relative to that of a quadruped
    period: float | None = None  # of a trot, s; None if the robot only stands
    lift: float = 0.0  # height of a swinging foot, m
    fixed: tuple[str, ...] = ()  # prefixes of the names of joints that are fixed
    # Least and largest mass of a payload relative to the robot's.
    payload: tuple[float, float] = (0.05, 0.2)
    reach: float = 0.1  # largest distance of it from the trunk's origin along each axis, m
    # Joint -> axis along which it balances the centre of mass above the feet, and sign.
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
    """Return the URDF of a robot without meshes, friction and fingers, valid for MuJoCo.

    Massless links lose their inertia, and point masses get a small one.
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
    """Return the values (n,) of the first patterns that match the joints' names."""
    return np.array(
        [
            next(x for pattern, x in values.items() if fnmatchcase(joint, pattern))
            for joint in joints
        ]
    )


STEP = 5e-4  # s
BALL = 2e-3  # m, radius of the balls that touch the ground
_SOFTNESS = (0.01, 1.0)  # time constant, s, and damping ratio of a contact
_TOLERANCE = 1e-15  # of MuJoCo's contact solver
# Time constant and impedance of dry friction: with MuJoCo's defaults it increases with the speed up
# to some tenths of a radian per second.
_DRY = (2.0 * STEP, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
_GROUND = "ground"


@dataclass(frozen=True)
class Secret:
    """Differences between the simulated robot and its file."""

    # mass, place, inertia: Cubic payload: kg, m in the trunk's axes, kg·m².
    mass: float = 0.0
    place: tuple[float, ...] = (0.0, 0.0, 0.0)
    inertia: float = 0.0
    limb: str = ""  # heavier link; "" for none
    # scale, shift: Its mass and inertia relative to the file, and the shift of its centre, m.
    scale: float = 1.0
    shift: tuple[float, ...] = (0.0, 0.0, 0.0)
    # friction, damping, rotor: By joint: N·m, N·m·s/rad, kg·m².
    friction: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()
    rotor: tuple[float, ...] = ()
    # Joint with a wrong effort gain, and the factor; None for none.
    gain: tuple[str, float] | None = None
    # Foot with a sensor offset, and the wrench; None for none.
    offset: tuple[str, tuple[float, ...]] | None = None


def secret_of(draw: Draw) -> Secret:
    """Return the hidden effect of a draw."""
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
    """Compile the model of a robot on the ground with its hidden mechanical effects."""
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
    """Return the centres of the balls that touch the ground, in the frame of a foot."""
    if not any(robot.sole):
        return [(0.0, 0.0, 0.0)]
    length, width = robot.sole
    return [(x, y, BALL) for x in (-length, length) for y in (-width, width)]


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of all joints except the free one."""
    return tuple(model.joint(k).name for k in range(1, model.njnt))


def foot_wrench(
    model: mujoco.MjModel, data: mujoco.MjData, feet: tuple[str, ...]
) -> tuple[Array, Array]:
    """Return whether feet (F,) touch the ground, and its wrenches on them (F, 6).

    Wrenches are forces and torques about the feet's origins, in their frames.
    """
    bodies = [model.body(foot).id for foot in feet]
    touching, wrenches = np.zeros(len(feet), bool), np.zeros((len(feet), 6))
    contact_wrench = np.zeros(6)
    for k in range(data.ncon):
        contact: Any = data.contact[k]
        ground, foot = contact.geom1, contact.geom2
        sign = 1.0
        if model.geom(foot).name == _GROUND:
            ground, foot, sign = foot, ground, -1.0
        index = bodies.index(int(model.geom_bodyid[foot]))
        mujoco.mj_contactForce(model, data, k, contact_wrench)
        axes = contact.frame.reshape(3, 3).T
        force, torque = sign * axes @ contact_wrench[:3], sign * axes @ contact_wrench[3:]
        turn = data.xmat[bodies[index]].reshape(3, 3)
        arm = contact.pos - data.xpos[bodies[index]]
        wrenches[index, :3] += turn.T @ force
        wrenches[index, 3:] += turn.T @ (torque + np.cross(arm, force))
        touching[index] |= contact_wrench[0] > 0.0
    return touching, wrenches


_RATE = 100.0  # Hz, of targets
_RAMP = 2.0  # s, to blend in a motion
_WAVES = ((0.15, 0.4), (0.4, 0.9), (0.9, 1.8))  # Hz
_SHARES = (0.5, 0.35, 0.15)
_STANCE = 0.6  # stance share of a trot's period
_ITERATIONS = 4
_DAMPING = 1e-8
_ROOM = 0.8  # largest swing relative to the distance to the nearer joint limit


def standing(model: mujoco.MjModel, robot: Robot) -> Array:
    """Return the positions of root and joints of the standing robot."""
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
    """Return the start of a robot, and its joints' targets and rates as functions of time."""
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
    targets = np.array(
        [
            legs.reach(place, other, lift)
            for place, other, lift in zip(sway, swing[:, 6:], lifts, strict=True)
        ]
    )
    spline = CubicSpline(time, targets)
    return start, spline, spline.derivative()


class _Legs:
    """Inverse kinematics of legs, started at the previous solution."""

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
        """Return positions of all joints for a displacement (6,) of the trunk and heights of feet.

        `other` are displacements of all joints; those of legs are ignored.
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
        """Do one iteration for each foot."""
        model, data = self._model, self._data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        translation, rotation = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for k, (foot, leg) in enumerate(zip(self._feet, self.columns, strict=True)):
            mujoco.mj_jacBody(model, data, translation, rotation, foot)
            error = self._places[k] + [0.0, 0.0, lift[k]] - data.xpos[foot]
            jacobian = translation[:, leg]
            if self._has_soles:
                quaternion, angle = np.zeros(4), np.zeros(3)
                turn = self._turns[k] @ data.xmat[foot].reshape(3, 3).T
                mujoco.mju_mat2Quat(quaternion, turn.ravel())
                mujoco.mju_quat2Vel(angle, quaternion, 1.0)
                error = np.concatenate([error, angle])
                jacobian = np.vstack([jacobian, rotation[:, leg]])
            damped = jacobian.T @ jacobian + _DAMPING * np.eye(len(leg))
            data.qpos[np.add(leg, 1)] += np.linalg.solve(damped, jacobian.T @ error)


def _waves(time: Array, rng: Generator) -> Array:
    """Return a sum of waves between −1 and 1, with random frequencies and phases."""
    total = np.zeros_like(time)
    for (low, high), share in zip(_WAVES, _SHARES, strict=True):
        frequency, phase = rng.uniform(low, high), rng.uniform(0.0, 2.0 * np.pi)
        total += share * np.sin(2.0 * np.pi * frequency * time + phase)
    return total


def _lifts(robot: Robot, time: Array, rng: Generator) -> Array:
    """Return the heights of feet in a trot, in which diagonal feet swing together."""
    period = (robot.period or 1.0) * rng.uniform(0.9, 1.1)
    lifts = np.zeros((len(time), len(robot.feet)))
    for k in range(len(robot.feet)):
        phase = time / period + (0.5 if k in (1, 2) else 0.0)
        swing = (phase % 1.0 - _STANCE) / (1.0 - _STANCE)
        lifts[:, k] = robot.lift * np.where(swing > 0.0, np.sin(np.pi * swing.clip(0.0)) ** 2, 0.0)
    return lifts


_SETTLING = 1.0  # s, simulated before a log begins
_ENCODER, _TACHO = 2e-4, 5e-3  # rad, rad/s
_GYRO, _FORCE = 5e-3, 0.05  # rad/s, m/s²
_PLACE, _TURN = 1.5e-3, np.deg2rad(0.15)  # m, rad, drift of the base
_WHITE = 0.1  # white noise relative to the drift
_SLOWNESS = 5.0  # s, time constant of the drift
_VELOCITY = 0.01  # m/s, of the base
_EFFORT, _WRENCH = 0.01, 0.005  # of the range of a joint's effort, and of the weight
_ARM = 0.05  # m, of a foot sensor
_WRONG = 0.1
_EVERY = 17  # samples between those checked
_UPRIGHT = 0.7
_HOLD, _BRAKE = 1000.0, 300.0  # N·m/m and N·m·s/m, ankle gains for the centre of mass
_XYZ = "xyz"


@dataclass(frozen=True, eq=False)
class Motion:
    """A simulated motion without noise."""

    model: mujoco.MjModel
    # joints, feet: Their names.
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    time: Array  # (N,) s
    # q, v, a: MuJoCo's positions, velocities and accelerations.
    q: Array
    v: Array
    a: Array
    effort: Array  # (N, n) efforts of the motors
    touching: Array  # (N, F) whether feet touch the ground
    wrench: Array  # (N, F, 6) of the ground on feet

    @property
    def rate(self) -> Array:
        """Velocities at the sample: MuJoCo's are those of half a step before."""
        return self.v + 0.5 * STEP * self.a


@dataclass(frozen=True, eq=False)
class Recording:
    """Files of a draw, and the truth about them."""

    # model, logs: Paths of the URDF and of the tables.
    model: Path
    logs: tuple[Path, ...]
    secret: Secret  # differences from the file
    # Joint -> deviation of its effort in all logs, N·m; empty without efforts.
    deviations: Mapping[str, float]
    same: tuple[str, ...]  # links welded to the trunk
    # Largest error of MuJoCo's inverse dynamics with the feet's wrenches, before noise, relative to
    # the largest effort.
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
    """Return the relative error of inverse dynamics with measured wrenches, at some samples.

    Contacts are disabled; wrenches and MuJoCo's Jacobians replace them.
    """
    model = compiled(name, secret)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, worst = mujoco.MjData(model), 0.0
    translation, rotation = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for k in range(0, len(motion.time), _EVERY):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.q[k], motion.v[k], motion.a[k]
        mujoco.mj_inverse(model, data)
        residual = data.qfrc_inverse.copy()
        residual[6:] -= motion.effort[k]
        for foot, wrench in zip(motion.feet, motion.wrench[k], strict=True):
            body = model.body(foot).id
            axes = data.xmat[body].reshape(3, 3)
            mujoco.mj_jacBody(model, data, translation, rotation, body)
            residual -= translation.T @ (axes @ wrench[:3]) + rotation.T @ (axes @ wrench[3:])
        worst = max(worst, float(np.abs(residual).max()))
    return worst / float(np.abs(motion.effort).max())


def _welded(model: mujoco.MjModel, link: str) -> tuple[str, ...]:
    """Return all links that are welded to a link."""
    weld = model.body_weldid[model.body(link).id]
    return tuple(model.body(k).name for k in np.flatnonzero(model.body_weldid == weld))


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
    interval = round(1.0 / (draw.rate * STEP))
    begin, steps = round(_SETTLING / STEP), round(length / STEP)
    times = np.arange(steps) * STEP
    targets, rates = target(times), rate(times)
    mujoco.mj_forward(model, data)
    places = [data.body(foot).xpos[:2] for foot in feet]
    center, before = np.mean(places, axis=0), data.subtree_com[0, :2].copy()
    balance = [(joints.index(joint), *push) for joint, push in robot.balance.items()]
    samples: list[tuple[Array, ...]] = []
    for k in range(steps):
        effort = stiffness * (targets[k] - data.qpos[7:]) + damping * (rates[k] - data.qvel[6:])
        now = data.subtree_com[0, :2].copy()
        push = _HOLD * (now - center) + _BRAKE * (now - before) / STEP
        before = now
        for joint, axis, sign in balance:
            effort[joint] += sign * push[axis]
        data.qfrc_applied[6:] = effort
        if k < begin or k % interval:
            mujoco.mj_step(model, data)
            continue
        mujoco.mj_forward(model, data)
        samples.append(
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
    stacked = [np.array(each) for each in zip(*samples, strict=True)]
    time = np.arange(len(samples)) / draw.rate
    return Motion(model, joints, feet, time, *stacked)


def log_columns(draw: Draw, secret: Secret, motion: Motion, rng: Generator) -> Mapping[str, Array]:
    """Return the measurements of a motion, by the names of columns."""
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
    position = motion.q[:, :3] + noise * _PLACE * _drift(draw, size, rng)
    rotation = noise * _TURN * _drift(draw, size, rng)
    quaternion = np.empty((size, 4))
    force, linear = np.empty((size, 3)), np.empty((size, 3))
    gravity = motion.model.opt.gravity
    for k in range(size):
        quaternion[k] = motion.q[k, 3:7]
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, quaternion[k])
        axes = axes.reshape(3, 3)
        force[k] = axes.T @ (motion.a[k, :3] - gravity)
        linear[k] = axes.T @ motion.rate[k, :3]
        mujoco.mju_quatIntegrate(quaternion[k], rotation[k], 1.0)
    angular = motion.rate[:, 3:6]

    def measured(values: Array, deviation: float) -> Array:
        return values + noise * deviation * rng.normal(size=values.shape)

    return {
        **_axes("base.position", position),
        **{f"base.orientation.{n}": quaternion[:, i] for i, n in enumerate("wxyz")},
        **_axes("base.linear_velocity", measured(linear, _VELOCITY)),
        **_axes("base.angular_velocity", measured(angular, _GYRO)),
        **_axes("imu.angular_velocity", measured(angular, _GYRO)),
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
    """Return slow noise (N, 3) of unit deviation, with a little white noise."""
    memory = np.exp(-1.0 / (draw.rate * _SLOWNESS))
    slow = coloured(rng.normal(size=(size, 3)), memory)
    return slow + _WHITE * rng.normal(size=(size, 3))


def _axes(name: str, values: Array) -> dict[str, Array]:
    return {f"{name}.{axis}": values[:, i] for i, axis in enumerate(_XYZ)}
