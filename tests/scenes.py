"""Plants with a table, objects and other robots beside the double pendulum."""

from pathlib import Path

from pydrake.math import RigidTransform
from pydrake.multibody.parsing import LoadModelDirectivesFromString, Parser, ProcessModelDirectives
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

MODELS = Path(__file__).parents[1] / "models"
SCENES = Path(__file__).parents[1] / "diagrams" / "examples" / "scenes"
PENDULUM = MODELS / "double_pendulum.urdf"

_TABLE = f"""
directives:
- add_model: {{name: table, file: "file://{SCENES / "table.sdf"}"}}
- add_weld: {{parent: world, child: "table::top"}}
- add_model: {{name: other, file: "file://{PENDULUM}"}}
- add_weld: {{parent: "table::top", child: "other::base_link", X_PC: {{translation: [3, 0, 2]}}}}
- add_model:
    name: crate
    file: "file://{SCENES / "crate.sdf"}"
    default_free_body_pose: {{crate: {{translation: [0.6, 0.1, 0.2]}}}}
- add_model: {{name: arm, file: "file://{PENDULUM}"}}
"""


def scene(builder, *, time_step=1e-3, X_TB=None, actuated=(), finalize=True):
    """Return a table, another pendulum, a crate that falls onto the table, and the pendulum "arm".

    `X_TB` is the pose of the arm's base on the table; `actuated` are its joints that get
    actuators, in this order.
    """
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step)
    ProcessModelDirectives(LoadModelDirectivesFromString(_TABLE), Parser(plant))
    arm = plant.GetModelInstanceByName("arm")
    plant.WeldFrames(
        plant.GetFrameByName("top"),
        plant.GetFrameByName("base_link", arm),
        RigidTransform([0.0, -0.5, 2.0]) if X_TB is None else X_TB,
    )
    for joint in actuated:
        plant.AddJointActuator(f"motor_{joint}", plant.GetJointByName(joint, arm))
    if finalize:
        plant.Finalize()
    return plant


def alone(builder, *, time_step=1e-3):
    """Return the pendulum alone, without actuators."""
    plant = builder.AddSystem(MultibodyPlant(time_step))
    Parser(plant).AddModels(str(PENDULUM))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    return plant


def plant_of(**options):
    """Return the plant of a scene in a builder that is discarded."""
    return scene(DiagramBuilder(), **options)
