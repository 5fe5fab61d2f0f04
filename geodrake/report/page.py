"""A page of a report: its parts as plain data, and the way to one self-contained HTML file."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from geodrake.boundary.escaping import printable
from geodrake.report.style import png
from geodrake.report.tables import Table

_TEMPLATE = "report.html.jinja"


@dataclass(frozen=True)
class Picture:
    """A figure on a page.

    Attributes:
        source: The image, as a data URI.
        caption: What it shows; also read out by screen readers.
    """

    source: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A part of a page under a heading.

    Attributes:
        title: The heading.
        text: Paragraphs.
        tables: Tables.
        items: Entries of a list.
        pictures: Figures.
        abreast: Whether the tables are narrow and may stand side by side.
    """

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    items: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    abreast: bool = False


@dataclass(frozen=True)
class Tile:
    """A number worth seeing first.

    Attributes:
        label: What it is.
        value: The number, in words.
        note: What it means.
    """

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Page:
    """A whole report.

    Attributes:
        title: Title of the page.
        subject: What was compared with what.
        verdict: "adequate", "explained", "unexplained", "compared" or
            "identified"; decides the colour.
        mark: The verdict in words.
        headline: The answer, in a sentence.
        lead: What the answer means, in paragraphs.
        tiles: The numbers worth seeing first.
        sections: What follows.
        footer: Versions.
    """

    title: str
    subject: str
    verdict: str
    mark: str
    headline: str
    lead: tuple[str, ...]
    tiles: tuple[Tile, ...]
    sections: tuple[Section, ...]
    footer: str


def picture(figure: Figure, caption: str) -> Picture:
    """A figure as an image that is part of the page.

    Args:
        figure: The figure.
        caption: The sentence under it.
    """
    return Picture(f"data:image/png;base64,{base64.b64encode(png(figure)).decode()}", caption)


def pictures(figures: Mapping[str, Figure], captions: Mapping[str, str]) -> tuple[Picture, ...]:
    """The figures that have captions, in the order of the captions.

    Args:
        figures: Figures by name.
        captions: Captions by name of the figure.
    """
    return tuple(picture(figures[name], text) for name, text in captions.items() if name in figures)


def without_empty(sections: Sequence[Section]) -> tuple[Section, ...]:
    """The sections that say something."""
    return tuple(s for s in sections if s.text or s.tables or s.items or s.pictures)


def shown_text(value: Any) -> Any:
    """Printable text whose numbers stay on one line with their per cent signs and deviations."""
    if not isinstance(value, str) or hasattr(value, "__html__"):  # a macro's: done
        return value
    return (
        printable(value)
        .replace(" %", "\N{NO-BREAK SPACE}%")
        .replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    )


def render(page: Page) -> str:
    """The page as one HTML file that loads nothing from elsewhere; all text is escaped."""
    environment = Environment(
        loader=PackageLoader("geodrake", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=shown_text,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(_TEMPLATE).render(page=page)
