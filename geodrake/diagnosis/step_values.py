"""Names, values and standard deviations of what was fitted, as steps tell them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.delay import fine_delays, later
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.inertia import to_mass_com_inertia
from geodrake.model import FittedEffect

Array = NDArray[np.float64]
Values = dict[str, dict[str, float]]


def told_parameters(fitted: FittedEffect) -> tuple[dict[str, float], dict[str, float]]:
    """Values and standard deviations of an effect's parameters and shape by name, SI units.

    A payload is told by its mass and centre of mass.
    """
    spread = (
        fitted.deviations
        if fitted.deviations is not None
        else np.full(len(fitted.parameters), np.nan)
    )
    if fitted.effect.name == "payload":
        mass, com, _ = to_mass_com_inertia(fitted.parameters)
        # To first order of the deviations, those of mass and moment taken as independent.
        com_spread = np.hypot(spread[1:4], com * spread[0]) / mass
        values = {
            "mass": float(mass),
            **{f"com_{a}": float(c) for a, c in zip("xyz", com, strict=True)},
        }
        deviations = {f"com_{a}": float(d) for a, d in zip("xyz", com_spread, strict=True)}
        return values, {"mass": float(spread[0]), **deviations}
    names = [p.name for p in fitted.effect.parameters]
    values = dict(zip(names, map(float, fitted.parameters), strict=True))
    shapes = fitted.effect.told_shape.items()
    values |= {k: float(v) for k, v in shapes if v is not None and k != "log"}
    return values, dict(zip(names, map(float, spread), strict=True))


def late_joints(joints: Sequence[str], start: Hypothesis, end: Hypothesis) -> tuple[str, ...]:
    """Joints that are late alone at the end of a search; none where all are alike."""
    return tuple(joints[late[0]] for late in later(start, end) if len(late) == 1)


def told_delays(
    joints: Sequence[str], start: Hypothesis, end: Hypothesis, delays: Array
) -> tuple[Values, Values]:
    """Delays that a search found and their deviations, s, by joint or that of all joints.

    Args:
        joints: Names of the joints.
        start: Where the search began.
        end: Where it ended.
        delays: (nv,) delays of the fitted model, s.
    """
    late = later(start, end)
    _, spread = fine_delays(end, late)
    at = {"all joints" if len(some) > 1 else joints[some[0]]: some[0] for some in late}
    values = {place: {"delay": float(delays[j])} for place, j in at.items()}
    return values, {place: {"delay": float(spread[j])} for place, j in at.items()}
