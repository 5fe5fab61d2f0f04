"""Collision meshes as convex hulls in memory; of STL files too, which Drake does not read.

Drake takes a mesh for its convex hull wherever it measures distances, so nothing is lost.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Convex, Mesh, Shape
from pydrake.multibody.parsing import PackageMap

from geodrake.errors import ModelError
from geodrake.robot.mesh_files import check_mesh, stl_vertices

Array = NDArray[np.float64]


def replace_stl(root: Element, packages: PackageMap, model: Path, folder: Path) -> None:
    """Makes all meshes of a description files that Drake reads.

    Args:
        root: The description, URDF or SDF; changed. Places of its meshes become URLs.
        folder: Where to write the surfaces of STL files to, in Wavefront's format.

    Raises:
        ModelError: An STL file is missing, or is none.
    """
    numbers = iter(range(10**9))
    for mesh in root.iter("mesh"):
        if "filename" in mesh.attrib:
            place = mesh.get("filename", "")
            mesh.set("filename", _readable(place, packages, model, folder / f"{next(numbers)}.obj"))
    for uri in root.iter("uri"):
        uri.text = _readable(uri.text or "", packages, model, folder / f"{next(numbers)}.obj")


def in_memory(shape: Shape, label: str) -> Shape:
    """Return a shape that needs no file: of a mesh, its convex hull.

    Args:
        label: Name of the convex hull that takes a mesh's place.
    """
    if not isinstance(shape, Mesh | Convex):
        return shape.Clone()
    hull = shape.GetConvexHull()
    points = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    return Convex(points=points.T, label=label)


def _unusable(place: str | Path, reason: str) -> ModelError:
    return ModelError(
        f"The mesh {place} cannot be used for collisions: {reason}.",
        advice="Correct the file, or give the links shapes of their own with `links` and leave out "
        "those of the model's file (use_file=False).",
        mesh=str(place),
    )


def _readable(place: str, packages: PackageMap, model: Path, replacement: Path) -> str:
    """Return the URL of a mesh, or of what is written in the place of an STL file."""
    place = place.strip()
    if "://" not in place:
        # Drake does not know where a text is from, and takes no bare paths in it.
        place = f"file://{model.resolve().parent / place}"
    try:
        path = packages.ResolveUrl(place)
    except RuntimeError as error:
        reason = str(error).strip().partition("\n")[0]
        raise _unusable(place, reason.rpartition("error: ")[2].rstrip(".")) from error
    try:
        if not path.lower().endswith(".stl"):
            check_mesh(Path(path))
            return place
        vertices = stl_vertices(Path(path))
    except ModelError as error:
        words = error.problem.replace(f"The mesh {path} ", "it ").rstrip(".")
        raise _unusable(path, words) from error
    corners = 1 + np.arange(len(vertices)).reshape(-1, 3)
    with replacement.open("w", encoding="utf-8") as file:
        np.savetxt(file, vertices, "v %.9g %.9g %.9g")
        np.savetxt(file, corners, "f %d %d %d")
    return f"file://{replacement}"
