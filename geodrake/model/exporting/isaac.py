"""A robot for Isaac Lab: its URDF, and values of its actuators by joint."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

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
    """A robot's URDF, and the values that Isaac Lab's actuators take.

    Viscous friction is `viscous_friction`, since `damping` is a gain; static `friction` is what
    Stribeck friction makes of the dynamic one at rest. The delay is in seconds: `min_delay` and
    `max_delay` of a DelayedPDActuatorCfg are it in steps of the simulation.

    Args:
        model: The whole model.
        held: What the files hold of it.
        folder: Where they will be.
    """
    name, data, notes = model_file(held.model, "urdf", folder)
    by_scoped = joint_numbers(held.model)
    limits, delays = (model.effort_limits, model.velocity_limits), model.delays.tolist()
    columns = zip(model.joints, model.scoped_joints, *limits, delays, strict=True)
    static = _static_excess(model)
    joints = {}
    for joint, scoped, effort, speed, delay in columns:
        if (numbers := by_scoped.get(scoped)) is None:
            continue
        joints[joint] = {
            "effort_limit": float(effort) if np.isfinite(effort) else None,
            "velocity_limit": float(speed) if np.isfinite(speed) else None,
            "stiffness": 0.0,
            "damping": 0.0,
            "armature": numbers.armature,
            "friction": numbers.friction + static.get(joint, 0.0),
            "dynamic_friction": numbers.friction,
            "viscous_friction": numbers.damping,
            "delay": delay,
        }
    table = {"urdf": name, "units": "SI; delay in s", "joints": joints}
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
