"""Rank the effects that a model may lack."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import instance
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.findings import (
    StagedFinding,
    named,
    probable,
    unknown_probability,
    verdict_of,
    where_of,
)
from geodrake.diagnosis.moves import additions
from geodrake.diagnosis.results import Candidate, Diagnosis
from geodrake.diagnosis.search import Found, searched
from geodrake.diagnosis.terms import names_and_places
from geodrake.effects import Effect
from geodrake.identification.logs.case import Case, error_table, open_case
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

    Columns are assumed to be correct; `check_columns` finds mistakes in them.

    Arguments are those of `explain`.

    Returns:
        Candidates. The first is the first step of the most probable explanation, as of `explain`;
        then come alternatives to it, and other effects that improve the model alone.

    Raises:
        LogError: A log cannot be used.
        ArgumentError: There is no log, or a setting is no usable number.
    """
    if beliefs is not None:
        instance(beliefs, "beliefs", Beliefs)
    case = open_case(
        model,
        logs,
        candidates=True,
        extra=extra,
        bandwidth=bandwidth,
        blocks=blocks,
        hold_resting=hold_resting,
    )
    found, findings, _ = named(searched(case, beliefs))
    found, start, stages = probable(case, found, findings)
    refitted, before = error_table(case.dataset, start.held_out), comparison(case)
    candidates = _candidates(case, found, start, stages) if stages else []
    return Diagnosis(
        "explained" if candidates else verdict_of(refitted, found=False),
        tuple(candidates),
        before.errors,
        refitted,
        before,
        case.notes,
    )


def _candidates(
    case: Case, found: Found, start: Hypothesis, stages: Sequence[StagedFinding]
) -> list[Candidate]:
    """Return the first step, its rivals, and what else improves the model alone."""
    first, before = stages[0], start.nrms
    finding, certainty = first.finding, first.finding.certainty
    data = found.case.dataset
    held_out = (start.held_out, first.validated.held_out, stages[-1].validated.held_out)
    errors = [error_table(data, each) for each in held_out]
    known = 1.0 - unknown_probability(found, finding, errors)
    bare = found.model.bare(found.model.shares(first.fit))
    candidates = [
        Candidate(
            finding.name,
            where_of(found, finding, found.model.bodies(first.fit)),
            before,
            first.validated.nrms,
            first.fit.score - bare.score,
            1.0 - known * (1.0 - certainty.chance),
            tied=True,
        )
    ]
    candidates += [
        Candidate(r.effect, r.where, before, r.nrms, 0.0, 1.0 - known * r.probability, tied=True)
        for r in certainty.rivals
    ]
    seen = {candidate.effect for candidate in candidates}
    for fit in additions(found.model, bare):
        (name, places), gain = names_and_places(fit.terms), fit.score - bare.score
        chance = float(np.exp(-0.5 * np.clip(gain, 0.0, 1400.0)))
        if name not in seen and chance <= ALARM:
            seen.add(name)
            nrms = found.model.validated(fit).nrms  # of bodies that can be
            candidates.append(Candidate(name, places, before, nrms, gain, chance, tied=False))
    return candidates
