"""Trials: the held-out evidence for single packages of effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from geodrake.diagnosis.candidates import Package
from geodrake.diagnosis.judgement import Judgement, acted_upon, judge, judge_errors
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import (
    MORE_THAN_HALF,
    MOST,
    SEARCH_MARGIN,
    USUAL_GAIN,
    Criteria,
)
from geodrake.identification.logs.cross_validation import ExtraColumns, HeldOut
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.evidence import log_likelihood_gain
from geodrake.identification.logs.hypothesis import Hypothesis, effective_of_each
from geodrake.identification.logs.unknowns import effect_prior

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Trial:
    """A package tried on a hypothesis.

    Attributes:
        package: What was tried.
        judgement: What held-out errors say of it, at the joints that it acts upon.
    """

    package: Package
    judgement: Judgement

    @property
    def score(self) -> float:
        """Gain less the penalty of the parameters."""
        return self.judgement.score


def open_joints(hypothesis: Hypothesis, least: float = SEARCH_MARGIN) -> list[str]:
    """Joints that err by more than so many times their noise floor.

    Args:
        hypothesis: The hypothesis.
        least: How many times the noise floor.
    """
    dataset = hypothesis.dataset
    errors = zip(dataset.joints, hypothesis.held_out.rms, dataset.noise_floor, strict=True)
    return [joint for joint, rms, floor in errors if rms > least * floor]


def try_package(
    hypothesis: Hypothesis, package: Package, tried: int, *, least: Criteria | None = None
) -> Trial:
    """Held-out evidence for a package, with everything that may move refitted.

    Args:
        hypothesis: What the package is added to.
        package: The effects to try together.
        tried: Number of candidates that compete, for the probability of a false alarm.
        least: Spare the effective samples of a package that reduces too little by these criteria;
            its gain is then given as zero, as is that of effects that are nothing.
    """
    return try_packages(hypothesis, [package], tried, least=least)[0]


def try_packages(
    hypothesis: Hypothesis,
    packages: Sequence[Package],
    tried: int,
    *,
    least: Criteria | None = None,
    rivals: bool = False,
) -> list[Trial]:
    """Held-out evidence for each of several packages; see `try_package`.

    Args:
        hypothesis: What each package is added to.
        packages: The effects to try together, one package after another.
        tried: Number of candidates that compete, for the probability of a false alarm.
        least: As for `try_package`.
        rivals: Whether the others are rivals of the first one that is something. The residuals of
            those that gain less than half as much count as many effective samples as its own do.
    """
    dataset, before, present = hypothesis.dataset, hypothesis.held_out, hypothesis.unknowns.columns
    none = np.zeros(len(dataset.joints))  # effective samples, until they are counted
    trials, promising = list[Trial](), list[int]()
    fits = _quick_fits(hypothesis, packages) if packages else []
    for package, after in zip(packages, fits, strict=True):
        seen, parameters = acted_upon(dataset, package.effects), package.parameters
        found = judge_errors((before, after), none, joints=seen, parameters=parameters, tried=tried)
        few = least and (found.reduction < least.reduction or found.agreement < least.agreement)
        if not few and not is_nothing(dataset, package.effects, after.x[:, len(present) :]):
            promising.append(len(trials))
        trials.append(Trial(package, found))
    columns = [
        np.concatenate([present, columns_of(dataset, packages[k].effects)]) for k in promising
    ]
    tried_ones = list(zip(columns, [fits[k].x for k in promising], strict=True))
    counts = _counts(hypothesis, [fits[k].mse for k in promising], tried_ones, rivals=rivals)
    for k, effective in zip(promising, counts, strict=True):
        gain = float(log_likelihood_gain(before.mse, fits[k].mse, effective).sum())
        trials[k] = Trial(packages[k], replace(trials[k].judgement, gain=gain))
    return trials


def _counts(
    hypothesis: Hypothesis,
    errors: Sequence[Array],
    fits: Sequence[tuple[Indices, Array]],
    *,
    rivals: bool,
) -> Array:
    """(m, nv) effective samples of m fits; see `try_packages`.

    Args:
        hypothesis: What the packages of the fits are added to.
        errors: Mean squared held-out errors (nv,) of each fit, (N·m)² or N².
        fits: Columns (p,) and parameters (F, p) of each fit.
        rivals: As for `try_packages`.
    """
    dataset, delay = hypothesis.dataset, hypothesis.delay
    if not rivals or len(fits) < 2:
        return effective_of_each(dataset, fits, delay=delay)
    first = effective_of_each(dataset, fits[:1], delay=delay)
    before = hypothesis.held_out.mse
    gains = np.array([log_likelihood_gain(before, mse, first[0]).sum() for mse in errors])
    near = [k for k in range(1, len(fits)) if gains[k] >= MOST * gains[0]]
    counts = np.repeat(first, len(fits), axis=0)
    counts[near] = effective_of_each(dataset, [fits[k] for k in near], delay=delay)
    return counts


def is_nothing(dataset: Dataset, effects: Sequence[Effect], x: Array) -> bool:
    """Whether one of some effects has, in most folds, none of what cannot be negative.

    A spring without stiffness is an offset, whatever its preload. A drag of nothing has no centre
    that could be elsewhere; its slopes, which have no sign, would stand for a force that drives. A
    gain, or what looks like one, is nothing that is off, in the mean of the folds, by no more than
    gains are uncertain.

    Args:
        dataset: The reduced logs.
        effects: Effects.
        x: (F, p) their parameters, one after the other, for each fold.
    """
    ends = np.cumsum([len(effect.parameters) for effect in effects])
    for effect, own in zip(effects, np.split(x, ends[:-1], axis=1), strict=True):
        sizes = own[:, [parameter.lower == 0.0 for parameter in effect.parameters]]
        if sizes.shape[1] and (sizes <= 0.0).all(axis=1).mean() > 0.5:
            return True
        gain = effect.as_gain(own)
        if gain is not None:
            usual = USUAL_GAIN * dataset.gain_uncertainty[dataset.joints.index(effect.where[0])]
            if np.abs(gain.mean()) < usual:
                return True
    return False


def quick_fit(hypothesis: Hypothesis, package: Package) -> HeldOut:
    """Held-out errors with a package, everything refitted with the weights of the hypothesis.

    Args:
        hypothesis: What the package is added to.
        package: The effects to try together.
    """
    return _quick_fits(hypothesis, [package])[0]


def _quick_fits(hypothesis: Hypothesis, packages: Sequence[Package]) -> list[HeldOut]:
    dataset = hypothesis.dataset
    return hypothesis.cv.with_candidates([_candidate(dataset, package) for package in packages])


def _candidate(dataset: Dataset, package: Package) -> ExtraColumns:
    known = [effect_prior(dataset, effect)[1] for effect in package.effects]
    information = block_diag(*known) if len(known) > 1 else known[0]
    parameters = [p for effect in package.effects for p in effect.parameters]
    lower, upper = (np.array([getattr(p, side) for p in parameters]) for side in ("lower", "upper"))
    return ExtraColumns(columns_of(dataset, package.effects), information, lower, upper)


def asked_of(names: Sequence[str], hypothesis: Hypothesis, criteria: Criteria) -> Criteria:
    """The criteria for effects of some names: of what most joints have, most folds need not agree.

    A robot with rotors at five joints has one at the sixth too, whose evidence may lie in a few
    folds; what else is asked stays.

    Args:
        names: Names of the effects.
        hypothesis: What they would be added to.
        criteria: What an effect must show otherwise.
    """
    effects, joints = hypothesis.unknowns.effects, len(hypothesis.dataset.joints)
    fewest = min(
        len({e.where for e in effects if e.name == name and e.places == "joint"}) for name in names
    )
    if fewest <= max(MOST * joints, 1):
        return criteria
    return replace(criteria, agreement=min(criteria.agreement, MORE_THAN_HALF))


def judge_package(before: Hypothesis, after: Hypothesis, package: Package) -> Judgement:
    """What the hypotheses without and with a package, both fitted in full, say of it.

    Where inertias stand in for a package, they may do so well at the joints that it acts upon, and
    leave the error to another one. The joint that gains most is therefore looked at too.

    Args:
        before: The hypothesis without the package.
        after: The hypothesis with it.
        package: The effects.
    """
    seen = acted_upon(before.dataset, package.effects)
    seen[np.argmin(after.held_out.mse / before.held_out.mse)] = True
    return judge(before, after, joints=seen, parameters=package.parameters)


def columns_of(dataset: Dataset, effects: Sequence[Effect]) -> Indices:
    """(k,) columns of effects.

    Args:
        dataset: The reduced logs, with columns for the effects.
        effects: The effects.
    """
    return np.concatenate([dataset.effect_columns(effect) for effect in effects])
