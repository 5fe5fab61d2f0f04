"""A playback as people see it: its robots, its worst moments in words, and the page of `play`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from geodrake.boundary.escaping import path_part, printable
from geodrake.effects import FittedEffect
from geodrake.effects.episode import PointEpisode
from geodrake.report.drawn_robots import ColoredRobot, error_colors
from geodrake.report.explaining import comparison_page
from geodrake.report.json_output import picked
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import About, ColoredList, Page, Section, View
from geodrake.report.playback import Moment, Playback, PlayedModel
from geodrake.report.robot_scene import RIGHT, Extent, body_links, joint_places, posed_links
from geodrake.report.words import effect_label
from geodrake.robot.shapes import RobotShapes


@dataclass(frozen=True, eq=False)
class PlayedRobot(ColoredRobot):
    """One copy of the robot."""

    played: PlayedModel
    name: str  # its title, as part of a path
    # What was found, and the link at which it is said; None for the whole robot.
    findings: list[tuple[str, str | None]]


@dataclass(frozen=True, eq=False)
class Played:
    """A playback, and how the robot looks in it."""

    playback: Playback
    shapes: RobotShapes

    @property
    def units(self) -> Units:
        """Return the units of the last model."""
        return Units.of(self.playback.models[-1].model)

    @cached_property
    def extent(self) -> Extent:
        """Return where the robot goes."""
        model = self.playback.models[-1].model
        return Extent.of(model, model.positions(self.playback.q))

    @cached_property
    def robots(self) -> list[PlayedRobot]:
        """Return a copy of the robot for each model, one beside the other."""
        playback, units = self.playback, self.units
        return [
            PlayedRobot(
                posed_links(played.model, played.model.positions(playback.q), self.shapes),
                k * self.extent.gap * RIGHT,
                error_colors(played.relative, playback.top),
                played,
                path_part(played.title),
                _findings(played, units),
            )
            for k, played in enumerate(playback.models)
        ]

    @property
    def left_out(self) -> list[str]:
        """Return what is not played, in words."""
        left = self.playback.seconds_left_out
        words = f"the worst passages are played; {left:.0f} s of the logs are not (--seconds)"
        return [words] if left > 0.5 else []

    def moment_words(self, moment: Moment) -> str:
        """Return when a joint is how far off."""
        joint = self.playback.joints[moment.joint]
        log, time = self.playback.own_time(moment.frame)
        return (
            f"{joint} at {time:.2f} s of {log}: {number(moment.error)} "
            f"{self.units.effort([joint])} off, {percent(moment.relative)} of the deviation of its "
            "effort"
        )


def _findings(played: PlayedModel, units: Units) -> list[tuple[str, str | None]]:
    places = {name: place.link for name, place in joint_places(played.model).items()}
    places |= body_links(played.model)
    found = []
    for fitted in played.model.effects:
        effect = fitted.effect
        at = next((places[name] for name in effect.where if name in places), None)
        found.append((f"{effect_words(fitted, units)} ({effect.place})", at))
    return found


def playback_page(found: Played, about: About) -> Page:
    """Say when models err most, and beside it how the last one does."""
    playback = found.playback
    lists = []
    for k, played in enumerate(playback.models):
        data = "training data" if played.trained else "held-out data"
        nrms = number(played.comparison.errors.nrms)
        told = tuple(found.moment_words(m) for m in playback.moments if m.played == k)
        color = "after" if k == len(playback.models) - 1 else "before"
        lists.append(ColoredList(f"{played.title}, nrms {nrms} on {data}", color, told))
    page = comparison_page(playback.models[-1].comparison, about)
    *others, notes = page.sections
    notes = replace(notes, items=(*found.left_out, *found.shapes.notes, *notes.items))
    detailed = (replace(each, detailed=True) for each in others)
    return replace(page, sections=(Section("Worst moments", lists=tuple(lists)), *detailed, notes))


def playback_dict(found: Played) -> dict[str, Any]:
    """Return what is played, and where the models err most, as JSON has it."""
    playback = found.playback
    return {
        "models": [
            {
                "title": played.title,
                "file": str(played.model.path),
                "nrms": played.comparison.errors.nrms,
                "trained": played.trained,
                "worst_moments": [
                    {
                        "joint": playback.joints[moment.joint],
                        **dict(zip(("log", "time"), playback.own_time(moment.frame), strict=True)),
                        **picked(moment, "error", "relative"),
                    }
                    for moment in playback.moments
                    if moment.played == k
                ],
            }
            for k, played in enumerate(playback.models)
        ],
        "excerpts": [
            {"log": e.log, "start": float(e.time[0]), "end": float(e.time[-1])}
            for e in playback.excerpts
        ],
        "seconds_left_out": playback.seconds_left_out,
        "notes": list(playback.models[-1].comparison.notes),
    }


def effect_words(fitted: FittedEffect, units: Units) -> str:
    """Return an effect and its most telling value, such as `payload 2.49 kg`."""
    effect = fitted.effect
    label = printable(effect.label or effect_label(effect.name))
    values, _ = effect.reported(fitted.parameters, np.full(len(fitted.parameters), np.nan))
    names = [effect.summary] if effect.summary in values else list(values)
    if isinstance(effect, PointEpisode):
        return f"{label} {number(float(np.linalg.norm(fitted.parameters[:3])))} N"
    if not names:
        return label
    place = " & ".join(effect.where)
    shown = number(units.shown(effect.name, names[0], values[names[0]]))
    return f"{label} {shown} {units.parameter(effect.name, names[0], place)}".strip()


VIEWS = {Played: View(playback_page, playback_dict)}
"""How to see this result."""
