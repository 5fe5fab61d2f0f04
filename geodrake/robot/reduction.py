"""Triangular factors: a least-squares problem of any length as one small matrix.

R with RᵀR = AᵀA has the same residuals as A up to a constant, ‖A x − b‖² = ‖R [x; −1]‖² with
R of [A b], and orthogonal transformations keep all digits that AᵀA would lose by squaring the
condition number.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dtpqrt

from geodrake.errors import ArgumentError
from geodrake.inertia import Array

_ROWS = 4096
_PANEL = 16


def triangular_factor(blocks: Iterable[ArrayLike]) -> Array:
    """Return the factor of rows that arrive in blocks; memory does not grow with their number.

    Args:
        blocks: Arrays (n_i, p); a factor of earlier rows is a block like any other.

    Returns:
        (p, p) upper triangular R with RᵀR = Σ AᵢᵀAᵢ. Signs on the diagonal are arbitrary, and with
        fewer than p independent rows some of it is zero up to rounding.
    """
    factor: Array | None = None
    for number, block in enumerate(blocks):
        rows = np.asarray(block, float)
        if factor is None and rows.ndim == 2:
            factor = np.zeros((rows.shape[1], rows.shape[1]), order="F")
        if factor is None or rows.shape[1:] != factor.shape[1:]:
            raise ArgumentError(
                f"Block {number} has shape {rows.shape}; expected (n, "
                f"{'p' if factor is None else len(factor)}).",
                advice="All blocks need the same columns.",
            )
        factor = _with_rows(factor, rows)
        if not np.isfinite(factor).all():
            raise ArgumentError(
                f"Block {number} has values that are not finite, or overflow.",
                advice="Remove such rows, or scale the columns.",
            )
    if factor is None:
        raise ArgumentError("There are no rows to factor.", advice="Pass at least one block.")
    return np.ascontiguousarray(factor)


def _with_rows(factor: Array, rows: Array) -> Array:
    """Return the factor of [R; A], a cache-sized piece of A at a time; R stays in the cache."""
    if not factor.size:
        return factor
    for start in range(0, len(rows), _ROWS):
        piece = np.array(rows[start : start + _ROWS], order="F")
        panel = min(_PANEL, len(factor))
        factor, _, _, _ = dtpqrt(0, panel, factor, piece, overwrite_a=True, overwrite_b=True)
    return factor
