"""Pages of MeshCat's recordings: robots, efforts as arrows, effects as marks; replays and play."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
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
from geodrake.boundary.escaping import html_text, path_part, printable
from geodrake.control.rollout import Rollout
from geodrake.effects.episode import Episode, PointEpisode
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.dataset import is_body
from geodrake.inertia import Array, is_physical
from geodrake.inertia.ellipsoids import equivalent_ellipsoid
from geodrake.model.robot_model import RobotModel
from geodrake.report import style
from geodrake.report.html import templates
from geodrake.report.numbers import number, percent
from geodrake.report.playback import Playback, PlayedModel, PlayedRobot, effect_words
from geodrake.report.robot_scene import (
    COLORS,
    FRAMES,
    Extent,
    PosedLink,
    body_links,
    camera_place,
    drawn_shapes,
    joint_places,
    levels,
    own_joints,
    posed_links,
)
from geodrake.robot.files.description import drake_messages

MEASURED, PREDICTED, CONTACT = "#64748b", style.AFTER, "#c026a3"  # colours of arrows

LEAST_THICKNESS = 0.002  # semi-axis that is drawn at least, m: a body at the boundary may be flat

_SMALLEST = 0.01  # scale of an arrow: one of no length has no direction
_LARGEST = 1.6
_FLOOR_THICKNESS = 0.004  # m
_GHOSTLY, _INNER = 0.35, 0.99  # opacity and size of ghosts, which are seen where they depart
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
    color: Rgba | None = None,
) -> None:
    """Draw a robot, and record its links.

    Args:
        times: Frame -> its time in the recording, s.
        color: One colour for all links instead of the file's.
    """
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


def draw_floor(meshcat: Meshcat, path: str, extent: Extent, place: Array) -> None:
    """Draw a disc for a robot to stand on at a place (3,), m."""
    disc = Cylinder(0.3 * extent.size, _FLOOR_THICKNESS)
    meshcat.SetObject(f"{path}/floor", disc, Rgba(0.87, 0.89, 0.92, 1.0))
    below = RigidTransform(place - [0.0, 0.0, _FLOOR_THICKNESS])
    meshcat.SetTransform(f"{path}/floor", below)


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


def draw_effects(
    meshcat: Meshcat, path: str, found: Playback, robot: PlayedRobot
) -> list[tuple[str, str, str]]:
    """Draw the effects of a model: bodies, contacts, and discs at joints.

    Returns:
        Of each effect the folder of the scene where it is, words, and the place that it is of; one
        of the whole robot is at its foot.
    """
    model, size = robot.played.model, found.extent.size
    places, bodies, marks = joint_places(model), body_links(model), list[tuple[str, str, str]]()
    by_name = {link.name: link for link in robot.links}
    for k, fitted in enumerate(model.effects):
        effect, words = fitted.effect, effect_words(fitted, found.units)
        if effect.at_motor:
            for joint in effect.where:
                own = f"{link_path(path, places[joint].link)}/disc {path_part(joint)}"
                disc = Cylinder(0.06 * size, 0.01 * size)
                meshcat.SetObject(own, disc, _rgba(style.AFTER, 0.9))
                meshcat.SetTransform(own, places[joint].X_BJ)
                marks.append((own, words, joint))
            continue
        if not bodies.keys() & set(effect.where):
            marks.append((f"{path}/floor", words, effect.place))
            continue
        link = by_name[bodies[effect.where[0]]]
        turns = not isinstance(effect, PointEpisode) or effect.turning
        own = f"effects/{k} {path_part(effect.name)}"
        own = f"{link_path(path, link.name) if turns else path}/{own}"
        if isinstance(effect, PointEpisode):
            force = fitted.parameters[:3]
            norm = float(np.linalg.norm(force))
            axis = force / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
            _draw_arrow(meshcat, f"{own}/arrow", 0.35 * size, CONTACT)
            turned = RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2))
            meshcat.SetTransform(f"{own}/arrow", turned)
            if turns:
                meshcat.SetTransform(own, RigidTransform(effect.point))
            else:
                for frame, X_WB in enumerate(link.X_WB):
                    place = RigidTransform(X_WB.multiply(effect.point))
                    meshcat.SetTransform(own, place, clock(frame))
        elif is_body(effect) and is_physical(fitted.parameters):
            solid = equivalent_ellipsoid(fitted.parameters, least_semi_axis=LEAST_THICKNESS)
            meshcat.SetObject(own, Ellipsoid(*solid.semi_axes), _rgba(style.AFTER, 0.6))
            meshcat.SetTransform(own, RigidTransform(RotationMatrix(solid.rotation), solid.center))
        else:
            meshcat.SetObject(own, Sphere(0.02 * size), _rgba(style.AFTER, 0.8))
        if isinstance(effect, Episode):
            shown = np.concatenate(
                [
                    (effect.weight(e.time - e.began) >= 0.5) & effect.is_of(log_number(e.log))
                    for e in found.excerpts
                ]
            )
            last, changes = len(shown) - 1, 1 + np.flatnonzero(np.diff(shown))
            for frame in sorted({0, *changes.tolist(), last}):
                meshcat.SetProperty(own, "visible", bool(shown[frame]), clock(frame))
        marks.append((own, words, effect.place))
    return marks


def _draw_arrow(meshcat: Meshcat, path: str, length: float, color: str) -> None:
    """Draw an arrow from the origin of a folder along its z."""
    head, width = 0.3 * length, 0.028 * length
    meshcat.SetObject(f"{path}/shaft", Cylinder(width, length - head), _rgba(color))
    middle = RigidTransform([0.0, 0.0, 0.5 * (length - head)])
    meshcat.SetTransform(f"{path}/shaft", middle)
    meshcat.SetObject(f"{path}/head", MeshcatCone(head, 3 * width, 3 * width), _rgba(color))
    down = RotationMatrix.MakeXRotation(np.pi)
    meshcat.SetTransform(f"{path}/head", RigidTransform(down, [0.0, 0.0, length]))


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
    draw_floor(meshcat, "ground", extent, np.zeros(3))
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


def play_page(found: Playback, *, title: str, log_names: Sequence[str], speed: float = 1.0) -> str:
    """Return one HTML page that loads nothing from elsewhere and plays logs over the robot.

    Links have the colour of the error of their joint. A panel names the worst moments, and jumps to
    them; strips show the errors of all joints over time.
    """
    meshcat = calm_meshcat()
    with recording(meshcat):
        marks = [_draw(meshcat, found, robot, k) for k, robot in enumerate(found.robots)]
    meshcat.SetCameraPose(*camera_place(found.extent, len(marks)))
    repairs = (repair for played in found.models for repair in played.model.repairs)
    panel = (
        templates()
        .get_template("play.html.jinja")
        .render(
            title=title,
            logs=", ".join(log_names),
            models=[
                {
                    "title": played.title,
                    "nrms": number(played.comparison.errors.nrms),
                    "data": played.data,
                    "effects": _grouped((place, words) for _, words, place in own).items(),
                }
                for played, own in zip(found.models, marks, strict=True)
            ],
            groups=[(played.title, _moments(played, found)) for played in found.models],
            notes=list(dict.fromkeys((*repairs, *found.shapes.notes, *found.left_out))),
            gradient=", ".join(COLORS),
            top=percent(found.top),
            measured=MEASURED,
            predicted=style.AFTER,
            ghosts=any(map(_has_ghost, found.models)),
            # JSON that may stand in a script of a page.
            data=json.dumps(_data(found, marks, speed)).replace("<", "\\u003c"),
        )
    )
    view = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    icon = '<link rel="icon" href="data:,">'  # which browsers would ask a server for
    page = str(meshcat.StaticHtml())
    head, _, foot = page.rpartition("</body>")
    titled = f"<title>{html_text(title)}</title>{view}{icon}"
    return f"{head.replace('<title>Drake MeshCat</title>', titled, 1)}{panel}</body>{foot}"


def _path(played: PlayedModel, k: int) -> str:
    """Return the folder of a robot in the scene."""
    return f"robot/{k} {path_part(played.title)}"


def _has_ghost(played: PlayedModel) -> bool:
    return not np.isnan(played.simulated).all()


def _draw(
    meshcat: Meshcat, found: Playback, robot: PlayedRobot, k: int
) -> list[tuple[str, str, str]]:
    """Record a robot and its ghost, and return what to say of its effects."""
    played, path = robot.played, _path(robot.played, k)
    times = {frame: clock(frame) for frame in range(len(found.q))}
    draw_robot(meshcat, path, robot.links, times)
    draw_floor(meshcat, path, found.extent, robot.place)
    draw_efforts(meshcat, path, played, found.extent.size)
    if _has_ghost(played):
        ghost, there = f"ghost/{k}", np.asarray(np.isfinite(played.simulated).all(1))
        q = played.model.positions(np.where(there[:, None], played.simulated, found.q))
        links = posed_links(played.model, q, found.shapes, robot.place)
        shown = {frame: time for frame, time in times.items() if there[frame]}
        draw_robot(meshcat, ghost, links, shown, color=_rgba(style.AFTER, _GHOSTLY))
        meshcat.SetProperty(ghost, "scale", [_INNER] * 3)
        meshcat.SetTransform(ghost, RigidTransform((1.0 - _INNER) * robot.place))
        for frame, time in times.items():
            meshcat.SetProperty(ghost, "visible", bool(there[frame]), time)
    return draw_effects(meshcat, path, found, robot)


def _grouped(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Return each place with all that is said of it."""
    found: dict[str, list[str]] = {}
    for place, words in pairs:
        found.setdefault(place, []).append(words)
    return found


def _moments(played: PlayedModel, found: Playback) -> list[dict[str, Any]]:
    several = len({excerpt.log for excerpt in found.excerpts}) > 1
    return [
        {
            "frame": moment.frame,
            "joint": moment.joint,
            "place": found.joints.index(moment.joint),
            "error": f"{number(moment.error)} {found.units.effort([moment.joint])}",
            "relative": percent(moment.relative),
            "time": f"{moment.time:.2f} s" + (f" of {moment.log}" if several else ""),
        }
        for moment in played.moments
    ]


def _data(
    found: Playback, marks: Sequence[Sequence[tuple[str, str, str]]], speed: float
) -> dict[str, Any]:
    """Return what the page's script reads."""
    units = found.units
    curves = ("measured", "predicted", "simulated")
    moments = [moment for played in found.models for moment in played.moments]
    return {
        "rate": FRAMES,
        "frames": len(found.q),
        "speed": speed,
        "several": len({excerpt.log for excerpt in found.excerpts}) > 1,
        "joints": [printable(joint) for joint in found.joints],
        "first": found.joints.index(moments[0].joint) if moments else 0,
        "positions": _packed(found.q.astype("<f4")),
        "angles": [units.at(joint, "rad") for joint in found.joints],
        "inks": {"measured": MEASURED, "predicted": style.AFTER, "before": style.BEFORE},
        "units": [units.effort([joint]) for joint in found.joints],
        "colors": COLORS,
        "excerpts": [
            {"log": printable(e.log), "start": float(e.time[0]), "frames": len(e.time)}
            for e in found.excerpts
        ],
        "robots": [
            {
                "title": printable(played.title),
                "path": f"{_path(played, k)}/floor",
                "levels": _packed(levels(played.relative, found.top)),
                "errors": _packed(played.relative.astype("<f4")),
                **{name: _packed(getattr(played, name).astype("<f4")) for name in curves},
                "moved": [
                    [f"{link_path(_path(played, k), link)}/shapes" for link in place.moved]
                    for place in own_joints(played.model)
                ],
                # One label a place: where several effects are, the first and how many more.
                "marks": [
                    {"path": path, "words": first + (f" + {len(more)} more" if more else "")}
                    for path, (first, *more) in _grouped(
                        (path, printable(words)) for path, words, _ in own
                    ).items()
                ],
            }
            for k, (played, own) in enumerate(zip(found.models, marks, strict=True))
        ],
    }


def _packed(values: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
