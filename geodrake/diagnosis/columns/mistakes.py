"""Mistakes that may be in columns: what corrects each of them, and how rare it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.first_look import FirstLook
from geodrake.diagnosis.columns.kinds import KINDS, TIMES
from geodrake.diagnosis.columns.limits import likely_limits, nearest_limit

Array = NDArray[np.float64]
Joints = tuple[int, ...]

SIZES = 300.0
"""Number of sizes of a factor that data tell apart."""

LIMITS = 30.0
"""The same of a motor's limit, which is near the largest effort, and of its speed without load."""

DIGITS = 4
"""Of scores that differ by more than rounding."""

_TURNS = 12  # zeros that are tried at a joint, evenly over a turn
_TURNS_ROUND = 0.1  # of its samples, in which a joint needs efforts of the rarer sign
_KNOWN = 0.5  # deviation of the logarithm of a gain that something is known of
_LEAST_FACTOR = 1e-100  # of measured velocities: less is none, of which there is no reciprocal
_LEAST_PRODUCT = 1e-9  # correlation of efforts with what is needed that says something of a gain
_MOST_SUSPECTS = 20  # joints, those that err most, of which motions and pairs are looked at
_WRONG = 3  # such steps of rarity is a model file whose bodies are all wrong away
_CLOSE = 1e-3  # rad or share: a step that ends it
_OTHER = 1.1  # factor by which times, or velocities, are to differ for a hypothesis of its own


@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake, or what looks like one, and the assignment without it."""

    kind: str  # one of `KINDS`; empty for what is no mistake in columns
    joints: Joints  # whose columns it is in; none for all
    assignment: Assignment  # of the columns that corrects it
    free: tuple[int, ...] = ()  # parameters of errors that are to be found large
    moved: Array = field(default_factory=lambda: np.zeros(0))  # (p,) by which it has moved these
    sizes: float = 1.0  # how many values other numbers may have that are found in the data

    @property
    def place(self) -> tuple[object, ...]:
        """Return what two hypotheses have in common that differ by their sizes alone."""
        own = self.assignment
        if self.kind:
            return self.kind, self.joints
        return own.carrying, own.is_far, own.gravity is not None, own.unknown, own.apart

    @property
    def is_seen(self) -> bool:
        """Return whether a first look at errors with the model's bodies tells its worth."""
        if self.kind == "position_zero":
            return bool(self.moved.any())
        return self.kind == "effort_sign" or self.kind.startswith(_SEEN)

    def nearer(self, model: ColumnModel, fit: ColumnFit, share: float) -> Mistake | None:
        """Return the mistake of the sizes that a fit asks for; None if it has no sizes to find.

        Errors are moved by a share of Newton's step, signs and limits are those by which efforts
        are nearest to what the fit needs.
        """
        start = self.assignment
        if self.free:
            step = share * model.way(fit, self.free)
            if np.abs(step).max() < _CLOSE:
                return None
            moved = self.moved + step if len(self.moved) else step
            return replace(self, assignment=model.moved(start, step), moved=moved)
        if self.kind not in ("effort_limit", "effort_magnitude") or share < 1.0:
            return None
        needed, designs = model.needed(fit), model.designs(start)
        if self.kind == "effort_magnitude":
            signs = {**start.signs}
            for j in self.joints:
                source = int(start.effort[j])
                signs[source] = signs[source].copy()
                signs[source][designs[j].rows] = np.where(needed[j] < 0.0, -1.0, 1.0)
            return replace(self, assignment=replace(start, signs=signs))
        (j,), limit = self.joints, start.limit_of(self.joints[0])
        if limit is None:
            return None
        asked, velocity = _asked(model, start, j)
        return replace(
            self, assignment=start.limited(j, nearest_limit([limit], asked, needed[j], velocity)[0])
        )


_SEEN = ("effort_unit", "swapped", "position", "velocity", "time")


class Mistakes:
    """Everything that may be wrong beside what a fit corrects already."""

    def __init__(
        self, model: ColumnModel, base: ColumnFit, look: FirstLook, zeros: Mapping[Joints, Array]
    ) -> None:
        """Take a fit, and by joint the steps (p,) to zeros that were the best beside another."""
        self._model, self._base, self._look, self._near = model, base, look, zeros
        self._start, self._robot = base.assignment, model.samples.model
        self._n = len(self._start.gain)
        # A gain that nobody knows cannot be wrong, nor one that these logs say.
        known = (model.samples.gain_deviations < _KNOWN) & ~model.samples.fitted
        self._measured = tuple(np.flatnonzero(known[self._start.effort]).tolist())
        errors = (base.mse / np.maximum(model.noise, 1e-300) ** 2)[self._start.effort]
        self._suspects = tuple(np.sort(np.argsort(-errors)[:_MOST_SUSPECTS]).tolist())

    def priced(self, *, others: bool = False) -> dict[Mistake, float]:
        """Return all of them, or those of no column, with −2 log prior odds.

        All kinds are equally likely, and so are the places of each. A payload or a slope is as
        likely as not; unknown efforts have odds of their own.
        """
        own = self._factors, self._magnitudes, self._gains, self._parts, self._limits
        every = (*own, self._swaps, self._zeros, self._velocities, self._others)
        used = (self._others,) if others else every
        mistakes = [mistake for each in used for mistake in each()]
        places, beliefs = dict[str, set[Joints]](), self._model.beliefs
        for mistake in mistakes:
            places.setdefault(mistake.kind, set()).add(mistake.joints)
        return {mistake: _price(mistake, places, beliefs) for mistake in mistakes}

    def _factors(self) -> Iterator[Mistake]:
        """Yield usual factors of the columns of one joint, or of all."""
        start, robot, rate = self._start, self._robot, self._model.samples.rate
        turning = tuple(j for j in range(self._n) if robot.joints[j] not in robot.sliding_joints)
        for name, kind in KINDS.items():
            able = self._measured if "gain" in kind.changes else self._suspects
            every = tuple(range(self._n)) if len(self._measured) == self._n else ()
            if name.startswith("position"):
                able = tuple(j for j in able if name.endswith("sign") or j in turning)
                every = turning
            if "alone" in name and rate is None:
                continue
            for factor in kind.factors:
                for j in able:
                    yield Mistake(name, (j,), start.times(kind.changes, (j,), factor))
                if len(every) > 1 and not name.endswith("sign"):
                    at = every if len(every) < self._n else ()
                    yield Mistake(name, at, start.times(kind.changes, every, factor))

    def _swaps(self) -> Iterator[Mistake]:
        """Yield pairs of joints swapped; efforts of commands belong to their positions."""
        fitted = self._model.samples.fitted[self._start.effort]
        apart = [j for j in self._suspects if not fitted[j]]
        for name in ("swapped_efforts", "swapped_joints", "swapped_positions"):
            joints = self._suspects if name == "swapped_joints" else apart
            for i, j in combinations(joints, 2):
                yield Mistake(name, (i, j), self._start.swapped(KINDS[name].changes, i, j))

    def _magnitudes(self) -> Iterator[Mistake]:
        """Yield efforts without their signs: none changes it, and some joint needs both."""
        start, keeps = self._start, self._model.samples.keeps_sign
        needed, sources = self._model.needed_by_model(start), start.effort.tolist()
        joints = tuple(j for j, c in enumerate(sources) if keeps[c] and c not in start.signs)
        negative = np.mean(needed < 0.0, axis=0)
        if any(_TURNS_ROUND <= negative[j] <= 1.0 - _TURNS_ROUND for j in joints):
            signs = {sources[j]: np.where(needed[:, j] < 0.0, -1.0, 1.0) for j in joints}
            signed = replace(start, signs={**start.signs, **signs})
            yield Mistake("effort_magnitude", joints, signed)

    def _gains(self) -> Iterator[Mistake]:
        """Yield gains of one joint, of each, or one of all, from those by the model's bodies."""
        start, at = self._start, self._model.gains
        needed, product, power = self._look.moments(start)
        share = np.abs(product) / np.sqrt(np.maximum(needed * power, 1e-300))
        # Of two directions of a regression, the one with which noise of the effort does not count.
        told = share > _LEAST_PRODUCT
        gains = np.where(told, needed / np.where(told, product, 1.0), 1.0)
        for j in self._measured:
            free = (int(at[j]),)
            yield Mistake("effort_gain", (j,), start, free)
            if _is_other(gains[j]):
                own = start.times(("gain",), (j,), gains[j])
                sizes = SIZES if gains[j] < 0.0 else 1.0
                moved = self._moved(free, -np.log(abs(gains[j])))
                yield Mistake("effort_gain", (j,), own, free, moved, sizes)
        if len(self._measured) == self._n > 1:
            positive, weight = gains > 0.0, share**2 * power
            common = 1.0
            if weight[positive].sum() > 0.0:
                mean = np.average(np.log(gains[positive]), weights=weight[positive])
                common = float(np.exp(mean))
            each = np.where(positive, gains, common)
            own, ends = replace(start, gain=start.gain * each), tuple(at.tolist())
            moved, rarer = self._moved(ends, -np.log(each)), self._model.beliefs.rarer
            yield Mistake("effort_gains", (), own, ends, moved, rarer ** (self._n - 1))
            own = replace(start, gain=start.gain * common)
            yield Mistake("effort_gain", (), own, sizes=SIZES)

    def _moved(self, at: Sequence[int], by: Array | float) -> Array:
        found = np.zeros(len(self._model.mean))
        found[list(at)] = by
        return found

    def _parts(self) -> Iterator[Mistake]:
        """Yield parts of the efforts that drives take out of what they report."""
        start = self._start
        if not start.is_weightless:
            yield Mistake("without_gravity", (), replace(start, gravity=(0.0, 0.0, 0.0)))
        stated = [f.effect.taken_out_as for f in self._robot.effects if np.any(f.parameters)]
        for name in sorted({*stated} - start.without):
            kind = f"without_{name.replace(' ', '_')}"
            if kind in KINDS:
                yield Mistake(kind, (), replace(start, without=start.without | {name}))

    def _limits(self) -> Iterator[Mistake]:
        """Yield efforts that were asked for of motors that cannot give them."""
        start, needed = self._start, self._model.needed(self._base)
        for j in self._measured:
            if start.limit_of(j) is None and j not in start.apart:
                asked, velocity = _asked(self._model, start, j)
                for limit in likely_limits(asked, needed[j], velocity):
                    sizes = LIMITS ** (1 + int(np.isfinite(limit.no_load_speed)))
                    yield Mistake("effort_limit", (j,), start.limited(j, limit), sizes=sizes)

    def _zeros(self) -> Iterator[Mistake]:
        """Yield other zeros: near ones, and those over a turn that look better than either side."""
        for j in self._suspects:
            free = (int(self._model.zeros[j]),)
            known = self._near.get((j,), np.zeros(0))
            start = self._model.moved(self._start, known) if len(known) else self._start
            near = Mistake("position_zero", (j,), start, free, known)
            yield near
            if len(known) or self._robot.joints[j] in self._robot.sliding_joints:
                continue
            ring = [near]
            for k in range(1, _TURNS):
                by = self._moved(free, float(np.angle(np.exp(2j * np.pi * k / _TURNS))))
                own = self._model.moved(self._start, by)
                ring.append(Mistake("position_zero", (j,), own, free, by))
            looks = np.round([self._look.score(each.assignment) for each in ring], DIGITS)
            peaks = (looks >= np.roll(looks, 1)) & (looks >= np.roll(looks, -1))
            yield from (ring[k] for k in np.flatnonzero(peaks) if k)

    def _velocities(self) -> Iterator[Mistake]:
        """Yield factors of measured velocities, and of the time."""
        start, factors = self._start, self._velocity_factors()
        told = np.flatnonzero(np.isfinite(factors))
        common = float(np.median(factors[told])) if len(told) else 1.0
        places = [((j,), factors[j]) for j in told.tolist()]
        for joints, factor in [*places, *([((), common)] if len(told) > 1 else [])]:
            if _is_other(factor):
                own = start.times(("rate",), joints, 1.0 / factor)
                yield Mistake("velocity_factor", joints, own, sizes=SIZES)
        measured = (1.0 / common,) if common > 0.0 and _is_other(common) else ()
        for factor in (*measured, *TIMES):
            yield Mistake("time", (), replace(start, time=start.time * factor), sizes=SIZES)

    def _velocity_factors(self) -> Array:
        """Return (n,) ratios of measured velocities to derived ones; NaN where nothing moves."""
        samples, start = self._model.samples, self._start
        if samples.rate is None:
            return np.full(self._n, np.nan)
        measured, v = samples.rate[:, start.position] * start.rate, samples.motion(start)[1]
        moving = np.mean(samples.v**2, axis=0) > samples.width**2
        moving = moving[start.position]
        slope = np.sum(measured * v, axis=0) / np.where(moving, np.sum(v**2, axis=0), 1.0)
        return np.where(moving & (np.abs(slope) > _LEAST_FACTOR), slope, np.nan)

    def _others(self) -> Iterator[Mistake]:
        """Yield what is no mistake in columns but looks like one.

        A payload that the model lacks, bodies far from the model's, a base on a slope, something
        unknown at a joint beside the bodies, or in their place.
        """
        start, every = self._start, tuple(range(self._n))
        for body in self._robot.load_bodies:
            held = start.carrying | {self._robot.bodies.index(body)}
            if held != start.carrying:
                yield Mistake("", (), replace(start, carrying=held))
        if not start.is_far:
            rarer = self._model.beliefs.rarer**_WRONG
            yield Mistake("", (), replace(start, is_far=True), sizes=rarer)
        if start.gravity is None:
            down = tuple(self._robot.tree.gravity.tolist())
            yield Mistake("", (), replace(start, gravity=down), tuple(self._model.tilt.tolist()))
        for j in every:
            if j not in start.unknown:
                yield Mistake("", (j,), replace(start, unknown=start.unknown | {j}))
            if j not in start.apart:
                yield Mistake("", (j,), replace(start, apart=start.apart | {j}))
        if len(start.apart) < self._n:
            yield Mistake("", every, replace(start, apart=frozenset(every)))


def _price(mistake: Mistake, places: dict[str, set[Joints]], beliefs: Beliefs) -> float:
    """Return −2 log of the prior odds of a mistake, by the places of all kinds."""
    if mistake.kind:
        odds = beliefs.columns / (len(places.keys() - {""}) * len(places[mistake.kind]))
    else:
        others = max(1, len(places[""]) - 1)
        odds = beliefs.odd_joint / others if mistake.joints else 1.0
    return float(2.0 * (np.log(mistake.sizes) - np.log(odds)))


def _asked(model: ColumnModel, assignment: Assignment, joint: int) -> tuple[Array, Array]:
    """Return the efforts (K,) of the log at a joint, and velocities (K,)."""
    rows, source = model.designs(assignment)[joint].rows, int(assignment.effort[joint])
    effort = model.samples.effort[rows, source]
    if source in assignment.signs:
        effort = effort * assignment.signs[source][rows]
    velocity = model.samples.motion(assignment, rows)[1][:, joint]
    return assignment.gain[joint] * effort, velocity


def _is_other(factor: float) -> bool:
    return factor < 0.0 or abs(np.log(factor)) > np.log(_OTHER)
