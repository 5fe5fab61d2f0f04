"""Damping, dry friction, rotors and springs that a model file states, as effects of a model.

Files state them at joints; effects act at actuators. Where one actuator moves a joint by a constant
ratio J, damping, rotor inertia and stiffness are J² there, and dry friction |J|. Where several do,
or the ratio changes, no effect at an actuator is the same: the term is left out, which a note says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from geodrake.effects import catalogue
from geodrake.effects.fitted_effect import FittedEffect
from geodrake.inertia import Array
from geodrake.model.file_terms import Drag, Spring
from geodrake.robot.plant import LoadedPlant
from geodrake.robot.transmission.actuation import Actuation

_LEAST = 1e-100  # SI units: less counts as zero, as its square has no inverse
_WEIGHTS: dict[str, Callable[[Array], Array]] = {"dry friction": np.abs}


def stated_effects(
    loaded: LoadedPlant, joints: Sequence[str], names: Sequence[str], actuation: Actuation | None
) -> tuple[list[FittedEffect], list[str]]:
    """The effects, and notes on them.

    Args:
        loaded: The plant of a model file, and what the file says of friction, damping and rotors.
        joints: Names of the velocities of its tree, without followers.
        names: Names of the model's velocities.
        actuation: How the former follow from the latter; None if they are the same.
    """
    effects, notes = list[FittedEffect](), list[str]()
    for kind in catalogue():
        stated = loaded.stated.get(kind.stated_as, np.zeros(len(joints)))
        values, lost = _at_actuators(stated, actuation, _WEIGHTS.get(kind.stated_as, np.square))
        notes += _lost_notes(kind.stated_as, [joints[at] for at in lost])
        values = _without_negligible(values, kind.stated_as, names, notes)
        found = [(name, value) for name, value in zip(names, values, strict=True) if value]
        for name, value in found:
            effects += [FittedEffect(each, np.array([value])) for each in kind.shaped(name)]
        if found:
            listed = ", ".join(f"{name} {value:g}" for name, value in found)
            notes.append(f"The {kind.stated_as} in the file ({listed}) is kept as {kind.name}.")
    for exponent, stated in zip((2.0, 3.0), loaded.file_powers, strict=True):
        what = f"damping of the power {exponent:g}"
        weight = partial(_power, exponent=exponent + 1.0)
        values, lost = _at_actuators(stated, actuation, weight)
        notes += _lost_notes(what, [joints[at] for at in lost])
        for name, value in zip(names, values.tolist(), strict=True):
            if value:
                drag = Drag(name, exponent=exponent)
                effects.append(FittedEffect(drag, np.array([value])))
                notes.append(f"The {what} in the file ({name} {value:g}) is kept as {drag.name}.")
    stiffness, rest, cubic, rest_3 = loaded.file_springs
    values, lost = _at_actuators(stiffness, actuation, np.square)
    if actuation is not None:  # Σ J² k (q − c)² / 2 of several springs is one about their mean
        moments, _ = actuation.joined(stiffness * (rest - actuation.offsets), lambda J: J)
        rest = moments / np.where(values > 0.0, values, 1.0)
    notes += _lost_notes("spring", [joints[at] for at in lost])
    values = _without_negligible(values, "spring", names, notes)
    for name, value, center in zip(names, values.tolist(), rest.tolist(), strict=True):
        if value:
            spring = Spring(name, center=center)
            effects.append(FittedEffect(spring, np.array([value, 0.0])))
            notes.append(f"The spring in the file ({name} {value:g}) is kept as {spring.name}.")
    values, lost = _at_actuators(cubic, actuation, lambda J: J**4)
    if actuation is not None:
        moments, _ = actuation.joined(cubic * (rest_3 - actuation.offsets), lambda J: J**3)
        rest_3 = moments / np.where(values != 0.0, values, 1.0)
    notes += _lost_notes("cubic spring", [joints[at] for at in lost])
    for name, value, center in zip(names, values.tolist(), rest_3.tolist(), strict=True):
        if value:
            spring = Spring(name, exponent=3, center=center)
            effects.append(FittedEffect(spring, np.array([value, 0.0])))
            notes.append(f"The cubic spring in the file ({name} {value:g}) is kept.")
    return effects, notes


def _power(J: Array, exponent: float) -> Array:
    return np.abs(J) ** exponent


def _without_negligible(values: Array, what: str, names: Sequence[str], notes: list[str]) -> Array:
    """Return values with zeros for negligible ones, which a note tells."""
    small = (values != 0.0) & (np.abs(values) < _LEAST)
    if small.any():
        pairs = zip(names, values, small, strict=True)
        listed = ", ".join(f"{name} {value:g}" for name, value, is_small in pairs if is_small)
        notes.append(f"The {what} in the file ({listed}) is negligible, and counts as 0.")
    return np.where(small, 0.0, values)


def _at_actuators(
    values: Array, actuation: Actuation | None, weight: Callable[[Array], Array]
) -> tuple[Array, list[int]]:
    return (values, []) if actuation is None else actuation.joined(values, weight)


def _lost_notes(what: str, joints: Sequence[str]) -> list[str]:
    if not joints:
        return []
    return [
        f"The {what} in the file of {', '.join(joints)} is left out: behind the transmission, no "
        "effect at an actuator is the same."
    ]
