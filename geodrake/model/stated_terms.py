"""Damping, dry friction, rotors and springs that a model file states, as effects of a model.

Files state them at joints; effects act at actuators. Where one actuator moves a joint by a constant
ratio J, damping, rotor inertia and stiffness are J² there, and dry friction |J|. Where several do,
or the ratio changes, as in a closed loop, the effect stays at the joint, τ_q = Jᵀ τ_θ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
    places = _Places(joints, names, actuation, loaded.closing, notes)
    for kind in catalogue():
        stated = loaded.stated.get(kind.stated_as, np.zeros(len(joints)))
        found = places.of(stated, kind.stated_as, _WEIGHTS.get(kind.stated_as, np.square))
        for name, value in found.items():
            effects += [FittedEffect(each, np.array([value])) for each in kind.shaped(name)]
        if found:
            listed = ", ".join(f"{name} {value:g}" for name, value in found.items())
            notes.append(f"The {kind.stated_as} in the file ({listed}) is kept as {kind.name}.")
    for exponent, stated in zip((2.0, 3.0), loaded.file_powers, strict=True):
        what = f"damping of the power {exponent:g}"
        for name, value in places.of(
            stated, what, partial(_power, exponent=exponent + 1.0)
        ).items():
            drag = Drag(name, exponent=exponent)
            effects.append(FittedEffect(drag, np.array([value])))
            notes.append(f"The {what} in the file ({name} {value:g}) is kept as {drag.name}.")
    stiffness, rest, cubic, rest_3 = loaded.file_springs
    for what, exponent, k, center in (
        ("spring", 1, stiffness, rest),
        ("cubic spring", 3, cubic, rest_3),
    ):
        centers = places.centers(k, center, exponent)
        for name, value in places.of(k, what, partial(_power, exponent=exponent + 1)).items():
            spring = Spring(name, exponent=exponent, center=centers[name])
            effects.append(FittedEffect(spring, np.array([value, 0.0])))
            notes.append(f"The {what} in the file ({name} {value:g}) is kept as {spring.name}.")
    return effects, notes


class _Places:
    """Where what is stated of the tree's joints acts in the model; says what is negligible."""

    def __init__(
        self,
        joints: Sequence[str],
        names: Sequence[str],
        actuation: Actuation | None,
        closing: Mapping[str, Mapping[str, float]],
        notes: list[str],
    ) -> None:
        self.joints, self.names, self.actuation, self.notes = joints, names, actuation, notes
        self.closing = closing

    def of(self, stated: Array, what: str, weight: Callable[[Array], Array]) -> dict[str, float]:
        """Actuator or joint -> its coefficient, where it has one, of those (nv of the tree,)."""
        values, lost = stated, list[int]()
        if self.actuation is not None:
            values, lost = self.actuation.joined(stated, weight)
        found = dict(zip(self.names, values.tolist(), strict=True))
        for at in lost:
            found[self.joints[at]] = found.get(self.joints[at], 0.0) + float(stated[at])
        found |= {joint: stated.get(what, 0.0) for joint, stated in self.closing.items()}
        small = {name: value for name, value in found.items() if 0.0 < abs(value) < _LEAST}
        if small:
            listed = ", ".join(f"{name} {value:g}" for name, value in small.items())
            self.notes.append(f"The {what} in the file ({listed}) is negligible, and counts as 0.")
        return {name: value for name, value in found.items() if value and name not in small}

    def centers(self, k: Array, center: Array, exponent: int) -> dict[str, float]:
        """Actuator or joint -> where its spring k (q − c)^n rests, of those of joints.

        Several at an actuator, Σ Jⁿ⁺¹ k (q − c)², are one about their mean.
        """
        found = dict(zip(self.joints, center.tolist(), strict=True))
        found |= {joint: stated["rest"] for joint, stated in self.closing.items()}
        if self.actuation is not None:
            values, _ = self.actuation.joined(k, partial(_power, exponent=exponent + 1))
            shifted = k * (center - self.actuation.offsets)
            moments, _ = self.actuation.joined(shifted, lambda J: J**exponent)
            there = values != 0.0
            means = np.divide(moments, values, out=np.zeros_like(values), where=there)
            pairs = zip(self.names, means.tolist(), there, strict=True)
            found |= {name: mean for name, mean, is_there in pairs if is_there}
        return found


def _power(J: Array, exponent: float) -> Array:
    return np.abs(J) ** exponent
