"""Trials: the held-out evidence for single packages of effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from geodrake.diagnosis.candidates import Package
from geodrake.effects.base import Effect, Proposer, Role
from geodrake.identification.logs.criteria import (
    MORE_THAN_HALF,
    MOST,
    PENALTY,
    SEARCH_MARGIN,
    USUAL_GAIN,
    Criteria,
)
from geodrake.identification.logs.cross_validation import ExtraColumns, HeldOut
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.evidence import (
    false_alarm_probability,
    fold_agreement,
    log_likelihood_gain,
)
from geodrake.identification.logs.hypothesis import Hypothesis, effective_of_each
from geodrake.identification.logs.unknowns import effect_prior

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Trial:
    """A package tried on a hypothesis.

    Attributes:
        package: What was tried.
        gain: Twice the held-out log-likelihood ratio.
        reduction: Share of the squared error gone at the joints that the package acts on.
        agreement: Share of folds in which the error fell there.
        alarm: Probability of a false alarm, all candidates counted.
    """

    package: Package
    gain: float
    reduction: float
    agreement: float
    alarm: float

    @property
    def score(self) -> float:
        """Gain less the penalty of the parameters."""
        return self.gain - PENALTY * self.package.parameters

    def convinces(self, criteria: Criteria) -> bool:
        """Whether all criteria are met."""
        return (
            self.alarm <= criteria.alarm
            and self.reduction >= criteria.reduction
            and self.agreement >= criteria.agreement
        )


def gain_of(before: Hypothesis, after: Hypothesis) -> float:
    """Twice the held-out log-likelihood ratio of two hypotheses.

    Args:
        before: The one hypothesis.
        after: The other, with which the samples are counted.
    """
    gains = log_likelihood_gain(before.held_out.mse, after.held_out.mse, after.effective)
    return float(gains.sum())


def net_gain(before: Hypothesis, after: Hypothesis) -> float:
    """Gain of one hypothesis over another less the penalty of the parameters that it has more.

    Args:
        before: The one hypothesis.
        after: The other.
    """
    return gain_of(before, after) - PENALTY * (_parameters(after) - _parameters(before))


def is_likelier(held: Hypothesis, loose: Hypothesis) -> bool:
    """Whether a hypothesis explains logs better than bodies that go far, and pay for their way.

    Args:
        held: A hypothesis with bodies within the assumed prior.
        loose: One with bodies that go farther.
    """
    return net_gain(loose, held) + loose.inertial_penalty - held.inertial_penalty > 0.0


def _parameters(hypothesis: Hypothesis) -> int:
    """How many parameters the effects have, shapes that were tried on a grid counted."""
    return sum(Package((e,), e.where).parameters for e in hypothesis.unknowns.effects)


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
    trials, promising = list[Trial](), list[int]()
    fits = _quick_fits(hypothesis, packages) if packages else []
    for package, after in zip(packages, fits, strict=True):
        reduction, agreement = improvement((before, after), acted_upon(dataset, package))
        few = least and (reduction < least.reduction or agreement < least.agreement)
        if not few and not is_nothing(dataset, package.effects, after.x[:, len(present) :]):
            promising.append(len(trials))
        trials.append(Trial(package, 0.0, reduction, agreement, 1.0))
    columns = [np.concatenate([present, columns_of(dataset, packages[k])]) for k in promising]
    parameters = [fits[k].x for k in promising]
    tried_ones = list(zip(columns, parameters, strict=True))
    counts = _counts(hypothesis, [fits[k].mse for k in promising], tried_ones, rivals=rivals)
    for k, effective in zip(promising, counts, strict=True):
        gain = float(log_likelihood_gain(before.mse, fits[k].mse, effective).sum())
        alarm = false_alarm_probability(gain, packages[k].parameters, tried)
        trials[k] = replace(trials[k], gain=gain, alarm=alarm)
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
    gain is nothing that is off, in the mean of the folds, by no more than gains are uncertain.

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
        if effect.role is Role.SCALE:
            usual = USUAL_GAIN * dataset.gain_uncertainty[dataset.joints.index(effect.where[0])]
            if np.abs(own.mean()) < usual:
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
    return ExtraColumns(columns_of(dataset, package), information, lower, upper)


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


def settled_trial(before: Hypothesis, after: Hypothesis, package: Package) -> Trial:
    """The evidence for a package between the hypotheses without and with it, both fitted in full.

    Where inertias stand in for a package, they may do so well at the joints that it acts upon, and
    leave the error to another one. The joint that gains most is therefore looked at too.

    Args:
        before: The hypothesis without the package.
        after: The hypothesis with it.
        package: The effects.
    """
    errors = before.held_out, after.held_out
    seen = acted_upon(before.dataset, package)
    seen[np.argmin(errors[1].mse / errors[0].mse)] = True
    gain = gain_of(before, after)
    alarm = false_alarm_probability(gain, package.parameters, 1)
    return Trial(package, gain, *improvement(errors, seen), alarm)


def acted_upon(dataset: Dataset, package: Package) -> Mask:
    """(nv,) whether the effects of a package act on a joint.

    Play is proposed at its joint alone: it reaches others too, but is lost there in larger errors.

    Args:
        dataset: The reduced logs.
        package: The effects.
    """
    if all(effect.proposer is Proposer.PLAY for effect in package.effects):
        return np.isin(dataset.joints, [joint for e in package.effects for joint in e.where])
    return np.asarray(dataset.reach[:, columns_of(dataset, package)].any(axis=1))


def columns_of(dataset: Dataset, package: Package) -> Indices:
    """(k,) columns of a package.

    Args:
        dataset: The reduced logs, with columns for the effects.
        package: The effects.
    """
    return np.concatenate([dataset.effect_columns(effect) for effect in package.effects])


def improvement(errors: tuple[HeldOut, HeldOut], joints: Mask) -> tuple[float, float]:
    """Share of the squared error gone at some joints, and share of the folds in which it fell.

    Args:
        errors: Held-out errors before and after.
        joints: (nv,) which joints to look at.
    """
    before, after = errors
    weight = joints / before.mse
    lost, left = before.sse @ weight, after.sse @ weight
    return float(1.0 - left.sum() / lost.sum()), fold_agreement(lost, left)
