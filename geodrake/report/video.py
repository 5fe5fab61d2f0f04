"""A playback as a video: the robots, coloured by the errors of their joints, and the efforts."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from pydrake.common.value import Value
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    LightParameter,
    MakeRenderEngineVtk,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo

from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import OutputError
from geodrake.inertia import Array
from geodrake.report import style
from geodrake.report.numbers import Units
from geodrake.report.play_page import COLORS
from geodrake.report.playback import Playback
from geodrake.report.played_robots import PlayedRobot, frame_times, played_robots
from geodrake.report.robot_scene import FRAMES, VIEW, Extent, camera_place
from geodrake.robot.shapes import RobotShapes

RATES = {".mp4": 30, ".gif": 10}
"""Frames a second of a kind of video."""

_WIDTH, _HEIGHT, _PLOTS = 960, 540, 180  # pixels: of the view, and the height of the plots below
_CLOSER = 0.85  # than MeshCat's camera, beside whose view there are panels
_SHADES = 8  # colours of errors
_AWAY = RigidTransform([0.0, 0.0, -1e4])  # where what is not shown is, m
Picture = NDArray[np.uint8]


def check_video(file: Path) -> None:
    """Refuse a video that nothing here can encode.

    Raises:
        OutputError: Neither the package nor the program that encodes MP4 is here.
    """
    if file.suffix.lower() == ".mp4":
        _encoder()


def _encoder() -> Any:
    encoder = optional_package(
        "imageio_ffmpeg", "viewers", "videos in MP4 (GIF needs none)", OutputError
    )
    try:
        encoder.get_ffmpeg_exe()
    except RuntimeError as error:
        raise OutputError(
            "There is no ffmpeg, which encodes MP4.",
            advice='Install one: pip install "geodrake[viewers]"; or name the video FILE.gif.',
        ) from error
    return encoder


def video(
    playback: Playback, shapes: RobotShapes, suffix: str, *, units: Units, speed: float = 1.0
) -> bytes:
    """Return a video of a playback, ".mp4" or ".gif".

    Args:
        shapes: Shapes of the links.
        speed: Seconds of the log in a second of the video.

    Raises:
        OutputError: It cannot be drawn or encoded on this machine.
    """
    rate, count = RATES[suffix], len(playback.q)
    step = FRAMES * speed / rate
    numbers = np.minimum(np.arange(0.0, count, step).round().astype(int), count - 1)
    frames = _frames(playback, shapes, units, numbers.tolist())
    if suffix == ".gif":
        images = [Image.fromarray(f).convert("P", palette=Image.Palette.ADAPTIVE) for f in frames]
        buffer = io.BytesIO()
        images[0].save(
            buffer, "GIF", save_all=True, append_images=images[1:], duration=1000 // rate, loop=0
        )
        return buffer.getvalue()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "play.mp4"
        size = (_WIDTH, _HEIGHT + _PLOTS)
        out = _encoder().write_frames(str(path), size, fps=rate, macro_block_size=4)
        out.send(None)
        for frame in frames:
            out.send(np.ascontiguousarray(frame))
        out.close()
        return path.read_bytes()


def _frames(
    playback: Playback, shapes: RobotShapes, units: Units, numbers: list[int]
) -> Iterator[Picture]:
    robots = played_robots(playback, shapes, units)
    view = _View(robots, Extent.of(robots[-1].played.model, _positions(playback)))
    plot, left, right = _error_plot(playback)
    times = frame_times(playback)
    for number in numbers:
        picture = Image.fromarray(np.vstack([view.picture(number), plot]))
        pen = ImageDraw.Draw(picture)
        at = left + (right - left) * number / max(len(times) - 1, 1)
        pen.line([(at, _HEIGHT + 8), (at, _HEIGHT + _PLOTS - 24)], fill="#1f2a37", width=2)
        log, time = playback.own_time(number)
        titles = " | ".join(robot.played.title for robot in robots)
        pen.text((16, 12), f"{titles}    {time:.2f} s of {log}", fill="#1f2a37", font_size=18)
        yield np.asarray(picture)


def _positions(playback: Playback) -> Array:
    return playback.models[-1].model.positions(playback.q)


@style.own_look()
def _error_plot(playback: Playback) -> tuple[Picture, float, float]:
    """Return a plot of the errors of all joints, and where its time begins and ends, pixels."""
    figure = Figure(figsize=(_WIDTH / 100, _PLOTS / 100), dpi=100)
    axes = figure.add_subplot()
    rows = np.arange(len(playback.q))
    for played, color in zip(playback.models[::-1], (style.AFTER, style.BEFORE), strict=False):
        worst = np.max(np.nan_to_num(played.relative), axis=1)
        axes.plot(rows, 100 * worst, lw=1.4, color=color, label=style.label(played.title))
    axes.set_xlim(0, max(len(rows) - 1, 1))
    axes.set_ylim(0, None)
    axes.set_xticks([])
    axes.set_ylabel("error, %", fontsize=9)
    axes.set_title("largest error of a joint, over the deviation of its effort", fontsize=9)
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.05), frameon=False)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.subplots_adjust(left=0.07, right=0.8, bottom=0.08, top=0.86)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="rgba", dpi=100)
    pixels = np.frombuffer(buffer.getvalue(), np.uint8).reshape(_PLOTS, _WIDTH, 4)[..., :3]
    left, right = (axes.transData.transform((x, 0))[0] for x in axes.get_xlim())
    return pixels, float(left), float(right)


class _View:
    """Pictures of the robots, drawn by Drake's renderer without a window."""

    def __init__(self, robots: list[PlayedRobot], extent: Extent) -> None:
        self._robots, self._scene = robots, SceneGraph()
        self._scene.AddRenderer("view", _renderer())
        self._source = self._scene.RegisterSource("robots")
        self._frames: list[tuple[PlayedRobot, int, list[FrameId]]] = []
        shades = LinearSegmentedColormap.from_list("error", COLORS, N=_SHADES)
        self._shades = shades(np.arange(_SHADES))[:, :3]
        for robot in robots:
            for number in range(len(robot.links)):
                self._register(robot, number)
        self._context = self._scene.CreateDefaultContext()
        far, target = camera_place(extent, len(robots))
        p_WC = target + _CLOSER * (far - target)
        forward = (target - p_WC) / np.linalg.norm(target - p_WC)
        side = np.cross(forward, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side)
        R_WC = RotationMatrix(np.column_stack([side, np.cross(forward, side), forward]))
        self._X_WC = RigidTransform(R_WC, p_WC)
        core = RenderCameraCore(
            "view", CameraInfo(_WIDTH, _HEIGHT, VIEW), ClippingRange(0.01, 100.0), RigidTransform()
        )
        self._camera = ColorRenderCamera(core, False)

    def picture(self, frame: int) -> Picture:
        """Return the picture (height, width, 3) of a frame."""
        poses = FramePoseVector()
        for robot, number, variants in self._frames:
            link = robot.links[number]
            X_WB = RigidTransform(robot.place) @ link.X_WB[frame]
            shown = self._shade(robot, number, frame) if len(variants) > 1 else 0
            for k, variant in enumerate(variants):
                poses.set_value(variant, X_WB if k == shown else _AWAY)
        port = self._scene.get_source_pose_port(self._source)
        port.FixValue(self._context, Value(poses))
        query = self._scene.get_query_output_port().Eval(self._context)
        image = query.RenderColorImage(self._camera, self._scene.world_frame_id(), self._X_WC)
        return np.asarray(image.data[..., :3])

    def _shade(self, robot: PlayedRobot, number: int, frame: int) -> int:
        color = robot.color(robot.links[number], frame)[:3] / 255.0
        return int(np.argmin(np.linalg.norm(self._shades - color, axis=1)))

    def _register(self, robot: PlayedRobot, number: int) -> None:
        link, variants = robot.links[number], []
        colors = [None] if link.joint is None else [Rgba(*shade, 1.0) for shade in self._shades]
        for k, color in enumerate(colors):
            frame = self._scene.RegisterFrame(
                self._source, GeometryFrame(f"{robot.name}/{link.name}/{k}")
            )
            for i, one in enumerate(link.shapes):
                instance = GeometryInstance(one.X_BG, one.shape, f"{i}")
                looks = PerceptionProperties()
                looks.AddProperty("phong", "diffuse", color or one.color)
                looks.AddProperty("label", "id", RenderLabel.kDontCare)
                instance.set_perception_properties(looks)
                self._scene.RegisterGeometry(self._source, frame, instance)
            variants.append(frame)
        self._frames.append((robot, number, variants))


def _renderer() -> Any:
    """Return Drake's renderer, on whatever draws here.

    Raises:
        OutputError: Nothing does.
    """
    lights = [
        LightParameter(type="directional", direction=way, frame="camera", intensity=0.7)
        for way in ([0.3, 0.5, 1.0], [-0.5, 0.2, 1.0])
    ]
    for backend in ("", "EGL"):
        try:
            return MakeRenderEngineVtk(
                RenderEngineVtkParams(
                    backend=backend,
                    default_clear_color=np.array([0.96, 0.97, 0.98]),
                    lights=lights,
                )
            )
        except RuntimeError as error:
            reason = str(error).partition(";")[0]
    raise OutputError(
        f"A video cannot be drawn here: {reason}.",
        advice="Install Mesa's EGL (libegl1, libgl1-mesa-dri), or write the page with --out.",
    )
