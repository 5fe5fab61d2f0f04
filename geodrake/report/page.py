"""A page of a report: its parts as plain data, and the way to one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from geodrake.boundary.escaping import printable
from geodrake.errors import ArgumentError
from geodrake.report.bars import Bars
from geodrake.report.charts import Chart
from geodrake.report.dependence import Dependence
from geodrake.report.frame import HEIGHT, WIDTH
from geodrake.report.static_plot import static_plots
from geodrake.report.tables import Table

_TEMPLATE = "report.html.jinja"


@dataclass(frozen=True)
class Picture:
    """A figure on a page.

    Attributes:
        source: The image as a data URI; "" where it is SVG.
        caption: What it shows; also read out by screen readers.
        svg: The image as an SVG element in the page's colours; "" where it has pixels.
    """

    source: str
    caption: str
    svg: str = ""


@dataclass(frozen=True)
class ColoredList:
    """A list about one of the page's models.

    Attributes:
        color: Name of the model's colour in the style sheet.
    """

    title: str
    color: str
    items: tuple[str, ...]


@dataclass(frozen=True)
class Section:
    """A part of a page under a heading.

    Attributes:
        abreast: Whether the tables are narrow and may stand side by side.
        dependences: Residuals of models against what they may depend on.
    """

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    items: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    bars: tuple[Bars, ...] = ()
    abreast: bool = False
    lists: tuple[ColoredList, ...] = ()
    charts: tuple[Chart, ...] = ()
    dependences: tuple[Dependence, ...] = ()

    @property
    def says_something(self) -> bool:
        """Whether there is anything under the heading."""
        parts = (self.text, self.tables, self.items, self.pictures, self.bars)
        return any((*parts, self.lists, self.charts, self.dependences))


@dataclass(frozen=True)
class Tile:
    """A number worth seeing first.

    Attributes:
        value: The number, in words.
        words: Whether the value is a name, which may be long.
    """

    label: str
    value: str
    note: str = ""
    words: bool = False


@dataclass(frozen=True)
class Page:
    """A whole report.

    Attributes:
        subject: What was compared with what.
        verdict: "adequate", "explained", "unexplained", "undecided", "compared" or
            "identified"; decides the colour.
        headline: The answer, in a sentence.
        lead: What the answer means, in paragraphs.
        tiles: The numbers worth seeing first.
        links: Words -> address of what belongs to the page.
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
    links: Mapping[str, str] = field(default_factory=dict)


def without_empty(sections: Sequence[Section]) -> tuple[Section, ...]:
    """The sections that say something."""
    return tuple(section for section in sections if section.says_something)


def shown_text(value: Any) -> Any:
    """Printable text whose numbers stay on one line with their per cent signs and deviations."""
    if not isinstance(value, str) or hasattr(value, "__html__"):  # a macro's: done
        return value
    return (
        printable(value)
        .replace(" %", "\N{NO-BREAK SPACE}%")
        .replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    )


def _asset(name: str) -> str:
    return (files("geodrake") / "report" / "assets" / name).read_text(encoding="utf-8")


def _policy(scripts: Sequence[str]) -> str:
    """What a browser may load for a page: nothing; and run: these scripts and no other."""
    hashes = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts)
    allowed = " ".join(f"'sha256-{each}'" for each in hashes) or "'none'"
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {allowed}; "
        "base-uri 'none'; form-action 'none'"
    )


def _breakable(text: str) -> Markup:
    """Text as markup whose long names may go on in a new line after an underscore or a slash."""
    return Markup(re.sub("(?<=[_/])(?=[^_/])", "<wbr>", str(escape(shown_text(text)))))


def _checked(links: Mapping[str, str]) -> Mapping[str, str]:
    """Links that lead to a page, beside this one or in the web.

    Raises:
        ArgumentError: An address has another scheme, such as javascript.
    """
    for words, address in links.items():
        scheme = address.split("/")[0].partition(":")
        if scheme[1] and scheme[0].lower() not in ("http", "https"):
            raise ArgumentError(
                f"The link {words!r} of a report leads to {address!r}.",
                advice="Give the path of a file, relative to the report, or a http(s) address.",
            )
    return links


def _scripts(page: Page) -> list[str]:
    """What the page runs: uPlot where there are plots, with its licence, and the page's own."""
    own = [_asset("page.js")]
    if not any(section.charts for section in page.sections):
        return own
    licence = _asset("uplot/LICENSE").strip()
    return [f"/* uPlot\n{licence}\n*/\n{_asset('uplot/uPlot.iife.min.js').strip()}", *own]


def templates() -> Environment:
    """The templates of all pages: what they show is escaped, and what is not there is an error."""
    return Environment(
        loader=PackageLoader("geodrake", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=shown_text,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(page: Page) -> str:
    """The page as one HTML file that loads nothing from elsewhere; all text is escaped.

    Raises:
        ArgumentError: A link leads to no page.
    """
    environment = templates()
    environment.filters["json_of"] = Markup  # a chart's data, which has no letter of markup
    environment.filters["breakable"] = _breakable
    environment.globals.update(static_plots=static_plots, size=(WIDTH, HEIGHT))
    scripts = _scripts(page)
    style = _asset("page.css")
    if len(scripts) > 1:
        style = _asset("uplot/uPlot.min.css") + style
    _checked(page.links)
    return environment.get_template(_TEMPLATE).render(
        page=page,
        style=Markup(style),
        scripts=[Markup(script) for script in scripts],
        policy=Markup(_policy(scripts)),
    )
