"""Which effect is missing, with the evidence: one round of the search."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from geodrake.diagnosis.case import error_table, open_case
from geodrake.diagnosis.compare import comparison
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.explain import verdict_of
from geodrake.diagnosis.forward import tuned
from geodrake.diagnosis.hypothesis import first_hypothesis
from geodrake.diagnosis.results import Candidate, Diagnosis
from geodrake.diagnosis.search import Ranked, choose, rank
from geodrake.effects.base import Effect
from geodrake.identification.model_fit import model_unknowns
from geodrake.model import RobotModel
from geodrake.motion import JointLog


def diagnose(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    criteria: Criteria | None = None,
) -> Diagnosis:
    """Rank the effects that a model may lack by the held-out error that each would take away.

    Args:
        model: The model as it stands.
        logs: Logs or their files; several logs are several trajectories.
        extra: Effect classes of the user's own to try beside the catalogue's.
        bandwidth: Bandwidth of the filter, Hz; by default chosen from the data.
        blocks: Blocks into which every log is cut for validation.
        criteria: When an effect counts as found.

    Returns:
        Convincing candidates, each refitted with everything that may move. The first is the
        simplest of those that the logs cannot tell from the best.

    Raises:
        LogError: A log cannot be used.
    """
    criteria = criteria or Criteria()
    case = open_case(model, logs, candidates=True, extra=extra, bandwidth=bandwidth, blocks=blocks)
    hypothesis = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    if model.information is None:
        hypothesis = tuned(hypothesis)
    ranked = rank(hypothesis, criteria)
    if ranked:
        chosen = choose(ranked)
        ranked = [chosen, *(r for r in ranked if r is not chosen)]
    before = comparison(case)
    return Diagnosis(
        "explained" if ranked else verdict_of(before.errors, found=False),
        tuple(_candidate(r, hypothesis.nrms) for r in ranked),
        before.errors,
        error_table(case.dataset, hypothesis.held_out),
        before,
        case.notes,
    )


def _candidate(ranked: Ranked, before: float) -> Candidate:
    return Candidate(
        " + ".join(ranked.names),
        ranked.where,
        before,
        ranked.hypothesis.nrms,
        ranked.score,
        ranked.alarm,
        ranked.tied,
    )
