"""Effects that are to be distinguished: where they are, which shapes they may have, how large."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from geodrake.boundary.arguments import instance, instances
from geodrake.boundary.showing import Short
from geodrake.effects import Effect, effect_class, make_effect
from geodrake.effects.user_effects import candidates_of
from geodrake.errors import ArgumentError
from geodrake.excitation.effect_sizes import sized_effects
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.target import Target
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rival(Short):
    """One of two effects that are to be distinguished.

    Attributes:
        alternatives: For each shape that it may have, the effect at each of its places.
    """

    name: str
    alternatives: tuple[tuple[Effect, ...], ...]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All of them."""
        return tuple(effect for alternative in self.alternatives for effect in alternative)


def make_rival(
    name: str,
    model: RobotModel,
    limits: MotionLimits,
    *,
    where: Sequence[str] = (),
    shape: Mapping[str, Any] | None = None,
    extra: Sequence[type[Effect]] = (),
) -> Rival:
    """An effect by name, at a place or wherever it can be.

    Args:
        model: The robot; an effect that it has keeps its shape.
        limits: Whose speeds the shapes scale with that a diagnosis would try.
        where: One place; all joints, or pairs of joints, if empty.
        shape: Shape parameters by name. If it is None, those of the model, else the defaults, else
            all that a diagnosis would try.

    Raises:
        ArgumentError: There is no such effect, place or shape, or it has no parameters.
    """
    instance(model, "model", RobotModel)
    instance(limits, "limits", MotionLimits)
    where = instances(where, "where", str)
    cls = effect_class(name, extra)
    if not getattr(cls, "parameters", ()):
        raise ArgumentError(
            f"{name} has no linear parameters, so that no motion is better for it than another.",
            advice="Let geodrake diagnose find it.",
        )
    places = [tuple(where)] if where else _places(cls, model)
    speed = dict(zip(model.joints, limits.velocity.tolist(), strict=True))
    known = {(f.effect.name, f.effect.where): f.effect for f in model.effects}
    per_place: list[tuple[Effect, ...]] = []
    for place in places:
        if shape is None and (name, place) in known:
            per_place.append((known[name, place],))
            continue
        _check_place(cls, place, model)
        try:
            per_place.append((make_effect(name, place, shape, extra),))
        except ArgumentError:
            if shape is not None or cls.places != "joint":
                raise
            per_place.append(candidates_of(cls, place[0], speed[place[0]]))
    most = max(len(effects) for effects in per_place)
    every = [effects * most if len(effects) == 1 else effects for effects in per_place]
    if any(len(effects) != most for effects in every):
        raise ArgumentError(
            f"{name} has other shapes at some joints than at others.",
            advice=f"Ask for one joint at a time, such as {name}@{places[0][0]}.",
        )
    return Rival(name, tuple(zip(*every, strict=True)))


def known_sizes(model: RobotModel, effects: Sequence[Effect]) -> dict[Effect, Array]:
    """Parameters of those effects that the model has, unless they are zero."""
    values = {fitted.effect: fitted.parameters for fitted in model.effects}
    return {e: values[e] for e in effects if e in values and np.any(values[e])}


def imitations(target: Target, truth: Effect, size: Array, rival: Effect) -> Array | None:
    """(k,) parameters with which a rival is most like an effect of known size, on random motion.

    None if the effects have nothing to do with each other.

    Args:
        rival: The effect that imitates it within the bounds of its parameters.
    """
    seen = target.measure(target.random_motion).seen
    if seen is None:
        return None
    wanted = (truth.regressor(seen) @ size).ravel()
    columns = rival.regressor(seen).reshape(len(wanted), -1)
    bounds = tuple(np.array([getattr(p, s) for p in rival.parameters]) for s in ("lower", "upper"))
    found = np.asarray(lsq_linear(columns, wanted, bounds).x)
    return found if np.linalg.norm(columns @ found) > _ALIKE * np.linalg.norm(wanted) else None


def typical_sizes(target: Target) -> dict[Effect, Array]:
    """Parameters of a target's effects, those without values as large as such effects are."""
    return {fitted.effect: fitted.parameters for fitted in sized_effects(target)}


_ALIKE = 0.1  # share of an effect's effort that an imitation must have


def _places(cls: type[Effect], model: RobotModel) -> list[tuple[str, ...]]:
    if cls.places == "robot":
        return [()]
    if cls.places == "joint":
        left_out = model.sliding_joints if cls.turning_only else ()
        return [(joint,) for joint in model.single_joints if joint not in left_out]
    if cls.places == "joint_pair":
        return list(model.joint_pairs)
    raise ArgumentError(
        f"{cls.name} cannot be everywhere.",
        advice=f"Say on which body it is: {cls.name}@{model.bodies[-1]}.",
    )


def _check_place(cls: type[Effect], place: Sequence[str], model: RobotModel) -> None:
    known = model.bodies if cls.places == "body" else model.joints
    for name in place:
        if name not in known:
            raise ArgumentError(
                f"There is no {'body' if cls.places == 'body' else 'joint'} {name!r}.",
                advice=f"There are: {', '.join(known)}.",
            )
