"""Pages as self-contained HTML, and for notebooks."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from geodrake.boundary.escaping import printable
from geodrake.errors import ArgumentError
from geodrake.report.page import Page


def render(page: Page) -> str:
    """Return a page as one self-contained HTML file; all text is escaped."""
    for words, address in page.about.links.items():
        scheme, colon, _ = address.split("/")[0].partition(":")
        if colon and scheme.lower() not in ("http", "https"):
            raise ArgumentError(
                f"Link {words!r} of a report points to {address!r}.",
                advice="Use a file path relative to the report, or an http(s) address.",
            )
    scripts, style = [_asset("page.js")], _asset("page.css")
    if any(section.charts for section in page.sections):
        licence = _asset("uplot/LICENSE").strip()
        code = _asset("uplot/uPlot.iife.min.js").strip()
        scripts.insert(0, f"/* uPlot\n{licence}\n*/\n{code}")
        style = _asset("uplot/uPlot.min.css") + style
    environment = templates()
    environment.filters["json_of"] = Markup  # a chart's data, which is escaped
    environment.filters["breakable"] = _breakable
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    return environment.get_template("report.html.jinja").render(
        page=page,
        style=Markup(style),
        scripts=[Markup(script) for script in scripts],
        policy=Markup(_policy(scripts)),
    )


def templates() -> Environment:
    """Return the templates of all pages; they escape values, and missing values are errors."""
    return Environment(
        loader=PackageLoader("geodrake", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown_text,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _shown_text(value: Any) -> Any:
    """Return printable text with no-break spaces before percent signs and around ±."""
    if not isinstance(value, str) or hasattr(value, "__html__"):  # the output of a macro
        return value
    text = re.sub(r"(?<=\d) %", "\N{NO-BREAK SPACE}%", printable(value))
    return text.replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")


def _breakable(text: str) -> Markup:
    """Return lines as markup in which names may break after an underscore or a slash."""
    shown = "\n".join(str(escape(_shown_text(line))) for line in text.split("\n"))
    return Markup(re.sub("(?<=[_/])(?=[^_/])", "<wbr>", shown))


def _asset(name: str) -> str:
    return (files("geodrake") / "report" / "assets" / name).read_text(encoding="utf-8")


def _policy(scripts: Sequence[str]) -> str:
    """Return the content security policy of a page: no external content, and only these scripts."""
    hashes = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts)
    allowed = " ".join(f"'sha256-{each}'" for each in hashes)
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {allowed}; "
        "base-uri 'none'; form-action 'none'"
    )


def notebook_html(page: Page) -> str:
    """Return the answer and the tables of a page for notebooks."""
    sections = [section for section in page.shown_sections if not section.detailed]
    shown = [table for s in sections for table in s.shown_tables if not table.detailed]
    template = templates().get_template("notebook.html.jinja")
    return template.render(answer=page.answer, tables=shown)
