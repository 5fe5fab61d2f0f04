"""How far apart a motion drives the predictions of rival explanations, in units of the noise.

If a robot has effect A, of parameters α, and is thought to have B instead, the best that B can do
on a motion is

    Δ = min over θ, β of ‖X_A α − X θ − X_B β‖² + θᵀ Λ θ     (T-optimality)

with regressors whitened by the noise, everything else that may move in θ, and what is known of it
in Λ. As a function of α this is αᵀ S α with the Schur complement S of the information matrix of
(θ, β, α), as long as no bound holds β. √Δ is by how many deviations of the noise A and B differ.

Since θ and β are at a minimum, only the regressors' own change counts: with the residual e and the
coefficients x = (−θ, −β, α) of all columns, ∂Δ/∂X = 2 e xᵀ. So one gradient costs as much as that
of a criterion of information.

Samples at which a joint's direction of motion is hardly known count less, by sgn²: what dry
friction is there, no model says, and a diagnosis leaves them out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from geodrake.boundary.arguments import Sizes, instances, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.information import Objective
from geodrake.excitation.motion_gradient import regressor_motion_gradient
from geodrake.excitation.reverse_recursion import MotionGradient
from geodrake.excitation.target import Measurement
from geodrake.logs.motion import Motion

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LEAST = 1e-12  # separation that counts as none, per sample


@dataclass(frozen=True, eq=False)
class Pair(Short):
    """A robot with one effect at a place, explained by another one.

    Attributes:
        truth: Name of the effect that the robot has.
        rival: Name of the effect that is to explain it.
        effects: (r, p) columns' coefficients of r robots, whose separations are added: one if the
            parameters are known, and one for each parameter if not.
        columns: (c,) columns that an explanation may use: what may move, and the rival.
    """

    truth: str
    rival: str
    where: tuple[str, ...]
    effects: Array
    columns: Indices


@dataclass(frozen=True, eq=False)
class Separation(Objective):
    """The separations of pairs as a criterion: the least of them, as large as can be.

    They stand in for the eigenvalues of an information matrix: E-optimality is 1/Δ of the pair that
    is hardest to distinguish, with the smooth form of `Criterion`.

    Attributes:
        pairs: Who is to be distinguished from whom.
        prior: (q, p) rows Λ^½ of what is known of each column's parameter.
        lower: (p,) least change of each column's parameter from its nominal value.
        upper: (p,) greatest change.
    """

    pairs: tuple[Pair, ...] = ()
    prior: Array = field(default_factory=lambda: np.zeros((0, 0)))
    lower: Array = field(default_factory=lambda: np.zeros(0))
    upper: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        super().__post_init__()
        instances(self.pairs, "pairs", Pair)
        sizes: Sizes = {}
        real_array(self.prior, "prior", ("q", "p"), sizes)
        lower = real_array(self.lower, "lower", ("p",), sizes, finite=False)
        upper = real_array(self.upper, "upper", ("p",), sizes, finite=False)
        if not (lower <= upper).all():
            raise ArgumentError("lower must be at most upper, and neither NaN, at every column.")

    def separations(self, motion: Motion) -> Array:
        """(K,) Δ of every pair, in squared standard deviations of all samples together."""
        measurement = self.target.measure(motion)
        return self._solve(measurement)[0]

    def efforts(self, motion: Motion) -> Array:
        """(K,) RMS of what no rival explains, at the joint where that is most, N·m or N."""
        measurement = self.target.measure(motion)
        known, values = np.abs(self._known(measurement))[..., None], []
        for solutions in self._solve(measurement)[1]:
            left = measurement.regressor @ solutions.T * known
            values.append(float(np.sqrt(np.mean(np.square(left).sum(2), axis=0)).max()))
        return np.array(values)

    def imitation(self, motion: Motion, pair: int) -> tuple[Array, Array]:
        """(N, nv) effort of the truth of a pair, and the most that its rival makes of it.

        Of several robots, that one's which the rival explains worst.
        """
        measurement = self.target.measure(motion)
        solutions = self._solve(measurement)[1][pair]
        left = measurement.regressor @ solutions.T
        worst = int(np.argmax(np.square(left / self.target.noise[:, None]).sum((0, 1))))
        truth = measurement.regressor @ self.pairs[pair].effects[worst]
        return truth, truth - left[:, :, worst]

    def eigenvalues(self, motion: Motion) -> Array:
        """(K,) the separations, ascending."""
        return np.sort(self.separations(motion))

    def value_and_gradient(self, motion: Motion) -> tuple[float, MotionGradient]:
        """Return what a solver minimizes, and its gradient by the motion.

        Raises:
            ArgumentError: The motion distinguishes some pair not at all, whatever the noise.
        """
        measurement = self.target.measure(motion)
        separations, solutions = self._solve(measurement)
        alike = np.flatnonzero(~(separations > _LEAST * len(motion)))
        if len(alike):
            pair = self.pairs[alike[0]]
            raise ArgumentError(
                f"{pair.rival} explains {pair.truth} of {', '.join(pair.where) or 'the robot'} "
                "wholly on this motion.",
                advice="Start from another motion, or ask for a pair that differs.",
            )
        value, slope = self.criterion.objective(np.log(separations))
        gains = np.repeat(slope / separations, [len(x) for x in solutions])
        x, known, noise = np.concatenate(solutions), self._known(measurement), self.target.noise
        left = (measurement.regressor / noise[:, None]) @ x.T  # (N, nv, robots)
        weights = (left * known[..., None] ** 2) @ (2.0 * gains[:, None] * x)
        gradient = regressor_motion_gradient(self.target, measurement, weights / noise[:, None])
        by_speed = np.square(left) @ gains
        gradient.v[:] += by_speed * 2.0 * known * (1.0 - known**2) / self.target.sign_width
        return value, gradient

    def _known(self, measurement: Measurement) -> Array:
        """(N, nv) smoothed sign of each joint's speed, the root of its samples' weights."""
        return np.tanh(measurement.motion.v / self.target.sign_width)

    def _solve(self, measurement: Measurement) -> tuple[Array, list[Array]]:
        """(K,) separations, and of each pair the coefficients (r, p) of what is left."""
        known = self._known(measurement)[..., None]
        rows = measurement.regressor * (known / self.target.noise[:, None])
        rows = rows.reshape(-1, rows.shape[2])
        R = np.asarray(np.linalg.qr(np.concatenate([rows, self.prior]), mode="r"))
        solutions = [pair.effects.copy() for pair in self.pairs]
        for columns, members in self._groups.items():
            at = np.array(columns, np.intp)
            robots = np.concatenate([self.pairs[k].effects for k in members])
            explained = self._explained(R, at, R @ robots.T)
            for k in members:
                count = len(solutions[k])
                solutions[k][:, at] -= explained[:count]
                explained = explained[count:]
        return np.array([np.square(R @ x.T).sum() for x in solutions]), solutions

    @cached_property
    def _groups(self) -> dict[tuple[int, ...], list[int]]:
        """Columns -> the pairs whose explanations use them."""
        found: dict[tuple[int, ...], list[int]] = {}
        for k, pair in enumerate(self.pairs):
            found.setdefault(tuple(pair.columns.tolist()), []).append(k)
        return found

    def _explained(self, R: Array, columns: Indices, targets: Array) -> Array:
        """(r, c) coefficients of columns that come nearest to targets (q, r), within bounds."""
        A = R[:, columns]
        sizes = np.linalg.norm(A, axis=0)
        sizes = np.where(sizes > 0, sizes, 1.0)
        A, low, high = A / sizes, self.lower[columns] * sizes, self.upper[columns] * sizes
        found = np.asarray(np.linalg.lstsq(A, targets)[0].T)
        outside = ((found < low) | (found > high)).any(axis=1)
        if outside.any():
            bound = np.isfinite(low) | np.isfinite(high)
            found[outside] = _bounded(A, bound, targets[:, outside], (low[bound], high[bound]))
        return found / sizes


def _bounded(
    A: Array, bound: NDArray[np.bool_], targets: Array, bounds: tuple[Array, Array]
) -> Array:
    """(r, c) least-squares solutions, some of the columns within bounds.

    The others are eliminated first, so that the bounded problem is small.
    """
    free, held = A[:, ~bound], A[:, bound]
    shares = np.linalg.lstsq(free, np.concatenate([held, targets], axis=1))[0]
    count = held.shape[1]
    small, rest = held - free @ shares[:, :count], targets - free @ shares[:, count:]
    factor = np.asarray(np.linalg.qr(np.concatenate([small, rest], axis=1), mode="r"))
    found = np.empty((targets.shape[1], A.shape[1]))
    for k in range(targets.shape[1]):
        problem = lsq_linear(factor[:, :count], factor[:, count + k], bounds, method="bvls")
        found[k, bound] = problem.x
        found[k, ~bound] = shares[:, count + k] - shares[:, :count] @ problem.x
    return found
