"""Evidence of an assignment of columns: one Gaussian model of all joints' efforts.

The prior of the bodies is the pullback metric ([Lee2019] section 3.5) about the model's bodies.
Friction, offsets and rotor inertia are free; the base's tilt, gains and zeros have usual
deviations. The noise of each effort column is in the column's own unit, so that a gain of zero
explains nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.design import UNKNOWN, JointDesign, MotionDesigns
from geodrake.diagnosis.columns.gaussian import JointEquations, most_probable
from geodrake.diagnosis.columns.limits import spread
from geodrake.diagnosis.columns.samples import ColumnSamples
from geodrake.effects import catalogue
from geodrake.effects.base import Effect
from geodrake.effects.declarations import Role
from geodrake.identification.logs.criteria import LARGEST, NOISE_MARGIN, SPREAD
from geodrake.identification.logs.log_slices import Layout
from geodrake.identification.logs.noise import known_noise
from geodrake.identification.logs.unknowns import payload_reference, pullback_information
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

USUAL_TILT, USUAL_ZERO = 0.03, 0.02
"""Prior deviations of a base's tilt about each horizontal axis, rad, and of zeros, rad or m."""

USUAL_MASS = 0.3
"""Relative prior deviation of the robot's total mass, if bodies may differ much."""

USUAL_REST = 0.1
"""Relative prior deviation of subtracted friction or rotor inertia that is left over."""

PAYLOAD_WIDTH = 3.0
"""Prior width of a body that may carry a payload, as a geometric distance."""

WIDE_GAIN, WIDE_RELATIVE_GAIN, WIDE_ZERO, WIDE_TILT = 4.0, 1.2, 1.0, 0.5
"""Prior deviations of errors that are searched for: the logarithm of the common gain of all joints,
and of each gain relative to it, as motors of one robot are similar; a zero and a tilt, rad."""

USUAL_RANGE, USUAL_RATE, USUAL_SPREAD = 2.0, 200.0, 1.5
"""Typical range of a revolute joint, rad, and typical sampling rate, 1/s, with the deviation of
their logarithms: 0.02 or 200 rad are very unlikely, and so are 2 or 20,000 samples a second."""

LEAST_RANGE = 0.02
"""Smaller ranges, rad, count as this one: the joint is at rest in any unit."""

_LONGEST = 0.7  # rad, or logarithm of a gain, of a step
_RATE_AGREEMENT = 0.05  # relative difference between measured velocities and derivatives
_LEAST = 1e-12  # information of parameters on which no effort depends
_CACHE_SIZE = 200_000_000  # bytes of designs


@dataclass(frozen=True, eq=False)
class ColumnFit:
    """Fit by one assignment."""

    assignment: Assignment
    x: Array  # (p,) parameters
    mse: Array  # (n,) mean squared error of each effort column, in its own unit
    score: float  # twice the log-evidence


class ColumnModel:
    """Gaussian model of column samples.

    The parameters are those of bodies and effects, the tilt of the base (2), errors of the zeros
    (n), logarithms of the errors of the gains (n), and those of unknown functions of joints.
    """

    def __init__(self, samples: ColumnSamples, beliefs: Beliefs) -> None:
        self.samples, self.beliefs, model = samples, beliefs, samples.model
        self.noise, n = known_noise(samples.trajectories)[0], len(model.joints)
        fitted = [f for f in model.effects if _is_seen(f.effect)]
        known_keys = {(f.effect.name, f.effect.where) for f in fitted}
        usual = [kind for kind in catalogue() if kind.complexity == 0]
        more = [e for kind in usual for joint in model.single_joints for e in kind.shaped(joint)]
        more = [effect for effect in more if (effect.name, effect.where) not in known_keys]
        self.effects = [*(f.effect for f in fitted), *more]
        self.layout = Layout.of(model, tuple(self.effects), samples.width, samples.width)
        information, size = _information(samples), model.phi.size
        first = len(information) + sum(len(effect.parameters) for effect in more)
        # Friction that a model file states is as uncertain as friction that it lacks.
        self.lacking = slice(size if model.information is None else len(information), first)
        self.tilt, self.zeros = first + np.arange(2), first + 2 + np.arange(n)
        self.gains = self.zeros + n
        gains = np.maximum(samples.gain_deviations, 1e-3)
        errors = np.concatenate([np.full(2, USUAL_TILT), np.full(n, USUAL_ZERO), gains])
        zero = np.zeros(first - len(information))
        self.information = block_diag(information, np.diag(zero), np.diag(errors**-2.0))
        stated = [model.total_phi.ravel(), *(f.parameters for f in fitted)]
        self.mean = np.concatenate([*stated, zero, np.zeros(len(errors))])
        self.lower = np.full(len(self.mean), -np.inf)
        self.lower[size:first] = [q.lower for e in self.effects for q in e.parameters]
        self._designs: dict[tuple[object, ...], MotionDesigns] = {}
        self._fits: dict[tuple[object, ...], ColumnFit] = {}  # without `score_of_motion`
        periods = [segment.period for t in samples.trajectories for segment in t.segments]
        self._rate = 1.0 / float(np.median(periods))
        self._rates = samples.effective(list(samples.v.T), [np.arange(len(samples))] * n)
        self._reach, self._deviations = np.ptp(samples.q, axis=0), samples.effort.std(axis=0)
        self._slow = np.mean(samples.v**2, axis=0) < samples.width**2

    def designs(self, assignment: Assignment) -> list[JointDesign]:
        """Return the joints' designs for an assignment; the latest motions are cached."""
        key, samples = assignment.motion_key, self.samples
        kept = self._designs.pop(key, None)
        if kept is None:
            kept = MotionDesigns(samples, self.layout, assignment)
            size = kept.nbytes + sum(cached.nbytes for cached in self._designs.values())
            while self._designs and size > _CACHE_SIZE:
                size -= self._designs.pop(next(iter(self._designs))).nbytes
        self._designs[key] = kept
        return [
            kept(j, source, unknown=j in assignment.unknown).read_as(samples, assignment, j)
            for j, source in enumerate(assignment.effort.tolist())
        ]

    def full_counts(self) -> Array:
        """Return (n,) sample counts as if all were independent, used while mistakes dominate."""
        return np.full(len(self._rates), float(len(self.samples)))

    def effective_counts(self, fit: ColumnFit) -> Array:
        """Return (n,) effective sample sizes of a fit's residuals in each effort column."""
        joints = self._joints(fit.assignment)
        residuals = [np.subtract(*joint.needed(fit.x)) for joint in joints]
        rows = [joint.design.rows for joint in joints]
        counts = np.zeros(len(residuals))
        counts[fit.assignment.effort] = self.samples.effective(residuals, rows)
        # Residuals beyond sensor noise vary with the motion, and repeat with it.
        noise = np.square(NOISE_MARGIN * self.noise) / np.maximum(fit.mse, 1e-300)
        excess = np.clip(1.0 - noise, 0.0, 1.0)
        repeated = np.minimum(counts, self.beliefs.discrepancy)
        return np.asarray(1.0 / ((1.0 - excess) / counts + excess / repeated))

    def needed(self, fit: ColumnFit) -> list[Array]:
        """Return per joint the (K,) efforts that a fit predicts."""
        return [joint.needed(fit.x)[0] for joint in self._joints(fit.assignment)]

    def needed_by_model(self, assignment: Assignment, rows: Indices | slice = slice(None)) -> Array:
        """Return the (K, n) efforts that the model's bodies need for the motion in some rows."""
        robot, (q, v, vd) = self.samples.model, self.samples.motion(assignment, rows)
        tree = robot.tree
        if assignment.gravity is not None:
            tree = replace(tree, gravity=np.array(assignment.gravity))
        return inverse_dynamics(tree, robot.positions(q), v, vd, robot.total_phi)

    def nrms(self, fit: ColumnFit) -> float:
        """Return the RMS over joints of errors, each relative to the deviation of the effort."""
        return float(np.sqrt(np.mean(fit.mse / self._deviations**2)))

    def moved(self, assignment: Assignment, step: Array) -> Assignment:
        """Return an assignment with zeros, gains and tilt changed by a step (p,)."""
        zero = assignment.zero + step[self.zeros]
        moved = replace(assignment, zero=zero, gain=assignment.gain / np.exp(step[self.gains]))
        if step[self.tilt].any():
            turn = Rotation.from_rotvec([*-step[self.tilt], 0.0])
            down = assignment.gravity or self.samples.model.tree.gravity
            moved = replace(moved, gravity=tuple(turn.apply(down).tolist()))
        return moved

    def newton_step(self, fit: ColumnFit, free: Collection[int]) -> Array:
        """Return the limited Newton step (p,) in some errors of zeros, gains and tilt."""
        step, indices = np.zeros(len(self.mean)), list(free)
        step[indices] = np.clip(fit.x[indices], -_LONGEST, _LONGEST)
        return step

    def score_of_motion(self, assignment: Assignment) -> float:
        """Return twice the log-likelihood of ranges, the sampling rate and measured velocities."""
        samples, model, source = self.samples, self.samples.model, assignment.position
        revolute = [joint not in model.sliding_joints for joint in model.joints]
        reach = np.abs(assignment.scale) * self._reach[source]
        ranges = np.log(np.maximum(reach[revolute], LEAST_RANGE) / USUAL_RANGE) / USUAL_SPREAD
        period = np.log(self._rate / assignment.time / USUAL_RATE) / USUAL_SPREAD
        score = -float(ranges @ ranges + period**2)
        if samples.rate is None:
            return score
        v, rate = samples.v[:, source], samples.rate[:, source]
        share = assignment.scale / (assignment.time * assignment.rate)
        error, power = np.mean((rate - v * share) ** 2, axis=0), np.mean(rate**2, axis=0)
        relative = np.maximum(error / np.maximum(power, 1e-300), _RATE_AGREEMENT**2)
        errors = np.where(self._slow[source] | (power == 0.0), 1.0, relative)
        counts = np.minimum(self._rates, self.beliefs.discrepancy)
        return score - float(counts[source] @ np.log(errors))

    def _joints(self, assignment: Assignment) -> list[JointEquations]:
        joints, effects = list[JointEquations](), self.samples.model.phi.size
        for j, design in enumerate(self.designs(assignment)):
            indices, local = [design.columns, self.tilt, self.zeros], np.arange(design.linear)
            effort, payload = np.zeros((2, design.X.shape[1]))
            effort[design.effort(int(assignment.effort[j]))] = assignment.gain[j]
            if j in assignment.detached:
                local = np.flatnonzero(design.columns >= effects)
                indices = [design.columns[local]]
            if j in assignment.unknown:
                preceding = sum(other < j for other in assignment.unknown)
                indices.append(len(self.mean) + UNKNOWN * preceding + np.arange(UNKNOWN))
                local = np.append(local, design.unknown)
            if j not in assignment.detached:
                indices.append(self.gains[[j]])
                payload[design.effort(-1)] = 1.0
            joints.append(JointEquations(design, np.concatenate(indices), local, effort, payload))
        return joints

    def _prior(
        self, assignment: Assignment, joints: Sequence[JointEquations], wide: Collection[int]
    ) -> tuple[Array, Array, Array]:
        """Return the prior mean (p,), information (p, p) and lower bounds (p,)."""
        mean, information, lower = self.mean.copy(), self.information.copy(), self.lower.copy()
        unknown, first = list[Array](), self.samples.model.phi.size
        for j, joint in enumerate(joints):
            design, size = joint.design, self._size(assignment, j)
            added = np.flatnonzero(design.columns >= self.lacking.start)
            columns, peak = design.columns[added], design.peaks[added]
            information[columns, columns] += (peak / (LARGEST * size)) ** 2
            if j in assignment.unknown:
                share = 1.0 if j in assignment.detached else self.beliefs.unknown
                power = np.diag(design.gram)[design.unknown] / len(design.rows)
                unknown.append(power / (share * size) ** 2)
        self._widen(information, assignment, wide)
        if assignment.is_far:
            masses = np.arange(0, self.samples.model.phi.size, PARAMETERS_PER_BODY)
            information[:first] *= SPREAD / self.beliefs.widths[-1]
            information[:, :first] *= SPREAD / self.beliefs.widths[-1]
            information[np.ix_(masses, masses)] += (USUAL_MASS * mean[masses].sum()) ** -2.0
        subtracted = list[int]()
        for effect in self.effects:
            indices = range(first, first := first + len(effect.parameters))
            subtracted += indices if effect.taken_out_as in assignment.subtracted else ()
        variance = np.maximum((USUAL_REST * mean[subtracted]) ** 2.0, 1e-12)
        mean[subtracted], lower[subtracted] = 0.0, -np.inf
        information[subtracted] = information[:, subtracted] = 0.0
        information[subtracted, subtracted] = 1.0 / variance
        load = payload_reference(self.samples.model.total_phi)
        for body in assignment.payload_bodies:
            span = slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1))
            mean[span] += load
            information[span] = information[:, span] = 0.0
            information[span, span] = pullback_information(mean[span][None], PAYLOAD_WIDTH)
        extra = np.concatenate([np.zeros(0), *unknown])
        information = block_diag(information, np.diag(extra)) if len(extra) else information
        np.fill_diagonal(information, np.maximum(np.diag(information), _LEAST))
        bounds = np.full(len(extra), -np.inf)
        return np.append(mean, 0.0 * extra), information, np.append(lower, bounds)

    def _size(self, assignment: Assignment, joint: int) -> float:
        """Return the standard deviation of a joint's efforts, N·m or N."""
        deviation = self._deviations[assignment.effort[joint]]
        return max(float(abs(assignment.gain[joint]) * deviation), 1e-300)

    def _widen(self, information: Array, assignment: Assignment, wide: Collection[int]) -> None:
        """Widen the prior of errors of zeros, gains and tilt that are searched for."""
        indices = np.array(sorted(wide), np.intp)
        gains, zeros = np.intersect1d(indices, self.gains), np.intersect1d(indices, self.zeros)
        if len(gains):
            covariance = WIDE_GAIN**2 + WIDE_RELATIVE_GAIN**2 * np.eye(len(gains))
            information[np.ix_(gains, gains)] = np.linalg.inv(covariance)
        information[zeros, zeros] = WIDE_ZERO**-2.0
        if assignment.gravity is not None:
            information[self.tilt, self.tilt] = WIDE_TILT**-2.0

    def fit(
        self,
        assignment: Assignment,
        counts: Array,
        near: ColumnFit | None = None,
        *,
        wide: Collection[int] = (),
        moved: Array | None = None,
    ) -> ColumnFit:
        """Fit all joints by an assignment.

        Args:
            counts: (n,) independent samples of each effort column.
            near: Fit whose errors give the initial weights of the joints; by default, as if all
                were well explained.
            wide: Indices of errors with a wide prior.
            moved: (p,) change of the parameters that the assignment includes already.
        """
        mse_key = None if near is None else near.mse.tobytes()
        moved_key = None if moved is None else moved.tobytes()
        key = assignment.effort_key, tuple(wide), counts.tobytes(), mse_key, moved_key
        if key not in self._fits:
            self._fits[key] = self._fitted(assignment, counts, near, wide, moved)
        efforts = self._fits[key]
        score = efforts.score + self.score_of_motion(assignment)
        return replace(efforts, assignment=assignment, score=score)

    def of_other_rates(self, fit: ColumnFit, assignment: Assignment) -> ColumnFit:
        """Return a fit with other velocity factors, on which efforts do not depend."""
        gain = self.score_of_motion(assignment) - self.score_of_motion(fit.assignment)
        return replace(fit, assignment=assignment, score=fit.score + gain)

    def _fitted(
        self,
        assignment: Assignment,
        counts: Array,
        near: ColumnFit | None,
        wide: Collection[int],
        moved: Array | None,
    ) -> ColumnFit:
        """Return the result of `fit` without the score of the motion."""
        joints = self._joints(assignment)
        mean, information, lower = self._prior(assignment, joints, wide)
        start = mean.copy()
        if moved is not None:
            mean[: len(moved)] -= moved
        sources, scale = assignment.effort, np.square(assignment.gain)
        mse = None if near is None else near.mse[sources] * scale
        solution = most_probable(
            joints,
            counts[sources],
            (mean, information, lower),
            start=start,
            gains=self.gains,
            mse=mse,
        )
        pairs = zip(solution.mse.tolist(), joints, strict=True)
        errors = np.array([spread(m, joint.design.beyond) for m, joint in pairs]) / scale
        score = solution.score - float(counts[sources] @ np.log(errors))
        # Prior widths of friction scale with the efforts, and so with the gains.
        free_counts = [np.sum(joint.design.columns >= self.lacking.start) for joint in joints]
        score += 2.0 * float(solution.x[self.gains] @ free_counts)
        masses = solution.x[[PARAMETERS_PER_BODY * body for body in assignment.payload_bodies]]
        score = score if (masses > 0.0).all() else -np.inf
        by_column = np.zeros(len(errors))
        by_column[sources] = errors
        return ColumnFit(assignment, solution.x, by_column, score)


def _is_seen(effect: Effect) -> bool:
    """Return whether an effect's columns can be computed sample by sample."""
    excluded = "history" in effect.depends_on or effect.state_count > 0 or effect.places == "log"
    excluded |= effect.role in (Role.BODY, Role.DEFLECTION)
    return bool(effect.parameters) and not excluded


def _information(samples: ColumnSamples) -> Array:
    """Return the prior information of bodies and of the model's sample-wise effects."""
    model = samples.model
    effects, d = [f for f in model.effects if len(f.effect.parameters)], model.phi.size
    used = [np.ones(d, bool), *(np.full(len(f.parameters), _is_seen(f.effect)) for f in effects)]
    information = model.information
    if information is None:
        zero = np.zeros((sum(len(f.parameters) for f in effects),) * 2)
        information = block_diag(pullback_information(model.phi, SPREAD), zero)
    return np.asarray(information[np.ix_(*[np.concatenate(used)] * 2)])
