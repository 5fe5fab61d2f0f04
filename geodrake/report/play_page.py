"""Where models fail, on the robot: one HTML page with MeshCat's recording and a panel beside it."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba

from geodrake.boundary.escaping import html_text, path_part, printable
from geodrake.report import style
from geodrake.report.drawn_robots import COLORS, levels
from geodrake.report.html import templates
from geodrake.report.meshcat_scene import (
    MEASURED,
    Mark,
    calm_meshcat,
    clock,
    draw_effects,
    draw_efforts,
    draw_floor,
    draw_robot,
    link_path,
    recording,
)
from geodrake.report.numbers import number, percent
from geodrake.report.playback import Moment, Playback, PlayedModel, PlayedRobot
from geodrake.report.robot_scene import FRAMES, camera_place, own_joints, posed_links

_GHOSTLY, _INNER = 0.35, 0.99  # opacity and size of ghosts, which are seen where they depart
_TEMPLATE = "play.html.jinja"


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
    models = list(enumerate(zip(found.models, marks, strict=True)))
    panel = (
        templates()
        .get_template(_TEMPLATE)
        .render(
            title=title,
            logs=", ".join(log_names),
            models=[_model_words(played, own, k) for k, (played, own) in models],
            groups=[
                (
                    played.title,
                    [_moment(moment, found) for moment in found.moments if moment.played == k],
                )
                for k, (played, _) in models
            ],
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


def _draw(meshcat: Meshcat, found: Playback, robot: PlayedRobot, k: int) -> list[Mark]:
    """Record a robot and its ghost, and return what to say of its effects."""
    played, size = robot.played, found.extent.size
    path, model = _path(played, k), played.model
    times = {frame: clock(frame) for frame in range(len(found.q))}
    draw_robot(meshcat, path, robot.links, times, p_WR=robot.place)
    draw_floor(meshcat, path, found.extent)
    draw_efforts(meshcat, path, played, size)
    if _has_ghost(played):
        ghost, there = f"ghost/{k}", np.asarray(np.isfinite(played.simulated).all(1))
        q = np.where(there[:, None], played.simulated, found.q)
        links = posed_links(model, model.positions(q), found.shapes)
        shown = {frame: time for frame, time in times.items() if there[frame]}
        color = Rgba(*to_rgb(style.AFTER), _GHOSTLY)
        draw_robot(meshcat, ghost, links, shown, p_WR=robot.place, color=color)
        meshcat.SetProperty(ghost, "scale", [_INNER] * 3)
        for frame, time in times.items():
            meshcat.SetProperty(ghost, "visible", bool(there[frame]), time)
    return draw_effects(
        meshcat, path, model, robot.links, found.excerpts, units=found.units, size=size
    )


def _model_words(played: PlayedModel, marks: Iterable[Mark], k: int) -> dict[str, Any]:
    effects: dict[str, list[str]] = {}
    for mark in marks:
        effects.setdefault(mark.place, []).append(mark.words)
    return {
        "title": played.title,
        "file": played.model.path.name,
        "nrms": number(played.comparison.errors.nrms),
        "data": "training data" if played.trained else "held-out data",
        "effects": [(place, ", ".join(words)) for place, words in effects.items()],
        "number": k,
    }


def _moment(moment: Moment, found: Playback) -> dict[str, Any]:
    joint = found.joints[moment.joint]
    log, time = found.own_time(moment.frame)
    return {
        "frame": moment.frame,
        "joint": joint,
        "place": moment.joint,
        "played": moment.played,
        "error": f"{number(moment.error)} {found.units.effort([joint])}",
        "relative": percent(moment.relative),
        "time": f"{time:.2f} s" + (f" of {log}" if _several(found) else ""),
    }


def _several(found: Playback) -> bool:
    return len({excerpt.log for excerpt in found.excerpts}) > 1


def _data(found: Playback, marks: Sequence[Sequence[Mark]], speed: float) -> dict[str, Any]:
    """Return what the page's script reads."""
    units = found.units
    curves = ("measured", "predicted", "simulated")
    return {
        "rate": FRAMES,
        "frames": len(found.q),
        "speed": speed,
        "several": _several(found),
        "joints": [printable(joint) for joint in found.joints],
        "first": found.moments[0].joint if found.moments else 0,
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
                "marks": _labels(own),
            }
            for k, (played, own) in enumerate(zip(found.models, marks, strict=True))
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


def _packed(values: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
