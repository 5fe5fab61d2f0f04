"""The evidence of an assignment of columns: one Gaussian model of all joints' efforts.

Bodies are near those of the model by the pullback metric ([Lee2019] section 3.5); friction, offsets
and rotors are free; the base may lean, and gains and zeros be off, as much as is usual. What is
left is noise, profiled out on the scale of its column, so that a gain of zero explains nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.design import (
    UNKNOWN,
    USUAL_REST,
    EffectRows,
    JointDesign,
    Parameters,
    joint_designs,
    joint_motion,
)
from geodrake.diagnosis.columns.limits import spread
from geodrake.diagnosis.columns.samples import ColumnSamples
from geodrake.identification.logs.criteria import LARGEST, LEAST_NOISE, NOISE_MARGIN
from geodrake.identification.logs.noise import noise_floor
from geodrake.identification.logs.unknowns import payload_reference, pullback_information
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CARRIED = 3.0
"""A body that may hold a payload is known to within this geometric distance."""

WIDE = {"gain": 4.0, "apart": 1.2, "zero": 1.0, "tilt": 0.5}
"""Deviations of errors that are to be found: of the logarithm of the gains of all joints, and of
each one from that, as motors of one robot are alike; of a zero and of a slope, rad."""

USUAL_RANGE, USUAL_RATE, USUAL_SPREAD = 2.0, 200.0, 1.5
"""So far joints turn, rad, and so often logs are sampled, 1/s, with the deviation of logarithms:
hardly any joint turns by 0.02 or by 200 rad, hardly any log has 2 or 20,000 samples a second."""

LEAST_RANGE = 0.02
"""A joint that turns by less, rad, is at rest, whatever its unit."""

_ROUNDS = 12  # of a fit, in which weights and what gains act on change
_HOPED = 0.03  # error over the deviation of efforts, that a fit begins with where none is near
_SETTLED = 1e-3  # change of the logarithm of the noise
_FURTHEST = 0.5  # logarithm of a gain's error: farther, sizes of efforts are other ones
_RATE_AGREEMENT = 0.05  # of a velocity's RMS: measured ones are the derivatives but for that
_LEAST = 1e-12  # information: that of what efforts do not depend on
_MOST_KEPT = 200_000_000  # bytes of designs


@dataclass(frozen=True, eq=False)
class ColumnFit:
    """A fit by one assignment.

    Attributes:
        assignment: The assignment.
        x: (p,) parameters.
        mse: (n,) mean squared errors of each column of efforts, in its own unit.
        score: Twice the logarithm of the evidence.
    """

    assignment: Assignment
    x: Array
    mse: Array
    score: float


class ColumnModel:
    """The Gaussian model of some samples."""

    def __init__(self, samples: ColumnSamples, beliefs: Beliefs) -> None:
        self.samples, self.parameters = samples, Parameters.of(samples)
        self.noise, self.beliefs = noise_floor(samples.trajectories), beliefs
        self._designs: dict[tuple[object, ...], tuple[JointDesign, ...]] = {}
        self._rows: EffectRows = {}
        periods = [segment.period for t in samples.trajectories for segment in t.segments]
        self._rate = 1.0 / float(np.median(periods))
        rows = [np.arange(len(samples))] * samples.v.shape[1]
        self._rates = samples.effective(list(samples.v.T), rows)

    def designs(self, assignment: Assignment) -> tuple[JointDesign, ...]:
        """Return the joints' normal matrices for an assignment; those of last motions are kept."""
        key = assignment.motion_key
        found = self._designs.pop(key, None)
        if found is None:
            found = joint_designs(self.samples, self.parameters, assignment, self._rows)
            each = sum(design.X.nbytes for design in found)
            while self._designs and (len(self._designs) + 1) * each > _MOST_KEPT:
                self._designs.pop(next(iter(self._designs)))
        self._designs[key] = found
        return tuple(d.read_as(self.samples, assignment, j) for j, d in enumerate(found))

    def hopeful(self) -> Array:
        """Return (n,) independent samples of each column, as long as mistakes may be in it."""
        return np.full(len(self._rates), float(len(self.samples)))

    def worth(self, fit: ColumnFit) -> Array:
        """Return (n,) independent samples that a fit's residuals of each column are worth."""
        system = _System(self, fit.assignment, ())
        left = [joint.residual(fit.x) for joint in system.near(fit.x)]
        found = np.zeros(len(left))
        rows = [design.rows for design in system.designs]
        found[fit.assignment.effort] = self.samples.effective(left, rows)
        # What is more than sensor noise goes with the motion, however often that repeats.
        noise = np.square(NOISE_MARGIN * self.noise) / np.maximum(fit.mse, 1e-300)
        more = np.clip(1.0 - noise, 0.0, 1.0)
        repeated = np.minimum(found, self.beliefs.discrepancy)
        return np.asarray(1.0 / ((1.0 - more) / found + more / repeated))

    def fit(
        self,
        assignment: Assignment,
        worth: Array,
        near: ColumnFit | None = None,
        *,
        wide: Collection[int] = (),
        moved: Array | None = None,
    ) -> ColumnFit:
        """Fit all joints by an assignment.

        Args:
            assignment: The assignment.
            worth: (n,) independent samples of each column of efforts.
            near: A fit whose errors say how much each joint counts at first; by default, all
                count as if they were explained.
            wide: Parameters of errors that may be large.
            moved: (p,) by how much the assignment has moved these already.
        """
        return _System(self, assignment, wide).fitted(worth, near, moved)

    def needed(self, fit: ColumnFit) -> list[Array]:
        """Return per joint (K,) efforts that bodies and effects of a fit need."""
        assignment, found = fit.assignment, list[Array]()
        for j, joint in enumerate(_System(self, assignment, ()).near(fit.x)):
            design = joint.design
            effort = design.X[:, design.place_of(assignment.effort[j])]
            found.append(joint.residual(fit.x) + assignment.gain[j] * effort)
        return found

    def needed_by_model(self, assignment: Assignment, rows: Indices | slice = slice(None)) -> Array:
        """Return (K, n) efforts that the model's own bodies need for the motion in some rows."""
        robot = self.parameters.model
        q, v, vd = (part[rows] for part in joint_motion(self.samples, assignment))
        load = inverse_dynamics(robot.tree, robot.positions(q), v, vd, robot.total_phi)
        if assignment.level:
            still = np.zeros_like(v)
            load -= inverse_dynamics(robot.tree, robot.positions(q), still, still, robot.total_phi)
        return np.asarray(load)

    def nrms(self, fit: ColumnFit) -> float:
        """Return the root mean square over joints of errors over the deviations of efforts."""
        return float(np.sqrt(np.mean(fit.mse / self.samples.effort.var(axis=0))))

    def usual_score(self, assignment: Assignment) -> float:
        """Return twice the logarithm of how usual ranges of joints and the rate of samples are."""
        model = self.parameters.model
        turns = [joint not in model.sliding_joints for joint in model.joints]
        reach = np.abs(assignment.scale) * np.ptp(self.samples.q, axis=0)[assignment.position]
        found = np.append(np.maximum(reach[turns], LEAST_RANGE) / USUAL_RANGE, 1.0)
        found[-1] = self._rate / assignment.time / USUAL_RATE
        far = np.log(found) / USUAL_SPREAD
        return -float(far @ far)

    def rate_score(self, assignment: Assignment) -> float:
        """Return twice the log-likelihood of measured velocities; zero if there are none."""
        samples = self.samples
        if samples.rate is None:
            return 0.0
        share = assignment.scale / (assignment.time * assignment.rate)
        at = assignment.position
        error = np.mean((samples.rate[:, at] - samples.v[:, at] * share) ** 2, axis=0)
        size = np.mean(samples.rate[:, at] ** 2, axis=0)
        slow = np.mean(samples.v[:, at] ** 2, axis=0) < samples.width[at] ** 2
        relative = np.maximum(error / np.maximum(size, 1e-300), _RATE_AGREEMENT**2)
        errors = np.where(slow | (size == 0.0), 1.0, relative)
        return -float(np.minimum(self._rates, self.beliefs.discrepancy)[at] @ np.log(errors))


@dataclass(frozen=True, eq=False)
class _JointSystem:
    """Equations of one joint: its parameters, its gain's error last, explain its efforts.

    Attributes:
        design: The design.
        parameters: (m + 1,) those parameters.
        factor: (m,) what the design's columns are multiplied by.
        ends: (·, 2) of the design's columns, what an error of the gain changes, and the efforts.
    """

    design: JointDesign
    parameters: Indices
    factor: Array
    ends: Array

    @property
    def gram(self) -> Array:
        """(m + 2, m + 2) normal matrix, efforts last."""
        m, gram = len(self.factor), self.design.gram
        mapped, found = gram @ self.ends, np.empty((m + 2, m + 2))
        np.multiply(gram[:m, :m], self.factor[:, None] * self.factor, out=found[:m, :m])
        found[:m, m:] = self.factor[:, None] * mapped[:m]
        found[m:, :m], found[m:, m:] = found[:m, m:].T, self.ends.T @ mapped
        return found

    def residual(self, x: Array) -> Array:
        """(K,) what is needed with parameters (p,), less the efforts."""
        m, own = len(self.factor), x[self.parameters]
        columns = self.ends @ [own[-1], -1.0]
        columns[:m] += self.factor * own[:-1]
        return np.asarray(self.design.X @ columns)


class _System:
    """Normal equations of all joints, in the parameters that an assignment leaves free."""

    def __init__(self, model: ColumnModel, assignment: Assignment, wide: Collection[int]) -> None:
        self.model, self.assignment = model, assignment
        self.designs = model.designs(assignment)
        parameters, n = model.parameters, len(self.designs)
        mean, information = parameters.mean.copy(), parameters.information.copy()
        lower = parameters.lower.copy()
        sizes = np.abs(assignment.gain) * model.samples.effort.std(axis=0)[assignment.effort]
        sizes = np.maximum(sizes, 1e-300)
        lacking = parameters.lacking
        for j, (design, size) in enumerate(zip(self.designs, sizes.tolist(), strict=True)):
            of_lacking = (design.columns >= lacking.start) & (design.columns < lacking.stop)
            at = design.columns[of_lacking]
            information[at, at] += (design.peak[of_lacking] / (LARGEST * size)) ** 2
            share = 1.0 if j in assignment.apart else model.beliefs.unknown
            at = design.columns[-UNKNOWN:]
            power = np.sqrt(
                np.diag(design.gram)[len(design.columns) - UNKNOWN : len(design.columns)]
                / len(design.rows)
            )
            information[at, at] = (power / (share * size)) ** 2
        self._widen(information, wide)
        gone = parameters.taken_out(assignment.without)
        left = np.maximum((USUAL_REST * mean[gone]) ** 2.0, 1e-12)
        mean[gone], lower[gone] = 0.0, -np.inf
        information[gone] = information[:, gone] = 0.0
        information[gone, gone] = 1.0 / left
        load = payload_reference(parameters.model.total_phi)
        for body in assignment.carrying:
            own = slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1))
            mean[own] += load
            information[own] = information[:, own] = 0.0
            information[own, own] = pullback_information(mean[own][None], CARRIED)
        diagonal = np.arange(len(mean))
        information[diagonal, diagonal] = np.maximum(information[diagonal, diagonal], _LEAST)
        free = np.ones(len(mean), bool)
        for j in range(n):
            if j not in assignment.unknown:
                free[parameters.unknown(j)] = False
        self.free = np.flatnonzero(free)
        self.mean, self.information, self.lower = mean, information, lower
        self._bodies, self._errors = parameters.model.phi.size, parameters.shared
        self._functions = int(parameters.unknown(0)[0])
        self._gains = parameters.gains()

    def _widen(self, information: Array, wide: Collection[int]) -> None:
        """Free errors of zeros, gains and tilt that are to be found."""
        parameters, found = self.model.parameters, np.array(sorted(wide), np.intp)
        gains = np.intersect1d(found, parameters.gains())
        if len(gains):
            covariance = WIDE["gain"] ** 2 + WIDE["apart"] ** 2 * np.eye(len(gains))
            information[np.ix_(gains, gains)] = np.linalg.inv(covariance)
        zeros = np.intersect1d(found, parameters.zeros())
        information[zeros, zeros] = WIDE["zero"] ** -2.0
        tilt = parameters.tilt()
        if self.assignment.tilted or np.isin(tilt, found).all():
            information[tilt, tilt] = WIDE["tilt"] ** -2.0

    def near(self, x: Array) -> Iterator[_JointSystem]:
        """Yield the joints' equations near parameters (p,), where gains act on what is needed."""
        assignment, n = self.assignment, len(self.designs)
        for j, design in enumerate(self.designs):
            m, error = len(design.columns), x[self._gains[j]]
            factor, ends = np.full(m, np.exp(error)), np.zeros((m + 1 + n, 2))
            if j in assignment.apart:
                bodies = design.columns < self._bodies
                errors = (design.columns >= self._errors) & (design.columns < self._functions)
                factor = np.where(bodies | errors, 0.0, 1.0)
            else:
                needed = np.exp(error) * np.append(x[design.columns], 1.0)
                ends[: m + 1, 0], ends[: m + 1, 1] = needed, error * needed
                ends[m, 1] -= np.exp(error)
            ends[m + 1 + assignment.effort[j], 1] = assignment.gain[j]
            yield _JointSystem(design, np.append(design.columns, self._gains[j]), factor, ends)

    def _carrying(self, x: Array) -> Array:
        """(b, 10) inertial parameters of the bodies that may hold a payload."""
        bodies = x[: self._bodies].reshape(-1, PARAMETERS_PER_BODY)
        return np.asarray(bodies[sorted(self.assignment.carrying)])

    def fitted(self, worth: Array, near: ColumnFit | None, moved: Array | None) -> ColumnFit:
        """See `ColumnModel.fit`."""
        assignment, free = self.assignment, self.free
        count = np.array([len(design.rows) for design in self.designs], float)
        each, scale = worth[assignment.effort], np.square(assignment.gain)
        power = np.array(
            [
                scale[j] * d.gram[k, k] / count[j]
                for j, d in enumerate(self.designs)
                for k in [d.place_of(assignment.effort[j])]
            ]
        )
        least = power * LEAST_NOISE**2 + 1e-300
        mse = _HOPED**2 * power if near is None else near.mse[assignment.effort] * scale
        mse = np.clip(mse, least, np.maximum(power, least))
        x, held = self.mean.copy(), np.zeros(len(self.mean), bool)
        offset = np.zeros_like(x) if moved is None else moved
        pull = self.information @ (self.mean - offset)
        for _ in range(_ROUNDS):
            H, b = self.information.copy(), pull.copy()
            local = []
            for j, joint in enumerate(self.near(x)):
                small, at = joint.gram, joint.parameters
                weight = each[j] / count[j] / mse[j]
                H[at[:, None], at] += weight * small[:-1, :-1]
                b[at] += weight * small[:-1, -1]
                local.append((at, small))
            H, b = H[free[:, None], free], b[free]
            to = x.copy()
            to[free] = _bounded(H, b, self.lower[free], held[free])
            held[free] = np.where(held[free], H @ to[free] >= b, to[free] < self.lower[free])
            to = np.maximum(to, self.lower)
            to[self._gains] = np.clip(to[self._gains], -_FURTHEST, _FURTHEST)
            x, before = to, mse
            ends = [np.append(x[at], -1.0) for at, _ in local]
            squares = [end @ small @ end for end, (_, small) in zip(ends, local, strict=True)]
            mse = np.maximum(np.array(squares) / count, least)
            if np.abs(np.log(mse / before)).max() < _SETTLED:
                break
        far = (x - self.mean + offset)[free]
        prior = self.information[free[:, None], free]
        spreads = np.array([spread(m, d.beyond) for m, d in zip(mse, self.designs, strict=True)])
        score = (
            -float(each @ np.log(spreads / scale))
            - float(far @ prior @ far)
            - _log_determinant(H)
            + _log_determinant(prior)
            + self.model.rate_score(assignment)
            + self.model.usual_score(assignment)
        )
        if (self._carrying(x)[:, 0] <= 0.0).any():  # no mass
            score = -np.inf
        by_column = np.zeros(len(count))
        by_column[assignment.effort] = spreads / scale
        return ColumnFit(assignment, x, by_column, score)


def _bounded(A: Array, b: Array, lower: Array, held: NDArray[np.bool_]) -> Array:
    """Solve a positive definite system, some of the unknowns at their lower bounds."""
    x, free = np.where(held, lower, 0.0), ~held
    scale = 1.0 / np.sqrt(np.diag(A)[free])
    right = scale * (b - A[:, held] @ x[held])[free]
    scaled = A[np.ix_(free, free)] * scale * scale[:, None]
    np.fill_diagonal(scaled, 1.0 + 1e-12)
    x[free] = scale * solve(scaled, right, assume_a="pos")
    return x


def _log_determinant(A: Array) -> float:
    scale = 1.0 / np.sqrt(np.diag(A))
    scaled = A * scale * scale[:, None]
    np.fill_diagonal(scaled, 1.0 + 1e-12)
    return float(np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum())
