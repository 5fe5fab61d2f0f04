"""MeshCat pages of recorded robots, with efforts as arrows and effects as marks."""

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

LEAST_THICKNESS = 0.002  # smallest drawn semi-axis, m: a body at the boundary may be flat

_SMALLEST, _LARGEST = 0.01, 1.6  # scales of arrows; one without length has no direction
_OF_WEIGHT = 3.0  # scale of an arrow of the robot's weight
_FLOOR_THICKNESS = 0.004  # m
_GHOST_OPACITY, _GHOST_SIZE = 0.35, 0.99  # ghosts inside the robot are hidden
_SIZE_STEP = 0.002  # difference in size of robots at the same place, so that they do not flicker
_REPLAYED = ("measured", "#8a94a0", 0.35)
_BEFORE, _AFTER = ("simulated before", style.BEFORE, 0.6), ("simulated", style.AFTER, 0.85)


def clock(frame: int) -> float:
    """Return the time of a frame in a recording, s: its middle, as MeshCat rounds to frames."""
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
    animation = meshcat.get_mutable_recording()
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(1_000_000)
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
    """Return the folder of a link of a robot; its frame is the link's."""
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
        folder = link_path(path, link.name)
        for k, shape in enumerate(link.shapes):
            meshcat.SetObject(f"{folder}/shapes/{k}", shape.shape, color or shape.color)
            meshcat.SetTransform(f"{folder}/shapes/{k}", shape.X_BG)
        if link.fixed:
            meshcat.SetTransform(folder, link.X_WB[0])
        else:
            for frame, time in times.items():
                meshcat.SetTransform(folder, link.X_WB[frame], time)


def draw_floor(meshcat: Meshcat, path: str, extent: Extent, place: Array) -> None:
    """Draw a disc under a robot at a place (3,), m."""
    disc = Cylinder(0.3 * extent.size, _FLOOR_THICKNESS)
    meshcat.SetObject(f"{path}/floor", disc, Rgba(0.87, 0.89, 0.92, 1.0))
    below = RigidTransform(place - [0.0, 0.0, _FLOOR_THICKNESS])
    meshcat.SetTransform(f"{path}/floor", below)


def draw_efforts(meshcat: Meshcat, path: str, played: PlayedModel, size: float) -> None:
    """Record measured and predicted effort at every joint, as arrows along its axis.

    Arrows follow the right-hand rule. Their length is relative to the largest measured effort of
    the joint, and proportional to the robot's size, m.
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
            offset = RigidTransform([0.02 * size * side, 0.0, 0.0])
            meshcat.SetTransform(f"{folder}/{name}", offset)
            _draw_arrow(meshcat, f"{folder}/{name}/arrow", 0.22 * size, color)
            for frame, length in enumerate(scale[:, joint].tolist()):
                arrow = f"{folder}/{name}/arrow"
                meshcat.SetProperty(arrow, "scale", [1.0, 1.0, length], clock(frame))


def draw_ground(meshcat: Meshcat, path: str, found: Playback, robot: PlayedRobot) -> None:
    """Record measured forces of the ground as arrows, and other contacts as balls.

    The length of an arrow is relative to the robot's weight.
    """
    model, size = robot.played.model, found.extent.size
    weight = float(model.total_phi[:, 0].sum() * np.linalg.norm(model.tree.gravity))
    for foot in found.feet:
        frame = foot.frame
        folder = f"{link_path(path, body_links(model)[frame.body])}/ground {path_part(frame.name)}"
        _draw_arrow(meshcat, f"{folder}/arrow", 0.25 * size, CONTACT)
        meshcat.SetObject(f"{folder}/ball", Sphere(0.02 * size), _rgba(CONTACT))
        meshcat.SetTransform(f"{folder}/ball", RigidTransform(frame.center))
        forces = np.nan_to_num(foot.force) @ frame.rotation.T
        norms = np.linalg.norm(forces, axis=1)
        for k, (force, norm) in enumerate(zip(forces, norms.tolist(), strict=True)):
            axis = force / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
            X = RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2), frame.origin)
            arrow, length = f"{folder}/arrow", max(_SMALLEST, _OF_WEIGHT * norm / weight)
            meshcat.SetTransform(arrow, X, clock(k))
            meshcat.SetProperty(arrow, "scale", [1.0, 1.0, length], clock(k))
            meshcat.SetProperty(arrow, "visible", norm > _SMALLEST * weight, clock(k))
            meshcat.SetProperty(f"{folder}/ball", "visible", bool(foot.touches[k]), clock(k))


def draw_effects(
    meshcat: Meshcat, path: str, found: Playback, robot: PlayedRobot
) -> list[tuple[str, str, str]]:
    """Draw the effects of a model: bodies, contacts, and discs at joints.

    Returns:
        The folder in the scene, description and place of each effect. Effects of the whole robot
        are shown at its floor.
    """
    model, size = robot.played.model, found.extent.size
    places, bodies, marks = joint_places(model), body_links(model), list[tuple[str, str, str]]()
    by_name = {link.name: link for link in robot.links}
    for k, fitted in enumerate(model.effects):
        effect, words = fitted.effect, effect_words(fitted, found.units)
        if effect.at_motor:
            for joint in effect.where:
                folder = f"{link_path(path, places[joint].link)}/disc {path_part(joint)}"
                disc = Cylinder(0.06 * size, 0.01 * size)
                meshcat.SetObject(folder, disc, _rgba(style.AFTER, 0.9))
                meshcat.SetTransform(folder, places[joint].X_BJ)
                marks.append((folder, words, joint))
            continue
        if not bodies.keys() & set(effect.where):
            marks.append((f"{path}/floor", words, effect.place))
            continue
        link = by_name[bodies[effect.where[0]]]
        is_turning = not isinstance(effect, PointEpisode) or effect.turning
        folder = f"effects/{k} {path_part(effect.name)}"
        folder = f"{link_path(path, link.name) if is_turning else path}/{folder}"
        if isinstance(effect, PointEpisode):
            force = fitted.parameters[:3]
            norm = float(np.linalg.norm(force))
            axis = force / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
            _draw_arrow(meshcat, f"{folder}/arrow", 0.35 * size, CONTACT)
            X = RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2))
            meshcat.SetTransform(f"{folder}/arrow", X)
            if is_turning:
                meshcat.SetTransform(folder, RigidTransform(effect.point))
            else:
                for frame, X_WB in enumerate(link.X_WB):
                    place = RigidTransform(X_WB.multiply(effect.point))
                    meshcat.SetTransform(folder, place, clock(frame))
        elif is_body(effect) and is_physical(fitted.parameters):
            solid = equivalent_ellipsoid(fitted.parameters, least_semi_axis=LEAST_THICKNESS)
            meshcat.SetObject(folder, Ellipsoid(*solid.semi_axes), _rgba(style.AFTER, 0.6))
            meshcat.SetTransform(
                folder, RigidTransform(RotationMatrix(solid.rotation), solid.center)
            )
        else:
            meshcat.SetObject(folder, Sphere(0.02 * size), _rgba(style.AFTER, 0.8))
        if isinstance(effect, Episode):
            shown = np.concatenate(
                [
                    (effect.weight(e.time - e.began) >= 0.5) & effect.is_of(log_number(e.log))
                    for e in found.excerpts
                ]
            )
            last, changes = len(shown) - 1, 1 + np.flatnonzero(np.diff(shown))
            for frame in sorted({0, *changes.tolist(), last}):
                meshcat.SetProperty(folder, "visible", bool(shown[frame]), clock(frame))
        marks.append((folder, words, effect.place))
    return marks


def _draw_arrow(meshcat: Meshcat, path: str, length: float, color: str) -> None:
    """Draw an arrow from the origin of a folder along its z axis."""
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
    """Return a self-contained HTML page that replays positions (N, nq) at times (N,), s.

    The robot has the shapes of its file; links whose shapes cannot be read are sticks.
    """
    return _replay(model, times, {"robot": q}, {})


@typed
def rollout_replay_page(model: RobotModel, after: Rollout, before: Rollout | None = None) -> str:
    """Return an HTML page of a rollout's windows: the measured and the simulated robot.

    A simulated robot stays where its simulation fails.
    """
    looks, motions = [_REPLAYED, _AFTER], [_frames(after, "measured"), _frames(after, "simulated")]
    if before is not None:
        looks.insert(1, _BEFORE)
        motions.insert(1, _frames(before, "simulated"))
    positions = {look[0]: model.positions(q) for look, q in zip(looks, motions, strict=True)}
    times = np.array([clock(frame) for frame in range(len(motions[0]))])
    colors = {name: _rgba(color, opacity) for name, color, opacity in looks}
    page = _replay(model, times, positions, colors)
    return legend(page, [(color, name) for name, color, _ in looks])


def _replay(
    model: RobotModel, times: Array, motions: Mapping[str, Array], colors: Mapping[str, Rgba]
) -> str:
    """Return a page with a robot for each motion, all at the same place."""
    meshcat, shapes = calm_meshcat(), drawn_shapes(model)
    extent = Extent.of(model, np.concatenate(list(motions.values())))
    with recording(meshcat):
        for k, (name, q) in enumerate(motions.items()):
            path, links = path_part(name), posed_links(model, q, shapes)
            draw_robot(
                meshcat, path, links, dict(enumerate(times.tolist())), color=colors.get(name)
            )
            meshcat.SetProperty(path, "scale", [1.0 - _SIZE_STEP * k] * 3)
    draw_floor(meshcat, "ground", extent, extent.floor)
    meshcat.SetCameraPose(*camera_place(extent))
    page = str(meshcat.StaticHtml())
    return legend(page, [("#c78a1e", note) for note in shapes.notes]) if shapes.notes else page


def _frames(found: Rollout, name: str) -> Array:
    """Return the positions (F, nv) of successive windows at the frame rate of recordings."""
    parts = []
    for window in found.windows:
        values = getattr(window, name)
        known = np.isfinite(values).all(1)
        frames = np.arange(window.time[0], window.time[-1] + 1e-9, 1.0 / FRAMES)
        q = values[known] if known.any() else window.measured[:1]
        time = window.time[known] if known.any() else window.time[:1]
        parts.append(np.stack([np.interp(frames, time, x) for x in q.T], -1))
    return np.concatenate(parts)


def play_page(found: Playback, *, title: str, log_names: Sequence[str], speed: float = 1.0) -> str:
    """Return a self-contained HTML page that plays logs on the robot.

    Links have the colour of their joint's error. A panel lists the worst moments and jumps to them;
    strips show the errors of all joints over time.
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
            ground=CONTACT if found.feet else "",
            # Escaped for a script element.
            data=json.dumps(_data(found, marks, speed)).replace("<", "\\u003c"),
        )
    )
    view = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    icon = '<link rel="icon" href="data:,">'  # or browsers request one
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
    """Record a robot and its ghost, and return its effects as from `draw_effects`."""
    played, path = robot.played, _path(robot.played, k)
    times = {frame: clock(frame) for frame in range(len(found.q))}
    draw_robot(meshcat, path, robot.links, times)
    draw_floor(meshcat, path, found.extent, found.extent.floor + robot.place)
    draw_efforts(meshcat, path, played, found.extent.size)
    draw_ground(meshcat, path, found, robot)
    if _has_ghost(played):
        ghost, visible = f"ghost/{k}", np.asarray(np.isfinite(played.simulated).all(1))
        q = played.model.positions(np.where(visible[:, None], played.simulated, found.q))
        links = posed_links(played.model, q, found.shapes, robot.place)
        shown = {frame: time for frame, time in times.items() if visible[frame]}
        draw_robot(meshcat, ghost, links, shown, color=_rgba(style.AFTER, _GHOST_OPACITY))
        meshcat.SetProperty(ghost, "scale", [_GHOST_SIZE] * 3)
        meshcat.SetTransform(ghost, RigidTransform((1.0 - _GHOST_SIZE) * robot.place))
        for frame, time in times.items():
            meshcat.SetProperty(ghost, "visible", bool(visible[frame]), time)
    return draw_effects(meshcat, path, found, robot)


def _grouped(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Return the words for each place."""
    groups: dict[str, list[str]] = {}
    for place, words in pairs:
        groups.setdefault(place, []).append(words)
    return groups


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
    """Return the data for the script of the page."""
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
                # One label for each place: the first effect, and the number of others.
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
