"""The shapes of an MJCF's bodies, as MuJoCo compiles them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    InMemoryMesh,
    Mesh,
    Rgba,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform

from geodrake.errors import ModelError
from geodrake.robot.files.given import Given
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.mjcf_source import compiled, load_mujoco
from geodrake.robot.files.mjcf_terms import pose_of
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.mesh_files import wavefront_text

_LAST_GROUP = 2  # of geoms that MuJoCo shows unasked
_WIDE, _DEEP = 100.0, 1.0
"""Sides of the box below a plane, m: Drake has no distances of half-spaces to most shapes."""
WORLD = "WorldModelInstance::world"  # Drake's scoped name
SHAPES_ADVICE = (
    "Give the links shapes of their own with `links` and leave out those of the file "
    "(use_file=False)."
)


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
class MjcfGeom(LinkShape):
    """A geom of a body.

    Attributes:
        name: Its name, or its number.
        shown: Whether MuJoCo shows its group unasked.
        collides: Whether it touches others.
    """

    name: str
    shown: bool
    collides: bool
    friction: float


def mjcf_geoms(
    path: Path, given: Given, *, hulls: bool = False, scope: str | None = None
) -> tuple[Mapping[str, tuple[MjcfGeom, ...]], tuple[str, ...]] | None:
    """Return the geoms of each body by its scoped name, and sentences on meshes that are lost.

    Of other files, that is None.

    Args:
        hulls: For collisions and not for pictures: meshes are convex hulls of all of their points,
            and what the file puts into the world is there, planes included.
        scope: Name of the model; None for that in the file.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return None
    root = parse_xml_bytes(read_expanded(path, given), path)
    if root.tag != "mujoco":
        return None
    Includes(path, given.packages).insert_elements(root)
    scope = scope or root.get("model") or path.stem
    source = compiled(root, path, geoms=True)
    if hulls and source.touching:
        raise ModelError(
            f"{path} cannot be read with its collision geometry: {' '.join(source.lost)}",
            advice=SHAPES_ADVICE,
            path=path,
        )
    m, plane = source.model, load_mujoco().mjtGeom.mjGEOM_PLANE
    found = dict[str, list[MjcfGeom]]()
    for at in range(m.ngeom):
        shape, body = _shape(m, at, hulls), int(m.geom_bodyid[at])
        if shape is None or not (body or hulls):
            continue  # the ground is no part of the robot
        X_BG, material = pose_of(m.geom_pos[at], m.geom_quat[at]), int(m.geom_matid[at])
        if int(m.geom_type[at]) == plane:
            X_BG = X_BG @ RigidTransform([0.0, 0.0, -0.5 * _DEEP])
        color = m.geom_rgba[at] if material < 0 else m.mat_rgba[material]
        geom = MjcfGeom(
            shape,
            X_BG,
            Rgba(*np.clip(color, 0.0, 1.0)),
            m.geom(at).name or str(at),
            bool(m.geom_group[at] <= _LAST_GROUP),
            bool(m.geom_contype[at] or m.geom_conaffinity[at]),
            float(m.geom_friction[at][0]),
        )
        link = f"{scope}::{m.body(body).name}" if body else WORLD
        found.setdefault(link, []).append(geom)
    return {link: tuple(geoms) for link, geoms in found.items()}, tuple(source.lost)


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
