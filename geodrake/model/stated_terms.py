"""What a model file states of joints, tendons, weights and a medium, as effects of a model.

Files state joints' terms at joints; effects act at actuators. Where one actuator moves a joint by a
constant ratio J, damping, rotor inertia and stiffness are J² there, and dry friction |J|. A joint
that several move is to them what a tendon Σ cᵢ qᵢ is to joints: its energy ½ k (Σ cᵢ qᵢ − L₀)² is
that of a spring at each, and of a coupling of each two; damping and inertia likewise. Where a ratio
changes, no effect at an actuator is the same: the term is left out, which is said.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from geodrake.effects import catalogue
from geodrake.effects.base import Effect
from geodrake.effects.fitted_effect import FittedEffect
from geodrake.inertia import Array
from geodrake.model.file_terms import (
    Carried,
    CoupledDry,
    CoupledRotor,
    Coupling,
    Drag,
    Medium,
    Polynomial,
    Spring,
    StrutEffect,
)
from geodrake.robot import stated
from geodrake.robot.plant import LoadedPlant
from geodrake.robot.transmission.actuation import Actuation

_LEAST = 1e-100  # SI units: less counts as zero, as its square has no inverse
_DAMPING, _FRICTION, _ROTOR = "damping", "dry friction", "reflected rotor inertia"
_WEIGHTS: Mapping[str, Callable[[Array], Array]] = {_FRICTION: np.abs}
Placed = tuple[str, Effect, Sequence[float]]
"""Where an effect is, in words, the effect, and its values."""

_BEHIND = "is left out: behind the transmission, no effect at an actuator is the same."


@dataclass
class StatedEffects:
    """Effects that a file states.

    Attributes:
        effects: With their values.
        notes: Sentences on what they are of.
        left_out: Sentences on what no effect is.
    """

    effects: list[FittedEffect] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def keep(self, what: str, found: Sequence[Placed]) -> None:
        """Add effects with values, and a note on them.

        Args:
            what: What they are in the file.
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
        names: Names of the model's velocities.
        actuation: How the former follow from the latter; None if they are the same.
    """
    found = StatedEffects()
    at_joints = {what: np.array(values) for what, values in loaded.stated.items()}
    rows, shifts = _rows(actuation, len(joints))
    shared = _shared(rows, at_joints, loaded.file_springs, joints)
    values = {}
    for what, own in at_joints.items():
        values[what], lost = _at_actuators(own, actuation, _WEIGHTS.get(what, np.square))
        found.left_out += (f"The {what} in the file of {joints[at]} {_BEHIND}" for at in lost)
    own_springs = {k: s for k, s in loaded.file_springs.items() if k not in shared.springs}
    springs = _springs_through(own_springs, rows, shifts)
    lost = [at for at in own_springs if len(rows.get(at, {})) != 1]
    found.left_out += (f"The spring in the file of {joints[at]} {_BEHIND}" for at in lost)
    tendons = list(shared.tendons)
    for tendon in loaded.file_tendons:
        if rows.keys() >= tendon.shares.keys():
            tendons.append(tendon)
        else:
            found.left_out.append(f"The tendon {tendon.name} in the file {_BEHIND}")
    entries = [*shared.inertias, *((i, j, x) for (i, j), x in loaded.file_inertias.items())]
    inertias = stated.entries_through(entries, rows)
    for at in range(len(names)):
        values[_ROTOR][at] += inertias.pop((at, at), 0.0)
    own_tendons = [each.through(rows, shifts) for each in tendons]
    across = _across(own_tendons, values, springs, inertias, names)
    for kind in catalogue():
        if kind.stated_as in values:
            own = _without_negligible(values[kind.stated_as], kind.stated_as, names, found.notes)
            single = zip(names, own.tolist(), strict=True)
            found.keep(
                kind.stated_as,
                [(n, each, [x]) for n, x in single if x for each in kind.shaped(n)],
            )
    for exponent, own in zip((2.0, 3.0), loaded.file_powers, strict=True):
        what = f"damping of the power {exponent:g}"
        powers, lost = _at_actuators(own, actuation, partial(_power, exponent=exponent + 1.0))
        found.left_out += (f"The {what} in the file of {joints[at]} {_BEHIND}" for at in lost)
        single = zip(names, powers.tolist(), strict=True)
        found.keep(what, [(n, Drag(n, exponent=exponent), [x]) for n, x in single if x])
    _keep_springs(springs, names, found)
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


def _springs_through(
    springs: Mapping[int, stated.Spring],
    rows: Mapping[int, Mapping[int, float]],
    shifts: Mapping[int, float],
) -> dict[int, stated.Spring]:
    """Return springs at the actuators that alone move their joints by a constant ratio."""
    found = dict[int, stated.Spring]()
    for at, spring in springs.items():
        row = rows.get(at, {})
        for to, ratio in row.items() if len(row) == 1 else ():
            _add(found, to, spring.through(ratio, shifts.get(at, 0.0)))
    return found


def _keep_springs(
    springs: Mapping[int, stated.Spring], names: Sequence[str], found: StatedEffects
) -> None:
    own_springs = [(names[at], spring) for at, spring in sorted(springs.items())]
    simple = [(n, s) for n, s in own_springs if _is_simple(s) and any(s.coefficients)]
    placed = [(n, Spring(n, center=s.center), s.coefficients[1::-1]) for n, s in simple]
    found.keep("spring", placed)
    others = [
        (n, Polynomial(n, s.center), s.coefficients) for n, s in own_springs if not _is_simple(s)
    ]
    found.keep("spring", others)


@dataclass(frozen=True)
class _Shared:
    """What joints that several actuators move have, as tendons over those; and whose springs."""

    tendons: list[stated.Tendon]
    inertias: list[tuple[int, int, float]]
    springs: set[int]


def _shared(
    rows: Mapping[int, Mapping[int, float]],
    values: Mapping[str, Array],
    springs: Mapping[int, stated.Spring],
    joints: Sequence[str],
) -> _Shared:
    """Return what is linear at joints that several actuators move by constant ratios.

    Args:
        rows: Velocity of the tree -> actuator -> ratio.
        values: What in the file -> values (nv of the tree,); those that are taken become zero.
        springs: Velocity of the tree -> spring.
        joints: Names of the tree's velocities.
    """
    found = _Shared([], [], set())
    for at in (at for at, row in rows.items() if len(row) > 1):
        taken = {what: float(own[at]) for what, own in values.items()}
        for own in values.values():
            own[at] = 0.0
        preload, stiffness, rest = 0.0, 0.0, 0.0
        if at in springs and _is_simple(springs[at]) and springs[at].coefficients[1]:
            found.springs.add(at)
            preload, stiffness, *_ = springs[at].coefficients
            rest = springs[at].center - preload / stiffness
        if stiffness or taken[_DAMPING] or taken[_FRICTION]:
            numbers = stiffness, rest, taken[_DAMPING], taken[_FRICTION]
            found.tendons.append(stated.Tendon(joints[at], {at: 1.0}, *numbers))
        if taken[_ROTOR]:
            found.inertias.append((at, at, taken[_ROTOR]))
    return found


def _add(springs: dict[int, stated.Spring], at: int, spring: stated.Spring) -> None:
    springs[at] = springs[at] + spring if at in springs else spring


def _is_simple(spring: stated.Spring) -> bool:
    """Return whether a spring is a linear one that pulls back."""
    _, stiffness, *powers = spring.coefficients
    return stiffness >= 0.0 and not any(powers)


def _rows(
    actuation: Actuation | None, count: int
) -> tuple[dict[int, dict[int, float]], dict[int, float]]:
    """Return how velocities of a tree follow actuators, where ratios are constant, and from where.

    Returns:
        Velocity of the tree -> actuator -> ratio; and its position where those are at zero.
    """
    if actuation is None:
        return {at: {at: 1.0} for at in range(count)}, {}
    rows = dict[int, dict[int, float]]()
    for at, unit in enumerate(np.eye(count)):
        if actuation.constant is not None:
            ratios, lost = actuation.constant[at], list[int]()
        else:
            ratios, lost = actuation.joined(unit, lambda J: J)
        if not lost:
            rows[at] = {int(to): float(ratios[to]) for to in np.flatnonzero(ratios)}
    return rows, dict(enumerate(actuation.offsets.tolist()))


@dataclass
class _Across:
    """What in the file tendons are between joints -> what is kept of it, and what is lost."""

    kept: dict[str, list[Placed]]
    lost: list[str]


def _across(
    tendons: Sequence[stated.Tendon],
    values: Mapping[str, Array],
    springs: dict[int, stated.Spring],
    inertias: stated.Entries,
    names: Sequence[str],
) -> _Across:
    """Add what tendons are at each joint to values and springs; return what they are between them.

    Args:
        tendons: By velocities of the model.
        values: What in the file -> (nv,) values; changed.
        springs: Velocity -> spring; changed.
        inertias: What tendons are in the mass matrix between two joints.
        names: Names of the velocities.
    """
    couplings = defaultdict[tuple[int, int], Array](lambda: np.zeros(2))
    rubs = defaultdict[tuple[int, int, int], float](float)
    lost = list[str]()
    for tendon in tendons:
        shares = {at: share for at, share in sorted(tendon.shares.items()) if share}
        k, length = tendon.stiffness, tendon.length
        for at, share in shares.items():
            values[_DAMPING][at] += share**2 * tendon.damping
            if k:
                _add(springs, at, stated.Spring.linear(share**2 * k, length / share))
        for pair in combinations(shares, 2):
            both = shares[pair[0]] * shares[pair[1]]
            couplings[pair] += (both * k, both * tendon.damping)
        sizes = {abs(share) for share in shares.values()}
        if tendon.friction and len(shares) == 1:
            values[_FRICTION][next(iter(shares))] += next(iter(sizes)) * tendon.friction
        elif tendon.friction and len(shares) == 2 and len(sizes) == 1:
            (i, first), (j, second) = shares.items()
            rubs[i, j, 1 if first == second else -1] += abs(first) * tendon.friction
        elif tendon.friction and shares:
            lost.append(
                f"The dry friction {tendon.friction:g} of {tendon.name}, over joints that pull it "
                "unequally, is left out."
            )

    def placed(make: Callable[..., Effect], found: Mapping[Any, Sequence[float]]) -> list[Placed]:
        every = [((names[i], names[j]), sign, own) for (i, j, *sign), own in found.items()]
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
