"""Pages in terminals, or as plain text in pipes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from geodrake.boundary.escaping import printable
from geodrake.report.page import Page, Section, Table

_GAP = 2  # columns between those of a table
_NARROW_NAME, _WIDE_NAME = 12, 20  # columns to which names are wrapped before a table is split
_ENDS = re.compile(r"(?<=[_/.:])")  # where lines end inside names
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
            for k, grid in enumerate(_tables(console, table, details=details)):
                if k > 0:
                    console.print()
                console.print(grid)
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


def _tables(console: Console, table: Table, *, details: bool) -> Iterator[Grid]:
    """Yield a table in parts that are not wider than the terminal, the deep columns last."""
    table, room = table if details else table.in_short, console.width + _GAP
    widths = _widths(console, table)
    least = [*map(min, widths, _least_widths(table)), *widths[table.words :]]
    words, numbers = [*range(table.words)], [*range(table.words, len(widths))]
    deep = [k for k in numbers if table.head[k] in table.deep and sum(widths) > room]
    for group in filter(None, ([k for k in numbers if k not in deep], deep)):
        start = 0
        while start < len(group):
            end = len(group)
            while end > start + 1 and sum(least[k] for k in (*words, *group[start:end])) > room:
                end -= 1
            kept, filled = [*words, *group[start:end]], group[start] > numbers[0]
            fitted = _fitted([widths[k] for k in kept], [least[k] for k in kept], room)
            yield _grid(console, table.columns(kept, filled=filled), fitted)
            start = end
    if not numbers:
        yield _grid(console, table, _fitted(widths, least, room))


def _widths(console: Console, table: Table) -> list[int]:
    """Return the widths of columns without wrapping, with the gaps after them."""
    texts = [[cell.typed or cell.text for cell in row] for row in table.rows]
    columns = [[name, *column] for name, *column in zip(table.head, *texts, strict=True)]
    if console.is_terminal:
        for column in columns[table.words :]:
            column[0] = column[0].replace(" ", "\n")
    lines = [[printable(line) for x in column for line in x.split("\n")] for column in columns]
    return [max(map(cell_len, column)) + _GAP for column in lines]


def _least_widths(table: Table) -> list[int]:
    """Return the widths to which columns of words are wrapped before the table is split."""
    least = []
    for k, name in enumerate(table.head[: table.words]):
        words = " ".join(row[k].typed or row[k].text for row in table.rows).split()
        pieces = words if name == "effect" else [x for word in words for x in _ENDS.split(word)]
        widest = max(map(cell_len, pieces), default=0)
        least.append(min(max(widest, _NARROW_NAME), _WIDE_NAME) + _GAP)
    return least


def _fitted(widths: Sequence[int], least: Sequence[int], room: int) -> list[int]:
    """Return widths within the room, the widest reduced first, if the least ones allow it."""
    fitted = list(widths)
    while sum(fitted) > room:
        k = max(range(len(fitted)), key=lambda k: (fitted[k] > least[k], fitted[k]))
        if fitted[k] <= least[k]:
            break
        fitted[k] -= 1
    return fitted


def _grid(console: Console, table: Table, widths: Sequence[int]) -> Grid:
    grid = Grid(
        box=box.SIMPLE_HEAD if console.is_terminal else None,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0) if console.is_terminal else (0, 2, 0, 0),
    )
    texts = [width - _GAP for width in widths]
    for k, name in enumerate(table.head):
        if k < table.words:
            grid.add_column(_wrapped(name, texts[k]), overflow="fold")
        else:
            title = printable(name).replace(" ", "\n" if console.is_terminal else " ")
            grid.add_column(Text(title), justify="right", no_wrap=True)
    for k, row in enumerate(table.rows):
        if table.total and k == len(table.rows) - table.total:
            grid.add_section()
        pairs = zip((cell.typed or cell.text for cell in row), texts, strict=True)
        grid.add_row(*(_wrapped(text, width) for text, width in pairs))
    return grid


def _wrapped(text: str, width: int) -> Text:
    """Return printable text whose lines end at spaces, or in names at underscores and the like."""
    lines = []
    for line in text.split("\n"):
        lines.append("")
        for word in printable(line).split(" "):
            joined = f"{lines[-1]} {word}" if lines[-1] else word
            if cell_len(joined) <= width:
                lines[-1] = joined
                continue
            if lines[-1]:
                lines.append("")
            for piece in _ENDS.split(word):
                if lines[-1] and cell_len(lines[-1] + piece) > width:
                    lines.append("")
                lines[-1] += piece
    return Text("\n".join(lines))
