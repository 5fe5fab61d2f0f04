"""What else a finding could be: rivals in its place, beside everything else that was found.

A rival tied with an effect when that was chosen, often before others were known. So it is asked
again at the end, and how probable either is follows from the same held-out errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from geodrake.diagnosis.candidates import kinds
from geodrake.diagnosis.search import LOOSER_PRIORS
from geodrake.diagnosis.trials import PENALTY, gain_of, try_packages
from geodrake.effects.lookup import effect_of
from geodrake.effects.role import Role
from geodrake.identification.logs.evidence import tie_probability
from geodrake.identification.logs.hypothesis import Hypothesis

_LEAST = 1e-6
"""No comparison of a few blocks makes anything more certain than this."""


def instead(bare: Hypothesis, name: str, where: Sequence[str]) -> Hypothesis | None:
    """A hypothesis with an effect of a name, at the places of another one if it can be there.

    Args:
        bare: The hypothesis without that other one.
        name: Name of the effect.
        where: Places of the other one.

    Returns:
        None where the effect cannot be added.
    """
    if name == effect_of(Role.INERTIA).name:
        if bare.looseness > 1.0:
            return None
        others = [bare.loosened(factor / bare.looseness) for factor in LOOSER_PRIORS]
        return max(others, key=lambda other: gain_of(bare, other))
    if name == effect_of(Role.DELAY).name:
        delays = [bare.dataset.delay_of_each(d) for d in range(len(bare.dataset.delays))]
        late = [delay for delay in delays if delay != bare.delay]
        return bare.delayed(late[int(np.argmax(bare.quick_gains(late)))]) if late else None
    best = []
    for kind in kinds(bare.dataset.effects, bare.unknowns.effects):
        if kind.names == (name,):
            same = [place for place in kind.options if set(place) <= set(where)]
            for place in same or list(kind.options):
                options = kind.options[place]
                trials = try_packages(bare, options, len(options))
                best.append(max(trials, key=lambda trial: trial.score))
            if best and not (kind.unite and same):
                best = [max(best, key=lambda trial: trial.score)]
    return bare.with_effects([e for t in best for e in t.package.effects]) if best else None


def odds(chosen: Hypothesis, other: Hypothesis) -> float:
    """Odds of another hypothesis against that which was chosen.

    The chance that it is truly no worse, by the held-out errors of all blocks, and the price of the
    parameters that it has more.

    Args:
        chosen: What was chosen.
        other: The same with a rival in its place.
    """
    no_worse = float(np.clip(tie_probability(chosen.loss(), other.loss()), _LEAST, 1.0 - _LEAST))
    more = parameters_of(other) - parameters_of(chosen)
    return float(no_worse / (1.0 - no_worse) * np.exp(-0.5 * PENALTY * more))


def parameters_of(hypothesis: Hypothesis) -> int:
    """How many parameters a hypothesis has beside the model's, shapes counted, bodies let go too.

    Args:
        hypothesis: The hypothesis.
    """
    effects = hypothesis.unknowns.effects
    own = sum(len(effect.parameters) + effect.free_shapes for effect in effects)
    own += len(set(hypothesis.delay)) if any(hypothesis.delay) else 0
    return own + (2 * len(hypothesis.dataset.bodies) if hypothesis.looseness > 1.0 else 0)


def shares(odds_of: Mapping[str, float], alarm: float) -> tuple[float, dict[str, float]]:
    """Probabilities of a finding and of its rivals; what is left to one is that of chance.

    Args:
        odds_of: Odds of every rival against the finding.
        alarm: Probability of a false alarm.
    """
    total = (1.0 - alarm) / (1.0 + sum(odds_of.values()))
    return total, {name: total * each for name, each in odds_of.items()}
