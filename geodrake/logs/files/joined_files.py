"""Logs whose columns are in several files: read one by one, and joined by their time stamps."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from geodrake.boundary.arguments import typed
from geodrake.logs.files.formats import table_of
from geodrake.logs.files.joined_tables import joined_tables, meanings_of
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import OF_JOINTS, is_time, meaning_of, quantity_of
from geodrake.logs.files.shapes import reshaped
from geodrake.logs.files.table import LogTable

_TOLD = re.compile(r"(?<![a-z])controls?(?![a-z])")  # in the name of a file of commands


@typed
def parts_of(path: Path) -> tuple[Path, ...]:
    """The files of a log: itself, or those that `+` joins, as in `positions.csv+efforts.csv`."""
    if "+" not in str(path) or path.exists():
        return (path,)
    return tuple(Path(part) for part in str(path).split("+") if part)


def joined_table(paths: Sequence[Path], reading: Reading) -> LogTable:
    """Return the columns of several files, at the time stamps of the one with the fewest a second.

    Args:
        paths: Files of any format. The name of a file may say the quantity of its columns, as
            that of `efforts.csv` does.

    Raises:
        LogError: One cannot be read, files without time are not equally long, their times do not
            meet, or one has more than ten times the rows a second of another.
    """
    named = [replace(_table(path, reading), path=Path(path.name)) for path in paths]
    return joined_tables(Path("+".join(path.name for path in paths)), named, reading)


def _table(path: Path, reading: Reading) -> LogTable:
    """Return the columns of one file; bare names of joints get the quantity of the file's name."""
    table = reshaped(table_of(path, reading, numbered=True).loaded(), reading)
    quantity = quantity_of(path.stem)
    if quantity is None and _TOLD.search(path.stem.lower()):
        quantity = "command"
    if quantity is None or any(m.quantity == quantity for m in meanings_of(table)):
        return table
    if quantity == "command" and any(m.quantity in OF_JOINTS for m in meanings_of(table)):
        quantity = None  # positions by their names: of commands, as that of the file says

    def named(column: str) -> str:
        meaning = meaning_of(column)
        if is_time(column):
            return column
        if quantity is None:
            is_position = meaning is not None and meaning.quantity == "position"
            own = column.removesuffix(".position")
            named = f"{own}.command" if own != column else f"command_{column}"
            return named if is_position else column
        return f"{quantity}_{column}" if column.isdecimal() else f"{column}.{quantity}"

    columns = {named(name): values for name, values in table.columns.items()}
    units = {named(name): unit for name, unit in table.units.items()}
    origins = {named(name): zero for name, zero in table.origins.items()}
    return replace(table, columns=columns, units=units, origins=origins)
