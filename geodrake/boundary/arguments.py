"""Checks of the arguments of public functions, so that kernels need not check theirs.

A shape is written as in docstrings: `("N", 10)`, or `("...", 3)` for any leading axes. A symbol has
one length in all arrays that are checked with the same `sizes`, and leading axes must broadcast:

    sizes: Sizes = {}
    q = real_array(q, "q", ("N", "nq"), sizes)
    v = real_array(v, "v", ("N", "nv"), sizes)

Numbers are real: complex ones, strings, objects, booleans, masked arrays and ragged lists are
refused instead of being half believed.
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

_LONGEST = 60  # characters of a value that a message shows


def shown(value: Any) -> str:
    """Return a value for a message, shortened, with its type where that helps."""
    text = repr(value) if isinstance(value, str | bytes | int | float | list | tuple) else ""
    if not text or len(text) > _LONGEST:
        return f"of type {type(value).__name__}"
    return text


Kind = TypeVar("Kind")
Kinds = type | tuple[type, ...]


def instance(value: Kind, name: str, kind: Kinds) -> Kind:
    """Return an object of a class."""
    if not isinstance(value, kind):
        raise ArgumentError(
            f"{name} must be a {_kinds_words(kind)}; it is {shown(value)}.", name=name
        )
    return value


def instances(value: Iterable[Kind], name: str, kind: Kinds) -> tuple[Kind, ...]:
    """Return objects of a class from any iterable."""
    wanted = f"{name} must be a tuple of {_kinds_words(kind)}"
    if isinstance(value, str | bytes | dict) or not isinstance(value, Iterable):
        raise ArgumentError(f"{wanted}; it is {shown(value)}.", name=name)
    found = tuple(value)
    for place, each in enumerate(found):
        if not isinstance(each, kind):
            raise ArgumentError(f"{wanted}; number {place} is {shown(each)}.", name=name)
    return found


def function(value: Kind, name: str) -> Kind:
    """Return an argument that can be called."""
    if not callable(value):
        raise ArgumentError(f"{name} must be a function; it is {shown(value)}.", name=name)
    return value


def file_path(value: str | os.PathLike[str]) -> Path:
    """Return the path of a file."""
    if not isinstance(value, str | os.PathLike):
        raise ArgumentError(f"path must be a path; it is {shown(value)}.", name="path")
    path = Path(value)
    try:
        unusable = b"\0" in os.fsencode(path)
    except UnicodeEncodeError:
        unusable = True
    if unusable:
        raise ArgumentError(f"path must be a path; no file can be called {value!a}.", name="path")
    return path


def one_of(value: Any, name: str, choices: Collection[str]) -> str:
    """Return an argument that must be one of a few words."""
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
    return " or ".join(each.__name__ for each in kinds)


Array = NDArray[np.float64]
Shape = tuple[int | str, ...]
Sizes = dict[str, tuple[int, ...]]
"""Symbol -> its length, and "..." -> the leading axes of all arrays together."""

LARGEST = 1e60
"""Larger numbers do not occur in mechanics, and their powers, as in det P, soon overflow."""

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
        shape: Its shape, with symbols for lengths that may be any; None for any shape.
        sizes: What symbols stand for so far; completed by this array.
        finite: Whether NaN, infinity and what is beyond `LARGEST` are refused.
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
    """Return numbers (count,), at least 0, from one for all, or one for each.

    Args:
        strict: Whether 0 itself is refused.
        finite: Whether infinity is refused; NaN always is.
    """
    array = real_array(value, name, finite=finite)
    if array.shape not in ((), (count,)):
        raise ArgumentError(
            f"{name} must be one number or {count}; its shape is {array.shape}.", name=name
        )
    if not (array > 0.0 if strict else array >= 0.0).all():
        wanted = "above" if strict else "at least"
        raise ArgumentError(f"{name} must be {wanted} 0; it is {shown(array.tolist())}.", name=name)
    # Compiled loops are compiled once more for arrays that cannot be written, as views cannot.
    return np.full(count, array)


def mask(value: Any, name: str) -> NDArray[np.bool_]:
    """Return booleans (n,), checked."""
    try:
        found = np.asarray(value)
    except ValueError:  # ragged
        found = np.empty((), object)
    if found.ndim != 1 or found.dtype != bool:
        raise ArgumentError(f"{name} must be (n,) booleans; it is {shown(value)}.", name=name)
    return found


def positive_definite(value: Any, name: str, shape: Shape, sizes: Sizes | None = None) -> Array:
    """Return a symmetric positive-definite matrix, in any units."""
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
    """Return an array of floats; raise for complex numbers, texts, objects, booleans and masks."""
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
        what = shown(value) if array.dtype.kind in "OU" else f"of type {array.dtype}"
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
    """Return whether all values are finite and within ±`LARGEST`, without copying the array."""
    least = np.minimum.reduce(array, axis=None, initial=0.0)  # NaN if any value is
    return bool(least >= -LARGEST and np.maximum.reduce(array, axis=None, initial=0.0) <= LARGEST)


def _wrong(
    name: str, shape: Shape | None, sizes: Sizes | None, but: str, **evidence: Any
) -> ArgumentError:
    """Return the error for an array that fails its check."""
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


def number(
    value: Any,
    name: str,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    strict: bool = False,
    finite: bool = True,
) -> float:
    """Return a real number between two others.

    Args:
        strict: Whether the bounds themselves are refused.
        finite: Whether infinity and what is beyond `LARGEST` is refused; NaN always is.
    """
    found = float(real_array(value, name, (), finite=False))
    inside = lower < found < upper if strict else lower <= found <= upper
    if not inside or (finite and abs(found) > LARGEST):
        wanted = _range_words("a finite number", lower, upper, strict=strict)
        raise ArgumentError(f"{name} must be {wanted}; it is {found:g}.", name=name)
    return found


def positive(value: Any, name: str) -> float:
    """Return a finite number above zero."""
    return number(value, name, lower=0.0, strict=True)


def integer(
    value: Any, name: str, *, lower: float = -sys.maxsize, upper: float = sys.maxsize
) -> int:
    """Return an integer from `lower` to `upper`."""
    try:
        found = operator.index(value)
    except TypeError:
        found = None
    if found is None or isinstance(value, bool | np.bool_) or not lower <= found <= upper:
        unlimited = found is None or abs(found) <= sys.maxsize
        limits = [
            x if abs(x) < sys.maxsize or not unlimited else x * np.inf for x in (lower, upper)
        ]
        wanted = _range_words("an integer", *limits, strict=False)
        raise ArgumentError(f"{name} must be {wanted}; it is {shown(value)}.", name=name)
    return found


def _range_words(what: str, lower: float, upper: float, *, strict: bool) -> str:
    """Return words such as "a finite number above 0"."""
    if np.isinf(lower) and np.isinf(upper):
        return what
    if np.isinf(upper):
        return f"{what} {'above' if strict else 'of at least'} {lower:g}"
    if np.isinf(lower):
        return f"{what} {'below' if strict else 'of at most'} {upper:g}"
    if strict:
        return f"{what} between {lower:g} and {upper:g}, without both"
    return f"{what} from {lower:g} to {upper:g}"


def integers(
    value: Iterable[int], name: str, *, lower: float = -sys.maxsize, upper: float = sys.maxsize
) -> tuple[int, ...]:
    """Return integers between bounds from any iterable."""
    found = instances(value, name, object)
    return tuple(integer(each, name, lower=lower, upper=upper) for each in found)


F = TypeVar("F", bound=Callable[..., Any])
_TRUTH = (bool, np.bool_, int)
_OPEN = (float, int, complex, object, Any)


def typed(function: F) -> F:
    """Return the function with a check of all arguments that must be of a class, or None.

    What is in collections, and numbers, which have bounds as well, are left to the function.
    """
    signature = inspect.signature(function)

    @cache
    def kinds() -> Mapping[str, tuple[type, ...]]:
        hints = get_type_hints(function)
        return {name: _kinds(hints.get(name, Any)) for name in signature.parameters}

    @wraps(function)
    def checked(*args: Any, **named: Any) -> Any:
        for name, value in signature.bind(*args, **named).arguments.items():
            if wanted := kinds()[name]:
                instance(value, name, wanted)
        return function(*args, **named)

    return cast(F, checked)


def _kinds(hint: Any) -> tuple[type, ...]:
    """Return the classes that an annotation admits; empty if classes cannot express it."""
    if get_origin(hint) in (Union, UnionType):
        each = [_kinds(part) for part in get_args(hint)]
        return tuple(kind for kinds in each for kind in kinds) if all(each) else ()
    kind = get_origin(hint) or hint
    if kind is bool:
        return _TRUTH
    if not isinstance(kind, type) or kind in _OPEN:
        return ()
    if kind is tuple and ... not in get_args(hint):
        return (tuple,)
    collection = issubclass(kind, Iterable) and not issubclass(kind, str | Mapping)
    return () if collection else (kind,)
