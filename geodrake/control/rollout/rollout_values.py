"""Values of a model that its simulated motion shows, as its effects declare them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from geodrake.effects import FittedEffect
from geodrake.effects.deflection import DeflectionEffect, Give
from geodrake.errors import ModelError
from geodrake.model.robot_model import RobotModel


@dataclass(frozen=True)
class RolloutValue:
    """One positive value of an effect.

    Attributes:
        at: Which of the model's effects has it.
        effect: Name of the effect.
        joint: Its joint.
        name: Name of the value, of a parameter or a shape of the effect.
        value: The value, SI.
    """

    at: int
    effect: str
    joint: str
    name: str
    value: float


def rollout_values(model: RobotModel) -> tuple[RolloutValue, ...]:
    """What of a model its simulated motion shows, and efforts hardly do.

    Args:
        model: The model.

    Raises:
        ModelError: There is nothing.
    """
    found = []
    for at, fitted in enumerate(model.effects):
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect):
            values = effect.rollout_values(fitted.parameters).items()
            found += [RolloutValue(at, effect.name, effect.joint, *each) for each in values]
    if not found:
        raise ModelError(
            "The model has no soft joint and no play, which are what rollouts fit.",
            advice="Find them first: geodrake explain MODEL LOG… --save FILE.yaml.",
        )
    return tuple(found)


def with_values(
    model: RobotModel,
    values: Sequence[RolloutValue],
    new: Sequence[float],
    deviations: Sequence[float],
) -> RobotModel:
    """The model with other values.

    Args:
        model: The model.
        values: Its values.
        new: As many new ones.
        deviations: Their standard deviations.
    """
    effects = list(model.effects)
    for at in sorted({value.at for value in values}):
        own = [k for k, value in enumerate(values) if value.at == at]
        effect = effects[at].effect
        if isinstance(effect, DeflectionEffect):
            given = {values[k].name: float(new[k]) for k in own}
            unsure = {values[k].name: float(deviations[k]) for k in own}
            effects[at] = effect.with_rollout_values(given, unsure)
    return replace(model, effects=tuple(effects))


def giving_way(effects: Sequence[FittedEffect]) -> dict[str, Give]:
    """Joint -> how far its link moves against its motor, of joints that are soft.

    Args:
        effects: The effects of a model.
    """
    found: dict[str, Give] = {}
    for fitted in effects:
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect):
            found[effect.joint] = found.get(effect.joint, Give()) + effect.give(fitted.parameters)
    return found
