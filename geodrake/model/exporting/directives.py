"""A robot for Drake: its own file, and model directives that put it where it stands."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.tree import BodyIndex, RigidBody

from geodrake.boundary.escaping import printable
from geodrake.model.export import repair_comments
from geodrake.model.exporting.export_format import Exported
from geodrake.model.exporting.held import HeldModel
from geodrake.model.exporting.model_text import model_file, own_kind, tilt_rotation, written_kind
from geodrake.model.robot_model import RobotModel

KINDS = ("sdf", "urdf")
"""Formats of the robot's file that directives add, the usual one first."""


def drake_files(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
    """Return a robot's file, the directives that add and weld it, and the package that they are.

    A tilted base is welded as it stands.

    Args:
        model: The whole model.
        held: What the files hold of it.
        folder: Where they will be.
    """
    kind = written_kind(model, KINDS)
    name, data, notes = model_file(held.model, kind, folder)
    package = re.sub(r"[^a-z0-9_]+", "_", folder.resolve().name.lower()).strip("_") or "robot"
    plant = model.plant
    roots, instance = [], name.partition(".")[0]
    if name == model.path.name:
        roots = _roots(held.model)
        last = plant.get_body(BodyIndex(plant.num_bodies() - 1))
        instance = plant.GetModelInstanceName(last.model_instance())
    lines = [
        "# Inertias, damping and rotors are those of the model; dry friction is in the file, but",
        "# Drake does not simulate it. parser.package_map().PopulateFromFolder(…) finds the file.",
        *(f"# {printable(each)}" for each in repair_comments(model)),
        "directives:",
        "- add_model:",
        f"    name: {json.dumps(instance)}",
        f"    file: package://{package}/{name}",
    ]
    for body, X_WB in roots:
        angles = (np.rad2deg(RollPitchYaw(X_WB.rotation()).vector()) + 0.0).tolist()
        lines += [
            "- add_weld:",
            "    parent: world",
            f"    child: {json.dumps(body.scoped_name().get_full())}",
            f"    X_PC: {{translation: {X_WB.translation().tolist()}, "
            f"rotation: !Rpy {{deg: {angles}}}}}",
        ]
    manifest = (
        f'<package format="2">\n  <name>{package}</name>\n  <version>0.0.0</version>\n'
        f"  <description>{model.path.stem}, by geodrake</description>\n"
        '  <maintainer email="nobody@example.com">nobody</maintainer>\n'
        "  <license>as the robot's own file</license>\n</package>\n"
    )
    files = {
        f"{model.path.stem}.dmd.yaml": ("\n".join(lines) + "\n").encode(),
        name: data,
        "package.xml": manifest.encode(),
    }
    return Exported(files, notes)


def stands_free(model: RobotModel) -> bool:
    """Whether the robot's own file leaves it free, so that directives decide how it stands."""
    if own_kind(model) not in KINDS:
        return False
    plant = model.plant
    joints = (plant.get_joint(index) for index in plant.GetJointIndices())
    on_world = [joint for joint in joints if joint.parent_body().index() == 0]
    return len(on_world) == len(_roots(model))


def _roots(model: RobotModel) -> list[tuple[RigidBody, RigidTransform]]:
    """The bodies that geodrake welds to the world, which the file leaves free, as they stand."""
    plant, tilt = model.plant, RotationMatrix(tilt_rotation(model))
    found = []
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        welded = joint.type_name() == "weld" and joint.parent_body().index() == 0
        if welded and not model.floating and joint.name().startswith("world_welds_to_"):
            X_WB = joint.frame_on_parent().GetFixedPoseInBodyFrame()
            found.append((joint.child_body(), RigidTransform(tilt, np.zeros(3)) @ X_WB))
    return found
