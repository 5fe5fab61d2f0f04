"""A robot's file with all that the format holds of a model: a copy of the user's own, or anew."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis

from geodrake.inertia import Array
from geodrake.model.export import export_bodies, file_kind
from geodrake.model.exporting.from_plant import SUFFIXES, from_plant
from geodrake.model.exporting.joints import all_numbers, changed_numbers, exported_joints
from geodrake.model.exporting.mjcf_actuators import with_actuators
from geodrake.model.file_terms import Tilt
from geodrake.model.robot_model import RobotModel, is_of_file
from geodrake.robot.files.joint_text import with_gravity, with_joint_numbers, without_passive_forces
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.reading import model_text_of
from geodrake.robot.files.references import with_references
from geodrake.robot.files.xacro_file import read_expanded


def written_kind(model: RobotModel, kinds: Sequence[str]) -> str:
    """Return the format that an export writes: that of the robot's own file if it may be.

    Args:
        kinds: The formats that it may be, the usual one first: urdf, sdf, xml for MJCF.
    """
    own = own_kind(model)
    return own if own in kinds else kinds[0]


def own_kind(model: RobotModel) -> str:
    """Return the format of the robot's file if it can be edited; nothing for directives."""
    return "" if model.path.suffix.lower() in (".yaml", ".yml") else file_kind(model)


def stands_as_it_is(model: RobotModel, kind: str) -> bool:
    """Return whether a model has the effects of its own file, which an export of a kind copies."""
    return kind == "xml" == own_kind(model) and is_of_file(model)


def model_file(
    model: RobotModel, kind: str, folder: Path, *, stands: bool = False
) -> tuple[str, bytes, tuple[str, ...]]:
    """Return the name of a robot's file with all that it can hold of a model, the file, and notes.

    That is a copy of the user's own file if it has the format, expanded if it is of xacro, and
    else a new one of bodies and joints alone.

    Args:
        model: The model, of effects that the format holds.
        folder: Where the file will be: relative paths in it lead from there.
        stands: Whether the model has the effects of its own file.

    Raises:
        ModelError: The file cannot take the numbers, or the robot cannot be written anew.
    """
    name = f"{model.path.name.partition('.')[0]}{SUFFIXES[kind]}"
    if own_kind(model) == kind:
        macros = model.path.suffix.lower() == ".xacro"
        return name if macros else model.path.name, *_edited(model, folder, stands)
    note = (
        f"{name} is made of the bodies and joints of {model.path.name}, without geometry; links "
        "that are welded together are one"
    )
    data = from_plant(model, kind, _tilted_gravity(model))
    if kind != "xml":
        return name, data, (note,)
    data, more = with_actuators(data, folder / name, model, anew=True)
    return name, data, (note, *more)


def _edited(model: RobotModel, folder: Path, stands: bool) -> tuple[bytes, tuple[str, ...]]:
    """Return the user's file with what it holds of a model, and notes; the rest stays.

    Of an MJCF, forces that are no joint's own only stay where the model has all effects of it.
    """
    exported = export_bodies(model)
    data, path = exported.content, model.path
    changes = {} if stands else changed_numbers(model)
    bare = data if stands else without_passive_forces(data, path)
    if bare != data:
        data, changes = bare, all_numbers(model)
    text = model_text_of(read_expanded(path, model.given), path)
    if isinstance(text, MjcfText) and text.degrees:
        for joint in exported_joints(model).values():
            if joint.turns and "rest" in changes.get(joint.scoped, {}):
                changes[joint.scoped]["rest"] = float(np.rad2deg(joint.rest))
    data = with_joint_numbers(data, path, changes)
    acting = _notes_on_limits(model)
    if text.kind == "xml":
        if any(isinstance(fitted.effect, Tilt) for fitted in model.effects):
            data = with_gravity(data, path, _tilted_gravity(model))
        data, acting = with_actuators(data, path, model, anew=False)
    moved = with_references(data, path, folder)
    elsewhere = (
        f"meshes and other files that {path.name} names stay where they are; the copy names them "
        "from its folder"
    )
    return moved, (*exported.notes, *acting, *([elsewhere] if moved != data else ()))


def _notes_on_limits(model: RobotModel) -> tuple[str, ...]:
    """Return notes on limits of effort and motors that logs contradict, and a file keeps."""
    known = model.known_effort_limits
    less = [
        f"{joint} {limit:.3g} {'N' if joint in model.sliding_joints else 'N·m'}"
        for joint, limit, of_file in zip(model.joints, known, model.effort_limits, strict=True)
        if limit != of_file
    ]
    stay = f"limits of effort in {model.path.name} stay as they are; the model knows of less: "
    idle = ", ".join(model.motorless)
    none = f"{idle} had no motor in logs; {model.path.name} stays as it is there"
    return (*([f"{stay}{', '.join(less)}"] if less else []), *([none] if idle else []))


def _tilted_gravity(model: RobotModel) -> Array:
    """Return (3,) gravity in the frame of a model's base, as that is turned, m/s²."""
    gravity = np.array(model.plant.gravity_field().gravity_vector())
    return np.asarray(tilt_rotation(model).T @ gravity)


def tilt_rotation(model: RobotModel) -> Array:
    """Return (3, 3) rotation R(θ) by which a model's base is turned against its file's."""
    turn = np.eye(3)
    for fitted in model.effects:
        if isinstance(fitted.effect, Tilt):
            vector = np.array([*fitted.parameters, 0.0])
            angle = float(np.linalg.norm(vector))
            if angle:
                turn = AngleAxis(angle, vector / angle).rotation() @ turn
    return np.asarray(turn)
