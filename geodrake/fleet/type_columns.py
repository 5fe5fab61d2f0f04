"""Columns of a type of robot, differences of robots in them, and hypotheses of changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.inertia import Array, pullback_metric

Mask = NDArray[np.bool_]

STEP, RAMP = "step", "ramp"
KINDS = (STEP, RAMP)
"""Kinds of changes: permanent steps, and ongoing ramps."""


@dataclass(frozen=True, eq=False)
class Spread(Short):
    """A random difference of parameters: F w, with w ~ N(0, s² 𝟙) and a learnt scale s."""

    name: str
    factor: Array  # (p, r) F; rows of relative columns are relative to the parameters' values


@dataclass(frozen=True, eq=False)
class ChangeHypothesis(Short):
    """A change of parameters D z, with z ~ N(0, s² 𝟙) for several s."""

    effect: str  # name of the effect, or of several, joined by "+"
    where: str
    factor: Array  # (p, d) D; rows of relative columns are relative to the robot's values
    names: tuple[tuple[str, str], ...]  # (k,) names and units of the parameters that change
    kinds: tuple[str, ...] = KINDS
    rows: Array | None = None  # (k, d) map from z to these parameters, if they are not columns


@dataclass(frozen=True, eq=False)
class TypeColumns(Short):
    """The p columns of all robots of a type."""

    prior: Array  # (p,) parameters of the model file; 0 for gains and for effects it lacks
    relative: Mask  # (p,) whether differences are relative to the value, as for friction
    # (p,) whether columns of all robots may change together, as friction with the season. Such
    # columns are relative.
    course: Mask
    gains: int  # number of the last columns, which are gains of the joints' efforts
    spreads: tuple[Spread, ...]  # differences between robots, and between logs of a robot
    # (p,) unit of each column; empty if all are equal. Sizes are compared only within a unit.
    units: tuple[str, ...] = ()

    @property
    def free(self) -> Mask:
        """(p,) whether the common value is learnt; that of gains is always 0."""
        return np.arange(len(self.prior)) < len(self.prior) - self.gains

    @property
    def sizes(self) -> list[int]:
        """Numbers of parameters of each spread, and of the response to the course."""
        return [s.factor.shape[1] for s in self.spreads] + [int(self.course.sum())]

    def alike(self) -> Mask:
        """Return (p, p) whether columns have the same unit."""
        units = np.array(self.units or [""] * len(self.prior))
        return np.asarray(units[:, None] == units)

    def parts(self, values: Array) -> Array:
        """Return (..., K + 1) sums of values (..., n) over each spread and the response."""
        parts = np.split(values, np.cumsum(self.sizes), axis=-1)[:-1]
        return np.stack([part.sum(axis=-1) for part in parts], axis=-1)


def distance_factor(phi: Array) -> Array:
    """Return the (10, 10) factor of the covariance of a body's φ in the geometric distance.

    With w ~ N(0, s² 𝟙), differences F w have the prior exp(−d² / (2 s²)) with the pullback distance
    d at φ ([Lee2019] Eq. (3.3.33)).
    """
    return np.linalg.cholesky(np.linalg.inv(pullback_metric(phi)))


def body_factor(root: Array, body: int, matrix: Array, columns: int) -> Array:
    """Return (p, 10) factor of one body's φ (10, 10), mapped to base parameters (n_B, 10 nb)."""
    factor = np.zeros((columns, len(root)))
    factor[: len(matrix)] = matrix[:, len(root) * body : len(root) * (body + 1)] @ root
    return factor


def narrow_factor(factor: Array) -> Array:
    """Return factors (..., p, min(p, r)) of the covariances F Fᵀ of factors F (..., p, r)."""
    if factor.shape[-1] <= factor.shape[-2]:
        return factor
    return np.swapaxes(np.linalg.qr(np.swapaxes(factor, -1, -2), "r"), -1, -2)
