"""Checks of what callers pass to public functions: one door, and kernels behind it trust.

A shape is written as in docstrings: `("N", 10)`, or `("...", 3)` for any leading axes. A symbol has
one length in all arrays that are checked with the same `sizes`, and leading axes must broadcast:

    sizes: Sizes = {}
    q = real_array(q, "q", ("N", "nq"), sizes)
    v = real_array(v, "v", ("N", "nv"), sizes)

Numbers are real: complex ones, strings, objects, booleans, masked arrays and ragged lists are
refused instead of being half believed.
"""

from geodrake.boundary.arguments.annotations import typed
from geodrake.boundary.arguments.arrays import (
    Shape,
    Sizes,
    mask,
    one_or_each,
    positive_definite,
    real_array,
)
from geodrake.boundary.arguments.numbers import integer, integers, number, positive
from geodrake.boundary.arguments.objects import file_path, function, instance, instances, one_of

__all__ = [
    "Shape",
    "Sizes",
    "file_path",
    "function",
    "instance",
    "instances",
    "integer",
    "integers",
    "mask",
    "number",
    "one_of",
    "one_or_each",
    "positive",
    "positive_definite",
    "real_array",
    "typed",
]
