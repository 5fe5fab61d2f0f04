"""Where models fail, on the robot: one HTML page with MeshCat's recording and a panel beside it."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, MeshcatAnimation, Rgba

from geodrake.boundary.escaping import html_text, path_part, printable
from geodrake.inertia import Array
from geodrake.report import style
from geodrake.report.html import templates
from geodrake.report.numbers import Units, number, percent
from geodrake.report.playback import Moment, Playback, PlayedModel
from geodrake.report.posed_links import drawn_shapes
from geodrake.report.robot_scene import (
    FRAMES,
    RIGHT,
    Extent,
    JointPlace,
    RobotScene,
    calm_meshcat,
    clock,
    draw_floor,
    place_camera,
)
from geodrake.report.scene_marks import MEASURED, EffectMarks, EffortArrows, Mark
from geodrake.robot.files.description import drake_messages
from geodrake.robot.shapes import RobotShapes

COLORS = ("#d3d9e0", "#f2d27a", "#ee9d3d", "#d8492f", "#8f1239")
"""Colours of errors from none to the largest."""

UNKNOWN = 255
"""Level of a joint in a frame where nothing is compared."""

_LEVELS = 254
_GHOSTLY, _INNER = 0.35, 0.99  # opacity and size of ghosts, which are seen where they depart
_TEMPLATE = "play.html.jinja"


@dataclass(frozen=True, eq=False)
class _RobotCopy:
    """One copy of the robot in the scene, and what the page needs to know of it."""

    played: PlayedModel
    scene: RobotScene
    places: tuple[JointPlace, ...]
    arrows: EffortArrows
    effects: EffectMarks
    ghost: RobotScene | None


def play_page(
    playback: Playback,
    *,
    title: str,
    log_names: Sequence[str],
    units: Units,
    speed: float = 1.0,
    shapes: RobotShapes | None = None,
) -> str:
    """Return one HTML page that loads nothing from elsewhere and plays logs over the robot.

    Links have the colour of the error of their joint. A panel names the worst moments, and jumps to
    them; strips show the errors of all joints over time.
    """
    with drake_messages():
        meshcat = calm_meshcat()
        shapes = drawn_shapes(playback.models[-1].model) if shapes is None else shapes
        copies = _draw(meshcat, playback, shapes, units)
        _record(meshcat, playback, copies)
        page = str(meshcat.StaticHtml())
    head, _, foot = page.rpartition("</body>")
    panel = _panel(playback, copies, title=title, log_names=log_names, units=units, speed=speed)
    named = head.replace("<title>Drake MeshCat</title>", _head(title), 1)
    return f"{named}{panel}</body>{foot}"


def _draw(
    meshcat: Meshcat, playback: Playback, shapes: RobotShapes, units: Units
) -> list[_RobotCopy]:
    model = playback.models[-1].model
    extent = Extent.of(model, model.positions(playback.q))
    copies = []
    for k, played in enumerate(playback.models):
        path = f"robot/{k} {path_part(played.title)}"
        scene = RobotScene(
            meshcat, played.model, shapes=shapes, path=path, p_WR=k * extent.gap * RIGHT
        )
        draw_floor(meshcat, path, extent)
        places = scene.joint_places()
        arrows = EffortArrows(meshcat, places, played.measured, played.predicted, extent.size)
        effects = EffectMarks(meshcat, scene, played.model, units, extent.size)
        ghost = _ghost(meshcat, played, shapes, k, extent)
        copies.append(_RobotCopy(played, scene, places, arrows, effects, ghost))
    place_camera(meshcat, extent, copies=len(copies))
    return copies


def _ghost(
    meshcat: Meshcat, played: PlayedModel, shapes: RobotShapes, number_: int, extent: Extent
) -> RobotScene | None:
    """Return the robot that the model alone moves; None if none is played."""
    if np.isnan(played.simulated).all():
        return None
    path, color = f"ghost/{number_}", Rgba(*to_rgb(style.AFTER), _GHOSTLY)
    place = number_ * extent.gap * RIGHT
    scene = RobotScene(meshcat, played.model, shapes=shapes, path=path, p_WR=place, color=color)
    meshcat.SetProperty(path, "scale", [_INNER] * 3)
    return scene


def _record(meshcat: Meshcat, playback: Playback, copies: Sequence[_RobotCopy]) -> None:
    q = playback.models[-1].model.positions(playback.q)
    meshcat.StartRecording(frames_per_second=FRAMES, set_visualizations_while_recording=False)
    for copy in copies:
        copy.effects.start(playback.excerpts)
    for frame, posture in enumerate(q):
        for copy in copies:
            copy.scene.move(posture, clock(frame))
            copy.arrows.show(frame)
            copy.effects.show(frame, posture)
            if copy.ghost is not None:
                there = np.isfinite(copy.played.simulated[frame]).all()
                meshcat.SetProperty(copy.ghost.path, "visible", bool(there), clock(frame))
                if there:
                    (own,) = copy.played.model.positions(copy.played.simulated[frame : frame + 1])
                    copy.ghost.move(own, clock(frame))
    meshcat.StopRecording()
    recording = meshcat.get_mutable_recording()
    recording.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    recording.set_repetitions(1_000_000)
    meshcat.PublishRecording()


def _panel(
    playback: Playback,
    copies: Sequence[_RobotCopy],
    *,
    title: str,
    log_names: Sequence[str],
    units: Units,
    speed: float,
) -> str:
    environment = templates()
    said = ((*copy.played.model.repairs, *copy.scene.notes) for copy in copies)
    notes = dict.fromkeys(note for own in said for note in own)
    if playback.seconds_left_out > 0.5:
        left_out = f"{playback.seconds_left_out:.0f} s of the logs"
        notes[f"the worst passages are played; {left_out} are not (--seconds)"] = None
    return environment.get_template(_TEMPLATE).render(
        title=title,
        logs=", ".join(log_names),
        models=[_model_words(copy, k) for k, copy in enumerate(copies)],
        groups=[
            (
                copy.played.title,
                [_moment(m, playback, units) for m in playback.moments if m.played == k],
            )
            for k, copy in enumerate(copies)
        ],
        notes=list(notes),
        gradient=", ".join(COLORS),
        top=percent(playback.top),
        measured=MEASURED,
        predicted=style.AFTER,
        ghosts=any(copy.ghost is not None for copy in copies),
        data=_script(_data(playback, copies, units, speed)),
    )


def _model_words(copy: _RobotCopy, number_: int) -> dict[str, Any]:
    played = copy.played
    return {
        "title": played.title,
        "file": played.model.path.name,
        "nrms": number(played.comparison.errors.nrms),
        "data": "training data" if played.trained else "held-out data",
        "effects": _by_place(copy.effects.marks),
        "number": number_,
    }


def _by_place(marks: Sequence[Mark]) -> list[tuple[str, str]]:
    """Return places, and the effects that are there."""
    found: dict[str, list[str]] = {}
    for mark in marks:
        found.setdefault(mark.place, []).append(mark.words)
    return [(place, ", ".join(words)) for place, words in found.items()]


def _moment(moment: Moment, playback: Playback, units: Units) -> dict[str, Any]:
    joint = playback.joints[moment.joint]
    log, time = playback.own_time(moment.frame)
    return {
        "frame": moment.frame,
        "joint": joint,
        "place": moment.joint,
        "played": moment.played,
        "error": f"{number(moment.error)} {units.effort([joint])}",
        "relative": percent(moment.relative),
        "time": f"{time:.2f} s" + (f" of {log}" if _several(playback) else ""),
    }


def _several(playback: Playback) -> bool:
    return len({excerpt.log for excerpt in playback.excerpts}) > 1


def levels(playback: Playback, played: PlayedModel) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return (F, nv) colours of a model's joints in all frames, from 0 for no error to 254."""
    scaled = np.clip(played.relative / playback.top, 0.0, 1.0) * _LEVELS
    return np.where(np.isfinite(scaled), np.rint(scaled), UNKNOWN).astype(np.uint8)


def _data(
    playback: Playback, copies: Sequence[_RobotCopy], units: Units, speed: float
) -> dict[str, Any]:
    """Return what the page's script reads."""
    return {
        "rate": FRAMES,
        "frames": len(playback.q),
        "speed": speed,
        "several": _several(playback),
        "joints": [printable(joint) for joint in playback.joints],
        "first": playback.moments[0].joint if playback.moments else 0,
        "positions": _packed(playback.q.astype("<f4")),
        "angles": [units.at(joint, "rad") for joint in playback.joints],
        "inks": {"measured": MEASURED, "predicted": style.AFTER, "before": style.BEFORE},
        "units": [units.effort([joint]) for joint in playback.joints],
        "colors": COLORS,
        "excerpts": [
            {"log": printable(e.log), "start": float(e.time[0]), "frames": len(e.time)}
            for e in playback.excerpts
        ],
        "robots": [
            {
                "title": printable(copy.played.title),
                "path": f"{copy.scene.path}/floor",
                "levels": _packed(levels(playback, copy.played)),
                "errors": _packed(copy.played.relative.astype("<f4")),
                "measured": _packed(copy.played.measured.astype("<f4")),
                "predicted": _packed(copy.played.predicted.astype("<f4")),
                "simulated": _packed(copy.played.simulated.astype("<f4")),
                "moved": [list(place.moved) for place in copy.places],
                "marks": _labels(copy.effects.marks),
            }
            for copy in copies
        ],
    }


def _labels(marks: Sequence[Mark]) -> list[dict[str, str]]:
    """Return one label a place: where several effects are, the first and how many more."""
    found: dict[str, list[str]] = {}
    for mark in marks:
        found.setdefault(mark.path, []).append(printable(mark.words))
    return [
        {"path": path, "words": f"{first} + {len(more)} more" if more else first}
        for path, (first, *more) in found.items()
    ]


def _packed(values: Array | np.ndarray[Any, np.dtype[np.uint8]]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _script(data: dict[str, Any]) -> str:
    """Return JSON that may stand in a script of a page."""
    return json.dumps(data).replace("<", "\\u003c")


def _head(title: str) -> str:
    view = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    icon = '<link rel="icon" href="data:,">'  # which browsers would ask a server for
    return f"<title>{html_text(title)}</title>{view}{icon}"
