"""The manifold of a robot's parameters, and selections of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances, positive, typed
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.manifolds import Manifold, PhysicalInertia, Product
from geodrake.model.robot_model import RobotModel


@typed
def parameter_manifold(
    model: RobotModel,
    *,
    body_weight: float = 1.0,
    effect_weight: float = 1.0,
    weights: Mapping[str, float] | None = None,
    bodies: Mapping[str, Manifold] | None = None,
) -> Product:
    """Return the manifold of a parameter vector [φ, μ], in the order of `ControlModel`.

    Args:
        body_weight: Weight w of every body's barrier. Adaptation speed is proportional to 1/w.
        effect_weight: Weight w of every effect's barrier; [Lee2019] §5.6 uses ½ for friction.
        weights: Weights of single bodies or kinds of effects by name, which override these.
        bodies: Manifolds of single bodies by name, such as a `ConstrainedInertia`; the default is
            `PhysicalInertia`.
    """
    positive(body_weight, "body_weight")
    positive(effect_weight, "effect_weight")
    weights = dict(weights or {})
    bodies = dict(bodies or {})
    names = {fitted.effect.name for fitted in model.effects}
    _check_names(model, set(weights) - names | set(bodies), names)
    factors, factor_weights = [], []
    for body in model.bodies:
        factor = instance(bodies.get(body, PhysicalInertia()), f"bodies[{body!r}]", Manifold)
        if factor.dimension != PhysicalInertia().dimension:
            raise ArgumentError(
                f"The manifold of body {body!r} has {factor.dimension} coordinates instead of ten."
            )
        factors.append(factor)
        factor_weights.append(weights.get(body, body_weight))
    for fitted in model.effects:
        if fitted.effect.parameters:
            factors.append(fitted.effect.manifold)
            factor_weights.append(weights.get(fitted.effect.name, effect_weight))
    return Product(tuple(factors), tuple(factor_weights))


def adapted_parameters(model: RobotModel, names: Sequence[str]) -> NDArray[np.bool_]:
    """Return which of a robot's parameters [φ, μ] belong to some bodies and effects.

    Args:
        names: Bodies and effects, by name.

    Returns:
        (p,) booleans, for a `PartialLaw`.
    """
    instance(model, "model", RobotModel)
    selected = set([names] if isinstance(names, str) else instances(names, "names", str))
    kinds = {fitted.effect.name for fitted in model.effects if fitted.effect.parameters}
    _check_names(model, selected - kinds, kinds)
    if not selected:
        raise ArgumentError("names must have at least one parameter to adapt.")
    adapted = [body in selected for body in model.bodies for _ in range(PARAMETERS_PER_BODY)]
    for fitted in model.effects:
        adapted += [fitted.effect.name in selected] * len(fitted.effect.parameters)
    return np.array(adapted)


def _check_names(model: RobotModel, bodies: set[str], effects: set[str]) -> None:
    """Raise if `bodies` are not in the model; `effects` are other valid names."""
    if unknown := bodies - set(model.bodies):
        raise ArgumentError(
            f"The robot has no {', '.join(sorted(map(str, unknown)))}.",
            advice=f"It has {', '.join((*model.bodies, *sorted(effects)))}.",
        )
