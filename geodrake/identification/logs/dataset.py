"""Logs reduced to triangular factors: one per fold and joint, over every column that may be used.

A factor holds the columns of the inertial parameters, of all effects (those of the model and those
that a diagnosis may try) and of the measured effort. Fits, held-out errors and comparisons of
hundreds of candidates are then small dense problems; no one goes back to the samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.effects import Effect, Role
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.manifolds import PhysicalInertia

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Delay = int | Sequence[int]
"""Index of a dataset's delay: that of all joints, or one for each."""


LEAST_INERTIA = 1e-3  # of the model's, that a joint without a motor feels


@dataclass(frozen=True, eq=False)
class JointRows:
    """Filtered, decimated rows of one joint in one block, while it moves."""

    time: Array  # (K,) instants, s
    motion: Array  # (K, 3) position, velocity and acceleration of the joint
    A: Array  # (K, p_j) columns, in the order of the joint's column indices
    b: Array  # (K, d) measured effort less `carried`, one column per delay of the dataset
    number: NDArray[np.intp]  # (K,) which of the filter's outputs they are, ascending
    # (K,) effort beside what is fitted: of known payloads, less what columns of bodies have in them
    # of effects (`Effect.in_bodies`), and less what measured wrenches do at joints.
    carried: Array

    def part(self, low: int, high: int) -> JointRows:
        """Return those of the outputs low to high − 1."""
        own = slice(*np.searchsorted(self.number, [low, high]))
        return JointRows(*(getattr(self, each.name)[own] for each in fields(self)))

    @classmethod
    def join(cls, parts: Sequence[JointRows]) -> JointRows:
        """Return rows one after another."""
        names = [each.name for each in fields(cls)]
        return cls(*(np.concatenate([getattr(rows, name) for rows in parts]) for name in names))


@dataclass(frozen=True, eq=False)
class JointData:
    """Data of all folds for one joint."""

    # (p_j,) global indices of the columns that can be nonzero at this joint, ascending.
    columns: Indices
    # (F, m, p_j + d) triangular factors R of [A | b], with RᵀR = [A | b]ᵀ[A | b], one for each
    # fold; the rows themselves where these are fewer than the columns.
    factors: Array
    samples: NDArray[np.int_]  # (F,) rows behind each factor
    rows: tuple[tuple[JointRows, ...], ...]  # per fold, the kept rows of each of its blocks
    carried: Array  # (F, p_j) products Aᵀc with the effort c that b is without
    seen: NDArray[np.int_]  # (F,) rows before those were left out at which the joint stands still
    effort_sums: Array  # (F, 2) sums of the measured efforts, and of their squares
    peaks: Array  # (p_j,) largest size of every column in the kept rows

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
        """Position of every global column up to the last, and −1 for all that follow."""
        positions = np.full(self.columns[-1] + 2, -1)
        positions[self.columns] = np.arange(len(self.columns))
        return positions

    def local(self, columns: Indices) -> Indices:
        """Return positions of global columns at this joint; −1 where a column cannot be nonzero."""
        return self._positions[np.minimum(columns, len(self._positions) - 1)]

    def factors_of(self, columns: Indices, late: int = 0) -> Array:
        """Return factors (F, m, p + 1) of [A | b] with global columns (p,) and efforts of a delay.

        Columns that cannot be nonzero at this joint are zero.
        """
        local = self.local(columns)
        found = self.factors[:, :, np.append(local, len(self.columns) + late)]
        found[:, :, :-1] *= local >= 0
        return found

    @property
    def still(self) -> float:
        """Share of the rows that are not used as the joint is at rest."""
        return float(1.0 - self.samples.sum() / self.seen.sum())

    def parameters(self, columns: Indices, x: Array) -> Array:
        """Return (F, p_j) parameters of this joint's columns, of those (F, p) of global columns.

        One of these may be there twice; parameters of all others are zero.
        """
        parameters = np.zeros((len(self.columns) + 1, len(x)))  # the last takes what is not seen
        np.add.at(parameters, self.local(columns), x.T)
        return np.ascontiguousarray(parameters[:-1].T)


@dataclass(frozen=True, eq=False)
class Dataset(Short):
    """Several logs, reduced."""

    joints: tuple[str, ...]  # names of the nv velocities
    bodies: tuple[str, ...]  # names of the nb bodies
    # Effects to fit or try, in column order after the 10·nb inertial ones; payloads have the
    # columns of their body.
    effects: tuple[Effect, ...]
    # (d, nv) seconds by which the effort columns of each joint are advanced on top of the model's
    # delays; delays[0] is zero.
    delays: Array
    folds: tuple[str, ...]  # names of the validation folds
    logs: tuple[str, ...]
    data: tuple[JointData, ...]  # one entry per joint
    # (nv,) standard deviation of the measured effort, N·m or N; of a joint at rest what else its
    # effort could show, as in `effort_scale`.
    effort_std: Array
    noise_floor: Array  # (nv,) estimated RMS of the sensor noise after filtering, N·m or N
    bandwidth: float  # bandwidth of the filter, Hz
    still: Array  # (nv,) share of the samples left out because the joint stands still
    payload: Array  # (10,) a body in the middle of what the robot may carry
    # (nv,) how well the gains of the efforts are known; 0 where known payloads say them.
    gain_uncertainty: Array
    # (nv,) whether the noise floor is known whatever a model leaves.
    noise_known: NDArray[np.bool_] | bool = True
    # (nv,) the part of the noise floor that is in the columns, too, N·m or N: that of a free base's
    # accelerations. It varies with the motion.
    motion_noise: Array | float = 0.0
    # (nv, 10·nb) what each inertial parameter adds to the inertia that a joint without a motor
    # feels, over that of the model's bodies; zeros at others. None if all have motors.
    passive_inertia: Array | None = None
    is_mixed: bool = False  # whether rows have efforts of several joints, as contacts are unknown

    def passive_shares(self, columns: Indices) -> Array:
        """Return (nv, p) `passive_inertia` in global columns (p,), zeros where one is −1."""
        if self.passive_inertia is None:
            return np.zeros((len(self.joints), len(columns)))
        shares = np.zeros((len(self.joints), self._width + 1))
        shares[:, : self.passive_inertia.shape[1]] = self.passive_inertia
        return shares[:, columns]

    def inertias(self, columns: Indices, x: Array) -> Array:
        """Return (nv, …) inertias at joints without motors over the model's, 1 at others.

        They are those of parameters (…, p) of global columns (p,).
        """
        return inertias_of(self.passive_shares(columns), x)

    def passive_pull(self, columns: Indices, x: Array, power: Array) -> Array | float:
        """Return the slope (p,) of the log likelihood by the inertias at joints without motors.

        Nothing was measured of efforts there: 0 = Yφ + noise holds for bodies of any scale. What
        is noisy is the acceleration, of a variance that is that of the residuals over the squared
        inertia m, so that n independent samples add n log m, and a part of it goes in the right
        side of the normal equations. Without it noise would shrink these bodies to nothing.
        Inertias are those of parameters x (p,) of columns (p,) in use; the `power` (nv,) are
        weighted sums of squared residuals, which are n with the weights of maximum likelihood.
        """
        if self.passive_inertia is None:
            return 0.0
        return np.asarray((power / self.inertias(columns, x)) @ self.passive_shares(columns))

    @cached_property
    def fold_shares(self) -> Array:
        """(F,) share of all samples that each fold has."""
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
        """(p,) largest value of every column, over the effort's deviation, at any joint."""
        peak = np.zeros(self._width)
        for data, std in zip(self.data, self.effort_std, strict=True):
            peak[data.columns] = np.maximum(peak[data.columns], data.peaks / std)
        return peak

    def delay_of_each(self, delay: Delay) -> tuple[int, ...]:
        """Return the index of the delay of every joint."""
        return tuple(np.broadcast_to(delay, len(self.joints)).tolist())

    def effect_columns(self, effect: Effect) -> Indices:
        """Return (k,) global columns of an effect of this dataset."""
        return self.starts[effect] + np.arange(len(effect.parameters))

    @cached_property
    def _felt(self) -> dict[Effect, NDArray[np.bool_]]:
        return {}

    def felt(self, effect: Effect) -> NDArray[np.bool_]:
        """Return (nv,) whether an effect acts on a joint."""
        if effect not in self._felt:
            self._felt[effect] = np.asarray(self.reach[:, self.effect_columns(effect)].any(axis=1))
        return self._felt[effect]

    @cached_property
    def samples(self) -> NDArray[np.int_]:
        """(F, nv) rows of each fold and joint."""
        return np.stack([data.samples for data in self.data], 1)

    @cached_property
    def has_rows(self) -> NDArray[np.bool_]:
        """(nv,) which joints have rows: those of a limb that always stands have none."""
        return np.asarray(self.samples.any(axis=0))

    @cached_property
    def rows(self) -> NDArray[np.int_]:
        """(nv,) rows of each joint; 1, of zeros, of one without."""
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
    """Return the inertias (nv, …) of parameters (…, p) with shares (nv, p) in them.

    Joints without shares, whose efforts were measured, have ones.
    """
    inertias = np.maximum(shares @ np.asarray(x).T, LEAST_INERTIA)
    inertias[~shares.any(axis=1)] = 1.0
    return np.asarray(inertias)


def is_payload(effect: Effect) -> bool:
    """Return whether an effect adds to the parameters of a body, and so shares its columns."""
    return effect.role is Role.BODY


def is_body(effect: Effect) -> bool:
    """Return whether the parameters of an effect are those of a body, held always or a while."""
    return isinstance(effect.manifold, PhysicalInertia)
