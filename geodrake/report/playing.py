"""The page of `play`: the moments at which models err most."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from geodrake.report.explaining import comparison_page
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import About, ColoredList, Page, Section
from geodrake.report.playback import Moment, Playback
from geodrake.robot.shapes import RobotShapes


@dataclass(frozen=True, eq=False)
class Played:
    """A playback, and how the robot looks in it."""

    playback: Playback
    shapes: RobotShapes

    @property
    def units(self) -> Units:
        """Return the units of the last model."""
        return Units.of(self.playback.models[-1].model)


def playback_page(found: Played, about: About) -> Page:
    """Say when models err most, and beside it how the last one does."""
    playback = found.playback
    lists = []
    for k, played in enumerate(playback.models):
        data = "training data" if played.trained else "held-out data"
        nrms = number(played.comparison.errors.nrms)
        own = (m for m in playback.moments if m.played == k)
        told = tuple(_moment_words(m, playback, about.units) for m in own)
        color = "after" if k == len(playback.models) - 1 else "before"
        lists.append(ColoredList(f"{played.title}, nrms {nrms} on {data}", color, told))
    left = playback.seconds_left_out
    left_out = (f"{left:.0f} s of the logs are not played; see --seconds",) if left > 0.5 else ()
    page = comparison_page(playback.models[-1].comparison, about)
    *others, notes = page.sections
    notes = replace(notes, items=(*left_out, *found.shapes.notes, *notes.items))
    detailed = (replace(each, detailed=True) for each in others)
    return replace(page, sections=(Section("Worst moments", lists=tuple(lists)), *detailed, notes))


def _moment_words(moment: Moment, playback: Playback, units: Units) -> str:
    joint = playback.joints[moment.joint]
    log, time = playback.own_time(moment.frame)
    error = f"{number(moment.error)} {units.effort([joint])}"
    return (
        f"{joint} at {time:.2f} s of {log}: {error} off, {percent(moment.relative)} of the "
        "deviation of its effort"
    )


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
                    _moment_dict(m, playback) for m in playback.moments if m.played == k
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


def _moment_dict(moment: Moment, playback: Playback) -> dict[str, Any]:
    log, time = playback.own_time(moment.frame)
    return {
        "joint": playback.joints[moment.joint],
        "log": log,
        "time": time,
        "error": moment.error,
        "relative": moment.relative,
    }
