"""How the user says that a log is to be read, where its file does not say it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from geodrake.boundary.arguments import instance, instances, integer
from geodrake.errors import ArgumentError
from geodrake.logs.files.units import unit_of


@dataclass(frozen=True)
class MappedColumn:
    """A column of a mapping.

    Attributes:
        column: Name of the column in the file, or its number, from 1 on.
        unit: Its unit; None if its name says it, or it is SI.
        gain: What its numbers are multiplied by, beside the unit.
    """

    column: str | int
    unit: str | None = None
    gain: float = 1.0


@dataclass(frozen=True)
class ColumnMapping:
    """Which column of a file is which quantity of which joint.

    Attributes:
        joints: Joint -> quantity -> column.
        time: The column of the time; None where a rate says it.
        rate: Rows a second, where there is no time.
        source: What messages call the mapping.
    """

    joints: Mapping[str, Mapping[str, MappedColumn]]
    time: MappedColumn | None = None
    rate: float | None = None
    source: str = "the mapping"

    def __iter__(self) -> Iterator[tuple[str, MappedColumn]]:
        """Every column, by `time` or `<joint>.<quantity>`."""
        if self.time is not None:
            yield "time", self.time
        for joint, quantities in self.joints.items():
            for quantity, column in quantities.items():
                yield f"{joint}.{quantity}", column


@dataclass(frozen=True)
class Reading:
    """How a log is to be read; what is not given is found out from the names of the columns.

    Attributes:
        mapping: Which column is what.
        columns: Names of the columns of files without a header, in their order.
        rate: Rows a second, for logs without a column of time, Hz.
        units: Quantity (time, position, velocity, acceleration or effort) -> its unit.
        gains: Joint -> what its efforts are multiplied by, such as current · constant · ratio.
        skip_bad_rows: Leave out rows that no recorder meant, if they are at most 1 %.
        topic: Topic of a bag or channel of an LCM log; None for the only one that fits.
        episode: Episode of a dataset; None for all of them, one after the other.

    Raises:
        ArgumentError: A rate or gain is no such number, or a unit is not known.
    """

    mapping: ColumnMapping | None = None
    columns: tuple[str, ...] = ()
    rate: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    skip_bad_rows: bool = False
    topic: str | None = None
    episode: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", instances(self.columns, "columns", str))
        instance(self.units, "units", Mapping)
        instance(self.gains, "gains", Mapping)
        check_rate(self.rate, "A log's rate")
        if self.topic is not None:
            instance(self.topic, "topic", str)
        if self.episode is not None:
            integer(self.episode, "episode", lower=0)
        for quantity, unit in self.units.items():
            unit_of(unit, quantity)
        for joint, gain in self.gains.items():
            check_gain(gain, f"the gain of {joint}")


def check_rate(rate: object, what: str) -> None:
    """Raise an ArgumentError unless a rate is none, or a positive number.

    Args:
        rate: What was given, Hz.
        what: What messages call it.
    """
    if rate is not None and not (_is_number(rate) and rate > 0):  # type: ignore[operator]
        raise ArgumentError(f"{what} is a positive number of rows a second; got {rate!r}.")


def check_gain(gain: object, what: str) -> None:
    """Raise an ArgumentError unless a gain is a number other than 0.

    Args:
        gain: What was given.
        what: What messages call it.
    """
    if not _is_number(gain) or gain == 0:
        raise ArgumentError(f"{what} must be a number other than 0; got {gain!r}.")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
