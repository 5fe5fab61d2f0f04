"""Pages in terminals, or as plain text in pipes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as Grid
from rich.text import Text

from geodrake.boundary.escaping import printable
from geodrake.report.page import Page, Section, Table

_UNLIMITED = 10_000  # columns
_NARROW = 40  # columns, below which labels and texts are not beside each other


class ResultsConsole(Console):
    """Console that escapes control characters, so that no string can control the terminal."""

    def render_str(self, text: str, **how: Any) -> Text:
        """Return printable text; markup is not interpreted."""
        return super().render_str(printable(text), **how)

    def on_broken_pipe(self) -> None:
        """Raise `BrokenPipeError`, which the command handles at its end."""
        raise BrokenPipeError


def show_page(console: Console, page: Page, *, details: bool = True) -> None:
    """Print a page: its subject, what to check first, the answer, and the sections.

    Without details, only the titles of deep sections are listed.
    """
    if page.subject:
        console.print(page.subject, soft_wrap=True)
    printed = [s for s in page.shown_sections if not s.detailed and _is_printed(s)]
    sections = [s for s in printed if details or not s.deep]
    for section in filter(_is_printed, page.first):
        show_section(console, section)
    if page.answer:
        console.print()
        _show_labelled(console, page.answer)
    for section in sections:
        show_section(console, section, details=details)
    hidden = [s.title[:1].lower() + s.title[1:] for s in printed if s.deep]
    columns = [name for s in sections for table in s.shown_tables for name in table.deep_columns]
    if not details and (hidden := [*hidden, *dict.fromkeys(columns)]):
        console.print()
        _show_labelled(console, {"--details adds": ", ".join(hidden)})


def _is_printed(section: Section) -> bool:
    tables = [table for table in section.shown_tables if not table.detailed]
    return bool(tables or section.items or section.commands)


def show_section(console: Console, section: Section, *, details: bool = True) -> None:
    """Print a section under its heading, without its charts."""
    _head(console, section.title)
    if section.text and (section.shown_tables or section.commands):
        console.print(Text(printable(section.text)), soft_wrap=not console.is_terminal)
    for table in section.shown_tables:
        if not table.detailed:
            if table.title:
                _head(console, table.title)
            is_split = details and table.deep and not _fits(console, table)
            console.print(_grid(console, table if details and not is_split else table.in_short))
            if is_split:
                console.print()
                console.print(_grid(console, table.in_depth))
    _show_items(console, (*section.items, *section.commands))


def show_saved(console: Console, saved: Mapping[Path, str], others: Sequence[object] = ()) -> None:
    """Print the files that were written."""
    if saved or others:
        console.print()
    for path in others:
        console.print(f"Saved: {path}", soft_wrap=True)
    for path, words in saved.items():
        console.print(f"Saved the {words}: {path}", soft_wrap=True)


def _show_labelled(console: Console, texts: Mapping[str, str]) -> None:
    """Print texts beside their labels; in a pipe or a narrow terminal after them."""
    if not console.is_terminal or console.width < _NARROW:
        for label, text in texts.items():
            console.print(f"{label}: {text}", soft_wrap=not console.is_terminal)
        return
    grid = Grid.grid(padding=(0, 1, 0, 0))
    grid.add_column(no_wrap=True, style="bold")
    for label, text in texts.items():
        grid.add_row(f"{label}:", Text(printable(text)))
    console.print(grid)


def _head(console: Console, words: str) -> None:
    console.print()
    console.print(Text(printable(words), style="bold"), soft_wrap=True)


def _show_items(console: Console, items: Sequence[str]) -> None:
    for item in items:
        if console.is_terminal:
            grid = Grid.grid(padding=(0, 1))
            grid.add_row("-", Text(printable(item)))
            console.print(grid)
        else:
            console.print(f"- {item}", soft_wrap=True)


def _fits(console: Console, table: Table) -> bool:
    """Return whether a table needs no more columns than the terminal has."""
    unlimited = console.options.update(max_width=_UNLIMITED)
    return Measurement.get(console, unlimited, _grid(console, table)).maximum <= console.width


def _grid(console: Console, table: Table) -> Grid:
    grid = Grid(
        box=box.SIMPLE_HEAD if console.is_terminal else None,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0) if console.is_terminal else (0, 2, 0, 0),
    )
    for k, name in enumerate(table.head):
        if k < table.words:
            grid.add_column(printable(name), overflow="fold", no_wrap=name == "effect")
        else:
            title = printable(name).replace(" ", "\n" if console.is_terminal else " ")
            grid.add_column(Text(title), justify="right", no_wrap=True)
    for k, row in enumerate(table.rows):
        if table.total and k == len(table.rows) - table.total:
            grid.add_section()
        grid.add_row(*(_printable_lines(cell.typed or cell.text) for cell in row))
    return grid


def _printable_lines(text: str) -> Text:
    return Text("\n".join(map(printable, text.split("\n"))))
