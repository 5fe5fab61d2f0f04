"""Mistakes that are made with columns: what each of them makes of an assignment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.design import joint_motion
from geodrake.diagnosis.columns.fit import ColumnFit, ColumnJudge
from geodrake.diagnosis.columns.limits import likely_limits
from geodrake.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]

_DEGREE = np.pi / 180.0
_THOUSAND = (1e-3, 1e3)  # N·mm beside N·m, and the other way round; milliseconds
_MINUTE = (60.0, 1.0 / 60.0)
_TIMES = (*_THOUSAND, *_MINUTE, 0.1, 10.0, 0.5, 2.0)
_TURNS = 12  # zeros that are tried at a joint, evenly over a turn
_PAYLOAD, _SLOPE, _APART = 4.0, 2.0, 1.0  # numbers of a mass and its centre, of a tilt, of noise
_LEAST_FACTOR = 1e-100  # of measured velocities: less is none, of which there is no reciprocal
_OTHER = 1.1  # factor by which times, or velocities, are to differ for a hypothesis of its own


@dataclass(frozen=True, eq=False)
class ColumnMistake:
    """A mistake, and the assignment without it.

    Attributes:
        kind: What it is; see `ColumnFinding`.
        joints: Indices of the joints whose columns it is in; none for all.
        assignment: The assignment of the columns that corrects it.
        value: Its size, where it has one.
        free: Parameters of small errors that are to be found large, if its size is to be found.
        times: The columns whose factor was found, if it is no small error.
        numbers: How many other numbers were found.
        spared: What a fit pays for numbers that are none without the mistake.
        price: Numbers that the data say of what is no mistake in columns.
    """

    kind: str
    joints: tuple[int, ...]
    assignment: Assignment
    value: float = np.nan
    free: tuple[int, ...] = ()
    times: str = ""
    numbers: int = 0
    spared: float = 0.0
    price: float = 0.0

    @property
    def sizes(self) -> int:
        """Return how many numbers are found in the data."""
        return len(self.free) + bool(self.times) + self.numbers


def mistakes(judge: ColumnJudge, base: ColumnFit) -> list[ColumnMistake]:
    """Everything that may be wrong with the columns beside what a fit corrects already.

    Args:
        judge: The fits' samples.
        base: The fit by what is known of the columns.
    """
    found = [*_efforts(judge, base), *_limits(judge, base)]
    found += [*_positions(judge, base), *_velocities(judge, base)]
    return [*found, *_zeros(judge, base), *_clocks(judge, base), *_bodies(judge, base)]


def _bodies(judge: ColumnJudge, base: ColumnFit) -> Iterator[ColumnMistake]:
    """What is no mistake in columns, but looks like some.

    A payload that the model lacks, a base on a slope, and a joint of which the bodies explain
    nothing.
    """
    model = judge.parameters.model
    for body in model.last_bodies:
        index = model.bodies.index(body)
        if index not in base.assignment.carrying:
            more = replace(base.assignment, carrying=base.assignment.carrying | {index})
            yield ColumnMistake("", (), more, price=_PAYLOAD)
    if not base.assignment.tilted:
        free = tuple(map(int, judge.parameters.tilt()))
        yield ColumnMistake("", (), replace(base.assignment, tilted=True), free=free, price=_SLOPE)
    for j in range(len(base.assignment.gain)):
        if j not in base.assignment.apart:
            apart = base.assignment.apart | {j}
            yield ColumnMistake("", (j,), replace(base.assignment, apart=apart), price=_APART)


def _efforts(judge: ColumnJudge, base: ColumnFit) -> Iterator[ColumnMistake]:
    """Mistakes with efforts alone, for which the motion stays as it is."""
    start, n = base.assignment, len(base.assignment.gain)
    for j in range(n):
        yield ColumnMistake("effort_sign", (j,), start.times("gain", j, -1.0), -1.0)
        for factor in _THOUSAND:
            yield ColumnMistake("effort_unit", (j,), start.times("gain", j, factor), factor)
    for factor in _THOUSAND if n > 1 else ():
        yield ColumnMistake("effort_unit", (), start.times("gain", None, factor), factor)
    for i, j in combinations(range(n), 2):
        swapped = start.swapped(i, j, positions=False, efforts=True)
        yield ColumnMistake("swapped_efforts", (i, j), swapped)
    gains, free = own_gains(judge, base), judge.parameters.gains()
    for j in range(n):
        yield ColumnMistake(
            "effort_gain", (j,), start.times("gain", j, gains[j]), free=(int(free[j]),)
        )
    if n > 1:
        common, every = common_gain(judge, base), tuple(map(int, free))
        for factors in (np.where(gains > 0.0, gains, common), np.full(n, common)):
            own = replace(start, gain=start.gain * factors)
            yield ColumnMistake("effort_gains", (), own, free=every)
        yield ColumnMistake("effort_gain", (), start.times("gain", None, common), times="gain")
    if not start.level:
        yield ColumnMistake("without_gravity", (), replace(start, level=True))
    for name in judge.parameters.can_be_taken_out:
        if name not in start.without:
            without = replace(start, without=start.without | {name})
            gone = judge.parameters.stated(name)
            kind, spared = f"without_{name.replace(' ', '_')}", judge.spared(base, gone)
            yield ColumnMistake(kind, (), without, spared=spared)


def _limits(judge: ColumnJudge, base: ColumnFit) -> Iterator[ColumnMistake]:
    """Efforts that were asked for of motors that cannot give them."""
    start, samples = base.assignment, judge.samples
    for j, (needed, design) in enumerate(
        zip(judge.needed(base), judge.designs(start), strict=True)
    ):
        if j in start.limited_joints:
            continue
        asked, velocity = design.asked(samples, start, j)
        for limit in likely_limits(asked, needed, velocity):
            numbers = 1 + int(np.isfinite(limit.no_load_speed))
            yield ColumnMistake("effort_limit", (j,), start.limited(j, limit), numbers=numbers)


def _positions(judge: ColumnJudge, base: ColumnFit) -> Iterator[ColumnMistake]:
    """Mistakes with positions, and with the velocities that belong to them."""
    start, n = base.assignment, len(base.assignment.gain)
    measured, model = judge.samples.rate is not None, judge.parameters.model
    turning = tuple(j for j in range(n) if model.joints[j] not in model.sliding_joints)
    for factor in (_DEGREE, 1.0 / _DEGREE) if len(turning) > 1 else ():
        by = np.where(np.isin(np.arange(n), turning), factor, 1.0)
        alone, where = replace(start, scale=start.scale * by), turning if len(turning) < n else ()
        yield ColumnMistake("position_unit", where, replace(alone, rate=start.rate * by), factor)
        if measured:
            yield ColumnMistake("position_alone_unit", where, alone, factor)
    for j in range(n):
        for factor, kind in ((-1.0, "sign"), (_DEGREE, "unit"), (1.0 / _DEGREE, "unit")):
            alone = start.times("scale", j, factor)
            if kind == "unit" and j not in turning:
                continue
            yield ColumnMistake(f"position_{kind}", (j,), alone.times("rate", j, factor), factor)
            if measured:
                yield ColumnMistake(f"position_alone_{kind}", (j,), alone, factor)
    for i, j in combinations(range(n), 2):
        for efforts, kind in ((True, "swapped_joints"), (False, "swapped_positions")):
            swapped = start.swapped(i, j, positions=True, efforts=efforts)
            yield ColumnMistake(kind, (i, j), swapped)


def _velocities(judge: ColumnJudge, base: ColumnFit) -> Iterator[ColumnMistake]:
    """Mistakes with measured velocities."""
    samples, start = judge.samples, base.assignment
    if samples.rate is None:
        return
    factors = velocity_factors(judge, base)
    known = np.isfinite(factors)
    for j in np.flatnonzero(known).tolist():
        if abs(np.log(abs(factors[j]))) > np.log(_OTHER) or factors[j] < 0.0:
            wrong = start.times("rate", j, 1.0 / factors[j])
            yield ColumnMistake(
                "velocity_factor", (j,), wrong, float(1.0 / factors[j]), times="rate"
            )
    if known.sum() > 1:
        common = float(np.median(factors[known]))
        if abs(np.log(abs(common))) > np.log(_OTHER) or common < 0.0:
            wrong = start.times("rate", None, 1.0 / common)
            yield ColumnMistake("velocity_factor", (), wrong, 1.0 / common, times="rate")


def velocity_factors(judge: ColumnJudge, base: ColumnFit) -> Array:
    """(n,) what measured velocities are of the positions' derivatives; NaN where nothing moves.

    Args:
        judge: The fits' samples.
        base: A fit.
    """
    samples, start = judge.samples, base.assignment
    if samples.rate is None:
        return np.full(len(start.gain), np.nan)
    at = start.position
    measured = samples.rate[:, at] * start.rate
    v = samples.v[:, at] * start.scale / start.time
    moving = np.mean(v**2, axis=0) > samples.width[at] ** 2
    slope = np.sum(measured * v, axis=0) / np.where(moving, np.sum(v**2, axis=0), 1.0)
    return np.where(moving & (np.abs(slope) > _LEAST_FACTOR), slope, np.nan)


def _clocks(judge: ColumnJudge, base: ColumnFit) -> Iterator[ColumnMistake]:
    """Mistakes with the time: a factor of the velocities, if they say one, or usual ones."""
    factors = velocity_factors(judge, base)
    known = factors[np.isfinite(factors)]
    if len(known) and np.median(known) > 0.0:
        factor = 1.0 / float(np.median(known))
        if abs(np.log(factor)) > np.log(_OTHER):
            changed = replace(base.assignment, time=base.assignment.time * factor)
            yield ColumnMistake("time", (), changed, factor, times="time")
    for factor in _TIMES:
        changed = replace(base.assignment, time=base.assignment.time * factor)
        yield ColumnMistake("time", (), changed, factor, times="time")


def _zeros(judge: ColumnJudge, base: ColumnFit) -> Iterator[ColumnMistake]:
    """Other zeros: near ones by the slopes of the fit, and the best of a turn for φ as it is."""
    start, free = base.assignment, judge.parameters.zeros()
    model = judge.parameters.model
    for j in range(len(start.gain)):
        yield ColumnMistake("position_zero", (j,), start, free=(int(free[j]),))
    best = list[tuple[float, int, float]]()
    quick = _Quick.of(judge, base)
    for j, joint in enumerate(model.joints):
        if joint not in model.sliding_joints:
            steps = 2.0 * np.pi * np.arange(1, _TURNS) / _TURNS
            costs = [(quick.cost(start.moved(j, step)), step) for step in steps.tolist()]
            cost, step = min(costs)
            best.append((cost, j, float(np.angle(np.exp(1j * step)))))
    for _, j, step in best:
        yield ColumnMistake("position_zero", (j,), start.moved(j, step), step, (int(free[j]),))


@dataclass(frozen=True, eq=False)
class _Quick:
    """Errors of all joints with the bodies of a fit, beside what is linear in each joint alone.

    Attributes:
        judge: The fits' samples.
        phi: (nb, 10) bodies.
        base: The fit.
        bases: Per joint (K, r) orthonormal columns of effects.
        efforts: Per joint (K,) efforts without what these explain, N·m or N.
    """

    judge: ColumnJudge
    phi: Array
    base: ColumnFit
    bases: tuple[Array, ...]
    efforts: tuple[Array, ...]

    @classmethod
    def of(cls, judge: ColumnJudge, base: ColumnFit) -> _Quick:
        parameters, start = judge.parameters, base.assignment
        d, shared = parameters.model.phi.size, parameters.shared
        bases, efforts = [], []
        for j, design in enumerate(judge.designs(start)):
            own = (design.columns >= d) & (design.columns < shared)
            Q, _ = np.linalg.qr(design.X[:, : len(own)][:, own])
            m = len(design.columns) + 1
            s = start.gain[j] * design.X[:, m + start.effort[j]]
            bases.append(Q)
            efforts.append(s - Q @ (Q.T @ s))
        return cls(judge, parameters.model.total_phi, base, tuple(bases), tuple(efforts))

    def cost(self, assignment: Assignment) -> float:
        """Twice the negative log-likelihood for another motion."""
        judge, model = self.judge, self.judge.parameters.model
        q, v, vd = joint_motion(judge.samples, assignment)
        load = inverse_dynamics(model.tree, model.positions(q), v, vd, self.phi)
        if assignment.level:
            still = np.zeros_like(v)
            load = load - inverse_dynamics(model.tree, model.positions(q), still, still, self.phi)
        total = 0.0
        for j, (Q, s) in enumerate(zip(self.bases, self.efforts, strict=True)):
            rows = np.flatnonzero(judge.samples.used[:, assignment.position[j]])
            left = s - load[rows, j] + Q @ (Q.T @ load[rows, j])
            total += self.base.effective[assignment.effort[j]] * np.log(np.mean(left**2) + 1e-300)
        return float(total)


def own_gains(judge: ColumnJudge, base: ColumnFit) -> Array:
    """(n,) factors of the efforts by which each would be nearest to what the bodies need.

    Args:
        judge: The fits' samples.
        base: A fit.
    """
    needed, measured = _both(judge, base)
    power = np.array([s @ s for s in measured])
    products = np.array([s @ load for s, load in zip(measured, needed, strict=True)])
    # Of two directions of a regression, the one with which noise of the effort does not count.
    strength = np.array([load @ load for load in needed])
    usable = (np.abs(products) > 1e-9 * np.sqrt(power * strength)) & (strength > 0.0)
    return np.where(usable, strength / np.where(usable, products, 1.0), 1.0)


def common_gain(judge: ColumnJudge, base: ColumnFit) -> float:
    """Return the one factor of all efforts by which they are nearest to what the bodies need.

    Args:
        judge: The fits' samples.
        base: A fit.
    """
    needed, measured = _both(judge, base)
    weight = base.effective[base.assignment.effort]
    factors = own_gains(judge, base)
    share = [
        abs(s @ load) / np.sqrt(max(float((s @ s) * (load @ load)), 1e-300))
        for s, load in zip(measured, needed, strict=True)
    ]
    positive = factors > 0.0
    if not positive.any():
        return 1.0
    weight = weight * np.square(share)
    return float(np.exp(np.average(np.log(factors[positive]), weights=weight[positive])))


def _both(judge: ColumnJudge, base: ColumnFit) -> tuple[list[Array], list[Array]]:
    """What the model's bodies and effects need at each joint, and efforts, without nuisances."""
    parameters, start = judge.parameters, base.assignment
    d, shared = parameters.model.phi.size, parameters.shared
    needed, measured = [], []
    for j, design in enumerate(judge.designs(start)):
        own = (design.columns >= d) & (design.columns < shared)
        m = len(design.columns)
        Q, _ = np.linalg.qr(design.X[:, :m][:, own])
        load = design.X[:, :m][:, ~own] @ parameters.mean[design.columns][~own] + design.X[:, m]
        s = start.gain[j] * design.X[:, m + 1 + start.effort[j]]
        needed.append(load - Q @ (Q.T @ load))
        measured.append(s - Q @ (Q.T @ s))
    return needed, measured
