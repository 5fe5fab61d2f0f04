"""Robots coloured by errors, as triangles and as rendered pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
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

from geodrake.compiling import compiled, contiguous
from geodrake.inertia import Array
from geodrake.report.robot_scene import VIEW, PosedLink
from geodrake.robot.shapes import LinkShape

Pixels = NDArray[np.uint8]
Faces = NDArray[np.int32]

COLORS = ("#d3d9e0", "#f2d27a", "#ee9d3d", "#d8492f", "#8f1239")
"""Colours of errors from none to the largest."""

UNKNOWN = 255  # level of a joint in a frame where nothing is compared

GRAYS = np.array([[209, 214, 220, 255], [225, 228, 233, 255]], np.uint8)
"""Colours (RGBA) of links without a joint, and of joints where nothing is compared."""

_LEVELS = 254
_AROUND = 24  # corners of what is round

_FINER = 2  # pixels that are drawn for each one of the picture, along each side
_NEAR = 0.01  # m, before the camera, from which on something is seen
_LIGHTS = np.array([[0.3, 0.5, 1.0], [-0.5, 0.2, 1.0]])  # to the right, up, and to the viewer
_DARKEST = 0.45  # share of its colour that a surface has which no light meets


def top_error(relative: Array, least: float) -> float:
    """Return the error of the last colour, which hardly any exceeds."""
    known = relative[np.isfinite(relative)]
    return max(float(np.quantile(known, 0.99)), least) if len(known) else 1.0


def levels(relative: Array, top: float) -> NDArray[np.uint8]:
    """Return colours of errors as numbers, from 0 for none to 254, or `UNKNOWN`."""
    scaled = np.clip(relative / top, 0.0, 1.0) * _LEVELS
    return np.where(np.isfinite(scaled), np.rint(scaled), UNKNOWN).astype(np.uint8)


def error_colors(relative: Array, top: float) -> NDArray[np.uint8]:
    """Return colours (F, nv, 4) of errors (F, nv), RGBA."""
    shades = LinearSegmentedColormap.from_list("error", COLORS, N=UNKNOWN)
    found = levels(relative, top)
    colors = np.asarray(shades(np.minimum(found, UNKNOWN - 1).astype(int), bytes=True))
    return np.where((found == UNKNOWN)[..., None], GRAYS[1], colors).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class ColoredRobot:
    """A robot in the colours of the errors of its joints."""

    links: list[PosedLink]
    place: Array  # (3,) where it stands, m
    colors: NDArray[np.uint8]  # (F, nv, 4) of the joints, RGBA


@dataclass(frozen=True, eq=False)
class _Surface:
    """The triangles of a link."""

    corners: Array  # (m, 3, 3) in the link's frame, m
    colors: Array  # (m, 3) that the file gives them, 0 to 255


@dataclass(frozen=True)
class Camera:
    """The pose and size of a camera."""

    place: Array  # (3,) of the camera in the world, m
    target: Array  # (3,) what is in the middle, m
    width: int  # in pixels
    height: int  # in pixels, for an angle of `VIEW`

    @property
    def R_WC(self) -> Array:
        """(3, 3) axes of the camera in the world: to the right, up, and towards the viewer."""
        back = (self.place - self.target) / np.linalg.norm(self.place - self.target)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        return np.column_stack([right, np.cross(back, right), back])

    def seen(self, points: Array) -> Array:
        """Return points (..., 3) of the world as pixels from the left and top, and 1 / depth."""
        at = (points - self.place) @ self.R_WC
        nearness = 1.0 / np.maximum(-at[..., 2], _NEAR)
        scale = 0.5 * self.height / np.tan(0.5 * VIEW) * nearness
        x, y = 0.5 * self.width + scale * at[..., 0], 0.5 * self.height - scale * at[..., 1]
        return np.stack([x, y, np.where(-at[..., 2] > _NEAR, nearness, -1.0)], -1)


class DrawnRobots:
    """The robots of a playback, ready to be drawn in any of its frames."""

    def __init__(self, robots: Sequence[ColoredRobot], camera: Camera) -> None:
        self._robots = robots
        size = _FINER * camera.width, _FINER * camera.height
        self._camera = Camera(camera.place, camera.target, *size)
        self._surfaces = [[_surface(link.shapes) for link in robot.links] for robot in robots]

    def picture(self, frame: int) -> Pixels:
        """Return a frame (height, width, 4), RGBA, with a transparent background."""
        camera, corners, colors = self._camera, list[Array](), list[Array]()
        for robot, surfaces in zip(self._robots, self._surfaces, strict=True):
            for link, surface in zip(robot.links, surfaces, strict=True):
                X_WB = link.X_WB[frame]
                turned = surface.corners @ X_WB.rotation().matrix().T
                corners.append(turned + X_WB.translation() + robot.place)
                joint = link.joint
                own = surface.colors if joint is None else robot.colors[frame, joint, :3]
                colors.append(np.broadcast_to(own, surface.colors.shape))
        points = np.concatenate(corners)
        shaded = np.concatenate(colors) * _brightness(points @ camera.R_WC)[:, None]
        image = np.zeros((camera.height, camera.width, 4), np.float32)
        _draw(contiguous(camera.seen(points)), contiguous(shaded), image, np.zeros(image.shape[:2]))
        some = [image[i::_FINER, j::_FINER] for i in range(_FINER) for j in range(_FINER)]
        total = sum(some[1:], some[0])
        total[..., :3] /= np.maximum(total[..., 3:], 1.0)
        total[..., 3] *= 255.0 / len(some)
        return np.rint(total).astype(np.uint8)


def on_ground(picture: Pixels, ground: Sequence[int]) -> Pixels:
    """Return a picture (height, width, 3) on a background colour."""
    cover = picture[..., 3:] / 255.0
    return np.rint(picture[..., :3] * cover + np.array(ground) * (1.0 - cover)).astype(np.uint8)


def _surface(shapes: Sequence[Any]) -> _Surface:
    corners, colors = [np.empty((0, 3, 3))], [np.empty((0, 3))]
    for one in shapes:
        vertices, faces = link_triangles([one])
        corners.append(vertices[faces])
        rgb = 255.0 * np.array([one.color.r(), one.color.g(), one.color.b()])
        colors.append(np.tile(rgb, (len(faces), 1)))
    return _Surface(np.concatenate(corners), np.concatenate(colors))


def _brightness(corners: Array) -> Array:
    """Return the brightness (m,) of triangles with corners (m, 3, 3) in the camera's axes."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0)  # of the side that is seen
    lights = _LIGHTS / np.linalg.norm(_LIGHTS, axis=1, keepdims=True)
    lit = np.maximum(normals @ lights.T, 0.0).mean(1)
    return np.asarray(_DARKEST + (1.0 - _DARKEST) * lit)


@compiled
def _draw(corners: Array, colors: Array, image: Any, nearest: Array) -> None:
    """Draw triangles (m, 3, 3), each corner in pixels and 1 / depth, where nothing is nearer."""
    height, width = nearest.shape
    for k in range(len(corners)):
        a, b, c = corners[k]
        if min(a[2], b[2], c[2]) <= 0.0:
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        left = max(0, int(np.floor(min(a[0], b[0], c[0]))))
        right = min(width - 1, int(np.ceil(max(a[0], b[0], c[0]))))
        top = max(0, int(np.floor(min(a[1], b[1], c[1]))))
        bottom = min(height - 1, int(np.ceil(max(a[1], b[1], c[1]))))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                of_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
                of_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
                of_a = 1.0 - of_b - of_c
                if of_a < 0.0 or of_b < 0.0 or of_c < 0.0:
                    continue
                near = of_a * a[2] + of_b * b[2] + of_c * c[2]
                if near > nearest[row, column]:
                    nearest[row, column] = near
                    image[row, column, :3] = colors[k]
                    image[row, column, 3] = 1.0


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
