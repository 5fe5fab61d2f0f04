"""Two quadrupeds and a humanoid of the package example-robot-data, and how they stand and move."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from importlib.metadata import distribution

_FOLDER = "cmeel.prefix/share/example-robot-data/robots"
_NEGLIGIBLE = 1e-5  # kg
_POINT_INERTIA = 1e-5  # kg·m², of masses that a file calls points


@dataclass(frozen=True)
class Robot:
    """A robot with legs.

    Attributes:
        path: Its URDF in the package.
        trunk: The link that carries a payload.
        limbs: Links that may be heavier than the file says.
        feet: Frame of each foot, with the joints of its leg from the trunk on.
        posture: Positions of joints where it stands, rad; 0 for others.
        stiffness, damping: Gains of joints by a pattern of their names, N·m/rad and N·m·s/rad.
        sway: Half range of the trunk along x, y, z, m, and about them, rad.
        sole: Half length and half width of a sole, m; zeros for a foot that is a point.
        swing: Half range of joints outside the legs, rad.
        pace: Speed of sways over that of a quadruped.
        period: Of a trot, s; None where the robot only stands.
        lift: Height of a swinging foot, m.
        friction: Dry and viscous friction of a joint, N·m and N·m·s/rad, over its stiffness.
        rotor: Reflected inertia of joints by a pattern of their names, kg·m².
        payload: Least and largest mass of a payload, as shares of the robot's.
        reach: How far it is from the trunk's origin along each axis at most, m.
        fixed: How names of joints begin that are held fixed.
        balance: Axis along which a joint holds the centre of mass above the feet, and its sign.
    """

    path: str
    trunk: str
    limbs: tuple[str, ...]
    feet: Mapping[str, tuple[str, ...]]
    posture: Mapping[str, float]
    stiffness: Mapping[str, float]
    damping: Mapping[str, float]
    sway: tuple[float, ...]
    friction: tuple[float, float]
    rotor: Mapping[str, float]
    sole: tuple[float, float] = (0.0, 0.0)
    swing: float = 0.0
    pace: float = 1.0
    period: float | None = None
    lift: float = 0.0
    fixed: tuple[str, ...] = ()
    payload: tuple[float, float] = (0.05, 0.2)
    reach: float = 0.1
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
    path = distribution("example-robot-data").locate_file(f"{_FOLDER}/{robot.path}")
    root = ET.parse(str(path)).getroot()
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
