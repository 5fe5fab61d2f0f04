"""What a robot looks like: the shapes that its file gives its links, and what is said of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree.ElementTree import Element, tostring

from pydrake.common import MemoryFile
from pydrake.geometry import (
    GeometryInstance,
    HalfSpace,
    InMemoryMesh,
    MakePhongIllustrationProperties,
    Mesh,
    Rgba,
    Role,
    SceneGraph,
    Shape,
)
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from geodrake.errors import ModelError
from geodrake.robot.files.description import drake_errors, drake_messages, read_description
from geodrake.robot.files.given import Given
from geodrake.robot.files.includes import check_geometry
from geodrake.robot.files.values import drop
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.mesh_files import READERS, check_mesh, wavefront
from geodrake.robot.mjcf_shapes import LinkShape, mjcf_geoms

GRAY = Rgba(0.82, 0.84, 0.87, 1.0)
_DRAKE_READS = (".obj", ".gltf", ".vtk")


@dataclass(frozen=True, eq=False)
class RobotShapes:
    """The shapes of a robot's links.

    Attributes:
        links: Scoped link name -> its shapes.
        notes: What could not be shown as the file has it, in words.
    """

    links: Mapping[str, tuple[LinkShape, ...]]
    notes: tuple[str, ...] = ()


def robot_shapes(path: Path, given: Given) -> RobotShapes:
    """Return the visual shapes of a model's file; of links that have none, their collision shapes.

    STL and COLLADA meshes are read too. A file whose shapes nobody can read gives none, and a note.
    """
    lost = dict[str, str]()  # mesh, as the file names it -> why it cannot be used
    try:
        with drake_messages(), TemporaryDirectory() as folder, drake_errors(path):
            links, notes = _read(path, given, Path(folder), lost)
    except ModelError as error:
        return RobotShapes({}, (f"the shapes of {path.name} are not shown: {error.problem}",))
    if lost:
        mesh, reason = next(iter(lost.items()))
        others = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
        package = re.match(r"(?:package|model)://([^/]+)/", mesh)
        named = ""
        if package and "unknown package" in reason:
            named = f"; name its folder: --package {package[1]}=FOLDER"
        notes = (f"meshes that are not shown: {mesh} ({reason}){others}{named}", *notes)
    return RobotShapes(links, notes)


def add_visuals(
    plant: MultibodyPlant, scene_graph: SceneGraph, path: Path, given: Given
) -> tuple[str, ...]:
    """Give the bodies of a plant the shapes of its file, and return what cannot be shown.

    Nothing collides.
    """
    found = robot_shapes(path, given)
    for k in map(BodyIndex, range(plant.num_bodies())):
        name = plant.get_body(k).scoped_name().get_full()
        for number, shown in enumerate(found.links.get(name, ())):
            geometry = GeometryInstance(shown.X_BG, shown.shape, f"{name}_{number}")
            geometry.set_illustration_properties(MakePhongIllustrationProperties(shown.color.rgba))
            frame = plant.GetBodyFrameIdOrThrow(k)
            scene_graph.RegisterGeometry(plant.get_source_id(), frame, geometry)
    if found.links or found.notes:
        return found.notes
    return (f"{path.name} has no visual geometry.",)


def _read(
    path: Path, given: Given, folder: Path, lost: dict[str, str]
) -> tuple[dict[str, tuple[LinkShape, ...]], tuple[str, ...]]:
    found, links = mjcf_geoms(path, given), dict[str, tuple[LinkShape, ...]]()
    if found is not None:  # those that MuJoCo shows, or all
        geoms, notes = found
        return {k: tuple(g for g in own if g.shown) or own for k, own in geoms.items()}, notes
    plant, scene = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    parser = Parser(plant)
    description = read_description(path, given)
    description.add_every_package(parser.package_map())
    root = None
    if path.suffix.lower() not in (".yaml", ".yml"):
        root = parse_xml_bytes(read_expanded(path, given), path)
    if root is None or root.tag not in ("robot", "sdf"):
        check_geometry((text.path for text in description.texts), parser.package_map(), given)
        parser.AddModels(str(path))
    else:
        _prepare(root, parser.package_map(), path, folder, lost)
        kind = "urdf" if root.tag == "robot" else "sdf"
        parser.AddModelsFromString(tostring(root, encoding="unicode"), kind)
    inspector = scene.model_inspector()
    for role in (Role.kProximity, Role.kIllustration):  # of links that have both, the latter
        for i in range(plant.num_bodies()):
            body, shapes = plant.get_body(BodyIndex(i)), []
            frame = plant.GetBodyFrameIdOrThrow(body.index())
            for geometry in inspector.GetGeometries(frame, role):
                shape = inspector.GetShape(geometry)
                if isinstance(shape, HalfSpace):
                    continue  # the ground is no part of the robot
                properties = inspector.GetProperties(geometry, role)
                color = properties.GetPropertyOrDefault("phong", "diffuse", GRAY)
                pose = inspector.GetPoseInFrame(geometry)
                shapes.append(LinkShape(_in_memory(shape, folder), pose, color))
            if shapes:
                links[body.scoped_name().get_full()] = tuple(shapes)
    return links, ()


def _prepare(
    root: Element, packages: PackageMap, model: Path, folder: Path, lost: dict[str, str]
) -> None:
    """Leaves one kind of shape for each link, and of meshes those that are there, readable."""
    drop(root, "inertial", "mimic", "transmission", "sensor", "plugin", "gazebo", "surface")
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                shape.tag = "visual"
                if link.find("visual[@shown]") is not None and kind == "collision":
                    link.remove(shape)
                elif _is_readable(shape, packages, model, folder, lost):
                    shape.set("shown", kind)
                else:
                    link.remove(shape)
        for shape in link.findall("visual"):
            shape.attrib.pop("shown")


def _is_readable(
    shape: Element, packages: PackageMap, model: Path, folder: Path, lost: dict[str, str]
) -> bool:
    """Return whether a shape can be shown; where its mesh is, is then written as Drake takes it."""
    for mesh in shape.iter("mesh"):
        uri = mesh.find("uri")
        place = (mesh.get("filename", "") if uri is None else uri.text or "").strip()
        url = place if "://" in place else f"file://{model.resolve().parent / place}"
        try:
            found = Path(packages.ResolveUrl(url))
            if found.suffix.lower() in READERS:
                text, found = wavefront(found), folder / f"{len(list(folder.iterdir()))}.obj"
                found.write_text(text, encoding="utf-8")
            elif found.suffix.lower() not in _DRAKE_READS:
                lost[place] = f"MeshCat shows no {found.suffix or 'such'} files"
                return False
            else:
                check_mesh(found)
        except ModelError as error:
            lost[place] = error.problem.rstrip(".")
            return False
        except RuntimeError as error:
            reason = str(error).strip().partition("\n")[0].rpartition("error: ")[2]
            lost[place] = reason.rpartition(" refers to ")[2].rstrip(".")
            return False
        if uri is None:
            mesh.set("filename", f"file://{found.resolve()}")
        else:
            uri.text = f"file://{found.resolve()}"
    return True


def _in_memory(shape: Shape, folder: Path) -> Shape:
    """Return the shape, which needs no file of the folder any more."""
    if isinstance(shape, Mesh) and shape.source().is_path():
        path = Path(shape.source().path())
        if path.parent == folder.resolve():
            held = InMemoryMesh(mesh_file=MemoryFile.Make(str(path)))
            return Mesh(held, shape.scale3())
    return shape.Clone()
