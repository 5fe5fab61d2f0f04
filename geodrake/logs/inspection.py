"""Inspection of a log: columns, rates, gaps, units, rests, and sensor faults."""

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
from geodrake.logs.files.base_names import mapped_meaning
from geodrake.logs.files.column_mapping import Columns
from geodrake.logs.files.name_rules import Meaning
from geodrake.logs.files.reading import MappedColumn, mapping_of, mapping_yaml
from geodrake.logs.files.units import unit_of
from geodrake.logs.log_checks import check_commands, constant_efforts, constant_notes
from geodrake.logs.motion import PASSIVE, JointLog
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.sensor_faults import without_faults
from geodrake.logs.time_stamps import longest_step
from geodrake.logs.uniform_log import make_uniform
from geodrake.logs.units_of_values import effort_hint, position_unit_hint

_WINDOW, _STILL = 0.25, 2e-3  # s, and rad or m by which a joint at rest may move meanwhile
_SHORTEST_REST = 0.5  # s
_LEAST_STEP = 1e-7  # s, precision of stamps since 1970


@dataclass(frozen=True)
class UnderstoodColumn:
    """A quantity of a joint, or of a base or its feet, and its source in a log."""

    joint: str  # name of the joint; of others, such as `base.position` or `FL_foot.force`
    quantity: str  # of others, the axis or `contact`
    column: str
    unit: str
    factor: float
    lowest: float
    highest: float
    empty: int


@dataclass(frozen=True, eq=False)
class LogInspection:
    """A log and the way in which it was read."""

    log: JointLog  # without sensor faults
    time_column: str  # "" if a rate gives the time
    # In the order of the joints.
    columns: tuple[UnderstoodColumn, ...]
    period: float  # typical time between rows, s
    jitter: float  # standard deviation of the time between rows except gaps, s
    gaps: tuple[tuple[float, float], ...]  # instant and length of each gap, s
    rests: tuple[tuple[float, float], ...]  # first and last instant without motion, s
    notes: tuple[str, ...]  # `first`, notes from reading, sensor faults, and missing joints
    time_unit: str = ""  # unit of time in the file; "" if unknown
    # Doubts about units, signs and order, and data that are unusable at the positions' bandwidth.
    first: tuple[str, ...] = ()
    floating: tuple[UnderstoodColumn, ...] = ()  # of a base and its feet

    @property
    def seconds(self) -> float:
        """Time from the first row to the last, s."""
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
    """Read a log and inspect it without a model; see `read_log` for arguments."""
    raw, columns = understand(path, joints=joints, partial=partial, reading=reading)
    log = raw
    try:
        log = without_faults(raw)
        check_commands(log)
        silent = np.isnan(log.effort).all(axis=0)  # joints with commands instead
        complete = replace(log, effort=np.where(silent, 0.0, log.effort)) if silent.any() else log
        unused = prepare_logs([make_uniform(complete, faultless=True)])[0].left_out
    except LogError as error:  # the rest is still worth showing
        unused = f"cannot be used: {error}"
    steps = np.diff(_known(log.time))
    period = float(np.median(steps))
    gap = steps > longest_step(period)
    missing = [joint for joint in joints or () if joint not in (*log.joints, *log.standing)]
    notes = [f"the model's {', '.join(missing)} have no measurements"] if missing else []
    time = columns.sources.get("time")
    hints = [position_unit_hint(log), effort_hint(log), *constant_notes(constant_efforts(log))]
    hints += [*log.assumed, unused]
    first = tuple(filter(None, hints))
    return LogInspection(
        log,
        time.column if time else "",
        tuple(_columns(raw, log, columns)),
        period,
        float(steps[~gap].std()) if (~gap).any() else 0.0,
        tuple((float(_known(log.time)[k]), float(steps[k])) for k in np.flatnonzero(gap).tolist()),
        tuple(_rests(log, period)),
        tuple(dict.fromkeys((*first, *log.notes, *notes))),
        time.unit.name if time and time.unit else "",
        first,
        tuple(_floating_columns(raw, columns)),
    )


def mapping_text(
    path: Path,
    found: LogInspection,
    columns: Sequence[UnderstoodColumn],
    gain_deviations: Mapping[str, float] | None = None,
) -> str:
    """Return the text of a mapping by which these columns are read in the same way."""
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
    base = dict[str, MappedColumn]()
    for each in found.floating:
        name, unit = f"{each.joint}.{each.quantity}", each.unit or None
        gain = each.factor / mapped_meaning(name, each.column, unit, 1.0).factor
        base[name] = MappedColumn(each.column, unit, gain)
    text = mapping_yaml(joints, time, rate, base)
    _check_mapping(path, found, text)
    return text


def _check_mapping(path: Path, found: LogInspection, text: str) -> None:
    """Raise if a mapping does not reproduce the log, for example if cells contain joint names."""
    try:
        mapping = mapping_of(path, yaml.safe_load(text))
        log = read_log(path, reading=Reading(mapping=mapping), partial=True)
        problem = "the times of its rows would change."
        is_same = len(log) == len(found.log) and np.allclose(
            np.diff(log.time), np.diff(found.log.time), atol=_LEAST_STEP
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
            continue  # a joint may have only commands or only efforts
        values = [
            each.alone[joint]
            if joint in each.alone
            else getattr(each, quantity)[:, each.joints.index(joint)]
            for each in (raw, log)
        ]
        what = source.quantity if quantity == "effort" else quantity
        yield _understood((joint, what), source, *values)


def _floating_columns(log: JointLog, columns: Columns) -> Iterator[UnderstoodColumn]:
    for name, source in columns.floating.items():
        values = log.floating[name]
        what, _, axis = name.rpartition(".")
        yield _understood((what, axis), source, values, values)


def _understood(
    name: tuple[str, str], source: Meaning, raw: Array, values: Array
) -> UnderstoodColumn:
    """Return a column, given its values as measured, and without sensor faults."""
    measured, known = _known(raw), _known(values)
    return UnderstoodColumn(
        *name,
        source.column,
        source.unit.name if source.unit else "",
        source.factor,
        float(known.min()) if len(known) else np.nan,
        float(known.max()) if len(known) else np.nan,
        len(raw) - len(measured),
    )


def _rests(log: JointLog, period: float) -> Iterator[tuple[float, float]]:
    """Yield the first and last instants of stretches in which no joint moves, s."""
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
