"""Columns of a type of robot: how robots differ in them, and what may change over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.inertia import Array, pullback_metric

Mask = NDArray[np.bool_]

STEP, RAMP = "step", "ramp"
KINDS = (STEP, RAMP)
"""Kinds of changes: steps, which stay, and ramps, which go on."""


@dataclass(frozen=True, eq=False)
class Spread(Short):
    """A way in which parameters differ: F w, with w ~ N(0, s² 𝟙) and a scale s that is learnt."""

    name: str
    factor: Array  # (p, r) F; rows of relative columns are shares of the parameters' own values


@dataclass(frozen=True, eq=False)
class ChangeHypothesis(Short):
    """A change of parameters D z, with z ~ N(0, s² 𝟙) for several s."""

    effect: str  # name of the effect, or of several in one word
    where: str
    factor: Array  # (p, d) D; rows of relative columns are shares of the robot's own values
    # (k,) names and units of the parameters that change: those of the columns that D has.
    names: tuple[tuple[str, str], ...]
    kinds: tuple[str, ...] = KINDS
    # (k, d) rows that make the parameters of z, where they are not those of columns.
    rows: Array | None = None


@dataclass(frozen=True, eq=False)
class TypeColumns(Short):
    """The p columns of all robots of a type."""

    # (p,) parameters before any log: those of the model file; 0 for gains and for effects that it
    # does not have.
    prior: Array
    # (p,) whether differences are shares of the value itself, as those of friction are.
    relative: Mask
    # (p,) whether all robots may change together from day to day, as friction does with the season;
    # such columns are relative.
    course: Mask
    gains: int  # number of the last columns, which are gains of the joints' efforts
    # How robots differ from each other, and logs of one robot from each other.
    spreads: tuple[Spread, ...]
    # (p,) unit of each column; empty if all have the same. Sizes of columns are compared with those
    # of the same unit alone.
    units: tuple[str, ...] = ()

    @property
    def free(self) -> Mask:
        """(p,) whether the type's common value is learnt; that of gains is always 0."""
        return np.arange(len(self.prior)) < len(self.prior) - self.gains

    @property
    def sizes(self) -> list[int]:
        """Numbers of parameters of each spread, and of the response to the course."""
        return [s.factor.shape[1] for s in self.spreads] + [int(self.course.sum())]

    def alike(self) -> Mask:
        """Return (p, p) which columns have the same unit."""
        units = np.array(self.units or [""] * len(self.prior))
        return np.asarray(units[:, None] == units)

    def parts(self, values: Array) -> Array:
        """Return (..., K + 1) sums of (..., n) over each spread's parameters and the response."""
        parts = np.split(values, np.cumsum(self.sizes), axis=-1)[:-1]
        return np.stack([part.sum(axis=-1) for part in parts], axis=-1)


def distance_factor(phi: Array) -> Array:
    """Return (10, 10) factor of the covariance of a body's φ that the geometric distance gives.

    With w ~ N(0, s² 𝟙), differences F w have the prior exp(−d² / (2 s²)) of the pullback distance
    d at φ ([Lee2019] Eq. (3.3.33)).
    """
    return np.linalg.cholesky(np.linalg.inv(pullback_metric(phi)))


def body_factor(root: Array, body: int, matrix: Array, columns: int) -> Array:
    """Return (p, 10) factor of one body's φ (10, 10), seen through base parameters (n_B, 10 nb)."""
    factor = np.zeros((columns, len(root)))
    factor[: len(matrix)] = matrix[:, len(root) * body : len(root) * (body + 1)] @ root
    return factor


def narrow_factor(factor: Array) -> Array:
    """Return (..., p, min(p, r)) factors of the covariances F Fᵀ of wider factors F (..., p, r)."""
    if factor.shape[-1] <= factor.shape[-2]:
        return factor
    return np.swapaxes(np.linalg.qr(np.swapaxes(factor, -1, -2), "r"), -1, -2)
