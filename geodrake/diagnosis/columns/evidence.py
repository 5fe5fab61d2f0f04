"""The evidence of an assignment of columns: one Gaussian model of all joints' efforts.

Bodies are near those of the model by the pullback metric ([Lee2019] section 3.5); friction, offsets
and rotors are free; the base may lean, and gains and zeros be off, as much as is usual. What is
left is noise, profiled out on the scale of its column, so that a gain of zero explains nothing.
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
"""Deviations of the angles by which bases are off the level, rad, and of zeros, rad or m."""

USUAL_MASS = 0.3
"""Share to which all bodies together are known, however far each is from the model."""

USUAL_REST = 0.1
"""Of friction and rotors that drives take out, so much may be left, or be taken out twice."""

CARRIED = 3.0
"""A body that may hold a payload is known to within this geometric distance."""

WIDE_GAIN, WIDE_APART, WIDE_ZERO, WIDE_TILT = 4.0, 1.2, 1.0, 0.5
"""Deviations of errors that are to be found: of the logarithm of the gains of all joints, and of
each one from that, as motors of one robot are alike; of a zero and of a slope, rad."""

USUAL_RANGE, USUAL_RATE, USUAL_SPREAD = 2.0, 200.0, 1.5
"""So far joints turn, rad, and so often logs are sampled, 1/s, with the deviation of logarithms:
hardly any joint turns by 0.02 or by 200 rad, hardly any log has 2 or 20,000 samples a second."""

LEAST_RANGE = 0.02
"""A joint that turns by less, rad, is at rest, whatever its unit."""

_LONGEST = 0.7  # rad, or of a logarithm, of a step
_RATE_AGREEMENT = 0.05  # of a velocity's RMS: measured ones are the derivatives but for that
_LEAST = 1e-12  # information: that of what efforts do not depend on
_MOST_KEPT = 200_000_000  # bytes of designs


@dataclass(frozen=True, eq=False)
class ColumnFit:
    """A fit by one assignment."""

    assignment: Assignment
    x: Array  # (p,) parameters
    mse: Array  # (n,) mean squared errors of each column of efforts, in its own unit
    score: float  # twice the logarithm of the evidence


class ColumnModel:
    """The Gaussian model of some samples.

    Its parameters are those of bodies and effects, the tilt of the base (2), errors of the zeros
    (n) and logarithms of the errors of the gains (n), and those of unknown functions of the joints
    that have one.
    """

    def __init__(self, samples: ColumnSamples, beliefs: Beliefs) -> None:
        self.samples, self.beliefs, model = samples, beliefs, samples.model
        self.noise, n = known_noise(samples.trajectories)[0], len(model.joints)
        own = [f for f in model.effects if _is_seen(f.effect)]
        said = {(f.effect.name, f.effect.where) for f in own}
        usual = [kind for kind in catalogue() if kind.complexity == 0]
        more = [e for kind in usual for joint in model.single_joints for e in kind.shaped(joint)]
        more = [effect for effect in more if (effect.name, effect.where) not in said]
        self.effects = [*(f.effect for f in own), *more]
        self.layout = Layout.of(model, tuple(self.effects), samples.width, samples.width)
        known, size = _information(samples), model.phi.size
        first = len(known) + sum(len(effect.parameters) for effect in more)
        # What a file states of friction is in doubt as much as what it lacks.
        self.lacking = slice(size if model.information is None else len(known), first)
        self.tilt, self.zeros = first + np.arange(2), first + 2 + np.arange(n)
        self.gains = self.zeros + n
        gains = np.maximum(samples.gain_deviations, 1e-3)
        errors = np.concatenate([np.full(2, USUAL_TILT), np.full(n, USUAL_ZERO), gains])
        none = np.zeros(first - len(known))
        self.information = block_diag(known, np.diag(none), np.diag(errors**-2.0))
        stated = [model.total_phi.ravel(), *(f.parameters for f in own)]
        self.mean = np.concatenate([*stated, none, np.zeros(len(errors))])
        self.lower = np.full(len(self.mean), -np.inf)
        self.lower[size:first] = [q.lower for e in self.effects for q in e.parameters]
        self._designs: dict[tuple[object, ...], MotionDesigns] = {}
        self._fits: dict[tuple[object, ...], ColumnFit] = {}  # without the evidence of the motion
        periods = [segment.period for t in samples.trajectories for segment in t.segments]
        self._rate = 1.0 / float(np.median(periods))
        self._rates = samples.effective(list(samples.v.T), [np.arange(len(samples))] * n)
        self._reach, self._deviations = np.ptp(samples.q, axis=0), samples.effort.std(axis=0)
        self._slow = np.mean(samples.v**2, axis=0) < samples.width**2

    def designs(self, assignment: Assignment) -> list[JointDesign]:
        """Return the joints' normal matrices for an assignment; those of last motions are kept."""
        key, samples = assignment.motion_key, self.samples
        found = self._designs.pop(key, None)
        if found is None:
            found = MotionDesigns(samples, self.layout, assignment)
            kept = found.nbytes + sum(each.nbytes for each in self._designs.values())
            while self._designs and kept > _MOST_KEPT:
                kept -= self._designs.pop(next(iter(self._designs))).nbytes
        self._designs[key] = found
        return [
            found(j, source, unknown=j in assignment.unknown).read_as(samples, assignment, j)
            for j, source in enumerate(assignment.effort.tolist())
        ]

    def hopeful(self) -> Array:
        """Return (n,) independent samples of each column, as long as mistakes may be in it."""
        return np.full(len(self._rates), float(len(self.samples)))

    def worth(self, fit: ColumnFit) -> Array:
        """Return (n,) independent samples that a fit's residuals of each column are worth."""
        joints = self._joints(fit.assignment)
        left = [np.subtract(*joint.needed(fit.x)) for joint in joints]
        rows = [joint.design.rows for joint in joints]
        found = np.zeros(len(left))
        found[fit.assignment.effort] = self.samples.effective(left, rows)
        # What is more than sensor noise varies with the motion, however often that repeats.
        noise = np.square(NOISE_MARGIN * self.noise) / np.maximum(fit.mse, 1e-300)
        more = np.clip(1.0 - noise, 0.0, 1.0)
        repeated = np.minimum(found, self.beliefs.discrepancy)
        return np.asarray(1.0 / ((1.0 - more) / found + more / repeated))

    def needed(self, fit: ColumnFit) -> list[Array]:
        """Return per joint (K,) efforts that bodies and effects of a fit need."""
        return [joint.needed(fit.x)[0] for joint in self._joints(fit.assignment)]

    def needed_by_model(self, assignment: Assignment, rows: Indices | slice = slice(None)) -> Array:
        """Return (K, n) efforts that the model's own bodies need for the motion in some rows."""
        robot, (q, v, vd) = self.samples.model, self.samples.motion(assignment, rows)
        tree = robot.tree
        if assignment.gravity is not None:
            tree = replace(tree, gravity=np.array(assignment.gravity))
        return inverse_dynamics(tree, robot.positions(q), v, vd, robot.total_phi)

    def nrms(self, fit: ColumnFit) -> float:
        """Return the root mean square over joints of errors over the deviations of efforts."""
        return float(np.sqrt(np.mean(fit.mse / self._deviations**2)))

    def moved(self, assignment: Assignment, step: Array) -> Assignment:
        """Return an assignment whose zeros, gains and tilt are moved by a step (p,)."""
        zero = assignment.zero + step[self.zeros]
        moved = replace(assignment, zero=zero, gain=assignment.gain / np.exp(step[self.gains]))
        if step[self.tilt].any():
            turn = Rotation.from_rotvec([*-step[self.tilt], 0.0])
            down = assignment.gravity or self.samples.model.tree.gravity
            moved = replace(moved, gravity=tuple(turn.apply(down).tolist()))
        return moved

    def way(self, fit: ColumnFit, free: Collection[int]) -> Array:
        """Return the step (p,) of Newton's method in some errors of zeros, gains and tilt."""
        step, at = np.zeros(len(self.mean)), list(free)
        step[at] = np.clip(fit.x[at], -_LONGEST, _LONGEST)
        return step

    def score_of_motion(self, assignment: Assignment) -> float:
        """Return twice the logarithm of how likely ranges, rates and measured velocities are."""
        samples, model, at = self.samples, self.samples.model, assignment.position
        turns = [joint not in model.sliding_joints for joint in model.joints]
        reach = np.abs(assignment.scale) * self._reach[at]
        far = np.log(np.maximum(reach[turns], LEAST_RANGE) / USUAL_RANGE) / USUAL_SPREAD
        often = np.log(self._rate / assignment.time / USUAL_RATE) / USUAL_SPREAD
        score = -float(far @ far + often**2)
        if samples.rate is None:
            return score
        v, rate = samples.v[:, at], samples.rate[:, at]
        share = assignment.scale / (assignment.time * assignment.rate)
        error, size = np.mean((rate - v * share) ** 2, axis=0), np.mean(rate**2, axis=0)
        relative = np.maximum(error / np.maximum(size, 1e-300), _RATE_AGREEMENT**2)
        errors = np.where(self._slow[at] | (size == 0.0), 1.0, relative)
        return score - float(np.minimum(self._rates, self.beliefs.discrepancy)[at] @ np.log(errors))

    def _joints(self, assignment: Assignment) -> list[JointEquations]:
        """Return the equations of all joints."""
        joints, effects = list[JointEquations](), self.samples.model.phi.size
        for j, design in enumerate(self.designs(assignment)):
            at, local = [design.columns, self.tilt, self.zeros], np.arange(design.linear)
            effort, known = np.zeros((2, design.X.shape[1]))
            effort[design.effort(int(assignment.effort[j]))] = assignment.gain[j]
            if j in assignment.apart:
                local = np.flatnonzero(design.columns >= effects)
                at = [design.columns[local]]
            if j in assignment.unknown:
                before = sum(other < j for other in assignment.unknown)
                at.append(len(self.mean) + UNKNOWN * before + np.arange(UNKNOWN))
                local = np.append(local, design.unknown)
            if j not in assignment.apart:
                at.append(self.gains[[j]])
                known[design.effort(-1)] = 1.0
            joints.append(JointEquations(design, np.concatenate(at), local, effort, known))
        return joints

    def _prior(
        self, assignment: Assignment, joints: Sequence[JointEquations], wide: Collection[int]
    ) -> tuple[Array, Array, Array]:
        """Return the prior mean (p,), information (p, p) and lower bounds (p,)."""
        mean, information, lower = self.mean.copy(), self.information.copy(), self.lower.copy()
        unknown, first = list[Array](), self.samples.model.phi.size
        for j, joint in enumerate(joints):
            design, size = joint.design, self._size(assignment, j)
            new = np.flatnonzero(design.columns >= self.lacking.start)
            at, peak = design.columns[new], design.peaks[new]
            information[at, at] += (peak / (LARGEST * size)) ** 2
            if j in assignment.unknown:
                share = 1.0 if j in assignment.apart else self.beliefs.unknown
                power = np.diag(design.gram)[design.unknown] / len(design.rows)
                unknown.append(power / (share * size) ** 2)
        self._widen(information, assignment, wide)
        if assignment.is_far:
            masses = np.arange(0, self.samples.model.phi.size, PARAMETERS_PER_BODY)
            information[:first] *= SPREAD / self.beliefs.widths[-1]
            information[:, :first] *= SPREAD / self.beliefs.widths[-1]
            information[np.ix_(masses, masses)] += (USUAL_MASS * mean[masses].sum()) ** -2.0
        gone = list[int]()
        for effect in self.effects:
            here = range(first, first := first + len(effect.parameters))
            gone += here if effect.taken_out_as in assignment.without else ()
        left = np.maximum((USUAL_REST * mean[gone]) ** 2.0, 1e-12)
        mean[gone], lower[gone] = 0.0, -np.inf
        information[gone] = information[:, gone] = 0.0
        information[gone, gone] = 1.0 / left
        load = payload_reference(self.samples.model.total_phi)
        for body in assignment.carrying:
            own = slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1))
            mean[own] += load
            information[own] = information[:, own] = 0.0
            information[own, own] = pullback_information(mean[own][None], CARRIED)
        more = np.concatenate([np.zeros(0), *unknown])
        information = block_diag(information, np.diag(more)) if len(more) else information
        np.fill_diagonal(information, np.maximum(np.diag(information), _LEAST))
        bounds = np.full(len(more), -np.inf)
        return np.append(mean, 0.0 * more), information, np.append(lower, bounds)

    def _size(self, assignment: Assignment, joint: int) -> float:
        """Return the deviation of a joint's efforts, N·m or N."""
        deviation = self._deviations[assignment.effort[joint]]
        return max(float(abs(assignment.gain[joint]) * deviation), 1e-300)

    def _widen(self, information: Array, assignment: Assignment, wide: Collection[int]) -> None:
        """Free errors of zeros, gains and tilt that are to be found."""
        found = np.array(sorted(wide), np.intp)
        gains, zeros = np.intersect1d(found, self.gains), np.intersect1d(found, self.zeros)
        if len(gains):
            covariance = WIDE_GAIN**2 + WIDE_APART**2 * np.eye(len(gains))
            information[np.ix_(gains, gains)] = np.linalg.inv(covariance)
        information[zeros, zeros] = WIDE_ZERO**-2.0
        if assignment.gravity is not None:
            information[self.tilt, self.tilt] = WIDE_TILT**-2.0

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
            worth: (n,) independent samples of each column of efforts.
            near: A fit whose errors say how much each joint counts at first; by default, all
                count as if they were explained.
            moved: (p,) by how much the assignment has moved these already.
        """
        begun = None if near is None else near.mse.tobytes()
        away = None if moved is None else moved.tobytes()
        key = assignment.effort_key, tuple(wide), worth.tobytes(), begun, away
        if key not in self._fits:
            self._fits[key] = self._fitted(assignment, worth, near, wide, moved)
        efforts = self._fits[key]
        score = efforts.score + self.score_of_motion(assignment)
        return replace(efforts, assignment=assignment, score=score)

    def of_other_rates(self, fit: ColumnFit, assignment: Assignment) -> ColumnFit:
        """Return a fit by an assignment with other factors of velocities, and so of no effort."""
        more = self.score_of_motion(assignment) - self.score_of_motion(fit.assignment)
        return replace(fit, assignment=assignment, score=fit.score + more)

    def _fitted(
        self,
        assignment: Assignment,
        worth: Array,
        near: ColumnFit | None,
        wide: Collection[int],
        moved: Array | None,
    ) -> ColumnFit:
        """Return the result of `fit` without the evidence of the motion."""
        joints = self._joints(assignment)
        mean, information, lower = self._prior(assignment, joints, wide)
        start = mean.copy()
        if moved is not None:
            mean[: len(moved)] -= moved
        sources, scale = assignment.effort, np.square(assignment.gain)
        mse = None if near is None else near.mse[sources] * scale
        found = most_probable(
            joints,
            worth[sources],
            (mean, information, lower),
            start=start,
            gains=self.gains,
            mse=mse,
        )
        pairs = zip(found.mse.tolist(), joints, strict=True)
        errors = np.array([spread(m, joint.design.beyond) for m, joint in pairs]) / scale
        score = found.score - float(worth[sources] @ np.log(errors))
        # Sizes that frictions may have go with the efforts, multiplied by their gains.
        lacking = [np.sum(joint.design.columns >= self.lacking.start) for joint in joints]
        score += 2.0 * float(found.x[self.gains] @ lacking)
        masses = found.x[[PARAMETERS_PER_BODY * body for body in assignment.carrying]]
        score = score if (masses > 0.0).all() else -np.inf
        by_column = np.zeros(len(errors))
        by_column[sources] = errors
        return ColumnFit(assignment, found.x, by_column, score)


def _is_seen(effect: Effect) -> bool:
    """Return whether an effect's columns need no samples that follow each other."""
    apart = "history" in effect.depends_on or effect.state_count > 0 or effect.places == "log"
    apart |= effect.role in (Role.BODY, Role.DEFLECTION)
    return bool(effect.parameters) and not apart


def _information(samples: ColumnSamples) -> Array:
    """Return the prior information of bodies and of the model's effects whose columns are seen."""
    model = samples.model
    fitted, d = [f for f in model.effects if len(f.effect.parameters)], model.phi.size
    seen = [np.ones(d, bool), *(np.full(len(f.parameters), _is_seen(f.effect)) for f in fitted)]
    information = model.information
    if information is None:
        rest = np.zeros((sum(len(f.parameters) for f in fitted),) * 2)
        information = block_diag(pullback_information(model.phi, SPREAD), rest)
    return np.asarray(information[np.ix_(*[np.concatenate(seen)] * 2)])
