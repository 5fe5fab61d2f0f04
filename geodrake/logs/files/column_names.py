"""The columns of a log: which of a file they come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from geodrake.errors import LogError
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.units import Unit
from geodrake.logs.motion import EFFORT_KINDS, PASSIVE, QUANTITIES

HEADER = "time,<joint>.position,<joint>.velocity,<joint>.effort"
_MOST_COLUMNS = 10_000  # ten times more than a robot of a hundred joints has
HEADER_ADVICE = f"The first line names the columns: {HEADER}; velocity may be left out."
SIGNAL_ADVICE = "In the place of efforts, <joint>.current, .voltage, .pwm or .command will do."
"""What a joint may have whose efforts are not measured."""


@dataclass(frozen=True)
class Source:
    """Where the numbers of a column of a log come from.

    Attributes:
        factor: What its numbers are multiplied by.
        unit: The unit that they are in; None for SI that nobody said.
        nanoseconds: Column of what is to be added to time, ns.
        kind: Of efforts, what they are, of `EFFORT_KINDS`.
    """

    column: str
    factor: float = 1.0
    unit: Unit | None = None
    nanoseconds: str | None = None
    kind: str = "effort"

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the file."""
        return (self.column,) if self.nanoseconds is None else (self.column, self.nanoseconds)


@dataclass(frozen=True)
class Columns:
    """What is read from a file.

    Attributes:
        joints: Names of the n joints, in the order of the log to be.
        quantities: Quantities that every joint has; and efforts and commands, which some may lack.
        notes: What was left out or converted, in words.
        sources: `time` and `<joint>.<quantity>` -> where its numbers come from; no time where a
            rate says it.
        rate: Rows a second, Hz, where there is no column of time.
        reading: How the user said that the file is to be read.
        standing: Further joints, of which there is the position alone.
        passive: Joints among them without a motor, which need no column of efforts.
        others: Joint -> further columns that could be taken for its efforts, or in their place.
        origin: Since when time is, ns since 1970, if that is known.
    """

    path: Path
    joints: tuple[str, ...]
    quantities: tuple[str, ...]
    notes: tuple[str, ...]
    sources: Mapping[str, Source]
    rate: float | None = None
    reading: Reading = field(default_factory=Reading)
    standing: tuple[str, ...] = ()
    passive: tuple[str, ...] = ()
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    origin: int | None = None

    @property
    def kinds(self) -> dict[str, str]:
        """Joint -> what is in the place of its efforts, where it has none."""
        found = {j: self.sources[f"{j}.effort"].kind for j in self.joints if self.has(j, "effort")}
        found |= dict.fromkeys(self.passive, PASSIVE)
        return {joint: kind for joint, kind in found.items() if kind != "effort"}

    def has(self, joint: str, quantity: str) -> bool:
        """Return whether there is a column of a quantity of a joint."""
        return f"{joint}.{quantity}" in self.sources

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns of the log to be, time first."""
        return (
            "time",
            *(f"{joint}.{quantity}" for quantity in self.quantities for joint in self.joints),
            *(f"{joint}.position" for joint in self.standing),
        )

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Columns of the file that are needed together, for one column of the log each."""
        return tuple(self.sources[n].columns for n in self.names if n in self.sources)

    @property
    def files(self) -> tuple[str, ...]:
        """Columns of the file that are read."""
        return tuple(dict.fromkeys(column for group in self.groups for column in group))


def check_text(path: Path, names: Sequence[str]) -> None:
    """Refuse names that no text has, and those of the format that come twice."""
    if len(names) > _MOST_COLUMNS:
        raise LogError(
            f"Log {str(path)!r} has {len(names)} columns; at most {_MOST_COLUMNS} are read.",
            advice="Is it a table with a row for each sample? Else leave columns out.",
        )
    if any("\0" in name for name in names):
        raise LogError(
            f"The first line of log {str(path)!r} has null characters: it is no text in UTF-8.",
            advice="Is it UTF-16, or binary? Save it as CSV in UTF-8, or as .npz.",
        )
    check_twice(path, names, [name for name in names if is_used(name)])


def check_twice(path: Path, names: Sequence[str], used: Collection[str]) -> None:
    """Refuse columns that are needed and there twice."""
    counts = Counter(names)
    twice = sorted(name for name in set(used) if counts[name] > 1)
    if twice:
        raise LogError(
            f"Log {str(path)!r} has these columns more than once: {', '.join(twice)}.",
            advice="Remove or rename one of each.",
            columns=twice,
        )


def check_once(path: Path, names: Sequence[str]) -> None:
    """Refuse columns that are there twice, where only their names tell them apart."""
    check_twice(path, names, names)


def is_used(name: str) -> bool:
    """Return whether a column is one of the format's."""
    words = (*QUANTITIES, *EFFORT_KINDS)
    return name == "time" or ("." in name and name.rsplit(".", 1)[1] in words)


def listed(names: Sequence[str]) -> str:
    """Return the first few names."""
    return f"{', '.join(names[:8]) or 'none'}{' …' if len(names) > 8 else ''}"
