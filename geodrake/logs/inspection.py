"""Inspection of a log: columns, rates, gaps, units, rest, and sensor faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import yaml  # type: ignore[import-untyped]

from geodrake.boundary.arguments import Array
from geodrake.errors import GeodrakeError, LogError
from geodrake.logs.files import Reading, read_log, understand
from geodrake.logs.files.column_mapping import Columns
from geodrake.logs.files.reading import MappedColumn, mapping_of, mapping_yaml
from geodrake.logs.files.units import unit_of
from geodrake.logs.log_checks import check_commands
from geodrake.logs.motion import PASSIVE, JointLog
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.sensor_faults import without_faults
from geodrake.logs.time_stamps import longest_step
from geodrake.logs.uniform_log import make_uniform
from geodrake.logs.units_of_values import effort_hint, position_unit_hint

_WINDOW, _STILL = 0.25, 2e-3  # s, and rad or m by which a joint at rest may move in them
_SHORTEST_REST = 0.5  # s
_LEAST_STEP = 1e-7  # s, to which stamps since 1970 are exact


@dataclass(frozen=True)
class UnderstoodColumn:
    """A column of a log and its source."""

    joint: str
    quantity: str
    column: str
    unit: str
    factor: float
    lowest: float
    highest: float
    empty: int


@dataclass(frozen=True, eq=False)
class LogInspection:
    """How a log was read."""

    log: JointLog  # without what its sensors did wrong
    time_column: str  # the column of time; "" where a rate says it
    # Columns of all joints and quantities, in the order of the joints.
    columns: tuple[UnderstoodColumn, ...]
    period: float  # typical time between rows, s
    jitter: float  # standard deviation of the time between rows, gaps left out, s
    gaps: tuple[tuple[float, float], ...]  # instant and length of every gap, s
    # First and last instant of stretches in which no joint moves, s.
    rests: tuple[tuple[float, float], ...]
    # Doubts and what is left out, what was noticed while reading, and what sensors did wrong.
    notes: tuple[str, ...]
    time_unit: str = ""  # unit that time was in; "" where nobody said it
    # Doubts about units, signs and order, and what of the log is of no use at the bandwidth of its
    # positions.
    first: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """From the first row to the last, s."""
        time = _known(self.log.time)
        return float(time[-1] - time[0])

    @property
    def rest(self) -> float:
        """Time at rest, s."""
        return sum(last - first for first, last in self.rests)


def inspect_log(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    partial: bool = False,
    reading: Reading | None = None,
) -> LogInspection:
    """Read a log, and inspect it without a model; see `read_log` for arguments."""
    raw, columns = understand(path, joints=joints, partial=partial, reading=reading)
    log = raw
    try:
        log = without_faults(raw)
        check_commands(log)
        silent = np.isnan(log.effort).all(axis=0)  # where commands are in the place of efforts
        told = replace(log, effort=np.where(silent, 0.0, log.effort)) if silent.any() else log
        unused = prepare_logs([make_uniform(told, faultless=True)])[0].left_out
    except LogError as error:  # as of sensors that failed for good: there is still much to show
        unused = f"cannot be used: {error}"
    steps = np.diff(_known(log.time))
    period = float(np.median(steps))
    gap = steps > longest_step(period)
    missing = [joint for joint in joints or () if joint not in (*log.joints, *log.standing)]
    notes = [f"the model's {', '.join(missing)} have no measurements"] if missing else []
    time = columns.sources.get("time")
    first = tuple(filter(None, (position_unit_hint(log), effort_hint(log), unused)))
    return LogInspection(
        log,
        time.column if time else "",
        tuple(_columns(raw, log, columns)),
        period,
        float(steps[~gap].std()) if (~gap).any() else 0.0,
        tuple((float(_known(log.time)[k]), float(steps[k])) for k in np.flatnonzero(gap).tolist()),
        tuple(_rests(log, period)),
        (*first, *log.notes, *notes),
        time.unit.name if time and time.unit else "",
        first,
    )


def mapping_text(
    path: Path,
    found: LogInspection,
    columns: Sequence[UnderstoodColumn],
    gain_deviations: Mapping[str, float] | None = None,
) -> str:
    """Return the text of a mapping that reads a log in the same way, with these columns."""
    time = MappedColumn(found.time_column, found.time_unit or None) if found.time_column else None
    rate = None if time else round(1.0 / found.period, 6)
    known, deviations = (*found.log.joints, *found.log.standing), gain_deviations or {}
    joints: dict[str, dict[str, MappedColumn | None]] = {joint: {} for joint in known}
    for each in columns:
        gain = each.factor / (unit_of(each.unit, each.quantity).factor if each.unit else 1.0)
        deviation = deviations.get(each.joint) if each.quantity == "effort" else None
        mapped = MappedColumn(each.column, each.unit or None, gain, deviation)
        joints[each.joint][each.quantity] = mapped
    for joint in found.log.passive:
        joints[joint]["effort"] = MappedColumn(PASSIVE)
    text = mapping_yaml(joints, time, rate)
    _check_said(path, found, text)
    return text


def _check_said(path: Path, found: LogInspection, text: str) -> None:
    """Raise for a mapping that would not read the log again, as when cells name joints."""
    try:
        mapping = mapping_of(path, yaml.safe_load(text))
        again = read_log(path, reading=Reading(mapping=mapping), partial=True)
        problem = "the times of its rows would change."
        is_same = len(again) == len(found.log) and np.allclose(
            np.diff(again.time), np.diff(found.log.time), atol=_LEAST_STEP
        )
    except GeodrakeError as error:
        problem, is_same = error.problem, False
    if not is_same:
        raise LogError(
            f"A mapping cannot express how log {path.name!r} was read: {problem}",
            advice="Convert it to CSV with --convert, and map that.",
        )


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]


def _columns(raw: JointLog, log: JointLog, columns: Columns) -> Iterator[UnderstoodColumn]:
    for joint, quantity in product((*log.joints, *log.standing), columns.quantities):
        source = columns.sources.get(f"{joint}.{quantity}")
        if source is None:
            continue  # commands have the place of efforts, or the other way round
        values = [
            each.alone[joint]
            if joint in each.alone
            else getattr(each, quantity)[:, each.joints.index(joint)]
            for each in (raw, log)
        ]
        measured, known = map(_known, values)
        yield UnderstoodColumn(
            joint,
            source.quantity if quantity == "effort" else quantity,
            source.column,
            source.unit.name if source.unit else "",
            source.factor,
            float(known.min()) if len(known) else np.nan,
            float(known.max()) if len(known) else np.nan,
            len(raw) - len(measured),
        )


def _rests(log: JointLog, period: float) -> Iterator[tuple[float, float]]:
    """Yield stretches in which the positions of all joints stay."""
    rows = int(np.clip(_WINDOW / period, 2, len(log))) if period > 0 else 2
    count = len(log) // rows
    blocks = log.position[: count * rows].reshape(count, rows, len(log.joints))
    with np.errstate(invalid="ignore"):
        still = np.all(blocks.max(axis=1) - blocks.min(axis=1) <= _STILL, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    for first, last in pairwise(edges.tolist()):
        if still[first]:
            start, end = log.time[first * rows], log.time[min(last * rows, len(log) - 1)]
            if end - start >= _SHORTEST_REST:
                yield float(start), float(end)
