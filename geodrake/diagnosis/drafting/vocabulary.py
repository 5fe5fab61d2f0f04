"""The terms that a search for a formula may use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.drafting.formula import Factor, FormulaTerm

Array = NDArray[np.float64]

_OWN = (
    ("sign_v", "value"),
    ("v", "value"),
    ("q", "value"),
    ("q", "sine"),
    ("q", "cosine"),
    ("load", "value"),
)
_ANY = (
    ("q", "value"), ("q", "square"), ("q", "size"), ("q", "sine"), ("q", "cosine"),
    ("q", "sine_twice"), ("q", "cosine_twice"),
    ("v", "value"), ("v", "size"), ("v", "square"), ("v", "drag"), ("sign_v", "value"),
    ("vd", "value"), ("load", "value"), ("load", "size"),
)  # fmt: skip
_FEW = (
    ("q", "value"), ("q", "sine"), ("q", "cosine"),
    ("v", "value"), ("v", "size"), ("sign_v", "value"), ("vd", "value"), ("load", "value"),
)  # fmt: skip
_FEW_OWN = (("sign_v", "value"), ("v", "value"), ("q", "sine"), ("q", "cosine"), ("load", "value"))
_MIXED = ("q", "v")
TURNS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Functions that turn are first tried at these shares of the range of a position."""


def vocabulary(
    joint: str, joints: Sequence[str], reach: Mapping[str, tuple[float, float]]
) -> list[FormulaTerm]:
    """All terms for the effort of a joint: simple functions of one signal, and products of two.

    Args:
        joint: The joint.
        joints: Joints whose motion may matter.
        reach: Joint -> least and greatest position in the logs, rad or m.

    Returns:
        Terms, a constant first; none twice.
    """
    own = [Factor(joint, signal, function) for signal, function in _OWN]
    factors = [Factor(name, signal, function) for name in joints for signal, function in _ANY]
    for name in joints:
        low, high = reach[name]
        for share in TURNS:
            constant = float(low + share * (high - low))
            factors += [Factor(name, "q", side, constant) for side in ("above", "below")]
    terms = [FormulaTerm(()), *(FormulaTerm((factor,)) for factor in (*own, *factors))]
    terms += [FormulaTerm((a, b)) for a in own for b in factors if a != b]
    plain = [Factor(name, signal) for name in joints for signal in _MIXED]
    terms += [FormulaTerm(pair) for pair in combinations(plain, 2)]
    return list({_key(term): term for term in reversed(terms)}.values())[::-1]


def short_vocabulary(joint: str, joints: Sequence[str]) -> list[FormulaTerm]:
    """Return the commonest of all terms: enough to see what an error goes with, and quickly so.

    Args:
        joint: The joint.
        joints: Joints whose motion may matter.

    Returns:
        Terms, a constant first; none twice.
    """
    own = [Factor(joint, signal, function) for signal, function in _FEW_OWN]
    factors = [Factor(name, signal, function) for name in joints for signal, function in _FEW]
    terms = [FormulaTerm(()), *(FormulaTerm((factor,)) for factor in factors)]
    terms += [FormulaTerm((a, b)) for a in own for b in factors if a != b]
    return list({_key(term): term for term in reversed(terms)}.values())[::-1]


def _key(term: FormulaTerm) -> frozenset[Factor]:
    return frozenset(term.factors)
