"""Logs of data frames and arrays, whoever made them: pandas, polars, Arrow, NumPy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.arguments import instance, instances
from geodrake.errors import ArgumentError
from geodrake.logs.files import Reading, log_of
from geodrake.logs.files.column_mapping import check_once
from geodrake.logs.files.table import numeric_table, readable
from geodrake.logs.motion import JointLog


def log_of_frame(
    frame: Any,
    *,
    joints: Sequence[str] | None = None,
    name: str = "frame",
    reading: Reading | None = None,
) -> JointLog:
    """Return the log in a data frame, or in arrays by name.

    Args:
        frame: A DataFrame of pandas or polars, a table of Arrow, a structured array, or a mapping
            of names to arrays. Columns are `time` (numbers, durations or dates),
            `<joint>.position`, `<joint>.effort` (or `.current`, `.voltage`, `.pwm`, `.command`) and
            perhaps `<joint>.velocity` and `<joint>.temperature`; or `position`, `effort` … (N, n),
            with the joints in order.
            Without `time`, the index of a pandas frame is the time, if it is one of dates,
            durations or seconds.
        joints: Names of a model's joints, if the log must have the same and in their order.
        name: What messages call the log.
        reading: How columns are to be read, where their names do not say it.

    Raises:
        ArgumentError: It is no frame.
        LogError: It lacks a needed column or joint or has a column twice, such a column has no
            numbers, or its time does not increase.
    """
    instance(name, "name", str)
    joints = None if joints is None else instances(joints, "joints", str)
    with readable(Path(name), "frame of numbers", "Give columns of numbers, such as float64."):
        arrays = _arrays(frame, name)
    rows = max((len(values) for values in arrays.values() if np.ndim(values)), default=0)
    index: Any = getattr(frame, "index", None)
    if getattr(getattr(index, "dtype", None), "kind", "") in ("M", "m", "f"):  # no count of rows
        arrays.setdefault("time", index.to_numpy())
    table = numeric_table(Path(name), arrays, rows)
    return log_of(table, joints, reading or Reading())[0]


def _arrays(frame: Any, called: str) -> dict[str, Any]:
    """Return columns by their names, whatever holds them; a lazy frame of polars is collected."""
    if hasattr(frame, "collect_schema") and hasattr(frame, "collect"):
        frame = frame.collect()
    if isinstance(frame, np.ndarray) and frame.dtype.names is not None:
        return {name: frame[name] for name in frame.dtype.names}
    names = frame if isinstance(frame, Mapping) else getattr(frame, "column_names", None)
    if names is None:
        names = getattr(frame, "columns", None)
    if names is None or isinstance(frame, str):
        raise ArgumentError(
            f"A frame has named columns; it is {type(frame).__name__}.",
            advice="Give a DataFrame, or a dict of arrays with time, position and effort.",
        )
    check_once(Path(called), [str(name) for name in names])
    return {str(name): _array(frame[name]) for name in names}


def _array(column: Any) -> Any:
    """Return the array of a column; lists of polars as nested lists."""
    if hasattr(column, "to_numpy"):
        return column.to_numpy()
    return np.asanyarray(column)  # a mask says where nothing was measured
