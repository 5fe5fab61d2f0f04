"""Arrays of any of Drake's scalar types: values, slopes, linear equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff

from geodrake.inertia import Array
from geodrake.model.formulas.evaluation import Scalars

_TOLERANCE = 1e-10
_STEP = 6e-6  # cube root of the rounding of floats


def scalars(values: Any, scalar: type) -> Scalars:
    """Return an array of a scalar type, of entries of that type or floats."""
    if scalar is float:
        return np.asarray(values, float)
    array = np.asarray(values, object)
    flat = [x if isinstance(x, scalar) else scalar(x) for x in array.ravel()]
    found = np.empty(len(flat), object)
    found[:] = flat
    return found.reshape(array.shape)


def value_of(x: Scalars) -> Array:
    """Return the values (…) of an array of floats or of AutoDiffXd."""
    if np.asarray(x).dtype != object:
        return np.asarray(x, float)
    flat = [entry.value() if isinstance(entry, AutoDiffXd) else entry for entry in np.ravel(x)]
    return np.array(flat, float).reshape(np.shape(x))


def slopes_of(x: Scalars) -> Array:
    """Return derivatives (n, d) of (n,) numbers; d = 0 where there are none."""
    flat = scalars(x, AutoDiffXd)
    most = max((entry.derivatives().size for entry in flat), default=0)
    found = np.zeros((len(flat), most))
    for row, entry in zip(found, flat, strict=True):
        row[: entry.derivatives().size] = entry.derivatives()
    return found


def with_slopes(value: ArrayLike, slopes: ArrayLike) -> Scalars:
    """Return numbers (n,) of AutoDiffXd with derivatives (n, d)."""
    return InitializeAutoDiff(np.asarray(value, float), np.asarray(slopes, float)).ravel()


def solve(A: Scalars, b: Scalars) -> Scalars:
    """Return the solution (n,) of A x = b, with its derivatives dx = A⁻¹ (db − dA x).

    A (n, n) and b (n,) are of floats or AutoDiffXd.
    """
    if np.asarray(A).dtype != object and np.asarray(b).dtype != object:
        return np.linalg.solve(A, b)
    A_value, b_value = value_of(A), value_of(b)
    x = np.linalg.solve(A_value, b_value)
    # What b − A x changes by where x stays.
    change = slopes_of(scalars(b, AutoDiffXd) - scalars(A, AutoDiffXd) @ x)
    return with_slopes(x, np.linalg.solve(A_value, change))


def settled(before: Scalars, after: Scalars) -> bool:
    """Return whether numbers (n,), and their derivatives if they have any, change no more."""
    parts = [(value_of(before), value_of(after))]
    if after.dtype == object:
        parts.append((slopes_of(before), slopes_of(after)))
    return all(
        old.shape == new.shape
        and bool(np.abs(new - old).max(initial=0.0) <= _TOLERANCE * _size(new))
        for old, new in parts
    )


def _size(x: Array) -> float:
    return 1.0 + float(np.abs(x).max(initial=0.0))


def by_differences(function: Callable[[Array], Array], x: Scalars) -> Scalars:
    """Return a function of floats, from (n,) to (m,), at AutoDiffXd, its slopes by differences.

    Derivatives are exact to about 1e-9 of what they are differences of.
    """
    value, slopes = value_of(x), slopes_of(x)
    found = np.asarray(function(value), float)
    changes = np.zeros((len(found), slopes.shape[1]))
    known = np.isfinite(found)  # what is not has no slopes
    for k, direction in enumerate(slopes.T):
        moved = np.flatnonzero(direction)
        if len(moved):
            h = _STEP * _size(value[moved]) / np.abs(direction[moved]).max()
            ends = []
            for sign in (1.0, -1.0):
                there = value.copy()
                there[moved] += sign * h * direction[moved]
                ends.append(np.asarray(function(there), float)[known])
            changes[known, k] = (ends[0] - ends[1]) / (2.0 * h)
    return with_slopes(found, changes)
