"""Progress on stderr: a bar in a terminal, plain lines in a pipe.

Findings stay as lines above the bar. A pipe gets only such lines and, after long silence, the
current activity, without control characters.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn

from geodrake.boundary.escaping import printable
from geodrake.cli.streams import warn
from geodrake.compiling import while_compiling

if TYPE_CHECKING:
    from geodrake.diagnosis.search_progress import FoundStep

_COMPILING = "Compiling (only once, some ten seconds)"
STOPPING = "Interrupted: keeping what was found; Ctrl-C again stops at once"
"""Printed when a search with intermediate results is stopped."""

_SILENT, _PAUSE = 5.0, 1.0  # s of silence before a line in a pipe, and between checks
_LEAST_SHARE = 0.05  # completed share from which the remaining time is estimated
_WIDTH = 44


@dataclass(kw_only=True)
class Activity:
    """A display of the current activity; this base class shows only warnings."""

    begin: float = field(default_factory=time.monotonic)
    last: tuple[str, float | None] = ("", None)  # last description and share

    def __call__(self, words: str, share: float | None = None) -> None:
        """Show the current activity and its progress; None if unknown."""
        self.last = (words, share)

    def history(self, line: str) -> None:
        """Print a line that stays."""

    def warning(self, line: str) -> None:
        """Print a line that stays, even if progress is hidden."""
        warn(line)

    def time(self, share: float | None) -> str:
        """Return `12 s`, or `40 %, 12 s, about 18 s left`."""
        passed = time.monotonic() - self.begin
        if share is None or not _LEAST_SHARE <= share <= 1.0:
            return f"{passed:.0f} s"
        remaining = passed * (1.0 - share) / share
        return f"{100.0 * share:.0f} %, {passed:.0f} s, about {remaining:.0f} s left"


@dataclass(kw_only=True)
class _Lines(Activity):
    """Plain lines on stderr, with the current activity after long silence."""

    printed: float = field(default_factory=time.monotonic)  # time of the last line

    def __call__(self, words: str, share: float | None = None) -> None:
        super().__call__(words, share)
        if time.monotonic() - self.printed >= _SILENT:
            self.history(f"{words} ({self.time(share)})")

    def history(self, line: str) -> None:
        self.printed = time.monotonic()
        warn(line)

    warning = history

    @contextmanager
    def repeating(self) -> Iterator[None]:
        """Print the current activity at intervals."""
        finished = threading.Event()

        def repeat() -> None:
            while not finished.wait(_PAUSE):
                self(*self.last)

        thread = threading.Thread(target=repeat, daemon=True)
        thread.start()
        try:
            yield
        finally:
            finished.set()
            thread.join()


@dataclass(kw_only=True)
class _Bar(Activity):
    """A moving bar in a terminal, lines above it."""

    bar: Progress
    task: TaskID

    def __call__(self, words: str, share: float | None = None) -> None:
        super().__call__(words, share)
        self.show(words, share)

    def show(self, words: str, share: float | None = None) -> None:
        self.bar.update(
            self.task,
            description=printable(words)[:_WIDTH],
            total=None if share is None else 1.0,
            completed=share or 0.0,
            time=self.time(share),
        )

    def history(self, line: str) -> None:
        self.bar.console.print(printable(line), soft_wrap=True)

    warning = history


@contextmanager
def progress(words: str, *, quiet: bool = False) -> Iterator[Activity]:
    """Show the current activity until it is done."""
    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    if quiet:
        yield Activity()
        return
    if not console.is_terminal:
        lines = _Lines(last=(words, None))
        with lines.repeating():
            yield lines
        return
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=8),
        TextColumn("{task.fields[time]}", markup=False),
        console=console,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    with bar:
        task = bar.add_task(printable(words), total=None, time="")
        shown = _Bar(bar=bar, task=task)
        shown(words)
        with while_compiling(lambda: shown.show(_COMPILING), lambda: shown.show(*shown.last)):
            yield shown


def step_teller(activity: Activity) -> Callable[[FoundStep], None]:
    """Return a callback that prints each step with the smallest error so far, in two digits."""
    printed: list[float] = []

    def tell(step: FoundStep) -> None:
        if step.is_last:
            activity.history(STOPPING)
            return
        from geodrake.report.words import found_words  # slow to import

        error = float(f"{step.after:.2g}")
        if error < min(printed, default=math.inf):
            printed.append(error)
            activity.history(f"{len(printed)}  {found_words(step)}")
        words = f", error {step.after / step.floor:.3g} times the noise" if step.floor > 0.0 else ""
        activity(f"Searching{words}")

    return tell
