"""Moves between neighbouring explanations: additions, removals and replacements of terms."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from geodrake.diagnosis.log_model import Choice, Fit, LogModel
from geodrake.diagnosis.neighbourhood import Dropped, Neighbourhood
from geodrake.diagnosis.terms import Term, Terms
from geodrake.diagnosis.unknown_efforts import UNKNOWN

_MOST = 14
"""Number of most promising neighbours that are fitted."""
_POOL = 18
"""Number of effects of a joint that are tried in pairs, besides all simple ones."""
_HOPE = -10.0
"""Least gain of a neighbour to be fitted, at less than a hundredth of the probability."""
_WRONG_BODIES = 2  # that are tried with other widths of the bodies
_LOSS = -25.0  # least gain of a removal


@dataclass(frozen=True, eq=False)
class Move:
    """Neighbour of an explanation."""

    choice: Choice
    gain: float  # change of the score, at the noise of the fit
    added: Terms = ()  # the added terms, if they are needed later


def neighbours(
    model: LogModel,
    fit: Fit,
    *,
    most: int = _MOST,
    joints: Collection[str] | None = None,
    further: int = 0,
    common: bool = False,
) -> list[Choice]:
    """Find the most promising neighbours of an explanation.

    `most` does not count the best of all joints together, other widths of the bodies, the best
    delays, and `further` effects that gain most if they leave only white noise. If `joints` are
    given, only their own effects may change, and `further` is ignored. If `common`, only common
    effects and payloads are added.
    """
    finder = _MoveFinder(model, fit, common=common)
    moves = finder.moves() if joints is None else finder.rebuilds(joints)
    promising = sorted(moves, key=lambda move: -move.gain)
    delayed = [] if joints is not None else [*finder.delays()]
    best = list({move.choice.key: move for move in promising}.values())[:most]
    choices = [move.choice for move in best]
    gaining = [move for move in (*promising, *delayed) if move.gain > 0.0]
    gaining.sort(key=lambda move: -move.gain)
    if (several := together(model, fit, [move.choice for move in gaining])) is not None:
        choices.append(several)
    if joints is not None:
        return choices
    choices += finder.white_noise_additions(further)
    for move in best[: most // 2]:
        changed = set(move.choice.terms) ^ set(fit.terms)
        if any(term.joint is None for term in changed):  # bodies may change less
            choices += finder.other_widths(move)
    choices += other_widths(model, fit.choice)
    for move in finder.body_additions():
        choices += [move.choice, *finder.other_widths(move)]
    for choice in finder.body_removals():
        wider = [each for each in other_widths(model, choice) if each.width > fit.choice.width]
        choices += [choice, *wider]
    choices += [move.choice for move in delayed if move.gain > _HOPE]
    for move in delayed:
        if len({*move.choice.delay}) == 1:
            choices += _without_needless(model, fit, move.choice)
    return choices


def together(model: LogModel, fit: Fit, choices: Iterable[Choice]) -> Choice | None:
    """Combine the best changes of single joints; return None if fewer than two joints change.

    Choices are in order of preference. Only those count that change nothing but the effects or the
    delay of one joint, and that are compatible with the ones before them.
    """
    names, previous, changed = model.model.joints, fit.choice, set[str]()
    terms, delay = previous.terms, np.array(previous.delay)
    for choice in choices:
        differs = model.lateness(choice) != model.lateness(previous)
        joints = {term.joint for term in {*previous.terms} ^ {*choice.terms}}
        joints |= {names[k] for k in np.flatnonzero(differs)}
        joint = next(iter(joints), None)
        if len(joints) != 1 or joint is None or joint in changed or choice.width != previous.width:
            continue
        own = [term for term in choice.terms if term.joint == joint]
        combined = (*(term for term in terms if term.joint != joint), *own)
        if model.are_compatible(combined):
            terms = combined
            delay = np.where(differs, choice.delay, delay)
            changed.add(joint)
    combined_delay = tuple(delay.tolist())
    return model.choice(previous, terms, delay=combined_delay) if len(changed) > 1 else None


def additions(model: LogModel, fit: Fit) -> list[Fit]:
    """Return fits with effects of one name added at every place where they gain, best first."""
    moves = _MoveFinder(model, fit).additions()
    choices = [
        move.choice
        for move in moves
        if not any(isinstance(term.effect, UNKNOWN) for term in move.choice.terms)
    ]
    return model.ranked(choices, model.shares(fit), fit.noise)


def single_replacements(model: LogModel, fit: Fit) -> Terms:
    """Return the shaped effect that best replaces all effects of each crowded joint.

    A joint is crowded if it has several effects that are not simple: together they may imitate one
    effect whose shape is not on the grid.
    """
    finder, best = _MoveFinder(model, fit), list[Term]()
    for joint, offered in finder.by_joint.items():
        present = [term for term in fit.terms if term.joint == joint]
        shaped = [(t,) for t in offered if t.effect is not None and t.effect.free_shapes]
        if sum(_complexity(term) > 0 for term in present) > 1 and shaped:
            gains = finder.around.gains(shaped, finder.around.dropped(present))
            best.append(shaped[int(np.argmax(gains))][0])
    return tuple(best)


def other_widths(model: LogModel, choice: Choice) -> list[Choice]:
    """Return an explanation with each other prior width of the bodies."""
    others = [width for width in model.widths if width != choice.width]
    return [replace(choice, width=width) for width in others]


def _without_needless(model: LogModel, fit: Fit, delayed: Choice) -> list[Choice]:
    """Return a delayed explanation without terms that imitated the delay."""
    finder = _MoveFinder(model, model.unbounded(delayed, model.shares(fit), fit.noise))
    needless = [term for term in delayed.terms if any(m.gain > 0.0 for m in finder.removals(term))]
    kept = tuple(term for term in delayed.terms if term not in needless)
    return [model.choice(delayed, kept)] if needless and model.are_compatible(kept) else []


class _MoveFinder:
    """Generator of moves from one fit."""

    def __init__(self, model: LogModel, fit: Fit, *, common: bool = False) -> None:
        self.model, self.fit = model, fit
        self.terms = tuple(t for t in model.terms if _is_common(t)) if common else model.terms
        self.around = Neighbourhood(model, fit)
        self.base = model.odds_against(fit.choice)
        self.by_joint: dict[str, list[Term]] = {}
        for term in self.terms:
            if term.joint is not None:
                self.by_joint.setdefault(term.joint, []).append(term)
        kinds = dict[str, list[Term]]()
        for joint_terms in self.by_joint.values():
            named = dict[str, list[Term]]()
            for term in joint_terms:
                named.setdefault(term.name, []).append(term)
            for name, terms in named.items():
                if len(terms) == 1:  # it has at most one shape
                    kinds.setdefault(name, []).append(terms[0])
        self.everywhere = [*kinds.values()]

    @cached_property
    def _absent(self) -> list[Term]:
        """Candidates that are not in the fit."""
        present = set(self.fit.terms)
        return [term for term in self.terms if term not in present]

    @cached_property
    def _absent_shared(self) -> list[Term]:
        """Those of them that do not belong to a single joint."""
        return [term for term in self._absent if term.joint is None]

    def moves(self) -> Iterator[Move]:
        """Yield all moves that may gain."""
        yield from self.additions()
        yield from self.rebuilds(self.by_joint)
        for term in self.fit.terms:
            yield from self._replacements(term)
        yield from self._kind_replacements()

    def _choice(self, terms: Iterable[Term]) -> Choice:
        return self.model.choice(self.fit.choice, terms)

    def _move(self, terms: Iterable[Term], gain: float, added: Terms = ()) -> Move:
        """Return a move, given its gain without prior odds."""
        choice = self._choice(terms)
        return Move(choice, gain + self.base - self.model.odds_against(choice), added)

    def _offers(
        self, rest: Terms, packages: Iterable[Terms], dropped: Dropped | None = None
    ) -> list[tuple[float, Terms]]:
        """Return packages that can be added to the rest, with their gains without prior odds."""
        possible = self.model.compatibility.filter(rest, packages)
        gains = self.around.profiled_gains(possible, dropped)
        order = [k for k in np.argsort(-gains, kind="stable") if np.isfinite(gains[k])]
        return [(float(gains[k]), possible[k]) for k in order]

    def _moves(
        self,
        rest: Terms,
        packages: Iterable[Terms],
        dropped: Dropped | None = None,
        *,
        most: int | None = _MOST,
    ) -> list[Move]:
        """Return moves that add packages to the rest and may gain enough, the best first."""
        loss = 0.0 if dropped is None else dropped.loss
        moves = [
            self._move((*rest, *added), gain + loss, added)
            for gain, added in self._offers(rest, packages, dropped)[:most]
        ]
        return sorted((m for m in moves if m.gain > _HOPE), key=lambda move: -move.gain)

    def delays(self) -> Iterator[Move]:
        """Change the delay of the efforts of one joint, or of all."""
        for delay, gain in self.around.delays():
            delayed = replace(self.fit.choice, delay=delay)
            yield Move(delayed, gain + self.base - self.model.odds_against(delayed))

    def additions(self) -> Iterator[Move]:
        """Add one term, or one kind at all joints."""
        present = self.fit.terms
        moves = self._moves(present, [(term,) for term in self._absent], most=None)
        kinds, seen = dict[str, dict[str, tuple[Term, float]]](), set[str | None]()
        for k, move in enumerate(moves):
            (term,) = move.added
            if k < _MOST or (term.joint is not None and term.joint not in seen):
                yield move
            seen.add(term.joint)
            if term.joint is not None:
                kinds.setdefault(term.name, {}).setdefault(term.joint, (term, move.gain))
        for group in kinds.values():
            if len(group) > 1:
                terms, gains = zip(*group.values(), strict=True)
                yield Move(self._choice((*present, *terms)), sum(gains))

    def white_noise_additions(self, most: int) -> list[Choice]:
        """Add an effect of a joint that would gain if it left white noise, the best first.

        It replaces the effects that it contains.
        """
        present, joints, offered = self.fit.terms, self.model.dataset.joints, dict[Terms, Terms]()
        for term in self.terms if most else ():
            if term.joint in joints and term not in present and self.model.only_joint[term] >= 0:
                removed = tuple(other for other in present if other.key in term.contains)
                offered[removed] = (*offered.get(removed, ()), term)
        ranked = list[tuple[float, Choice]]()
        for removed, added in offered.items():
            rest = tuple(term for term in present if term not in removed)
            dropped = self.around.dropped(removed) if removed else None
            loss = 0.0 if dropped is None else dropped.loss
            possible = [t for (t,) in self.model.compatibility.filter(rest, [(t,) for t in added])]
            gains = self.around.white_noise_gains(possible, dropped) + self.base + loss
            choices = [self._choice((*rest, term)) for term in possible]
            odds = [self.model.odds_against(choice) for choice in choices]
            ranked += zip((gains - odds).tolist(), choices, strict=True)
        ranked.sort(key=lambda pair: -pair[0])
        return [choice for gain, choice in ranked[:most] if gain > 0.0]

    def rebuilds(self, joints: Collection[str]) -> Iterator[Move]:
        """Choose the own effects of some joints again: one, a pair, or with simple ones."""
        present = self.fit.terms
        for joint in joints:
            present_here = [term for term in present if term.joint == joint]
            rest = tuple(term for term in present if term not in present_here)
            if not self.model.are_compatible(rest):
                continue
            dropped = self.around.dropped(present_here) if present_here else None
            offered = self._packages(self.by_joint.get(joint, []), present_here, dropped)
            yield from self._moves(rest, offered, dropped)

    def _packages(
        self, offered: list[Term], present: list[Term], dropped: Dropped | None
    ) -> list[Terms]:
        """Return the candidate replacements of the effects at a joint."""
        gains = self.around.gains([(term,) for term in offered], dropped)
        best = [offered[k] for k in np.argsort(-gains)[:_POOL]]
        simple = [t for t in offered if _complexity(t) <= 1 and len(t.columns) == 1]
        pool = list(dict.fromkeys([*best, *simple, *present]))
        packages: list[Terms] = [(term,) for term in pool]
        packages += [pair for pair in combinations(pool, 2) if pair[0].key != pair[1].key]
        plain = [term for term in simple if _complexity(term) == 0]
        packages += [
            (*pair, term) for pair in combinations(plain, 2) for term in pool if term not in pair
        ]
        if len(present) > 2:
            packages += [tuple(t for t in present if t is not old) for old in present]
        # Replace one or two effects by one, or one by several simple ones.
        trades: list[tuple[Terms, Terms]] = [((old,), (t,)) for old in present for t in pool]
        for old in present:
            for count in range(2, max(3, len(old.columns))):
                trades += [((old,), simpler) for simpler in combinations(plain, count)]
        trades += [(pair, (t,)) for pair in combinations(present, 2) for t in pool]
        packages += [
            (*(t for t in present if t not in removed), *added)
            for removed, added in trades
            if not set(added) & set(present)
        ]
        # Replace an effect by any other shape of it, without unknown functions.
        known = [t for t in present if not isinstance(t.effect, UNKNOWN)]
        packages += [
            tuple(other if term is old else term for term in known)
            for old in known
            for other in offered
            if other.key == old.key
        ]
        unique = {frozenset(package): package for package in packages}
        unique.pop(frozenset(present), None)
        return [*unique.values()]

    def removals(self, term: Term) -> Iterator[Move]:
        """Drop one term, if the others do not need it."""
        rest = tuple(other for other in self.fit.terms if other is not term)
        return self._without(rest, self.around.dropped([term]))

    def _replacements(self, term: Term) -> Iterator[Move]:
        """Drop one term, or replace it; not both old and new terms belong to one joint."""
        dropped = self.around.dropped([term])
        rest = tuple(other for other in self.fit.terms if other is not term)
        yield from self._without(rest, dropped)
        offered = self._absent if term.joint is None else self._absent_shared
        others: list[Terms] = [(other,) for other in offered]
        if term.joint is None:  # one kind at several joints may replace it
            for kind in self.everywhere:
                free = [t for t in kind if t not in rest]
                gains = self.around.gains([(t,) for t in free], dropped)
                best = [free[k] for k in np.argsort(-gains)]
                others += [tuple(best[:count]) for count in range(2, len(best) + 1)]
        yield from self._moves(rest, others, dropped)

    def _without(self, rest: Terms, dropped: Dropped) -> Iterator[Move]:
        """Drop terms that are not in the rest, if the rest does not need them."""
        if self.model.are_compatible(rest):
            move = self._move(rest, dropped.loss)
            if move.gain > _LOSS:
                yield move

    def _kind_replacements(self) -> Iterator[Move]:
        """Drop all effects of one name, or replace them by another kind or by one shared effect."""
        present = self.fit.terms
        for name in dict.fromkeys(term.name for term in present):
            removed = [term for term in present if term.name == name]
            rest = tuple(term for term in present if term.name != name)
            if len(removed) < 2 or not self.model.are_compatible(rest):
                continue
            dropped, joints = self.around.dropped(removed), {term.joint for term in removed}
            yield from self._without(rest, dropped)
            if joints == {None}:
                continue
            others = [term for term in self.terms if term.name != name]
            yield from self._moves(rest, [(term,) for term in self._absent_shared], dropped)
            best = dict[str, dict[str, tuple[float, Term]]]()
            candidates = [(term,) for term in others if term.joint in joints]
            for gain, (term,) in self._offers(rest, candidates, dropped):
                best.setdefault(term.name, {}).setdefault(term.where[0], (gain, term))
            for group in best.values():
                terms = (*rest, *(term for _, term in group.values()))
                if len(group) == len(joints) and self.model.are_compatible(terms):
                    yield self._move(terms, dropped.loss + sum(gain for gain, _ in group.values()))

    def other_widths(self, move: Move) -> list[Choice]:
        """Return a move's explanation with other widths of the bodies that may gain enough.

        If a term is added, wider bodies gain no more than they do without it, as both explain the
        same errors.
        """
        choices, old = other_widths(self.model, move.choice), self.fit.choice.width
        if not set(self.fit.terms) <= set(move.choice.terms):
            return choices
        return [c for c in choices if c.width < old or move.gain + self._widening[c.width] > _HOPE]

    @cached_property
    def _widening(self) -> dict[float, float]:
        """Return the change of the fit's score by each width of the bodies."""
        model, fit = self.model, self.fit
        shares = (fit.weights * fit.noise)[: len(model.rows)]
        choices = [replace(fit.choice, width=width) for width in model.widths]
        score = model.unbounded(fit.choice, shares, fit.noise).score
        return {t.width: model.unbounded(t, shares, fit.noise).score - score for t in choices}

    def body_additions(self) -> Iterator[Move]:
        """Add a payload, a wrong body or an effect of the whole robot, in place of wider bodies.

        Its size is chosen with the narrowest bodies: with wide ones it may seem to gain nothing.
        Of wrong bodies, the most promising ones are tried.
        """
        model, present = self.model, self.fit.terms
        last, width, around = set(model.model.load_bodies), model.widths[0], self.around
        if self.fit.choice.width > width:
            held, shares = replace(self.fit.choice, width=width), self.fit.weights * self.fit.noise
            around = Neighbourhood(model, model.unbounded(held, shares[: len(model.rows)]))
        kinds, moves = dict[object, list[Terms]](), list[Move]()
        for term in self.terms:
            spares = _spares_bodies(term) and (not term.is_body or term.where[0] in last)
            if spares or term.effect is None:
                kinds.setdefault(term.effect or term.key, []).append((term,))
        for offered in kinds.values():
            possible = model.compatibility.filter(present, offered)
            gains = around.profiled_gains(possible)
            if np.isfinite(gains).any():
                best = possible[int(np.argmax(gains))]
                moves.append(self._move((*present, *best), float(gains.max()), best))
        moves = [move for move in moves if move.gain > _HOPE]  # wider bodies lower the gain
        wrong = [move for move in moves if move.added[0].effect is None]
        yield from (move for move in moves if move not in wrong)
        yield from sorted(wrong, key=lambda move: -move.gain)[:_WRONG_BODIES]

    def body_removals(self) -> Iterator[Choice]:
        """Drop a payload, a wrong body, or another effect of the whole robot.

        At the noise of the fit, which may be lower with it, this would lose too much; wider bodies
        may also replace it.
        """
        for term in self.fit.terms:
            rest = tuple(other for other in self.fit.terms if other is not term)
            if (_spares_bodies(term) or term.is_body) and self.model.are_compatible(rest):
                yield self._choice(rest)


def _spares_bodies(term: Term) -> bool:
    """Return whether a term is a payload, or another effect of the whole robot."""
    return term.is_whole or (term.effect is not None and term.effect.places == "robot")


def _is_common(term: Term) -> bool:
    """Return whether a term is an effect that any joint may have, or a payload."""
    return term.is_whole or (term.effect is not None and _complexity(term) == 0)


def _complexity(term: Term) -> int:
    return 0 if term.effect is None else term.effect.complexity
