"""The numbers of a log while its file is read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.files.column_mapping import Columns, in_seconds, read_column, with_own_parts
from geodrake.logs.files.joined_tables import at_instants
from geodrake.logs.files.packed_files import log_name
from geodrake.logs.files.table import TornRows
from geodrake.logs.motion import PASSIVE, JointLog
from geodrake.logs.time_stamps import evened, going_on, order_of_time, repeats
from geodrake.logs.units_of_values import ROUNDING, are_whole, take_units

LEAST_ROWS = 10
_DAY = 86_400_000_000_000  # ns
_BLOCK = 4096  # rows that are copied at once
_RUN, _ENOUGH_ROWS = 20, 100  # rows without an empty cell that are of use, and of a column
_STILL = 2e-3  # rad or m, by which a joint may move and still stand
_COMPLEMENTS = (16, 32)  # bits of registers in two's complement
_SIGN_BITS = (10, 15)  # bits that hold a sign beside a magnitude, as of Feetech's servos
_NINES = re.compile(r"-?9{3,}")  # what loggers write where nothing was measured
_LEAST, _CLOSER = 3, 0.5  # rows with either sign, and share of the jumps that these leave


def recorded(columns: Columns, numbers: dict[str, Array], torn: TornRows) -> JointLog:
    """Return the log from a file's numbers, with units inferred from them.

    Numbers (N,) of the file's columns are taken out of the mapping, so that each is held once.
    """
    rows = len(next(iter(numbers.values())))
    if rows < LEAST_ROWS:
        raise LogError(
            f"Log {str(columns.path)!r} has {rows} rows; at least {LEAST_ROWS} are needed.",
            advice="Record several seconds of motion.",
        )
    signed = [*_leave_out_nines(columns, numbers), *_take_signs(columns, numbers)]

    def column(joint: str, quantity: str) -> Array:
        source = columns.places.get((joint, quantity))
        return np.full(rows, np.nan) if source is None else read_column(source, numbers)

    joints, notes = columns.joints, tuple[str, ...]()
    stamps = columns.places.get(("", "time"))
    stamps = None if stamps is None or columns.rate is not None else with_own_parts(stamps, numbers)
    given = None if stamps is None else read_column(stamps, numbers)
    alone = {joint: column(joint, "position") for joint in columns.standing}
    data = {name: read_column(source, numbers) for name, source in columns.floating.items()}
    data |= {f"{joint}.position": place for joint, place in alone.items()}
    for quantity in columns.quantities:
        data[quantity] = _side_by_side([column(joint, quantity) for joint in joints])
    if stamps is None or given is None:
        time = np.arange(rows) / (columns.rate or 1.0)
    else:
        time, notes = in_seconds(stamps, given, (data["position"], data.get("velocity")))

    time, more = going_on(time, of_day=columns.origin is not None and columns.origin < _DAY)
    order = None if torn.rows else order_of_time(time, data["position"])
    if order is not None:  # rows that are torn are known by their place in the file
        time, more = time[order], (*more, "rows were sorted by time")
        data = {name: values[order] for name, values in data.items()}
    time, even = evened(time, data["position"])
    again = repeats(time, [*data.values()])
    if again.any():
        time = np.where(again, np.nan, time)
        even += (f"{again.sum()} of {rows} rows with a repeated time stamp are skipped",)
    kept, left_out = torn.settle(time)
    kept &= ~again
    take_units(time, data, columns)
    kinds, motors = _without_motors(data, columns)
    if not kept.all():
        time, data = time[kept], {name: values[kept] for name, values in data.items()}
    if (rarest := _rows_of_the_rarest(time, data)) is not None:
        words = (
            "each row has only some of the columns: all are interpolated at the instants "
            "of the slowest"
        )
        even += (f"{words}, {np.count_nonzero(rarest)} of {len(time)} rows",)
        held = ("command", *columns.floating)
        data = {n: _at(time[rarest], time, x, holds=n in held) for n, x in data.items()}
        time = time[rarest]
    elif "command" in data:  # of which changes alone may be written
        told = np.where(np.isfinite(data["command"]), np.arange(len(time))[:, None], 0)
        last = np.maximum.accumulate(told, axis=0)
        data["command"] = np.take_along_axis(data["command"], last, axis=0)
    uncertainty = columns.reading.effort_uncertainty(joints)
    passive = np.array([kinds.get(joint) == PASSIVE for joint in joints])
    return JointLog(
        log_name(columns.path),
        joints,
        time,
        data["position"],
        data["effort"],
        data.get("velocity"),
        data.get("acceleration"),
        (*columns.notes, *notes, *more, *even, *signed, *motors, *left_out),
        effort_uncertainty=np.where(passive, 0.0, uncertainty) if passive.any() else uncertainty,
        standing={joint: _place(data[f"{joint}.position"]) for joint in alone},
        alone={joint: data[f"{joint}.position"] for joint in alone},
        command=data.get("command"),
        effort_kinds=kinds,
        temperature=data.get("temperature"),
        origin=columns.origin,
        floating={name: data[name] for name in columns.floating},
        left_out=columns.left_out,
    )


def _side_by_side(columns: Sequence[Array]) -> Array:
    """Return columns (N,) as (N, n), in blocks of rows that fit into a cache."""
    found = np.empty((len(columns[0]), len(columns)))
    for first in range(0, len(found), _BLOCK):
        block = slice(first, first + _BLOCK)
        for place, column in enumerate(columns):
            found[block, place] = column[block]
    return found


def _leave_out_nines(columns: Columns, numbers: dict[str, Array]) -> Iterator[str]:
    """Leave out numbers such as −9999, which stand for nothing; yield notes.

    They are farther from all others of their column than these are apart.
    """
    for column in {source.column: None for (joint, _), source in columns.places.items() if joint}:
        for value in (np.fmin.reduce(numbers[column]), np.fmax.reduce(numbers[column])):
            if not _NINES.fullmatch(f"{value:g}"):
                continue
            lost = numbers[column] == value
            rest = numbers[column][~lost & np.isfinite(numbers[column])]
            if len(rest) and np.abs(rest - value).min() > np.ptp(rest):
                numbers[column] = np.where(lost, np.nan, numbers[column])
                yield f"{column!r} is {value:g} in {lost.sum()} rows: taken as not measured"


def _take_signs(columns: Columns, numbers: dict[str, Array]) -> Iterator[str]:
    """Give numbers of registers that were read without their sign that sign; yield notes.

    A joint that always pushes one way has registers of the kind of other joints.
    """
    for quantity in {what: None for joint, what in columns.places if joint}:
        own = [source.column for (_, what), source in columns.places.items() if what == quantity]
        found = {c: _register(numbers[c], magnitudes=quantity != "position") for c in own}
        known = next(filter(None, found.values()), None)
        for column in own:
            kind, values = found[column] or known, numbers[column]
            half, is_complement = kind or (np.inf, False)
            largest = np.fmax.reduce(values, initial=0.0)
            if not half <= largest < 2.0 * half or np.fmin.reduce(values) < 0.0:
                continue
            turned = values - 2.0 * half if is_complement else half - values
            numbers[column] = np.where(values >= half, turned, values)
            bits, end = round(np.log2(half)), turned[np.nanargmax(values)]
            how = f"sign and magnitude with the sign in bit {bits}"
            how = f"two's complement of {bits + 1} bits" if is_complement else how
            yield f"{column!r} is read as {how}: {largest:.0f} is {end:.0f}"


def _register(numbers: Array, *, magnitudes: bool) -> tuple[float, bool] | None:
    """Return half of the range of a register, and if it is in two's complement; None otherwise.

    A register of k bits that is read without its sign jumps by most of its range where the sign
    changes, and with it does not. A bit for the sign is looked for if `magnitudes`, and so are
    numbers that are next to 2ᵏ throughout.
    """
    largest = np.fmax.reduce(numbers, initial=0.0)
    if (
        largest < 2 ** _SIGN_BITS[0]
        or np.fmin.reduce(numbers) < -ROUNDING
        or not are_whole(numbers)
    ):
        return None
    known = np.rint(numbers[np.isfinite(numbers)])
    kinds = [(2.0 ** (bits - 1), True) for bits in _COMPLEMENTS]
    kinds += [(2.0**bit, False) for bit in _SIGN_BITS if magnitudes]
    for half, is_complement in kinds:
        if not half <= largest < 2.0 * half:
            continue
        above = known >= half
        if magnitudes and is_complement and known.min() >= 1.5 * half:  # always negative
            return half, True
        turned = np.where(above, known - 2.0 * half if is_complement else half - known, known)
        before, after = (np.abs(np.diff(x))[above[1:] != above[:-1]] for x in (known, turned))
        few = min(np.count_nonzero(above), np.count_nonzero(~above)) < _LEAST
        if not few and len(before) >= 2 and np.median(after) < _CLOSER * np.median(before):
            return half, is_complement
    return None


def _without_motors(data: dict[str, Array], columns: Columns) -> tuple[dict[str, str], list[str]]:
    """Set efforts (N, n) of joints without a motor to zero; return kinds of efforts, and notes."""
    kinds, notes, effort, command = columns.kinds, [], data["effort"], data.get("command")
    says = bool(columns.having("effort", "command")) or not columns.reading.of_base
    for at, joint in enumerate(columns.joints):
        said, motorless = kinds.get(joint) == PASSIVE, columns.reading.motorless
        if not said and joint not in motorless:
            continue
        largest = float(np.abs(np.nan_to_num(effort[:, at])).max(initial=0.0))
        told = command is not None and np.isfinite(command[:, at]).any()
        if said and largest > 0.0:
            raise LogError(
                f"Joint {joint!r} is passive, but log {columns.path.name!r} has efforts of "
                f"it of up to {largest:.4g}.",
                advice="Omit --passive; or write `effort: passive` in a mapping, which ignores "
                "that column.",
            )
        if joint in motorless and says and not (largest or told):
            kinds[joint] = PASSIVE
            notes.append(f"{joint} has no motor in the model and no effort in the log: passive")
        if kinds.get(joint) == PASSIVE:
            effort[:, at] = 0.0
    return kinds, notes


def _place(position: Array) -> float:
    """Return the position of a joint without effort; NaN if it moves."""
    known = position[np.isfinite(position)]
    if not len(known) or known.max() - _STILL > known.min():
        return np.nan
    return float(known[0] + (known - known[0]).mean())


def _at(instants: Array, time: Array, values: Array, *, holds: bool) -> Array:
    """Return values (N,) or (N, n) of rows that may be empty at other instants."""
    if values.ndim > 1:
        return np.stack([_at(instants, time, column, holds=holds) for column in values.T], 1)
    there = np.isfinite(values) & np.isfinite(time)
    return at_instants(instants, time[there], values[there], holds=holds)


def _rows_of_the_rarest(time: Array, values: Mapping[str, Array]) -> NDArray[np.bool_] | None:
    """Return rows (N,) that have the rarest column; None for a log with complete rows.

    It has whole rows if half of them come in runs that are long enough to be of use.
    """
    quantities = [values[q] for q in ("position", "effort") if q in values]
    if all(np.isfinite(numbers).all() for numbers in quantities):
        return None
    known = [np.isfinite(column) for numbers in quantities for column in numbers.T]
    known = [each for each in known if each.any()]
    rarest = min(known, key=np.count_nonzero, default=np.zeros(0, bool))
    if np.count_nonzero(rarest) < _ENOUGH_ROWS:
        return None
    whole = np.logical_and.reduce(known)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], whole, [False]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    has_whole = 2 * lengths[lengths >= _RUN].sum() >= np.count_nonzero(rarest)
    return None if has_whole else rarest & np.isfinite(time)
