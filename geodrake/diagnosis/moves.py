"""Moves from one explanation to its neighbours: terms that come, go, or take others' places."""

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
"""So many neighbours, those that promise most, are fitted."""
_POOL = 18
"""So many effects of a joint, and all simple ones, are tried in pairs there."""
_HOPE = -10.0
"""A neighbour that promises less is not fitted: it has less than a hundredth of the probability."""
_LOSS = -25.0


@dataclass(frozen=True, eq=False)
class Move:
    """A neighbour of an explanation."""

    choice: Choice
    gain: float  # what it adds to the score, at the noise of the fit
    come: Terms = ()  # the terms that come, where that is not plain


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

    `most` counts them beside other widths of the bodies and the best delays, and beside `further`
    effects that promise most if they leave only white noise. If `joints` are given, their own
    effects alone may change, and `further` does not count. If `common`, only what any joint may
    have is added, and payloads.
    """
    finder = _Finder(model, fit, common=common)
    moves = finder.moves() if joints is None else finder.rebuilt(joints)
    promising = sorted(moves, key=lambda move: -move.gain)
    best = list({move.choice.key: move for move in promising}.values())[:most]
    found = [move.choice for move in best]
    if joints is not None:
        return found
    found += finder.hopeful(further)
    for move in best[: most // 2]:
        changed = set(move.choice.terms) ^ set(fit.terms)
        if any(term.joint is None for term in changed):  # it may spare bodies their way
            found += finder.other_widths(move)
    found += other_widths(model, fit.choice)
    for move in finder.sparing():
        found += [move.choice, *finder.other_widths(move)]
    for choice in finder.unspared():
        found += [each for each in other_widths(model, choice) if each.width > fit.choice.width]
    was, base = fit.choice, finder.base
    for delay, gain in finder.around.delays():
        late = replace(was, delay=delay)
        if gain + base - model.odds_against(late) > _HOPE:
            found.append(late)
        if len({*delay}) == 1:
            found += _without_needless(model, fit, late)
    return found


def additions(model: LogModel, fit: Fit) -> list[Fit]:
    """Add effects of one name to an explanation at every place where they gain, best first."""
    moves = _Finder(model, fit).added()
    choices = [
        move.choice
        for move in moves
        if not any(isinstance(term.effect, UNKNOWN) for term in move.choice.terms)
    ]
    return model.ranked(choices, model.shares(fit), fit.noise)


def alone(model: LogModel, fit: Fit) -> Terms:
    """Return the shaped effect that best replaces all effects of each crowded joint.

    A joint is crowded if several of its effects are not simple: together they may imitate one
    effect whose shape is not on the grid.
    """
    finder, best = _Finder(model, fit), list[Term]()
    for joint, offered in finder.by_joint.items():
        here = [term for term in fit.terms if term.joint == joint]
        shaped = [(t,) for t in offered if t.effect is not None and t.effect.free_shapes]
        if sum(_complexity(term) > 0 for term in here) > 1 and shaped:
            gains = finder.around.gains(shaped, finder.around.dropped(here))
            best.append(shaped[int(np.argmax(gains))][0])
    return tuple(best)


def other_widths(model: LogModel, choice: Choice) -> list[Choice]:
    """Return an explanation with each other width of the bodies."""
    others = [width for width in model.widths if width != choice.width]
    return [replace(choice, width=width) for width in others]


def _without_needless(model: LogModel, fit: Fit, late: Choice) -> list[Choice]:
    """Drop what may have made up for a delay of all efforts."""
    finder = _Finder(model, model.unbounded(late, model.shares(fit), fit.noise))
    needless = [term for term in late.terms if any(m.gain > 0.0 for m in finder.leaving(term))]
    kept = tuple(term for term in late.terms if term not in needless)
    return [model.choice(late, kept)] if needless and model.are_compatible(kept) else []


class _Finder:
    """Finds the neighbours of one fit."""

    def __init__(self, model: LogModel, fit: Fit, *, common: bool = False) -> None:
        self.model, self.fit = model, fit
        self.terms = tuple(t for t in model.terms if is_common(t)) if common else model.terms
        self.around = Neighbourhood(model, fit)
        self.base = model.odds_against(fit.choice)
        self.by_joint: dict[str, list[Term]] = {}
        for term in self.terms:
            if term.joint is not None:
                self.by_joint.setdefault(term.joint, []).append(term)
        kinds = dict[str, list[Term]]()
        for here in self.by_joint.values():
            named = dict[str, list[Term]]()
            for term in here:
                named.setdefault(term.name, []).append(term)
            for name, terms in named.items():
                if len(terms) == 1:  # it has no shape, or one
                    kinds.setdefault(name, []).append(terms[0])
        self.everywhere = [*kinds.values()]

    def moves(self) -> Iterator[Move]:
        """Return all moves that promise a gain."""
        yield from self.added()
        yield from self.rebuilt(self.by_joint)
        for term in self.fit.terms:
            yield from self._replaced(term)
        yield from self._kinds_replaced()

    def _choice(self, terms: Iterable[Term]) -> Choice:
        return self.model.choice(self.fit.choice, terms)

    def _move(self, terms: Iterable[Term], gain: float, come: Terms = ()) -> Move:
        """Return a move by its gain without prior odds."""
        choice = self._choice(terms)
        return Move(choice, gain + self.base - self.model.odds_against(choice), come)

    def _offers(
        self, rest: Terms, packages: Iterable[Terms], dropped: Dropped | None = None
    ) -> list[tuple[float, Terms]]:
        """Return packages that may come to the rest, by their gains without prior odds."""
        possible = self.model.compatibility.beside(rest, packages)
        gains = self.around.promises(possible, dropped)
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
        """Return moves to packages beside the rest that may be worth a fit, the best first."""
        loss = 0.0 if dropped is None else dropped.loss
        moves = [
            self._move((*rest, *come), gain + loss, come)
            for gain, come in self._offers(rest, packages, dropped)[:most]
        ]
        return sorted((m for m in moves if m.gain > _HOPE), key=lambda move: -move.gain)

    def added(self) -> Iterator[Move]:
        """Add one term, the best at every joint together, or one kind at all joints together."""
        present = self.fit.terms
        offered = [(term,) for term in self.terms if term not in present]
        moves = self._moves(present, offered, most=None)
        yield from moves[:_MOST]
        best, kinds = dict[str, tuple[Term, float]](), dict[str, dict[str, tuple[Term, float]]]()
        for move in moves:
            (term,) = move.come
            if term.joint is not None:
                kinds.setdefault(term.name, {}).setdefault(term.joint, (term, move.gain))
                if move.gain > 0.0:
                    best.setdefault(term.joint, (term, move.gain))
        for group in (best, *kinds.values()):
            if len(group) > 1:
                terms, found = zip(*group.values(), strict=True)
                yield Move(self._choice((*present, *terms)), sum(found))

    def hopeful(self, most: int) -> list[Choice]:
        """Add one effect of a joint that would gain if it left white noise, the best first.

        It takes the place of those that it contains.
        """
        present, joints, offered = self.fit.terms, self.model.dataset.joints, dict[Terms, Terms]()
        for term in self.terms if most else ():
            if term.joint in joints and term not in present and self.model.felt_by[term] >= 0:
                gone = tuple(other for other in present if other.key in term.contains)
                offered[gone] = (*offered.get(gone, ()), term)
        found = list[tuple[float, Choice]]()
        for gone, come in offered.items():
            rest = tuple(term for term in present if term not in gone)
            dropped = self.around.dropped(gone) if gone else None
            loss = 0.0 if dropped is None else dropped.loss
            possible = [t for (t,) in self.model.compatibility.beside(rest, [(t,) for t in come])]
            hopes = self.around.hopes(possible, dropped) + self.base + loss
            choices = [self._choice((*rest, term)) for term in possible]
            odds = [self.model.odds_against(choice) for choice in choices]
            found += zip((hopes - odds).tolist(), choices, strict=True)
        found.sort(key=lambda each: -each[0])
        return [choice for hope, choice in found[:most] if hope > 0.0]

    def rebuilt(self, joints: Collection[str]) -> Iterator[Move]:
        """Choose the own effects of some joints anew: alone, as pairs, and beside simple ones."""
        present, every, gone = self.fit.terms, list[Move](), set[Term]()
        for joint in joints:
            here = [term for term in present if term.joint == joint]
            rest = tuple(term for term in present if term not in here)
            if not self.model.are_compatible(rest):
                continue
            dropped = self.around.dropped(here) if here else None
            offered = self._packages(self.by_joint.get(joint, []), here, dropped)
            moves = self._moves(rest, offered, dropped)
            yield from moves
            if moves and moves[0].gain > 0.0:
                every.append(moves[0])
                gone.update(here)
        if len(every) > 1:
            kept = [term for term in present if term not in gone]
            terms = (*kept, *(term for move in every for term in move.come))
            if self.model.are_compatible(terms):
                yield Move(self._choice(terms), sum(move.gain for move in every))

    def _packages(
        self, offered: list[Term], here: list[Term], dropped: Dropped | None
    ) -> list[Terms]:
        """Return what may replace the effects at a joint."""
        gains = self.around.gains([(term,) for term in offered], dropped)
        best = [offered[k] for k in np.argsort(-gains)[:_POOL]]
        simple = [t for t in offered if _complexity(t) <= 1 and len(t.columns) == 1]
        pool = list(dict.fromkeys([*best, *simple, *here]))
        packages: list[Terms] = [(term,) for term in pool]
        packages += [pair for pair in combinations(pool, 2) if pair[0].key != pair[1].key]
        plain = [term for term in simple if _complexity(term) == 0]
        packages += [
            (*pair, term) for pair in combinations(plain, 2) for term in pool if term not in pair
        ]
        if len(here) > 2:
            packages += [tuple(t for t in here if t is not one) for one in here]
        # One takes the place of one or of two, or two and more simple ones that of one.
        trades: list[tuple[Terms, Terms]] = [((one,), (t,)) for one in here for t in pool]
        for one in here:
            for count in range(2, max(3, len(one.columns))):
                trades += [((one,), simpler) for simpler in combinations(plain, count)]
        trades += [(pair, (t,)) for pair in combinations(here, 2) for t in pool]
        packages += [
            (*(t for t in here if t not in gone), *come)
            for gone, come in trades
            if not set(come) & set(here)
        ]
        # Any other shape of an effect may take its place, without unknown functions.
        known = [t for t in here if not isinstance(t.effect, UNKNOWN)]
        packages += [
            tuple(other if term is own else term for term in known)
            for own in known
            for other in offered
            if other.key == own.key
        ]
        unique = {frozenset(package): package for package in packages}
        unique.pop(frozenset(here), None)
        return [*unique.values()]

    def leaving(self, term: Term) -> Iterator[Move]:
        """Drop one term, if the others may be without it."""
        rest = tuple(other for other in self.fit.terms if other is not term)
        return self._without(rest, self.around.dropped([term]))

    def _replaced(self, term: Term) -> Iterator[Move]:
        """Drop one term, or replace it by others, one of which does not belong to one joint."""
        present, dropped = self.fit.terms, self.around.dropped([term])
        rest = tuple(other for other in present if other is not term)
        yield from self._without(rest, dropped)
        others: list[Terms] = [
            (other,)
            for other in self.terms
            if other not in present and (term.joint is None or other.joint is None)
        ]
        if term.joint is None:  # what it does together may be of one kind at several joints
            for kind in self.everywhere:
                free = [t for t in kind if t not in rest]
                gains = self.around.gains([(t,) for t in free], dropped)
                best = [free[k] for k in np.argsort(-gains)]
                others += [tuple(best[:count]) for count in range(2, len(best) + 1)]
        yield from self._moves(rest, others, dropped)

    def _without(self, rest: Terms, dropped: Dropped) -> Iterator[Move]:
        """Drop what is not in the rest, if that may be without it."""
        if self.model.are_compatible(rest):
            move = self._move(rest, dropped.loss)
            if move.gain > _LOSS:
                yield move

    def _kinds_replaced(self) -> Iterator[Move]:
        """Drop all effects of one name, or replace them by another kind, or by one for all."""
        present = self.fit.terms
        for name in dict.fromkeys(term.name for term in present):
            gone = [term for term in present if term.name == name]
            rest = tuple(term for term in present if term.name != name)
            if len(gone) < 2 or not self.model.are_compatible(rest):
                continue
            dropped, joints = self.around.dropped(gone), {term.joint for term in gone}
            yield from self._without(rest, dropped)
            if joints == {None}:
                continue
            others = [term for term in self.terms if term.name != name]
            shared = [(t,) for t in self.terms if t.joint is None and t not in present]
            yield from self._moves(rest, shared, dropped)
            best = dict[str, dict[str, tuple[float, Term]]]()
            own = [(term,) for term in others if term.joint in joints]
            for gain, (term,) in self._offers(rest, own, dropped):
                best.setdefault(term.name, {}).setdefault(term.where[0], (gain, term))
            for at in best.values():
                terms = (*rest, *(term for _, term in at.values()))
                if len(at) == len(joints) and self.model.are_compatible(terms):
                    yield self._move(terms, dropped.loss + sum(gain for gain, _ in at.values()))

    def other_widths(self, move: Move) -> list[Choice]:
        """Return where a move leads with other widths of the bodies, as far as they promise enough.

        Where a term comes, wider bodies add no more than they do without it: it makes up for what
        they would.
        """
        choices, was = other_widths(self.model, move.choice), self.fit.choice.width
        if not set(self.fit.terms) <= set(move.choice.terms):
            return choices
        return [c for c in choices if c.width < was or move.gain + self._widening[c.width] > _HOPE]

    @cached_property
    def _widening(self) -> dict[float, float]:
        """Gain in the score of the fit by each width of the bodies."""
        model, fit = self.model, self.fit
        shares = (fit.weights * fit.noise)[: len(model.rows)]
        tried = [replace(fit.choice, width=width) for width in model.widths]
        score = model.unbounded(fit.choice, shares, fit.noise).score
        return {t.width: model.unbounded(t, shares, fit.noise).score - score for t in tried}

    def sparing(self) -> Iterator[Move]:
        """Add a payload, or another effect of the whole robot, which may let bodies stay put.

        With bodies as free as they are it may promise nothing, and much with bodies that stay: by
        these its mass is chosen.
        """
        model, present = self.model, self.fit.terms
        last, width, around = set(model.model.load_bodies), model.widths[0], self.around
        if self.fit.choice.width > width:
            held, shares = replace(self.fit.choice, width=width), self.fit.weights * self.fit.noise
            around = Neighbourhood(model, model.unbounded(held, shares[: len(model.rows)]))
        kinds = dict[object, list[Terms]]()
        for term in self.terms:
            if _spares_bodies(term) and (not term.is_body or term.where[0] in last):
                kinds.setdefault(term.effect, []).append((term,))
        for offered in kinds.values():
            possible = model.compatibility.beside(present, offered)
            gains = around.promises(possible)
            if np.isfinite(gains).any():
                best = int(np.argmax(gains))
                move = self._move((*present, *possible[best]), float(gains[best]))
                if move.gain > _HOPE:  # with wider bodies it promises even less
                    yield move

    def unspared(self) -> Iterator[Choice]:
        """Drop a payload, or another effect of the whole robot, which bodies may take in."""
        for term in self.fit.terms:
            rest = tuple(other for other in self.fit.terms if other is not term)
            if _spares_bodies(term) and self.model.are_compatible(rest):
                yield self._choice(rest)


def _spares_bodies(term: Term) -> bool:
    """Return whether a term is a payload, or another effect of the whole robot."""
    return term.is_whole or (term.effect is not None and term.effect.places == "robot")


def is_common(term: Term) -> bool:
    """Return whether a term is what any joint may have, or a payload."""
    return term.is_whole or (term.effect is not None and _complexity(term) == 0)


def _complexity(term: Term) -> int:
    return 0 if term.effect is None else term.effect.complexity
