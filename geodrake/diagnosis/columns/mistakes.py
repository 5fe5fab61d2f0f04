"""Candidate mistakes in columns, with their corrections and prior odds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.kinds import KINDS, TIMES
from geodrake.diagnosis.columns.limits import likely_limits, nearest_limit
from geodrake.diagnosis.columns.quick_scores import QuickScores

Array = NDArray[np.float64]
Joints = tuple[int, ...]

SIZES = 300.0
"""Effective number of values of a factor."""

LIMITS = 30.0
"""Effective number of values of a motor limit and of its no-load speed."""

DIGITS = 4
"""Decimal digits to which scores are compared."""

_TURNS = 12  # candidate zeros of a joint, evenly over a turn
_RARER_SIGN = 0.1  # least share of samples in which a joint needs efforts of the rarer sign
_KNOWN = 0.5  # largest deviation of the logarithm of a known gain
_LEAST_FACTOR = 1e-100  # of measured velocities; smaller ones have no reciprocal
_LEAST_CORRELATION = 1e-9  # of logged and predicted efforts, to determine a gain
_MOST_SUSPECTS = 20  # joints with the largest errors, for candidates of motions and pairs
_WRONG = 3  # complexity of a model file whose bodies are all wrong
_CLOSE = 1e-3  # rad or logarithm of a gain: largest step at convergence
_OTHER = 1.1  # least factor by which a time, velocity or gain must differ


@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake, or another explanation of its symptoms, with the corrected assignment."""

    kind: str  # one of `KINDS`; empty if the columns are right
    joints: Joints  # joints with wrong columns; empty for all
    assignment: Assignment  # the corrected assignment
    free: tuple[int, ...] = ()  # indices of error parameters with a wide prior
    moved: Array = field(default_factory=lambda: np.zeros(0))  # (p,) their change so far
    sizes: float = 1.0  # effective number of values of its other numbers

    @property
    def place(self) -> tuple[object, ...]:
        """Return a key of everything but the sizes of a mistake."""
        a = self.assignment
        if self.kind:
            return self.kind, self.joints
        return a.payload_bodies, a.is_far, a.gravity is not None, a.unknown, a.detached

    @property
    def has_quick_score(self) -> bool:
        """Return whether `QuickScores` can judge it."""
        if self.kind == "position_zero":
            return bool(self.moved.any())
        return self.kind == "effort_sign" or self.kind.startswith(_QUICKLY_SCORED)

    def improved(self, model: ColumnModel, fit: ColumnFit, share: float) -> Mistake | None:
        """Return the mistake with better sizes by a fit; None if it has none, or has converged.

        Errors move by a share of the Newton step; signs and limits follow the predicted efforts.
        """
        start = self.assignment
        if self.free:
            step = share * model.newton_step(fit, self.free)
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
        commanded, velocity = _logged(model, start, j)
        limit, _ = nearest_limit([limit], commanded, needed[j], velocity)
        return replace(self, assignment=start.limited(j, limit))


_QUICKLY_SCORED = ("effort_unit", "swapped", "position", "velocity", "time")


class Mistakes:
    """Generator of candidate mistakes in addition to those that a fit corrects."""

    def __init__(
        self, model: ColumnModel, base: ColumnFit, quick: QuickScores, zeros: Mapping[Joints, Array]
    ) -> None:
        """Store the fit, and joints -> steps (p,) to the best zeros found so far."""
        self._model, self._base, self._quick, self._best_zeros = model, base, quick, zeros
        self._start, self._robot = base.assignment, model.samples.model
        self._n = len(self._start.gain)
        # An unknown gain cannot be wrong, nor one that was fitted to these logs.
        known = (model.samples.gain_deviations < _KNOWN) & ~model.samples.fitted
        self._measured = tuple(np.flatnonzero(known[self._start.effort]).tolist())
        errors = (base.mse / np.maximum(model.noise, 1e-300) ** 2)[self._start.effort]
        self._suspects = tuple(np.sort(np.argsort(-errors)[:_MOST_SUSPECTS]).tolist())

    def priced(self, *, others: bool = False) -> dict[Mistake, float]:
        """Return all candidates, or only those with right columns, with −2 log prior odds.

        All kinds are equally likely, and so are the places of each. The odds of a payload or a
        tilted base are even; those of unknown efforts are in `Beliefs`.
        """
        first = self._factors, self._magnitudes, self._gains, self._subtractions, self._limits
        kinds = (*first, self._swaps, self._zeros, self._velocities, self._others)
        mistakes = [m for kind in ((self._others,) if others else kinds) for m in kind()]
        places, beliefs = dict[str, set[Joints]](), self._model.beliefs
        for mistake in mistakes:
            places.setdefault(mistake.kind, set()).add(mistake.joints)
        return {mistake: _price(mistake, places, beliefs) for mistake in mistakes}

    def _factors(self) -> Iterator[Mistake]:
        """Yield usual factors of the columns of one joint, or of all."""
        start, robot, rate = self._start, self._robot, self._model.samples.rate
        turning = tuple(j for j in range(self._n) if robot.joints[j] not in robot.sliding_joints)
        for name, kind in KINDS.items():
            joints = self._measured if "gain" in kind.changes else self._suspects
            common = tuple(range(self._n)) if len(self._measured) == self._n else ()
            if name.startswith("position"):
                joints = tuple(j for j in joints if name.endswith("sign") or j in turning)
                common = turning
            if "alone" in name and rate is None:
                continue
            for factor in kind.factors:
                for j in joints:
                    yield Mistake(name, (j,), start.times(kind.changes, (j,), factor))
                if len(common) > 1 and not name.endswith("sign"):
                    place = common if len(common) < self._n else ()
                    yield Mistake(name, place, start.times(kind.changes, common, factor))

    def _swaps(self) -> Iterator[Mistake]:
        """Yield swapped pairs of joints; efforts fitted from commands belong to their positions."""
        fitted = self._model.samples.fitted[self._start.effort]
        separate = [j for j in self._suspects if not fitted[j]]
        for name in ("swapped_efforts", "swapped_joints", "swapped_positions"):
            joints = self._suspects if name == "swapped_joints" else separate
            for i, j in combinations(joints, 2):
                yield Mistake(name, (i, j), self._start.swapped(KINDS[name].changes, i, j))

    def _magnitudes(self) -> Iterator[Mistake]:
        """Yield efforts without signs: none changes sign, and some joint needs both."""
        start, keeps = self._start, self._model.samples.keeps_sign
        needed, sources = self._model.needed_by_model(start), start.effort.tolist()
        joints = tuple(j for j, c in enumerate(sources) if keeps[c] and c not in start.signs)
        negative = np.mean(needed < 0.0, axis=0)
        if any(_RARER_SIGN <= negative[j] <= 1.0 - _RARER_SIGN for j in joints):
            signs = {sources[j]: np.where(needed[:, j] < 0.0, -1.0, 1.0) for j in joints}
            signed = replace(start, signs={**start.signs, **signs})
            yield Mistake("effort_magnitude", joints, signed)

    def _gains(self) -> Iterator[Mistake]:
        """Yield gains of one joint, of each, or one for all, estimated by the model's bodies."""
        start, indices = self._start, self._model.gains
        needed, product, power = self._quick.moments(start)
        share = np.abs(product) / np.sqrt(np.maximum(needed * power, 1e-300))
        # Regress logged on predicted efforts: noise of the former does not bias the gain.
        is_known = share > _LEAST_CORRELATION
        gains = np.where(is_known, needed / np.where(is_known, product, 1.0), 1.0)
        for j in self._measured:
            free = (int(indices[j]),)
            yield Mistake("effort_gain", (j,), start, free)
            if _is_other(gains[j]):
                scaled = start.times(("gain",), (j,), gains[j])
                sizes = SIZES if gains[j] < 0.0 else 1.0
                moved = self._moved(free, -np.log(abs(gains[j])))
                yield Mistake("effort_gain", (j,), scaled, free, moved, sizes)
        if len(self._measured) == self._n > 1:
            positive, weight = gains > 0.0, share**2 * power
            common = 1.0
            if weight[positive].sum() > 0.0:
                mean = np.average(np.log(gains[positive]), weights=weight[positive])
                common = float(np.exp(mean))
            factors = np.where(positive, gains, common)
            scaled, ends = replace(start, gain=start.gain * factors), tuple(indices.tolist())
            moved, rarer = self._moved(ends, -np.log(factors)), self._model.beliefs.rarer
            yield Mistake("effort_gains", (), scaled, ends, moved, rarer ** (self._n - 1))
            scaled = replace(start, gain=start.gain * common)
            yield Mistake("effort_gain", (), scaled, sizes=SIZES)

    def _moved(self, indices: Sequence[int], step: Array | float) -> Array:
        moved = np.zeros(len(self._model.mean))
        moved[list(indices)] = step
        return moved

    def _subtractions(self) -> Iterator[Mistake]:
        """Yield terms that drives subtract from the efforts that they report."""
        start = self._start
        if not start.is_weightless:
            yield Mistake("without_gravity", (), replace(start, gravity=(0.0, 0.0, 0.0)))
        stated = [f.effect.taken_out_as for f in self._robot.effects if np.any(f.parameters)]
        for name in sorted({*stated} - start.subtracted):
            kind = f"without_{name.replace(' ', '_')}"
            if kind in KINDS:
                yield Mistake(kind, (), replace(start, subtracted=start.subtracted | {name}))

    def _limits(self) -> Iterator[Mistake]:
        """Yield commanded efforts of motors that cannot deliver them."""
        start, needed = self._start, self._model.needed(self._base)
        for j in self._measured:
            if start.limit_of(j) is None and j not in start.detached:
                commanded, velocity = _logged(self._model, start, j)
                for limit in likely_limits(commanded, needed[j], velocity):
                    sizes = LIMITS ** (1 + int(np.isfinite(limit.no_load_speed)))
                    yield Mistake("effort_limit", (j,), start.limited(j, limit), sizes=sizes)

    def _zeros(self) -> Iterator[Mistake]:
        """Yield zeros close to the present ones, and peaks of the quick score over a turn."""
        for j in self._suspects:
            free = (int(self._model.zeros[j]),)
            step = self._best_zeros.get((j,), np.zeros(0))
            start = self._model.moved(self._start, step) if len(step) else self._start
            candidate = Mistake("position_zero", (j,), start, free, step)
            yield candidate
            if len(step) or self._robot.joints[j] in self._robot.sliding_joints:
                continue
            ring = [candidate]
            for k in range(1, _TURNS):
                turn = self._moved(free, float(np.angle(np.exp(2j * np.pi * k / _TURNS))))
                turned = self._model.moved(self._start, turn)
                ring.append(Mistake("position_zero", (j,), turned, free, turn))
            scores = np.round([self._quick.score(zero.assignment) for zero in ring], DIGITS)
            peaks = (scores >= np.roll(scores, 1)) & (scores >= np.roll(scores, -1))
            yield from (ring[k] for k in np.flatnonzero(peaks) if k)

    def _velocities(self) -> Iterator[Mistake]:
        """Yield factors of measured velocities and of time."""
        start, factors = self._start, self._velocity_factors()
        moving = np.flatnonzero(np.isfinite(factors))
        common = float(np.median(factors[moving])) if len(moving) else 1.0
        places = [((j,), factors[j]) for j in moving.tolist()]
        for joints, factor in [*places, *([((), common)] if len(moving) > 1 else [])]:
            if _is_other(factor):
                scaled = start.times(("rate",), joints, 1.0 / factor)
                yield Mistake("velocity_factor", joints, scaled, sizes=SIZES)
        measured = (1.0 / common,) if common > 0.0 and _is_other(common) else ()
        for factor in (*measured, *TIMES):
            yield Mistake("time", (), replace(start, time=start.time * factor), sizes=SIZES)

    def _velocity_factors(self) -> Array:
        """Return (n,) ratios of measured velocities to derivatives; NaN for joints at rest."""
        samples, start = self._model.samples, self._start
        if samples.rate is None:
            return np.full(self._n, np.nan)
        measured, v = samples.rate[:, start.position] * start.rate, samples.motion(start)[1]
        moving = np.mean(samples.v**2, axis=0) > samples.width**2
        moving = moving[start.position]
        slope = np.sum(measured * v, axis=0) / np.where(moving, np.sum(v**2, axis=0), 1.0)
        return np.where(moving & (np.abs(slope) > _LEAST_FACTOR), slope, np.nan)

    def _others(self) -> Iterator[Mistake]:
        """Yield explanations with right columns.

        These are a payload, bodies far from the model's, a tilted base, and an unknown effort at a
        joint, in addition to that of the bodies or in place of it.
        """
        start, joints = self._start, tuple(range(self._n))
        for body in self._robot.load_bodies:
            bodies = start.payload_bodies | {self._robot.bodies.index(body)}
            if bodies != start.payload_bodies:
                yield Mistake("", (), replace(start, payload_bodies=bodies))
        if not start.is_far:
            rarer = self._model.beliefs.rarer**_WRONG
            yield Mistake("", (), replace(start, is_far=True), sizes=rarer)
        if start.gravity is None:
            down = tuple(self._robot.tree.gravity.tolist())
            yield Mistake("", (), replace(start, gravity=down), tuple(self._model.tilt.tolist()))
        for j in joints:
            if j not in start.unknown:
                yield Mistake("", (j,), replace(start, unknown=start.unknown | {j}))
            if j not in start.detached:
                yield Mistake("", (j,), replace(start, detached=start.detached | {j}))
        if len(start.detached) < self._n:
            yield Mistake("", joints, replace(start, detached=frozenset(joints)))


def _price(mistake: Mistake, places: dict[str, set[Joints]], beliefs: Beliefs) -> float:
    """Return −2 log of the prior odds of a mistake, by the places of all kinds."""
    if mistake.kind:
        odds = beliefs.columns / (len(places.keys() - {""}) * len(places[mistake.kind]))
    else:
        others = max(1, len(places[""]) - 1)
        odds = beliefs.odd_joint / others if mistake.joints else 1.0
    return float(2.0 * (np.log(mistake.sizes) - np.log(odds)))


def _logged(model: ColumnModel, assignment: Assignment, joint: int) -> tuple[Array, Array]:
    """Return the logged efforts (K,) of a joint, and its velocities (K,)."""
    rows, source = model.designs(assignment)[joint].rows, int(assignment.effort[joint])
    effort = model.samples.effort[rows, source]
    if source in assignment.signs:
        effort = effort * assignment.signs[source][rows]
    velocity = model.samples.motion(assignment, rows)[1][:, joint]
    return assignment.gain[joint] * effort, velocity


def _is_other(factor: float) -> bool:
    return factor < 0.0 or abs(np.log(factor)) > np.log(_OTHER)
