"""Scenes of several robots, tables and objects, told by scenario files in YAML.

A scenario is like one of Drake's `examples/hardware_sim`: model directives, and what is to happen
in them. `load_scenario` reads it, `build_scene` makes the diagram, `run` simulates it. Robots are
driven in the diagram, or by messages of LCM, as the drivers of an iiwa take and give them.
"""

from geodrake.control.scenes.building import Scene, build_scene
from geodrake.control.scenes.iiwa_messages import (
    IiwaCommandWriter,
    IiwaStatusReader,
    add_simulated_iiwa,
    iiwa_ports,
)
from geodrake.control.scenes.running import RobotRun, SceneRun, run, write_logs
from geodrake.control.scenes.scenario import (
    ComputedTorqueControl,
    IiwaMessages,
    LogMotion,
    MeshcatView,
    PassivityControl,
    PredictionSpec,
    RobotSpec,
    Scenario,
    Waypoints,
    load_scenario,
)

__all__ = [
    "ComputedTorqueControl",
    "IiwaCommandWriter",
    "IiwaMessages",
    "IiwaStatusReader",
    "LogMotion",
    "MeshcatView",
    "PassivityControl",
    "PredictionSpec",
    "RobotRun",
    "RobotSpec",
    "Scenario",
    "Scene",
    "SceneRun",
    "Waypoints",
    "add_simulated_iiwa",
    "build_scene",
    "iiwa_ports",
    "load_scenario",
    "run",
    "write_logs",
]
