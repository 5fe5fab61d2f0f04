"""A robot for Isaac Lab: its URDF, and values of its actuators by joint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.model.export import repair_comments
from geodrake.model.exporting.export_format import Exported
from geodrake.model.exporting.held import HeldModel
from geodrake.model.exporting.joints import exported_joints
from geodrake.model.exporting.model_text import model_file
from geodrake.model.file_terms import StaticFriction
from geodrake.model.robot_model import RobotModel


def isaac_files(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
    """Return a robot's URDF and the values that Isaac Lab's actuators take, by name.

    Viscous friction is `viscous_friction`, since `damping` is a gain; static `friction` is what
    Stribeck friction makes of the dynamic one at rest. Stiffness and damping are those of servos,
    0 for joints that are moved by efforts. `delay` is that of what a drive is told, in seconds:
    `min_delay` and `max_delay` of a DelayedPDActuatorCfg are it in steps of the simulation.
    `effort_delay` is that of measured efforts, which drives do not have.
    """
    name, data, notes = model_file(held.model, "urdf", folder)
    stem, held_joints = name.removesuffix(".urdf"), exported_joints(held.model)
    at_rest = {  # by how much friction exceeds that of a moving joint
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
            "friction": numbers.friction + at_rest.get(joint, 0.0),
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
        f"the values of {stem} are named as fields of Isaac Lab's ActuatorBaseCfg; stiffness and "
        "damping there are gains of a drive, 0 for joints that are moved by efforts"
    )
    return Exported({name: data, f"{stem}.actuators.json": values}, (*notes, note))
