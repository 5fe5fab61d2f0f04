"""Terms that a formula may contain."""

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
"""Initial constants of piecewise functions, as shares of the range of a position."""


def vocabulary(
    joint: str,
    joints: Sequence[str],
    reach: Mapping[str, tuple[float, float]] | None = None,
) -> list[FormulaTerm]:
    """Return the terms for the effort of a joint: functions of one signal, and products of two.

    Args:
        reach: Joint -> least and greatest position in the logs, rad or m. Without it, only the most
            common terms are returned: enough to see quickly what an error varies with.

    Returns:
        Distinct terms, a constant first.
    """
    signals, own_signals = (_ANY, _OWN) if reach else (_FEW, _FEW_OWN)
    own_factors = [Factor(joint, signal, function) for signal, function in own_signals]
    factors = [Factor(name, signal, function) for name in joints for signal, function in signals]
    for least, greatest, name in ((*ends, name) for name, ends in (reach or {}).items()):
        for share in TURNS:
            constant = float(least + share * (greatest - least))
            factors += [Factor(name, "q", side, constant) for side in ("above", "below")]
    terms = [FormulaTerm(()), *(FormulaTerm((factor,)) for factor in (*own_factors, *factors))]
    terms += [FormulaTerm((a, b)) for a in own_factors for b in factors if a != b]
    plain = [Factor(name, signal) for name in joints for signal in _MIXED if reach]
    terms += [FormulaTerm(pair) for pair in combinations(plain, 2)]
    return list({frozenset(term.factors): term for term in reversed(terms)}.values())[::-1]
