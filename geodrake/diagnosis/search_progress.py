"""Progress of a search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geodrake.diagnosis.log_model import Fit, LogModel
from geodrake.diagnosis.terms import Term
from geodrake.diagnosis.unknown_efforts import UNKNOWN
from geodrake.effects import Role
from geodrake.effects.lookup import effect_of


@dataclass(frozen=True)
class FoundStep:
    """Step of a search when it is taken; later steps may change it."""

    effect: str  # names of added effects, joined by " + "; empty if effects were only removed
    where: tuple[str, ...]  # joints or bodies; those of removed effects if none was added
    before: float  # held-out nrms before
    after: float  # held-out nrms after
    floor: float  # nrms of the sensor noise; zero if the logs show none
    instead_of: tuple[str, ...] = ()  # names of removed effects
    # Whether the search was stopped here, and only the final fit follows.
    is_last: bool = False


Progress = Callable[[FoundStep], None]
"""Callback for each step. It may raise `StopSearch` to return the steps found so far."""


def _name(term: Term) -> str:
    return "something unknown" if isinstance(term.effect, UNKNOWN) else term.name


def progress_of(model: LogModel, before: Fit, after: Fit) -> FoundStep:
    """Return the step from one explanation to another."""
    data = model.dataset
    deviation = np.where(data.effort_std > 0.0, data.effort_std, np.inf)
    added = [term for term in after.terms if term not in before.terms]
    dropped = [term for term in before.terms if term not in after.terms]
    names = dict.fromkeys(_name(term) for term in added)
    removed = tuple(dict.fromkeys(_name(term) for term in dropped if _name(term) not in names))
    places = dict.fromkeys(name for term in added or dropped for name in term.where)
    late = np.flatnonzero(np.array(after.choice.delay) != before.choice.delay).tolist()
    if late:
        names[effect_of(Role.DELAY).name] = None
        shared = len(late) == len(model.model.joints)
        places |= {} if shared else dict.fromkeys(model.model.joints[j] for j in late)
    if not names and not removed:
        names["bodies"] = None
    errors = np.sqrt(before.variance), np.sqrt(after.variance), data.noise_floor
    first, last, floor = (float(np.sqrt(np.mean(np.square(e / deviation)))) for e in errors)
    return FoundStep(
        " + ".join(names),
        tuple(places),
        first,
        last,
        floor,
        removed,
    )
