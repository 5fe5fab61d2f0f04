"""A model as a `ros2_control` controller: feedforward of gravity and friction, as a C++ package."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jinja2
import numpy as np

from geodrake.boundary.escaping import printable
from geodrake.control.export_proof.held import Exported, HeldModel
from geodrake.errors import ModelError
from geodrake.model.robot_model import RobotModel
from geodrake.model.source import effort_source

SIGN_WIDTH = 0.02
"""Speed below which dry friction fades, rad/s or m/s: a controller would chatter otherwise."""

_FILES = {
    "package.xml": "package.xml",
    "CMakeLists.txt": "CMakeLists.txt",
    "plugin.xml": "plugin.xml",
    "feedforward.cpp": "src/feedforward.cpp",
    "feedforward.yaml": "config/feedforward.yaml",
    "README.md": "README.md",
}
"""Template -> its place in the package."""


def ros2_files(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
    """Return a package for colcon with a chainable controller.

    Its efforts are those of the exported C++ function at no acceleration.
    """
    count = len(model.joints)
    if len(model.single_joints) != count:
        raise ModelError(
            "A ros2_control controller needs joints with one degree of freedom, but the "
            "model has others.",
            advice="Export to cpp, and write a controller that calls the function.",
        )
    source = effort_source(held.model, "cpp", sign_width=SIGN_WIDTH)
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
        place: templates.get_template(f"{template}.jinja").render(values).encode()
        for template, place in _FILES.items()
    }
    files[f"include/{package}/{source.file_name}"] = source.text.encode()
    notes = (
        *(f"not included: {effect}" for effect in source.left_out),
        f"{package} is a colcon package for ROS 2 Jazzy or later; it was not compiled here",
    )
    return Exported(files, notes)
