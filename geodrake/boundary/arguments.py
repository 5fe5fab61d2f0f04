"""Checks of the arguments of public functions, so that kernels need no checks.

Shapes are written as in docstrings: `("N", 10)`, or `("...", 3)` for any leading axes. A symbol has
the same length in all arrays that are checked with the same `sizes`, and leading axes must
broadcast:

    sizes: Sizes = {}
    q = real_array(q, "q", ("N", "nq"), sizes)
    v = real_array(v, "v", ("N", "nv"), sizes)

Numbers must be real: complex numbers, strings, objects, booleans, masked arrays and ragged lists
are errors.
"""

from __future__ import annotations

import inspect
import operator
import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache, wraps
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import ArgumentError, nearest

_LONGEST = 60  # characters of a value in a message


def shown(value: Any) -> str:
    """Return a value for a message, or its type if the value is not plain or too long."""
    text = repr(value) if isinstance(value, str | bytes | int | float | list | tuple) else ""
    if not text or len(text) > _LONGEST:
        return f"of type {type(value).__name__}"
    return text


Kind = TypeVar("Kind")
Kinds = type | tuple[type, ...]


def instance(value: Kind, name: str, kind: Kinds) -> Kind:
    """Return an object, checked to be of a class."""
    if not isinstance(value, kind):
        raise ArgumentError(
            f"{name} must be a {_kinds_words(kind)}; it is {shown(value)}.", name=name
        )
    return value


def instances(value: Iterable[Kind], name: str, kind: Kinds) -> tuple[Kind, ...]:
    """Return the objects of an iterable, checked to be of a class."""
    requirement = f"{name} must be a tuple of {_kinds_words(kind)}"
    if isinstance(value, str | bytes | dict) or not isinstance(value, Iterable):
        raise ArgumentError(f"{requirement}; it is {shown(value)}.", name=name)
    items = tuple(value)
    for place, item in enumerate(items):
        if not isinstance(item, kind):
            raise ArgumentError(f"{requirement}; number {place} is {shown(item)}.", name=name)
    return items


def function(value: Kind, name: str) -> Kind:
    """Return an argument, checked to be callable."""
    if not callable(value):
        raise ArgumentError(f"{name} must be a function; it is {shown(value)}.", name=name)
    return value


def file_path(value: str | os.PathLike[str]) -> Path:
    """Return a path, checked to be a valid one."""
    if not isinstance(value, str | os.PathLike):
        raise ArgumentError(f"path must be a path; it is {shown(value)}.", name="path")
    path = Path(value)
    try:
        is_invalid = b"\0" in os.fsencode(path)
    except UnicodeEncodeError:
        is_invalid = True
    if is_invalid:
        raise ArgumentError(f"path must be a path; no file can be called {value!a}.", name="path")
    return path


def one_of(value: Any, name: str, choices: Collection[str]) -> str:
    """Return an argument, checked to be one of the choices."""
    if not isinstance(value, str) or value not in choices:
        words = ", ".join(f'"{choice}"' for choice in choices)
        raise ArgumentError(
            f"{name} must be one of {words}; it is {shown(value)}.",
            advice=nearest(value, choices).strip(),
            name=name,
        )
    return value


def _kinds_words(kind: Kinds) -> str:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    return " or ".join(kind.__name__ for kind in kinds)


Array = NDArray[np.float64]
Shape = tuple[int | str, ...]
Sizes = dict[str, tuple[int, ...]]
"""Symbol -> its length, and "..." -> the broadcast leading axes of all arrays."""

LARGEST = 1e60
"""Bound of valid numbers. Powers of larger ones, as in det P, overflow."""

_FLOAT = np.dtype(float)
_REAL_KINDS = "fiu"  # NumPy's kinds of floating-point numbers and integers
_ASYMMETRY = 1e-8  # maximum relative asymmetry that counts as rounding


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
        shape: Its shape, with symbols for variable lengths; None for any shape.
        sizes: Lengths of symbols so far; updated by this array.
        finite: Whether NaN, infinity and magnitudes above `LARGEST` are errors.
    """
    array = _numbers(value, name, shape)
    if shape is not None and not _fits(array.shape, shape, sizes):
        raise _wrong(name, shape, sizes, f"its shape is {array.shape}", got=array.shape)
    if finite and not _within(array):
        place = tuple(int(i) for i in np.argwhere(~(np.abs(array) <= LARGEST))[0])
        at = f" at {list(place)}" if place else ""
        raise _wrong(name, shape, sizes, f"it has {array[place]}{at}", place=place)
    return array


def one_or_each(
    value: Any,
    name: str,
    count: int,
    *,
    strict: bool = False,
    finite: bool = True,
) -> Array:
    """Return numbers (count,), at least 0, from a scalar or (count,).

    Args:
        strict: Whether 0 is an error.
        finite: Whether infinity is an error; NaN always is.
    """
    array = real_array(value, name, finite=finite)
    if array.shape not in ((), (count,)):
        raise ArgumentError(
            f"{name} must be one number or {count}; its shape is {array.shape}.", name=name
        )
    if not (array > 0.0 if strict else array >= 0.0).all():
        bound = "above" if strict else "at least"
        raise ArgumentError(f"{name} must be {bound} 0; it is {shown(array.tolist())}.", name=name)
    # A writable array: compiled functions have another version for read-only ones.
    return np.full(count, array)


def mask(value: Any, name: str) -> NDArray[np.bool_]:
    """Return booleans (n,), checked."""
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        array = np.empty((), object)
    if array.ndim != 1 or array.dtype != bool:
        raise ArgumentError(f"{name} must be (n,) booleans; it is {shown(value)}.", name=name)
    return array


def positive_definite(value: Any, name: str, shape: Shape, sizes: Sizes | None = None) -> Array:
    """Return a matrix, checked to be symmetric positive definite, in any units."""
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
            f"{name} must be symmetric; its asymmetry is {asymmetry:.2g} of its diagonal.",
            advice="Pass 0.5 * (M + M.T) if the difference is due to rounding.",
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
    """Return an array of floats; raise if the value is not made of real numbers."""
    if type(value) is np.ndarray and value.dtype == _FLOAT:
        return value
    if isinstance(value, np.ma.MaskedArray):
        raise _wrong(name, shape, None, "it has a mask")
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        # Such as ragged lists.
        raise _wrong(name, shape, None, f"it is {shown(value)}") from error
    if array.dtype.kind not in _REAL_KINDS and array.size:
        description = shown(value) if array.dtype.kind in "OU" else f"of type {array.dtype}"
        raise _wrong(name, shape, None, f"it is {description}")
    with np.errstate(over="ignore"):  # large numbers of higher precision become infinite
        return np.asarray(array, _FLOAT)


def _fits(actual: tuple[int, ...], shape: Shape, sizes: Sizes | None) -> bool:
    """Return whether a shape matches the required one, and bind its symbols if so."""
    has_leading_axes = shape[:1] == ("...",)
    trailing = shape[1:] if has_leading_axes else shape
    start = len(actual) - len(trailing)
    if start < 0 or (start and not has_leading_axes):
        return False
    bound: Sizes = {}
    for length, symbol in zip(actual[start:], trailing, strict=True):
        if isinstance(symbol, int):
            required: tuple[int, ...] = (symbol,)
        else:
            required = bound.get(symbol) or (sizes or {}).get(symbol) or (length,)
            bound[symbol] = required
        if required != (length,):
            return False
    if sizes is not None:
        if has_leading_axes:
            try:
                bound["..."] = np.broadcast_shapes(sizes.get("...", ()), actual[:start])
            except ValueError:
                return False
        sizes.update(bound)
    return True


def _within(array: Array) -> bool:
    """Return whether all values are finite and within ±`LARGEST`, without copying the array."""
    least = np.minimum.reduce(array, axis=None, initial=0.0)  # NaN if any value is
    return bool(least >= -LARGEST and np.maximum.reduce(array, axis=None, initial=0.0) <= LARGEST)


def _wrong(
    name: str, shape: Shape | None, sizes: Sizes | None, but: str, **evidence: Any
) -> ArgumentError:
    """Return the error for an invalid array."""
    if shape == ():
        return ArgumentError(f"{name} must be a finite real number; {but}.", name=name, **evidence)
    comma = "," if shape is not None and len(shape) == 1 else ""
    words = "" if shape is None else f"({', '.join(map(str, shape))}{comma}) "
    bound = {symbol: (sizes or {}).get(str(symbol)) for symbol in shape or ()}
    lengths = [
        f"leading axes {size}" if symbol == "..." else f"{symbol} = {size[0]}"
        for symbol, size in bound.items()
        if size
    ]
    condition = f" with {' and '.join(lengths)}" if lengths else ""
    return ArgumentError(
        f"{name} must be {words}finite real numbers{condition}; {but}.", name=name, **evidence
    )


def number(
    value: Any,
    name: str,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    strict: bool = False,
    finite: bool = True,
) -> float:
    """Return a real number, checked to be between two bounds.

    Args:
        strict: Whether the bounds are excluded.
        finite: Whether infinity and magnitudes above `LARGEST` are errors; NaN always is.
    """
    x = float(real_array(value, name, (), finite=False))
    is_inside = lower < x < upper if strict else lower <= x <= upper
    if not is_inside or (finite and abs(x) > LARGEST):
        words = _range_words("a finite number", lower, upper, strict=strict)
        raise ArgumentError(f"{name} must be {words}; it is {x:g}.", name=name)
    return x


def positive(value: Any, name: str) -> float:
    """Return a number, checked to be finite and above zero."""
    return number(value, name, lower=0.0, strict=True)


def integer(
    value: Any, name: str, *, lower: float = -sys.maxsize, upper: float = sys.maxsize
) -> int:
    """Return an integer, checked to be from `lower` to `upper`."""
    try:
        index = operator.index(value)
    except TypeError:
        index = None
    if index is None or isinstance(value, bool | np.bool_) or not lower <= index <= upper:
        has_no_limits = index is None or abs(index) <= sys.maxsize
        limits = [
            x if abs(x) < sys.maxsize or not has_no_limits else x * np.inf for x in (lower, upper)
        ]
        words = _range_words("an integer", *limits, strict=False)
        raise ArgumentError(f"{name} must be {words}; it is {shown(value)}.", name=name)
    return index


def _range_words(noun: str, lower: float, upper: float, *, strict: bool) -> str:
    """Return words such as "a finite number above 0"."""
    if np.isinf(lower) and np.isinf(upper):
        return noun
    if np.isinf(upper):
        return f"{noun} {'above' if strict else 'of at least'} {lower:g}"
    if np.isinf(lower):
        return f"{noun} {'below' if strict else 'of at most'} {upper:g}"
    if strict:
        return f"{noun} between {lower:g} and {upper:g}, exclusive"
    return f"{noun} from {lower:g} to {upper:g}"


def integers(
    value: Iterable[int], name: str, *, lower: float = -sys.maxsize, upper: float = sys.maxsize
) -> tuple[int, ...]:
    """Return the integers of an iterable, checked to be from `lower` to `upper`."""
    items = instances(value, name, object)
    return tuple(integer(item, name, lower=lower, upper=upper) for item in items)


F = TypeVar("F", bound=Callable[..., Any])
_TRUTH = (bool, np.bool_, int)
_OPEN = (float, int, complex, object, Any)


def typed(function: F) -> F:
    """Return a function that checks its arguments against annotations that are classes.

    Items of collections, and numbers, which have bounds, must be checked by the function.
    """
    signature = inspect.signature(function)

    @cache
    def kinds() -> Mapping[str, tuple[type, ...]]:
        hints = get_type_hints(function)
        return {name: _kinds(hints.get(name, Any)) for name in signature.parameters}

    @wraps(function)
    def checked(*args: Any, **named: Any) -> Any:
        for name, value in signature.bind(*args, **named).arguments.items():
            if allowed := kinds()[name]:
                instance(value, name, allowed)
        return function(*args, **named)

    return cast(F, checked)


def _kinds(hint: Any) -> tuple[type, ...]:
    """Return the classes that an annotation admits; empty if classes cannot express it."""
    if get_origin(hint) in (Union, UnionType):
        parts = [_kinds(part) for part in get_args(hint)]
        return tuple(kind for kinds in parts for kind in kinds) if all(parts) else ()
    kind = get_origin(hint) or hint
    if kind is bool:
        return _TRUTH
    if not isinstance(kind, type) or kind in _OPEN:
        return ()
    if kind is tuple and ... not in get_args(hint):
        return (tuple,)
    is_collection = issubclass(kind, Iterable) and not issubclass(kind, str | Mapping)
    return () if is_collection else (kind,)
