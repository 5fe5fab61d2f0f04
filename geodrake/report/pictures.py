"""Pictures and videos of robots coloured by the errors of their joints."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from subprocess import SubprocessError
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import GeodrakeError, OutputError
from geodrake.identification.logs.model_errors import Comparison, Series
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.report import style
from geodrake.report.drawn_robots import (
    COLORS,
    Camera,
    ColoredRobot,
    DrawnRobots,
    Pixels,
    error_colors,
    on_ground,
    top_error,
)
from geodrake.report.numbers import number, percent
from geodrake.report.page import Picture, Pictures
from geodrake.report.playback import Playback
from geodrake.report.robot_scene import FRAMES, Extent, camera_place, drawn_shapes, posed_links
from geodrake.report.words import capitalized

RATES = {".mp4": 30, ".gif": 10}  # frames a second of a kind of video

_FARTHER = 1.3  # than a camera that sees the origins of all links, for shapes that reach beyond
_CLOSER = 0.85  # than MeshCat's camera, beside whose view there are panels
_STILL = 1200, 800  # pixels, before margins are cut
_PALETTE = 128  # colours of a still
_WIDTH, _HEIGHT, _PLOTS = 960, 540, 180  # pixels: of a video's view, and the plots below it
_GROUND = (245, 247, 250)


def error_pictures(model: RobotModel, compared: Mapping[str, Comparison]) -> Pictures | None:
    """Draw a robot where the first of its models (by title) errs most, once for each of them.

    None where it has no posture that a log says, or nothing is to be seen.
    """
    try:
        return _drawn(model, compared)
    except GeodrakeError:
        return None


def _drawn(model: RobotModel, compared: Mapping[str, Comparison]) -> Pictures | None:
    first = next(iter(compared.values()))
    if not any(len(series.time) for series in first.series):
        return None
    worst, at = _worst(first)
    q, shapes = model.positions(_posture(model, first, worst, at)), drawn_shapes(model)
    near, target = camera_place(Extent.of(model, q))
    camera = Camera(target + _FARTHER * (near - target), target, *_STILL)
    known = [{joint.joint: joint.nrms for joint in c.errors.joints} for c in compared.values()]
    nrms = np.array([[own.get(joint, np.nan) for joint in model.joints] for own in known])
    top, links = top_error(nrms, 1.0), posed_links(model, q, shapes)
    drawn = [
        DrawnRobots([ColoredRobot(links, np.zeros(3), error_colors(own[None], top))], camera)
        .picture(0)
        for own in nrms
    ]  # fmt: skip
    if not drawn[0].any():
        return None
    rows, columns = (np.flatnonzero(drawn[0][..., 3].any(axis)) for axis in (1, 0))
    inner = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    titles = (
        ", ".join(filter(None, [title, f"nrms {number(found.errors.nrms)}"]))
        for title, found in compared.items()
    )
    pictures = (Picture(t, _png(d[inner])) for t, d in zip(titles, drawn, strict=True))
    text = (
        "Links have the colour of their joint's error. The pose is that at "
        f"{worst.time[at]:.2f} s, where the error of {worst.joint} was largest."
    )
    notes = tuple(map(capitalized, shapes.notes))
    return Pictures(tuple(pictures), COLORS, percent(top), text, notes)


def _worst(found: Comparison) -> tuple[Series, int]:
    """Return the samples and the index at which the relative error of a joint is largest."""
    sizes = {joint.joint: max(joint.std, 1e-300) for joint in found.errors.joints}
    some = [series for series in found.series if len(series.time)]
    worst = max(some, key=lambda s: float(np.abs(s.residual).max()) / sizes[s.joint])
    return worst, int(np.abs(worst.residual).argmax())


def _posture(model: RobotModel, found: Comparison, worst: Series, at: int) -> Array:
    """Return the positions (1, nv) at a sample; those nearest in time of joints at rest there."""
    q = np.zeros((1, len(model.joints)))
    for j, joint in enumerate(model.joints):
        own = [series for series in found.series if series.joint == joint and len(series.time)]
        own = [series for series in own if series.block == worst.block] or own
        if own:
            time = np.concatenate([series.time for series in own])
            position = np.concatenate([series.position for series in own])
            q[0, j] = position[np.abs(time - worst.time[at]).argmin()]
    return q


def _png(picture: Pixels) -> bytes:
    buffer = io.BytesIO()
    few = Image.fromarray(picture).quantize(_PALETTE, Image.Quantize.FASTOCTREE)
    few.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def check_video(file: Path) -> None:
    """Raise if a video cannot be encoded here."""
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
            "No working ffmpeg was found, which MP4 needs.",
            advice='Install one: pip install "geodrake[viewers]"; or name the video FILE.gif.',
        ) from error
    return encoder


def video(found: Playback, suffix: str, *, speed: float = 1.0) -> bytes:
    """Return a video, ".mp4" or ".gif", played at a speed."""
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
    far, target = camera_place(found.extent, len(robots))
    place = target + _CLOSER * (far - target)
    view = DrawnRobots(robots, Camera(place, target, _WIDTH, _HEIGHT))
    plot, left, right = _error_plot(found)
    titles = " | ".join(robot.played.title for robot in robots)
    for number_ in numbers:
        picture = Image.fromarray(np.vstack([on_ground(view.picture(number_), _GROUND), plot]))
        pen = ImageDraw.Draw(picture)
        at = left + (right - left) * number_ / max(len(found.times) - 1, 1)
        pen.line([(at, _HEIGHT + 8), (at, _HEIGHT + _PLOTS - 24)], fill="#1f2a37", width=2)
        log, time = found.own_time(number_)
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
