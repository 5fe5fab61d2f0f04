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
from itertools import combinations

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
_SINGLE: Mapping[str, Callable[[str], Effect]] = {
    _DAMPING: Damping,
    _FRICTION: DryFriction,
    _ROTOR: Rotor,
}


@dataclass
class StatedEffects:
    """Effects that a file states.

    Attributes:
        joints: Names of the velocities of the plant's tree, without followers.
        names: Names of the model's velocities.
        actuation: How the former follow from the latter.
        closing: Joint that closes a loop -> what is stated of it.
        notes: Sentences on what the effects are of.
        left_out: Sentences on what no effect is.
    """

    joints: Sequence[str]
    names: Sequence[str]
    actuation: Actuation
    closing: Mapping[str, Mapping[str, float]]
    effects: list[FittedEffect] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def keep(self, what: str, found: Sequence[tuple[Effect, Sequence[float]]]) -> None:
        """Add effects with values that are not all zero, and a note on them."""
        found = [(effect, values) for effect, values in found if any(values)]
        self.effects += [FittedEffect(effect, np.array(values, float)) for effect, values in found]
        if found:
            listed = ", ".join(
                f"{effect.place} {' '.join(f'{value:g}' for value in values if value)}"
                for effect, values in found
            )
            kept = found[0][0].name
            self.notes.append(f"The {what} in the file ({listed}) is kept as {kept}.")

    def by_name(self, own: Array, what: str, power: float) -> dict[str, float]:
        """Return actuator or joint -> its coefficient, of those (nv of the tree,) of the joints.

        A ratio J multiplies it by |J| to a power.
        """
        values, lost = self.actuation.joined(own, lambda J: np.abs(J) ** power)
        found = dict(zip(self.names, values.tolist(), strict=True))
        for at in lost:
            found[self.joints[at]] = found.get(self.joints[at], 0.0) + float(own[at])
        return found | {joint: each.get(what, 0.0) for joint, each in self.closing.items()}

    def ratios(self) -> tuple[dict[int, dict[str, float]], dict[int, float]]:
        """Return what moves each velocity of the tree by a constant ratio, and from where.

        Returns:
            Velocity -> name of its actuator -> ratio, or the joint itself where several move it or
            the ratio changes; and velocity -> position with the actuator at zero.
        """
        rows: dict[int, dict[str, float]] = {at: {name: 1.0} for at, name in enumerate(self.joints)}
        shifts = dict[int, float]()
        for at, unit in enumerate(np.eye(len(self.joints))):
            ratios, lost = self.actuation.joined(unit, lambda J: J)
            if not lost:
                moved = np.flatnonzero(ratios)
                rows[at] = {self.names[int(to)]: float(ratios[to]) for to in moved}
                shifts[at] = float(self.actuation.offsets[at])
        return rows, shifts


def stated_effects(
    loaded: LoadedPlant, joints: Sequence[str], names: Sequence[str], actuation: Actuation
) -> StatedEffects:
    """Return the effects that a model file states; see `StatedEffects`."""
    found = StatedEffects(joints, names, actuation, loaded.closing)
    values = {
        what: found.by_name(own, what, 1.0 if what == _FRICTION else 2.0)
        for what, own in loaded.stated.items()
    }
    rows, shifts = found.ratios()
    springs = dict[str, stated.Spring]()

    def add_spring(name: str, spring: stated.Spring) -> None:
        springs[name] = springs[name] + spring if name in springs else spring

    for at, spring in loaded.file_springs.items():
        for to, ratio in rows[at].items():
            add_spring(to, spring.through(ratio, shifts.get(at, 0.0)))
    for joint, of_loop in loaded.closing.items():
        add_spring(joint, stated.Spring.linear(of_loop.get("spring", 0.0), of_loop["rest"]))
    entries = ((i, j, x) for (i, j), x in loaded.file_inertias.items())
    inertias = stated.entries_through(entries, rows)
    for name in [name for name, other in inertias if name == other]:
        values[_ROTOR][name] = values[_ROTOR].get(name, 0.0) + inertias.pop((name, name))
    tendons = [each.through(rows, shifts) for each in loaded.file_tendons]
    couplings, rubs = _across(found, tendons, values, add_spring)
    for what, kind in _SINGLE.items():
        own = values.get(what, {})
        small = {n: value for n, value in own.items() if 0.0 < abs(value) < _LEAST}
        if small:
            listed = ", ".join(f"{name} {value:g}" for name, value in small.items())
            found.notes.append(f"The {what} in the file ({listed}) is negligible, and counts as 0.")
        found.keep(what, [(kind(n), [x]) for n, x in own.items() if n not in small])
    for exponent, of_power in zip((2.0, 3.0), loaded.file_powers, strict=True):
        what = f"damping of the power {exponent:g}"
        single = found.by_name(of_power, what, exponent + 1.0)
        found.keep(what, [(Drag(n, exponent=exponent), [x]) for n, x in single.items()])
    simple, others = [], []
    for name, spring in springs.items():
        preload, stiffness, *powers = spring.coefficients
        if stiffness >= 0.0 and not any(powers):  # a linear one that pulls back
            simple.append((Spring(name, center=spring.center), (stiffness, preload)))
        else:
            others.append((Polynomial(name, spring.center), spring.coefficients))
    found.keep("spring", simple)
    found.keep("spring", others)
    pairs = [(Coupling(pair), own.tolist()) for pair, own in couplings.items()]
    found.keep("coupling by tendons", pairs)
    rotors = [(CoupledRotor(pair), [x]) for pair, x in inertias.items()]
    found.keep("rotor inertia of tendons", rotors)
    found.keep(
        "dry friction of tendons",
        [(CoupledDry((i, j), sign), [x, 0.0]) for (i, j, sign), x in rubs.items()],
    )
    weights = [(Carried(w.body, *w.place.tolist()), [w.mass]) for w in loaded.file_weights]
    found.keep("carried weight", weights)
    struts = []
    for strut in loaded.file_struts:
        effect = StrutEffect(strut.bodies, *strut.points[0].tolist(), *strut.points[1].tolist())
        numbers = [strut.stiffness, -strut.stiffness * strut.length, strut.damping]
        struts.append((effect, numbers))
    found.keep("tendon", struts)
    found.keep("medium", [(_drag(b), [b.density, b.viscosity]) for b in loaded.file_boxes])
    return found


def _across(
    found: StatedEffects,
    tendons: Sequence[stated.Tendon],
    values: Mapping[str, dict[str, float]],
    add_spring: Callable[[str, stated.Spring], None],
) -> tuple[dict[tuple[str, str], Array], dict[tuple[str, str, int], float]]:
    """Add what tendons are at each joint to values and springs.

    Returns:
        What they are between two joints: stiffness and damping, and dry friction by sign.
    """
    couplings = defaultdict[tuple[str, str], Array](lambda: np.zeros(2))
    rubs = defaultdict[tuple[str, str, int], float](float)
    for tendon in tendons:
        shares = {name: share for name, share in tendon.shares.items() if share}
        for name, share in shares.items():
            values[_DAMPING][name] = values[_DAMPING].get(name, 0.0) + share**2 * tendon.damping
            if k := tendon.stiffness:
                add_spring(name, stated.Spring.linear(share**2 * k, tendon.length / share))
        for pair in combinations(sorted(shares), 2):
            both = shares[pair[0]] * shares[pair[1]]
            couplings[pair] += (both * tendon.stiffness, both * tendon.damping)
        sizes, own = {abs(share) for share in shares.values()}, set(found.names).issuperset(shares)
        if tendon.friction and len(shares) == 1:
            (name,) = shares
            rubbing = values[_FRICTION].get(name, 0.0) + abs(shares[name]) * tendon.friction
            values[_FRICTION][name] = rubbing
        elif tendon.friction and len(shares) == 2 and len(sizes) == 1 and own:
            (i, first), (j, second) = sorted(shares.items())
            rubs[i, j, 1 if first == second else -1] += abs(first) * tendon.friction
        elif tendon.friction and shares:
            found.left_out.append(
                f"The dry friction {tendon.friction:g} of {tendon.name}, over joints that pull it "
                "unequally, is left out."
            )
    return couplings, rubs


def _drag(box: stated.BoxInMedium) -> Medium:
    turn = box.X_BP.rotation().ToQuaternion().wxyz()
    return Medium(box.body, *box.size, *box.X_BP.translation(), *turn, *box.wind)
