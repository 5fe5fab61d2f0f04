"""Arrays of real numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments.words import shown
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]
Shape = tuple[int | str, ...]
Sizes = dict[str, tuple[int, ...]]
"""Symbol -> its length, and "..." -> the leading axes of all arrays together."""

LARGEST = 1e60
"""What is larger is no number of mechanics, and its powers, as in det P, are soon none at all."""

_FLOAT = np.dtype(float)
_REAL_KINDS = "fiu"  # of NumPy's types: floating-point numbers and integers
_ASYMMETRY = 1e-8  # most relative asymmetry of a matrix that counts as rounding


def real_array(
    value: Any,
    name: str,
    shape: Shape | None = None,
    sizes: Sizes | None = None,
    *,
    finite: bool = True,
) -> Array:
    """Return an array of real numbers of a shape.

    Args:
        value: What the caller passed.
        name: What messages call it.
        shape: Its shape, with symbols for lengths that may be any; None for any shape.
        sizes: What symbols stand for so far; completed by this array.
        finite: Whether NaN, infinity and what is beyond `LARGEST` are refused.

    Raises:
        ArgumentError: It is something else; `name` of its evidence is the argument, `got` a wrong
            shape, and `place` that of the first value that is not finite.
    """
    array = _numbers(value, name, shape)
    if shape is not None and not _fits(array.shape, shape, sizes):
        raise _wrong(name, shape, sizes, f"it has the shape {array.shape}", got=array.shape)
    if finite and not _within(array):
        place = tuple(int(i) for i in np.argwhere(~(np.abs(array) <= LARGEST))[0])
        at = f" at {list(place)}" if place else ""
        raise _wrong(name, shape, sizes, f"it holds {array[place]}{at}", place=place)
    return array


def one_or_each(
    value: Any,
    name: str,
    count: int,
    *,
    lower: float = 0.0,
    strict: bool = False,
    finite: bool = True,
) -> Array:
    """Numbers (count,) from one for all, or one for each.

    Args:
        value: What the caller passed.
        name: What messages call it.
        count: How many numbers there must be, unless there is one for all.
        strict: Whether `lower` itself is refused.
        finite: Whether infinity is refused; NaN always is.

    Raises:
        ArgumentError: They are something else, not as many, or below `lower` (or at it, if strict).
    """
    array = real_array(value, name, finite=finite)
    if array.shape not in ((), (count,)):
        raise ArgumentError(
            f"{name} must be one number or {count}; it has the shape {array.shape}.", name=name
        )
    if not (array > lower if strict else array >= lower).all():
        wanted = "above" if strict else "at least"
        raise ArgumentError(
            f"{name} must be {wanted} {lower:g}; it is {shown(array.tolist())}.", name=name
        )
    return np.broadcast_to(array, (count,))


def mask(value: Any, name: str, count: int | None = None) -> NDArray[np.bool_]:
    """Return booleans (n,), checked, of a given or any number.

    Raises:
        ArgumentError: They are something else, or not as many.
    """
    try:
        found = np.asarray(value)
    except ValueError:  # ragged
        found = np.empty((), object)
    size = "n" if count is None else count
    if found.ndim != 1 or found.dtype != bool or count not in (None, len(found)):
        raise ArgumentError(f"{name} must be ({size},) booleans; it is {shown(value)}.", name=name)
    return found


def positive_definite(value: Any, name: str, shape: Shape, sizes: Sizes | None = None) -> Array:
    """Return a symmetric positive-definite matrix, in whatever units its rows are.

    Args:
        value: What the caller passed.
        name: What messages call it.
        shape: Its shape (n, n), with symbols for lengths that may be any.
        sizes: What symbols stand for so far; completed by this matrix.

    Raises:
        ArgumentError: It is something else.
    """
    matrix = real_array(value, name, shape, sizes)
    diagonal = np.diagonal(matrix)
    if not (diagonal > 0).all():
        raise ArgumentError(
            f"{name} must be positive definite; its diagonal is {shown(diagonal.tolist())}.",
            name=name,
        )
    scaled = matrix / np.sqrt(diagonal[:, None]) / np.sqrt(diagonal)
    asymmetry = np.abs(scaled - scaled.T).max(initial=0.0)
    if not asymmetry <= _ASYMMETRY:
        raise ArgumentError(
            f"{name} must be symmetric; it is off by {asymmetry:.2g} of its diagonal.",
            advice="Pass 0.5 * (M + M.T) if the difference is meant to be rounding.",
            name=name,
        )
    if len(scaled) and not (least := np.linalg.eigvalsh(scaled)[0]) > 0:
        raise ArgumentError(
            f"{name} must be positive definite; with its diagonal scaled to one, its smallest "
            f"eigenvalue is {least:.3g}.",
            name=name,
        )
    return matrix


def _numbers(value: Any, name: str, shape: Shape | None) -> Array:
    """An array of floats; complex numbers, texts, objects, truth values and masks are none."""
    if type(value) is np.ndarray and value.dtype == _FLOAT:
        return value
    if isinstance(value, np.ma.MaskedArray):
        raise _wrong(name, shape, None, "it has a mask")
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        # NumPy cannot make an array of ragged lists, or of objects that refuse.
        raise _wrong(name, shape, None, f"it is {shown(value)}") from error
    if array.dtype.kind not in _REAL_KINDS and array.size:
        what = shown(value) if array.dtype.kind == "O" else f"of type {array.dtype}"
        raise _wrong(name, shape, None, f"it is {what}")
    with np.errstate(over="ignore"):  # numbers of more digits that are too large become infinite
        return np.asarray(array, _FLOAT)


def _fits(found: tuple[int, ...], shape: Shape, sizes: Sizes | None) -> bool:
    """Return whether a shape is the wanted one; binds its symbols if it is."""
    open_ended = shape[:1] == ("...",)
    ends = shape[1:] if open_ended else shape
    start = len(found) - len(ends)
    if start < 0 or (start and not open_ended):
        return False
    bound: Sizes = {}
    for length, wanted in zip(found[start:], ends, strict=True):
        if isinstance(wanted, int):
            known: tuple[int, ...] = (wanted,)
        else:
            known = bound.get(wanted) or (sizes or {}).get(wanted) or (length,)
            bound[wanted] = known
        if known != (length,):
            return False
    if sizes is not None:
        if open_ended:
            try:
                bound["..."] = np.broadcast_shapes(sizes.get("...", ()), found[:start])
            except ValueError:
                return False
        sizes.update(bound)
    return True


def _within(array: Array) -> bool:
    """Whether all values are finite and not beyond `LARGEST`, without a copy of a long array."""
    least = np.minimum.reduce(array, axis=None, initial=0.0)  # NaN if any value is
    return bool(least >= -LARGEST and np.maximum.reduce(array, axis=None, initial=0.0) <= LARGEST)


def _wrong(
    name: str, shape: Shape | None, sizes: Sizes | None, but: str, **evidence: Any
) -> ArgumentError:
    """Return the error of an array that is not what it must be."""
    if shape == ():
        return ArgumentError(f"{name} must be a finite real number; {but}.", name=name, **evidence)
    comma = "," if shape is not None and len(shape) == 1 else ""
    words = "" if shape is None else f"({', '.join(map(str, shape))}{comma}) "
    bound = {each: (sizes or {}).get(str(each)) for each in shape or ()}
    known = [
        f"leading axes {size}" if symbol == "..." else f"{symbol} = {size[0]}"
        for symbol, size in bound.items()
        if size
    ]
    more = f" with {' and '.join(known)}" if known else ""
    return ArgumentError(
        f"{name} must be {words}finite real numbers{more}; {but}.", name=name, **evidence
    )
