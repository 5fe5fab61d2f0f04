"""A playback as a video: the robots, coloured by the errors of their joints, and the efforts."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from subprocess import SubprocessError
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import OutputError
from geodrake.report import style
from geodrake.report.drawn_robots import Camera, DrawnRobots, Pixels, on_ground
from geodrake.report.numbers import Units
from geodrake.report.playback import Playback
from geodrake.report.played_robots import frame_times, played_robots
from geodrake.report.robot_scene import FRAMES, Extent, camera_place
from geodrake.robot.shapes import RobotShapes

RATES = {".mp4": 30, ".gif": 10}
"""Frames a second of a kind of video."""

_WIDTH, _HEIGHT, _PLOTS = 960, 540, 180  # pixels: of the view, and the height of the plots below
_CLOSER = 0.85  # than MeshCat's camera, beside whose view there are panels
_GROUND = (245, 247, 250)


def check_video(file: Path) -> None:
    """Refuse a video that nothing here can encode."""
    if file.suffix.lower() == ".mp4":
        _encoder()


def _encoder() -> Any:
    encoder = optional_package(
        "imageio_ffmpeg", "viewers", "videos in MP4 (GIF needs none)", OutputError
    )
    try:
        encoder.get_ffmpeg_version()  # by running it
    except (RuntimeError, OSError, LookupError, SubprocessError) as error:
        raise OutputError(
            "There is no ffmpeg that runs, which encodes MP4.",
            advice='Install one: pip install "geodrake[viewers]"; or name the video FILE.gif.',
        ) from error
    return encoder


def video(
    playback: Playback, shapes: RobotShapes, suffix: str, *, units: Units, speed: float = 1.0
) -> bytes:
    """Return a video of a playback, ".mp4" or ".gif".

    Args:
        speed: Seconds of the log in a second of the video.
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
        try:
            out = _encoder().write_frames(str(path), size, fps=rate, macro_block_size=4)
            out.send(None)
            for frame in frames:
                out.send(np.ascontiguousarray(frame))
            out.close()
            return path.read_bytes()
        except OSError as error:
            raise OutputError(
                "This ffmpeg does not encode MP4.", advice="Name the video FILE.gif."
            ) from error


def _frames(
    playback: Playback, shapes: RobotShapes, units: Units, numbers: list[int]
) -> Iterator[Pixels]:
    robots = played_robots(playback, shapes, units)
    model = playback.models[-1].model
    extent = Extent.of(model, model.positions(playback.q))
    far, target = camera_place(extent, len(robots))
    place = target + _CLOSER * (far - target)
    view = DrawnRobots(robots, Camera(place, target, _WIDTH, _HEIGHT))
    plot, left, right = _error_plot(playback)
    times = frame_times(playback)
    for number in numbers:
        picture = Image.fromarray(np.vstack([on_ground(view.picture(number), _GROUND), plot]))
        pen = ImageDraw.Draw(picture)
        at = left + (right - left) * number / max(len(times) - 1, 1)
        pen.line([(at, _HEIGHT + 8), (at, _HEIGHT + _PLOTS - 24)], fill="#1f2a37", width=2)
        log, time = playback.own_time(number)
        titles = " | ".join(robot.played.title for robot in robots)
        pen.text((16, 12), f"{titles}    {time:.2f} s of {log}", fill="#1f2a37", font_size=18)
        yield np.asarray(picture)


@style.own_look()
def _error_plot(playback: Playback) -> tuple[Pixels, float, float]:
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
