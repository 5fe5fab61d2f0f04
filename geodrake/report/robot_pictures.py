"""The robot at the head of a page: links coloured by the errors of their joints."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from PIL import Image

from geodrake.errors import GeodrakeError
from geodrake.identification.logs.model_errors import Comparison, Series
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.report.drawn_robots import Camera, DrawnRobots, Pixels
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import Picture, Pictures
from geodrake.report.play_page import COLORS
from geodrake.report.playback import Excerpt, Playback, PlayedModel
from geodrake.report.played_robots import played_robots
from geodrake.report.posed_links import drawn_shapes
from geodrake.report.robot_scene import Extent, camera_place
from geodrake.report.words import capitalized

_WIDTH, _HEIGHT = 1200, 800  # pixels, before margins are cut
_FARTHER = 1.3  # than a camera that sees the origins of all links, for shapes that reach beyond
_COLORS = 128


def error_pictures(model: RobotModel, compared: Mapping[str, Comparison]) -> Pictures | None:
    """Draw a robot where the first of its models errs most, once for each of them.

    Args:
        compared: Title -> how far a model is from the logs.

    Returns:
        The pictures; None where it has no posture that a log says, or nothing is to be seen.
    """
    try:
        return _drawn(model, compared)
    except GeodrakeError:
        return None


def _drawn(model: RobotModel, compared: Mapping[str, Comparison]) -> Pictures | None:
    if not any(len(series.time) for series in next(iter(compared.values())).series):
        return None
    worst, at = _worst(next(iter(compared.values())))
    q = _posture(model, next(iter(compared.values())), worst, at)
    excerpt = Excerpt(worst.block, 0.0, worst.time[at : at + 1], q)
    played = tuple(_played(title, model, found) for title, found in compared.items())
    shapes = drawn_shapes(model)
    playback = Playback(model.joints, (excerpt,), played, (), 0.0, least_top=1.0)
    near, target = camera_place(Extent.of(model, model.positions(q)), 1)
    camera = Camera(target + _FARTHER * (near - target), target, _WIDTH, _HEIGHT)
    titles, drawn = list[str](), list[Pixels]()
    for robot in played_robots(playback, shapes, Units.of(model)):
        alone = replace(robot, place=np.zeros(3))
        nrms = number(robot.played.comparison.errors.nrms)
        titles.append(", ".join(filter(None, [robot.played.title, f"nrms {nrms}"])))
        drawn.append(DrawnRobots([alone], camera).picture(0))
    if not drawn[0].any():
        return None
    rows, columns = (np.flatnonzero(drawn[0][..., 3].any(axis)) for axis in (1, 0))
    inner = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    pictures = [Picture(t, _png(d[inner])) for t, d in zip(titles, drawn, strict=True)]
    text = (
        f"A link has the colour of its joint's error. The robot stands as it did at "
        f"{worst.time[at]:.2f} s, where {worst.joint} was farthest off."
    )
    notes = tuple(capitalized(note) for note in shapes.notes)
    return Pictures(tuple(pictures), COLORS, percent(playback.top), text, notes)


def _worst(found: Comparison) -> tuple[Series, int]:
    """Return the samples, and the one among them, at which a joint errs most for its size."""
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
            time, position = (np.concatenate([getattr(s, n) for s in own]) for n in _AT)
            q[0, j] = position[np.abs(time - worst.time[at]).argmin()]
    return q


_AT = ("time", "position")


def _played(title: str, model: RobotModel, found: Comparison) -> PlayedModel:
    known = {joint.joint: joint.nrms for joint in found.errors.joints}
    nrms = np.array([[known.get(joint, np.nan) for joint in model.joints]])
    unknown = np.full_like(nrms, np.nan)
    return PlayedModel(title, model, found, False, unknown, unknown, unknown, nrms, unknown)


def _png(picture: Pixels) -> bytes:
    buffer = io.BytesIO()
    few = Image.fromarray(picture).quantize(_COLORS, Image.Quantize.FASTOCTREE)
    few.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
