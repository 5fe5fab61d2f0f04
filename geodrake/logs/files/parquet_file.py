"""Logs in Parquet and Feather files, as pandas, polars and Arrow write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.column_names import check_once
from geodrake.logs.files.damage import readable
from geodrake.logs.files.numeric_columns import numeric_table
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.room import check_room
from geodrake.logs.files.table import LogTable

Array = NDArray[np.float64]


def read_parquet(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a Parquet file; see `read_bag` for arguments."""
    parquet = optional_package("pyarrow.parquet", "logs", "Parquet files", LogError)
    with readable(path, "Parquet file"):
        file = parquet.ParquetFile(path)
        rows, width = file.metadata.num_rows, file.metadata.num_columns
        check_room(path, rows * width, f"{rows} rows of {width} columns")
        return arrow_table(path, file.read())


def read_feather(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a Feather or Arrow file; see `read_bag` for arguments."""
    feather = optional_package("pyarrow.feather", "logs", "Feather files", LogError)
    with readable(path, "Feather file"):
        return arrow_table(path, feather.read_table(path))


def arrow_table(path: Path, table: Any) -> LogTable:
    """Return columns of an Arrow table: structs by `<struct>.<field>`, lists by `<list>[0]`."""
    while any(str(field.type).startswith("struct") for field in table.schema):
        table = table.flatten()
    check_once(path, table.column_names)
    arrays = {name: arrow_numbers(table[name]) for name in table.column_names}
    return numeric_table(path, arrays, table.num_rows)


def arrow_numbers(column: Any) -> Any:
    """Return the values of a column of Arrow, lists of one length as (N, n)."""
    if not hasattr(column.type, "value_type") or not hasattr(column.type, "value_field"):
        return column.to_numpy()
    values = column.combine_chunks()
    rows, flat = len(values), values.flatten()
    lengths = np.asarray(values.value_lengths())
    if values.null_count or not rows or np.any(lengths != lengths[0]):
        return column.to_numpy()
    return np.asarray(flat.to_numpy(zero_copy_only=False)).reshape(rows, -1)
