"""Build a log from the numbers of a file."""

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
_BLOCK = 4096  # rows copied at once
_RUN, _ENOUGH_ROWS = 20, 100  # least rows of a useful run without gaps, and of a column
_STILL = 2e-3  # rad or m, largest motion of a joint at rest
_COMPLEMENTS = (16, 32)  # bits of registers in two's complement
_SIGN_BITS = (10, 15)  # sign bits beside a magnitude, as in Feetech's servos
_NINES = re.compile(r"-?9{3,}")  # placeholder for missing values
_LEAST, _CLOSER = 3, 0.5  # least rows of either sign, and largest ratio of corrected jumps


def recorded(columns: Columns, numbers: dict[str, Array], torn: TornRows) -> JointLog:
    """Build a log from the numbers (N,) of a file, with units inferred from them.

    Columns are removed from `numbers` as they are used, to save memory.
    """
    rows = len(next(iter(numbers.values())))
    if rows < LEAST_ROWS:
        raise LogError(
            f"Log {str(columns.path)!r} has {rows} rows; at least {LEAST_ROWS} are needed.",
            advice="Record several seconds of motion.",
        )
    value_notes = [*_drop_nines(columns, numbers), *_restore_signs(columns, numbers)]

    def column(joint: str, quantity: str) -> Array:
        source = columns.places.get((joint, quantity))
        return np.full(rows, np.nan) if source is None else read_column(source, numbers)

    joints, notes = columns.joints, tuple[str, ...]()
    stamps = columns.places.get(("", "time"))
    stamps = None if stamps is None or columns.rate is not None else with_own_parts(stamps, numbers)
    raw_time = None if stamps is None else read_column(stamps, numbers)
    undriven = {joint: column(joint, "position") for joint in columns.standing}
    data = {name: read_column(source, numbers) for name, source in columns.floating.items()}
    data |= {f"{joint}.position": place for joint, place in undriven.items()}
    for quantity in columns.quantities:
        data[quantity] = _as_matrix([column(joint, quantity) for joint in joints])
    if stamps is None or raw_time is None:
        time = np.arange(rows) / (columns.rate or 1.0)
    else:
        time, notes = in_seconds(stamps, raw_time, (data["position"], data.get("velocity")))

    time, time_notes = going_on(time, of_day=columns.origin is not None and columns.origin < _DAY)
    order = None if torn.rows else order_of_time(time, data["position"])
    if order is not None:  # corrupt rows are identified by their index in the file
        time, time_notes = time[order], (*time_notes, "rows were sorted by time")
        data = {name: values[order] for name, values in data.items()}
    time, row_notes = evened(time, data["position"])
    repeated = repeats(time, [*data.values()])
    if repeated.any():
        time = np.where(repeated, np.nan, time)
        row_notes += (f"{repeated.sum()} of {rows} rows with a repeated time stamp are skipped",)
    kept, left_out = torn.settle(time)
    kept &= ~repeated
    take_units(time, data, columns)
    kinds, motors = _without_motors(data, columns)
    if not kept.all():
        time, data = time[kept], {name: values[kept] for name, values in data.items()}
    if (rarest := _rarest_rows(time, data)) is not None:
        words = (
            "each row has only some of the columns: all are interpolated at the instants "
            "of the slowest"
        )
        row_notes += (f"{words}, {np.count_nonzero(rarest)} of {len(time)} rows",)
        held = ("command", *columns.floating)
        data = {n: _resampled(time[rarest], time, x, holds=n in held) for n, x in data.items()}
        time = time[rarest]
    elif "command" in data:  # logs may contain only changes
        indices = np.where(np.isfinite(data["command"]), np.arange(len(time))[:, None], 0)
        last = np.maximum.accumulate(indices, axis=0)
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
        (*columns.notes, *notes, *time_notes, *row_notes, *value_notes, *motors, *left_out),
        effort_uncertainty=np.where(passive, 0.0, uncertainty) if passive.any() else uncertainty,
        standing={joint: _rest_position(data[f"{joint}.position"]) for joint in undriven},
        alone={joint: data[f"{joint}.position"] for joint in undriven},
        command=data.get("command"),
        effort_kinds=kinds,
        temperature=data.get("temperature"),
        origin=columns.origin,
        floating={name: data[name] for name in columns.floating},
        left_out=columns.left_out,
        assumed=columns.assumed,
    )


def _as_matrix(columns: Sequence[Array]) -> Array:
    """Return columns (N,) as a matrix (N, n), copied in blocks that fit into the cache."""
    matrix = np.empty((len(columns[0]), len(columns)))
    for first in range(0, len(matrix), _BLOCK):
        block = slice(first, first + _BLOCK)
        for place, column in enumerate(columns):
            matrix[block, place] = column[block]
    return matrix


def _drop_nines(columns: Columns, numbers: dict[str, Array]) -> Iterator[str]:
    """Replace placeholders such as −9999 by NaN, and yield notes.

    They are farther from all other values of the column than these are from each other.
    """
    for column in {source.column: None for (joint, _), source in columns.places.items() if joint}:
        for value in (np.fmin.reduce(numbers[column]), np.fmax.reduce(numbers[column])):
            if not _NINES.fullmatch(f"{value:g}"):
                continue
            missing = numbers[column] == value
            rest = numbers[column][~missing & np.isfinite(numbers[column])]
            if len(rest) and np.abs(rest - value).min() > np.ptp(rest):
                numbers[column] = np.where(missing, np.nan, numbers[column])
                yield f"{column!r} is {value:g} in {missing.sum()} rows: taken as not measured"


def _restore_signs(columns: Columns, numbers: dict[str, Array]) -> Iterator[str]:
    """Restore the sign of register values that were read as unsigned, and yield notes.

    A column without changes of sign is assumed to have the same format as other joints.
    """
    for quantity in {what: None for joint, what in columns.places if joint}:
        names = [source.column for (_, what), source in columns.places.items() if what == quantity]
        registers = {c: _register(numbers[c], magnitudes=quantity != "position") for c in names}
        default = next(filter(None, registers.values()), None)
        for column in names:
            kind, values = registers[column] or default, numbers[column]
            half, is_complement = kind or (np.inf, False)
            largest = np.fmax.reduce(values, initial=0.0)
            if not half <= largest < 2.0 * half or np.fmin.reduce(values) < 0.0:
                continue
            negative = values - 2.0 * half if is_complement else half - values
            numbers[column] = np.where(values >= half, negative, values)
            bits, end = round(np.log2(half)), negative[np.nanargmax(values)]
            encoding = f"sign and magnitude with the sign in bit {bits}"
            encoding = f"two's complement of {bits + 1} bits" if is_complement else encoding
            yield f"{column!r} is read as {encoding}: {largest:.0f} is {end:.0f}"


def _register(numbers: Array, *, magnitudes: bool) -> tuple[float, bool] | None:
    """Return half the range of an unsigned register and whether it is two's complement, or None.

    Without its sign, a register jumps by most of its range where the sign changes. With
    `magnitudes`, sign bits and values that are always close to 2ᵏ are recognized too.
    """
    largest = np.fmax.reduce(numbers, initial=0.0)
    if (
        largest < 2 ** _SIGN_BITS[0]
        or np.fmin.reduce(numbers) < -ROUNDING
        or not are_whole(numbers)
    ):
        return None
    values = np.rint(numbers[np.isfinite(numbers)])
    kinds = [(2.0 ** (bits - 1), True) for bits in _COMPLEMENTS]
    kinds += [(2.0**bit, False) for bit in _SIGN_BITS if magnitudes]
    for half, is_complement in kinds:
        if not half <= largest < 2.0 * half:
            continue
        above = values >= half
        if magnitudes and is_complement and values.min() >= 1.5 * half:  # always negative
            return half, True
        signed = np.where(above, values - 2.0 * half if is_complement else half - values, values)
        before, after = (np.abs(np.diff(x))[above[1:] != above[:-1]] for x in (values, signed))
        is_rare = min(np.count_nonzero(above), np.count_nonzero(~above)) < _LEAST
        if not is_rare and len(before) >= 2 and np.median(after) < _CLOSER * np.median(before):
            return half, is_complement
    return None


def _without_motors(data: dict[str, Array], columns: Columns) -> tuple[dict[str, str], list[str]]:
    """Set the efforts of joints without a motor to zero; return kinds of efforts and notes."""
    kinds, notes, effort, command = columns.kinds, [], data["effort"], data.get("command")
    says = bool(columns.having("effort", "command")) or not columns.reading.of_base
    for k, joint in enumerate(columns.joints):
        declared, motorless = kinds.get(joint) == PASSIVE, columns.reading.motorless
        if not declared and joint not in motorless:
            continue
        largest = float(np.abs(np.nan_to_num(effort[:, k])).max(initial=0.0))
        commanded = command is not None and np.isfinite(command[:, k]).any()
        if declared and largest > 0.0:
            raise LogError(
                f"Joint {joint!r} is passive, but log {columns.path.name!r} has efforts of "
                f"it of up to {largest:.4g}.",
                advice="Omit --passive; or write `effort: passive` in a mapping, which ignores "
                "that column.",
            )
        if joint in motorless and says and not (largest or commanded):
            kinds[joint] = PASSIVE
            notes.append(f"{joint} has no motor in the model and no effort in the log: passive")
        if kinds.get(joint) == PASSIVE:
            effort[:, k] = 0.0
    return kinds, notes


def _rest_position(position: Array) -> float:
    """Return the constant position of a joint without effort; NaN if it moves."""
    finite = position[np.isfinite(position)]
    if not len(finite) or finite.max() - _STILL > finite.min():
        return np.nan
    return float(finite[0] + (finite - finite[0]).mean())


def _resampled(instants: Array, time: Array, values: Array, *, holds: bool) -> Array:
    """Interpolate values (N,) or (N, n), which may be NaN in some rows, at other instants."""
    if values.ndim > 1:
        return np.stack([_resampled(instants, time, column, holds=holds) for column in values.T], 1)
    valid = np.isfinite(values) & np.isfinite(time)
    return at_instants(instants, time[valid], values[valid], holds=holds)


def _rarest_rows(time: Array, values: Mapping[str, Array]) -> NDArray[np.bool_] | None:
    """Return a mask (N,) of the rows with the rarest column; None if most rows are complete.

    Complete rows count only in long runs, which must contain half as many rows as that column.
    """
    quantities = [values[q] for q in ("position", "effort") if q in values]
    if all(np.isfinite(numbers).all() for numbers in quantities):
        return None
    present = [np.isfinite(column) for numbers in quantities for column in numbers.T]
    present = [mask for mask in present if mask.any()]
    rarest = min(present, key=np.count_nonzero, default=np.zeros(0, bool))
    if np.count_nonzero(rarest) < _ENOUGH_ROWS:
        return None
    complete = np.logical_and.reduce(present)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], complete, [False]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    has_runs = 2 * lengths[lengths >= _RUN].sum() >= np.count_nonzero(rarest)
    return None if has_runs else rarest & np.isfinite(time)
