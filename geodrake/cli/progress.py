"""Signs of life on stderr during long work; silent when no one is watching."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from geodrake.boundary.escaping import printable
from geodrake.compiling import while_compiling

Update = Callable[[str], None]

_COMPILING = "Compiling, once, which takes some ten seconds"


@contextmanager
def progress(words: str) -> Iterator[Update]:
    """A moving bar with words and the time so far, gone when the work is done.

    Args:
        words: What is being done.

    Yields:
        A function that replaces the words.
    """
    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=16),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
        disable=not console.is_terminal,
    )
    with bar:
        task, last = bar.add_task(printable(words), total=None), [words]

        def show(text: str) -> None:
            bar.update(task, description=printable(text))

        def update(text: str) -> None:
            last[0] = text
            show(text)

        with while_compiling(lambda: show(_COMPILING), lambda: show(last[0])):
            yield update
