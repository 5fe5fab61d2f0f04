"""STL and COLLADA files, which Drake does not read, as Wavefront text, which it does."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform

from geodrake.boundary.input_files import open_regular, read_regular, regular_files
from geodrake.errors import GeodrakeError, ModelError
from geodrake.inertia import Array
from geodrake.robot.files.xml_text import LARGEST_FILE, parse_xml

Faces = NDArray[np.int64]
Surface = tuple[Array, Faces]
"""(n, 3) vertices, m, and (m, 3) numbers of the corners of triangles."""

MOST_TRIANGLES = 6000
"""Triangles of a mesh that are drawn at most: a page is to stay small."""

_HEADER, _COUNT, _FACET = 80, 4, 50  # bytes of a binary STL file
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")
_MATERIALS = re.compile(rb"^[ \t]*mtllib[ \t]+(.+)$", re.MULTILINE)
_IMAGES = re.compile(
    rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t].*?(\S+)[ \t\r]*$", re.MULTILINE
)
_URIS = re.compile(rb'"uri"\s*:\s*"([^"]{1,4000})"')  # longer ones are data
_SMOOTH = 0.8  # cosine of the angle between a face's normal and the mean, up to which it is smooth
_GRIDS = (256, 180, 128, 90, 64, 45, 32, 22, 16)  # cells along the longest side


def wavefront(path: Path) -> str:
    """Return a mesh file as Wavefront's text, of `MOST_TRIANGLES` at most."""
    try:
        return wavefront_text(READERS[path.suffix.lower()](path))
    except GeodrakeError:
        raise
    except (OSError, ValueError, LookupError, AttributeError, TypeError) as error:
        raise _unreadable(path, str(error)) from error


def wavefront_text(surface: Surface) -> str:
    """Return a surface as Wavefront's text, of `MOST_TRIANGLES` at most."""
    vertices, faces = simplified(surface)
    normals, of_corners = _normals(vertices, faces)
    corners = 1 + np.stack([faces, of_corners], -1).reshape(-1, 6)
    text = io.StringIO()
    np.savetxt(text, vertices, "v %.4g %.4g %.4g")
    np.savetxt(text, normals, "vn %.2f %.2f %.2f")
    np.savetxt(text, corners, "f %d//%d %d//%d %d//%d")
    return text.getvalue()


def check_mesh(path: Path) -> None:
    """Raise if Drake would open what is no file, for a mesh or for what it names.

    Args:
        path: A mesh of any kind; one that is not there is nothing to wait for.
    """
    for mesh in _there([path]):
        open_regular(mesh, "mesh", ModelError).close()
        if mesh.suffix.lower() == ".obj":
            for material in _named(mesh, _MATERIALS, "mesh"):
                regular_files(_named(material, _IMAGES, "material"), "texture", ModelError)
        elif mesh.suffix.lower() == ".gltf":
            regular_files(_named(mesh, _URIS, "mesh"), "file of a mesh", ModelError)


def _named(path: Path, pattern: re.Pattern[bytes], what: str) -> list[Path]:
    """Return the files beside a file that it names."""
    data = read_regular(path, what, ModelError, largest=LARGEST_FILE, empty=True)
    names = dict.fromkeys(name.strip() for name in pattern.findall(data))
    return _there(path.parent / os.fsdecode(name) for name in names)


def _there(places: Iterable[Path]) -> list[Path]:
    """Return the places where there is something that is no folder."""
    exists = os.path.exists  # which takes names that no file can have
    return [place for place in places if exists(place) and not place.is_dir()]


def _unreadable(path: Path, reason: str) -> ModelError:
    return ModelError(
        f"The mesh {path} cannot be read: {reason}.", advice="Correct the file.", path=path
    )


def _normals(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Normals, and (m, 3) numbers of those at corners: the mean around a vertex where it is smooth.

    At an edge, where a face's normal is far from the mean, the corner has that of its face.
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
    """Return a surface of few triangles: vertices in one cell of a grid become one of them."""
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
    """Keep the most central vertex of each number; triangles that collapse are left out."""
    count = np.bincount(number)
    means = np.stack([np.bincount(number, axis) / count for axis in vertices.T], -1)
    far = np.linalg.norm(vertices - means[number], axis=1)
    order = np.lexsort([far, number])
    central = order[np.cumsum(count) - count]
    faces = number[faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(1)
    _, first = np.unique(np.sort(faces[whole], axis=1), axis=0, return_index=True)
    return vertices[central], faces[whole][np.sort(first)]


def stl_vertices(path: Path) -> Array:
    """Return (3 n, 3) vertices of an STL file's n triangles, binary or text, in its unit."""
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
        raise _unreadable(path, "it has no triangles, or not whole ones")
    return vertices


def _stl(path: Path) -> Surface:
    vertices = stl_vertices(path)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _collada(path: Path) -> Surface:
    root = parse_xml(path)
    unit = root.find("asset/unit")
    scale = 1.0 if unit is None else float(unit.get("meter", "1"))
    meshes = {g.get("id"): g.find("mesh") for g in root.iter("geometry")}
    nodes = {n.get("id"): n for n in root.findall("library_nodes//node")}
    parts: list[Surface] = []
    for scene in root.iter("visual_scene"):
        for node in scene.findall("node"):
            for name, X in _instances(node, np.eye(4), nodes):
                if (mesh := meshes[name]) is not None:
                    vertices, faces = _mesh(mesh)
                    parts.append((scale * (vertices @ X[:3, :3].T + X[:3, 3]), faces))
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    moved = (faces + start for (_, faces), start in zip(parts, starts, strict=False))
    vertices = np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _ in parts)])
    return vertices, np.concatenate([np.zeros((0, 3), int), *moved])


def _instances(
    node: Element, X: Array, nodes: Mapping[str | None, Element]
) -> Iterator[tuple[str, Array]]:
    """Yield names of the meshes at a node and below it, with their 4×4 poses in the scene."""
    for child in node:
        if child.tag in _TRANSFORMS:
            X = X @ _TRANSFORMS[child.tag](np.array((child.text or "").split(), float))
        elif child.tag == "instance_geometry":
            yield child.get("url", "")[1:], X
        elif child.tag == "node":
            yield from _instances(child, X, nodes)
        elif child.tag == "instance_node":
            yield from _instances(nodes[child.get("url", "")[1:]], X, {})


_TRANSFORMS: dict[str, Callable[[Array], Array]] = {
    "matrix": lambda x: x.reshape(4, 4),
    "translate": lambda x: RigidTransform(x).GetAsMatrix4(),
    "rotate": lambda x: RigidTransform(
        AngleAxis(np.radians(x[3]), x[:3] / np.linalg.norm(x[:3])), np.zeros(3)
    ).GetAsMatrix4(),
    "scale": lambda x: np.diag([*x, 1.0]),
}


def _mesh(mesh: Element) -> Surface:
    """Return vertices and triangles of a mesh, polygons cut into triangles."""
    sources = {source.get("id"): source for source in mesh.findall("source")}
    place = mesh.find("vertices/input[@semantic='POSITION']")
    if place is None:
        raise ValueError("it has no positions")
    numbers = sources[place.get("source", "")[1:]].findtext("float_array", "").split()
    vertices, faces = np.array(numbers, float).reshape(-1, 3), [np.zeros((0, 3), int)]
    for kind in ("triangles", "polylist", "polygons"):
        for part in mesh.findall(kind):
            inputs = {i.get("semantic"): int(i.get("offset", "0")) for i in part.findall("input")}
            width = 1 + max(inputs.values())
            for p in part.findall("p"):
                corners = np.array((p.text or "").split(), int)
                corners = corners.reshape(-1, width)[:, inputs["VERTEX"]]
                counts = {"triangles": [3] * (len(corners) // 3), "polygons": [len(corners)]}
                stated = np.array(part.findtext("vcount", "").split(), int)
                faces.append(_fans(corners, np.array(counts.get(kind, stated), int)))
    return vertices, np.concatenate(faces)


def _fans(corners: Faces, counts: Faces) -> Faces:
    """Return (m, 3) triangles of polygons with so many corners each, one polygon after another."""
    first = np.repeat(np.cumsum(counts) - counts, np.maximum(counts - 2, 0))
    step = np.concatenate([np.zeros(0, int), *(np.arange(1, count - 1) for count in counts)])
    return np.stack([corners[first], corners[first + step], corners[first + step + 1]], -1)


READERS: dict[str, Callable[[Path], Surface]] = {".stl": _stl, ".dae": _collada}
"""Suffix -> reads a surface."""
