"""Pictures of robots coloured by the errors of their joints."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
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
from geodrake.errors import GeodrakeError
from geodrake.identification.logs.model_errors import Comparison, Series
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.report.numbers import number, percent
from geodrake.report.page import Pictures
from geodrake.report.robot_scene import (
    COLORS,
    VIEW,
    Extent,
    PosedLink,
    camera_place,
    drawn_shapes,
    error_colors,
    posed_links,
    top_error,
)
from geodrake.report.words import capitalized
from geodrake.robot.shapes import LinkShape

Pixels = NDArray[np.uint8]
Faces = NDArray[np.int32]

_PICTURE_DISTANCE = 1.3  # over that of `camera_place`, as shapes reach beyond the links' origins
_PICTURE_SIZE = 1200, 800  # pixels, before margins are cut
_PALETTE = 128  # colours of a picture
_CORNERS = 24  # of a circle
_SUPERSAMPLING = 2  # drawn pixels for each pixel of the picture, along each side
_NEAR = 0.01  # m, distance of the clipping plane from the camera
_LIGHTS = np.array([[0.3, 0.5, 1.0], [-0.5, 0.2, 1.0]])  # to the right, up, and to the viewer
_AMBIENT = 0.45  # brightness of a surface without light


def error_pictures(model: RobotModel, compared: Mapping[str, Comparison]) -> Pictures | None:
    """Return pictures of a robot, coloured by the errors of each model (by title).

    The posture is that of the first model's largest error. Return None if the logs or the shapes
    cannot be drawn.
    """
    with suppress(GeodrakeError):
        return _pictures(model, compared)
    return None


def _pictures(model: RobotModel, compared: Mapping[str, Comparison]) -> Pictures | None:
    first = next(iter(compared.values()), None)
    series = [s for s in first.series if len(s.time)] if first else []
    if first is None or not series:
        return None
    stds = {joint.joint: max(joint.std, 1e-300) for joint in first.errors.joints}
    worst = max(series, key=lambda s: float(np.abs(s.residual).max()) / stds[s.joint])
    index = int(np.abs(worst.residual).argmax())
    q, shapes = model.positions(_posture(model, series, worst, index)), drawn_shapes(model)
    place, target = camera_place(Extent.of(model, q))
    camera = Camera(target + _PICTURE_DISTANCE * (place - target), target, *_PICTURE_SIZE)
    tables = [{joint.joint: joint.nrms for joint in c.errors.joints} for c in compared.values()]
    nrms = np.array([[table.get(joint, np.nan) for joint in model.joints] for table in tables])
    top, links = top_error(nrms, 1.0), posed_links(model, q, shapes)
    drawn = [
        next(drawn_robots([(links, error_colors(row[None], top))], camera, [0])) for row in nrms
    ]
    if not drawn[0].any():
        return None
    rows, columns = (np.flatnonzero(drawn[0][..., 3].any(axis)) for axis in (1, 0))
    inner = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    pictures = {}
    for (title, found), picture in zip(compared.items(), drawn, strict=True):
        buffer = io.BytesIO()
        image = Image.fromarray(picture[inner]).quantize(_PALETTE, Image.Quantize.FASTOCTREE)
        image.save(buffer, "PNG", optimize=True)
        words = ", ".join(filter(None, [title, f"nrms {number(found.errors.nrms)}"]))
        pictures[words] = buffer.getvalue()
    text = (
        "Links have the colour of their joint's error. The pose is that at "
        f"{worst.time[index]:.2f} s, where the error of {worst.joint} was largest."
    )
    notes = tuple(map(capitalized, shapes.notes))
    return Pictures(pictures, COLORS, percent(top), text, notes)


def _posture(model: RobotModel, series: Sequence[Series], worst: Series, index: int) -> Array:
    """Return the positions (1, nv) at a sample; joints without it have the nearest in time."""
    q = np.zeros((1, len(model.joints)))
    for j, joint in enumerate(model.joints):
        parts = [s for s in series if s.joint == joint]
        parts = [s for s in parts if s.block == worst.block] or parts
        if parts:
            time = np.concatenate([s.time for s in parts])
            position = np.concatenate([s.position for s in parts])
            q[0, j] = position[np.abs(time - worst.time[index]).argmin()]
    return q


@dataclass(frozen=True)
class Camera:
    """The pose and size of a camera."""

    place: Array  # (3,) of the camera in the world, m
    target: Array  # (3,) point in the middle of the picture, m
    width: int  # in pixels
    height: int  # in pixels, for an angle of `VIEW`

    @property
    def R_WC(self) -> Array:
        """Axes (3, 3) of the camera in the world: to the right, up, and towards the viewer."""
        back = (self.place - self.target) / np.linalg.norm(self.place - self.target)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        return np.column_stack([right, np.cross(back, right), back])

    def project(self, points: Array) -> Array:
        """Return points (..., 3) of the world as pixels from the left and top, and 1 / depth."""
        p_CP = (points - self.place) @ self.R_WC
        inverse_depth = 1.0 / np.maximum(-p_CP[..., 2], _NEAR)
        scale = 0.5 * self.height / np.tan(0.5 * VIEW) * inverse_depth
        x, y = 0.5 * self.width + scale * p_CP[..., 0], 0.5 * self.height - scale * p_CP[..., 1]
        return np.stack([x, y, np.where(-p_CP[..., 2] > _NEAR, inverse_depth, -1.0)], -1)


def drawn_robots(
    robots: Sequence[tuple[Sequence[PosedLink], Pixels]], camera: Camera, frames: Iterable[int]
) -> Iterator[Pixels]:
    """Yield frames (height, width, 4), RGBA, of robots in the colours of their joints.

    The background is transparent.

    Args:
        robots: Links of each robot, and colours (F, nv, 4) of its joints, RGBA.
        frames: Numbers of the frames.
    """
    factor = _SUPERSAMPLING
    fine = replace(camera, width=factor * camera.width, height=factor * camera.height)
    parts = [(link, colors, *_surface(link.shapes)) for links, colors in robots for link in links]
    for frame in frames:
        triangle_parts, color_parts = list[Array](), list[Array]()
        for link, colors, corners, file_colors in parts:
            X_WB = link.X_WB[frame]
            triangle_parts.append(corners @ X_WB.rotation().matrix().T + X_WB.translation())
            color = file_colors if link.joint is None else colors[frame, link.joint, :3]
            color_parts.append(np.broadcast_to(color, file_colors.shape))
        points = np.concatenate(triangle_parts)
        shaded = np.concatenate(color_parts) * _brightness(points @ fine.R_WC)[:, None]
        image = np.zeros((fine.height, fine.width, 4), np.float32)
        buffer = np.zeros(image.shape[:2])
        _draw(contiguous(fine.project(points)), contiguous(shaded), image, buffer)
        samples = [image[i::factor, j::factor] for i in range(factor) for j in range(factor)]
        total = sum(samples[1:], samples[0])
        total[..., :3] /= np.maximum(total[..., 3:], 1.0)
        total[..., 3] *= 255.0 / len(samples)
        yield np.rint(total).astype(np.uint8)


def _surface(shapes: Sequence[LinkShape]) -> tuple[Array, Array]:
    """Return the triangles of a link in its frame (m, 3, 3), m, and the file's colours (m, 3)."""
    corners, colors = [np.empty((0, 3, 3))], [np.empty((0, 3))]
    for shape in shapes:
        vertices, faces = link_triangles([shape])
        corners.append(vertices[faces])
        rgb = 255.0 * np.array([shape.color.r(), shape.color.g(), shape.color.b()])
        colors.append(np.tile(rgb, (len(faces), 1)))
    return np.concatenate(corners), np.concatenate(colors)


def _brightness(corners: Array) -> Array:
    """Return the brightness (m,) of triangles with corners (m, 3, 3) in the camera's axes."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0)  # towards the viewer
    lights = _LIGHTS / np.linalg.norm(_LIGHTS, axis=1, keepdims=True)
    diffuse = np.maximum(normals @ lights.T, 0.0).mean(1)
    return np.asarray(_AMBIENT + (1.0 - _AMBIENT) * diffuse)


@compiled
def _draw(corners: Array, colors: Array, image: Any, buffer: Array) -> None:
    """Rasterize triangles (m, 3, 3) of pixels and 1 / depth, with a buffer of 1 / depth."""
    height, width = buffer.shape
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
                weight_b = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
                weight_c = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
                weight_a = 1.0 - weight_b - weight_c
                if weight_a < 0.0 or weight_b < 0.0 or weight_c < 0.0:
                    continue
                inverse_depth = weight_a * a[2] + weight_b * b[2] + weight_c * c[2]
                if inverse_depth > buffer[row, column]:
                    buffer[row, column] = inverse_depth
                    for channel in range(3):
                        image[row, column, channel] = colors[k, channel]
                    image[row, column, 3] = 1.0


def link_triangles(shapes: Sequence[LinkShape]) -> tuple[Array, Faces]:
    """Return the shapes of a link as one mesh: (n, 3) vertices in its frame, m; (m, 3) corners."""
    vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), np.int32)], 0
    for shape in shapes:
        points, corners = triangles(shape.shape)
        vertices.append(points @ shape.X_BG.rotation().matrix().T + shape.X_BG.translation())
        faces.append(corners + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


def triangles(shape: Shape) -> tuple[Array, Faces]:
    """Return a shape as (n, 3) vertices, m, and (m, 3) corners of triangles seen from outside.

    Meshes of other formats than Wavefront OBJ become their convex hulls.
    """
    if isinstance(shape, Mesh) and shape.extension() == ".obj":
        with TemporaryDirectory() as folder:
            source, path = shape.source(), Path(folder) / "mesh.obj"
            if source.is_path():
                path = Path(source.path())
            else:
                path.write_bytes(source.in_memory().mesh_file.contents())
            found = ReadObjToTriangleSurfaceMesh(path, shape.scale3())
        corners = [[t.vertex(k) for k in range(3)] for t in found.triangles()]
        return np.array(found.vertices()), np.array(corners, np.int32).reshape(-1, 3)
    points = _points(shape)
    hull = ConvexHull(points)
    a, b, c = points[hull.simplices].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return points, faces.astype(np.int32)


def _points(shape: Shape) -> Array:
    """Return points (n, 3) whose convex hull is a shape, or the hull of a mesh."""
    angle = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(_CORNERS)], -1)
    up = np.array([0.0, 0.0, 1.0])
    polar = np.linspace(0.0, np.pi, _CORNERS // 2 + 1)[1:-1]
    ball = np.concatenate([*(np.sin(a) * circle + np.cos(a) * up for a in polar), [up, -up]])
    if isinstance(shape, Sphere):
        return shape.radius() * ball
    if isinstance(shape, Ellipsoid):
        return ball * [shape.a(), shape.b(), shape.c()]
    if isinstance(shape, Capsule | Cylinder):
        end = shape.radius() * (ball if isinstance(shape, Capsule) else circle)
        shift = 0.5 * shape.length() * up
        return np.concatenate([end + shift, end - shift])
    if isinstance(shape, Box):
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
        return np.asarray(signs * shape.size())
    return np.array(shape.GetConvexHull().vertices())
