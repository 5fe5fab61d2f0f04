"""Pairs of effects at a joint that hide each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.diagnosis.candidates import hidden_pairs
from geodrake.diagnosis.judgement import judge
from geodrake.diagnosis.ranked import Ranked
from geodrake.diagnosis.search import with_ties
from geodrake.diagnosis.trials import open_joints, try_packages
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import MOST, Criteria
from geodrake.identification.logs.cross_validation import normal_matrices
from geodrake.identification.logs.hypothesis import Hypothesis

_FITTED = 4  # pairs of a joint that are fitted in full
_CANCELLED = 9.0  # times the power of two effects together, in one of them


def rank_pairs(
    hypothesis: Hypothesis, criteria: Criteria, *, joints: Sequence[str] | None = None
) -> list[Ranked]:
    """Pairs of effects at a joint that convince together though none does alone, best first.

    What one effect leaves of the residual is coloured by the other, and worth few samples. Only
    pairs that explain most of the squared error are reported, and none that cancel each other: two
    smooth functions of the position stand for any other one so.

    Args:
        hypothesis: What the pairs are added to.
        criteria: When they count as found.
        joints: Where to look; by default at joints that err by clearly more than noise.
    """
    dataset, where = hypothesis.dataset, open_joints(hypothesis) if joints is None else joints
    criteria = replace(criteria, reduction=max(criteria.reduction, MOST))
    effects, present = dataset.effects, hypothesis.unknowns.effects
    pairs = {joint: hidden_pairs(effects, present, joint) for joint in where}
    tried, ranked = sum(map(len, pairs.values())), []
    for joint, packages in pairs.items():
        trials = try_packages(hypothesis, packages, tried, least=criteria)
        good = [trial for trial in trials if trial.judgement.convinces(criteria)]
        good.sort(key=lambda trial: -trial.score)
        for trial in good[:_FITTED]:
            found = trial.package.effects
            after = hypothesis.with_effects(found)
            if not _cancel(after, found):
                classes = tuple(type(effect) for effect in found)
                ranked.append(
                    Ranked(classes, (joint,), found, after, judge(hypothesis, after, tried=tried))
                )
    return with_ties(ranked, criteria)


def _cancel(hypothesis: Hypothesis, effects: Sequence[Effect]) -> bool:
    """Whether one of some effects of a joint is much larger than all of them together."""
    x, unknowns = hypothesis.cv.fit_all(), hypothesis.unknowns
    at = np.concatenate([np.arange(len(x))[unknowns.span(effect)] for effect in effects])
    columns = unknowns.columns[at]
    gram, _ = normal_matrices(
        hypothesis.dataset, np.ones(len(hypothesis.dataset.joints)), columns, columns
    )
    ends = np.cumsum([len(effect.parameters) for effect in effects])[:-1]
    own = np.zeros((len(effects), len(at)))
    for row, part in zip(own, np.split(np.arange(len(at)), ends), strict=True):
        row[part] = x[at[part]]
    power = np.einsum("ki,ij,kj->k", own, gram.sum(0), own)
    return bool(power.max() > _CANCELLED * (x[at] @ gram.sum(0) @ x[at]))
