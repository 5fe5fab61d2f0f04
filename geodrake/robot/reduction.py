"""Triangular factors, which reduce a long least-squares problem to a small matrix.

The factor R of [A b], with RᵀR = [A b]ᵀ[A b], has the same residuals, ‖A x − b‖² = ‖R [x; −1]‖².
Orthogonal transformations keep the digits that AᵀA would lose by squaring the condition number.
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
    """Return the upper triangular R (p, p) with RᵀR = Σ AᵢᵀAᵢ for blocks Aᵢ (n_i, p) of rows.

    A factor of earlier rows is a valid block. Signs on the diagonal are arbitrary.
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
    """Return the factor of [R; A], in pieces of A so that R stays in the cache."""
    if not factor.size:
        return factor
    for start in range(0, len(rows), _ROWS):
        piece = np.array(rows[start : start + _ROWS], order="F")
        panel = min(_PANEL, len(factor))
        factor, _, _, _ = dtpqrt(0, panel, factor, piece, overwrite_a=True, overwrite_b=True)
    return factor
