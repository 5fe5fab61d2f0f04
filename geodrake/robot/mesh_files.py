"""STL and COLLADA files, which Drake does not read, as Wavefront text, which it does."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.input_files import read_regular
from geodrake.errors import GeodrakeError, ModelError
from geodrake.inertia import Array
from geodrake.robot.files.xml_text import LARGEST_FILE

Faces = NDArray[np.int64]
Surface = tuple[Array, Faces]
"""(n, 3) vertices, m, and (m, 3) numbers of the corners of triangles."""

MOST_TRIANGLES = 6000
"""Triangles of a mesh that are drawn at most: a page is to stay small."""

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
_SMOOTH = 0.8  # cosine of the angle between a face's normal and the mean, up to which it is smooth
_GRIDS = (256, 180, 128, 90, 64, 45, 32, 22, 16)  # cells along the longest side


def regular_mesh(path: Path) -> Path:
    """Return a mesh file, once it is clear that it and the files that it names end.

    Drake opens those, materials and textures; what is not there does no harm.
    """
    waiting, seen = [path], set[Path]()
    while waiting:
        file = waiting.pop()
        if file not in seen:
            seen.add(file)
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
    """Return a mesh file as Wavefront's text, of `MOST_TRIANGLES` at most."""
    try:
        surface = READERS[path.suffix.lower()](path)
    except GeodrakeError:
        raise
    except Exception as error:  # whatever collada says of a file
        raise _unreadable(path, _ERROR.sub("", str(error))) from error
    if not len(surface[1]):
        raise _unreadable(path, "it has no triangles")
    return wavefront_text(surface)


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


def _unreadable(path: Path, reason: str) -> ModelError:
    return ModelError(f"Mesh {path} cannot be read: {reason}.", advice="Correct the file.")


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
    import collada  # which takes long, and few need

    data = read_regular(path, "mesh", ModelError, largest=LARGEST_FILE)
    ignored = [collada.common.DaeError]  # of what is no mesh, lights say
    document = collada.Collada(io.BytesIO(_MATERIALS.sub(b"", data)), ignore=ignored)
    parts = [(np.zeros((0, 3)), np.zeros((0, 3), int))]
    for geometry in chain.from_iterable(s.objects("geometry") for s in document.scenes):
        for primitive in geometry.primitives():
            is_cut = isinstance(primitive, collada.polylist.BoundPolylist)
            part = primitive.triangleset() if is_cut else primitive
            is_surface = isinstance(part, collada.triangleset.BoundTriangleSet)  # and no lines
            if is_surface and part.vertex_index is not None:
                parts.append((part.vertex, part.vertex_index))
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate([own + at for (_, own), at in zip(parts, starts, strict=False)])
    if document.errors and not len(faces):
        raise document.errors[0]
    vertices = np.concatenate([vertices for vertices, _ in parts])
    vertices = (document.assetInfo.unitmeter or 1.0) * vertices
    if not np.isfinite(vertices).all():
        raise _unreadable(path, "some of its vertices are not finite")
    return vertices, faces


READERS: dict[str, Callable[[Path], Surface]] = {".stl": _stl, ".dae": _collada}
"""Suffix -> reads a surface."""
