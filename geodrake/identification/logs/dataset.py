"""Logs reduced to a triangular factor per fold and joint.

A factor contains the columns of inertial parameters, of all effects (the model's and the candidates
of a diagnosis), and of the measured effort. Fits, held-out errors and comparisons of hundreds of
candidates are then small dense problems that need no samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.effects import Effect, Role
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs.folds import Fold
from geodrake.manifolds import PhysicalInertia

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Delay = int | Sequence[int]
"""Index of a dataset's delay, for all joints or one for each."""


LEAST_INERTIA = 1e-3  # least inertia at a joint without a motor, relative to the model's


@dataclass(frozen=True, eq=False)
class JointRows:
    """Filtered, decimated rows of one joint in one block, while it moves."""

    time: Array  # (K,) instants, s
    motion: Array  # (K, 3) position, velocity and acceleration of the joint
    # (K, p_j + d) [A | b] of columns, in the order of the joint's column indices, and of measured
    # efforts less `carried`, one column per delay of the dataset.
    joined: Array
    delays: int  # d
    number: NDArray[np.intp]  # (K,) ascending indices among the filter's outputs
    # (K,) known effort: of known payloads, less that of effects included in the columns of bodies
    # (`Effect.in_bodies`), and less that of measured wrenches.
    carried: Array

    @property
    def A(self) -> Array:
        """(K, p_j) columns."""
        return self.joined[:, : -self.delays]

    @property
    def b(self) -> Array:
        """(K, d) measured efforts less `carried`."""
        return self.joined[:, -self.delays :]

    def part(self, low: int, high: int) -> JointRows:
        """Return the rows of outputs low to high − 1."""
        rows = slice(*np.searchsorted(self.number, [low, high]))
        values: dict[str, Any] = {name: getattr(self, name)[rows] for name in _OF_ROWS}
        return replace(self, **values)

    @classmethod
    def join(cls, parts: Sequence[JointRows]) -> JointRows:
        """Concatenate rows."""
        if len(parts) == 1:
            return parts[0]
        values: dict[str, Any] = {
            name: np.concatenate([getattr(rows, name) for rows in parts]) for name in _OF_ROWS
        }
        return replace(parts[0], **values)


_OF_ROWS = ("time", "motion", "joined", "number", "carried")


@dataclass(frozen=True, eq=False)
class JointData:
    """Data of all folds for one joint."""

    columns: Indices  # (p_j,) ascending global indices of columns that can be nonzero here
    # (F, m, p_j + d) triangular factors R of [A | b] with RᵀR = [A | b]ᵀ[A | b] for each fold, or
    # the rows themselves if they are fewer than the columns.
    factors: Array
    samples: NDArray[np.int_]  # (F,) rows in each factor
    rows: tuple[tuple[JointRows, ...], ...]  # per fold, the kept rows of each of its blocks
    carried: Array  # (F, p_j) products Aᵀc with the known effort c, which b excludes
    seen: NDArray[np.int_]  # (F,) rows, including those at which the joint is at rest
    effort_sums: Array  # (F, 2) sums of the measured efforts, and of their squares
    peaks: Array  # (p_j,) largest absolute value of every column in the kept rows

    @property
    def grams(self) -> Array:
        """(F, p_j + d, p_j + d) normal matrices RᵀR of every fold."""
        return np.swapaxes(self.factors, 1, 2) @ self.factors

    @property
    def gram(self) -> Array:
        """(p_j + d, p_j + d) normal matrix of all folds together."""
        stacked = self.factors.reshape(-1, self.factors.shape[2])
        return np.asarray(stacked.T @ stacked)

    @cached_property
    def _positions(self) -> Indices:
        """Local index of every global column up to the last one here, then −1."""
        positions = np.full(self.columns[-1] + 2, -1)
        positions[self.columns] = np.arange(len(self.columns))
        return positions

    def local(self, columns: Indices) -> Indices:
        """Return local indices of global columns; −1 where a column is zero at this joint."""
        return self._positions[np.minimum(columns, len(self._positions) - 1)]

    def factors_of(self, columns: Indices, delay: int = 0) -> Array:
        """Return factors (F, m, p + 1) of [A | b] with global columns (p,) and one delay's efforts.

        Columns of other joints are zero.
        """
        local = self.local(columns)
        factors = self.factors[:, :, np.append(local, len(self.columns) + delay)]
        factors[:, :, :-1] *= local >= 0
        return factors

    def logged_rows(self, folds: Sequence[Fold]) -> list[tuple[int, JointRows]]:
        """Return the kept rows of all blocks, in the order of folds, and the index of their log."""
        return [
            (block.trajectory, rows)
            for fold, kept in zip(folds, self.rows, strict=True)
            for block, rows in zip(fold.blocks, kept, strict=False)
        ]

    @property
    def still(self) -> float:
        """Share of the rows that are unused because the joint is at rest."""
        return float(1.0 - self.samples.sum() / self.seen.sum())

    def parameters(self, columns: Indices, x: Array) -> Array:
        """Return the parameters (F, p_j) of this joint from those (F, p) of global columns.

        Parameters of a repeated column add up; missing ones are zero.
        """
        parameters = np.zeros((len(self.columns) + 1, len(x)))  # the last row is discarded
        np.add.at(parameters, self.local(columns), x.T)
        return np.ascontiguousarray(parameters[:-1].T)


@dataclass(frozen=True, eq=False)
class Dataset(Short):
    """Reduced logs."""

    joints: tuple[str, ...]  # names of the nv velocities
    bodies: tuple[str, ...]  # names of the nb bodies
    # Fitted and candidate effects, in the order of their columns after the 10·nb inertial ones;
    # payloads share the columns of their body.
    effects: tuple[Effect, ...]
    # (d, nv) seconds by which each joint's effort columns are advanced beyond the model's delays;
    # delays[0] is zero.
    delays: Array
    folds: tuple[str, ...]  # names of the validation folds
    logs: tuple[str, ...]
    data: tuple[JointData, ...]  # one entry per joint
    # (nv,) standard deviation of the measured effort, N·m or N; for a joint at rest see
    # `effort_scale`.
    effort_std: Array
    noise_floor: Array  # (nv,) estimated RMS of the sensor noise after filtering, N·m or N
    bandwidth: float  # bandwidth of the filter, Hz
    still: Array  # (nv,) share of the samples left out because the joint is at rest
    payload: Array  # (10,) typical payload of the robot
    gain_uncertainty: Array  # (nv,) relative, of the efforts; 0 if known payloads determine it
    # (nv,) whether the noise floor is known independently of a model.
    noise_known: NDArray[np.bool_] | bool = True
    # (nv,) part of the noise floor due to a free base's accelerations, N·m or N. It is in the
    # columns too, and so varies with the motion.
    motion_noise: Array | float = 0.0
    # (nv, 10·nb) slopes of the inertia at joints without motors with respect to the inertial
    # parameters, over the model's inertia; zero at other joints. None if all joints have motors.
    passive_inertia: Array | None = None
    is_mixed: bool = False  # whether rows mix joints' efforts to eliminate unknown contact forces

    def passive_shares(self, columns: Indices) -> Array:
        """Return `passive_inertia` (nv, p) of global columns (p,), zero for columns of −1."""
        if self.passive_inertia is None:
            return np.zeros((len(self.joints), len(columns)))
        shares = np.zeros((len(self.joints), self._width + 1))
        shares[:, : self.passive_inertia.shape[1]] = self.passive_inertia
        return shares[:, columns]

    def inertias(self, columns: Indices, x: Array) -> Array:
        """Return inertias (nv, …) at joints without motors, relative to the model's; 1 at others.

        `x` (…, p) are the parameters of global columns (p,).
        """
        return inertias_of(self.passive_shares(columns), x)

    def passive_pull(self, columns: Indices, x: Array, power: Array) -> Array | float:
        """Return the gradient (p,) of the log-likelihood of inertias at joints without motors.

        Without a measured effort, 0 = Yφ + noise holds for bodies of any scale. The noise is that
        of the acceleration, with the residual's variance over the squared inertia m. n independent
        samples thus add n log m to the log-likelihood, whose gradient enters the right-hand side
        of the normal equations; without it, noise would shrink these bodies to zero. The inertias
        are those of parameters x (p,) of `columns` (p,). `power` (nv,) are weighted sums of squared
        residuals, equal to n for maximum-likelihood weights.
        """
        if self.passive_inertia is None:
            return 0.0
        return np.asarray((power / self.inertias(columns, x)) @ self.passive_shares(columns))

    @cached_property
    def fold_shares(self) -> Array:
        """(F,) share of all samples in each fold."""
        counts = self.samples.sum(axis=1)
        return np.asarray(counts / counts.sum())

    @cached_property
    def starts(self) -> Mapping[Effect, int]:
        """First column of every effect."""
        return column_starts(self.effects, self.bodies)

    @cached_property
    def reach(self) -> NDArray[np.bool_]:
        """(nv, p) whether a column can be nonzero at a joint."""
        return np.array([data.local(np.arange(self._width)) >= 0 for data in self.data])

    @cached_property
    def _width(self) -> int:
        """Number p of global columns."""
        own = sum(len(effect.parameters) for effect in self.effects if not is_payload(effect))
        return len(self.bodies) * PARAMETERS_PER_BODY + own

    @cached_property
    def column_peak(self) -> Array:
        """(p,) largest ratio of every column to the effort's standard deviation, at any joint."""
        peak = np.zeros(self._width)
        for data, std in zip(self.data, self.effort_std, strict=True):
            peak[data.columns] = np.maximum(peak[data.columns], data.peaks / std)
        return peak

    def delay_of_each(self, delay: Delay) -> tuple[int, ...]:
        """Return the delay index of every joint."""
        return tuple(np.broadcast_to(delay, len(self.joints)).tolist())

    def effect_columns(self, effect: Effect) -> Indices:
        """Return (k,) global columns of an effect of this dataset."""
        return self.starts[effect] + np.arange(len(effect.parameters))

    @cached_property
    def _affected(self) -> dict[Effect, NDArray[np.bool_]]:
        return {}

    def affected_joints(self, effect: Effect) -> NDArray[np.bool_]:
        """Return (nv,) whether an effect acts on a joint."""
        if effect not in self._affected:
            self._affected[effect] = np.asarray(
                self.reach[:, self.effect_columns(effect)].any(axis=1)
            )
        return self._affected[effect]

    @cached_property
    def samples(self) -> NDArray[np.int_]:
        """(F, nv) rows of each fold and joint."""
        return np.stack([data.samples for data in self.data], 1)

    @cached_property
    def has_rows(self) -> NDArray[np.bool_]:
        """(nv,) whether a joint has rows; joints of an always standing limb have none."""
        return np.asarray(self.samples.any(axis=0))

    @cached_property
    def rows(self) -> NDArray[np.int_]:
        """(nv,) number of rows of each joint, at least 1."""
        return np.maximum(self.samples.sum(axis=0), 1)


def column_starts(effects: tuple[Effect, ...], bodies: tuple[str, ...]) -> dict[Effect, int]:
    """Return the first column of every effect, after the inertial columns that payloads share."""
    starts, free = {}, len(bodies) * PARAMETERS_PER_BODY
    for effect in effects:
        if is_payload(effect):
            starts[effect] = bodies.index(effect.where[0]) * PARAMETERS_PER_BODY
        else:
            starts[effect] = free
            free += len(effect.parameters)
    return starts


def inertias_of(shares: Array, x: Array) -> Array:
    """Return the inertias (nv, …) of parameters (…, p) with shares (nv, p); 1 without shares."""
    inertias = np.maximum(shares @ np.asarray(x).T, LEAST_INERTIA)
    inertias[~shares.any(axis=1)] = 1.0
    return np.asarray(inertias)


def is_payload(effect: Effect) -> bool:
    """Return whether an effect is a payload, which shares the columns of a body."""
    return effect.role is Role.BODY


def is_body(effect: Effect) -> bool:
    """Return whether the parameters of an effect are those of a body, permanent or temporary."""
    return isinstance(effect.manifold, PhysicalInertia)
