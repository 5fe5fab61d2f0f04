"""Effects from elements of a model file: joints, tendons, gravity compensation, a medium.

Files state terms at joints, whereas effects act at actuators. With one actuator of constant ratio
J, damping, rotor inertia and stiffness are multiplied by J², and dry friction by |J|. With several
actuators or a varying ratio, as in a closed loop, the effect stays at the joint, τ_q = Jᵀ τ_θ. A
tendon's energy ½ k (Σ cᵢ qᵢ − L₀)² is that of a spring at each joint and of a coupling of each
pair; damping and inertia are split in the same way.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import chain, combinations

import numpy as np
from pydrake.math import RigidTransform

from geodrake.effects.base import Effect, FittedEffect
from geodrake.effects.file_terms import (
    AddedMass,
    Ball,
    Carried,
    CoupledDry,
    CoupledRotor,
    Coupling,
    Damping,
    Drag,
    DryFriction,
    Ellipsoid,
    Medium,
    Polynomial,
    Rotor,
    Spring,
    StrutEffect,
    TendonPath,
)
from geodrake.effects.lookup import catalogue, file_effects
from geodrake.effects.of_files import PART
from geodrake.inertia import Array, from_spatial_inertia
from geodrake.inertia.bodies import lumped_bodies
from geodrake.robot import stated
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.joints import Following, joint_names
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import LoadedPlant, scoped_joint_names

_LEAST = 1e-100  # SI units; smaller values count as zero, as their squares underflow


class StatedEffects:
    """Sums of the terms in a file as effects at coordinates, joints and bodies, with notes."""

    def __init__(self, names: Sequence[str]) -> None:
        self.left_out, self.notes = list[str](), list[str]()
        self._at = {name: at for at, name in enumerate(names)}
        self._sums, self._springs = dict[Effect, Array](), dict[str, stated.Spring]()

    def add(self, effect: Effect, *values: float) -> None:
        """Add parameters to an effect."""
        if any(values):
            self._sums[effect] = self._sums.get(effect, 0.0) + np.array(values, float)

    def add_inertia(self, first: str, second: str, value: float) -> None:
        """Add an entry of the mass matrix, at one coordinate or between two."""
        pair = min(first, second), max(first, second)
        self.add(Rotor(first) if first == second else CoupledRotor(pair), value)

    def add_length(self, length: stated.StatedLength) -> None:
        """Add terms along a length, a linear combination of coordinates."""
        shares, friction = length.shares, length.friction
        for name, share in shares.items():
            for power, value in enumerate(length.damping, start=1):
                drag = Damping(name) if power == 1 else Drag(name, exponent=float(power))
                self.add(drag, abs(share) ** (power + 1) * value)
            self.add_inertia(name, name, share**2 * length.armature)
            if any(length.spring.coefficients):
                spring, known = length.spring.through(share, 0.0), self._springs.get(name)
                self._springs[name] = spring if known is None else known + spring
        for pair in combinations(sorted(shares), 2):
            both = shares[pair[0]] * shares[pair[1]]
            stiffness = length.spring.coefficients[1]
            self.add(Coupling(pair), both * stiffness, both * length.damping[0])
        names, size = sorted(shares), max(map(abs, shares.values()), default=0.0)
        alike = all(abs(share) == size for share in shares.values())
        if len(shares) == 1:
            self.add(DryFriction(*names), size * friction)
        elif len(shares) == 2 and alike and self._at.keys() >= shares.keys():
            one, two = names
            sign = 1 if shares[one] == shares[two] else -1
            self.add(CoupledDry((one, two), sign), size * friction, 0.0)
        elif friction and shares:
            self.left_out.append(
                f"The dry friction {friction:g} of {length.name} is ignored, as its joints "
                "have unequal moment arms."
            )

    def fitted(self) -> list[FittedEffect]:
        """Return the effects with nonzero parameters, and add notes on them."""
        for name, spring in self._springs.items():
            preload, stiffness, *powers = spring.coefficients
            if stiffness >= 0.0 and not any(powers):  # a linear one that pulls back
                self.add(Spring(name, center=spring.center), stiffness, preload)
            else:
                self.add(Polynomial(name, spring.center), *spring.coefficients)
        groups = defaultdict[tuple[str, str], list[FittedEffect]](list)
        for effect in sorted(self._sums, key=self._rank):
            values, words = self._sums[effect], effect.file_term.words.format(**effect.shape)
            how = f"is kept as {effect.name}"
            if np.abs(values).max() < _LEAST:
                how = "is negligible and ignored"
            if values.any():
                groups[words, how].append(FittedEffect(effect, values))
        for (words, how), items in groups.items():
            names = ((f.effect.place, *(f"{x:g}" for x in f.parameters if x)) for f in items)
            self.notes.append(f"The {words} in the file ({', '.join(map(' '.join, names))}) {how}.")
        kept = chain.from_iterable(groups.values())
        return [fitted for fitted in kept if np.abs(fitted.parameters).max() >= _LEAST]

    def _rank(self, effect: Effect) -> tuple[int, float, int]:
        """Return an effect's sorting key: kind, power, place."""
        known, power = (*catalogue(), *file_effects()), effect.shape.get("exponent") or 0.0
        return known.index(type(effect)), power, self._at.get(effect.where[0], len(self._at))


def _places(loaded: LoadedPlant, coordinates: RobotCoordinates) -> dict[str, Following]:
    """Return the coupling of each joint by scoped name, with an index for several velocities."""
    joints = scoped_joint_names(loaded.plant)
    keys = (
        joint if joints.count(joint) == 1 else f"{joint}[{joints[:index].count(joint)}]"
        for index, joint in enumerate(joints)
    )
    places = dict(zip(keys, coordinates.followed(joint_names(loaded.plant)), strict=True))
    places |= {cut.scoped_name: Following(cut.name) for cut in loaded.closing}
    return places | {joint: Following("", 0.0, index) for joint, index in loaded.places.items()}


def stated_effects(loaded: LoadedPlant, coordinates: RobotCoordinates) -> StatedEffects:
    """Return the effects in a model file, at the coordinates of all joints of the plant."""
    effects, terms = StatedEffects(coordinates.names), loaded.terms
    places = _places(loaded, coordinates)
    for length in chain.from_iterable(each.each(places) for each in terms.lengths):
        if places.keys() >= length.shares.keys():
            effects.add_length(length.through(places))
        elif not places.keys().isdisjoint(length.shares):
            note = f"Tendon {length.name} between several robots is ignored."
            effects.left_out.append(note)
    for first, second, value in terms.coupled_inertia:
        if {first, second} <= places.keys():
            (i, a, _), (j, b, _) = places[first], places[second]
            effects.add_inertia(i, j, a * b * value * (2.0 if i == j and first != second else 1.0))
    _add_of_bodies(effects, loaded)
    return effects


def _add_of_bodies(effects: StatedEffects, loaded: LoadedPlant) -> None:
    """Add gravity compensation, struts and media, at the bodies of their links."""
    terms, plant = loaded.terms, loaded.plant
    places, still = stated.places_of_links(plant), (stated.WORLD, RigidTransform())
    weights = defaultdict[str, Array](lambda: np.zeros(4))
    for member in chain.from_iterable(body.members for body in lumped_bodies(plant)):
        share, link = terms.carried.get(member.scoped_name, 0.0), plant.get_body(member.index)
        parameters = from_spatial_inertia(link.default_spatial_inertia())
        mass, *moment = terms.set_aside.get(member.scoped_name, parameters)[:4]
        if share and 0.0 < mass < np.inf:
            com = member.X_RB @ (np.array(moment) / mass)
            body = places[member.scoped_name][0]
            weights[body] += share * mass * np.append(1.0, com)
    for body, weight in weights.items():
        for by, sign in _carriers(loaded, body) if weight[0] else ():
            carried = Carried((body, by), *(weight[1:] / weight[0]).tolist())
            effects.add(carried, sign * weight[0])
    for tendon in terms.tendons:
        _add_tendon(effects, tendon, places)
    for ball in terms.balls:
        (one, X), (two, Y) = (places.get(link, ("", RigidTransform())) for link in ball.bodies)
        if one and two and one != two:
            turn = Y.rotation() @ ball.rest @ X.rotation().inverse()
            effects.add(Ball((one, two), *turn.ToQuaternion().wxyz()), ball.stiffness)
    inertias = defaultdict[str, Array](lambda: np.zeros((6, 6)))
    for link, inertia in terms.added_mass.items():
        body, X = places.get(link, still)
        R, (x, y, z) = X.rotation().matrix().T, X.translation()
        at_link = np.kron(np.eye(2), R)  # from the velocities of the body to those of the link
        at_link[:3, 3:] = R @ [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        inertias[body] += at_link.T @ inertia @ at_link
    for body in inertias.keys() - {stated.WORLD}:
        effects.add(AddedMass(body, tuple(inertias[body][np.triu_indices(6)].tolist())), 1.0)
    for each in terms.in_medium:
        body, X = places.get(each.body, still)
        if body != stated.WORLD:
            X_BP = X @ each.X_BP
            turn = X_BP.rotation().ToQuaternion().wxyz()
            kind = Ellipsoid if each.coefficients else Medium
            values = *each.size, *X_BP.translation(), *turn, *each.wind, *each.coefficients
            effects.add(kind(body, *values), each.density, each.viscosity)


def _add_tendon(
    effects: StatedEffects,
    tendon: stated.StatedTendon,
    places: Mapping[str, tuple[str, RigidTransform]],
) -> None:
    """Add a tendon with the parts whose length varies."""
    links = {link for part in tendon.parts for link in part.bodies}
    links |= {part.around.body for part in tendon.parts if part.around is not None}
    if not places.keys() >= links:
        return  # of another robot
    bodies, numbers, rest, moves = list[str](), list[float](), tendon.length, False
    for part in tendon.parts:
        ends = [places[link] for link in part.bodies]
        points = [X @ point for (_, X), point in zip(ends, part.points, strict=True)]
        names, shape = [body for body, _ in ends], [0.0] * (len(PART) - 7)
        if (pulley := part.around) is not None:
            body, X = places[pulley.body]
            X_BG, kind = X @ pulley.X_BG, [pulley.radius, float(pulley.is_cylinder)]
            turn = X_BG.rotation().ToQuaternion().wxyz()
            names, shape = [*names, body], [*kind, *X_BG.translation(), *turn, *pulley.side]
        if len(set(names)) == 1 and pulley is None:
            rest -= part.weight * float(np.linalg.norm(points[1] - points[0]))
            continue
        bodies += [*names, stated.WORLD][:3]
        numbers += [*np.ravel(points).tolist(), part.weight, *map(float, shape)]
        moves = moves or len(set(names)) > 1
    slack, k, d = tendon.slack, tendon.stiffness, tendon.damping
    p, band = (0.0, (rest, rest + slack)) if slack else (-k * rest, (0.0, 0.0))
    if len(bodies) == 3 and not (slack or any(numbers[7:])):
        strut, weight = StrutEffect((bodies[0], bodies[1]), *numbers[:6]), numbers[6]
        effects.add(strut, weight**2 * k, weight * p, weight**2 * d)
    elif moves:
        effects.add(TendonPath(bodies=tuple(bodies), numbers=(*band, *numbers)), k, p, d)


def _carriers(loaded: LoadedPlant, body: str) -> list[tuple[str, float]]:
    """Return the bodies that carry the compensated weight of a body, with signs.

    Joints with motors for gravity compensation still bear the weight. Each boundary between these
    and other joints, along the chain from the world, has a carrier with the sign of the change.
    """
    acting = loaded.terms.acting
    if not acting:
        return [(stated.WORLD, 1.0)]
    tree, names = KinematicTree.from_plant(loaded.plant), scoped_joint_names(loaded.plant)
    (*inboard, last) = tree.branch(tree.bodies.index(body)).mobilizers
    bodies = [stated.WORLD, *(tree.bodies[each.body] for each in inboard)]
    feels = [float(names[each.velocities.start] not in acting) for each in (*inboard, last)]
    signs = np.diff([0.0, *feels]).tolist()
    return [(each, sign) for each, sign in zip(bodies, signs, strict=True) if sign]
