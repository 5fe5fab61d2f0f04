"""Export formats: the effects that each can express, and the files that it writes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.tree import BodyIndex, RigidBody

from geodrake.boundary.escaping import printable
from geodrake.control.export_proof.engines import (
    DrakeEngine,
    Engine,
    MujocoEngine,
    PinocchioEngine,
    PythonEngine,
)
from geodrake.control.export_proof.held import Holds
from geodrake.control.export_proof.joints import POSITIVE_TERMS, exported_joints
from geodrake.control.export_proof.model_text import (
    model_file,
    own_kind,
    sprung_in_file,
    stands_as_it_is,
    tilt_rotation,
    written_kind,
)
from geodrake.effects import Effect
from geodrake.effects.file_terms import Delay, Spring, StaticFriction, Tilt
from geodrake.errors import ArgumentError, ModelError, nearest
from geodrake.model.export import repair_comments
from geodrake.model.robot_model import RobotModel
from geodrake.model.source import effort_source, is_written

SIGN_WIDTH = 0.02
"""Speed below which dry friction fades, rad/s or m/s, so that controllers do not chatter."""

_FILES = {
    "package.xml": "package.xml",
    "CMakeLists.txt": "CMakeLists.txt",
    "plugin.xml": "plugin.xml",
    "feedforward.cpp": "src/feedforward.cpp",
    "feedforward.yaml": "config/feedforward.yaml",
    "README.md": "README.md",
}
"""Template -> its path in the package."""


@dataclass(frozen=True)
class Exported:
    """The files of an export."""

    files: Mapping[str, bytes]  # name in the folder -> content; the main file comes first
    notes: tuple[str, ...] = ()


Holding = Callable[[RobotModel], Holds]
"""Returns, for a model, which effects its files can express."""

Write = Callable[[RobotModel, RobotModel, Path], Exported]
"""Writes a model, given the model, the part that the format can express, and the folder."""


@dataclass(frozen=True)
class ExportFormat:
    """An export format."""

    name: str  # as in `--to`
    holding: Holding  # inertias and payloads can always be expressed
    write: Write
    engines: tuple[type[Engine], ...] = ()  # simulators in which the files are tested
    at_actuators: bool = False  # whether files support actuators behind a transmission
    servos: bool = False  # whether files contain servo gains


def ros2_files(model: RobotModel, held: RobotModel, folder: Path) -> Exported:
    """Return a colcon package with a chainable controller.

    Its efforts are those of the exported C++ function at zero acceleration.
    """
    count = len(model.joints)
    if len(model.single_joints) != count:
        raise ModelError(
            "A ros2_control controller needs joints with one degree of freedom, but the "
            "model has others.",
            advice="Export to cpp, and write a controller that calls the function.",
        )
    source = effort_source(held, "cpp", sign_width=SIGN_WIDTH)
    robot = source.file_name.removesuffix("_effort.hpp")
    package = re.sub(r"[^a-z0-9]+", "_", robot.lower()).strip("_") + "_feedforward"
    order = model.positions(np.arange(count, dtype=float)[None])[0]
    limits = [repr(float(limit)) for limit in model.effort_limits]
    values = {
        "package": package,
        "name": package,
        "robot": printable(model.path.stem),
        "namespace": f"{robot}_model",
        "header": source.file_name,
        "joints": json.dumps(model.joints, ensure_ascii=False),
        "limits": f"[{', '.join(limits)}]".replace("inf", ".inf"),
        "cpp_limits": ", ".join(limits).replace("inf", "std::numeric_limits<double>::infinity()"),
        "places": np.argsort(order).tolist(),
        "left_out": source.left_out,
        "sign_width": SIGN_WIDTH,
    }
    templates = jinja2.Environment(
        loader=jinja2.PackageLoader("geodrake.control.export_proof", "ros2_package"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    files = {
        path: templates.get_template(f"{template}.jinja").render(values).encode()
        for template, path in _FILES.items()
    }
    files[f"include/{package}/{source.file_name}"] = source.text.encode()
    notes = (
        *(f"not included: {effect}" for effect in source.left_out),
        f"{package} is a colcon package for ROS 2 Jazzy or later; it was not compiled here",
    )
    return Exported(files, notes)


def isaac_files(model: RobotModel, held: RobotModel, folder: Path) -> Exported:
    """Return a robot's URDF and the values of Isaac Lab's actuators, by name.

    Viscous friction is `viscous_friction`, since `damping` is a gain; static `friction` includes
    Stribeck friction. Stiffness and damping are those of servos, 0 for joints with commanded
    efforts. `delay` is that of commands, in seconds; `min_delay` and `max_delay` of a
    DelayedPDActuatorCfg are in simulation steps. `effort_delay` is that of measured efforts, not of
    drives.
    """
    name, data, notes = model_file(held, "urdf", folder)
    stem, held_joints = name.removesuffix(".urdf"), exported_joints(held)
    static_excess = {  # of friction at rest over that of a moving joint
        fitted.effect.where[0]: float(fitted.parameters[0])
        for fitted in model.effects
        if isinstance(fitted.effect, StaticFriction)
    }
    joints = {}
    for joint, drive in exported_joints(model).items():
        numbers = held_joints[joint]
        joints[joint] = {
            "effort_limit": drive.effort if np.isfinite(drive.effort) else None,
            "velocity_limit": drive.velocity if np.isfinite(drive.velocity) else None,
            "stiffness": drive.kp,
            "damping": drive.kd,
            "armature": numbers.armature,
            "friction": numbers.friction + static_excess.get(joint, 0.0),
            "dynamic_friction": numbers.friction,
            "viscous_friction": numbers.damping,
            "delay": drive.delay,
            "effort_delay": drive.measured_late,
        }
    table: dict[str, Any] = {"urdf": name, "units": "SI; delays in s", "joints": joints}
    if repairs := repair_comments(model):
        table["notes"] = repairs  # as JSON has no comments
    values = (json.dumps(table, indent=2) + "\n").encode()
    note = (
        f"the values in {stem}.actuators.json are named as in Isaac Lab's ActuatorBaseCfg; "
        "stiffness and damping there are gains of a drive, 0 for joints with commanded efforts"
    )
    return Exported({name: data, f"{stem}.actuators.json": values}, (*notes, note))


_WITH_SPRINGS = frozenset({"sdf", "xml"})  # file formats that support springs
_DRAKE_KINDS = ("sdf", "urdf")  # file formats for directives, the default first


def _holding(
    *kinds: str,
    extra: tuple[type[Effect], ...] = (),
    has_extra: Callable[[RobotModel], bool] = lambda model: True,
) -> Holding:
    """Return which effects files can express: friction, rotors, springs, and extra ones.

    Args:
        kinds: Formats of the files, the default first.
        has_extra: Whether the files of a model can express the extra effects.
    """

    def holding(model: RobotModel) -> Holds:
        kind = written_kind(model, kinds)
        sprung = set(model.joints) if kind in _WITH_SPRINGS else sprung_in_file(model)
        more = extra if extra and has_extra(model) else ()
        if stands_as_it_is(model, kinds[0]):
            return lambda effect: True

        def holds(effect: Effect) -> bool:
            if isinstance(effect, Spring):
                return effect.joint in sprung and effect.exponent == 1
            return effect.file_term.joint in POSITIVE_TERMS or isinstance(effect, more)

        return holds

    return holding


def _file(kind: str) -> Write:
    """Return a function that writes a model file of a format."""

    def write(model: RobotModel, held: RobotModel, folder: Path) -> Exported:
        stands = stands_as_it_is(model, kind)
        name, data, notes = model_file(held, kind, folder, stands=stands)
        return Exported({name: data}, notes)

    return write


def _source(language: str) -> Write:
    """Return a function that writes the effort as a function in a language."""

    def write(model: RobotModel, held: RobotModel, folder: Path) -> Exported:
        source = effort_source(held, language)
        notes = tuple(f"not included: {effect}" for effect in source.left_out)
        return Exported({source.file_name: source.text.encode()}, notes)

    return write


def _drake_files(model: RobotModel, held: RobotModel, folder: Path) -> Exported:
    """Return a robot's file, directives that add and weld it, and a package manifest.

    A tilted base is welded at its tilt.
    """
    kind = written_kind(model, _DRAKE_KINDS)
    name, data, notes = model_file(held, kind, folder)
    package = re.sub(r"[^a-z0-9_]+", "_", folder.resolve().name.lower()).strip("_") or "robot"
    plant = model.plant
    roots, instance = [], name.partition(".")[0]
    if name == model.path.name:
        roots = _free_roots(held)
        last = plant.get_body(BodyIndex(plant.num_bodies() - 1))
        instance = plant.GetModelInstanceName(last.model_instance())
    lines = [
        "# Inertias, damping and rotors are those of the model; the file has dry friction, which",
        "# Drake does not simulate. parser.package_map().PopulateFromFolder(…) finds the file.",
        *(f"# {printable(comment)}" for comment in repair_comments(model)),
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


def _has_free_base(model: RobotModel) -> bool:
    """Return whether the robot's file does not fix its base, so that directives can place it."""
    if own_kind(model) not in _DRAKE_KINDS:
        return False
    plant = model.plant
    joints = (plant.get_joint(index) for index in plant.GetJointIndices())
    on_world = [joint for joint in joints if joint.parent_body().index() == 0]
    return len(on_world) == len(_free_roots(model))


def _free_roots(model: RobotModel) -> list[tuple[RigidBody, RigidTransform]]:
    """Return the bodies that geodrake, not the file, welds to the world, and their poses."""
    plant, tilt = model.plant, RotationMatrix(tilt_rotation(model))
    roots = []
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        welded = joint.type_name() == "weld" and joint.parent_body().index() == 0
        if welded and not model.floating and joint.name().startswith("world_welds_to_"):
            X_WB = joint.frame_on_parent().GetFixedPoseInBodyFrame()
            roots.append((joint.child_body(), RigidTransform(tilt, np.zeros(3)) @ X_WB))
    return roots


_URDF_ENGINES = (DrakeEngine, PinocchioEngine)
_OF_DRAKE = _holding(*_DRAKE_KINDS, extra=(Tilt,), has_extra=_has_free_base)
_OF_MUJOCO = _holding("xml", extra=(Tilt, Delay))
_OF_ISAAC = _holding("urdf", extra=(Delay,))

FORMATS = {
    form.name: form
    for form in (
        ExportFormat("urdf", _holding("urdf"), _file("urdf"), _URDF_ENGINES),
        ExportFormat("sdf", _holding("sdf"), _file("sdf"), (DrakeEngine,)),
        ExportFormat("mjcf", _OF_MUJOCO, _file("xml"), (MujocoEngine,), servos=True),
        ExportFormat("drake", _OF_DRAKE, _drake_files, (DrakeEngine,)),
        ExportFormat("isaac", _OF_ISAAC, isaac_files, _URDF_ENGINES, servos=True),
        ExportFormat("python", lambda _: is_written, _source("python"), (PythonEngine,), True),
        ExportFormat("cpp", lambda _: is_written, _source("cpp"), at_actuators=True),
        ExportFormat("ros2", lambda _: is_written, ros2_files),
    )
}
"""Export formats by name."""


def export_format(name: str) -> ExportFormat:
    """Return a format by name."""
    if name not in FORMATS:
        raise ArgumentError(
            f"Export format {name!r} is unknown.",
            advice=f"{nearest(name, FORMATS)}Formats are {', '.join(FORMATS)}.",
        )
    return FORMATS[name]
