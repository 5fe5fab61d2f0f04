"""Videos of robots coloured by the errors of their joints."""

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
from geodrake.report.pictures import Camera, Pixels, drawn_robots
from geodrake.report.playback import Playback
from geodrake.report.robot_scene import FRAMES, camera_place

RATES = {".mp4": 30, ".gif": 10}  # frames per second

_DISTANCE = 0.85  # over that of `camera_place`, which leaves room for panels
_WIDTH, _HEIGHT, _PLOTS = 960, 540, 180  # pixels of a video, and height of the plots below it
_GROUND = (245, 247, 250)


def check_video(file: Path) -> None:
    """Raise if a video cannot be encoded here."""
    if file.suffix.lower() == ".mp4":
        _encoder()


def _encoder() -> Any:
    encoder = optional_package(
        "imageio_ffmpeg", "viewers", "videos in MP4 (GIF needs none)", OutputError
    )
    try:
        encoder.get_ffmpeg_version()  # runs ffmpeg
    except (RuntimeError, OSError, LookupError, SubprocessError) as error:
        raise OutputError(
            "No working ffmpeg was found, which MP4 needs.",
            advice='Install one: pip install "geodrake[viewers]"; or name the video FILE.gif.',
        ) from error
    return encoder


def video(found: Playback, suffix: str, *, speed: float = 1.0) -> bytes:
    """Return a video in the format of a suffix, ".mp4" or ".gif"."""
    rate, count = RATES[suffix], len(found.q)
    step = FRAMES * speed / rate
    numbers = np.minimum(np.arange(0.0, count, step).round().astype(int), count - 1)
    frames = _frames(found, numbers.tolist())
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
                "This ffmpeg cannot encode MP4.", advice="Name the video FILE.gif."
            ) from error


def _frames(found: Playback, numbers: list[int]) -> Iterator[Pixels]:
    robots = found.robots
    place, target = camera_place(found.extent, len(robots))
    place = target + _DISTANCE * (place - target)
    colored = [(robot.links, robot.colors) for robot in robots]
    views = drawn_robots(colored, Camera(place, target, _WIDTH, _HEIGHT), numbers)
    plot, left, right = _error_plot(found)
    titles = " | ".join(robot.played.title for robot in robots)
    for number_, drawn in zip(numbers, views, strict=True):
        alpha = drawn[..., 3:] / 255.0
        blend = np.rint(drawn[..., :3] * alpha + np.array(_GROUND) * (1.0 - alpha))
        picture = Image.fromarray(np.vstack([blend.astype(np.uint8), plot]))
        pen = ImageDraw.Draw(picture)
        x = left + (right - left) * number_ / max(len(found.times) - 1, 1)
        pen.line([(x, _HEIGHT + 8), (x, _HEIGHT + _PLOTS - 24)], fill="#1f2a37", width=2)
        log, time = found.instants[number_]
        pen.text((16, 12), f"{titles}    {time:.2f} s of {log}", fill="#1f2a37", font_size=18)
        yield np.asarray(picture)


@style.own_look()
def _error_plot(playback: Playback) -> tuple[Pixels, float, float]:
    """Return a plot of the errors of all joints, and the first and last pixel of its time axis."""
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
    axes.set_title(
        "largest error of a joint, relative to the standard deviation of its effort", fontsize=9
    )
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.05), frameon=False)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.subplots_adjust(left=0.07, right=0.8, bottom=0.08, top=0.86)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="rgba", dpi=100)
    pixels = np.frombuffer(buffer.getvalue(), np.uint8).reshape(_PLOTS, _WIDTH, 4)[..., :3]
    left, right = (axes.transData.transform((x, 0))[0] for x in axes.get_xlim())
    return pixels, float(left), float(right)
