"""A robot for Isaac Lab: its URDF, and values of its actuators by joint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.model.export import repair_comments
from geodrake.model.exporting.actuators import actuators_of
from geodrake.model.exporting.export_format import Exported
from geodrake.model.exporting.held import HeldModel
from geodrake.model.exporting.joint_numbers import joint_numbers
from geodrake.model.exporting.model_text import model_file
from geodrake.model.file_terms import StaticFriction
from geodrake.model.robot_model import RobotModel

_NOTE = (
    "the values of {name} are named as fields of Isaac Lab's ActuatorBaseCfg; "
    "stiffness and damping there are gains of a drive, 0 for joints that are moved by efforts"
)


def isaac_files(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
    """Return a robot's URDF, and the values that Isaac Lab's actuators take.

    Viscous friction is `viscous_friction`, since `damping` is a gain; static `friction` is what
    Stribeck friction makes of the dynamic one at rest. Stiffness and damping are those of servos,
    0 for joints that are moved by efforts. `delay` is that of what a drive is told, in seconds:
    `min_delay` and `max_delay` of a DelayedPDActuatorCfg are it in steps of the simulation.
    `effort_delay` is that of measured efforts, which drives do not have.

    Args:
        model: The whole model.
        held: What the files hold of it.
        folder: Where they will be.
    """
    name, data, notes = model_file(held.model, "urdf", folder)
    by_scoped = joint_numbers(held.model)
    speeds = dict(zip(model.joints, model.velocity_limits.tolist(), strict=True))
    scoped = dict(zip(model.joints, model.scoped_joints, strict=True))
    static = _static_excess(model)
    joints = {}
    for actuator in actuators_of(model):
        joint, speed = actuator.joint, speeds[actuator.joint]
        if (numbers := by_scoped.get(scoped[joint])) is None:
            continue
        joints[joint] = {
            "effort_limit": actuator.limit if np.isfinite(actuator.limit) else None,
            "velocity_limit": speed if np.isfinite(speed) else None,
            "stiffness": actuator.stiffness,
            "damping": actuator.damping,
            "armature": numbers.armature,
            "friction": numbers.friction + static.get(joint, 0.0),
            "dynamic_friction": numbers.friction,
            "viscous_friction": numbers.damping,
            "delay": actuator.delay,
            "effort_delay": actuator.measured_late,
        }
    table: dict[str, Any] = {"urdf": name, "units": "SI; delays in s", "joints": joints}
    if repairs := repair_comments(model):
        table["notes"] = repairs  # as JSON has no comments
    files = {
        name: data,
        f"{name.removesuffix('.urdf')}.actuators.json": (
            json.dumps(table, indent=2) + "\n"
        ).encode(),
    }
    return Exported(files, (*notes, _NOTE.format(name=name.removesuffix(".urdf"))))


def _static_excess(model: RobotModel) -> dict[str, float]:
    """By how much friction at rest exceeds that of a moving joint, N·m or N."""
    return {
        fitted.effect.where[0]: float(fitted.parameters[0])
        for fitted in model.effects
        if isinstance(fitted.effect, StaticFriction)
    }
