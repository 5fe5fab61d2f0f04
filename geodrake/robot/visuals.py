"""What a robot looks like, by its file, on a plant that was read without geometry."""

from __future__ import annotations

from pathlib import Path

from pydrake.geometry import GeometryInstance, MakePhongIllustrationProperties, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from geodrake.robot.files import Given
from geodrake.robot.shapes import robot_shapes


def add_visuals(
    plant: MultibodyPlant, scene_graph: SceneGraph, path: Path, given: Given
) -> tuple[str, ...]:
    """Gives the bodies of a plant the shapes of its file; nothing collides.

    Args:
        plant: A finalized plant that was read from the file, and is a source of the SceneGraph.

    Returns:
        Notes on what cannot be shown.
    """
    found = robot_shapes(path, given)
    for k in map(BodyIndex, range(plant.num_bodies())):
        name = plant.get_body(k).scoped_name().get_full()
        for number, shown in enumerate(found.links.get(name, ())):
            geometry = GeometryInstance(shown.X_BG, shown.shape, f"{name}_{number}")
            geometry.set_illustration_properties(MakePhongIllustrationProperties(shown.color.rgba))
            scene_graph.RegisterGeometry(
                plant.get_source_id(), plant.GetBodyFrameIdOrThrow(k), geometry
            )
    if found.links or found.notes:
        return found.notes
    return (f"{path.name} has no visual geometry.",)
