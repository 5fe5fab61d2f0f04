"""Checks of effects' columns, whose errors name the line of user code."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.robot_motion import RobotMotion
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]

_LEAST, _GREATEST = 1e-100, 1e100
"""Bounds of a user's values, so that squares are finite: smaller ones become 0, larger raise."""

_OURS = frozenset(str(path) for path in Path(__file__).parent.glob("*.py"))


def rows_of(effect: Any, motion: RobotMotion) -> Mapping[str, Array]:
    """Return `Effect.rows`, checked."""
    kind = type(effect)
    if of_geodrake(kind):
        return effect.rows(motion)
    line = line_of(kind, "columns", "rows")
    with exits_as_errors(kind.name, line):
        rows: Any = effect.rows(_read_only(motion))
    if not isinstance(rows, Mapping):
        raise ArgumentError(f"{kind.name} returns {rows!r:.60} instead of columns by joint{line}.")
    unknown = [joint for joint in rows if joint not in motion.joints]
    if unknown:
        raise ArgumentError(
            f"{kind.name} returns columns of an unknown joint {unknown[0]!r}{line}.",
            advice=f"Joints are {', '.join(motion.joints)}.",
        )
    shape = (len(motion.v), len(effect.parameters))
    return {
        joint: _checked(f"{kind.name} of {joint}", line, block, shape)
        for joint, block in rows.items()
    }


def of_geodrake(kind: type[Any]) -> bool:
    """Return whether a class belongs to geodrake, so that its columns need no checks."""
    return kind.__module__.startswith("geodrake.")


def stacked(effect: Any, columns: Any, joint: str, count: int) -> Array:
    """Return columns of a joint, one for each parameter, as an array (N, k)."""
    name = effect.name
    line = "" if of_geodrake(type(effect)) else line_of(type(effect), "columns")
    if isinstance(columns, str) or not isinstance(columns, Sequence | np.ndarray):
        raise ArgumentError(
            f"{name} returns {columns!r:.60} instead of columns{line}.",
            advice="Let columns() return a list with one column for each entry of `parameters`.",
        )
    if len(columns) != len(effect.parameters):
        raise ArgumentError(
            f"{name} has {len(effect.parameters)} parameters, but {len(columns)} columns{line}.",
            advice="Let columns() return one column for each entry of `parameters`.",
        )
    return np.stack([_checked(f"{name} of {joint}", line, x, (count,)) for x in columns]).T


def _checked(what: str, line: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return columns as finite floats of a shape; `what` describes them in errors."""
    is_float = isinstance(values, np.ndarray) and values.dtype == float and not line
    if is_float and np.shape(values) == shape and np.isfinite(array := np.asarray(values)).all():
        return array
    advice = "Let columns() return arrays of the shape of joint.q, or numbers."
    if np.iscomplexobj(values):
        raise ArgumentError(f"{what} returns complex numbers{line}.", advice=advice)
    try:
        array = np.broadcast_to(np.asarray(values, float), shape)
    except (TypeError, ValueError) as error:
        raise ArgumentError(
            f"{what} returns a column of shape {np.shape(values)} for {shape[0]} "
            f"samples{line}: {error}.",
            advice=advice,
        ) from error
    least, greatest = (_LEAST, _GREATEST) if line else (0.0, np.finfo(float).max)
    bad = np.flatnonzero(~(np.abs(array) <= greatest))
    if len(bad):
        raise ArgumentError(
            f"{what} returns {array.flat[bad[0]]:g} in {len(bad)} of {array.size} samples{line}.",
            advice="Let columns() return finite numbers of reasonable size for every motion.",
        )
    return np.where(np.abs(array) < least, 0.0, array)


@contextmanager
def exits_as_errors(name: str, line: str) -> Iterator[None]:
    """Convert exceptions that would end the program, such as `SystemExit`, to errors."""
    try:
        yield
    except (Exception, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:
        raise ArgumentError(f"{name} raises {type(error).__name__}: {error}{line}.") from error


def line_of(effect: type[Any], *methods: str) -> str:
    """Return " (line N of FILE)" for the last of these methods that a user defines."""
    defined: list[Callable[..., Any]] = [getattr(effect, m) for m in methods if hasattr(effect, m)]
    codes = [code for code in (getattr(f, "__code__", None) for f in defined) if code is not None]
    user = [code for code in codes if code.co_filename not in _OURS]
    return f" (line {user[-1].co_firstlineno} of {user[-1].co_filename})" if user else ""


def _read_only(motion: RobotMotion) -> RobotMotion:
    """Return the motion with read-only arrays."""
    arrays = {}
    for name in ("q", "v", "vd", "load"):
        arrays[name] = getattr(motion, name).view()
        arrays[name].flags.writeable = False
    return replace(motion, **arrays)
