"""Results as tables and sentences in a terminal, or as plain text in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from geodrake.boundary.escaping import printable
from geodrake.cli.surroundings import results
from geodrake.diagnosis.ambiguity import distinguishing_commands
from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.identification.logs.model_errors import Comparison
from geodrake.model.effort_signal import EFFORT
from geodrake.report.identification_tables import bodies_table
from geodrake.report.numbers import Units, number
from geodrake.report.tables import (
    Cell,
    Table,
    candidates_table,
    error_stages,
    errors_table,
    limits_table,
    parameters_table,
    short_steps_table,
    signals_table,
    step_details,
)
from geodrake.report.words import (
    addition_verdict,
    comparison_verdict,
    diagnosis_verdict,
    draft_advice,
    explanation_verdict,
    failing_list,
    is_summarized,
    worst_words,
)

_PIPE_WIDTH = 160  # room for long names; tables are as wide as what is in them
_PLACES_WIDTH = 36
_WIDE = 110  # letters from which on a table has room for all that is known of a step
REST = "What is left goes with"
_TELLING = "Motions that would distinguish what the logs cannot"
SAVED = {
    "save": "model",
    "json": "numbers",
    "report": "report",
    "export": "model file with the identified inertias",
    "ellipsoids": "ellipsoids",
    "meshcat": "page of ellipsoids",
    "draft-effect": "drafted effects",
    "series": "samples",
}


class _Console(Console):
    """Shows a string as one line, in which nothing acts on the terminal, whatever names it has."""

    def render_str(self, text: str, **how: Any) -> Text:
        return super().render_str(printable(text), **how)

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError  # where the command ends, this is known


def make_console(*, stderr: bool = False) -> Console:
    """A console that prints names and numbers as they are, without reading markup into them."""
    file = sys.stderr if stderr else results()
    console = _Console(file=file, markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    return console


def show_comparison(console: Console, comparison: Comparison, units: Units) -> None:
    """Errors per joint, and where they are concentrated."""
    head(console, f"Error of the model as it stands, {units.effort()}")
    show_table(console, errors_table({"RMS": comparison.errors}, units))
    say(console, "Worst joint", worst_words(comparison.errors, unit=units.effort()))
    say(console, "Verdict", comparison_verdict(comparison))
    show_list(console, "Where it fails", failing_list(comparison))
    show_list(console, "Notes", comparison.notes)


def show_diagnosis(console: Console, diagnosis: Diagnosis, units: Units) -> None:
    """Candidates from the best on, with the evidence."""
    start, refitted = number(diagnosis.start.nrms), number(diagnosis.refitted.nrms)
    found = "Missing effects" if diagnosis.candidates else "No effect found"
    head(console, f"{found}; nrms {start} as it stands, {refitted} with parameters refitted")
    if diagnosis.candidates:
        show_table(console, candidates_table(diagnosis, units))
    say(console, "Worst joint", worst_words(diagnosis.start, unit=units.effort()))
    say(console, "Verdict", diagnosis_verdict(diagnosis, units))
    show_list(console, _TELLING, distinguishing_commands(diagnosis))
    show_list(console, "Notes", diagnosis.notes)


def show_explanation(
    console: Console,
    explanation: Explanation,
    units: Units,
    *,
    advised: bool = True,
    rest: Sequence[str] = (),
) -> None:
    """The steps with the error falling, the verdict, what is left, and errors per joint.

    Args:
        advised: Whether to say what to do about an error that nothing explains.
        rest: What the error left goes with, in sentences.
    """
    _show_steps(console, explanation, units)
    if explanation.is_interrupted:
        say(console, "Interrupted", "the search had not ended; these steps were found by then.")
    advice = draft_advice(explanation) if advised else ""
    say(console, "Verdict", f"{explanation_verdict(explanation, units)} {advice}".rstrip())
    show_list(console, REST, rest)
    show_list(console, _TELLING, distinguishing_commands(explanation))
    _show_change(console, explanation, units)


def show_addition(console: Console, explanation: Explanation, units: Units) -> None:
    """The same for an effect that was asked for, whatever the evidence for it."""
    _show_steps(console, explanation, units)
    say(console, "Result", addition_verdict(explanation, units))
    _show_change(console, explanation, units)


def _show_steps(console: Console, explanation: Explanation, units: Units) -> None:
    head(console, "Steps; nrms on held-out data, everything refitted")
    is_narrow = console.is_terminal and console.width < _WIDE
    show_table(console, short_steps_table(explanation, units, details=not is_narrow))
    if is_narrow:
        show_list(console, "How much", step_details(explanation, units))
    for step in filter(is_summarized, explanation.steps):
        table = parameters_table(step, units)
        head(console, f"{step.effect}, value ± standard deviation")
        show_table(console, table)


def _show_change(console: Console, explanation: Explanation, units: Units) -> None:
    """Errors per joint from the start to the end, and the notes."""
    head(console, f"Error of each joint, RMS in {units.effort()}")
    show_table(console, errors_table(error_stages(explanation), units))
    first = "Where it failed as it stood" if explanation.steps else "Where it fails"
    show_list(console, first, failing_list(explanation.before))
    if explanation.steps:
        show_list(console, "Where it still fails", failing_list(explanation.after))
    start, end = explanation.start, explanation.end if explanation.steps else None
    say(console, "Worst joint", worst_words(start, end, unit=units.effort()))
    if explanation.bodies:
        head(
            console, "Bodies before and after, kg and mm, farthest change first; ± from noise alone"
        )
        show_table(console, bodies_table(explanation.bodies))
    motors = [each for each in explanation.model.effort_signals if each.kind == EFFORT]
    others = [each for each in explanation.model.effort_signals if each.kind != EFFORT]
    if others:
        head(console, "Gains, by the model's inertias")
        show_table(console, signals_table(others, units))
    if motors:
        head(console, "Limits of motors")
        show_table(console, limits_table(motors, units))
    show_list(console, "Notes", explanation.notes)


def show_saved(
    console: Console, files: Mapping[str, object], words: Mapping[str, str] | None = None
) -> None:
    """Where files went; `words` says what they are where that is not the usual.

    Args:
        files: Option -> the file that was written.
        words: Option -> what the file is, where that is not the usual.
    """
    if files:
        console.print()
    for option, path in files.items():
        what = {**SAVED, **(words or {})}[option]
        console.print(f"Saved the {what}: {path}", soft_wrap=True)


def show_table(console: Console, table: Table) -> None:
    """A table with a rule under its head in a terminal, and without lines in a pipe.

    Args:
        table: The table; its cells are read without markup.
    """
    grid = Grid(
        box=box.SIMPLE_HEAD if console.is_terminal else None,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0) if console.is_terminal else (0, 2, 0, 0),
    )
    for k, name in enumerate(table.head):
        if k < table.words:
            width = _PLACES_WIDTH if name.startswith("where") else None
            grid.add_column(name, overflow="fold", max_width=width, no_wrap=name == "effect")
        else:
            lines = name.split(" ") if console.is_terminal else [name]
            title = Text("\n").join(map(console.render_str, lines))
            grid.add_column(title, justify="right", no_wrap=True)
    for k, row in enumerate(table.rows):
        if table.total and k == len(table.rows) - table.total:
            grid.add_section()
        grid.add_row(*(_lines(console, cell) for cell in row))
    console.print(grid)


def _lines(console: Console, cell: Cell) -> Text:
    """Return an entry of a table, which may have several lines."""
    lines = (cell.typed or cell.text).split("\n")
    return Text("\n").join(console.render_str(line) for line in lines)


def head(console: Console, words: str) -> None:
    """A heading after an empty line."""
    console.print()
    console.print(console.render_str(words, style="bold"), soft_wrap=True)


def say(console: Console, head: str, sentence: str) -> None:
    """A paragraph; in a pipe it stays one line."""
    text = Text.assemble((f"{head}: ", "bold"), console.render_str(sentence))
    console.print()
    console.print(text, soft_wrap=not console.is_terminal)


def show_list(console: Console, words: str, entries: Sequence[str]) -> None:
    """A heading with a list under it, or nothing.

    Args:
        entries: The list; nothing is printed if it is empty.
    """
    if not entries:
        return
    head(console, words)
    for entry in entries:
        if console.is_terminal:
            grid = Grid.grid(padding=(0, 1))
            grid.add_row("-", entry)
            console.print(grid)
        else:
            console.print(f"- {entry}", soft_wrap=True)
