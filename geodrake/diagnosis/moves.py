"""Moves from one explanation to its neighbours: terms that come, go, or take others' places."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geodrake.diagnosis.log_model import Choice, Dropped, Fit, LogModel, Neighbourhood
from geodrake.diagnosis.terms import Term, Terms

_MOST = 14
"""So many neighbours, those that promise most, are fitted."""
_POOL = 14
"""So many effects of a joint, and all simple ones, are tried in pairs there."""
_HOPE = -10.0
"""A neighbour that promises less is not fitted: it has less than a hundredth of the probability."""
_LOSS = -25.0


@dataclass(frozen=True, eq=False)
class Move:
    """A neighbour of an explanation."""

    choice: Choice
    gain: float  # what it adds to the score, at the noise of the fit


def neighbours(
    model: LogModel, fit: Fit, *, most: int = _MOST, joints: Collection[str] | None = None
) -> list[Choice]:
    """Find the most promising neighbours of an explanation.

    `most` counts them beside other widths of the bodies and the best delays. If `joints` are given,
    their own effects alone may change.
    """
    finder = _Finder(model, fit)
    moves = finder.moves() if joints is None else finder.rebuilt(joints)
    promising = sorted(moves, key=lambda move: -move.gain)
    best = list({move.choice.key: move for move in promising}.values())[:most]
    found = [move.choice for move in best]
    if joints is not None:
        return found
    for move in best[: most // 2]:
        changed = set(move.choice.terms) ^ set(fit.terms)
        if any(term.joint is None for term in changed):  # it may spare bodies their way
            found += _other_widths(model, move.choice)
    found += _other_widths(model, fit.choice)
    for choice in finder.sparing():
        found += [choice, *_other_widths(model, choice)]
    was, base = fit.choice, finder.base
    for delay, gain in finder.around.delays():
        late = Choice(was.terms, was.width, delay)
        if gain + base - model.odds_against(late) > _HOPE:
            found.append(late)
    return found


def additions(model: LogModel, fit: Fit) -> list[Fit]:
    """Add terms of one name to an explanation at every place where they gain, best first."""
    shares = model.shares(fit)
    choices = [move.choice for move in _Finder(model, fit).added()]
    fits = [model.fit(choice, shares, fit.variance) for choice in choices]
    return sorted((each for each in fits if each is not None), key=lambda each: -each.score)


def _other_widths(model: LogModel, choice: Choice) -> list[Choice]:
    others = [width for width in model.widths if width != choice.width]
    return [Choice(choice.terms, width, choice.delay) for width in others]


class _Finder:
    """Finds the neighbours of one fit."""

    def __init__(self, model: LogModel, fit: Fit) -> None:
        self.model, self.fit = model, fit
        self.around: Neighbourhood = model.around(fit)
        self.base = model.odds_against(fit.choice)
        self.by_joint: dict[str, list[Term]] = {}
        for term in model.terms:
            if term.joint is not None:
                self.by_joint.setdefault(term.joint, []).append(term)

    def moves(self) -> Iterator[Move]:
        """Return all moves that promise a gain."""
        yield from self.added()
        yield from self.rebuilt(self.by_joint)
        for term in self.fit.terms:
            yield from self._replaced(term)
        yield from self._without_kinds()
        yield from self._kinds_replaced()

    def _move(self, terms: Iterable[Term], gain: float) -> Move:
        """Return a move by its gain without prior odds."""
        choice = self._choice(terms)
        return Move(choice, gain + self.base - self.model.odds_against(choice))

    def _choice(self, terms: Iterable[Term]) -> Choice:
        was = self.fit.choice
        return self.model.choice(tuple(terms), was.width, was.delay)

    def added(self) -> Iterator[Move]:
        """Add one term, the best at every joint together, or one kind at all joints together."""
        present = self.fit.terms
        offered = [
            term
            for term in self.model.terms
            if term not in present and self.model.are_compatible((*present, term))
        ]
        gains = self.around.gains([(term,) for term in offered])
        moves = [
            (self._move((*present, t), float(g)), t)
            for t, g in zip(offered, gains, strict=True)
            if np.isfinite(g)
        ]
        moves = sorted((m for m in moves if m[0].gain > _HOPE), key=lambda each: -each[0].gain)
        yield from (move for move, _ in moves[:_MOST])
        best, kinds = dict[str, tuple[Term, float]](), dict[str, dict[str, tuple[Term, float]]]()
        for move, term in moves:
            if term.joint is not None:
                kinds.setdefault(term.name, {}).setdefault(term.joint, (term, move.gain))
                if move.gain > 0.0:
                    best.setdefault(term.joint, (term, move.gain))
        for group in (best, *kinds.values()):
            if len(group) > 1:
                terms, found = zip(*group.values(), strict=True)
                yield Move(self._choice((*present, *terms)), sum(found))

    def rebuilt(self, joints: Collection[str]) -> Iterator[Move]:
        """Choose the own effects of some joints anew: alone, as pairs, and beside simple ones."""
        present, every = self.fit.terms, list[tuple[Move, list[Term], Terms]]()
        for joint in joints:
            offered = self.by_joint.get(joint, [])
            here = [term for term in present if term.joint == joint]
            rest = tuple(term for term in present if term not in here)
            if not self.model.are_compatible(rest):
                continue
            dropped = self.around.dropped(here) if here else None
            packages = [
                package
                for package in self._packages(offered, here, dropped)
                if self.model.are_compatible((*rest, *package))
            ]
            loss = 0.0 if dropped is None else dropped.loss
            gains = self.around.gains(packages, dropped) + loss
            order = np.argsort(-gains)[:_MOST]
            moves = [
                (self._move((*rest, *packages[k]), float(gains[k])), here, packages[k])
                for k in order
                if np.isfinite(gains[k])
            ]
            moves.sort(key=lambda each: -each[0].gain)
            yield from (move for move, _, _ in moves if move.gain > _HOPE)
            every += moves[:1] if moves and moves[0][0].gain > 0.0 else []
        if len(every) > 1:
            gone = {term for _, here, _ in every for term in here}
            kept = [term for term in present if term not in gone]
            come = [term for _, _, package in every for term in package]
            if self.model.are_compatible((*kept, *come)):
                yield Move(self._choice((*kept, *come)), sum(move.gain for move, _, _ in every))

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
        packages += [
            (*(t for t in here if t is not one), term)
            for one in here
            for term in pool
            if term not in here
        ]
        unique = {frozenset(package): package for package in packages}
        unique.pop(frozenset(here), None)
        return [*unique.values()]

    def _replaced(self, term: Term) -> Iterator[Move]:
        """Drop one term, or replace it by one that does not belong to a single joint."""
        rest = tuple(other for other in self.fit.terms if other is not term)
        dropped = self.around.dropped([term])
        if self.model.are_compatible(rest):
            without = self._move(rest, dropped.loss)
            if without.gain > _LOSS:
                yield without
        others = [
            (other,)
            for other in self.model.terms
            if other not in self.fit.terms
            and (term.joint is None or other.joint is None)
            and self.model.are_compatible((*rest, other))
        ]
        gains = self.around.gains(others, dropped) + dropped.loss
        for k in np.argsort(-gains)[:_MOST]:
            if np.isfinite(gains[k]):
                move = self._move((*rest, *others[k]), float(gains[k]))
                if move.gain > _HOPE:
                    yield move

    def _without_kinds(self) -> Iterator[Move]:
        """Drop all effects of one name."""
        for name in {term.name for term in self.fit.terms}:
            gone = [term for term in self.fit.terms if term.name == name]
            rest = tuple(term for term in self.fit.terms if term.name != name)
            if len(gone) > 1 and self.model.are_compatible(rest):
                move = self._move(rest, self.around.dropped(gone).loss)
                if move.gain > _LOSS:
                    yield move

    def sparing(self) -> Iterator[Choice]:
        """Add a payload, or another effect of the whole robot, which may let bodies stay put.

        With bodies as free as they are it may promise nothing, and much with bodies that stay.
        """
        present, last = self.fit.terms, set(self.model.model.last_bodies)
        for term in self.model.terms:
            whole = term.effect is not None and term.effect.places == "robot"
            held = term.is_body and term.is_whole and term.where[0] in last
            if (whole or held) and self.model.are_compatible((*present, term)):
                yield self._choice((*present, term))

    def _kinds_replaced(self) -> Iterator[Move]:
        """Replace one kind of effect, or one that joints share, by another one everywhere."""
        present = self.fit.terms
        for name in {term.name for term in present if term.joint is not None}:
            gone = [term for term in present if term.name == name]
            rest = tuple(term for term in present if term.name != name)
            if len(gone) < 2 or not self.model.are_compatible(rest):
                continue
            dropped, best = self.around.dropped(gone), dict[str, dict[str, tuple[float, Term]]]()
            joints = {term.joint for term in gone}
            offered = [
                term
                for term in self.model.terms
                if term.joint in joints
                and term.name != name
                and self.model.are_compatible((*rest, term))
            ]
            gains = self.around.gains([(term,) for term in offered], dropped)
            for term, gain in zip(offered, gains.tolist(), strict=True):
                at = best.setdefault(term.name, {})
                if np.isfinite(gain) and gain > at.get(term.where[0], (-np.inf, term))[0]:
                    at[term.where[0]] = gain, term
            shared = [
                (term,)
                for term in self.model.terms
                if term.joint is None
                and term not in present
                and self.model.are_compatible((*rest, term))
            ]
            others = self.around.gains(shared, dropped)
            for k in np.argsort(-others)[:_MOST]:
                if np.isfinite(others[k]):
                    yield self._move((*rest, *shared[k]), dropped.loss + float(others[k]))
            for at in best.values():
                if len(at) == len(joints):
                    terms = (*rest, *(term for _, term in at.values()))
                    if self.model.are_compatible(terms):
                        yield self._move(terms, dropped.loss + sum(g for g, _ in at.values()))


def _complexity(term: Term) -> int:
    return 0 if term.effect is None else term.effect.complexity
