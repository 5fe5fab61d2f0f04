"""What a robot looks like, by its file, on a plant that was read without geometry."""

from __future__ import annotations

from pathlib import Path

from pydrake.geometry import SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from geodrake.errors import ModelError
from geodrake.robot.files import Given, read_description
from geodrake.robot.files.description import drake_errors, drake_messages
from geodrake.robot.files.xacro_file import is_xacro, read_expanded


def add_visuals(
    plant: MultibodyPlant, scene_graph: SceneGraph, path: Path, given: Given
) -> tuple[str, ...]:
    """Gives the bodies of a plant the visual geometry of its file; nothing collides.

    Args:
        plant: A finalized plant that was read from the file, and is a source of the SceneGraph.
        scene_graph: Where the geometry goes.
        path: The model file.
        given: How it was read.

    Returns:
        Notes on what cannot be shown.
    """
    shown, scene = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    try:
        with drake_messages(), drake_errors(path):
            parser = Parser(shown)
            description = read_description(path, given)
            description.add_packages(parser.package_map(), description.named_packages())
            if is_xacro(path.read_bytes()):
                parser.AddModelsFromString(read_expanded(path, given).decode(), "urdf")
            else:
                parser.AddModels(str(path))
            shown.Finalize()
    except ModelError as error:
        return (f"The robot has no shapes: {error.problem}",)
    inspector, count = scene.model_inspector(), 0
    frames = {_scoped(plant, k): plant.GetBodyFrameIdOrThrow(k) for k in _bodies(plant)}
    for k in _bodies(shown):
        frame = frames.get(_scoped(shown, k))
        for geometry in shown.GetVisualGeometriesForBody(shown.get_body(k)) if frame else ():
            copy = inspector.CloneGeometryInstance(geometry)
            scene_graph.RegisterGeometry(plant.get_source_id(), frame, copy)
            count += 1
    return () if count else (f"{path.name} has no visual geometry.",)


def _bodies(plant: MultibodyPlant) -> list[BodyIndex]:
    return [BodyIndex(k) for k in range(plant.num_bodies())]


def _scoped(plant: MultibodyPlant, index: BodyIndex) -> str:
    return str(plant.get_body(index).scoped_name().get_full())
