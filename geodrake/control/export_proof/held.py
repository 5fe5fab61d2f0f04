"""Parts of a model that a file can hold; the rest is fitted into them, or left out and named."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from geodrake.effects import Effect, FittedEffect, RobotMotion, Role
from geodrake.effects.file_terms import Damping, DryFriction, Offset, Rotor, Spring, Tilt
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Holds = Callable[[Effect], bool]

Basis = Damping | DryFriction | Rotor
_BASES: tuple[type[Basis], ...] = (Damping, DryFriction, Rotor)
"""Effects into which others are fitted."""

_WORTH = 0.1  # share of the square of an effect that its approximation must take away


@dataclass(frozen=True)
class Lost:
    """An effect that a format cannot hold as it is."""

    effect: str
    where: tuple[str, ...]  # joints or bodies
    # Names of the effects that stand in its place, fitted to it; none if it is left out.
    into: tuple[str, ...]
    # Error of logs with it approximated or left out, and all else as it is; None if unknown.
    nrms: float | None = None


def held_by(
    model: RobotModel,
    holds: Holds,
    motions: Sequence[Motion],
    *,
    keep: Holds = lambda effect: False,
) -> tuple[RobotModel, tuple[Lost, ...]]:
    """Return the model that a format can hold and that is nearest to a model on some motion.

    With it comes what it is without.

    Effects of a kind at a joint become one. What the format cannot hold is approximated at each
    joint by least squares over the motion: friction that depends on load or direction, or that
    falls with speed, by damping and Coulomb friction, and inertia that couples joints by that of
    rotors. All these stay positive. What a drive does is left out: nothing passive pushes.

    Args:
        keep: Which effects stay although the format does not hold them, to see what others cost.
    """
    kept, lost = list[FittedEffect](), list[FittedEffect]()
    sprung = {
        fitted.effect.where
        for fitted in model.effects
        if isinstance(fitted.effect, Spring)
        and fitted.effect.exponent == 1
        and fitted.parameters[0] > 0
        and holds(fitted.effect)
    }
    for fitted in model.effects:
        effect = fitted.effect
        stays = holds(effect) or keep(effect) or effect.role in (Role.BODY, Role.INERTIA)
        if isinstance(effect, Offset) and not stays and effect.where in sprung:
            of_spring = np.array([0.0, fitted.parameters[0]])
            kept.append(FittedEffect(Spring(effect.joint), of_spring))
        else:
            (kept if stays else lost).append(fitted)
    merged, into = _merged(kept), dict[Effect, tuple[str, ...]]()
    bases = [kind for kind in _BASES if holds(kind(model.joints[0]))]
    if bases and motions:
        seen = [model.motion(motion) for motion in motions]
        for joint in model.single_joints:
            changed, named = _stand_ins(joint, lost, merged, seen, bases)
            merged |= changed
            for effect, names in named.items():
                into[effect] = tuple(dict.fromkeys([*into.get(effect, ()), *names]))
    effects = tuple(fitted for fitted in merged.values() if fitted.effect.role is not Role.INERTIA)
    return replace(model, effects=effects, information=None), _named(lost, into)


def _merged(effects: Sequence[FittedEffect]) -> dict[Effect, FittedEffect]:
    """Merge effects that differ only in their parameters; springs also in their rest."""
    found: dict[Effect, FittedEffect] = {}
    for fitted in effects:
        effect, values = fitted.effect, fitted.parameters
        if isinstance(effect, Spring) and effect.exponent == 1:
            values = values - [0.0, values[0] * effect.center]
            effect = Spring(effect.joint)
        if isinstance(effect, Tilt):  # exact, as simulators turn gravity
            effect = Tilt(*values.tolist())
        before = found.get(effect)
        if before is not None and len(values):
            values = values + before.parameters
        found[effect] = FittedEffect(effect, values)
    for effect, fitted in [*found.items()]:
        if isinstance(effect, Spring) and effect.exponent == 1:
            del found[effect]
            stiffness, preload = fitted.parameters.tolist()
            if stiffness > 0.0:
                rest = replace(effect, center=-preload / stiffness)
                found[rest] = FittedEffect(rest, np.array([stiffness, 0.0]))
    return found


def _stand_ins(
    joint: str,
    lost: Sequence[FittedEffect],
    held: Mapping[Effect, FittedEffect],
    seen: Sequence[RobotMotion],
    bases: Sequence[type[Basis]],
) -> tuple[dict[Effect, FittedEffect], dict[Effect, tuple[str, ...]]]:
    """Return held effects of a joint that are changed so that they stand for what is lost.

    Returns:
        They; and by each effect that is lost, the names of those that stand for it.
    """
    at = seen[0].index(joint)
    wanted = {
        fitted.effect: np.concatenate(
            [fitted.effect.effort(motion, fitted.parameters)[:, at] for motion in seen]
        )
        for fitted in lost
        if fitted.effect.role is Role.FORCE
        and fitted.effect.depends_on & {"v", "vd"}
        and not fitted.effect.by_drive
    }
    wanted = {effect: effort for effect, effort in wanted.items() if effort.any()}
    signals = frozenset[str]().union(*(effect.depends_on for effect in wanted))
    used = [kind(joint) for kind in bases if kind.depends_on <= signals]
    if not wanted or not used:
        return {}, {}
    joints = [motion.joint(joint) for motion in seen]
    A = np.array([np.concatenate([each.columns(j)[0] for j in joints]) for each in used], float).T
    b = np.sum([*wanted.values()], axis=0)
    have = np.array([held[e].parameters[0] if e in held else 0.0 for e in used])
    x = _bounded(A, b, have)
    if np.sum((A @ x - b) ** 2) > (1.0 - _WORTH) * np.sum(b**2):
        return {}, {}
    changed: dict[Effect, FittedEffect] = {
        effect: FittedEffect(effect, np.array([before + change]))
        for effect, before, change in zip(used, have.tolist(), x.tolist(), strict=True)
        if change
    }
    named = {
        effect: tuple(e.name for e in changed if e.depends_on <= effect.depends_on)
        for effect in wanted
    }
    return changed, named


def _bounded(A: Array, b: Array, have: Array) -> Array:
    """Return the x of least |A x − b| with have + x ≥ 0, columns scaled to one size."""
    size = np.linalg.norm(A, axis=0)
    usable = size > 0
    x = np.zeros(len(have))
    if usable.any():
        scaled, lower = A[:, usable] / size[usable], -(have * size)[usable]
        bounds = (np.minimum(lower, 0.0) - 1e-300, np.inf)
        x[usable] = lsq_linear(scaled, b, bounds=bounds, method="bvls").x / size[usable]
    return np.maximum(x, -have)


def _named(lost: Sequence[FittedEffect], into: dict[Effect, tuple[str, ...]]) -> tuple[Lost, ...]:
    """Return what is lost, the places of one effect together."""
    found: dict[str, Lost] = {}
    for fitted in lost:
        name = fitted.effect.name
        before = found.get(name, Lost(name, (), ()))
        where = dict.fromkeys([*before.where, *fitted.effect.where])
        names = dict.fromkeys([*before.into, *into.get(fitted.effect, ())])
        found[name] = Lost(name, tuple(where), tuple(names))
    return tuple(found.values())
