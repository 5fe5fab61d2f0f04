"""Candidates: packages of effects at a place, gathered into kinds that are named together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

from geodrake.effects.base import Effect

COMPLEXITY: Mapping[str, int] = {
    "viscous_friction": 0,
    "coulomb_friction": 0,
    "effort_offset": 0,
    "rotor_inertia": 0,
    "payload": 1,
    "asymmetric_friction": 1,
    "load_dependent_friction": 1,
    "joint_spring": 1,
    "gravity_compensator": 1,
    "coupled_friction": 1,
    "coupled_rotor_inertia": 1,
    "effort_delay": 1,
    "stribeck_friction": 2,
    "nonlinear_viscous_friction": 2,
    "torque_ripple": 2,
    "friction_drift": 2,
    "hysteresis": 2,
    "gravity_tilt": 1,
    "effort_scale": 1,
    "aerodynamic_drag": 2,
    "joint_elasticity": 1,
    "backlash": 2,
    "contact": 3,
    "wrong_inertia": 3,
}
"""Of candidates that the data cannot tell apart, the one of least complexity is named."""

DRY_AND_VISCOUS = ("coulomb_friction", "viscous_friction")
_WITHIN_ASYMMETRIC = (*DRY_AND_VISCOUS, "effort_offset")


@dataclass(frozen=True)
class Package:
    """Effects that are tried together at one place.

    Attributes:
        effects: The effects, one for most packages.
        place: Joint or body names.
    """

    effects: tuple[Effect, ...]
    place: tuple[str, ...]

    @property
    def parameters(self) -> int:
        """Linear parameters, and one for every shape parameter that was tried on a grid."""
        return sum(len(effect.parameters) + effect.free_shapes for effect in self.effects)


@dataclass(frozen=True)
class Kind:
    """Packages that bear one name: per place, the shapes to choose from.

    Attributes:
        names: Effect names, two for a pair that is found together or not at all.
        options: Place -> packages to choose one from.
        unite: Whether several places may be named at once (joints), or one only (bodies, pairs).
    """

    names: tuple[str, ...]
    options: Mapping[tuple[str, ...], tuple[Package, ...]]
    unite: bool

    @property
    def complexity(self) -> int:
        """Complexity of the most complex of its effects."""
        return kind_complexity(self.names)


def kind_complexity(names: Sequence[str]) -> int:
    """Complexity of the most complex effect; a user's own effect counts like the complex ones."""
    return max(COMPLEXITY.get(name, 2) for name in names)


def kinds_at(
    effects: Sequence[Effect], present: Sequence[Effect], place: tuple[str, ...]
) -> list[Kind]:
    """The kinds to try of which there are packages at a place, as they first appear there.

    Args:
        effects: Every effect that has columns in the dataset, the shapes of a grid included.
        present: Effects of the hypothesis.
        place: Joint or body names.
    """
    within = set(place)  # both rotors of coupled joints come with those that couple them
    near = [effect for effect in effects if within.issuperset(effect.where)]
    return [kind for kind in kinds(near, present) if place in kind.options]


def kinds(effects: Sequence[Effect], present: Sequence[Effect]) -> list[Kind]:
    """All kinds to try when some effects are already in the model.

    Args:
        effects: Every effect that has columns in the dataset, the shapes of a grid included.
        present: Effects of the hypothesis; what they already say is not offered again.
    """
    taken = {(effect.name, effect.where) for effect in present}
    options: dict[tuple[str, ...], dict[tuple[str, ...], list[Package]]] = defaultdict(
        lambda: defaultdict(list)
    )
    joint_kinds: set[tuple[str, ...]] = set()
    by_place: dict[tuple[str, ...], dict[str, Effect]] = defaultdict(dict)
    for effect in effects:
        own = (effect.name, effect.where)
        if own in taken or not has_base(effect, taken) or _is_within(effect, taken):
            continue
        options[(effect.name,)][effect.where].append(Package((effect,), effect.where))
        by_place[effect.where][effect.name] = effect
        if effect.places == "joint" and not effect.sees_bodies:  # felt at its joint alone
            joint_kinds.add((effect.name,))
    for place, named in by_place.items():
        pair = tuple(named[name] for name in DRY_AND_VISCOUS if name in named)
        if len(pair) == len(DRY_AND_VISCOUS):
            singles = [Package((effect,), place) for effect in pair]
            options[DRY_AND_VISCOUS][place] = [Package(pair, place), *singles]
            joint_kinds.add(DRY_AND_VISCOUS)
    for place, alone in options.get(("coupled_rotor_inertia",), {}).items():
        rotors = [by_place[joint,].get("rotor_inertia") for joint in place]
        more = tuple(rotor for rotor in rotors if rotor is not None)
        if more:  # the rotor that couples two joints turns with each of them too
            alone += [Package((*each.effects, *more), place) for each in alone]
    return [
        Kind(names, {p: tuple(packages) for p, packages in places.items()}, names in joint_kinds)
        for names, places in options.items()
    ]


def pairs_at(
    effects: Sequence[Effect], present: Sequence[Effect], place: tuple[str, ...]
) -> tuple[Package, ...]:
    """All pairs of the simple effects at a place: each may hide the other; see `simple_at`."""
    return tuple(
        Package(pair, place) for pair in combinations(simple_at(effects, present, place), 2)
    )


def hidden_pairs(
    effects: Sequence[Effect], present: Sequence[Effect], joint: str
) -> tuple[Package, ...]:
    """All pairs of effects at a joint, of every shape, each of which may hide the other.

    Args:
        effects: Every effect that has columns in the dataset, the shapes of a grid included.
        present: Effects of the hypothesis.
        joint: The joint.
    """
    place = (joint,)
    offered = kinds_at(effects, present, place)
    singles = [kind.options[place] for kind in offered if kind.unite and len(kind.names) == 1]
    return tuple(
        Package((*one.effects, *other.effects), place)
        for ones, others in combinations(singles, 2)
        for one, other in product(ones, others)
    )


def simple_at(
    effects: Sequence[Effect], present: Sequence[Effect], place: tuple[str, ...]
) -> list[Effect]:
    """Simple effects of one parameter at a place.

    Args:
        effects: Every effect that has columns in the dataset.
        present: Effects of the hypothesis.
        place: A joint.
    """
    return [
        effect
        for effect in effects
        if effect.where == place
        and effect not in present
        and kind_complexity((effect.name,)) <= 1
        and Package((effect,), place).parameters == 1
    ]


def _is_within(effect: Effect, taken: Collection[tuple[str, tuple[str, ...]]]) -> bool:
    """Whether asymmetric friction is there, which with other heights and slopes has the effect."""
    return effect.name in _WITHIN_ASYMMETRIC and ("asymmetric_friction", effect.where) in taken


def is_refinement(effect: Effect) -> bool:
    """Whether an effect refines dry and viscous friction, and alone is a compromise of the two.

    Stribeck friction is one, drift of friction, and |v|^α with α < 1; drag that grows faster than
    the speed is not.
    """
    if effect.name == "nonlinear_viscous_friction":
        return float(effect.shape["exponent"]) < 1.0
    return effect.name in ("stribeck_friction", "friction_drift")


def has_base(effect: Effect, taken: Collection[tuple[str, tuple[str, ...]]]) -> bool:
    """Whether the frictions that an effect refines are among those taken, by name and place.

    Stribeck friction refines dry friction, with viscous friction or without; drift either of them;
    |v|^α both, which it stands between.
    """
    if not is_refinement(effect) or ("asymmetric_friction", effect.where) in taken:
        return True
    dry, viscous = ((name, effect.where) in taken for name in DRY_AND_VISCOUS)
    if effect.name == "friction_drift":
        return dry or viscous
    return dry and (viscous or effect.name == "stribeck_friction")
