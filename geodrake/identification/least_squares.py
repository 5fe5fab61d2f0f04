"""Least squares without a regularizer, for data that identify all parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import qr, solve_triangular

from geodrake.boundary.arguments import integer
from geodrake.errors import IdentificationError
from geodrake.identification.problem import whitened_factor
from geodrake.inertia import Array
from geodrake.inertia.parameters import PARAMETER_NAMES

_RANK = 1e-10
_NAMED, _MOST_PARTS = 4, 3


@dataclass(frozen=True, kw_only=True, eq=False)
class LeastSquaresResult:
    """Solution of an unconstrained least-squares problem."""

    x: Array  # (p,) parameters, not necessarily physical
    residual: float  # squared residual
    rank: int  # number of identified parameters or combinations
    directions: Array  # (p − rank, p) unidentified directions, which do not change A x


def least_squares(
    A: ArrayLike,
    b: ArrayLike,
    *,
    sigma: ArrayLike | None = None,
    bodies: int = 0,
    minimum_norm: bool = False,
) -> LeastSquaresResult:
    """Solve the unconstrained least squares A x ≈ b ([Lee2019] Eq. (3.2.15)).

    A is (m, p), b (m,), and sigma the standard deviations of b, (m,) or scalar, in its units. The
    first parameters are those of `bodies`, 10 each, which names directions. With `minimum_norm`,
    return the x of least norm if the data do not identify it; it depends on units and frames.

    Raises:
        IdentificationError: The data do not identify x; the evidence has the unidentified
            `directions` as rows.
    """
    integer(bodies, "bodies", lower=0)
    factor = whitened_factor(A, b, sigma=sigma)
    directions = open_directions(factor)
    if len(directions) and not minimum_norm:
        raise _undetermined(directions, bodies)
    R, r = factor[:, :-1], factor[:, -1]
    norms = np.linalg.norm(R, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    x = np.linalg.lstsq(R / scale, r, rcond=_RANK)[0] / scale
    if len(directions):
        # The solution orthogonal to the unidentified directions.
        basis = np.linalg.qr(directions.T)[0]
        x = x - basis @ (basis.T @ x)
    errors = R @ x - r
    rank = R.shape[1] - len(directions)
    return LeastSquaresResult(
        x=x, residual=float(errors @ errors), rank=rank, directions=directions
    )


def open_directions(factor: Array) -> Array:
    """Return sparse directions (k, p), with largest value 1, that do not change ‖R x − r‖.

    There are none if the data (n, p + 1) identify all parameters.
    """
    R = factor[:, :-1]
    p = R.shape[1]
    norms = np.linalg.norm(R, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    _, triangle, order = qr(R / scale, mode="economic", pivoting=True)
    diagonal = np.abs(np.diagonal(triangle))
    rank = int(np.count_nonzero(diagonal > _RANK * max(diagonal.max(initial=0.0), _RANK)))
    directions = np.zeros((p - rank, p))
    directions[range(p - rank), order[rank:]] = 1.0
    if 0 < rank < p:
        shares = solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:])
        directions[:, order[:rank]] = -np.where(np.abs(shares) > 1e-9, shares, 0.0).T
    directions /= scale
    return np.asarray(directions / np.abs(directions).max(1, initial=0.0, keepdims=True))


def _undetermined(directions: Array, bodies: int) -> IdentificationError:
    count, p = directions.shape
    places = [f"{name}[{body}]" for body in range(bodies) for name in PARAMETER_NAMES]
    places += [f"x[{column}]" for column in range(len(places), p)]
    words = []
    for direction in directions[:_NAMED]:
        order = np.argsort(-np.abs(direction), kind="stable")
        parts = [i for i in order if abs(direction[i]) > 1e-6]
        text = " ".join(f"{direction[i]:+.2g} {places[i]}" for i in parts[:_MOST_PARTS])
        words.append(f"{text} …" if len(parts) > _MOST_PARTS else text)
    more = f"; and {count - _NAMED} more" if count > _NAMED else ""
    return IdentificationError(
        f"The data do not identify {count} of {p} directions of the parameters: "
        f"{'; '.join(words)}{more}.",
        advice="Use a regularizer, which takes them from the prior, or richer motion; "
        "minimum_norm=True of `least_squares` sets them to zero.",
        directions=directions,
    )
