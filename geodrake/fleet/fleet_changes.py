"""All robots of a type: what they share, and which of them changed, at which joint, since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.boundary.arguments import instances, integer, number
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.change_evidence import ChangePlace
from geodrake.fleet.changes import RobotChange, RobotSearch, logs_at, months
from geodrake.fleet.columns import TypeColumns
from geodrake.fleet.history import LogEquations, RobotHistory
from geodrake.fleet.hypotheses import ChangeHypothesis
from geodrake.fleet.type_model import Array, TypeModel, learn_type, least_squares


_FIRST, _LATER = 12, 4  # rounds of learning what robots share


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
    references: list[Array] = [_pooled(histories)] * len(histories)
    logs, designs, model = _at(histories, columns, references), None, None
    for step in range(passes):
        model = learn_type(
            logs, columns, changes=designs, start=model, rounds=_LATER if step else _FIRST
        )
        searches = [
            RobotSearch(model, r, each, reference, hypotheses)
            for r, (each, reference) in enumerate(zip(histories, references, strict=True))
        ]
        places = [
            search.find(min(1.0, false_alarms * months(search.history))) for search in searches
        ]
        if step < passes - 1:
            states = [search.state(own) for search, own in zip(searches, places, strict=True)]
            references = [
                model.parameters(r, state.logs, state.fit) for r, state in enumerate(states)
            ]
            logs = _at(histories, columns, references)
            designs = [_design(search, own) for search, own in zip(searches, places, strict=True)]
            model = replace(model, odd=tuple(state.odd for state in states))
    told = tuple(search.told(own) for search, own in zip(searches, places, strict=True))
    return FleetChanges(model, told, tuple(tuple(own) for own in places))


def _pooled(histories: Sequence[RobotHistory]) -> Array:
    """(p,) least squares of all robots, to which gains refer at first."""
    total = np.sum([history.grams.sum(axis=(0, 1)) for history in histories], axis=0)
    return least_squares(total[:-1, :-1], total[:-1, -1])


def _at(
    histories: Sequence[RobotHistory], columns: TypeColumns, references: Sequence[Array]
) -> list[LogEquations]:
    pairs = zip(histories, references, strict=True)
    return [logs_at(history, columns.gains, reference) for history, reference in pairs]


def _design(search: RobotSearch, places: Sequence[ChangePlace]) -> Array:
    """(T, p, m) parameters of the changes of a robot, of which there may be none."""
    found = search.design(places)
    shape = (len(search.history.days), len(search.model.mean), 0)
    return np.zeros(shape) if found is None else found
