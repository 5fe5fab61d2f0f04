"""Numbers of joints, or other scalars of Drake in their place, checked where they come in."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression

from geodrake.boundary.arguments import real_array
from geodrake.errors import ArgumentError
from geodrake.model.formulas.evaluation import Scalars
from geodrake.model.formulas.symbols import Symbols

_FLOAT = np.dtype(float)
_OTHERS = (AutoDiffXd, Expression, float, int)


class JointScalars:
    """A dataclass of scalars of n joints, one for all joints or (..., n)."""

    def __post_init__(self) -> None:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        names = [field.name for field in fields]
        found = joint_scalars((), {name: getattr(self, name) for name in names}, finite=False)
        for name, value in zip(names, found, strict=True):
            object.__setattr__(self, name, value)

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape () or (..., n) of all fields together."""
        return np.broadcast_shapes(*(value.shape for value in vars(self).values()))


def joint_scalars(
    shape: tuple[int, ...], values: Mapping[str, Any], *, finite: bool = True
) -> list[Scalars]:
    """Return the values as arrays, one for all joints or (..., n).

    Args:
        shape: () or (..., n), with which they must go together.
        values: Name -> what the caller passed.
        finite: Whether infinity is refused, which is a limit that there is not.

    Raises:
        ArgumentError: They hold something else, NaN included, or are of different joints.
    """
    found = [_scalars(value, name, finite) for name, value in values.items()]
    for name, array in zip(values, found, strict=True):
        if array.shape in ((), shape):
            continue
        if shape and array.shape[-1] != shape[-1]:
            raise ArgumentError(
                f"{name} must be one number or {shape[-1]}; it has the shape {array.shape}.",
                name=name,
            )
        try:
            shape = np.broadcast_shapes(shape, array.shape)
        except ValueError as error:
            raise ArgumentError(
                f"{name} has the shape {array.shape}, and others {shape}.", name=name
            ) from error
    return found


def _scalars(value: Any, name: str, finite: bool) -> Scalars:
    if isinstance(value, Symbols):
        return value
    is_array = type(value) is np.ndarray
    if is_array and value.dtype == object and all(isinstance(x, _OTHERS) for x in value.flat):
        return np.asarray(value)
    array = value if is_array and value.dtype == _FLOAT else real_array(value, name, finite=False)
    if np.isnan(array).any() or (finite and np.isinf(array).any()):
        raise ArgumentError(f"{name} must be numbers; it holds NaN or infinity.", name=name)
    return array
