"""All robots of a type: what they share, and which of them changed, at which joint, since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from geodrake.boundary.arguments import instance, instances, integer, number
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.change_evidence import ChangePlace
from geodrake.fleet.changes import RobotChange, RobotSearch, months
from geodrake.fleet.columns import TypeColumns
from geodrake.fleet.history import HistorySource, ReferredLogs, RobotHistory
from geodrake.fleet.hypotheses import ChangeHypothesis
from geodrake.fleet.type_learning import begun, learnt, least_squares, pooled
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
    histories: Sequence[HistorySource],
    columns: TypeColumns,
    hypotheses: Sequence[ChangeHypothesis],
    *,
    false_alarms: float,
    passes: int = 3,
) -> FleetChanges:
    """`find_changes` where others look at robots, whose histories are not held here.

    Args:
        histories: Where those of each robot are, over the same p columns.
        false_alarms: At most how many robots in which nothing changed are named, a robot-month.
        passes: How often all is done.
    """
    # What gains refer to at first is what all robots are in the mean.
    first = least_squares(*pooled(team, [ReferredLogs(h, 0, columns.prior) for h in histories]))
    references: list[Array] = [first] * len(histories)
    logs = _referred(histories, columns, references)
    model = learnt(team, logs, begun(team, logs, columns), rounds=_FIRST)
    for _ in range(passes - 1):
        found = in_order(
            team, _settled, _searches(model, histories, references, hypotheses, false_alarms)
        )
        references = [each.reference for each in found]
        model = learnt(
            team,
            _referred(histories, columns, references),
            replace(model, odd=tuple(each.odd for each in found)),
            changes=[each.design for each in found],
            rounds=_LATER,
        )
    told = in_order(team, _told, _searches(model, histories, references, hypotheses, false_alarms))
    places, changes = zip(*told, strict=True)
    return FleetChanges(model, changes, places, tuple(references))


@dataclass(frozen=True, eq=False)
class _SearchedRobot:
    """A robot whose changes are to be found.

    Attributes:
        model: What is known of its type, as it alone needs it.
        reference: (T, p) or (p,) parameters that gains refer to at first.
        level: Probability of a false alarm in the time of its logs.
    """

    model: TypeModel
    history: HistorySource
    reference: Array
    hypotheses: Sequence[ChangeHypothesis]
    level: float

    def search(self) -> RobotSearch:
        """What finds them."""
        return RobotSearch(self.model, 0, self.history.read(), self.reference, self.hypotheses)


@dataclass(frozen=True, eq=False)
class _SettledRobot:
    """What learning needs of a robot: parameters of the day, changes, and how odd logs are."""

    reference: Array
    design: Array
    odd: Array


def _searches(
    model: TypeModel,
    histories: Sequence[HistorySource],
    references: Sequence[Array],
    hypotheses: Sequence[ChangeHypothesis],
    false_alarms: float,
) -> list[_SearchedRobot]:
    return [
        _SearchedRobot(
            model.of(r), history, reference, hypotheses, min(1.0, false_alarms * months(history))
        )
        for r, (history, reference) in enumerate(zip(histories, references, strict=True))
    ]


def _settled(robot: _SearchedRobot) -> _SettledRobot:
    search = robot.search()
    places = search.find(robot.level)
    reference, odd = search.settled(places)
    return _SettledRobot(reference, search.design(places), odd)


def _told(robot: _SearchedRobot) -> tuple[tuple[ChangePlace, ...], tuple[RobotChange, ...]]:
    search = robot.search()
    places = search.find(robot.level)
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


def _referred(
    histories: Sequence[HistorySource], columns: TypeColumns, references: Sequence[Array]
) -> list[ReferredLogs]:
    pairs = zip(histories, references, strict=True)
    return [ReferredLogs(history, columns.gains, reference) for history, reference in pairs]
