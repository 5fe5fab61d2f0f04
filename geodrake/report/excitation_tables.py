"""Tables of designed motions, and of what is identifiable from logs, as plain data."""

from __future__ import annotations

import numpy as np

from geodrake.excitation import ExcitationResult
from geodrake.excitation.identifiability import LogIdentifiability
from geodrake.excitation.verdict import distinguished_pairs
from geodrake.report.numbers import UNKNOWN, Units, number, percent, relative
from geodrake.report.tables import Cell, Table, cells
from geodrake.report.words import effect_label, places_label


def pairs_table(result: ExcitationResult, units: Units, *, most: int) -> Table:
    """Pairs of effects and by how much they differ on a motion, the most alike first."""
    rows = tuple(
        cells(
            _shaped(entry.pair.truth),
            places_label(entry.pair.where, units.joints),
            _shaped(entry.pair.rival),
            f"{number(entry.deviations)} σ",
            number(entry.effort),
        )
        for entry in distinguished_pairs(result)[:most]
    )
    unit = units.effort(result.limits.joints)
    head = ("if the robot has", "where", "and is thought to have", "they differ by", f"RMS, {unit}")
    return Table(head, rows, words=3)


def limits_table(result: ExcitationResult, units: Units) -> Table:
    """Ranges of the joints, and the largest shares of their limits that a motion uses."""
    limits, use = result.limits, result.use
    q = result.trajectory.states(result.trajectory.family.times(result.samples))[0]
    rows = tuple(
        cells(
            f"{joint}, {units.at(joint, 'rad')}",
            f"{number(float(limits.lower[j]))} … {number(float(limits.upper[j]))}",
            f"{number(float(q[:, j].min()))} … {number(float(q[:, j].max()))}",
            percent(float(use.position[j])),
            *(
                percent(float(getattr(use, name)[j]))
                if np.isfinite(getattr(limits, name)[j])
                else UNKNOWN
                for name in ("velocity", "acceleration", "effort")
            ),
        )
        for j, joint in enumerate(limits.joints)
    )
    head = ("joint", "limits", "moves in", "range", "velocity", "acceleration", "effort")
    return Table(head, rows)


def starts_table(result: ExcitationResult) -> Table:
    """What a design made of every random motion that it began with."""
    rows = tuple(
        cells(
            str(outcome.seed),
            outcome.status,
            number(outcome.random_value),
            number(outcome.value),
            str(outcome.evaluations),
            f"{outcome.seconds:.1f}",
        )
        for outcome in result.outcomes
    )
    head = ("seed", "solver", "random motion", "designed", "evaluations", "seconds")
    return Table(head, rows, words=2)


def identifiable_bodies_table(found: LogIdentifiability) -> Table:
    """How many parameters of every body are identifiable, of those that any motion could show."""
    rows = [
        cells(
            body.name,
            Cell(f"{body.count:.1f}", bar=min(1.0, body.share)),
            f"{body.possible:.1f}",
            percent(body.share),
        )
        for body in found.bodies
    ]
    counts = [
        f"{sum(getattr(b, name) for b in found.bodies):.1f}" for name in ("count", "possible")
    ]
    head = ("body", "identifiable", "of", "share")
    return Table(head, (*rows, cells("all bodies", *counts, "")), total=1)


def identifiable_effects_table(found: LogIdentifiability, units: Units) -> Table:
    """Every parameter of an effect with the deviation of an estimate."""
    rows = tuple(
        cells(
            entry.name,
            places_label(entry.where, units.joints),
            "identifiable" if entry.is_identifiable else "not identifiable",
            number(entry.value),
            number(entry.deviation),
            units.parameter(entry.effect, entry.parameter, " & ".join(entry.where)),
        )
        for entry in found.effects
    )
    head = ("parameter", "where", "", "value", "deviation", "unit")
    return Table(head, rows, words=3)


def unidentifiable_table(found: LogIdentifiability, *, most: int) -> Table:
    """The base parameters that are not identifiable, worst first."""
    rows = tuple(
        cells(c.words, number(c.value), number(c.deviation), relative(c.relative))
        for c in found.unidentifiable[:most]
    )
    return Table(("combination", "in the model", "deviation", "relative"), rows)


def shaped_label(name: str) -> str:
    """An effect's name with its shape in words: `nonlinear viscous friction (exponent 2)`."""
    effect, bracket, shape = name.partition(" (")
    return effect_label(effect) + bracket + shape


def _shaped(name: str) -> Cell:
    return Cell(shaped_label(name), typed=name)
