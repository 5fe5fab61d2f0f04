"""What may change in a robot: columns that are let go from some day on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, instances, integer, integers, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.columns import MOST_COLUMNS
from geodrake.fleet.profiles import KINDS, STEP
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    from_mass_com_inertia,
    is_physical,
    pullback_metric,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ChangeHypothesis(Short):
    """A change of parameters D z, with z ~ N(0, s² 𝟙) for several s.

    Attributes:
        effect: Name of the effect, or of several in one word.
        factor: (p, d) D; rows of relative columns are shares of the robot's own values.
    """

    effect: str
    where: str
    factor: Array
    kinds: tuple[str, ...] = KINDS

    def __post_init__(self) -> None:
        """Checks all."""
        instance(self.effect, "effect", str)
        instance(self.where, "where", str)
        real_array(self.factor, "factor", ("p", "d"))
        kinds = instances(self.kinds, "kinds", str)
        if not kinds or any(kind not in KINDS for kind in kinds):
            raise ArgumentError(f"kinds must be of {' and '.join(KINDS)}; they are {kinds}.")


def column_change(
    effect: str,
    where: str,
    columns: Sequence[int],
    count: int,
    *,
    size: float = 1.0,
    kinds: tuple[str, ...] = KINDS,
) -> ChangeHypothesis:
    """Some columns change, each by itself.

    Args:
        columns: (d,) indices of its columns.
        count: Number p of all columns.
        size: Scale of a change for s = 1: a share, for relative columns, else in their unit.

    Raises:
        ArgumentError: There is no such column.
    """
    integer(count, "count", lower=1, upper=MOST_COLUMNS)
    at = integers(columns, "columns", lower=0, upper=count - 1)
    positive(size, "size")
    if not at:
        raise ArgumentError("A change needs at least one column.")
    return ChangeHypothesis(effect, where, size * np.eye(count)[:, list(at)], kinds)


def body_change(
    effect: str,
    where: str,
    body: int,
    phi: ArrayLike,
    count: int,
    *,
    mass: float,
    radius: float = 0.1,
    matrix: ArrayLike | None = None,
) -> ChangeHypothesis:
    """The ten parameters of a body change from one day to the next, as by a payload.

    z is measured in the geometric distance at a ball of the size and mass of a usual payload, at
    the body's centre of mass, so that the prior depends on no frame and no unit.

    Args:
        phi: (nb, 10) physical inertial parameters of the bodies that all robots share.
        count: Number p of all columns; those of the bodies are the first.
        mass: Mass of a usual payload, kg.
        radius: Its radius, and about how far it is from the body's centre of mass, m.
        matrix: (n_B, 10 nb) base parameters B, if these are the columns; None for ten a body.

    Raises:
        ArgumentError: Shapes do not fit, or the body is not physical.
    """
    phi = real_array(phi, "phi", ("nb", PARAMETERS_PER_BODY))
    integer(body, "body", lower=0, upper=len(phi) - 1)
    positive(mass, "mass")
    positive(radius, "radius")
    if not is_physical(phi[body]):
        raise ArgumentError(f"The body {where} is not physical, so that there is no distance.")
    com = phi[body, 1:4] / phi[body, 0]
    usual = from_mass_com_inertia(mass, com, 0.4 * mass * radius**2 * np.eye(3))
    root = np.linalg.cholesky(np.linalg.inv(pullback_metric(usual)))
    columns = np.zeros((phi.size, PARAMETERS_PER_BODY))
    columns[10 * body : 10 * body + 10] = root
    if matrix is not None:
        columns = real_array(matrix, "matrix", ("n", phi.size)) @ columns
    if integer(count, "count", upper=MOST_COLUMNS) < len(columns):
        raise ArgumentError(f"count must be at least the {len(columns)} columns of the bodies.")
    factor = np.zeros((count, PARAMETERS_PER_BODY))
    factor[: len(columns)] = columns
    return ChangeHypothesis(effect, where, factor, (STEP,))
