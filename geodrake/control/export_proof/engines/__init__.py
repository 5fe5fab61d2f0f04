"""Simulators that exports are tried in, those that are installed."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from geodrake.control.export_proof.engines.base import Engine
from geodrake.model.robot_model import RobotModel

_ENGINES = {
    "drake": ("pydrake", "DrakeEngine"),
    "mujoco": ("mujoco", "MujocoEngine"),
    "pinocchio": ("pinocchio", "PinocchioEngine"),
    "python": ("math", "PythonEngine"),
}
"""Name -> the package that it needs, and its class in the module `<name>_engine`."""


def engine(name: str) -> Callable[[Path, RobotModel], Engine] | None:
    """What loads a file into a simulator; None if that is not installed."""
    package, kind = _ENGINES[name]
    if find_spec(package) is None:
        return None
    module = import_module(f"{__name__}.{name}_engine")
    made: Callable[[Path, RobotModel], Engine] = getattr(module, kind)
    return made
