"""A robot's plant with collision geometry: that of its file, of the user, and of the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree.ElementTree import tostring

from pydrake.geometry import Box, SceneGraph, Shape
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from geodrake.boundary.arguments import instance, typed
from geodrake.errors import ArgumentError
from geodrake.excitation.collision_meshes import in_memory, replace_stl
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files import read_description
from geodrake.robot.files.description import drake_errors, drake_messages
from geodrake.robot.files.meshes import check_geometry
from geodrake.robot.files.values import drop
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.mjcf_shapes import SHAPES_ADVICE, mjcf_geoms
from geodrake.robot.plant import arrange_as

_CONTACT = CoulombFriction(0.5, 0.5)  # which nothing here uses, but Drake asks for


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape that stands in the way, or that a link has.

    Attributes:
        name: What messages call it.
        shape: Drake's shape, such as `Box(0.5, 0.5, 0.1)`.
        X_BG: Its pose in the link's frame; for an obstacle, in the world.
    """

    name: str
    shape: Shape
    X_BG: RigidTransform

    def __post_init__(self) -> None:
        instance(self.name, "name", str)
        instance(self.shape, "shape", Shape)
        instance(self.X_BG, "X_BG", RigidTransform)


FLOOR = "floor"
_HALF = 10.0, 0.5  # m, of the sides and the depth of a floor


@typed
def floor_of(model: RobotModel) -> Solid:
    """Return a floor at the height of the origin of the robot's base, level in the world."""
    plant = model.plant
    context = plant.CreateDefaultContext()
    welded = plant.GetBodiesWeldedTo(plant.world_body())
    bases = [body for body in welded if body.index() != plant.world_body().index()]
    heights = [plant.EvalBodyPoseInWorld(context, body).translation()[2] for body in bases]
    depth = min(heights, default=0.0) - _HALF[1]
    sides = (2.0 * _HALF[0], 2.0 * _HALF[0], 2.0 * _HALF[1])
    return Solid(FLOOR, Box(*sides), RigidTransform([0.0, 0.0, depth]))


def add_collision_plant(
    builder: DiagramBuilder,
    model: RobotModel,
    obstacles: Sequence[Solid],
    links: Mapping[str, Sequence[Solid]],
    *,
    use_file: bool = True,
) -> tuple[MultibodyPlant, SceneGraph]:
    """Adds a finalized plant of the model with collision geometry, and its SceneGraph.

    Args:
        model: The robot. Its joints are read as always, and its geometry from its file.
        links: Link name -> further solids of the link.
        use_file: Whether the file's own collision geometry counts.

    Raises:
        ModelError: The file cannot be read with its geometry.
        ArgumentError: There is no such link.
    """
    plant, scene = AddMultibodyPlantSceneGraph(builder, 0.0)
    with drake_messages(), drake_errors(model.path):
        read_description(model.path, model.given).add_to(plant)
        arrange_as(plant, model.plant)
    bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
    by_scope = {body.scoped_name().get_full(): body for body in bodies}
    for scope, solids in _solids_of_file(model).items() if use_file else ():
        for solid in solids if scope in by_scope else ():
            _register(plant, by_scope[scope], solid)
    for solid in obstacles:
        _register(plant, plant.world_body(), solid)
    for name, further in links.items():
        found = [body for body in bodies if name in (body.name(), body.scoped_name().get_full())]
        if not found:
            raise ArgumentError(
                f"There is no link {name!r}.",
                advice=f"Links are: {', '.join(body.name() for body in bodies[1:])}.",
            )
        for solid in further:
            _register(plant, found[0], solid)
    plant.Finalize()
    return plant, scene


def _register(plant: MultibodyPlant, body: object, solid: Solid) -> None:
    plant.RegisterCollisionGeometry(body, solid.X_BG, solid.shape, solid.name, _CONTACT)


def _solids_of_file(model: RobotModel) -> dict[str, list[Solid]]:
    """Return collision geometry by scoped link name: of MJCF by MuJoCo, otherwise by Drake."""
    of_mjcf = mjcf_geoms(model.path, model.given, hulls=True)
    if of_mjcf is not None:
        geoms, _ = of_mjcf
        return {
            link: [Solid(f"{k}_{g.name}", g.shape, g.X_BG) for k, g in enumerate(own) if g.collides]
            for link, own in geoms.items()
        }
    plant, scene = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    parser = Parser(plant)
    read_description(model.path, model.given).add_every_package(parser.package_map())
    inspector, found = scene.model_inspector(), {}
    errors = drake_errors(
        model.path,
        how=" with its collision geometry",
        advice=SHAPES_ADVICE,
    )
    with drake_messages(), errors, TemporaryDirectory() as folder:
        _parse(parser, model, Path(folder))
        for i in range(plant.num_bodies()):
            body = plant.get_body(BodyIndex(i))
            solids = []
            for k, geometry in enumerate(plant.GetCollisionGeometriesForBody(body)):
                name = f"{k}_{inspector.GetName(geometry).split('::')[-1]}"
                shape = in_memory(inspector.GetShape(geometry), name)
                solids.append(Solid(name, shape, inspector.GetPoseInFrame(geometry)))
            found[body.scoped_name().get_full()] = solids
    return found


def _parse(parser: Parser, model: RobotModel, folder: Path) -> None:
    """Reads the file without what Drake might trip over and geometry does not need."""
    root = None
    if model.path.suffix.lower() not in (".yaml", ".yml"):
        root = parse_xml_bytes(read_expanded(model.path, model.given), model.path)
    if root is None or root.tag not in ("robot", "sdf"):
        files = (text.path for text in read_description(model.path, model.given).texts)
        check_geometry(files, parser.package_map(), model.given)
        parser.AddModels(str(model.path))
        return
    drop(root, "visual", "inertial", "mimic", "transmission", "sensor", "plugin", "gazebo")
    replace_stl(root, parser.package_map(), model.path, folder)
    kind = "urdf" if root.tag == "robot" else "sdf"
    parser.AddModelsFromString(tostring(root, encoding="unicode"), kind)
