"""Names, values and standard deviations of what was fitted, as steps tell them."""

from __future__ import annotations

import numpy as np

from geodrake.inertia import to_mass_com_inertia
from geodrake.model import FittedEffect


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
