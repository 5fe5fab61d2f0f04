"""The links of a robot with the joint that moves each: what every format writes down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Joint

from geodrake.errors import ModelError
from geodrake.inertia import Array, change_frame
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model.exporting.joint_numbers import JointNumbers, joint_numbers
from geodrake.model.robot_model import RobotModel


@dataclass(frozen=True, eq=False)
class Link:
    """A body that a joint moves; its frame L is that of the joint, on the side of the body.

    Attributes:
        name: Name of the body.
        parent: Name of the body that carries it; None for the world.
        joint: Name of the joint.
        X_PL: Pose of the link in the frame of the parent, with the joint at zero.
        axis: (3,) unit axis of the joint, in L.
        limits: Lowest and highest position, rad or m; infinite where there is none.
        velocity: Largest speed, rad/s or m/s; infinite where there is none.
        effort: Largest effort, N·m or N; infinite where there is none.
        numbers: Damping, friction, rotor inertia and spring of the joint.
        phi: (10,) inertial parameters about Lo, expressed in L.
    """

    name: str
    parent: str | None
    joint: str
    X_PL: RigidTransform
    axis: Array
    limits: tuple[float, float]
    velocity: float
    effort: float
    numbers: JointNumbers
    phi: Array


def links_of(model: RobotModel) -> tuple[Link, ...]:
    """The links of a model from the base on, each after its parent; inertias with payloads.

    Args:
        model: The model, on a base that stands still.

    Raises:
        ModelError: It has joints that turn about or slide along more than one axis, or backwards.
    """
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    lumps, moving = lumped_bodies(plant), _moving_joints(model)
    names = [body.name.replace("::", "_") for body in lumps]
    owner = {int(m.index): k for k, body in enumerate(lumps) for m in body.members}
    inboard = {owner[int(joint.child_body().index())]: joint for joint in moving}
    X_WL = {k: joint.frame_on_child().CalcPoseInWorld(context) for k, joint in inboard.items()}
    found: dict[int, Link] = {}
    while len(found) < len(lumps):
        ready = {
            k: joint
            for k, joint in inboard.items()
            if k not in found
            and ((above := owner.get(int(joint.parent_body().index()))) is None or above in found)
        }
        if not ready:
            raise _refusal(moving[0], "points from a body to what carries it")
        for k, joint in ready.items():
            above = owner.get(int(joint.parent_body().index()))
            X_WP = RigidTransform() if above is None else X_WL[above]
            X_WR = plant.get_body(lumps[k].body_index).body_frame().CalcPoseInWorld(context)
            X_LR = X_WL[k].inverse() @ X_WR
            found[k] = Link(
                names[k],
                None if above is None else names[above],
                X_PL=X_WP.inverse() @ X_WL[k],
                phi=change_frame(model.total_phi[k], X_LR.rotation().matrix(), X_LR.translation()),
                **_of_joint(model, joint),
            )
    return tuple(found.values())


def _moving_joints(model: RobotModel) -> list[Joint]:
    plant = model.plant
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    moving = [joint for joint in joints if joint.num_velocities()]
    for joint in moving:
        if joint.type_name() not in ("revolute", "prismatic"):
            raise _refusal(joint, f"is of the type {joint.type_name()}")
    return sorted(moving, key=lambda joint: joint.velocity_start())


def _refusal(joint: Joint, problem: str) -> ModelError:
    return ModelError(
        f"The robot cannot be written in another format than its own: joint {joint.name()} "
        f"{problem}.",
        advice="Export it in the format of its own file.",
        joint=joint.name(),
    )


def _of_joint(model: RobotModel, joint: Joint) -> Mapping[str, Any]:
    at = model.coordinates.velocity_of(joint)
    axis = joint.revolute_axis() if joint.type_name() == "revolute" else joint.translation_axis()
    return {
        "joint": model.joints[at],
        "axis": np.array(axis),
        "limits": (
            float(joint.position_lower_limits()[0]),
            float(joint.position_upper_limits()[0]),
        ),
        "velocity": float(model.velocity_limits[at]),
        "effort": float(model.known_effort_limits[at]),
        "numbers": joint_numbers(model)[model.scoped_joints[at]],
    }
