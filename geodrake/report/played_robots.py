"""The robots of a playback, apart from what shows them: links, poses, colours, words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from geodrake.boundary.escaping import path_part
from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.report.numbers import Units, number
from geodrake.report.play_page import COLORS, UNKNOWN, levels
from geodrake.report.playback import Moment, Playback, PlayedModel
from geodrake.report.posed_links import PosedLink, link_joints, posed_links
from geodrake.report.robot_scene import FRAMES, RIGHT, Extent
from geodrake.report.scene_marks import effect_words
from geodrake.robot.shapes import RobotShapes

GRAYS = np.array([[209, 214, 220, 255], [225, 228, 233, 255]], np.uint8)
"""Colours (RGBA) of links without a joint, and of joints where nothing is compared."""


@dataclass(frozen=True, eq=False)
class PlayedRobot:
    """One copy of the robot.

    Attributes:
        place: (3,) where it stands, m.
        colors: (F, nv, 4) of the joints by their errors, RGBA.
        findings: What was found, and the link at which it is said; None for the whole robot.
    """

    played: PlayedModel
    name: str
    place: Array
    links: list[PosedLink]
    colors: NDArray[np.uint8]
    findings: list[tuple[str, str | None]]

    def color(self, link: PosedLink, frame: int) -> NDArray[np.uint8]:
        """Return the colour (4,) of a link in a frame."""
        return GRAYS[0] if link.joint is None else self.colors[frame, link.joint]


def played_robots(playback: Playback, shapes: RobotShapes, units: Units) -> list[PlayedRobot]:
    """Return the robots of a playback, one beside the other."""
    model = playback.models[-1].model
    extent = Extent.of(model, model.positions(playback.q))
    return [
        PlayedRobot(
            played,
            path_part(played.title),
            k * extent.gap * RIGHT,
            posed_links(played.model, played.model.positions(playback.q), shapes),
            error_colors(playback, played),
            _findings(played, units),
        )
        for k, played in enumerate(playback.models)
    ]


def error_colors(playback: Playback, played: PlayedModel) -> NDArray[np.uint8]:
    """Return colours (F, nv, 4) of a model's errors, RGBA."""
    shades = LinearSegmentedColormap.from_list("error", COLORS, N=UNKNOWN)
    found = levels(playback, played)
    colors = np.asarray(shades(np.minimum(found, UNKNOWN - 1).astype(int), bytes=True))
    return np.where((found == UNKNOWN)[..., None], GRAYS[1], colors).astype(np.uint8)


def frame_times(playback: Playback) -> Array:
    """Return the instants (F,) of the frames as they are played, s.

    Those of one passage of one log are the log's own; several passages follow one another from 0.
    """
    if len(playback.excerpts) == 1:
        return playback.excerpts[0].time
    return np.arange(len(playback.q)) / FRAMES


def moment_words(moment: Moment, playback: Playback, units: Units) -> str:
    """Return one of the worst moments in words."""
    joint, (log, time) = playback.joints[moment.joint], playback.own_time(moment.frame)
    title = playback.models[moment.played].title
    off = f"{number(moment.error)} {units.effort([joint])}"
    return f"{title}: {joint} is {off} off at {time:.2f} s of {log}"


def joint_values(playback: Playback, played: PlayedModel) -> dict[str, Array]:
    """Return what is plotted of a model, by name: (F, nv) arrays, NaN where nothing is compared."""
    return {
        "measured": played.measured,
        "predicted": played.predicted,
        "residual": played.measured - played.predicted,
    }


def _findings(played: PlayedModel, units: Units) -> list[tuple[str, str | None]]:
    model, places = played.model, dict[str, str]()
    for link, joint in link_joints(model).items():
        places.setdefault(model.joints[joint], link)
    for body, lump in zip(model.bodies, lumped_bodies(model.plant), strict=True):
        places.setdefault(body, model.plant.get_body(lump.body_index).scoped_name().get_full())
    found = []
    for fitted in model.effects:
        effect = fitted.effect
        at = next((places[name] for name in effect.where if name in places), None)
        found.append((f"{effect_words(fitted, units)} ({effect.place})", at))
    return found
