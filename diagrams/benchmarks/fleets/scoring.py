"""What was found in a fleet, beside what was hidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from diagrams.benchmarks.fleets.logs import (
    GAIN,
    PAYLOAD,
    STICKIER,
    WEAR,
    FleetDraw,
    HiddenChange,
    day_of,
    type_file,
)
from geodrake.fleet import FleetFinding
from geodrake.fleet.changes import MONTH
from geodrake.fleet.fleet_result import ChangeRival
from geodrake.fleet.type_columns import RAMP, STEP

_DRY, _VISCOUS = frozenset({"coulomb_friction"}), frozenset({"viscous_friction"})

FAMILIES: Mapping[str, tuple[frozenset[str], ...]] = {
    WEAR: (_DRY | _VISCOUS, _DRY, _VISCOUS),
    STICKIER: (_DRY, _DRY | _VISCOUS),
    PAYLOAD: (frozenset({"payload"}),),
    GAIN: (frozenset({"effort_scale"}),),
}
"""What each hidden change may be called: friction that rises is found as dry, viscous, or both."""

DAYS_OFF = 2.0
"""Days by which the day of a change may be off; for a ramp, the day on which it begins."""


def robot_row(draw: FleetDraw, found: Sequence[FleetFinding]) -> dict[str, Any]:
    """Return a row of the table: one robot, what was hidden, and what was found."""
    hidden = draw.change
    right = None if hidden is None else _right(draw.kind, hidden, found)
    return {
        "robot": draw.name,
        "type": draw.kind,
        "months": draw.days / MONTH,
        "hidden": None if hidden is None else hidden.what,
        "where": None if hidden is None else _where(draw.kind, hidden),
        "hidden day": None if hidden is None else hidden.day,
        "hidden size": None if hidden is None else hidden.size,
        "found": right is not None,
        "day off": None if right is None or hidden is None else day_of(right.date) - hidden.day,
        "inside": None if right is None or hidden is None else _is_inside(hidden, right),
        "in rivals": hidden is not None and _in_rivals(draw.kind, hidden, found),
        "named": [_named(change) for change in found],
        "others named": len(found) - (right is not None),
    }


def _where(kind: str, hidden: HiddenChange) -> str:
    model = type_file(kind).model
    names = model.bodies if hidden.what == PAYLOAD else model.joints
    return str(names[hidden.joint])


def _right(kind: str, hidden: HiddenChange, found: Sequence[FleetFinding]) -> FleetFinding | None:
    """Return the finding with the right effect, joint or body, kind and day."""
    for change in found:
        same = _effects(change) in FAMILIES[hidden.what] and change.where == _where(kind, hidden)
        shape = change.kind == (RAMP if hidden.what == WEAR else STEP)
        if same and shape and abs(day_of(change.date) - hidden.day) <= DAYS_OFF:
            return change
    return None


def _effects(found: FleetFinding | ChangeRival) -> frozenset[str]:
    """Return effects that change together."""
    return frozenset(found.effect.split("+"))


def _is_inside(hidden: HiddenChange, found: FleetFinding) -> bool:
    low, high = (day_of(end) for end in found.interval)
    return low <= hidden.day <= high


def _in_rivals(kind: str, hidden: HiddenChange, found: Sequence[FleetFinding]) -> bool:
    """Return whether the truth is among a finding's alternatives."""
    where, families = _where(kind, hidden), FAMILIES[hidden.what]
    return any(
        _effects(rival) in families and rival.where == where
        for change in found
        for rival in change.rivals
    )


def _named(change: FleetFinding) -> dict[str, Any]:
    return {
        "effect": change.effect,
        "where": change.where,
        "kind": change.kind,
        "day": day_of(change.date),
        "interval": [day_of(end) for end in change.interval],
        "probability": change.probability,
        "false_alarm_probability": change.false_alarm_probability,
        "rivals": [[r.effect, r.where, r.kind, r.probability] for r in change.rivals],
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return shares over all robots."""
    changed = [row for row in rows if row["hidden"] is not None]
    still = [row for row in rows if row["hidden"] is None]
    found = [row for row in changed if row["found"]]
    table: dict[str, Any] = {
        "robots": len(rows),
        "changed": len(changed),
        "found": _share(len(found), len(changed)),
        "day inside its interval": _share(sum(row["inside"] for row in found), len(found)),
        "others named, a changed robot": _share(
            sum(row["others named"] for row in changed), len(changed)
        ),
        "robots with nothing": len(still),
        "robots with nothing that are named": sum(bool(row["named"]) for row in still),
        "alarms, a robot-month": _share(
            sum(bool(row["named"]) for row in still), sum(row["months"] for row in still)
        ),
    }
    for what in FAMILIES:
        same = [row for row in changed if row["hidden"] == what]
        table[what] = {
            "found": _share(sum(row["found"] for row in same), len(same)),
            "or among rivals": _share(
                sum(row["found"] or row["in rivals"] for row in same), len(same)
            ),
            "of": len(same),
        }
    return table


def _share(count: float, total: float) -> float | None:
    return count / total if total else None
