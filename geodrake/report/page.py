"""The content of a result, said once and printed by a terminal, an HTML page and a notebook."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
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

    text: str  # what it says, in lines
    note: str = ""  # what stands under it in small letters on an HTML page
    # Share in [0, 1] that an HTML page draws as a bar beside the text; None for no bar.
    bar: float | None = None
    typed: str = ""  # how commands call it, which terminals and notebooks show in place of the text


@dataclass(frozen=True)
class Table:
    """A table of words and numbers."""

    head: tuple[str, ...]
    rows: Sequence[tuple[Cell, ...]]  # the rows, as long as the head
    words: int = 1  # how many columns from the left hold words; the others hold numbers
    title: str = ""
    total: int = 0  # how many of the last rows sum the others up
    detailed: bool = False  # whether HTML pages alone have it


def cells(*entries: Cell | str | float | None) -> tuple[Cell, ...]:
    """Return a row of a table: numbers with their usual digits, nothing for None."""
    return tuple(each if isinstance(each, Cell) else Cell(_text(each)) for each in entries)


def _text(entry: str | float | None) -> str:
    if entry is None:
        return ""
    if isinstance(entry, str | int):
        return str(entry)
    return number(entry)


@dataclass(frozen=True)
class ColoredList:
    """A list about one of the models; `color` is the model's in the style sheet."""

    title: str
    color: str
    items: tuple[str, ...]


@dataclass(frozen=True)
class Section:
    """A part of a page under a heading."""

    title: str
    text: str = ""  # what is seen here, in a sentence
    more: str = ""  # how to read it, in lines that HTML pages show as paragraphs when asked
    bars: tuple[Bars, ...] = ()
    tables: tuple[Table, ...] = ()
    items: tuple[str, ...] = ()
    lists: tuple[ColoredList, ...] = ()
    commands: tuple[str, ...] = ()  # commands to copy
    charts: tuple[Chart, ...] = ()
    detailed: bool = False  # whether HTML pages alone have it
    deep: bool = False  # whether terminals show it only where details are asked for

    @property
    def shown_tables(self) -> tuple[Table, ...]:
        """Return the tables that have a row."""
        return tuple(table for table in self.tables if table.rows)

    @property
    def says_something(self) -> bool:
        """Return whether there is anything but words about it."""
        parts = (self.bars, self.shown_tables, self.items, self.lists, self.commands, self.charts)
        return any(parts)


@dataclass(frozen=True)
class Tile:
    """A number worth seeing first; `words` if the value is a name, which may be long."""

    label: str
    value: str
    note: str = ""
    words: bool = False


@dataclass(frozen=True)
class Picture:
    """A picture of a robot as PNG, on no ground."""

    title: str
    png: bytes


@dataclass(frozen=True)
class Pictures:
    """Pictures of a robot whose links are coloured by errors."""

    shown: tuple[Picture, ...]
    colors: tuple[str, ...]  # colours from no error to the largest
    top: str  # the largest one, in words
    text: str
    notes: tuple[str, ...] = ()  # what is not shown as the model's file has it, in words


@dataclass(frozen=True)
class About:
    """What a result is of.

    Attributes:
        model: What the model is called.
        logs: What the logs are called.
        command: What made the result, for the title.
        units: Units of the model's joints and effects.
        saved: How commands call the model from now on: where it was saved.
        links: Words -> address of further pages, such as a replay.
    """

    model: str = "the model"
    logs: tuple[str, ...] = ()
    command: str = "report"
    units: Units = field(default_factory=Units)
    saved: str = "MODEL"
    links: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Page:
    """All that there is to say of a result.

    Attributes:
        mark: The verdict in a few words.
        headline: The answer, in a sentence.
        verdict: "adequate", "explained", "unexplained" or "undecided", which decide the colour, or
            another word where nothing is judged.
        of: What was compared with what, if it is not the model with the logs.
        lead: What the answer means, in paragraphs.
        tiles: The numbers worth seeing first.
        first: What is to be known before all else: mistakes in columns, and what is left out.
        pictures: The robot, which HTML pages alone have.
    """

    about: About
    mark: str
    headline: str
    sections: tuple[Section, ...]
    verdict: str = "compared"
    of: str | None = None
    lead: tuple[str, ...] = ()
    tiles: tuple[Tile, ...] = ()
    footer: str = ""
    first: tuple[Section, ...] = ()
    pictures: Pictures | None = None

    @property
    def subject(self) -> str:
        """Return what was compared with what, in words."""
        against = f"{self.about.model} against {', '.join(self.about.logs)}"
        return against if self.of is None else self.of

    @property
    def shown_sections(self) -> tuple[Section, ...]:
        """Return the sections that say something."""
        return tuple(section for section in self.sections if section.says_something)

    @property
    def sentence(self) -> str:
        """Return the answer and what it means, as a paragraph."""
        judged = self.verdict in ("adequate", "explained", "unexplained", "undecided")
        mark = f"{self.mark[:1].upper()}{self.mark[1:]}. " if judged else ""
        return " ".join((f"{mark}{self.headline}", *self.lead))


@dataclass(frozen=True)
class View:
    """How to see one kind of result."""

    page: Callable[[Any, About], Page]
    kind: str  # of object that it is in JSON, as `schema.yaml` calls it
    # Keys of that whose values are no attributes of the result, by their names.
    given: Callable[[Any], Mapping[str, Any]] = lambda found: {}
    records: Any = None  # function to rows of numbers, for a DataFrame; None if there are none
    samples: Any = None  # function to the samples behind it, by column; None if there are none
    figure: str = ""  # name of the chart or bars that say most
    # Title -> comparison by whose errors the page colours the robot.
    drawn: Callable[[Any], Mapping[str, Comparison]] = lambda found: {}

    def numbers(self, found: object) -> dict[str, Any]:
        """Return a result as a dictionary, for JSON."""
        return record(self.kind, found, **self.given(found))
