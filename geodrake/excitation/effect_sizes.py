"""How large effects of unknown parameters are thought to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import FittedEffect
from geodrake.excitation.target import Target

Array = NDArray[np.float64]

SIZE_WORDS = "a tenth of the load, or 2 % of the limit of effort where that is more"
_SHARE = 0.02  # of the limit of effort


def sized_effects(target: Target) -> tuple[FittedEffect, ...]:
    """The effects of a target, those without values as large as such effects usually are.

    Friction is there however light a load is, so that the load alone does not give its size.

    Args:
        target: Its effects with parameters of zero are those of unknown size.

    Returns:
        The effects in the target's order, payloads as they are.
    """
    limits = target.model.effort_limits
    X = target.measure(target.random_motion).regressor[:, :, len(target.columns) :]
    acting = np.sqrt(np.mean(np.square(X), axis=0))  # (nv, k)
    wanted = _SHARE * np.where(np.isfinite(limits), limits, 0.0)[:, None]
    least = np.where(acting > 0, wanted / np.where(acting > 0, acting, 1.0), np.inf).min(axis=0)
    sizes = np.maximum(target.effect_sizes, np.where(np.isfinite(least), least, 0.0))
    found, at = [*target.payloads], 0
    for fitted in target.further:
        count = len(fitted.parameters)
        values = np.where(fitted.parameters, fitted.parameters, sizes[at : at + count])
        found.append(FittedEffect(fitted.effect, values))
        at += count
    return tuple(found)
