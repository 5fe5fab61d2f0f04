"""Single numbers."""

from __future__ import annotations

import operator
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np

from geodrake.boundary.arguments.arrays import LARGEST, real_array
from geodrake.boundary.arguments.objects import instances
from geodrake.boundary.arguments.words import shown
from geodrake.errors import ArgumentError


def number(
    value: Any,
    name: str,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    strict: bool = False,
    finite: bool = True,
) -> float:
    """A real number between two others.

    Args:
        value: What the caller passed.
        name: What messages call it.
        strict: Whether the bounds themselves are refused.
        finite: Whether infinity and what is beyond `LARGEST` is refused; NaN always is.

    Raises:
        ArgumentError: It is something else.
    """
    found = float(real_array(value, name, (), finite=False))
    inside = lower < found < upper if strict else lower <= found <= upper
    if not inside or (finite and abs(found) > LARGEST):
        wanted = _range("a finite number", lower, upper, strict=strict)
        raise ArgumentError(f"{name} must be {wanted}; it is {found:g}.", name=name)
    return found


def positive(value: Any, name: str) -> float:
    """A finite number above zero.

    Raises:
        ArgumentError: It is something else.
    """
    return number(value, name, lower=0.0, strict=True)


def integer(
    value: Any, name: str, *, lower: float = -sys.maxsize, upper: float = sys.maxsize
) -> int:
    """A whole number from `lower` to `upper`.

    Args:
        value: What the caller passed: an int, or an integer of NumPy, but no bool.
        name: What messages call it.

    Raises:
        ArgumentError: It is something else; a float is, whatever its value.
    """
    try:
        found = operator.index(value)
    except TypeError:
        found = None
    if found is None or isinstance(value, bool | np.bool_) or not lower <= found <= upper:
        unlimited = found is None or abs(found) <= sys.maxsize
        limits = [
            x if abs(x) < sys.maxsize or not unlimited else x * np.inf for x in (lower, upper)
        ]
        wanted = _range("a whole number", *limits, strict=False)
        raise ArgumentError(f"{name} must be {wanted}; it is {shown(value)}.", name=name)
    return found


def _range(what: str, lower: float, upper: float, *, strict: bool) -> str:
    """Such as "a finite number above 0"."""
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
    """Integers between bounds, in whatever holds them.

    Raises:
        ArgumentError: It holds something else, or nothing can be taken from it.
    """
    found = instances(value, name, object)
    return tuple(integer(each, name, lower=lower, upper=upper) for each in found)
