"""What the columns of a type of robot are to a fleet: what differs, scatters, and goes together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, instances, integer, integers, mask, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, pullback_metric

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_COLUMNS = 5_000
"""Most columns of a type."""


@dataclass(frozen=True, eq=False)
class Spread(Short):
    """A way in which parameters differ: F w, with w ~ N(0, s² 𝟙) and a scale s that is learnt.

    Attributes:
        name: What it is, in words.
        factor: (p, r) F; rows of relative columns are shares of the parameters' own values.
    """

    name: str
    factor: Array

    def __post_init__(self) -> None:
        """Checks both."""
        instance(self.name, "name", str)
        real_array(self.factor, "factor", ("p", "r"))


@dataclass(frozen=True, eq=False)
class TypeColumns(Short):
    """The p columns of all robots of a type.

    Attributes:
        prior: (p,) parameters before any log: those of the model file; 0 for gains and for effects
            that it does not have.
        free: (p,) whether the type's common value is learnt; gains have none but 0.
        relative: (p,) whether differences are shares of the value itself, as those of friction are.
        course: (p,) whether all robots may change together from day to day, as friction does with
            the season; such columns are relative.
        gains: Number of the last columns, which are gains of the joints' efforts.
        spreads: How robots differ from each other, and logs of one robot from each other.
        units: (p,) unit of each column; empty if all have the same. Sizes of columns are compared
            with those of the same unit alone.
    """

    prior: Array
    free: Mask
    relative: Mask
    course: Mask
    gains: int
    spreads: tuple[Spread, ...]
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Checks that all fit each other."""
        size = real_array(self.prior, "prior", ("p",)).shape
        spreads = instances(self.spreads, "spreads", Spread)
        names = ("free", "relative", "course")
        _, relative, course = (mask(getattr(self, name), name, size[0]) for name in names)
        if any(len(each.factor) != size[0] for each in spreads):
            raise ArgumentError(f"The factors of spreads must have {size[0]} rows, as the prior.")
        integer(self.gains, "gains", lower=0, upper=size[0])
        if len(instances(self.units, "units", str)) not in (0, size[0]):
            raise ArgumentError(f"{size[0]} columns cannot have {len(self.units)} units.")
        if not spreads or (course & ~relative).any():
            raise ArgumentError(
                "There must be a spread, and columns with a common course must be relative."
            )

    @property
    def sizes(self) -> list[int]:
        """Parameters of each spread, and of the response to the course."""
        return [s.factor.shape[1] for s in self.spreads] + [int(self.course.sum())]

    def alike(self) -> Mask:
        """(p, p) which columns have the same unit."""
        units = np.array(self.units or [""] * len(self.prior))
        return np.asarray(units[:, None] == units)

    def parts(self, values: Array) -> Array:
        """(..., K + 1) sums of (..., n) over the parameters of each spread, and of the response."""
        ends = np.cumsum([0, *self.sizes])
        sums = np.zeros((*values.shape[:-1], ends[-1] + 1))
        kept = values[..., : ends[-1]]
        np.cumsum(kept, axis=-1, out=sums[..., 1 : kept.shape[-1] + 1])
        sums[..., kept.shape[-1] + 1 :] = sums[..., kept.shape[-1], None]
        return np.diff(sums[..., ends])


def body_spread(
    name: str, phi: ArrayLike, columns: int, *, matrix: ArrayLike | None = None
) -> Spread:
    """Differences of bodies, in the geometric distance at common ones.

    With w ~ N(0, s² 𝟙), the difference of every body has the prior exp(−d² / (2 s²)) of the
    pullback distance d at φ ([Lee2019] Eq. (3.3.33)), seen through base parameters if a matrix is
    given.

    Args:
        name: What it is, in words.
        phi: (nb, 10) physical inertial parameters, those of the bodies that differ not at all set
            to NaN.
        columns: Number p of all columns; those of the bodies are the first.
        matrix: (n_B, 10 nb) base parameters B, if these are the columns; None for ten a body.

    Raises:
        ArgumentError: Shapes do not fit, or a body is not physical.
    """
    phi = real_array(phi, "phi", ("nb", PARAMETERS_PER_BODY), finite=False)
    shown = np.flatnonzero(~np.isnan(phi).any(axis=1))
    if not len(shown):
        raise ArgumentError("There must be a body that differs.")
    roots = np.linalg.cholesky(np.linalg.inv(pullback_metric(phi[shown])))
    factor = np.zeros((phi.size, 10 * len(shown)))
    for place, (body, root) in enumerate(zip(shown.tolist(), roots, strict=True)):
        factor[10 * body : 10 * body + 10, 10 * place : 10 * place + 10] = root
    if matrix is not None:
        B = real_array(matrix, "matrix", ("n", phi.size))
        # A factor of the same covariance, with no more columns than rows.
        factor = np.asarray(np.linalg.qr((B @ factor).T, mode="r")).T
    if integer(columns, "columns", upper=MOST_COLUMNS) < len(factor):
        raise ArgumentError(f"columns must be at least the {len(factor)} of the bodies.")
    whole = np.zeros((columns, factor.shape[1]))
    whole[: len(factor)] = factor
    return Spread(name, whole)


def column_spreads(names: Sequence[str], columns: Sequence[int], count: int) -> tuple[Spread, ...]:
    """Return a spread for each of some columns alone, in its own unit or share."""
    names, unit = (
        instances(names, "names", str),
        np.eye(integer(count, "count", lower=1, upper=MOST_COLUMNS)),
    )
    at = integers(columns, "columns", lower=0, upper=count - 1)
    if len(at) != len(names):
        raise ArgumentError(f"{len(names)} names cannot be those of {len(at)} columns.")
    return tuple(Spread(name, unit[:, [each]]) for name, each in zip(names, at, strict=True))
