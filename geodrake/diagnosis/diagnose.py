"""Ranking of the effects that a model may lack."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import instance
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.findings import (
    StagedFinding,
    at_found_gains,
    largest_residual,
    named,
    probable,
    unknown_probability,
    verdict_of,
    where_of,
)
from geodrake.diagnosis.moves import additions
from geodrake.diagnosis.results import Candidate, Diagnosis
from geodrake.diagnosis.search import SearchResult, find_explanation
from geodrake.diagnosis.terms import names_and_places
from geodrake.effects import Effect
from geodrake.identification.logs.case import Case, error_table, prepare_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.criteria import ALARM
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel


def diagnose(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    hold_resting: bool = True,
    beliefs: Beliefs | None = None,
) -> Diagnosis:
    """Rank the effects that a model may lack, each added alone.

    Columns are assumed to be correct; `check_columns` finds mistakes in them. Arguments are those
    of `explain`.

    Returns:
        Candidates. The first is the first step of the most probable explanation, as from `explain`;
        then come alternatives to it, and other effects that improve the model alone.

    Raises:
        LogError: A log cannot be used.
        ArgumentError: There is no log, or a setting is invalid.
    """
    if beliefs is not None:
        instance(beliefs, "beliefs", Beliefs)
    case = prepare_case(
        model,
        logs,
        candidates=True,
        extra=extra,
        bandwidth=bandwidth,
        blocks=blocks,
        hold_resting=hold_resting,
    )
    result, findings, _ = named(find_explanation(case, beliefs))
    result, start, stages = probable(case, result, findings)
    refitted, before = error_table(case.dataset, start.held_out), comparison(case)
    candidates = _candidates(case, result, start, stages) if stages else []
    gained = None if candidates else at_found_gains(result)
    left = largest_residual(result)
    return Diagnosis(
        "explained" if candidates else verdict_of(gained or refitted, found=False, left=left),
        tuple(candidates),
        before.errors,
        refitted,
        before,
        case.notes,
        gained,
    )


def _candidates(
    case: Case, result: SearchResult, start: Hypothesis, stages: Sequence[StagedFinding]
) -> list[Candidate]:
    """Return the first step, its rivals, and other effects that improve the model alone."""
    first, before = stages[0], start.nrms
    finding, certainty = first.finding, first.finding.certainty
    data = result.case.dataset
    held_out = (start.held_out, first.validated.held_out, stages[-1].validated.held_out)
    errors = [error_table(data, each) for each in held_out]
    named = 1.0 - unknown_probability(result, finding, errors)
    without = result.model.without_terms(result.model.shares(first.fit))
    candidates = [
        Candidate(
            finding.name,
            where_of(result, finding, result.model.bodies(first.fit)),
            before,
            first.validated.nrms,
            first.fit.score - without.score,
            1.0 - named * (1.0 - certainty.chance),
            tied=True,
        )
    ]
    candidates += [
        Candidate(r.effect, r.where, before, r.nrms, 0.0, 1.0 - named * r.probability, tied=True)
        for r in certainty.rivals
    ]
    seen = {candidate.effect for candidate in candidates}
    for fit in additions(result.model, without):
        (name, places), gain = names_and_places(fit.terms), fit.score - without.score
        chance = float(np.exp(-0.5 * np.clip(gain, 0.0, 1400.0)))
        if name not in seen and chance <= ALARM:
            seen.add(name)
            nrms = result.model.validated(fit).nrms  # with physical bodies
            candidates.append(Candidate(name, places, before, nrms, gain, chance, tied=False))
    return candidates
