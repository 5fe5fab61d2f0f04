"""Shapes of a robot's links, read from its file.

STL and COLLADA files, which Drake does not read, are converted to Wavefront text.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    GeometryInstance,
    HalfSpace,
    InMemoryMesh,
    MakePhongIllustrationProperties,
    Mesh,
    Rgba,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from geodrake.boundary.input_files import read_regular
from geodrake.errors import GeodrakeError, ModelError
from geodrake.inertia import Array
from geodrake.robot.files.checks import drop
from geodrake.robot.files.description import (
    Where,
    drake_errors,
    drake_messages,
    read_description,
)
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.load_options import Given
from geodrake.robot.files.mjcf_source import CompiledMjcf, load_mujoco, pose_of
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import LARGEST_FILE, parse_xml_bytes
from geodrake.robot.stated import WORLD_LINK

Faces = NDArray[np.int64]
Surface = tuple[Array, Faces]
"""Vertices (n, 3), m, and triangles (m, 3) as indices of vertices."""

MOST_TRIANGLES = 6000
"""Most triangles of a drawn mesh, to limit the size of pages."""

_HEADER, _COUNT, _FACET = 80, 4, 50  # bytes of a binary STL file
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")
_NAMED = {
    ".obj": re.compile(rb"^\s*mtllib\s+(.+)", re.MULTILINE),
    ".mtl": re.compile(rb"^\s*(?:map_\w+|bump|disp|decal|refl|norm)\s+(.+)", re.MULTILINE),
    ".gltf": re.compile(rb'"uri"\s*:\s*"([^"]*)"'),
}
"""Suffix -> references to other files: materials, textures, buffers."""
_NAME = re.compile(r"(?!data:)[^\0]{1,200}")
_MATERIALS = re.compile(rb"<bind_material.*?</bind_material>", re.DOTALL)
_ERROR = re.compile(r"^\w+Error: ")
_SMOOTH = 0.8  # least cosine between the normal of a face and the mean at a smooth vertex
_GRIDS = (256, 180, 128, 90, 64, 45, 32, 22, 16)  # cells along the longest side


def regular_mesh(path: Path) -> Path:
    """Return a mesh file after checking it and the files that it names, which Drake opens.

    They must be regular files of limited size, or missing.
    """
    waiting, visited = [path], set[Path]()
    while waiting:
        file = waiting.pop()
        if file not in visited:
            visited.add(file)
            what = "mesh" if file == path else f"file that mesh {path} refers to,"
            data = read_regular(file, what, ModelError, largest=LARGEST_FILE, empty=True)
            pattern, named = _NAMED.get(file.suffix.lower()), list[str]()
            for match in pattern.finditer(data) if pattern else ():
                words = match[1].decode(errors="replace").strip()
                named += [words, words.rpartition(" ")[2], unquote(words)]
            places = (file.parent / name for name in named if _NAME.fullmatch(name))
            waiting += (place for place in places if place.exists() and not place.is_dir())
    return path


def wavefront(path: Path) -> str:
    """Return a mesh file as Wavefront text with at most `MOST_TRIANGLES`."""
    try:
        surface = READERS[path.suffix.lower()](path)
    except GeodrakeError:
        raise
    except Exception as error:  # collada raises many types
        raise _unreadable(path, _ERROR.sub("", str(error))) from error
    if not len(surface[1]):
        raise _unreadable(path, "it has no triangles")
    return wavefront_text(surface)


def wavefront_text(surface: Surface) -> str:
    """Return a surface as Wavefront text with at most `MOST_TRIANGLES`."""
    vertices, faces = simplified(surface)
    normals, of_corners = _normals(vertices, faces)
    corners = 1 + np.stack([faces, of_corners], -1).reshape(-1, 6)
    text = io.StringIO()
    np.savetxt(text, vertices, "v %.4g %.4g %.4g")
    np.savetxt(text, normals, "vn %.2f %.2f %.2f")
    np.savetxt(text, corners, "f %d//%d %d//%d %d//%d")
    return text.getvalue()


def _unreadable(path: Path, reason: str) -> ModelError:
    return ModelError(f"Mesh {path} cannot be read: {reason}.", advice="Correct the file.")


def _normals(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Return normals, and the indices (m, 3) of normals at corners.

    Corners at smooth vertices have the mean normal of the vertex, others that of their face.
    """
    a, b, c = (vertices[corner] for corner in faces.T)
    across = np.cross(b - a, c - a)
    means = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(means, corner, across)
    means, own = (
        n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-30) for n in (means, across)
    )
    smooth = np.einsum("fci,fi->fc", means[faces], own) > _SMOOTH
    edged = np.flatnonzero(~smooth.all(1))
    number = np.zeros(len(faces), int)
    number[edged] = len(means) + np.arange(len(edged))
    return np.concatenate([means, own[edged]]), np.where(smooth, faces, number[:, None])


def simplified(surface: Surface) -> Surface:
    """Return a surface with at most `MOST_TRIANGLES`, by merging vertices in cells of a grid."""
    vertices, faces = surface
    if not len(faces):
        raise ModelError("A mesh has no triangles.")
    low, side = vertices.min(0), float(np.ptp(vertices, axis=0).max()) or 1.0
    _, same = np.unique(np.round((vertices - low) / side * 1e6), axis=0, return_inverse=True)
    vertices, faces = _merged(vertices, faces, same.ravel())
    for grid in _GRIDS:
        if len(faces) <= MOST_TRIANGLES:
            break
        cells = np.floor((vertices - low) / side * grid)
        _, number = np.unique(cells, axis=0, return_inverse=True)
        vertices, faces = _merged(vertices, faces, number.ravel())
    return vertices, faces


def _merged(vertices: Array, faces: Faces, number: Faces) -> Surface:
    """Merge vertices of the same number into the most central one, without collapsed triangles."""
    count = np.bincount(number)
    means = np.stack([np.bincount(number, axis) / count for axis in vertices.T], -1)
    far = np.linalg.norm(vertices - means[number], axis=1)
    order = np.lexsort([far, number])
    central = order[np.cumsum(count) - count]
    faces = number[faces]
    is_valid = (faces != np.roll(faces, 1, axis=1)).all(1)
    _, first = np.unique(np.sort(faces[is_valid], axis=1), axis=0, return_index=True)
    return vertices[central], faces[is_valid][np.sort(first)]


def stl_vertices(path: Path) -> Array:
    """Return the vertices (3 n, 3) of n triangles in a binary or text STL file, in its unit."""
    data = read_regular(path, "mesh", ModelError, empty=True)
    start = _HEADER + _COUNT
    count = int.from_bytes(data[_HEADER:start], "little")
    if count and len(data) == start + _FACET * count:
        facets = np.frombuffer(data, np.uint8, offset=start).reshape(count, _FACET)
        vertices = facets[:, 12:48].copy().view("<f4").astype(float).reshape(-1, 3)
    else:
        try:
            vertices = np.array(_VERTEX.findall(data)).astype(float).reshape(-1, 3)
        except ValueError as error:
            raise _unreadable(path, str(error)) from error
    if not len(vertices) or len(vertices) % 3 or not np.isfinite(vertices).all():
        raise _unreadable(path, "it has no triangles, or incomplete ones")
    return vertices


def _stl(path: Path) -> Surface:
    vertices = stl_vertices(path)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _collada(path: Path) -> Surface:
    import collada  # slow to import, and rarely needed

    data = read_regular(path, "mesh", ModelError, largest=LARGEST_FILE)
    ignored = [collada.common.DaeError]  # errors of other elements, such as lights
    document = collada.Collada(io.BytesIO(_MATERIALS.sub(b"", data)), ignore=ignored)
    parts = [(np.zeros((0, 3)), np.zeros((0, 3), int))]
    for geometry in chain.from_iterable(s.objects("geometry") for s in document.scenes):
        for primitive in geometry.primitives():
            is_cut = isinstance(primitive, collada.polylist.BoundPolylist)
            part = primitive.triangleset() if is_cut else primitive
            is_surface = isinstance(part, collada.triangleset.BoundTriangleSet)  # not lines
            if is_surface and part.vertex_index is not None:
                parts.append((part.vertex, part.vertex_index))
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate(
        [triangles + start for (_, triangles), start in zip(parts, starts, strict=False)]
    )
    if document.errors and not len(faces):
        raise document.errors[0]
    vertices = np.concatenate([vertices for vertices, _ in parts])
    vertices = (document.assetInfo.unitmeter or 1.0) * vertices
    if not np.isfinite(vertices).all():
        raise _unreadable(path, "some of its vertices are not finite")
    return vertices, faces


READERS: dict[str, Callable[[Path], Surface]] = {".stl": _stl, ".dae": _collada}
"""Suffix -> reader of a surface."""


_LAST_GROUP = 2  # of geoms that MuJoCo shows by default
_WIDE, _DEEP = 100.0, 1.0
"""Width and depth of the box for a plane, m: Drake lacks most distances to half-spaces."""
SHAPES_ADVICE = (
    "Pass the shapes of links as `links`, and ignore those of the file (use_file=False)."
)


@dataclass(frozen=True, eq=False)
class LinkShape:
    """A shape of a link."""

    shape: Shape
    X_BG: RigidTransform
    color: Rgba


@dataclass(frozen=True, eq=False)
class MjcfGeom(LinkShape):
    """A geom of a body."""

    name: str  # or index
    shown: bool  # MuJoCo shows its group by default
    collides: bool


def mjcf_geoms(
    path: Path, given: Given, *, hulls: bool = False
) -> tuple[Mapping[str, tuple[MjcfGeom, ...]], tuple[str, ...]] | None:
    """Return scoped body name -> geoms of an MJCF, and notes on missing meshes; or else None.

    With `hulls`, for collisions, meshes are convex hulls, and geoms of the world are included.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return None
    root = parse_xml_bytes(read_expanded(path, given), path)
    if root.tag != "mujoco":
        return None
    Includes(path, given.packages).insert_elements(root)
    scope = root.get("model") or path.stem
    source = CompiledMjcf(root, path, geoms=True)
    if hulls and source.touching:
        raise ModelError(
            f"{path} cannot be read with its collision geometry: {' '.join(source.lost)}",
            advice=SHAPES_ADVICE,
        )
    m, plane = source.model, load_mujoco().mjtGeom.mjGEOM_PLANE
    geoms_of = dict[str, list[MjcfGeom]]()
    for index in range(m.ngeom):
        shape, body = _shape(m, index, hulls), int(m.geom_bodyid[index])
        if shape is None or not (body or hulls):
            continue  # the ground is not part of the robot
        X_BG, material = pose_of(m.geom_pos[index], m.geom_quat[index]), int(m.geom_matid[index])
        if int(m.geom_type[index]) == plane:
            X_BG = X_BG @ RigidTransform([0.0, 0.0, -0.5 * _DEEP])
        color = m.geom_rgba[index] if material < 0 else m.mat_rgba[material]
        geom = MjcfGeom(
            shape,
            X_BG,
            Rgba(*np.clip(color, 0.0, 1.0)),
            m.geom(index).name or str(index),
            bool(m.geom_group[index] <= _LAST_GROUP),
            bool(m.geom_contype[index] or m.geom_conaffinity[index]),
        )
        link = f"{scope}::{m.body(body).name}" if body else WORLD_LINK
        geoms_of.setdefault(link, []).append(geom)
    return {link: tuple(geoms) for link, geoms in geoms_of.items()}, tuple(source.lost)


def _shape(m: Any, at: int, hulls: bool) -> Shape | None:
    kinds, kind = load_mujoco().mjtGeom, int(m.geom_type[at])
    a, b, c = (float(x) for x in m.geom_size[at])
    if kind == kinds.mjGEOM_MESH:
        mesh = int(m.geom_dataid[at])
        first, count = int(m.mesh_vertadr[mesh]), int(m.mesh_vertnum[mesh])
        face, faces = int(m.mesh_faceadr[mesh]), int(m.mesh_facenum[mesh])
        vertices = np.array(m.mesh_vert[first : first + count], float)
        name = m.mesh(mesh).name or str(mesh)
        if hulls:
            return Convex(points=vertices.T, label=name)
        text = wavefront_text((vertices, np.array(m.mesh_face[face : face + faces], np.int64)))
        return Mesh(InMemoryMesh(mesh_file=MemoryFile(text, ".obj", name)))
    shapes: dict[int, Callable[[], Shape]] = {
        int(kinds.mjGEOM_SPHERE): lambda: Sphere(a),
        int(kinds.mjGEOM_CAPSULE): lambda: Capsule(a, 2.0 * b),
        int(kinds.mjGEOM_CYLINDER): lambda: Cylinder(a, 2.0 * b),
        int(kinds.mjGEOM_ELLIPSOID): lambda: Ellipsoid(a, b, c),
        int(kinds.mjGEOM_BOX): lambda: Box(2.0 * a, 2.0 * b, 2.0 * c),
    }
    if hulls:
        shapes[int(kinds.mjGEOM_PLANE)] = lambda: Box(_WIDE, _WIDE, _DEEP)
    return shapes[kind]() if kind in shapes else None


def collision_balls(path: Path, given: Given) -> Mapping[str, tuple[Array, float]]:
    """Return scoped link name -> center and radius, m, of its only collision sphere.

    Links may have other shapes, too. A file with unreadable collision geometry yields none.
    """
    shapes_of = dict[str, list[tuple[RigidTransform, Shape]]]()
    with suppress(ModelError), drake_messages(), drake_errors(path):
        if (of_mjcf := mjcf_geoms(path, given)) is not None:
            for link, geoms in of_mjcf[0].items():
                shapes_of[link] = [(g.X_BG, g.shape) for g in geoms if g.collides]
        else:
            plant, scene = scene_of(path, given, _keep_spheres)
            see = scene.model_inspector()
            for link, own in geometries_of(plant, scene, Role.kProximity):
                shapes_of[link] = [(see.GetPoseInFrame(id), see.GetShape(id)) for id in own]
    balls = {
        link: [(X.translation(), shape.radius()) for X, shape in own if isinstance(shape, Sphere)]
        for link, own in shapes_of.items()
    }
    return {link: own[0] for link, own in balls.items() if len(own) == 1}


def _keep_spheres(root: Element, _: Where) -> None:
    drop(root, "visual")
    for link in root.iter("link"):
        for shape in link.findall("collision"):
            if shape.find("geometry/sphere") is None:
                link.remove(shape)


GRAY = Rgba(0.82, 0.84, 0.87, 1.0)
_DRAKE_READS = (".obj", ".gltf", ".vtk")


@dataclass(frozen=True, eq=False)
class RobotShapes:
    """The shapes of a robot's links."""

    links: Mapping[str, tuple[LinkShape, ...]]
    notes: tuple[str, ...] = ()  # on shapes that are not shown


def robot_shapes(path: Path, given: Given) -> RobotShapes:
    """Return the visual shapes of a model's file, or collision shapes of links without any.

    STL and COLLADA meshes are read, too. A file with unreadable shapes yields none and a note.
    """
    missing = dict[str, str]()  # mesh name in the file -> reason
    try:
        with drake_messages(), TemporaryDirectory() as folder, drake_errors(path):
            links, notes = _read(path, given, Path(folder), missing)
    except ModelError as error:
        return RobotShapes({}, (f"the shapes of {path.name} are not shown: {error.problem}",))
    if missing:
        mesh, reason = next(iter(missing.items()))
        others = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        package = re.match(r"(?:package|model)://([^/]+)/", mesh)
        named = ""
        if package and "unknown package" in reason:
            named = f"; name its folder: --package {package[1]}=FOLDER"
        notes = (f"meshes that are not shown: {mesh} ({reason}){others}{named}", *notes)
    return RobotShapes(links, notes)


def add_visuals(
    plant: MultibodyPlant, scene_graph: SceneGraph, path: Path, given: Given
) -> tuple[str, ...]:
    """Add the shapes in a file to a plant's bodies, without collisions; return notes."""
    shapes = robot_shapes(path, given)
    for k in map(BodyIndex, range(plant.num_bodies())):
        name = plant.get_body(k).scoped_name().get_full()
        for number, shown in enumerate(shapes.links.get(name, ())):
            geometry = GeometryInstance(shown.X_BG, shown.shape, f"{name}_{number}")
            geometry.set_illustration_properties(MakePhongIllustrationProperties(shown.color.rgba))
            frame = plant.GetBodyFrameIdOrThrow(k)
            scene_graph.RegisterGeometry(plant.get_source_id(), frame, geometry)
    if shapes.links or shapes.notes:
        return shapes.notes
    return (f"{path.name} has no visual geometry.",)


def _read(
    path: Path, given: Given, folder: Path, lost: dict[str, str]
) -> tuple[dict[str, tuple[LinkShape, ...]], tuple[str, ...]]:
    found, links = mjcf_geoms(path, given), dict[str, tuple[LinkShape, ...]]()
    if found is not None:  # of each body those that MuJoCo shows, or all
        geoms, notes = found
        return {k: tuple(g for g in ids if g.shown) or ids for k, ids in geoms.items()}, notes
    plant, scene = scene_of(path, given, lambda root, where: _prepare(root, where, folder, lost))
    inspector = scene.model_inspector()
    for role in (Role.kProximity, Role.kIllustration):  # the latter takes precedence
        for link, ids in geometries_of(plant, scene, role):
            shapes = []
            for geometry in ids:
                shape = inspector.GetShape(geometry)
                if isinstance(shape, HalfSpace):
                    continue  # the ground is not part of the robot
                properties = inspector.GetProperties(geometry, role)
                color = properties.GetPropertyOrDefault("phong", "diffuse", GRAY)
                pose = inspector.GetPoseInFrame(geometry)
                shapes.append(LinkShape(_in_memory(shape, folder), pose, color))
            if shapes:
                links[link] = tuple(shapes)
    return links, ()


def scene_of(
    path: Path, given: Given, prepare: Callable[[Element, Where], None]
) -> tuple[MultibodyPlant, SceneGraph]:
    """Return a plant of a file with the geometry of its links.

    `prepare` modifies the geometry of URDFs and SDFs before Drake reads it (`move_meshes`).
    """
    plant, scene = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)

    def shapes_alone(root: Element, where: Where) -> None:
        drop(root, "inertial", "mimic", "transmission", "sensor", "plugin", "gazebo", "surface")
        prepare(root, where)

    read_description(path, given).add_to(plant, simplified=False, prepare=shapes_alone)
    return plant, scene


def move_meshes(element: Element, moved: Callable[[str], Path]) -> None:
    """Replace the mesh files named in an element of a URDF or SDF."""
    for mesh in element.iter("mesh"):
        uri = mesh.find("uri")
        name = mesh.get("filename", "") if uri is None else uri.text or ""
        url = f"file://{moved(name.strip()).resolve()}"
        if uri is None:
            mesh.set("filename", url)
        else:
            uri.text = url


def geometries_of(
    plant: MultibodyPlant, scene: SceneGraph, role: Role
) -> Iterator[tuple[str, list[GeometryId]]]:
    """Yield scoped names of links and their geometry of a role."""
    for body in map(plant.get_body, map(BodyIndex, range(plant.num_bodies()))):
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        own = scene.model_inspector().GetGeometries(frame, role)
        yield body.scoped_name().get_full(), own


def _prepare(root: Element, where: Where, folder: Path, lost: dict[str, str]) -> None:
    """Keep one kind of shape for each link, with readable meshes only."""
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                shape.tag = "visual"
                if link.find("visual[@shown]") is not None and kind == "collision":
                    link.remove(shape)
                elif _is_readable(shape, where, folder, lost):
                    shape.set("shown", kind)
                else:
                    link.remove(shape)
        for shape in link.findall("visual"):
            shape.attrib.pop("shown")


def _is_readable(shape: Element, where: Where, folder: Path, lost: dict[str, str]) -> bool:
    """Return whether a shape can be shown, after replacing its mesh file by a readable one."""

    def shown(name: str) -> Path:
        try:
            found = where(name)
            if found.suffix.lower() in READERS:
                text, found = wavefront(found), folder / f"{len(list(folder.iterdir()))}.obj"
                found.write_text(text, encoding="utf-8")
            elif found.suffix.lower() not in _DRAKE_READS:
                raise ModelError(f"MeshCat cannot show {found.suffix or 'such'} files")
            else:
                regular_mesh(found)
        except ModelError as error:
            lost[name] = error.problem.rstrip(".")
            raise
        return found

    with suppress(ModelError):
        move_meshes(shape, shown)
        return True
    return False


def _in_memory(shape: Shape, folder: Path) -> Shape:
    """Return the shape with its mesh in memory if it is a file of the folder."""
    if isinstance(shape, Mesh) and shape.source().is_path():
        path = Path(shape.source().path())
        if path.parent == folder.resolve():
            held = InMemoryMesh(mesh_file=MemoryFile.Make(str(path)))
            return Mesh(held, shape.scale3())
    return shape.Clone()
