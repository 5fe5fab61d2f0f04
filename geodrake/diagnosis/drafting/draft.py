"""Formulas for what no effect of the catalogue explains."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import function, instance, typed
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.drafting.formula import Formula
from geodrake.diagnosis.drafting.judgement import judge
from geodrake.diagnosis.drafting.results import Array, Correlate, Draft, DraftedEffect
from geodrake.diagnosis.drafting.screening import Screen
from geodrake.diagnosis.drafting.search import FoundFormula, JointSearch
from geodrake.diagnosis.drafting.term_columns import TermColumns
from geodrake.diagnosis.drafting.vocabulary import short_vocabulary
from geodrake.diagnosis.explain import Investigation, investigate
from geodrake.diagnosis.results import Explanation
from geodrake.diagnosis.search_progress import FoundStep, Progress
from geodrake.effects.base import Effect
from geodrake.identification.logs.case import error_table, open_case
from geodrake.identification.logs.criteria import FIXED, NOISE_MARGIN
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

_MOST_JOINTS = 3  # of which it is reported what their error goes with


def draft_effects(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    hold_resting: bool = True,
    beliefs: Beliefs | None = None,
    progress: Progress | None = None,
) -> tuple[Explanation, Draft]:
    """Explain, and draft formulas for what stays unexplained.

    A formula is a sum of up to three terms at a joint, each a product of up to two simple functions
    of positions, velocities, directions, accelerations and loads of any joints. It is judged by
    held-out error, everything that may move refitted, with the number of formulas that were tried
    counted against it.

    Args:
        model: The model as it stands.
        logs: Logs or their files; several logs are several trajectories.
        extra: Effect classes of the user's own to try beside the catalogue's.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Blocks into which every log is cut for validation.
        hold_resting: Whether joints that hardly move in any log are held; see
            `geodrake.model.logged_joints.holding_resting`.
        beliefs: Prior odds and widths of effects.
        progress: Called with each `FoundStep`, and with each formula.

    Returns:
        The explanation as `explain` gives it, and formulas for the rest.

    Raises:
        LogError: A log cannot be used.
    """
    if progress is not None:
        function(progress, "progress")
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
    found = investigate(case, beliefs=beliefs, progress=progress)
    return found.explanation, draft_rest(found, fixed=effects_of(case.model), progress=progress)


@typed
def rest_correlates(investigation: Investigation) -> tuple[Correlate, ...]:
    """Return what the error that an investigation left goes with, without a search for formulas.

    Args:
        investigation: What was found so far.

    Returns:
        Signals and products of two of them, for the joints that err most beyond noise.
    """
    case, hypothesis = investigation.case, _where_fewest_joints_err(investigation.hypothesis)
    joints = [joint for joint in _worst_first(hypothesis) if _left(hypothesis, joint)]
    terms = {j: short_vocabulary(j, case.model.single_joints) for j in joints[:_MOST_JOINTS]}
    columns = [TermColumns(Formula(joint, tuple(each))) for joint, each in terms.items()]
    if not columns:
        return ()
    effects = [*hypothesis.unknowns.effects, *columns]
    dataset = reduce_logs(case.model, case.trajectories, case.folds, effects=effects)
    found: list[Correlate] = []
    for each in columns:
        search = JointSearch(case, hypothesis, each.formula.joint)
        found += search.correlates(Screen.of(hypothesis, dataset, each))
    return tuple(found)


def draft_rest(
    investigation: Investigation,
    *,
    fixed: Sequence[Effect] = (),
    progress: Progress | None = None,
) -> Draft:
    """Draft formulas for what an investigation left, joint by joint, the worst first.

    Args:
        investigation: What was found so far.
        fixed: Effects that stay even if a formula makes them needless.
        progress: Called with each formula.
    """
    start = hypothesis = _where_fewest_joints_err(investigation.hypothesis)
    drafted: list[DraftedEffect] = []
    correlates: list[Correlate] = []
    stopped = investigation.explanation.is_interrupted
    for joint in () if stopped else _worst_first(start):
        if not _left(hypothesis, joint):
            continue
        search = JointSearch(investigation.case, hypothesis, joint)
        screen = search.screened()
        correlates += search.correlates(screen)
        found = search.judged(search.formulas(screen), len(screen.vocabulary))
        if found is not None:
            drafts = [e for e in found.after.unknowns.effects if e.name == found.columns.name]
            before = hypothesis.nrms
            hypothesis = _without_needless(found.after, {*fixed, *drafts})
            drafted.append(_drafted(found, hypothesis))
            if progress is not None:
                floor = error_table(start.dataset, start.held_out).floor_nrms
                nrms = before, hypothesis.nrms, start.nrms, floor
                progress(FoundStep("a formula", (joint,), *nrms))
    kept = hypothesis.unknowns.effects
    return Draft(
        tuple(drafted),
        tuple(correlates),
        tuple(e for e in start.unknowns.effects if e not in kept),
        error_table(start.dataset, start.held_out),
        error_table(hypothesis.dataset, hypothesis.held_out),
        start.dataset.logs,
    )


def _without_needless(hypothesis: Hypothesis, kept: set[Effect]) -> Hypothesis:
    """The hypothesis less the effects that a formula made needless, those kept left aside."""
    for effect in hypothesis.unknowns.effects:
        if effect not in kept:
            less = hypothesis.without([effect])
            hypothesis = hypothesis if judge(less, hypothesis).is_better else less
    return hypothesis


def _where_fewest_joints_err(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis, or with bodies that stay as the model has them if fewer joints err then.

    Bodies that follow what is unknown at one joint, as a hose on the sum of two angles goes with a
    pendulum's weight, spread it over the joints further in.
    """
    fixed = hypothesis.loosened(FIXED / hypothesis.looseness)
    free, fewer = (sum(_left(each, j) for j in each.dataset.joints) for each in (hypothesis, fixed))
    return fixed if fewer < free else hypothesis


def _worst_first(hypothesis: Hypothesis) -> list[str]:
    excess = hypothesis.held_out.rms / hypothesis.dataset.noise_floor
    return [hypothesis.dataset.joints[k] for k in np.argsort(-excess)]


def _left(hypothesis: Hypothesis, joint: str) -> bool:
    """Return whether a joint has more error than noise, so that a formula of it is searched."""
    j = hypothesis.dataset.joints.index(joint)
    return bool(hypothesis.held_out.rms[j] > NOISE_MARGIN * hypothesis.dataset.noise_floor[j])


def _drafted(found: FoundFormula, end: Hypothesis) -> DraftedEffect:
    """Return what was found, with the coefficients of the fit to all logs."""
    formula, span = found.columns.formula, end.unknowns.span(found.columns)
    j = end.dataset.joints.index(formula.joint)
    coefficients = end.cv.fit_all[span]
    return DraftedEffect(
        formula,
        coefficients,
        end.cv.deviations[span],
        float(found.before.held_out.rms[j]),
        float(end.held_out.rms[j]),
        float(end.dataset.noise_floor[j]),
        found.alarm,
        tuple(rival.words() for rival in found.rivals),
        *_traces(end, found.columns),
    )


def _traces(end: Hypothesis, columns: TermColumns) -> tuple[Array, Array, Array]:
    """Instants, held-out residual without a formula, and the formula's effort, (K,) each."""
    dataset, span = end.dataset, end.unknowns.span(columns)
    joint = dataset.joints.index(columns.formula.joint)
    data, late = dataset.data[joint], end.delay[joint]
    local, own = data.local(end.unknowns.columns), data.local(dataset.effect_columns(columns))
    used = local >= 0
    parts = []
    for fold, blocks in enumerate(data.rows):
        x = end.held_out.x[fold]
        for rows in blocks:
            effort = rows.A[:, own] @ x[span]
            residual = rows.b[:, late] - rows.A[:, local[used]] @ x[used]
            parts.append((rows.time, residual + effort, effort))
    time, residual, effort = (np.concatenate(part) for part in zip(*parts, strict=True))
    return time, residual, effort
