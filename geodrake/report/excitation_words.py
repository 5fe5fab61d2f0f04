"""Designed motions, and what is identifiable from logs, in sentences."""

from __future__ import annotations

import numpy as np

from geodrake.excitation import ExcitationResult
from geodrake.excitation.identifiability import LogIdentifiability
from geodrake.excitation.verdict import (
    CLEAR,
    THRESHOLD,
    distinguished_pairs,
    identifiable_directions,
    improvement,
)
from geodrake.report.numbers import Units, number, percent, relative
from geodrake.report.words import listed, places_label

_HALF = 0.5  # of a parameter: a body of which less is possible is not spoken of
_FULL, _HARDLY = 0.9, 0.1  # shares of a body above which it counts as all, and below as nothing


def excitation_verdict(result: ExcitationResult) -> str:
    """What a designed motion amounts to, in a few sentences."""
    if distinguished_pairs(result):
        return _separation_verdict(result)
    criterion, normalization = result.objective.criterion.name, result.objective.normalization
    words = f"{criterion.replace('_', ' ')} {number(result.value)}"
    if criterion == "e_optimality" and normalization == "geometric":
        words += f": the worst direction has a deviation of {relative(result.value**0.5)}"
    words += f"; {_times(improvement(result))} better than the best random motion."
    if normalization == "geometric":
        words += (
            f" Its {result.samples} samples identify {identifiable_directions(result)} of "
            f"{len(result.eigenvalues)} directions to within {percent(THRESHOLD**0.5)}."
        )
    return words[:1].upper() + words[1:]


def _separation_verdict(result: ExcitationResult) -> str:
    hardest, gained = distinguished_pairs(result)[0], improvement(result) ** 0.5
    units = Units.of(result.objective.target.model)
    words = (
        f"Every pair differs by at least {number(hardest.deviations)} standard deviations of the "
        f"noise of all {result.samples} samples together, {_times(gained)} what the best random "
        f"motion makes of it. Hardest to distinguish is {hardest.pair.truth} of "
        f"{places_label(hardest.pair.where, units.joints)} from {hardest.pair.rival}, which leaves "
        f"an effort of {number(hardest.effort)} {units.effort()} RMS unexplained."
    )
    if hardest.deviations < CLEAR:
        words += " That is little: such a log will hardly distinguish them."
    return words


def nearest_bodies(result: ExcitationResult) -> str:
    """How near bodies come to each other on a motion; "" if collisions were not looked for."""
    use = result.use
    if not np.isfinite(use.distance):
        return ""
    least, kept = (f"{1e3 * distance:.0f} mm" for distance in (use.distance, use.clearance))
    return f"{use.nearest}, {least} apart, where {kept} are to be kept."


def identifiability_verdict(found: LogIdentifiability) -> str:
    """What is identifiable from logs, in a few sentences."""
    words = f"{identifiable_share(found)}{_whose_bodies(found)}."
    unknown = [entry.label for entry in found.effects if not entry.is_identifiable]
    if unknown:
        words += f" Not identifiable: {listed(unknown)}."
    elif found.effects:
        words += " All parameters of effects are identifiable."
    if found.count_at_floor > found.count:
        words += f" If the model left nothing but sensor noise, {found.count_at_floor} would be."
    return words


def identifiable_share(found: LogIdentifiability) -> str:
    """`9 of 12 directions are identifiable to within 10 %`."""
    most = percent(found.identifiable.threshold**0.5)
    return f"{found.count} of {found.possible} directions are identifiable to within {most}"


def _whose_bodies(found: LogIdentifiability) -> str:
    """Which bodies are identifiable in full, and which hardly at all."""
    seen = [body for body in found.bodies if body.possible >= _HALF]
    full = [body.name for body in seen if body.share > _FULL]
    none = [body.name for body in seen if body.share < _HARDLY]
    words = f"; {listed(full)} in full" if full else ""
    return f"{words}; {listed(none)} hardly at all" if none else words


def _times(factor: float) -> str:
    return f"{number(factor)} times" if np.isfinite(factor) else "infinitely"
