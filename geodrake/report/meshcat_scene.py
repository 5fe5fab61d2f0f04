"""Robots in MeshCat recordings: links, efforts as arrows, effects as marks; and replays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from pydrake.geometry import (
    Cylinder,
    Ellipsoid,
    Meshcat,
    MeshcatAnimation,
    MeshcatCone,
    MeshcatParams,
    Rgba,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import html_text, path_part
from geodrake.control.rollout import Rollout
from geodrake.effects.episode import Episode, PointEpisode
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.dataset import is_body
from geodrake.inertia import Array, is_physical
from geodrake.inertia.ellipsoids import equivalent_ellipsoid
from geodrake.model.robot_model import RobotModel
from geodrake.report import style
from geodrake.report.numbers import Units
from geodrake.report.playback import Excerpt, PlayedModel, effect_words
from geodrake.report.robot_scene import (
    FRAMES,
    Extent,
    PosedLink,
    body_links,
    camera_place,
    drawn_shapes,
    joint_places,
    own_joints,
    posed_links,
)
from geodrake.robot.files.description import drake_messages

MEASURED, PREDICTED, CONTACT = "#64748b", style.AFTER, "#c026a3"  # colours of arrows

LEAST_THICKNESS = 0.002  # semi-axis that is drawn at least, m: a body at the boundary may be flat

_SMALLEST = 0.01  # scale of an arrow: one of no length has no direction
_LARGEST = 1.6
_AROUND, _ACROSS = 32, 10  # corners of a ring
_FLOOR_THICKNESS = 0.004  # m
_APART = 0.002  # of their size, by which robots at one place differ
_REPLAYED = ("measured", "#8a94a0", 0.35)
_BEFORE, _AFTER = ("simulated before", style.BEFORE, 0.6), ("simulated", style.AFTER, 0.85)


def clock(frame: int) -> float:
    """Return the time of a frame in a recording, s: its middle, so that none is counted twice."""
    return (frame + 0.5) / FRAMES


def calm_meshcat() -> Meshcat:
    """Return a MeshCat for a page: light, without axes, on any port."""
    with drake_messages():
        meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    meshcat.SetProperty("/Background/<object>", "top_color", [1.0, 1.0, 1.0])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Grid", "visible", False)
    return meshcat


@contextmanager
def recording(meshcat: Meshcat) -> Iterator[None]:
    """Record a looping animation."""
    meshcat.StartRecording(frames_per_second=FRAMES, set_visualizations_while_recording=False)
    yield
    meshcat.StopRecording()
    made = meshcat.get_mutable_recording()
    made.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    made.set_repetitions(1_000_000)
    meshcat.PublishRecording()


def legend(page: str, entries: Sequence[tuple[str, str]]) -> str:
    """Return a MeshCat page with a legend of its colours."""
    spans = "".join(
        f'<div><span style="display:inline-block;width:12px;height:12px;margin-right:8px;'
        f'border-radius:6px;background:{color}"></span>{html_text(name)}</div>'
        for color, name in entries
    )
    box = (
        '<div style="position:absolute;left:16px;top:16px;padding:10px 14px;background:#ffffffd0;'
        f'font:14px/1.6 sans-serif;color:#1f2a37;pointer-events:none">{spans}</div>'
    )
    head, _, foot = page.rpartition("</body>")
    return f"{head}{box}</body>{foot}"


def link_path(robot: str, link: str) -> str:
    """Return the folder of a link, whose frame is the link's, from that of its robot."""
    return f"{robot}/{path_part(link)}"


def draw_robot(
    meshcat: Meshcat,
    path: str,
    links: Iterable[PosedLink],
    times: Mapping[int, float],
    *,
    p_WR: Array | None = None,
    color: Rgba | None = None,
) -> None:
    """Draw a robot, and record its links.

    Args:
        times: Frame -> its time in the recording, s.
        p_WR: (3,) where the robot stands, m.
        color: One colour for all links instead of the file's.
    """
    meshcat.SetTransform(path, RigidTransform([0.0, 0.0, 0.0] if p_WR is None else p_WR))
    for link in links:
        own = link_path(path, link.name)
        for k, one in enumerate(link.shapes):
            meshcat.SetObject(f"{own}/shapes/{k}", one.shape, color or one.color)
            meshcat.SetTransform(f"{own}/shapes/{k}", one.X_BG)
        if link.fixed:
            meshcat.SetTransform(own, link.X_WB[0])
        else:
            for frame, time in times.items():
                meshcat.SetTransform(own, link.X_WB[frame], time)


def draw_floor(meshcat: Meshcat, path: str, extent: Extent) -> None:
    """Draw a disc for a robot to stand on."""
    disc = Cylinder(0.3 * extent.size, _FLOOR_THICKNESS)
    meshcat.SetObject(f"{path}/floor", disc, Rgba(0.87, 0.89, 0.92, 1.0))
    meshcat.SetTransform(f"{path}/floor", RigidTransform([0.0, 0.0, -_FLOOR_THICKNESS]))


def draw_efforts(meshcat: Meshcat, path: str, played: PlayedModel, size: float) -> None:
    """Record measured and predicted effort at every joint, as arrows along its axis.

    The direction is that of the right hand for joints that turn. Arrows of a joint's largest
    measured effort have one length at all joints, a share of the robot's size, m.
    """
    peak = np.nanmax(np.abs(played.measured), axis=0, initial=1e-12)
    kinds = (
        ("measured", played.measured, MEASURED, -1),
        ("predicted", played.predicted, PREDICTED, 1),
    )
    for name, efforts, color, side in kinds:
        scale = np.nan_to_num(efforts / peak)
        scale = np.where(scale < 0, -1.0, 1.0) * np.clip(np.abs(scale), _SMALLEST, _LARGEST)
        for joint, place in enumerate(own_joints(played.model)):
            folder = f"{link_path(path, place.link)}/efforts/{path_part(place.joint)}"
            meshcat.SetTransform(folder, place.X_BJ)
            aside = RigidTransform([0.02 * size * side, 0.0, 0.0])
            meshcat.SetTransform(f"{folder}/{name}", aside)
            _draw_arrow(meshcat, f"{folder}/{name}/arrow", 0.22 * size, color)
            for frame, length in enumerate(scale[:, joint].tolist()):
                arrow = f"{folder}/{name}/arrow"
                meshcat.SetProperty(arrow, "scale", [1.0, 1.0, length], clock(frame))


@dataclass(frozen=True)
class Mark:
    """A label in the scene."""

    path: str  # folder of the scene that is there
    words: str
    place: str  # the joint or body, or what else the effect is of


def draw_effects(
    meshcat: Meshcat,
    path: str,
    model: RobotModel,
    links: Iterable[PosedLink],
    excerpts: Sequence[Excerpt],
    *,
    units: Units,
    size: float,
) -> list[Mark]:
    """Draw the effects of a model, and return labels and their positions.

    These are bodies, contacts, and rings at joints; what is of the whole robot is said at its foot.
    """
    places, bodies, marks = joint_places(model), body_links(model), list[Mark]()
    by_name = {link.name: link for link in links}
    for k, fitted in enumerate(model.effects):
        effect, words = fitted.effect, effect_words(fitted, units)
        if effect.at_motor:
            for joint in effect.where:
                own = f"{link_path(path, places[joint].link)}/ring {path_part(joint)}"
                vertices, faces = ring(0.06 * size, 0.005 * size)
                meshcat.SetTriangleMesh(own, vertices.T, faces.T, _rgba(style.AFTER, 0.9))
                meshcat.SetTransform(own, places[joint].X_BJ)
                marks.append(Mark(own, words, joint))
            continue
        if not bodies.keys() & set(effect.where):
            marks.append(Mark(f"{path}/floor", words, effect.place))
            continue
        link = by_name[bodies[effect.where[0]]]
        turns = not isinstance(effect, PointEpisode) or effect.turning
        own = f"effects/{k} {path_part(effect.name)}"
        own = f"{link_path(path, link.name) if turns else path}/{own}"
        if isinstance(effect, PointEpisode):
            _draw_contact(meshcat, own, effect, fitted.parameters[:3], size)
            if not turns:
                for frame, X_WB in enumerate(link.X_WB):
                    place = RigidTransform(X_WB.multiply(effect.point))
                    meshcat.SetTransform(own, place, clock(frame))
        elif is_body(effect) and is_physical(fitted.parameters):
            solid = equivalent_ellipsoid(fitted.parameters)
            shape = Ellipsoid(*np.maximum(solid.semi_axes, LEAST_THICKNESS))
            meshcat.SetObject(own, shape, _rgba(style.AFTER, 0.6))
            meshcat.SetTransform(own, RigidTransform(RotationMatrix(solid.rotation), solid.center))
        else:
            meshcat.SetObject(own, Sphere(0.02 * size), _rgba(style.AFTER, 0.8))
        if isinstance(effect, Episode):
            there = [
                (effect.weight(e.time - e.began) >= 0.5) & effect.is_of(log_number(e.log))
                for e in excerpts
            ]
            shown = np.concatenate(there)
            last, changes = len(shown) - 1, 1 + np.flatnonzero(np.diff(shown))
            for frame in sorted({0, *changes.tolist(), last}):
                meshcat.SetProperty(own, "visible", bool(shown[frame]), clock(frame))
        marks.append(Mark(own, words, effect.place))
    return marks


def _draw_contact(
    meshcat: Meshcat, path: str, effect: PointEpisode, force: Array, size: float
) -> None:
    """Draw an arrow of the contact force on the robot at its point."""
    if effect.turning:
        meshcat.SetTransform(path, RigidTransform(effect.point))
    norm = float(np.linalg.norm(force))
    axis = force / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
    _draw_arrow(meshcat, f"{path}/arrow", 0.35 * size, CONTACT)
    turned = RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2))
    meshcat.SetTransform(f"{path}/arrow", turned)


def _draw_arrow(meshcat: Meshcat, path: str, length: float, color: str) -> None:
    """Draw an arrow from the origin of a folder along its z."""
    head, width = 0.3 * length, 0.028 * length
    meshcat.SetObject(f"{path}/shaft", Cylinder(width, length - head), _rgba(color))
    middle = RigidTransform([0.0, 0.0, 0.5 * (length - head)])
    meshcat.SetTransform(f"{path}/shaft", middle)
    meshcat.SetObject(f"{path}/head", MeshcatCone(head, 3 * width, 3 * width), _rgba(color))
    down = RotationMatrix.MakeXRotation(np.pi)
    meshcat.SetTransform(f"{path}/head", RigidTransform(down, [0.0, 0.0, length]))


def ring(radius: float, thickness: float) -> tuple[Array, NDArray[np.int32]]:
    """Return vertices (n, 3) and corners of triangles (m, 3) of a ring about z, m."""
    u, v = np.meshgrid(
        np.linspace(0, 2 * np.pi, _AROUND, endpoint=False),
        np.linspace(0, 2 * np.pi, _ACROSS, endpoint=False),
        indexing="ij",
    )
    far = radius + thickness * np.cos(v)
    vertices = np.stack([far * np.cos(u), far * np.sin(u), thickness * np.sin(v)], -1)
    number_ = np.arange(_AROUND * _ACROSS).reshape(_AROUND, _ACROSS)
    right, up = np.roll(number_, -1, 0), np.roll(number_, -1, 1)
    both = np.roll(right, -1, 1)
    faces = np.stack([number_, right, both, number_, both, up], -1).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces.astype(np.int32)


def _rgba(color: str, opaque: float = 1.0) -> Rgba:
    return Rgba(*to_rgb(color), opaque)


@typed
def replay_page(model: RobotModel, times: Array, q: Array) -> str:
    """Return a self-contained HTML page that replays positions (N, nq) at instants (N,), s.

    The robot looks as its file says, meshes included; links that cannot be shown are sticks.
    """
    return _replayed(model, times, {"robot": q}, {})


@typed
def rollout_replay_page(model: RobotModel, after: Rollout, before: Rollout | None = None) -> str:
    """Return an HTML page of a rollout's windows: the measured and the simulated robot.

    A simulated robot that breaks off stays where it was.
    """
    looks, motions = [_REPLAYED, _AFTER], [_frames(after, "measured"), _frames(after, "simulated")]
    if before is not None:
        looks.insert(1, _BEFORE)
        motions.insert(1, _frames(before, "simulated"))
    named = {look[0]: model.positions(q) for look, q in zip(looks, motions, strict=True)}
    times = np.array([clock(frame) for frame in range(len(motions[0]))])
    colors = {name: _rgba(color, opaque) for name, color, opaque in looks}
    page = _replayed(model, times, named, colors)
    return legend(page, [(color, name) for name, color, _ in looks])


def _replayed(
    model: RobotModel, times: Array, motions: Mapping[str, Array], colors: Mapping[str, Rgba]
) -> str:
    """Return a page with one robot for each motion, all at one place."""
    meshcat, shapes = calm_meshcat(), drawn_shapes(model)
    extent = Extent.of(model, np.concatenate(list(motions.values())))
    with recording(meshcat):
        for k, (name, q) in enumerate(motions.items()):
            path, links = path_part(name), posed_links(model, q, shapes)
            draw_robot(
                meshcat, path, links, dict(enumerate(times.tolist())), color=colors.get(name)
            )
            # So that surfaces at one place do not flicker.
            meshcat.SetProperty(path, "scale", [1.0 - _APART * k] * 3)
    draw_floor(meshcat, "ground", extent)
    meshcat.SetCameraPose(*camera_place(extent))
    page = str(meshcat.StaticHtml())
    return legend(page, [("#c78a1e", note) for note in shapes.notes]) if shapes.notes else page


def _frames(found: Rollout, name: str) -> Array:
    """Return (F, nv) positions of all windows, one after another, at the rate of recordings."""
    parts = []
    for window in found.windows:
        values = getattr(window, name)
        known = np.isfinite(values).all(1)
        frames = np.arange(window.time[0], window.time[-1] + 1e-9, 1.0 / FRAMES)
        last = values[known] if known.any() else window.measured[:1]
        own = window.time[known] if known.any() else window.time[:1]
        parts.append(np.stack([np.interp(frames, own, x) for x in last.T], -1))
    return np.concatenate(parts)
