"""Results as tables and sentences in a terminal, or as plain text in a pipe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from geodrake.cli.wording import (
    Wording,
    addition_verdict,
    comparison_verdict,
    diagnosis_verdict,
    explanation_verdict,
    number,
    percent,
    rivals_told,
)
from geodrake.diagnosis.ambiguity import telling_commands
from geodrake.diagnosis.results import Comparison, Diagnosis, Explanation, JointError
from geodrake.escaping import printable

_PIPE_WIDTH = 160  # room for long names; tables are as wide as what is in them
_PLACES_WIDTH = 36
REST = "What is left goes with"
_TELLING = "Motions that would tell apart what the log cannot"
_SAVED = {
    "save": "model",
    "json": "numbers",
    "report": "report",
    "export": "model file with the identified inertias",
    "ellipsoids": "ellipsoids",
    "meshcat": "page of ellipsoids",
    "draft-effect": "drafted effects",
}


class _Console(Console):
    """Shows a string as one line, in which nothing acts on the terminal, whatever names it has."""

    def render_str(self, text: str, **how: Any) -> Text:
        return super().render_str(printable(text), **how)

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError  # where the command ends, this is known


def make_console(*, stderr: bool = False) -> Console:
    """A console that prints names and numbers as they are, without reading markup into them."""
    console = _Console(stderr=stderr, markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    return console


def show_comparison(console: Console, comparison: Comparison, wording: Wording) -> None:
    """Errors per joint, and where they are concentrated."""
    errors = comparison.errors
    head(console, f"Error of the model as it stands, {wording.effort_unit}")
    table = table_of(console, "joint")
    number_columns(table, "std", "RMS", "nrms", "noise", "removable")
    for joint in errors.joints:
        table.add_row(
            joint.joint,
            number(joint.std),
            number(joint.rms),
            f"{joint.nrms:.3f}",
            number(joint.floor),
            _removable(joint),
        )
    console.print(table)
    say(console, "Verdict", comparison_verdict(comparison))
    show_list(console, "Where it fails", [str(case) for case in comparison.failing])
    show_list(console, "Notes", comparison.notes)


def show_diagnosis(console: Console, diagnosis: Diagnosis, wording: Wording) -> None:
    """Candidates from the best on, with the evidence."""
    start, refitted = diagnosis.start, diagnosis.refitted
    levels = f"nrms {start.nrms:.3f} as it stands, {refitted.nrms:.3f} with parameters refitted"
    if diagnosis.candidates:
        head(console, f"Missing effects; {levels}")
        table = table_of(console, "#", "effect", "where")
        number_columns(table, "before", "after", "evidence", "chance")
        for count, candidate in enumerate(diagnosis.candidates, 1):
            table.add_row(
                "=" if candidate.tied and count > 1 else str(count),
                lines_of(console, candidate.effect.replace(" + ", "\n+ ").split("\n")),
                wording.where(candidate.where),
                f"{candidate.error_before:.3f}",
                f"{candidate.error_after:.3f}",
                number(candidate.evidence),
                _chance(candidate.false_alarm_probability),
            )
        console.print(table)
    else:
        head(console, f"No effect found; {levels}")
    say(console, "Verdict", diagnosis_verdict(diagnosis, wording))
    show_list(console, _TELLING, telling_commands(diagnosis))
    show_list(console, "Notes", diagnosis.notes)


def show_explanation(
    console: Console,
    explanation: Explanation,
    wording: Wording,
    *,
    advice: str = "",
    rest: Sequence[str] = (),
) -> None:
    """The steps with the error falling, the verdict, what is left, and errors per joint.

    Args:
        console: Where to print.
        explanation: The explanation.
        wording: How to speak about its model.
        advice: What follows the verdict.
        rest: What the error left goes with, in sentences.
    """
    _show_steps(console, explanation, wording)
    say(console, "Verdict", explanation_verdict(explanation, wording) + advice)
    show_list(console, REST, rest)
    show_list(console, _TELLING, telling_commands(explanation))
    _show_change(console, explanation, wording)


def show_addition(console: Console, explanation: Explanation, wording: Wording) -> None:
    """The same for an effect that was asked for, whatever the evidence for it."""
    _show_steps(console, explanation, wording)
    say(console, "Result", addition_verdict(explanation, wording))
    _show_change(console, explanation, wording)


def _show_change(console: Console, explanation: Explanation, wording: Wording) -> None:
    """Errors per joint from the start to the end, and the notes."""
    start, refitted, end = explanation.start, explanation.refitted, explanation.end
    head(console, f"Error of each joint, RMS in {wording.effort_unit}")
    table = table_of(console, "joint")
    number_columns(table, "std", "start", "refitted", "end", "noise", "removable")
    for before, middle, after in zip(start.joints, refitted.joints, end.joints, strict=True):
        values = (after.std, before.rms, middle.rms, after.rms, after.floor)
        table.add_row(after.joint, *map(number, values), _removable(after))
    table.add_section()
    table.add_row(
        "nrms", "", *(f"{e.nrms:.3f}" for e in (start, refitted, end)), f"{end.floor_nrms:.3f}", ""
    )
    console.print(table)
    show_list(console, "Notes", explanation.notes)


def show_saved(
    console: Console, files: Mapping[str, object], words: Mapping[str, str] | None = None
) -> None:
    """Where files went; `words` says what they are where that is not the usual."""
    if files:
        console.print()
    for option, path in files.items():
        what = {**_SAVED, **(words or {})}[option]
        console.print(f"Saved the {what}: {path}", soft_wrap=True)


def _show_steps(console: Console, explanation: Explanation, wording: Wording) -> None:
    head(console, "Steps; nrms on held-out data, everything refitted")
    table = table_of(console, "#", "effect", "where, how much")
    number_columns(table, "before", "after", "blocks better")
    start, refitted = explanation.start.nrms, explanation.refitted.nrms
    table.add_row("", "as it stands", "", "", f"{start:.3f}")
    if explanation.steps:
        table.add_row("", "refitted", "its own parameters", f"{start:.3f}", f"{refitted:.3f}")
    for count, step in enumerate(explanation.steps, 1):
        lines = [wording.where(step.where), *wording.parameters(step)]
        if step.indistinguishable_from:
            lines.append(f"or: {', '.join(rivals_told(step))}")
        table.add_row(
            str(count),
            step.effect,
            lines_of(console, lines),
            f"{step.error_before:.3f}",
            f"{step.error_after:.3f}",
            percent(step.agreement),
        )
    console.print(table)


def table_of(console: Console, *columns: str) -> Table:
    """A table with a rule under its head in a terminal, and without lines in a pipe."""
    table = Table(
        box=box.SIMPLE_HEAD if console.is_terminal else None,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0) if console.is_terminal else (0, 2, 0, 0),
    )
    for name in columns:
        width = _PLACES_WIDTH if name.startswith("where") else None
        table.add_column(name, overflow="fold", max_width=width, no_wrap=name == "effect")
    return table


def lines_of(console: Console, lines: Sequence[str]) -> Text:
    """An entry of a table in several lines."""
    return Text("\n").join(console.render_str(line) for line in lines)


def number_columns(table: Table, *names: str) -> None:
    """Adds columns of numbers to a table."""
    for name in names:
        table.add_column(name, justify="right", no_wrap=True)


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
    """A heading with a list under it, or nothing."""
    if not entries:
        return
    head(console, words)
    for entry in entries:
        if console.is_terminal:
            grid = Table.grid(padding=(0, 1))
            grid.add_row("-", entry)
            console.print(grid)
        else:
            console.print(f"- {entry}", soft_wrap=True)


def _removable(joint: JointError) -> str:
    return percent(joint.removable)


def _chance(probability: float) -> str:
    return "< 1e-9" if probability < 1e-9 else f"{probability:.2g}"
