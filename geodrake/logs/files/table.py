"""Columns of a log file under their original names, before they are assigned to joints.

The reader of each format converts its arrays, which may be nested, nullable or dates, to a
`LogTable`. A few corrupt rows can be skipped.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.boundary.memory import machine_memory
from geodrake.errors import GeodrakeError, LogError
from geodrake.logs.files.name_rules import is_time, meaning_of
from geodrake.logs.files.packed_files import log_name
from geodrake.logs.files.units import WORDS
from geodrake.logs.time_stamps import check_time


@contextmanager
def readable(path: Path, what: str, advice: str = "Write it again, or as CSV.") -> Iterator[None]:
    """Convert any exception while reading a file to a LogError."""
    try:
        yield
    except (GeodrakeError, MemoryError):
        raise
    except Exception as error:  # decompressors and parsers raise many types
        words = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise LogError(
            f"Log {str(path)!r} is not a readable {what}: {words}.", advice=advice
        ) from error


_LARGEST_SHARE = 0.5  # of the memory for the numbers of a log; analysis needs the rest


def check_room(path: Path, count: int, words: str) -> None:
    """Raise if `count` numbers and the data derived from them would exceed the memory."""
    needed, available = 8 * count, machine_memory()
    if needed > _LARGEST_SHARE * available:
        raise LogError(
            f"Log {str(path)!r} has {words}, which need {needed / 1e9:.3g} GB; this machine "
            f"has {available / 1e9:.3g} GB of memory.",
            advice="Use excerpts of it, or fewer columns.",
        )


DATE = re.compile(
    r"""(?: (?P<year>\d{4}) (?P<dash>[-/]?) (?P<month>\d\d) (?P=dash) (?P<day>\d\d) [Tt _-]
          | (?P<first>\d\d?) (?P<mark>[./-]) (?P<second>\d\d?) (?P=mark) (?P<last>\d\d(\d\d)?) [Tt ]
          | (?P<on>\d\d?) [ -] (?P<named>[A-Za-z]{3}) [ -] (?P<in>\d{4}) [ ]
          | (?: (?P<days>\d{1,9}) [ ] days? [ ] )? (?= \d\d?:\d\d:\d\d ) )
        (?P<time> \d\d? : \d\d (?: : \d\d )? | (?<=[Tt_-]) \d\d -? \d\d -? \d\d )
        (?: (?: [.,;] | (?<=:\d\d:\d\d) : (?=\d{3}\b) ) (?P<part>\d{1,9}) \d* )?
        (?: \s* (?P<half> [AaPp][Mm] ) \b )?
        (?: \s* (?: [Zz] | UTC | (?P<sign>[+-]) (?P<hours>\d\d) :? (?P<minutes>\d\d)? ) )?""",
    re.VERBOSE,
)
_NAMED_FIRST = re.compile(  # May 1, 2026 12:00:00; and Fri May 1 12:00:00 2026
    r"(?:[A-Za-z]{3,9},? )?([A-Za-z]{3})[a-z]*\.? +(\d\d?),? (?:(\d{4}) (\S.*)|(\S+) (\d{4}))"
)
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_LAST_MONTH = _NOON = 12
_SECONDS = re.compile(r"(\d+)(?:[.,](\d{1,9})\d*)? ?s(?:ec)?")  # as MATLAB writes durations
_MINUTES = re.compile(r"(\d{1,3}):([0-5]\d)[.,](\d{1,9})\d*")  # minutes and seconds from Excel
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_SECOND, _DAY = 1_000_000_000, 86_400  # ns, s


def date_of(text: str, *, day_first: bool = False) -> int | None:
    """Return a date with time of day in nanoseconds since 1970; None if the text is not one.

    Formats are ISO 8601 and its variants, day.month.year, day month-name year, and month/day/year
    (`day_first`: day/month/year). Dates without a time zone are in UTC. A time of day, days with
    a time, and seconds with their unit count from 1970.
    """
    if (match := _SECONDS.fullmatch(text.strip())) is not None:
        return int(match[1]) * _SECOND + int((match[2] or "").ljust(9, "0"))
    if (match := _MINUTES.fullmatch(text.strip())) is not None:
        return (60 * int(match[1]) + int(match[2])) * _SECOND + int(match[3].ljust(9, "0"))
    text = text.strip()
    if "年" in text:
        text = re.sub("[年月]", "-", text).replace("日", "")
    if not text[:1].isdecimal() and (parts := _NAMED_FIRST.fullmatch(text)):
        text = f"{parts[2]} {parts[1]} {parts[3] or parts[6]} {parts[4] or parts[5]}"
    if (match := DATE.fullmatch(text)) is None:
        return None
    date = match.group("year", "month", "day")
    if match["named"]:
        named = match["named"].lower()
        date = match["in"], 1 + _MONTHS.index(named) if named in _MONTHS else 0, match["on"]
    if match["last"]:
        in_order = match["mark"] != "." and not day_first
        date = match.group("last", *(("first", "second") if in_order else ("second", "first")))
    hour, minute, second = map(int, [*re.findall(r"\d\d?", match["time"]), 0][:3])
    if match["half"]:
        if not 0 < hour <= _NOON:
            return None
        hour = hour % _NOON + _NOON * (match["half"].upper() == "PM")
    try:
        since = timedelta(int(match["days"] or 0), second, minutes=minute, hours=hour)
        if date[0]:
            year, month, day = map(int, date)
            year += 2000 * (len(date[0]) == 2)
            since = datetime(year, month, day, hour, minute, second, tzinfo=UTC) - _EPOCH
    except ValueError:  # the 30th of February
        return None
    offset = timedelta(hours=int(match["hours"] or 0), minutes=int(match["minutes"] or 0))
    since -= -offset if match["sign"] == "-" else offset
    return (since.days * _DAY + since.seconds) * _SECOND + int((match["part"] or "").ljust(9, "0"))


def is_date(text: str) -> bool:
    """Return whether a text is a date with time of day, in either order of day and month."""
    return any(date_of(text, day_first=first) is not None for first in (False, True))


def order_of_days(texts: Iterable[str]) -> tuple[bool, str]:
    """Return whether days precede months in dates with slashes or dashes, and a note.

    A number above 12 decides, otherwise the order that gives the shorter total time span.
    """
    dates = [date for text in texts if (date := DATE.fullmatch(text.strip()))]
    dates = [date for date in dates if date["mark"] in ("/", "-")]
    if not dates:
        return False, ""
    days = list(dict.fromkeys(date.group("first", "second", "last") for date in dates))
    first, second, years = np.array(days, int).T
    spans = [
        np.ptp(372 * years + 31 * months + days)
        for months, days in ((first, second), (second, first))
    ]
    invalid_months = [numbers > _LAST_MONTH for numbers in (first, second)]
    examples = [dates[0]["mark"].join(day) for day in days]
    if invalid_months[0].any() or invalid_months[1].any():
        day_first = bool(invalid_months[0].any())
        why = f", by {examples[int(invalid_months[0 if day_first else 1].argmax())]}"
    else:
        day_first = bool(spans[1] < spans[0])
        why = ", in which rows are closer in time"
        if spans[0] == spans[1]:
            why = ", though both are possible: if this is wrong, write them as 2026-05-01"
    order = "day/month" if day_first else "month/day"
    return day_first, f"dates such as {examples[0]} are read as {order}/year{why}"


def date_words(nanoseconds: int) -> str:
    """Format a date, or a time of day within the first day of 1970, for messages."""
    instant = _EPOCH + timedelta(microseconds=nanoseconds // 1000)
    if nanoseconds < _DAY * _SECOND:
        return f"{instant:%H:%M:%S} of a day"
    return f"{instant:%Y-%m-%d %H:%M:%S} UTC"


Mask = NDArray[np.bool_]
Texts = NDArray[np.object_]

MOST = 0.01
"""Largest fraction of rows that may be skipped."""

_NAMED = 8  # most runs of rows listed in a message
_MOST_TORN = 100_000  # corrupt rows after which reading stops
_AT_END = 3  # most corrupt rows at the end that are always skipped
ADVICE = f"--skip-bad-rows skips such rows, up to {100 * MOST:g} % of a log."


@dataclass
class TornRows:
    """Corrupt rows found while reading a file."""

    path: Path
    skip: bool = False
    rows: list[int] = field(default_factory=list)
    first: LogError | None = None

    def add(self, row: int, error: LogError) -> None:
        """Record a corrupt row."""
        self.first = self.first or error
        self.rows.append(row)
        if len(self.rows) > _MOST_TORN:
            raise self._refusal(self.rows, row + 1)

    def settle(self, time: Array) -> tuple[Mask, tuple[str, ...]]:
        """Return a mask (N,) of the rows to keep and a note, given time stamps (N,)."""
        backwards, kept = rows_out_of_order(time), np.ones(len(time), bool)
        bad = np.union1d(self.rows, backwards).astype(int).tolist()
        if not bad:
            return kept, ()
        count = min(len(self.rows), _AT_END)  # a truncated row, or a few words
        cut = self.rows == [*range(len(time) - count, len(time))]
        few = len(bad) <= MOST * len(time) + cut * count
        if few and (self.skip or (cut and not len(backwards))):
            kept[bad] = False
            return kept, (f"{len(bad)} of {len(time)} rows are corrupt and skipped: {_runs(bad)}",)
        if self.first is None or cut:
            try:
                check_time(log_name(self.path), time)
            except LogError as error:
                self.first = error
        raise self._refusal(bad, len(time))

    def _refusal(self, rows: Sequence[int], count: int) -> LogError:
        """Return the first error, extended by the numbers of all corrupt rows."""
        first = self.first or LogError(f"Log {str(self.path)!r} has corrupt rows.")
        advice, few = first.advice, len(rows) <= MOST * count
        if len(rows) > 1 and (few or self.rows):
            advice += f" Corrupt rows are {_runs(rows)}: {len(rows)} of {count}."
        if few:
            advice += f" {ADVICE}"
        elif self.skip:
            advice += f" At most {100 * MOST:g} % are skipped."
        return LogError(first.problem, advice=advice)


def rows_out_of_order(time: Array) -> NDArray[np.intp]:
    """Return the fewest rows to remove so that time stamps (N,), ignoring NaN, increase."""
    rows = np.flatnonzero(np.isfinite(time))
    stamps = time[rows]
    if np.all(np.diff(stamps) > 0):
        return np.zeros(0, int)
    smallest: list[float] = []  # least last stamp of a subsequence of each length
    ends: list[int] = []
    previous = np.full(len(stamps), -1)
    for k, stamp in enumerate(stamps.tolist()):
        length = bisect_left(smallest, stamp)
        if length == len(smallest):
            smallest.append(stamp)
            ends.append(k)
        else:
            smallest[length], ends[length] = stamp, k
        previous[k] = ends[length - 1] if length else -1
    kept, k = np.zeros(len(stamps), bool), ends[-1]
    while k >= 0:
        kept[k] = True
        k = int(previous[k])
    return rows[~kept]


def _runs(rows: Sequence[int]) -> str:
    """Format rows, counted from 0, as runs of row numbers from 1."""
    edges = [k for k, (row, following) in enumerate(pairwise(rows), 1) if following > row + 1]
    runs = [rows[i:j] for i, j in pairwise([0, *edges, len(rows)])]
    words = [
        f"{run[0] + 1}" if len(run) == 1 else f"{run[0] + 1} to {run[-1] + 1}"
        for run in runs[:_NAMED]
    ]
    return ", ".join(words) + (" …" if len(runs) > _NAMED else "")


@dataclass(eq=False)
class LogTable:
    """Columns of numbers from a file of any format, not yet assigned to joints and quantities."""

    path: Path
    # Name in the file -> numbers (N,), NaN if missing. Formats with their own time stamps add
    # `time`, in s from the first sample.
    columns: Mapping[str, Array]
    # Column -> unit, where the file states it.
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # remarks for the user
    # Columns already converted to seconds -> date of their zero, ns since 1970, or None.
    origins: Mapping[str, int | None] = field(default_factory=dict)
    # Column that was left out -> reason, in words.
    silent: Mapping[str, str] = field(default_factory=dict)
    # Column without numbers -> texts (N,).
    words: Mapping[str, Texts] = field(default_factory=dict)
    # Cells of the first row of a file without column names, where names are numbers from 1.
    unnamed: tuple[str, ...] = ()
    order: Sequence[str] = ()  # all names, for numbers in mappings, if columns were left out
    # Sampling rate (Hz) and its name in the file, such as `dt`; used if there is no time.
    rate: tuple[float, str] | None = None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.columns.values()), ()))

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns."""
        return list(self.columns)

    @property
    def counted(self) -> Sequence[str]:
        """Names to which the column numbers in mappings refer, counted from 1."""
        return self.order or self.names

    @property
    def first_words(self) -> dict[str, str]:
        """Column without numbers -> its first text."""
        return {name: str(cells[0]) for name, cells in self.words.items() if len(cells)}

    def is_time(self, name: str) -> bool:
        """Return whether a column is time, by its name or as the only column of dates."""
        if name not in self.origins:
            return is_time(name)
        return is_time(name) or not (len(self.origins) > 1 or any(map(is_time, self.names)))

    def has_numbers(self, name: str) -> bool:
        """Return whether a column contains a finite number."""
        return bool(np.isfinite(self.columns[name]).any())

    def read(
        self, names: Sequence[str], *, skip: bool = False
    ) -> tuple[dict[str, Array], TornRows]:
        """Return some columns (N,), with NaN in unreadable rows, and these rows."""
        found = {name: self.columns[name] for name in dict.fromkeys(names)}
        return found, TornRows(self.path, skip)

    def loaded(self, *, skip: bool = False) -> LogTable:
        """Return the table with all its columns read."""
        return replace(self, columns=dict(self.columns))

    def renamed(self, names: Mapping[str, str]) -> LogTable:
        """Return the table with some columns renamed."""
        columns = {names.get(name, name): each for name, each in self.columns.items()}
        units = {names.get(name, name): unit for name, unit in self.units.items()}
        origins = {names.get(name, name): origin for name, origin in self.origins.items()}
        return replace(self, columns=columns, units=units, origins=origins)

    def under(self, head: str) -> LogTable:
        """Return the table with a prefix before all names other than time."""
        return self.renamed({n: f"{head}{n}" for n in self.columns if not self.is_time(n)})

    def noting(self, *notes: str) -> LogTable:
        """Return the table with notes prepended."""
        noted = copy(self)
        noted.notes = (*notes, *self.notes)
        return noted


def numbered(cells: Sequence[str]) -> list[str]:
    """Return the numbers of columns, from 1, as their names."""
    return [str(k) for k in range(1, len(cells) + 1)]


_NUMBERS_OR_NONE = frozenset([int, float, type(None)])
_ONE_SECOND = np.timedelta64(1, "s")
_MOST_NAMES = 8
_MOST_NAMED = 1000  # columns of a matrix
_LONGEST_TEXT = 60
_SAYS_NOTHING, *_ALSO = WORDS["nothing"]
NOTHING = frozenset(f(w) for w in _SAYS_NOTHING for f in (str, str.upper, str.title)).union(*_ALSO)
"""Cells that mean a missing value."""

LIST = re.compile(r"(?:(?:array|tensor)\()?[\[({]([^\[\](){}]*)[\])}](?:, dtype=[\w.]+)?\)?")
_BARE = re.compile(r"([^\s;]*\d\.[^\s;]*(?:(?:; ?| )[^\s;]*\d\.[^\s;]*)+)")  # no brackets
_SCALAR = re.compile(r"np\.\w+\(([^()]*)\)")  # NumPy scalars in a list
_NO_AXIS = re.compile(r"9[Ee]\+?0?9")
_FORTRAN = re.compile(r"(?<=\d)[Dd](?=[+-]\d)")  # in 1.5D+00
_BETWEEN = re.compile(r"\s*[,;]\s*|\s+")
_NUMBERS = msgspec.json.Decoder(list[float])


@dataclass(frozen=True)
class Cells:
    """Type of the cells of a column: numbers, lists of numbers, or dates."""

    count: int | None = None  # length of each list
    origin: int | None = None  # first date, ns since 1970
    day_first: bool = False  # whether days precede months in dates with slashes

    @classmethod
    def of(cls, first: Any, *, day_first: bool = False) -> Cells | None:
        """Return the type of a column from its first nonempty cell; None for words."""
        if (items := _list_in(first)) is not None:
            return cls(len(items))
        for order in (day_first, not day_first):
            if (date := date_of(_date_text(first), day_first=order)) is not None:
                return cls(None, date, order)
        return None if number_in(first) is None else cls()

    def numbers(self, cell: Any) -> list[float] | None:
        """Return the numbers in a cell, or None. Dates become seconds since the first one."""
        found: list[float] | None = None
        if self.count is not None:
            items = _list_in(cell) or []
            found = items if len(items) == self.count else None
        elif self.origin is not None:
            date = date_of(_date_text(cell), day_first=self.day_first)
            found = None if date is None else [(date - self.origin) / _SECOND]
        elif (number := number_in(cell)) is not None:
            found = [number]
        return [np.nan] * (self.count or 1) if found is None and is_nothing(cell) else found


def is_nothing(cell: Any) -> bool:
    """Return whether a cell is a missing value, such as an empty list."""
    if isinstance(cell, Sized) and not isinstance(cell, str):
        return not len(cell)
    return str(cell).strip() in NOTHING


def _list_in(cell: Any) -> list[float] | None:
    """Return the numbers of a list or of a text such as `[0.1, 0.2]`; None otherwise."""
    if isinstance(cell, str):
        try:
            return _NUMBERS.decode(cell)  # fast path: most lists are JSON
        except msgspec.DecodeError:
            cell = _SCALAR.sub(r"\1", cell.strip())
            if cell.startswith("[["):  # RAPID marks missing axes by 9E+09
                items = (
                    x for x in re.split(r"[\[\],\s]+", cell) if x and not _NO_AXIS.fullmatch(x)
                )
                cell = f"[{','.join(items)}]"
            match = LIST.fullmatch(cell) or _BARE.fullmatch(cell)
            cell = _BETWEEN.split(match[1].strip()) if match else None
    if not isinstance(cell, Sized):
        return None
    try:
        return [np.nan if item is None else float(item) for item in cell]  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        return None


def _date_text(value: Any) -> str:
    """Return the text of a date or date object; "" for anything else."""
    text = value.isoformat() if isinstance(value, datetime) else value
    return text if isinstance(text, str) else ""


def number_in(value: Any) -> float | None:
    """Return the number in a text or an object; None otherwise."""
    is_text = isinstance(value, str)
    if is_text and "_" in value:  # `float` accepts 1_000
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        usual = _FORTRAN.sub("E", value) if is_text else value
        return None if usual is value or usual == value else number_in(usual)


def numeric_table(path: Path, arrays: Mapping[str, Any], rows: int) -> LogTable:
    """Return a table of numeric arrays; matrices become columns `name[0]`, `name[1]` and so on.

    Arrays, or what converts to them, are (N,) or (N, n). Dates become seconds from the first row.
    Notes list the arrays left out. A scalar may be the sampling period or rate.
    """
    columns, notes = dict[str, Array](), dict[str, None]()
    origins, silent, words = {}, {}, dict[str, Texts]()
    rates = {name: rate for name, x in arrays.items() if (rate := rate_in(name, x)) is not None}
    headers = {len(names): names for x in arrays.values() if (names := _columns_in(x))}
    for name, array in arrays.items():
        if name in rates:
            continue
        values = array_of(array) if isinstance(array, list) else array
        matrix, origin, note = numbers(values)
        if matrix is not None and matrix.ndim == 2 and matrix.shape[0] != rows == matrix.shape[1]:
            matrix = matrix.T
        if matrix is not None and matrix.ndim in (1, 2) and 1 < len(matrix) == rows - 1:
            matrix = np.concatenate(
                [matrix, np.full_like(matrix[:1], np.nan)]
            )  # inputs are one row shorter than states
        if matrix is None or matrix.ndim not in (1, 2) or len(matrix) != rows:
            silent[name] = _what_else(values, rows)
            words |= _texts(name, values, rows)
            continue
        header = headers.get(matrix.shape[-1]) if matrix.ndim > 1 else None
        columns.update(zip(header, matrix.T, strict=True) if header else spread(name, matrix))
        if origin is not None:
            origins[name] = origin
        notes |= {note: None} if note else {}
    unused = [n for n in silent if n not in words and not _is_alone(arrays[n])]
    remarks = (*notes, *(f"{n!r} is not used: it {silent[n]}" for n in unused[:_MOST_NAMES]))
    stated = next(((rate, name) for name, rate in rates.items()), None)
    return LogTable(path, columns, {}, remarks, origins, silent, words, rate=stated)


_HIGHEST_RATE = 1e5


def rate_in(name: str, value: Any) -> float | None:
    """Return the sampling rate if a scalar is named as a rate or period; None otherwise."""
    word = re.sub(r"[^a-z]", "", re.split(r"[./]", name.lower())[-1])
    is_rate = not {word, word.removesuffix("hz")}.isdisjoint(WORDS["rates"].split())
    if not _is_alone(value) or not (is_rate or word in WORDS["periods"].split()):
        return None
    number = number_in(value) or np.nan
    rate = number if is_rate else 1.0 / number
    return rate if 1.0 <= rate <= _HIGHEST_RATE else None


def _columns_in(values: Any) -> list[str]:
    """Return an array of texts as column names of a matrix; an empty list otherwise."""
    is_list = isinstance(values, list) or getattr(values, "ndim", 0) == 1
    cells = [*values] if is_list and 1 < len(values) < _MOST_NAMED else []
    cells = [x.decode(errors="replace") if isinstance(x, bytes) else x for x in cells]
    return cells if all(isinstance(x, str) and meaning_of(x) for x in cells) else []


def _texts(name: str, values: Any, rows: int) -> dict[str, Texts]:
    """Return the texts or lists of texts (N,) in an array, by its name.

    A single list of distinct names, such as joint names, applies to every row.
    """
    cells = [] if _is_alone(values) else [_text(value) for value in values]
    names = {cell for cell in cells if isinstance(cell, str)}
    if len(names) == len(cells) != rows and cells:
        cells = [cells] * rows  # type: ignore[list-item]
    texts = np.empty(len(cells), object)
    texts[:] = cells
    return {name: texts} if len(cells) == rows > 0 and None not in cells else {}


def _text(value: Any) -> str | list[str] | None:
    """Return a text, or the texts of a list; None otherwise."""
    if isinstance(value, bytes | str):
        return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
    if not isinstance(value, Sized):
        return None
    items = [_text(each) for each in value]  # type: ignore[attr-defined]
    return items if all(isinstance(item, str) for item in items) else None  # type: ignore[return-value]


def _is_alone(value: Any) -> bool:
    return np.isscalar(value) or getattr(value, "shape", None) == ()


def are_lists(values: Any) -> bool:
    """Return whether the values are a list that begins with a list."""
    return isinstance(values, list) and isinstance(next(iter(values), None), list)


def rows_of(arrays: Mapping[str, Any]) -> int:
    """Return the number of rows of a log: the length of its time, or of most arrays."""
    longer = {name: values for name, values in arrays.items() if not _is_alone(values)}
    timed = {n: x for n, x in longer.items() if is_time(n) and max(np.shape(x)) == np.size(x)}
    lengths = [max(map(len, (x, *x[:1]))) if are_lists(x) else max(getattr(x, "shape", (len(x),)))
               for x in (timed or longer).values()]  # fmt: skip
    return max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)


def _what_else(values: Any, rows: int) -> str:
    """Describe, for a message, why an array was left out."""
    if np.ndim(values) == 0:
        return f"has only one value, {str(values)[:_LONGEST_TEXT]!r}"
    if np.ndim(values) > 2 or len(values) != rows:
        mismatch = f"has {len(values)} rows, but others have {rows}"
        shape = f"has the shape {np.shape(values)} instead of a row for each sample"
        return shape if np.ndim(values) > 2 else mismatch
    text = next(
        (x for x in values if isinstance(x, str) and not is_nothing(x) and number_in(x) is None), ""
    )
    cells = [x for x in values if isinstance(x, Sized | int | float) and not isinstance(x, str)]
    lengths = [len(x) if isinstance(x, Sized) else 1 for x in cells]
    if len({*lengths} - {0}) > 1:
        usual = max({*lengths}, key=lengths.count)
        row, length = next((k, n) for k, n in enumerate(lengths, 1) if n not in (0, usual))
        return f"has lists of {usual} numbers, but one of {length} in row {row}"
    if text:
        return f"has {text[:_LONGEST_TEXT]!r}, which is neither a number nor a date"
    kind = getattr(values, "dtype", np.dtype(object))
    return "has no numbers" if kind.hasobject else f"has {kind}, not real numbers"


def spread(name: str, values: Array) -> Iterator[tuple[str, Array]]:
    """Yield the columns of an array (N,) or (N, n)."""
    if values.ndim == 1:
        yield name, values
    elif values.shape[1] == 1:
        yield name, values[:, 0]
    else:
        yield from ((f"{name}[{k}]", column) for k, column in enumerate(values.T))


def numbers(values: Any) -> tuple[Array | None, int | None, str]:
    """Convert an array to floats with NaN for missing values, or to None if not numeric.

    Dates become seconds from the first one. Also returns the first date (ns since 1970), and a
    note on the order of day and month if it is ambiguous.
    """
    if isinstance(values, np.ma.MaskedArray):
        missing, values = np.ma.getmaskarray(values), np.array(values.data, object)
        values[missing] = None
    try:
        array = array_of(values)
        if array.dtype.kind == "M":
            stamps = array.astype("datetime64[ns]").astype(np.int64)
            known = stamps != np.iinfo(np.int64).min
            origin = int(stamps[known][0]) if known.any() else 0
            return np.where(known, (stamps - origin) / _SECOND, np.nan), origin, ""
        if array.dtype.kind == "m":
            return np.asarray(array / _ONE_SECOND), None, ""
        if array.dtype.kind in "OUT":
            return _of_objects(array.astype(object))
    except (TypeError, ValueError, ArithmeticError):  # texts, rows of different lengths, 10**400
        return None, None, ""
    return (np.asarray(array, float) if array.dtype.kind in "fiub" else None), None, ""


def array_of(values: Any) -> NDArray[Any]:
    """Return an array; an object array for lists of different lengths or with None."""
    try:
        return np.asarray(values)
    except ValueError:
        array = np.empty(len(values), object)
        array[:] = values
        return array


def _of_objects(array: NDArray[Any]) -> tuple[Array | None, int | None, str]:
    """Convert an array of lists, numbers, dates or None; see `numbers`."""
    if {*map(type, array.flat)} <= _NUMBERS_OR_NONE:
        return array.astype(float), None, ""
    first = next((value for value in array.flat if not is_nothing(value)), np.nan)
    dates = array.flat if is_date(_date_text(first)) else ()
    day_first, note = order_of_days(map(_date_text, dates))
    kind = Cells.of(first, day_first=day_first)
    rows = [None if kind is None else kind.numbers(value) for value in array.flat]
    if kind is None or None in rows or not rows:
        return None, None, ""
    matrix = np.array(rows).reshape(*array.shape, -1)
    return matrix if kind.count else matrix[..., 0], kind.origin, note
