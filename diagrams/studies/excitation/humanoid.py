"""Robots on one foot, [Lee2019] §4.6.3: Atlas from a folder of its own, or a small one of ours.

The left sole is the ground's frame: both are welded together there, so that a robot in balance is a
tree with a fixed base, and what the force plate under it measures is the base wrench.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia

from geodrake.inertia import inertial_parameters
from geodrake.model import RobotModel
from geodrake.robot.files.description import drake_messages

ATLAS = Path("reference") / "atlas_v5.urdf"
SOLE = "l_foot_sole"
HALF_SOLE = np.array([0.13, 0.06])
"""Half length and half width of the sole, m; the length is Atlas's, the width is ours."""
STANCE = ("l_leg_akx", "l_leg_aky")
GROUPS = {
    "hip": r"leg_hp",
    "knee": r"leg_kn",
    "ankle": r"leg_ak",
    "waist": r"back_",
    "shoulder": r"arm_sh",
    "elbow": r"arm_el",
    "wrist": r"arm_(uw|mw|lw)",
}
"""Joints of table 4.4 by name."""

_X, _Y, _Z = np.eye(3)
_LEG, _TRUNK = (0.08, 0.08, 0.4), (0.2, 0.3, 0.4)
_SMALL = (
    # joint, parent, place of the joint in the parent, axis, mass, box about its centre, its centre
    ("l_leg_akx", None, (0, 0, 0.08), _X, 0.5, (0.05, 0.05, 0.05), (0, 0, 0)),
    ("l_leg_aky", "l_leg_akx", (0, 0, 0), _Y, 3.0, _LEG, (0, 0, 0.2)),
    ("l_leg_kny", "l_leg_aky", (0, 0, 0.4), _Y, 5.0, _LEG, (0, 0, 0.2)),
    ("l_leg_hpy", "l_leg_kny", (0, 0, 0.4), _Y, 1.0, (0.1, 0.1, 0.1), (0, -0.02, 0)),
    ("l_leg_hpx", "l_leg_hpy", (0, 0, 0), _X, 8.0, (0.2, 0.25, 0.15), (0, -0.1, 0.05)),
    ("back_bky", "l_leg_hpx", (0, -0.1, 0.12), _Y, 20.0, _TRUNK, (0, 0, 0.25)),
    ("l_arm_shx", "back_bky", (0, 0.2, 0.4), _X, 2.0, (0.07, 0.3, 0.07), (0, 0.15, 0)),
    ("l_arm_elx", "l_arm_shx", (0, 0.3, 0), _X, 1.5, (0.06, 0.25, 0.06), (0, 0.12, 0)),
    ("r_arm_shx", "back_bky", (0, -0.2, 0.4), _X, 2.0, (0.07, 0.3, 0.07), (0, -0.15, 0)),
    ("r_arm_elx", "r_arm_shx", (0, -0.3, 0), _X, 1.5, (0.06, 0.25, 0.06), (0, -0.12, 0)),
    ("r_leg_hpy", "l_leg_hpx", (0, -0.2, 0), _Y, 5.0, _LEG, (0, 0, -0.2)),
    ("r_leg_kny", "r_leg_hpy", (0, 0, -0.4), _Y, 3.0, _LEG, (0, 0, -0.2)),
)


def standing_robot(shared: Path | None) -> RobotModel:
    """Atlas on its left foot, of the folder `shared`; our small robot if None.

    Its neck, which is not among the source's 29 joints, is held.
    """
    return _small() if shared is None else _atlas(shared / ATLAS)


def _atlas(path: Path) -> RobotModel:
    text = re.sub(r"<safety_controller[^>]*/>", "", path.read_text(encoding="utf-8"))
    text = re.sub(r'(name="neck_ay"\s+type=)"revolute"', r'\1"fixed"', text)
    plant = MultibodyPlant(0.0)
    with drake_messages():
        Parser(plant).AddModelsFromString(text, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(SOLE), RigidTransform())
    plant.Finalize()
    return RobotModel(plant, path, False, inertial_parameters(plant))


def _small() -> RobotModel:
    plant, reach = MultibodyPlant(0.0), 1.0
    for name, parent, place, axis, mass, box, center in _SMALL:
        P = plant.world_body() if parent is None else plant.GetBodyByName(parent)
        inertia = SpatialInertia.SolidBoxWithMass(mass, *box)
        B = plant.AddRigidBody(name, inertia.Shift(-np.array(center, float)))
        frame = FixedOffsetFrame(f"{name}_F", P.body_frame(), RigidTransform(np.array(place)))
        F = plant.AddFrame(frame)
        joint = plant.AddJoint(RevoluteJoint(name, F, B.body_frame(), axis, -reach, reach))
        joint.set_velocity_limits([-12.0], [12.0])
    plant.Finalize()
    return RobotModel(plant, Path("standing"), False, inertial_parameters(plant))


def groups(model: RobotModel) -> dict[str, np.ndarray]:
    """Indices of the joints of every group that the robot has."""
    found = {
        group: np.array([i for i, joint in enumerate(model.joints) if re.search(pattern, joint)])
        for group, pattern in GROUPS.items()
    }
    return {group: indices for group, indices in found.items() if len(indices)}
