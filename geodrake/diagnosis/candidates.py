"""Candidates: packages of effects at a place, gathered into kinds that are named together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

from geodrake.diagnosis.judgement import parameters_of
from geodrake.effects.base import Effect

Places = frozenset[tuple[str, tuple[str, ...]]]
"""Names of effects, each with the joints or bodies where it is."""


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
        return parameters_of(self.effects)


@dataclass(frozen=True)
class Kind:
    """Packages that bear one name: per place, the shapes to choose from.

    Attributes:
        classes: Classes of the effects, two for a pair that is found together or not at all.
        options: Place -> packages to choose one from.
        unite: Whether several places may be named at once (joints), or one only (bodies, pairs).
    """

    classes: tuple[type[Effect], ...]
    options: Mapping[tuple[str, ...], tuple[Package, ...]]
    unite: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(kind.name for kind in self.classes)

    @property
    def complexity(self) -> int:
        """Complexity of the most complex of its effects."""
        return max(kind.complexity for kind in self.classes)


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
    said = said_by(present)
    options: dict[tuple[type[Effect], ...], dict[tuple[str, ...], list[Package]]] = defaultdict(
        lambda: defaultdict(list)
    )
    united: set[tuple[type[Effect], ...]] = set()
    by_place: dict[tuple[str, ...], dict[type[Effect], Effect]] = defaultdict(dict)
    for effect in effects:
        if (effect.name, effect.where) in said or not has_base(effect, said):
            continue
        alone = (type(effect),)
        options[alone][effect.where].append(Package((effect,), effect.where))
        by_place[effect.where][type(effect)] = effect
        if effect.places == "joint" and "bodies" not in effect.depends_on:  # felt there alone
            united.add(alone)
    for place, here in by_place.items():
        for kind, effect in here.items():
            if kind.companion in here:
                pair = (effect, here[kind.companion])
                singles = [Package((each,), place) for each in pair]
                options[kind, kind.companion][place] = [Package(pair, place), *singles]
                united.add((kind, kind.companion))
    for (kind, *_), places in options.items():
        for place, packages in places.items() if kind.at_each_joint else ():
            found = [by_place[joint,].get(own) for own in kind.at_each_joint for joint in place]
            more = tuple(effect for effect in found if effect is not None)
            if more:  # the actuator that couples two joints turns with each of them too
                packages += [Package((*each.effects, *more), place) for each in packages]
    return [
        Kind(classes, {p: tuple(packages) for p, packages in places.items()}, classes in united)
        for classes, places in options.items()
    ]


def pairs_at(
    effects: Sequence[Effect], present: Sequence[Effect], place: tuple[str, ...]
) -> tuple[Package, ...]:
    """All pairs of the simple effects at a place: each may hide the other; see `simple_at`.

    Args:
        effects: Effects that are tried.
        present: Effects that the hypothesis has.
        place: Joint or body names.
    """
    return tuple(
        Package(pair, place) for pair in combinations(simple_at(effects, present, place), 2)
    )


def hidden_pairs(
    effects: Sequence[Effect], present: Sequence[Effect], joint: str
) -> tuple[Package, ...]:
    """All pairs of effects at a joint, of every shape, each of which may hide the other.

    What comes on top of others is in a pair only where these are there already.

    Args:
        effects: Every effect that has columns in the dataset, the shapes of a grid included.
        present: Effects of the hypothesis.
        joint: The joint.
    """
    place, said = (joint,), said_by(present)
    based = [effect for effect in effects if has_base(effect, said, alone=False)]
    offered = kinds_at(based, present, place)
    singles = [kind.options[place] for kind in offered if kind.unite and len(kind.classes) == 1]
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
        and effect.complexity <= 1
        and Package((effect,), place).parameters == 1
    ]


def said_by(effects: Iterable[Effect]) -> Places:
    """Names and places of some effects, and of those that they contain."""
    return frozenset(
        (kind.name, effect.where) for effect in effects for kind in (type(effect), *effect.contains)
    )


def has_base(effect: Effect, said: Places, *, alone: bool = True) -> bool:
    """Whether all that an effect refines, if it does, is among what is said by others.

    Args:
        effect: The effect.
        said: Names and places of the other effects, as `said_by` gives them.
        alone: Whether one that may come alone may do so here.
    """
    return not effect.refines or any(
        all((base.name, effect.where) in said for base in bases)
        for bases in effect.refines
        if bases or alone
    )
