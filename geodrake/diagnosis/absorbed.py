"""Effects that the inertias take in: one effect, where the inertias are held, for all of them."""

from __future__ import annotations

from geodrake.diagnosis.candidates import kind_complexity
from geodrake.diagnosis.case import Case
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.final_fit import final_fit
from geodrake.diagnosis.forward import Trail
from geodrake.diagnosis.search import Ranked, rank
from geodrake.diagnosis.steps import refit_evidence

HELD = 1e-3
"""Width of the inertial prior, as a share of that assumed, at which inertias stay as they are."""

_INERTIAS = "wrong_inertia"


def instead_of_inertias(case: Case, trail: Trail, criteria: Criteria) -> Trail:
    """One kind of effect with the inertias held, where nothing but moved inertias was found.

    A prior that is weak lets a payload, a rotor or a compensator pass into the inertias, and then
    nothing is left to find. An effect that explains the logs as well while every body stays as the
    model has it is the simpler answer, and moved inertias are what it cannot be told from. It does
    as well if it leaves less of the squared error than counts as a reduction.

    Args:
        case: The case.
        trail: A search that may have found nothing, and leaves no more than noise.
        criteria: When an effect counts as found.

    Returns:
        The trail with the effect, from the model with its inertias held; the trail as it was where
        it found something, the inertias did not need to move, or no effect does as well as they do.
    """
    end = trail.end
    found = set(end.unknowns.effects) != set(trail.start.unknowns.effects)
    if found or end.released or end.looseness > 1.0 or end.delay != trail.start.delay:
        return trail
    if refit_evidence(case, end, criteria) is None:
        return trail
    held, most = end.loosened(HELD / end.looseness), end.loss().sum() * (1.0 + criteria.reduction)
    alike = [r for r in rank(held, criteria) if r.effects and r.hypothesis.loss().sum() <= most]
    names = {name for r in alike for name in r.names} | {_INERTIAS}
    for chosen in sorted(alike, key=_simplest):
        # A body that lost mass is no payload: what counts is the fit that is physically consistent.
        _, fit, last = final_fit(case, chosen.hypothesis, criteria=criteria)
        left = (fit.held_out.sse / case.dataset.effort_std**2).sum()
        if left <= most and set(last.unknowns.effects) > set(held.unknowns.effects):
            rivals = {name: tuple(sorted(names.difference(chosen.names))) for name in chosen.names}
            return Trail(held, last, {**trail.rivals, **rivals})
    return trail


def _simplest(ranked: Ranked) -> tuple[int, float]:
    return kind_complexity(ranked.names), -ranked.score
