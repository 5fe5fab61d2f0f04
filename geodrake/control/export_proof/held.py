"""The part of a model that a format can express; other effects are approximated or omitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from geodrake.control.export_proof.joints import POSITIVE_TERMS
from geodrake.effects import Effect, FittedEffect, JointEffect, RobotMotion, Role, catalogue
from geodrake.effects.file_terms import Offset, Spring, Tilt
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Holds = Callable[[Effect], bool]
"""Whether a format can express an effect."""

_LEAST_REDUCTION = 0.1  # of an effect's mean square, required of its approximation


@dataclass(frozen=True)
class Lost:
    """An effect that a format cannot express."""

    effect: str
    where: tuple[str, ...]  # joints or bodies
    into: tuple[str, ...]  # effects that approximate it; empty if it is omitted
    nrms: float | None = None  # error of logs if only this effect is lost; None if unknown


def held_by(
    model: RobotModel,
    holds: Holds,
    motions: Sequence[Motion],
    *,
    keep: Holds = lambda effect: False,
) -> tuple[RobotModel, tuple[Lost, ...]]:
    """Return the best approximation of a model that a format can express, and the lost effects.

    Effects of the same kind at a joint are merged. Other effects are approximated at each joint by
    least squares over the motion: friction that depends on load, direction or speed by damping and
    Coulomb friction, and inertial coupling by rotor inertia. These remain positive. Effects caused
    by a drive are omitted, as they are not passive.

    Args:
        keep: Effects to keep even if the format cannot express them, to compute the cost of others.
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
        is_kept = holds(effect) or keep(effect) or effect.role in (Role.BODY, Role.INERTIA)
        if isinstance(effect, Offset) and not is_kept and effect.where in sprung:
            preload = np.array([0.0, fitted.parameters[0]])
            kept.append(FittedEffect(Spring(effect.joint), preload))
        else:
            (kept if is_kept else lost).append(fitted)
    merged, into = _merged(kept), dict[Effect, tuple[str, ...]]()
    bases = [
        kind
        for kind in catalogue()
        if issubclass(kind, JointEffect)
        and kind.file_term.joint in POSITIVE_TERMS
        and holds(kind(model.joints[0]))
    ]
    if bases and motions:
        robot_motions = [model.motion(motion) for motion in motions]
        for joint in model.single_joints:
            changed, names_of = _approximations(joint, lost, merged, robot_motions, bases)
            merged |= changed
            for effect, names in names_of.items():
                into[effect] = tuple(dict.fromkeys([*into.get(effect, ()), *names]))
    effects = tuple(fitted for fitted in merged.values() if fitted.effect.role is not Role.INERTIA)
    return replace(model, effects=effects, information=None), _lost_effects(lost, into)


def _merged(effects: Sequence[FittedEffect]) -> dict[Effect, FittedEffect]:
    """Merge effects that differ only in their parameters, or springs in their rest position."""
    merged: dict[Effect, FittedEffect] = {}
    for fitted in effects:
        effect, values = fitted.effect, fitted.parameters
        if isinstance(effect, Spring) and effect.exponent == 1:
            values = values - [0.0, values[0] * effect.center]
            effect = Spring(effect.joint)
        if isinstance(effect, Tilt):  # expanded about its angles, as simulators rotate gravity
            effect = Tilt(*values.tolist())
        previous = merged.get(effect)
        if previous is not None and len(values):
            values = values + previous.parameters
        merged[effect] = FittedEffect(effect, values)
    for effect, fitted in [*merged.items()]:
        if isinstance(effect, Spring) and effect.exponent == 1:
            del merged[effect]
            stiffness, preload = fitted.parameters.tolist()
            if stiffness > 0.0:
                spring = replace(effect, center=-preload / stiffness)
                merged[spring] = FittedEffect(spring, np.array([stiffness, 0.0]))
    return merged


def _approximations(
    joint: str,
    lost: Sequence[FittedEffect],
    held: Mapping[Effect, FittedEffect],
    motions: Sequence[RobotMotion],
    bases: Sequence[type[JointEffect]],
) -> tuple[dict[Effect, FittedEffect], dict[Effect, tuple[str, ...]]]:
    """Return the basis effects of a joint, changed to approximate its lost effects.

    Returns:
        Changed effects; and for each lost effect, the names of those that approximate it.
    """
    index = motions[0].index(joint)
    efforts = {
        fitted.effect: np.concatenate(
            [fitted.effect.effort(motion, fitted.parameters)[:, index] for motion in motions]
        )
        for fitted in lost
        if fitted.effect.role is Role.FORCE
        and fitted.effect.depends_on & {"v", "vd"}
        and not fitted.effect.by_drive
    }
    efforts = {effect: effort for effect, effort in efforts.items() if effort.any()}
    signals = frozenset[str]().union(*(effect.depends_on for effect in efforts))
    basis = [kind(joint) for kind in bases if kind.depends_on <= signals]
    if not efforts or not basis:
        return {}, {}
    joints = [motion.joint(joint) for motion in motions]
    rows = [np.concatenate([effect.columns(j)[0] for j in joints]) for effect in basis]
    A, b = np.array(rows, float).T, np.sum([*efforts.values()], axis=0)
    values = np.array([held[e].parameters[0] if e in held else 0.0 for e in basis])
    x = _nonnegative_fit(A, b, values)
    if np.sum((A @ x - b) ** 2) > (1.0 - _LEAST_REDUCTION) * np.sum(b**2):
        return {}, {}
    changed: dict[Effect, FittedEffect] = {
        effect: FittedEffect(effect, np.array([value + change]))
        for effect, value, change in zip(basis, values.tolist(), x.tolist(), strict=True)
        if change
    }
    names_of = {
        effect: tuple(e.name for e in changed if e.depends_on <= effect.depends_on)
        for effect in efforts
    }
    return changed, names_of


def _nonnegative_fit(A: Array, b: Array, values: Array) -> Array:
    """Return the x that minimizes |A x − b| with values + x ≥ 0."""
    size = np.linalg.norm(A, axis=0)
    nonzero = size > 0
    x = np.zeros(len(values))
    if nonzero.any():
        scaled, lower = A[:, nonzero] / size[nonzero], -(values * size)[nonzero]
        bounds = (np.minimum(lower, 0.0) - 1e-300, np.inf)
        x[nonzero] = lsq_linear(scaled, b, bounds=bounds, method="bvls").x / size[nonzero]
    return np.maximum(x, -values)


def _lost_effects(
    lost: Sequence[FittedEffect], into: dict[Effect, tuple[str, ...]]
) -> tuple[Lost, ...]:
    """Return the lost effects, with all places of one kind together."""
    by_name: dict[str, Lost] = {}
    for fitted in lost:
        name = fitted.effect.name
        previous = by_name.get(name, Lost(name, (), ()))
        where = dict.fromkeys([*previous.where, *fitted.effect.where])
        names = dict.fromkeys([*previous.into, *into.get(fitted.effect, ())])
        by_name[name] = Lost(name, tuple(where), tuple(names))
    return tuple(by_name.values())
