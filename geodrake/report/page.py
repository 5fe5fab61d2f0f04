"""The content of a result, for terminals, HTML pages and notebooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from geodrake.report.charts import Bars, Chart
from geodrake.report.json_output import record
from geodrake.report.numbers import Units, number

if TYPE_CHECKING:
    from geodrake.identification.logs.model_errors import Comparison

Records = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Cell:
    """An entry of a table."""

    text: str  # one or several lines
    note: str = ""  # small text below, on HTML pages
    bar: float | None = None  # length in [0, 1] of a bar beside the text, on HTML pages
    typed: str = ""  # name or shorter text, which terminals and notebooks show instead


@dataclass(frozen=True)
class Table:
    """A table of words and numbers."""

    head: tuple[str, ...]
    rows: Sequence[tuple[Cell, ...]]  # each as long as the head
    words: int = 1  # number of text columns, which precede those of numbers
    title: str = ""
    total: int = 0  # number of total rows at the end
    detailed: bool = False  # whether only HTML pages show it
    deep: tuple[str, ...] = ()  # columns that terminals show only with details

    @property
    def in_short(self) -> Table:
        """Return the table without its deep columns."""
        return self.columns([k for k, name in enumerate(self.head) if name not in self.deep])

    @property
    def deep_columns(self) -> tuple[str, ...]:
        """Return the columns of `deep` that the table has."""
        return tuple(name for name in self.head if name in self.deep)

    def columns(self, kept: Sequence[int], *, filled: bool = False) -> Table:
        """Return the table with some columns; if `filled`, without rows that have no numbers."""
        rows = [tuple(row[k] for k in kept) for row in self.rows]
        if filled:
            rows = [row for row in rows if any(cell.text for cell in row[self.words :])]
        total = self.total if len(rows) == len(self.rows) else 0
        return replace(self, head=tuple(self.head[k] for k in kept), rows=rows, total=total)


def cells(*entries: Cell | str | float | None) -> tuple[Cell, ...]:
    """Return a row of a table: numbers with three digits, empty cells for None."""
    return tuple(each if isinstance(each, Cell) else Cell(_text(each)) for each in entries)


def _text(entry: str | float | None) -> str:
    if entry is None:
        return ""
    if isinstance(entry, str | int):
        return str(entry)
    return number(entry)


@dataclass(frozen=True)
class Section:
    """A part of a page under a heading."""

    title: str
    text: str = ""  # a description of the content
    more: str = ""  # paragraphs on how to read it, folded on HTML pages
    bars: tuple[Bars, ...] = ()
    tables: tuple[Table, ...] = ()
    items: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()  # commands to copy
    charts: tuple[Chart, ...] = ()
    detailed: bool = False  # whether only HTML pages show it
    deep: bool = False  # whether terminals show it only with details

    @property
    def shown_tables(self) -> tuple[Table, ...]:
        """Return the tables that have rows."""
        return tuple(table for table in self.tables if table.rows)

    @property
    def says_something(self) -> bool:
        """Return whether there is any content besides the title and texts."""
        parts = (self.bars, self.shown_tables, self.items, self.commands, self.charts)
        return any(parts)


@dataclass(frozen=True)
class Tile:
    """A number at the top of a page; `words` if the value is a name, which may be long."""

    label: str
    value: str
    note: str = ""
    words: bool = False


@dataclass(frozen=True)
class Pictures:
    """Pictures of a robot whose links are coloured by errors."""

    shown: Mapping[str, bytes]  # title -> PNG with a transparent background
    colors: tuple[str, ...]  # colours from no error to the largest
    top: str  # label of the largest error
    text: str
    notes: tuple[str, ...] = ()  # how the picture differs from the model file


@dataclass(frozen=True)
class About:
    """Names of the inputs of a result.

    Attributes:
        model: Name of the model.
        logs: Names of the logs.
        command: Name of the command, for the title.
        units: Units of the model's joints and effects.
        saved: Path of the saved model, for commands that follow.
        links: Title -> address of further pages, such as a replay.
    """

    model: str = "the model"
    logs: tuple[str, ...] = ()
    command: str = "report"
    units: Units = field(default_factory=Units)
    saved: str = "MODEL"
    links: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Page:
    """The content of a result.

    Attributes:
        headline: The answer, in a short sentence.
        verdict: "adequate", "explained", "unexplained" or "undecided", which set the colour, or
            another word if there is no verdict.
        of: The subject, if it is not the model and the logs.
        facts: Label -> a short fact, or "".
        tiles: Numbers at the top of the page.
        first: Sections to check first: mistakes in columns, and omitted data.
        compared: Title -> comparison whose errors colour a picture of the robot.
        pictures: These pictures, for HTML pages.
    """

    about: About
    headline: str
    sections: tuple[Section, ...]
    verdict: str = "compared"
    of: str | None = None
    facts: Mapping[str, str] = field(default_factory=dict)
    tiles: tuple[Tile, ...] = ()
    footer: str = ""
    first: tuple[Section, ...] = ()
    compared: Mapping[str, Comparison] = field(default_factory=dict)
    pictures: Pictures | None = None

    @property
    def subject(self) -> str:
        """Return the subject of the page."""
        subject = f"{self.about.model} against {', '.join(self.about.logs)}"
        return subject if self.of is None else self.of

    @property
    def shown_sections(self) -> tuple[Section, ...]:
        """Return the sections that have content."""
        return tuple(section for section in self.sections if section.says_something)

    @property
    def answer(self) -> dict[str, str]:
        """Return the headline and the facts by their labels, without empty ones."""
        answer = {"Verdict": self.headline, **self.facts}
        return {label: text for label, text in answer.items() if text}


@dataclass(frozen=True)
class View:
    """Functions that show one type of result."""

    page: Callable[[Any, About], Page]
    kind: str  # type of its JSON object, as in `schema.yaml`
    # Values of JSON keys that are no attributes of the result.
    given: Callable[[Any], Mapping[str, Any]] = lambda found: {}
    records: Any = None  # function to rows of numbers, for a DataFrame; None if there are none
    samples: Any = None  # function to the samples by column; None if there are none
    figure: str = ""  # name of the main chart or bars

    def numbers(self, found: object) -> dict[str, Any]:
        """Return a result as a dictionary, for JSON."""
        return record(self.kind, found, **self.given(found))
