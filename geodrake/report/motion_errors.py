"""How far simulated motions depart from measured ones, for pages that have no more of rollouts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from geodrake.report.numbers import Units
from geodrake.report.page import Table, cells
from geodrake.report.words import departure

if TYPE_CHECKING:
    from geodrake.control.rollout import Rollout  # which takes a while to import


def departures_table(after: Rollout, before: Rollout | None, units: Units) -> Table:
    """Return how far every joint departs from its measured motion."""
    rows = []
    for j, joint in enumerate(after.joints):
        log, instant = joint.worst
        ends = (before.joints[j].rms, joint.rms) if before else (joint.rms,)
        worst = f"{log} {instant:.1f} s"
        name = f"{joint.joint}, {units.at(joint.joint, 'rad')}"
        rows.append(cells(name, joint.moved, *ends, departure(joint.relative), worst))
    heads = ("before", "after") if before else ("departure",)
    return Table(("joint", "moved", *heads, "share of motion", "worst at"), rows)


def stages_table(stages: Sequence[Rollout], units: Units) -> Table:
    """Return how far every joint departs before any step, and after each."""
    steps = [f"after step {k}" for k in range(1, len(stages))]
    rows = [
        cells(
            f"{joint.joint}, {units.at(joint.joint, 'rad')}",
            *(stage.joints[j].rms for stage in stages),
        )
        for j, joint in enumerate(stages[0].joints)
    ]
    return Table(("joint", "before", *steps), rows, title="Step by step", detailed=True)


def motion_values(motions: Sequence[Rollout] | None) -> dict[str, Any]:
    """Return rollouts under commands, by the key `motion`; nothing without commands.

    Those before and after the fit, and after each step but the last.
    """
    if motions is None:
        return {}
    before, *between, after = motions
    return {"motion": {"before": before, "after": after, "steps": between}}
