"""What a robot looks like: the shapes that its file gives its links, and what is said of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree.ElementTree import Element, tostring

from pydrake.common import MemoryFile
from pydrake.geometry import HalfSpace, InMemoryMesh, Mesh, Rgba, Role, Shape
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from geodrake.errors import ModelError
from geodrake.robot.files.description import drake_errors, drake_messages, read_description
from geodrake.robot.files.given import Given
from geodrake.robot.files.meshes import check_geometry
from geodrake.robot.files.values import drop
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.mesh_files import READERS, check_mesh, wavefront
from geodrake.robot.mjcf_shapes import MjcfGeom, mjcf_geoms

GRAY = Rgba(0.82, 0.84, 0.87, 1.0)
_DRAKE_READS = (".obj", ".gltf", ".vtk")


@dataclass(frozen=True, eq=False)
class LinkShape:
    """A shape of a link.

    Attributes:
        shape: Drake's shape; meshes are in memory.
        X_BG: Its pose in the link's frame.
        color: Colour that the file gives it.
    """

    shape: Shape
    X_BG: RigidTransform
    color: Rgba


@dataclass(frozen=True, eq=False)
class RobotShapes:
    """The shapes of a robot's links.

    Attributes:
        links: Scoped link name -> its shapes.
        notes: What could not be shown as the file has it, in words.
    """

    links: Mapping[str, tuple[LinkShape, ...]]
    notes: tuple[str, ...] = ()


@dataclass
class _Lost:
    """Meshes that could not be used: what for.

    Attributes:
        reasons: File, as the model names it -> why.
    """

    reasons: dict[str, str] = field(default_factory=dict)

    @property
    def words(self) -> tuple[str, ...]:
        """One sentence, or none."""
        if not self.reasons:
            return ()
        mesh, reason = next(iter(self.reasons.items()))
        more = len(self.reasons) - 1
        others = f" and {more} more" if more else ""
        package = re.match(r"(?:package|model)://([^/]+)/", mesh)
        named = f"; name its folder: --package {package[1]}=FOLDER" if package else ""
        return (f"meshes that are not shown: {mesh} ({reason}){others}{named}",)


def robot_shapes(path: Path, given: Given) -> RobotShapes:
    """Return the visual shapes of a model's file; of links that have none, their collision shapes.

    STL and COLLADA meshes are read too. A file whose shapes nobody can read gives none, and a note.
    """
    lost = _Lost()
    try:
        with drake_messages(), TemporaryDirectory() as folder, drake_errors(path):
            links, notes = _read(path, given, Path(folder), lost)
    except ModelError as error:
        return RobotShapes({}, (f"the shapes of {path.name} are not shown: {error.problem}",))
    return RobotShapes(links, (*lost.words, *notes))


def _read(
    path: Path, given: Given, folder: Path, lost: _Lost
) -> tuple[dict[str, tuple[LinkShape, ...]], tuple[str, ...]]:
    found = mjcf_geoms(path, given)
    if found is not None:
        geoms, notes = found
        return {link: _visible(own) for link, own in geoms.items()}, notes
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
    inspector, links = scene.model_inspector(), {}
    for role in (Role.kProximity, Role.kIllustration):  # of links that have both, the latter
        for i in range(plant.num_bodies()):
            body = plant.get_body(BodyIndex(i))
            shapes = []
            for geometry in inspector.GetGeometries(
                plant.GetBodyFrameIdOrThrow(body.index()), role
            ):
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


def _visible(geoms: Sequence[MjcfGeom]) -> tuple[LinkShape, ...]:
    """Geoms that MuJoCo shows; of bodies that have none such, all."""
    seen = [geom for geom in geoms if geom.shown] or geoms
    return tuple(LinkShape(geom.shape, geom.X_BG, geom.color) for geom in seen)


def _prepare(root: Element, packages: PackageMap, model: Path, folder: Path, lost: _Lost) -> None:
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
    shape: Element, packages: PackageMap, model: Path, folder: Path, lost: _Lost
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
                lost.reasons[place] = f"MeshCat shows no {found.suffix or 'such'} files"
                return False
            else:
                check_mesh(found)
        except ModelError as error:
            lost.reasons[place] = error.problem.rstrip(".")
            return False
        except RuntimeError as error:
            reason = str(error).strip().partition("\n")[0].rpartition("error: ")[2]
            lost.reasons[place] = reason.rpartition(" refers to ")[2].rstrip(".")
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
