"""The manifold of all parameters of a robot: its bodies, and then its effects."""

from __future__ import annotations

from collections.abc import Mapping

from geodrake.boundary.arguments import instance, positive
from geodrake.errors import ArgumentError
from geodrake.manifolds import Manifold, PhysicalInertia, Product
from geodrake.model.robot_model import RobotModel


def parameter_manifold(
    model: RobotModel,
    *,
    body_weight: float = 1.0,
    effect_weight: float = 1.0,
    weights: Mapping[str, float] | None = None,
    bodies: Mapping[str, Manifold] | None = None,
) -> Product:
    """The manifold of a parameter vector [φ, μ], as `ControlModel` has it.

    Args:
        model: The robot.
        body_weight: Weight w of every body's barrier. Twice the weight is half the speed.
        effect_weight: Weight w of every effect's barrier; [Lee2019] §5.6 has ½ for friction.
        weights: Weights of single bodies or of kinds of effects by name, instead of those.
        bodies: Manifolds of single bodies by name, such as a `ConstrainedInertia`; the others are
            `PhysicalInertia`.

    Raises:
        ArgumentError: There is no such body or effect, or a manifold is not one of a body.
    """
    instance(model, "model", RobotModel)
    positive(body_weight, "body_weight")
    positive(effect_weight, "effect_weight")
    weights = dict(instance(weights or {}, "weights", Mapping))
    bodies = dict(instance(bodies or {}, "bodies", Mapping))
    names = {fitted.effect.name for fitted in model.effects}
    unknown = (set(weights) - names | set(bodies)) - set(model.bodies)
    if unknown:
        raise ArgumentError(
            f"There is no {', '.join(sorted(unknown))} in the robot.",
            advice=f"It has {', '.join((*model.bodies, *sorted(names)))}.",
        )
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
