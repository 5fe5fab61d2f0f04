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
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex

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
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.joints import joint_names
from geodrake.robot.plant import LoadedPlant, scoped_joint_names

_LEAST = 1e-100  # SI units: less counts as zero, as its square has no inverse
_DAMPING, _FRICTION, _ROTOR = "damping", "dry friction", "reflected rotor inertia"
_SINGLE: Mapping[str, Callable[[str], Effect]] = {
    _DAMPING: Damping,
    _FRICTION: DryFriction,
    _ROTOR: Rotor,
}


Rows = dict[str, list[dict[str, float]]]
"""Scoped joint -> of each of its velocities, the actuator, or joint, that it follows -> ratio."""


@dataclass
class StatedEffects:
    """Effects that a file states.

    Attributes:
        notes: Sentences on what the effects are of.
        left_out: Sentences on what no effect is.
    """

    names: Sequence[str]
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

    def by_name(self, own: Mapping[str, ArrayLike], rows: Rows, power: float) -> dict[str, float]:
        """Return actuator or joint -> its coefficient, of those of joints by scoped names.

        A ratio J multiplies it by |J| to a power.
        """
        found = dict.fromkeys(self.names, 0.0)
        for joint, each in rows.items():
            values = np.broadcast_to(np.nan_to_num(own.get(joint, 0.0)), len(each))
            for row, value in zip(each, values.tolist(), strict=True):
                for name, ratio in row.items() if value else ():
                    found[name] = found.get(name, 0.0) + abs(ratio) ** power * value
        return found


def _rows(loaded: LoadedPlant, coordinates: RobotCoordinates) -> tuple[Rows, dict[str, float]]:
    """Return what each joint follows, and its position where that is at zero.

    A joint that several actuators move, or by a ratio that changes, follows itself.
    """
    rows, shifts = dict[int, dict[str, float]](), dict[int, float]()
    for at, joint in enumerate(joint_names(loaded.plant)):
        name, ratio, shifts[at] = coordinates.ratios.get(at, (joint, 1.0, 0.0))
        rows[at] = {name: ratio}
    for to, of, ratio, offset in coordinates.led.each():
        rows[to] = {name: ratio * own for name, own in rows[of].items()}
        shifts[to] = ratio * shifts[of] + offset
    found, places = Rows(), dict(loaded.places)
    for at, joint in enumerate(scoped_joint_names(loaded.plant)):
        found.setdefault(joint, []).append(rows[at])
        places[joint] = shifts[at]
    found |= {cut.scoped_name: [{cut.name: 1.0}] for cut in loaded.closing}
    return found | {joint: [{}] for joint in loaded.places}, places


def stated_effects(loaded: LoadedPlant, coordinates: RobotCoordinates) -> StatedEffects:
    """Return the effects that a model file states, by coordinates of all of the plant's joints."""
    found, terms = StatedEffects(coordinates.names), loaded.terms
    rows, places = _rows(loaded, coordinates)
    values = {
        _DAMPING: found.by_name(terms.damping, rows, 2.0),
        _FRICTION: found.by_name(terms.friction, rows, 1.0),
        _ROTOR: found.by_name(terms.armature, rows, 2.0),
    }
    springs = dict[str, stated.Spring]()

    def add_spring(name: str, spring: stated.Spring) -> None:
        springs[name] = springs[name] + spring if name in springs else spring

    by_joint = {joint: each[-1] for joint, each in rows.items()}
    for joint, row in by_joint.items():
        for to, ratio in row.items() if joint in terms.springs else ():
            add_spring(to, terms.springs[joint].through(ratio, places.get(joint, 0.0)))
    inertias = stated.entries_through(terms.coupled_inertia, by_joint)
    for name in [name for name, other in inertias if name == other]:
        values[_ROTOR][name] = values[_ROTOR].get(name, 0.0) + inertias.pop((name, name))
    tendons = [each for each in terms.tendons if by_joint.keys() >= each.shares.keys()]
    found.left_out += [
        f"The tendon {tendon.name} over joints of several robots is left out."
        for tendon in terms.tendons
        if tendon not in tendons and not by_joint.keys().isdisjoint(tendon.shares)
    ]
    own_tendons = [each.through(by_joint, places) for each in tendons]
    couplings, rubs = _across(found, own_tendons, values, add_spring)
    for what, kind in _SINGLE.items():
        own = values[what]
        small = {n: value for n, value in own.items() if 0.0 < abs(value) < _LEAST}
        if small:
            listed = ", ".join(f"{name} {value:g}" for name, value in small.items())
            found.notes.append(f"The {what} in the file ({listed}) is negligible, and counts as 0.")
        found.keep(what, [(kind(n), [x]) for n, x in own.items() if n not in small])
    for exponent, of_power in ((2.0, terms.damping_2), (3.0, terms.damping_3)):
        what = f"damping of the power {exponent:g}"
        single = found.by_name(of_power, rows, exponent + 1.0)
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
    _keep_of_bodies(found, loaded)
    return found


def _keep_of_bodies(found: StatedEffects, loaded: LoadedPlant) -> None:
    """Add what carries weights, struts and media, at the bodies that their links are parts of."""
    terms, plant = loaded.terms, loaded.plant
    places, still = stated.places_of_links(plant), (stated.WORLD, RigidTransform())
    weights = defaultdict[str, Array](lambda: np.zeros(4))
    for index in map(BodyIndex, range(plant.num_bodies())):
        link = plant.get_body(index)
        name = link.scoped_name().get_full()
        body, X = places.get(name, still)
        share = 0.0 if body == stated.WORLD else terms.carried.get(name, 0.0)
        if share and link.default_mass() > 0.0:
            com = X @ link.default_spatial_inertia().get_com()
            weights[body] += share * link.default_mass() * np.append(1.0, com)
    carried = [(Carried(b, *(w[1:] / w[0]).tolist()), [w[0]]) for b, w in weights.items() if w[0]]
    found.keep("carried weight", carried)
    struts, boxes = list[tuple[Effect, list[float]]](), list[tuple[Effect, list[float]]]()
    for strut in terms.struts:
        (one, X), (two, Y) = (places.get(link, ("", RigidTransform())) for link in strut.bodies)
        if one and two and one != two:
            ends = (X @ strut.points[0]).tolist(), (Y @ strut.points[1]).tolist()
            numbers = [strut.stiffness, -strut.stiffness * strut.length, strut.damping]
            struts.append((StrutEffect((one, two), *ends[0], *ends[1]), numbers))
    found.keep("tendon", struts)
    for box in terms.boxes:
        body, X = places.get(box.body, still)
        if body != stated.WORLD:
            boxes.append((_drag(box, body, X @ box.X_BP), [box.density, box.viscosity]))
    found.keep("medium", boxes)


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


def _drag(box: stated.BoxInMedium, body: str, X_BP: RigidTransform) -> Medium:
    turn = X_BP.rotation().ToQuaternion().wxyz()
    return Medium(body, *box.size, *X_BP.translation(), *turn, *box.wind)
