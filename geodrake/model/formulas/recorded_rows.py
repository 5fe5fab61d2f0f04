"""Columns of effects as formulas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from geodrake.effects import Effect, RobotMotion
from geodrake.effects.base import BEYOND_MOTION
from geodrake.effects.column_checks import line_of
from geodrake.errors import ArgumentError, ModelError
from geodrake.model.formulas.symbols import Formulas


def recorded_rows(
    effect: Effect, motion: RobotMotion, *, with_past: bool = True
) -> Mapping[str, Formulas]:
    """Return columns (k,) of an effect in symbols, by joint.

    Args:
        motion: One sample of symbols; with time and hidden states where it has any.
        with_past: Whether the sample has these; without, the effect is as if it had settled.

    Raises:
        ModelError: It does not compute them by NumPy's functions alone.
    """
    with_past = with_past and bool(effect.depends_on & BEYOND_MOTION)
    try:
        found: Any = (effect.rows if with_past else effect.formula_rows)(motion)
        count = len(effect.parameters)
        return {joint: np.asarray(x, object).reshape(count) for joint, x in found.items()}
    except Exception as error:  # whatever NumPy says of symbols
        line = line_of(type(effect), "columns", "rows", "formula_rows")
        problem = error.problem if isinstance(error, ArgumentError) else str(error)
        raise ModelError(
            f"{effect.name} of {effect.place} is known for numbers only{line}, without "
            f"derivatives, symbols and source code: {problem}",
            advice=getattr(error, "advice", None)
            or "Let it use functions of NumPy's on whole arrays, or define formula_rows.",
        ) from error
