"""Candidate terms of an explanation, with their columns, priors and prior odds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, reduce
from math import comb, log
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.unknown_efforts import CURVES, UNKNOWN, UnknownFunction
from geodrake.effects.base import Effect, Proposer
from geodrake.effects.declarations import Role
from geodrake.effects.episode import Episode, PointEpisode
from geodrake.effects.lookup import effect_of
from geodrake.identification.logs.dataset import Dataset, is_body, is_payload
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model.robot_model import RobotModel
from geodrake.robot.joints import joints_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Key = tuple[str, tuple[str, ...]]
"""Name and place of an effect; that of an episode includes its log and time."""

_REACH = 2.0  # of a tool's center of mass, over that of the dataset's payload
_COMPACT = np.repeat([1.0, 0.5, 0.25], [1, 3, 6])  # factors of a payload of half the size
_SPREAD = 2.0 / 3.0  # inertia of a load about an axis, over its mass times squared distance
_PHYSICAL = 0.1
"""Share of a payload's prior that is physical, for any mass."""
_FURTHEST = 3.0
"""Largest number of deviations by which a parameter may be below its usual value. Smaller values
belong to a smaller shape; the smallest shape has no such bound."""


@dataclass(frozen=True)
class Price:
    """Prior odds against an effect of one kind at a place."""

    name: str
    first: float  # twice the log-odds against it in a robot without such an effect
    again: float  # the same in a robot with one elsewhere, without the odds of its joints
    joint: str = ""  # its joint, if other joints are likely to have it too
    joints: int = 0  # number of joints that may have it; 0 if joints are independent


@dataclass(frozen=True, eq=False)
class Term:
    """A candidate that a model may lack at one place: an effect, or a wrong body."""

    name: str
    where: tuple[str, ...]
    effect: Effect | None  # the effect; None for a wrong body
    columns: Indices  # (k,) its columns in the dataset
    mean: Array  # (k,) prior mean of its parameters
    information: Array  # (k, k) prior information
    price: Price  # prior odds against it
    parts: tuple[Price, ...]  # prices of contained effects with fewer parameters
    positive: Indices  # indices of its parameters with lower bounds
    covers: frozenset[Key]  # keys of itself and of contained effects
    # Alternative sets of keys, one of which must be present.
    needs: tuple[frozenset[Key], ...] = ()
    is_own: bool = False  # whether the model has the effect, whose values may have changed
    is_least: bool = False  # whether it is the smallest shape of the effect at its place

    def __repr__(self) -> str:
        return f"{self.name}@{'+'.join(self.where)}"

    @cached_property
    def log_information(self) -> float:
        """Log |Λ| of the prior, normalized over the values within bounds."""
        share = _PHYSICAL if self.is_whole else float(np.prod(ndtr(self._reach)))
        if len(self.information) == 1:  # the common case
            return float(np.log(self.information[0, 0]) - 2.0 * np.log(share))
        return float(np.linalg.slogdet(self.information)[1]) - 2.0 * float(np.log(share))

    @cached_property
    def least(self) -> Array:
        """(b,) lower bounds of `positive` parameters."""
        return np.maximum(self.mean[self.positive] - self._reach * self._spread, 0.0)

    @property
    def _spread(self) -> Array:
        return np.asarray(np.diag(self.information)[self.positive] ** -0.5)

    @property
    def _reach(self) -> Array:
        """(b,) largest number of deviations of `positive` parameters below their mean."""
        far = self.mean[self.positive] / self._spread
        return far if self.is_body or self.is_least else np.minimum(far, _FURTHEST)

    @cached_property
    def prior_distance(self) -> float:
        """Return mᵀ Λ m, the squared distance of zero from the prior mean."""
        return float(self.mean @ self.information @ self.mean)

    @cached_property
    def key(self) -> Key:
        """Return its name and place."""
        return (self.name, self.where) if self.effect is None else key_of(self.effect)

    @cached_property
    def is_body(self) -> bool:
        """Return whether it has ten inertial parameters: a payload, or a wrong body."""
        return self.effect is None or is_payload(self.effect)

    @cached_property
    def is_whole(self) -> bool:
        """Return whether it is an additional payload, which must be physical."""
        return self.effect is not None and is_body(self.effect) and len(self.positive) > 0

    @cached_property
    def joint(self) -> str | None:
        """Return the joint if it depends on that joint's motion only; None otherwise."""
        is_of_joint = self.effect is not None and self.effect.places == "joint"
        return self.where[0] if is_of_joint else None

    @cached_property
    def contains(self) -> frozenset[Key]:
        """Return the keys of effects that it replaces."""
        return self.covers - {self.key}


def is_expandable(effect: Effect) -> bool:
    """Return whether an effect's columns are slopes about an expansion point."""
    return type(effect).expanded_about is not Effect.expanded_about


def key_of(effect: Effect, kind: type[Effect] | None = None) -> Key:
    """Return the key of an effect, or of another kind at its place."""
    when = [str(effect.window[3])] if isinstance(effect, Episode) else []
    if isinstance(effect, CURVES):
        when.append(effect.curve.words())
    if isinstance(effect, PointEpisode):  # a log may have several
        when.append(f"{0.5 * (effect.start + effect.end):.0f} s")
    return (kind or effect).name, (*effect.where, *when)


def terms_of(
    model: RobotModel, dataset: Dataset, effects: Sequence[Effect], beliefs: Beliefs
) -> tuple[Term, ...]:
    """Return the terms of some effects, and of every body being wrong."""
    places: dict[type[Effect], set[tuple[str, ...]]] = {}
    for effect in effects:
        places.setdefault(type(effect), set()).add(effect.where)
    sizes, terms, fitted = _column_sizes(dataset), list[Term](), {f.effect for f in model.effects}
    smallest = dict[tuple[type[Effect], tuple[str, ...]], float]()
    for effect in effects:
        key = type(effect), effect.where
        smallest[key] = min(_first_shape(effect), smallest.get(key, np.inf))
    load = dataset.payload * np.array([1.0, *(_REACH for _ in range(3)), *(_REACH**2,) * 6])
    sides, loads = _square_reaches(model), dict[tuple[float, bool], list[tuple[Array, Array]]]()
    priced = list[tuple[Effect, list[tuple[Array, Array]], Price]]()
    for effect in effects:
        everywhere, is_own = places[type(effect)], effect in fitted
        if is_body(effect):
            side = sides.get(effect.where[0], 0.0)
            if (side, is_own) not in loads:
                loads[side, is_own] = _load_priors(load, side, beliefs, is_own=is_own)
            priors = loads[side, is_own]
            odds = float(len(priors) * len(everywhere))
        else:
            slabs = _slabs(effect, sizes[dataset.effect_columns(effect)], beliefs)
            odds = float(len(everywhere) * len(slabs))
            usual = np.array([parameter.usual for parameter in effect.parameters])
            priors = [(usual, slab) for slab in slabs]
            if is_own:  # the values in a file are as likely wrong as right
                odds = 1.0 if model.information is None else odds * beliefs.fitted
        # Effects of motors and gears at one joint are likely at others; springs and effects at a
        # pair or a body are not.
        likely = effect.places == "joint" and not is_body(effect) and not _is_spring(effect)
        peers = len(everywhere) if likely else 0
        if peers:  # `_odds_of_joints` adds the odds of the set
            odds /= peers**2 if is_own else peers
        priced.append((effect, priors, _price(effect, odds, beliefs, peers)))
    fitted_keys = {(type(effect), effect.where) for effect in fitted}
    prices = {(type(e), e.where): price for e, _, price in priced}
    for effect, priors, price in priced:
        is_own, count = effect in fitted, len(effect.parameters)
        fewer = [kind for kind in effect.contains if len(kind.parameters) < count and not is_own]
        inside = [(kind, effect.where) for kind in fewer]
        parts = tuple(prices[at] for at in inside if at in prices and at not in fitted_keys)
        bounded = [k for k, p in enumerate(effect.parameters) if p.lower == 0.0]
        bounded = [0] if is_body(effect) else bounded
        least = np.array([] if is_own else bounded, np.intp)  # a known effect may have shrunk
        covers = frozenset(key_of(effect, kind) for kind in (None, *effect.contains))
        needs = tuple(frozenset((e.name, effect.where) for e in bases) for bases in effect.refines)
        is_least = _first_shape(effect) == smallest[type(effect), effect.where]
        identity = effect.name, effect.where, effect, dataset.effect_columns(effect)
        terms += [
            Term(*identity, *p, price, parts, least, covers, needs, is_own, is_least)
            for p in priors
        ]
    return (*terms, *_wrong_bodies(model, dataset, beliefs))


def _first_shape(effect: Effect) -> float:
    """Return the first shape of an effect; infinity if it has no numeric shape."""
    value = getattr(effect, effect.shapes[0].name) if effect.shapes else None
    return float(value) if isinstance(value, int | float) else np.inf


def _load_priors(
    load: Array, square: float, beliefs: Beliefs, *, is_own: bool
) -> list[tuple[Array, Array]]:
    """Return prior means (10,) and informations (10, 10) of a body's payloads, light to heavy.

    Each mass comes with the size of the usual `load` (10,) and with half of it. If limbs branch off
    at a larger mean squared distance (m², `square`), a payload of that size replaces the half-size
    one. A payload of the model (`is_own`) may have changed either way.
    """
    shapes, wide = [load * _COMPACT, load], load.copy()
    wide[4:7] = np.maximum(load[4:7], _SPREAD * load[0] * square)
    if (wide > load).any():
        shapes = [load, wide]
    width, mean = (1.0, 0.0) if is_own else (beliefs.load, 1.0)
    loads = [mass * shape for mass in beliefs.payloads for shape in shapes]
    return [(mean * each, pullback_information(each[None], width)) for each in loads]


def _square_reaches(model: RobotModel) -> dict[str, float]:
    """Return the mean squared distance of limbs from each body with several limbs, such as a trunk.

    Distances, m², are those of the limbs' joints from Bo.
    """
    reaches = dict[str, float]()
    for lump in lumped_bodies(model.plant):
        frames = {member.index: member.X_RB for member in lump.members}
        limbs = [
            frames[joint.parent_body().index()]
            @ joint.frame_on_parent().GetFixedPoseInBodyFrame().translation()
            for joint in joints_of(model.plant)
            if joint.parent_body().index() in frames and joint.num_velocities()
        ]
        if len(limbs) > 1 and lump.name in model.load_bodies:
            reaches[lump.name] = float(np.mean(np.square(limbs).sum(axis=1)))
    return reaches


def _slabs(effect: Effect, sizes: Array, beliefs: Beliefs) -> list[Array]:
    """Return candidate prior informations (k, k) of parameters with column RMS `sizes` (k,)."""
    spread = np.array([parameter.spread for parameter in effect.parameters])
    shares = [np.full(len(sizes), beliefs.size)]
    if isinstance(effect, UnknownFunction):
        shares = [np.full(len(sizes), beliefs.unknown)]
    if isinstance(effect, CURVES):
        smooth = 1.0 / (1.0 + np.arange(len(sizes)))
        shares = [share * smooth / np.linalg.norm(smooth) for share in beliefs.curves]
    known = np.array([parameter.usual != 0.0 for parameter in effect.parameters])
    return [
        np.diag(np.where(known, spread, np.minimum(share / np.maximum(sizes, 1e-12), spread)) ** -2)
        for share in shares
    ]


_IN_MANY = Proposer.WAVES, Proposer.HANDLING
"""Proposers of effects of one of many orders or instants."""
_ODD_SHAPE = 4.0
"""Price of an exponent that is not a multiple of one half, unlike those of physical laws."""


def _price(effect: Effect, odds: float, beliefs: Beliefs, peers: int) -> Price:
    """Return the price of an effect, given the odds of its place."""
    exponent = effect.shape.get("exponent")
    odd = isinstance(exponent, float) and not (2.0 * exponent).is_integer()
    shape = beliefs.order if effect.proposer in _IN_MANY else beliefs.shape
    price = 2.0 * np.log(shape) * effect.free_shapes + _ODD_SHAPE * odd
    first = price + 2.0 * (np.log(odds) + effect.complexity * np.log(beliefs.rarer))
    joint = effect.where[0] if peers else ""
    return Price(effect.name, float(first), float(price), joint, peers)


def _is_spring(effect: Effect) -> bool:
    """Return whether an effect depends only on the position of a joint, like a spring."""
    return effect.depends_on == {"q"} and effect.proposer is not Proposer.WAVES


def _wrong_bodies(model: RobotModel, dataset: Dataset, beliefs: Beliefs) -> list[Term]:
    """Return the terms of each single body being wrong, for each prior width."""
    kind = effect_of(Role.INERTIA)
    odds = 2.0 * (
        np.log(len(model.bodies) * len(beliefs.free)) + kind.complexity * np.log(beliefs.rarer)
    )
    odds += 0.0 if model.information is None else 2.0 * np.log(beliefs.fitted)
    zero, none, terms = np.zeros(PARAMETERS_PER_BODY), np.zeros(0, np.intp), list[Term]()
    for width in beliefs.free:
        metric = pullback_information(model.phi, width)
        for k, body in enumerate(model.bodies):
            at = PARAMETERS_PER_BODY * k + np.arange(PARAMETERS_PER_BODY)
            covers, own = frozenset({(kind.name, (body,))}), metric[np.ix_(at, at)]
            # A last body is rarely wrong by itself: more likely it carries a payload.
            against = odds + (2.0 * np.log(beliefs.inner) if body in model.load_bodies else 0.0)
            price = Price(kind.name, float(against), float(against))
            terms.append(Term(kind.name, (body,), None, at, zero, own, price, (), none, covers))
    return terms


def _column_sizes(dataset: Dataset) -> Array:
    """Return the RMS (p,) of every column relative to its joint's effort; the largest over joints.

    The effort of a joint without a motor is the effort that its motion needs.
    """
    width = 1 + max(int(data.columns.max(initial=0)) for data in dataset.data)
    sizes = np.zeros(width)
    for data, deviation in zip(dataset.data, dataset.effort_std, strict=True):
        rows, at = int(data.samples.sum()), data.columns
        if rows and deviation > 0.0:
            powers = np.square(data.factors[:, :, : len(at) + 1]).sum(axis=(0, 1)) / rows
            scale = max(float(np.sqrt(powers[-1])), float(deviation))
            sizes[at] = np.maximum(sizes[at], np.sqrt(powers[:-1]) / scale)
    return sizes


Terms = tuple[Term, ...]


def names_and_places(terms: Iterable[Term]) -> tuple[str, tuple[str, ...]]:
    """Return the names of terms, joined by " + ", and their places, each once."""
    names, places = [t.name for t in terms], [place for t in terms for place in t.where]
    return " + ".join(dict.fromkeys(names)), tuple(dict.fromkeys(places))


Options = list[list[int]]
"""Alternative requirements: each is a list of bit sets, of which one term must be present."""


class Compatibility:
    """Compatibility of terms with each other and with the model's effects, by bit sets of terms.

    Each place can be taken once, by an effect or by one that contains it, and the effects that a
    term refines must be present. A payload during an episode and a simultaneous contact of the body
    are alternatives, as are an unknown function and an effect that contains a constant: both
    constants together imitate what happens at reversals. `known` are the keys of the model's
    effects.
    """

    def __init__(self, terms: Terms, known: frozenset[Key]) -> None:
        self._bit = {term: 1 << k for k, term in enumerate(terms)}
        at, containing, bodies, covers, unknown_at, constants = (
            defaultdict[Any, int](int) for _ in range(6)
        )
        for term, bit in self._bit.items():
            at[term.key] |= bit
            for key in term.contains:
                containing[key] |= bit
            for key in term.covers:
                covers[key] |= bit
            if term.is_body:
                bodies[term.where] |= bit
        episodes = {term for term in terms if isinstance(term.effect, Episode)}
        unknown = {term for term in terms if term.joint and isinstance(term.effect, UNKNOWN)}
        for term in unknown:
            unknown_at[term.joint] |= self._bit[term]
        for term in filter(_has_constant, terms):
            constants[term.joint] |= self._bit[term]
        self._against, self._needs = dict[Term, int](), dict[Term, Options]()
        for term in terms:
            against = at[term.key] | containing[term.key]
            against |= reduce(or_, (at[key] for key in term.contains), 0)
            against |= bodies[term.where] if term.is_body else 0
            overlapping = (
                [self._bit[o] for o in episodes if _overlaps(term, o)] if term in episodes else []
            )
            against |= reduce(or_, overlapping, 0)
            against |= constants[term.joint] if term in unknown else 0
            against |= unknown_at[term.joint] if _has_constant(term) else 0
            self._against[term] = -1 if term.key in known and not term.is_own else against
            if term.needs:
                self._needs[term] = [
                    [covers[key] for key in option - known] for option in term.needs
                ]

    def holds(self, terms: Iterable[Term]) -> bool:
        """Return whether terms are compatible."""
        return bool(self.filter((), [tuple(terms)]))

    def filter(self, rest: Iterable[Term], packages: Iterable[Terms]) -> list[Terms]:
        """Return the packages of terms that are compatible with the rest."""
        present, needing = 0, list[Options]()
        for term in rest:
            if self._against[term] < 0 or self._against[term] & present:
                return []
            present |= self._bit[term]
            needing += [self._needs[term]] if term in self._needs else []
        needing = [options for options in needing if not _is_met(options, present)]
        return [each for each in packages if self._fits(each, present, needing)]

    def _fits(self, added: Terms, present: int, needing: list[Options]) -> bool:
        needs = needing
        for term in added:
            if self._against[term] < 0 or self._against[term] & present:
                return False
            present |= self._bit[term]
            if term in self._needs:
                needs = [*needs, self._needs[term]]
        return not needs or all(_is_met(options, present) for options in needs)


def _has_constant(term: Term) -> bool:
    """Return whether an effect of a joint contains one that is the same at all times."""
    kinds = [] if term.effect is None else term.effect.contains
    return term.joint is not None and not all(kind.depends_on for kind in kinds)


def _overlaps(term: Term, other: Term) -> bool:
    """Return whether two episodes of a body overlap mostly in time."""
    a, b = term.effect, other.effect
    if not isinstance(a, Episode) or not isinstance(b, Episode) or term.where[0] != other.where[0]:
        return False
    if term is other or term.key == other.key or not a.is_of(b.window[3]):
        return False
    (start, end), (other_start, other_end) = a.window[:2], b.window[:2]
    if start is None or end is None or other_start is None or other_end is None:
        return False
    shared = min(end, other_end) - max(start, other_start)
    return 2.0 * shared > max(end, other_end) - min(start, other_start)


def _is_met(options: Options, present: int) -> bool:
    return any(all(present & key for key in option) for option in options)


def odds_against(terms: Iterable[Term]) -> float:
    """Return twice the log prior odds against terms.

    A joint also counts as having the effects that its terms contain, if other joints have them.
    """
    terms, total = tuple(terms), 0.0
    joints, most = dict[str, set[str]](), dict[str, int]()
    for price in sorted((term.price for term in terms), key=lambda each: -each.first):
        if not price.joints:
            total += price.first
        elif price.name in joints:
            total += price.again
            joints[price.name].add(price.joint)
        else:
            total += price.first
            joints[price.name], most[price.name] = {price.joint}, price.joints
    for term in terms:
        for part in term.parts:
            if part.name in joints:
                joints[part.name].add(part.joint)
    return total + _odds_of_joints([(places, most[name]) for name, places in joints.items()])


def _odds_of_joints(kinds: Sequence[tuple[set[str], int]]) -> float:
    """Return twice the log-odds against kinds at sets of joints, with numbers of possible joints.

    All numbers of joints are equally likely, and so are all sets of one size. If another kind is at
    more joints, a kind is at some of these only with probability 1/2, as a motor or gear with one
    kind of friction often has others.
    """
    total, previous = 0.0, list[set[str]]()
    for joints, most in sorted(kinds, key=lambda each: -len(each[0])):
        share = _share(most, len(joints))
        if previous:
            nested = sum(_share(len(other), len(joints)) for other in previous if joints <= other)
            share = 0.5 * (share + nested / len(previous))
        total -= 2.0 * log(share)
        previous.append(joints)
    return total


@cache
def _share(most: int, count: int) -> float:
    """Return the probability of `count` of `most` joints, if all counts are equally likely."""
    return 1.0 / (most * comb(most, count))
