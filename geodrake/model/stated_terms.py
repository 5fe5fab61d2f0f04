"""What a model file states of joints, tendons, weights and a medium, as effects of a model.

Files state joints' terms at joints; effects act at actuators. Where one actuator moves a joint by a
constant ratio J, damping, rotor inertia and stiffness are J² there, and dry friction |J|. Where
several do, or the ratio changes, as in a closed loop, the effect stays at the joint, τ_q = Jᵀ τ_θ.
A tendon's energy ½ k (Σ cᵢ qᵢ − L₀)² is that of a spring at each joint, and of a coupling of each
two; damping and inertia likewise.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from geodrake.effects.base import Effect, FittedEffect
from geodrake.inertia import Array
from geodrake.model.file_terms import (
    Carried,
    CoupledDry,
    CoupledRotor,
    Coupling,
    Damping,
    Drag,
    DryFriction,
    Medium,
    Polynomial,
    Rotor,
    Spring,
    StrutEffect,
)
from geodrake.robot import stated
from geodrake.robot.plant import LoadedPlant
from geodrake.robot.transmission.actuation import Actuation

_LEAST = 1e-100  # SI units: less counts as zero, as its square has no inverse
_DAMPING, _FRICTION, _ROTOR = "damping", "dry friction", "reflected rotor inertia"
_KINDS: Mapping[str, Callable[[str], Effect]] = {
    _DAMPING: Damping,
    _FRICTION: DryFriction,
    _ROTOR: Rotor,
}
_WEIGHTS: Mapping[str, Callable[[Array], Array]] = {_FRICTION: np.abs}
Placed = tuple[str, Effect, Sequence[float]]
"""Where an effect is, in words, the effect, and its values."""


@dataclass
class StatedEffects:
    """Effects that a file states.

    Attributes:
        notes: Sentences on what they are of.
        left_out: Sentences on what no effect is.
    """

    effects: list[FittedEffect] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def keep(self, what: str, found: Sequence[Placed]) -> None:
        """Add effects with values, and a note on them.

        Args:
            found: Place, effect and values of each.
        """
        for _, effect, values in found:
            self.effects.append(FittedEffect(effect, np.array(values, float)))
        if found:
            listed = ", ".join(
                f"{place} {' '.join(f'{value:g}' for value in values if value)}"
                for place, _, values in found
            )
            kept = found[0][1].name
            self.notes.append(f"The {what} in the file ({listed}) is kept as {kept}.")


def stated_effects(
    loaded: LoadedPlant, joints: Sequence[str], names: Sequence[str], actuation: Actuation | None
) -> StatedEffects:
    """Return the effects, and notes on them.

    Args:
        loaded: The plant of a model file, and what the file says beside it.
        joints: Names of the velocities of its tree, without followers.
        actuation: How the former follow from the latter; None if they are the same.
    """
    found = StatedEffects()
    places = _Places(joints, names, actuation, loaded.closing)
    values = {
        what: places.of(own, what, _WEIGHTS.get(what, np.square))
        for what, own in loaded.stated.items()
    }
    rows, shifts = _rows(joints, names, actuation)
    springs = dict[str, stated.Spring]()
    for at, spring in loaded.file_springs.items():
        for to, ratio in rows[at].items():
            _add(springs, to, spring.through(ratio, shifts.get(at, 0.0)))
    for joint, of_loop in loaded.closing.items():
        _add(springs, joint, stated.Spring.linear(of_loop.get("spring", 0.0), of_loop["rest"]))
    entries = ((i, j, x) for (i, j), x in loaded.file_inertias.items())
    inertias = stated.entries_through(entries, rows)
    for name in [name for name, other in inertias if name == other]:
        values[_ROTOR][name] = values[_ROTOR].get(name, 0.0) + inertias.pop((name, name))
    tendons = [each.through(rows, shifts) for each in loaded.file_tendons]
    across = _across(tendons, values, springs, inertias, names)
    for what, kind in _KINDS.items():
        if what in values:
            single = _without_negligible(values[what], what, found.notes)
            found.keep(what, [(n, kind(n), [x]) for n, x in single.items()])
    for exponent, of_power in zip((2.0, 3.0), loaded.file_powers, strict=True):
        what = f"damping of the power {exponent:g}"
        single = places.of(of_power, what, partial(_power, exponent=exponent + 1.0))
        found.keep(what, [(n, Drag(n, exponent=exponent), [x]) for n, x in single.items() if x])
    _keep_springs(springs, found)
    for what, placed in across.kept.items():
        found.keep(what, placed)
    found.left_out += across.lost
    found.keep(
        "carried weight",
        [(w.body, Carried(w.body, *w.place.tolist()), [w.mass]) for w in loaded.file_weights],
    )
    struts = []
    for strut in loaded.file_struts:
        effect = StrutEffect(strut.bodies, *strut.points[0].tolist(), *strut.points[1].tolist())
        numbers = [strut.stiffness, -strut.stiffness * strut.length, strut.damping]
        struts.append((effect.place, effect, numbers))
    found.keep("tendon", struts)
    found.keep("medium", [(b.body, _drag(b), [b.density, b.viscosity]) for b in loaded.file_boxes])
    return found


@dataclass(frozen=True)
class _Places:
    """Where what is stated of the tree's joints acts in the model.

    Attributes:
        joints: Names of the velocities of the tree.
        names: Names of the model's velocities.
        actuation: How the former follow from the latter.
        closing: Joint that closes a loop -> what is stated of it.
    """

    joints: Sequence[str]
    names: Sequence[str]
    actuation: Actuation | None
    closing: Mapping[str, Mapping[str, float]]

    def of(self, own: Array, what: str, weight: Callable[[Array], Array]) -> dict[str, float]:
        """Return actuator or joint -> its coefficient, of those (nv of the tree,) of the joints."""
        values, lost = own, list[int]()
        if self.actuation is not None:
            values, lost = self.actuation.joined(own, weight)
        found = dict(zip(self.names, values.tolist(), strict=True))
        for at in lost:
            found[self.joints[at]] = found.get(self.joints[at], 0.0) + float(own[at])
        return found | {joint: each.get(what, 0.0) for joint, each in self.closing.items()}


def _keep_springs(springs: Mapping[str, stated.Spring], found: StatedEffects) -> None:
    simple = [(n, s) for n, s in springs.items() if _is_simple(s) and any(s.coefficients)]
    placed = [(n, Spring(n, center=s.center), s.coefficients[1::-1]) for n, s in simple]
    found.keep("spring", placed)
    others = [
        (n, Polynomial(n, s.center), s.coefficients)
        for n, s in springs.items()
        if not _is_simple(s)
    ]
    found.keep("spring", others)


def _add(springs: dict[str, stated.Spring], name: str, spring: stated.Spring) -> None:
    springs[name] = springs[name] + spring if name in springs else spring


def _is_simple(spring: stated.Spring) -> bool:
    """Return whether a spring is a linear one that pulls back."""
    _, stiffness, *powers = spring.coefficients
    return stiffness >= 0.0 and not any(powers)


def _rows(
    joints: Sequence[str], names: Sequence[str], actuation: Actuation | None
) -> tuple[dict[int, dict[str, float]], dict[int, float]]:
    """Return which actuator moves each velocity of the tree, by which constant ratio, from where.

    Where several do, or the ratio changes, that is the joint itself.

    Returns:
        Velocity -> name of the actuator, or of the joint -> ratio; and position with it at zero.
    """
    rows: dict[int, dict[str, float]] = {at: {name: 1.0} for at, name in enumerate(joints)}
    shifts = dict[int, float]()
    if actuation is not None:
        for at, unit in enumerate(np.eye(len(joints))):
            ratios, lost = actuation.joined(unit, lambda J: J)
            if not lost:
                rows[at] = {names[int(to)]: float(ratios[to]) for to in np.flatnonzero(ratios)}
                shifts[at] = float(actuation.offsets[at])
    return rows, shifts


@dataclass
class _Across:
    """What in the file tendons are between joints -> what is kept of it, and what is lost."""

    kept: dict[str, list[Placed]]
    lost: list[str]


def _across(
    tendons: Sequence[stated.Tendon],
    values: Mapping[str, dict[str, float]],
    springs: dict[str, stated.Spring],
    inertias: stated.Entries[str],
    names: Sequence[str],
) -> _Across:
    """Add what tendons are at each joint to values and springs; return what they are between them.

    Args:
        values: What in the file -> joint or actuator -> value; changed.
        springs: Joint or actuator -> spring; changed.
        inertias: What tendons are in the mass matrix between two joints.
    """
    couplings = defaultdict[tuple[str, str], Array](lambda: np.zeros(2))
    rubs = defaultdict[tuple[str, str, int], float](float)
    lost = list[str]()
    for tendon in tendons:
        shares = {name: share for name, share in tendon.shares.items() if share}
        k, length = tendon.stiffness, tendon.length
        for name, share in shares.items():
            values[_DAMPING][name] = values[_DAMPING].get(name, 0.0) + share**2 * tendon.damping
            if k:
                _add(springs, name, stated.Spring.linear(share**2 * k, length / share))
        for pair in combinations(sorted(shares), 2):
            both = shares[pair[0]] * shares[pair[1]]
            couplings[pair] += (both * k, both * tendon.damping)
        sizes, own = {abs(share) for share in shares.values()}, set(names).issuperset(shares)
        if tendon.friction and len(shares) == 1:
            (name,) = shares
            rubbing = values[_FRICTION].get(name, 0.0) + abs(shares[name]) * tendon.friction
            values[_FRICTION][name] = rubbing
        elif tendon.friction and len(shares) == 2 and len(sizes) == 1 and own:
            (i, first), (j, second) = sorted(shares.items())
            rubs[i, j, 1 if first == second else -1] += abs(first) * tendon.friction
        elif tendon.friction and shares:
            lost.append(
                f"The dry friction {tendon.friction:g} of {tendon.name}, over joints that pull it "
                "unequally, is left out."
            )

    def placed(make: Callable[..., Effect], found: Mapping[Any, Sequence[float]]) -> list[Placed]:
        every = [((i, j), sign, own) for (i, j, *sign), own in found.items()]
        return [(" & ".join(p), make(p, *sign), own) for p, sign, own in every if any(own)]

    kept = {
        "coupling by tendons": placed(Coupling, {p: own.tolist() for p, own in couplings.items()}),
        "rotor inertia of tendons": placed(CoupledRotor, {p: [x] for p, x in inertias.items()}),
        "dry friction of tendons": placed(CoupledDry, {p: [x, 0.0] for p, x in rubs.items()}),
    }
    return _Across(kept, lost)


def _drag(box: stated.BoxInMedium) -> Medium:
    turn = box.X_BP.rotation().ToQuaternion().wxyz()
    return Medium(box.body, *box.size, *box.X_BP.translation(), *turn, *box.wind)


def _power(J: Array, exponent: float) -> Array:
    return np.abs(J) ** exponent


def _without_negligible(
    values: Mapping[str, float], what: str, notes: list[str]
) -> dict[str, float]:
    """Return values without zeros and negligible ones, which a note tells."""
    small = {name: value for name, value in values.items() if 0.0 < abs(value) < _LEAST}
    if small:
        listed = ", ".join(f"{name} {value:g}" for name, value in small.items())
        notes.append(f"The {what} in the file ({listed}) is negligible, and counts as 0.")
    return {name: value for name, value in values.items() if value and name not in small}
