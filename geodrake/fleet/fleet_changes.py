"""All robots of a type: what they share, and which of them changed, at which joint, since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.boundary.arguments import instance, instances, integer, number
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.change_evidence import ChangePlace
from geodrake.fleet.changes import RobotChange, RobotSearch, logs_at, months
from geodrake.fleet.columns import TypeColumns
from geodrake.fleet.history import LogEquations, RobotHistory
from geodrake.fleet.hypotheses import ChangeHypothesis
from geodrake.fleet.type_learning import learn_type, least_squares
from geodrake.fleet.type_model import Array, TypeModel
from geodrake.fleet.workers import InThisProcess, Workers, in_order

_FIRST, _LATER = 12, 4  # rounds of learning what robots share


@dataclass(frozen=True, eq=False)
class FleetChanges(Short):
    """What changed in robots of a type.

    Attributes:
        model: What they share, and how they differ.
        changes: Of every robot, those that were found.
        places: The same by numbers, for further fits.
        references: (T, p) of every robot, parameters that its gains referred to.
    """

    model: TypeModel
    changes: tuple[tuple[RobotChange, ...], ...]
    places: tuple[tuple[ChangePlace, ...], ...]
    references: tuple[Array, ...]


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
    instance(columns, "columns", TypeColumns)
    number(false_alarms, "false_alarms", lower=0.0, upper=1.0, strict=True)
    integer(passes, "passes", lower=1)
    if any(len(h.factor) != len(columns.prior) for h in hypotheses) or not hypotheses:
        raise ArgumentError(
            f"Each hypothesis needs {len(columns.prior)} columns, and there must be one."
        )
    _check_shapes(histories, columns)
    return changes_by(
        InThisProcess(), histories, columns, hypotheses, false_alarms=false_alarms, passes=passes
    )


def changes_by(
    team: Workers,
    histories: Sequence[RobotHistory],
    columns: TypeColumns,
    hypotheses: Sequence[ChangeHypothesis],
    *,
    false_alarms: float,
    passes: int = 3,
) -> FleetChanges:
    """`find_changes` where others search: what robots share is learnt here.

    Args:
        team: Who searches.
        histories: Logs of each robot, over the same p columns.
        columns: What the columns are.
        hypotheses: What may change.
        false_alarms: At most how many robots in which nothing changed are named, a robot-month.
        passes: How often all is done.
    """
    references: list[Array] = [_pooled(histories)] * len(histories)
    model = learn_type(_at(histories, columns, references), columns, rounds=_FIRST)
    for _ in range(passes - 1):
        found = in_order(
            team, _settled, _searches(model, histories, references, hypotheses, false_alarms)
        )
        references = [each.reference for each in found]
        model = learn_type(
            _at(histories, columns, references),
            columns,
            changes=[each.design for each in found],
            start=replace(model, odd=tuple(each.odd for each in found)),
            rounds=_LATER,
        )
    told = in_order(team, _told, _searches(model, histories, references, hypotheses, false_alarms))
    places, changes = zip(*told, strict=True)
    return FleetChanges(model, changes, places, tuple(references))


@dataclass(frozen=True, eq=False)
class _SettledRobot:
    """What learning needs of a robot: parameters of the day, changes, and how odd logs are."""

    reference: Array
    design: Array
    odd: Array


def _searches(
    model: TypeModel,
    histories: Sequence[RobotHistory],
    references: Sequence[Array],
    hypotheses: Sequence[ChangeHypothesis],
    false_alarms: float,
) -> list[tuple[RobotSearch, float]]:
    """Each robot, and the probability of a false alarm in the time of its logs."""
    return [
        (
            RobotSearch(model.of(r), 0, history, reference, hypotheses),
            min(1.0, false_alarms * months(history)),
        )
        for r, (history, reference) in enumerate(zip(histories, references, strict=True))
    ]


def _settled(piece: tuple[RobotSearch, float]) -> _SettledRobot:
    search, level = piece
    places = search.find(level)
    reference, odd = search.settled(places)
    return _SettledRobot(reference, search.design(places), odd)


def _told(
    piece: tuple[RobotSearch, float],
) -> tuple[tuple[ChangePlace, ...], tuple[RobotChange, ...]]:
    search, level = piece
    places = search.find(level)
    return tuple(places), search.told(places)


def _check_shapes(histories: Sequence[RobotHistory], columns: TypeColumns) -> None:
    joints = {(len(history.joints), history.columns) for history in histories}
    wanted = len(columns.prior) - columns.gains
    if len(joints) != 1 or any(p != wanted or columns.gains not in (0, n) for n, p in joints):
        raise ArgumentError(
            f"Robots of a type must have the same joints and {wanted} columns, and there must be a "
            f"robot; they have (joints, columns) {sorted(joints)}.",
            advice="Gains are columns of the type, one a joint, and not of the logs.",
        )


def _pooled(histories: Sequence[RobotHistory]) -> Array:
    """(p,) least squares of all robots, to which gains refer at first."""
    logs = [history.equations() for history in histories]
    information = np.sum([each.information.sum(axis=0) for each in logs], axis=0)
    return least_squares(information, np.sum([each.right.sum(axis=0) for each in logs], axis=0))


def _at(
    histories: Sequence[RobotHistory], columns: TypeColumns, references: Sequence[Array]
) -> list[LogEquations]:
    pairs = zip(histories, references, strict=True)
    return [logs_at(history, columns.gains, reference) for history, reference in pairs]
