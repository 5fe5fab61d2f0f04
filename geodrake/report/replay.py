"""Motions replayed over the robot: HTML pages with MeshCat's recording in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Rgba

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import path_part
from geodrake.control.rollout import Rollout
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.report import style
from geodrake.report.meshcat_ellipsoids import legend
from geodrake.report.posed_links import drawn_shapes
from geodrake.report.robot_scene import (
    FRAMES,
    Extent,
    RobotScene,
    calm_meshcat,
    clock,
    draw_floor,
    place_camera,
)
from geodrake.robot.files.description import drake_messages

__all__ = ["FRAMES", "replay_page", "rollout_replay_page"]

_APART = 0.002  # of their size, by which robots at one place differ
_MEASURED = ("measured", "#8a94a0", 0.35)
_BEFORE, _AFTER = ("simulated before", style.BEFORE, 0.6), ("simulated", style.AFTER, 0.85)


@typed
def replay_page(model: RobotModel, times: Array, q: Array) -> str:
    """Return one HTML page that loads nothing from elsewhere and replays a motion.

    The robot looks as its file says, meshes included; links that cannot be shown are sticks.

    Args:
        times: (N,) instants, s.
        q: (N, nq) positions of the model.
    """
    return _replayed(model, times, {"robot": q}, {})


@typed
def rollout_replay_page(model: RobotModel, after: Rollout, before: Rollout | None = None) -> str:
    """Return an HTML page of a rollout's windows: the measured and the simulated robot.

    A simulated robot that breaks off stays where it was.
    """
    looks, motions = [_MEASURED, _AFTER], [_frames(after, "measured"), _frames(after, "simulated")]
    if before is not None:
        looks.insert(1, _BEFORE)
        motions.insert(1, _frames(before, "simulated"))
    named = {look[0]: model.positions(q) for look, q in zip(looks, motions, strict=True)}
    times = np.array([clock(frame) for frame in range(len(motions[0]))])
    colors = {name: Rgba(*to_rgb(color), opaque) for name, color, opaque in looks}
    page = _replayed(model, times, named, colors)
    return legend(page, [(color, name) for name, color, _ in looks])


def _replayed(
    model: RobotModel, times: Array, motions: Mapping[str, Array], colors: Mapping[str, Rgba]
) -> str:
    """Return a page with one robot for each motion, all at one place."""
    with drake_messages():
        meshcat, shapes = calm_meshcat(), drawn_shapes(model)
        scenes = [
            RobotScene(meshcat, model, shapes=shapes, path=path_part(name), color=colors.get(name))
            for name in motions
        ]
        for k, scene in enumerate(scenes):  # so that surfaces at one place do not flicker
            meshcat.SetProperty(scene.path, "scale", [1.0 - _APART * k] * 3)
        extent = Extent.of(model, np.concatenate(list(motions.values())))
        draw_floor(meshcat, "ground", extent)
        place_camera(meshcat, extent)
        meshcat.StartRecording(frames_per_second=FRAMES, set_visualizations_while_recording=False)
        for frame, time in enumerate(times.tolist()):
            for scene, q in zip(scenes, motions.values(), strict=True):
                scene.move(q[frame], time)
        meshcat.StopRecording()
        meshcat.PublishRecording()
        page = str(meshcat.StaticHtml())
    notes: Sequence[str] = shapes.notes
    return legend(page, [("#c78a1e", note) for note in notes]) if notes else page


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
