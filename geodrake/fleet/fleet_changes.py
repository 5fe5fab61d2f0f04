"""All robots of a type: what they share, and which of them changed, at which joint, since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.boundary.arguments import instances, integer, number
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.changes import ChangePlace, RobotChange, RobotSearch, months
from geodrake.fleet.columns import TypeColumns
from geodrake.fleet.history import RobotHistory
from geodrake.fleet.hypotheses import ChangeHypothesis
from geodrake.fleet.type_model import Array, TypeModel, learn_type


@dataclass(frozen=True, eq=False)
class FleetChanges(Short):
    """What changed in robots of a type.

    Attributes:
        model: What they share, and how they differ.
        changes: Of every robot, those that were found.
        places: The same by numbers, for further fits.
    """

    model: TypeModel
    changes: tuple[tuple[RobotChange, ...], ...]
    places: tuple[tuple[ChangePlace, ...], ...]


def find_changes(
    histories: Sequence[RobotHistory],
    columns: TypeColumns,
    hypotheses: Sequence[ChangeHypothesis],
    *,
    false_alarms: float = 0.01,
    passes: int = 3,
) -> FleetChanges:
    """Which robots of a type changed, at which joint or body, by which effect, since when.

    What all share, the scatter of logs and the common course are learnt with the changes that were
    found, and changes are sought with these, several times.

    Args:
        histories: Logs of each robot, over the same p columns.
        columns: What the columns are.
        hypotheses: What may change.
        false_alarms: At most how many robots in which nothing changed are named, a robot-month.
        passes: How often all is done.

    Raises:
        ArgumentError: Arrays do not fit, or a value is out of its range.
    """
    histories = instances(histories, "histories", RobotHistory)
    hypotheses = instances(hypotheses, "hypotheses", ChangeHypothesis)
    number(false_alarms, "false_alarms", lower=0.0, upper=1.0, strict=True)
    integer(passes, "passes", lower=1)
    if any(len(h.factor) != len(columns.prior) for h in hypotheses) or not hypotheses:
        raise ArgumentError(f"Each hypothesis needs {len(columns.prior)} columns, and there must be one.")
    model = learn_type(histories, columns)
    places: list[list[ChangePlace]] = []
    for step in range(passes):
        searches = [RobotSearch(model, r, each, hypotheses) for r, each in enumerate(histories)]
        places = [
            search.find(min(1.0, false_alarms * months(search.history))) for search in searches
        ]
        if step < passes - 1:
            designs = [_design(search, own) for search, own in zip(searches, places, strict=True)]
            model = learn_type(histories, columns, changes=designs, start=model, rounds=6)
    told = tuple(search.told(own) for search, own in zip(searches, places, strict=True))
    return FleetChanges(model, told, tuple(tuple(own) for own in places))


def _design(search: RobotSearch, places: Sequence[ChangePlace]) -> Array:
    """(T, p, m) parameters of the changes of a robot, of which there may be none."""
    found = search.design(places)
    shape = (len(search.history.days), len(search.model.mean), 0)
    return np.zeros(shape) if found is None else found
