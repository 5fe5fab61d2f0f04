"""Mistakes that are made with columns: what each of them makes of an assignment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.limits import likely_limits

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SIZES = 300.0
"""Number of sizes of a factor that data tell apart."""

LIMITS = 30.0
"""The same of a motor's limit, which is near the largest effort, and of its speed without load."""

_DEGREE = np.pi / 180.0
_THOUSAND = (1e-3, 1e3)  # N·mm beside N·m, and the other way round; milliseconds
_MINUTE = (60.0, 1.0 / 60.0)
_TIMES = (*_THOUSAND, *_MINUTE, 0.1, 10.0, 0.5, 2.0)
_TURNS = 12  # zeros that are tried at a joint, evenly over a turn
_TURNS_ROUND = 0.1  # of its samples, in which a joint needs efforts of the rarer sign
_KNOWN = 0.5  # deviation of the logarithm of a gain that something is known of
_LEAST_FACTOR = 1e-100  # of measured velocities: less is none, of which there is no reciprocal
_MOST_SUSPECTS = 20  # joints, those that err most, of which motions and pairs are looked at
_OTHER = 1.1  # factor by which times, or velocities, are to differ for a hypothesis of its own


@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake, and the assignment without it.

    Attributes:
        kind: What it is, see `ColumnFinding`; empty for what is no mistake in columns.
        joints: Indices of the joints whose columns it is in; none for all.
        assignment: The assignment of the columns that corrects it.
        free: Parameters of errors that are to be found large.
        moved: (p,) by how much the assignment has moved these.
        sizes: How many values other numbers may have that are found in the data.
    """

    kind: str
    joints: tuple[int, ...]
    assignment: Assignment
    free: tuple[int, ...] = ()
    moved: Array = field(default_factory=lambda: np.zeros(0))
    sizes: float = 1.0

    @property
    def is_seen(self) -> bool:
        """Return whether a first look at errors with the model's bodies tells its worth."""
        if not self.kind or self.kind.startswith(("without", "effort_gain")):
            return False
        if self.kind in ("effort_limit", "effort_magnitude"):
            return False
        return self.kind != "position_zero" or bool(self.moved.any())


class Mistakes:
    """Everything that may be wrong beside what a fit corrects already."""

    def __init__(self, model: ColumnModel, base: ColumnFit) -> None:
        self._model, self._base, self._start = model, base, base.assignment
        self._n = len(self._start.gain)
        self._robot = model.parameters.model
        # A gain that nobody knows, such as a servo's, cannot be wrong.
        known = model.samples.gain_deviations[self._start.effort] < _KNOWN
        self._measured = np.flatnonzero(known).tolist()
        errors = (base.mse / np.maximum(model.noise, 1e-300) ** 2)[self._start.effort]
        self._suspects = np.sort(np.argsort(-errors)[:_MOST_SUSPECTS]).tolist()

    def all(self) -> list[Mistake]:
        """Return all of them."""
        every = self._efforts, self._magnitudes, self._gains, self._parts, self._limits
        return [
            mistake
            for kind in (*every, self._positions, self._zeros, self._clock, self._others)
            for mistake in kind()
        ]

    def _moved(self, at: Indices | int, by: Array | float) -> Array:
        found = np.zeros(len(self._base.x))
        found[at] = by
        return found

    def _efforts(self) -> Iterator[Mistake]:
        start, n = self._start, self._n
        for j in self._measured:
            yield Mistake("effort_sign", (j,), start.times("gain", j, -1.0))
            for factor in _THOUSAND:
                yield Mistake("effort_unit", (j,), start.times("gain", j, factor))
        for factor in _THOUSAND if n == len(self._measured) > 1 else ():
            yield Mistake("effort_unit", (), start.times("gain", None, factor))
        for i, j in combinations(self._suspects, 2):
            swapped = start.swapped(i, j, positions=False, efforts=True)
            yield Mistake("swapped_efforts", (i, j), swapped)

    def _magnitudes(self) -> Iterator[Mistake]:
        """Efforts without their signs: none changes it, and some joint needs both."""
        start, keeps = self._start, self._model.samples.keeps_sign
        needed = self._model.needed_by_model(start)
        joints = [
            j for j, c in enumerate(start.effort.tolist()) if keeps[c] and c not in start.signs
        ]
        negative = np.mean(needed < 0.0, axis=0)
        if any(_TURNS_ROUND <= negative[j] <= 1.0 - _TURNS_ROUND for j in joints):
            signs = {int(start.effort[j]): np.where(needed[:, j] < 0.0, -1.0, 1.0) for j in joints}
            signed = replace(start, signs={**start.signs, **signs})
            yield Mistake("effort_magnitude", tuple(joints), signed)

    def _gains(self) -> Iterator[Mistake]:
        """Gains of one joint, of each, or one of all, from where the model's bodies have them."""
        start, n, at = self._start, self._n, self._model.parameters.gains()
        gains, weight = own_gains(self._model, self._base)
        for j in self._measured:
            free = (int(at[j]),)
            yield Mistake("effort_gain", (j,), start, free, self._moved(0, 0.0))
            if _is_other(gains[j]):
                moved = self._moved(at[j], -np.log(abs(gains[j])))
                sizes = SIZES if gains[j] < 0.0 else 1.0
                own = start.times("gain", j, gains[j])
                yield Mistake("effort_gain", (j,), own, free, moved, sizes)
        if n == len(self._measured) > 1:
            positive = gains > 0.0
            common = 1.0
            if positive.any() and weight[positive].sum() > 0.0:
                common = float(
                    np.exp(np.average(np.log(gains[positive]), weights=weight[positive]))
                )
            each = np.where(positive, gains, common)
            own = replace(start, gain=start.gain * each)
            yield Mistake(
                "effort_gains", (), own, tuple(at.tolist()), self._moved(at, -np.log(each))
            )
            own = replace(start, gain=start.gain * common)
            yield Mistake("effort_gain", (), own, sizes=SIZES)

    def _parts(self) -> Iterator[Mistake]:
        """Parts of the efforts that drives take out of what they report."""
        start = self._start
        if not start.level:
            yield Mistake("without_gravity", (), replace(start, level=True))
        for name in self._model.parameters.can_be_taken_out:
            if name not in start.without:
                without = replace(start, without=start.without | {name})
                yield Mistake(f"without_{name.replace(' ', '_')}", (), without)

    def _limits(self) -> Iterator[Mistake]:
        """Efforts that were asked for of motors that cannot give them."""
        start, model = self._start, self._model
        needed = model.needed(self._base)
        for j, design in enumerate(model.designs(start)):
            if j in start.limited_joints or j in start.apart or j not in self._measured:
                continue
            asked, velocity = design.asked(model.samples, start, j)
            for limit in likely_limits(asked, needed[j], velocity):
                sizes = LIMITS ** (1 + int(np.isfinite(limit.no_load_speed)))
                yield Mistake("effort_limit", (j,), start.limited(j, limit), sizes=sizes)

    def _positions(self) -> Iterator[Mistake]:
        """Mistakes with positions, and with the velocities that belong to them."""
        start, n = self._start, self._n
        measured, joints = self._model.samples.rate is not None, self._robot.joints
        turning = tuple(j for j in range(n) if joints[j] not in self._robot.sliding_joints)
        for factor in (_DEGREE, 1.0 / _DEGREE) if len(turning) > 1 else ():
            by = np.where(np.isin(np.arange(n), turning), factor, 1.0)
            alone, where = (
                replace(start, scale=start.scale * by),
                turning if len(turning) < n else (),
            )
            yield Mistake("position_unit", where, replace(alone, rate=start.rate * by))
            if measured:
                yield Mistake("position_alone_unit", where, alone)
        for j in self._suspects:
            for factor, kind in ((-1.0, "sign"), (_DEGREE, "unit"), (1.0 / _DEGREE, "unit")):
                if kind == "unit" and j not in turning:
                    continue
                alone = start.times("scale", j, factor)
                yield Mistake(f"position_{kind}", (j,), alone.times("rate", j, factor))
                if measured:
                    yield Mistake(f"position_alone_{kind}", (j,), alone)
        for i, j in combinations(self._suspects, 2):
            for efforts, kind in ((True, "swapped_joints"), (False, "swapped_positions")):
                yield Mistake(kind, (i, j), start.swapped(i, j, positions=True, efforts=efforts))

    def _zeros(self) -> Iterator[Mistake]:
        """Other zeros, near ones and all over a turn."""
        at = self._model.parameters.zeros()
        for j in self._suspects:
            joint = self._robot.joints[j]
            yield Mistake("position_zero", (j,), self._start, (int(at[j]),), self._moved(0, 0.0))
            steps = 2.0 * np.pi * np.arange(1, _TURNS) / _TURNS
            for step in steps.tolist() if joint not in self._robot.sliding_joints else ():
                moved = self._moved(at[j], float(np.angle(np.exp(1j * step))))
                yield Mistake(
                    "position_zero", (j,), self._start.moved(j, moved[at[j]]), (int(at[j]),), moved
                )

    def _clock(self) -> Iterator[Mistake]:
        """Factors of measured velocities, and of the time."""
        start, factors = self._start, velocity_factors(self._model, self._base)
        known = factors[np.isfinite(factors)]
        for j in np.flatnonzero(np.isfinite(factors)).tolist():
            if _is_other(factors[j]):
                yield Mistake(
                    "velocity_factor", (j,), start.times("rate", j, 1.0 / factors[j]), sizes=SIZES
                )
        common = float(np.median(known)) if len(known) else 1.0
        if len(known) > 1 and _is_other(common):
            yield Mistake(
                "velocity_factor", (), start.times("rate", None, 1.0 / common), sizes=SIZES
            )
        measured = (1.0 / common,) if common > 0.0 and _is_other(common) else ()
        for factor in (*measured, *_TIMES):
            yield Mistake("time", (), replace(start, time=start.time * factor), sizes=SIZES)

    def _others(self) -> Iterator[Mistake]:
        """Yield what is no mistake in columns but looks like one.

        A payload that the model lacks, a base on a slope, something unknown at a joint beside the
        bodies, or in their place.
        """
        start, tilt = self._start, tuple(map(int, self._model.parameters.tilt()))
        for body in self._robot.last_bodies:
            index = self._robot.bodies.index(body)
            if index not in start.carrying:
                yield Mistake("", (), replace(start, carrying=start.carrying | {index}))
        if not start.tilted:
            yield Mistake("", (), replace(start, tilted=True), tilt, self._moved(0, 0.0))
        for j in range(self._n):
            for name in ("unknown", "apart"):
                own = getattr(start, name)
                if j not in own:
                    yield Mistake("", (j,), replace(start, **{name: own | {j}}))
        if len(start.apart) < self._n:
            every = tuple(range(self._n))
            yield Mistake("", every, replace(start, apart=frozenset(every)))


def _is_other(factor: float) -> bool:
    return factor < 0.0 or abs(np.log(factor)) > np.log(_OTHER)


def velocity_factors(model: ColumnModel, base: ColumnFit) -> Array:
    """Return (n,) ratios of measured velocities to derived ones; NaN where nothing moves."""
    samples, start = model.samples, base.assignment
    if samples.rate is None:
        return np.full(len(start.gain), np.nan)
    at = start.position
    measured = samples.rate[:, at] * start.rate
    v = samples.v[:, at] * start.scale / start.time
    moving = np.mean(samples.v[:, at] ** 2, axis=0) > samples.width[at] ** 2
    slope = np.sum(measured * v, axis=0) / np.where(moving, np.sum(v**2, axis=0), 1.0)
    return np.where(moving & (np.abs(slope) > _LEAST_FACTOR), slope, np.nan)


def own_gains(model: ColumnModel, base: ColumnFit) -> tuple[Array, Array]:
    """Find factors of the efforts by which each is nearest to what the model's bodies need.

    Returns:
        (n,) factors, and (n,) the mean square of the efforts that goes with what bodies need.
    """
    parameters, start = model.parameters, base.assignment
    gains, shares = np.ones((2, len(start.gain)))
    for j, design in enumerate(model.designs(start)):
        m = len(design.columns)
        own = (design.columns >= parameters.model.phi.size) & (design.columns < parameters.shared)
        bodies = design.columns < parameters.model.phi.size
        Q, _ = np.linalg.qr(design.X[:, :m][:, own])
        load = design.X[:, :m][:, bodies] @ parameters.mean[design.columns[bodies]] + design.X[:, m]
        s = start.gain[j] * design.X[:, design.place_of(start.effort[j])]
        load, s = (values - Q @ (Q.T @ values) for values in (load, s))
        product, power, strength = float(s @ load), float(s @ s), float(load @ load)
        shares[j] = product**2 / max(power * strength, 1e-300) * power / len(s)
        # Of two directions of a regression, the one with which noise of the effort does not count.
        if abs(product) > 1e-9 * np.sqrt(power * strength) and strength > 0.0:
            gains[j] = strength / product
    return gains, shares
