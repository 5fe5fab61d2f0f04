"""Shapes of links as triangles, for viewers that know neither Drake's shapes nor its mesh files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Mesh,
    ReadObjToTriangleSurfaceMesh,
    Shape,
    Sphere,
)
from scipy.spatial import ConvexHull

from geodrake.inertia import Array
from geodrake.robot.shapes import LinkShape

Faces = NDArray[np.int32]

_AROUND = 24


def link_triangles(shapes: Sequence[LinkShape]) -> tuple[Array, Faces]:
    """Return the shapes of a link as one mesh: (n, 3) vertices in its frame, m; (m, 3) corners."""
    vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), np.int32)], 0
    for one in shapes:
        own, corners = triangles(one.shape)
        vertices.append(own @ one.X_BG.rotation().matrix().T + one.X_BG.translation())
        faces.append(corners + count)
        count += len(own)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


def triangles(shape: Shape) -> tuple[Array, Faces]:
    """Return a shape as (n, 3) vertices, m, and (m, 3) corners of triangles seen from outside.

    Meshes of other formats than Wavefront OBJ become their convex hulls.
    """
    if isinstance(shape, Mesh) and shape.extension() == ".obj":
        return _obj(shape)
    points = _points(shape)
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return points, faces.astype(np.int32)


def _obj(mesh: Mesh) -> tuple[Array, Faces]:
    with TemporaryDirectory() as folder:
        source, path = mesh.source(), Path(folder) / "mesh.obj"
        if source.is_path():
            path = Path(source.path())
        else:
            path.write_bytes(source.in_memory().mesh_file.contents())
        found = ReadObjToTriangleSurfaceMesh(str(path))
    vertices = np.array(found.vertices()) * mesh.scale3()
    faces = [[t.vertex(k) for k in range(3)] for t in found.triangles()]
    return vertices, np.array(faces, np.int32).reshape(-1, 3)


def _points(shape: Shape) -> Array:
    """Return points (n, 3) whose convex hull is a shape, or the hull of a mesh."""
    angle = np.linspace(0.0, 2 * np.pi, _AROUND, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(_AROUND)], -1)
    up = np.array([0.0, 0.0, 1.0])
    polar = np.linspace(0.0, np.pi, _AROUND // 2 + 1)[1:-1]
    ball = np.concatenate([*(np.sin(a) * circle + np.cos(a) * up for a in polar), [up, -up]])
    if isinstance(shape, Sphere):
        return shape.radius() * ball
    if isinstance(shape, Ellipsoid):
        return ball * [shape.a(), shape.b(), shape.c()]
    if isinstance(shape, Capsule):
        shift = 0.5 * shape.length() * up
        return np.concatenate([shape.radius() * ball + shift, shape.radius() * ball - shift])
    if isinstance(shape, Cylinder):
        shift = 0.5 * shape.length() * up
        return np.concatenate([shape.radius() * circle + shift, shape.radius() * circle - shift])
    if isinstance(shape, Box):
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
        return np.asarray(signs * shape.size())
    return np.array(shape.GetConvexHull().vertices())
