"""Room for the numbers of a log: asked for before they are read."""

from __future__ import annotations

from pathlib import Path

from geodrake.boundary.memory import machine_memory
from geodrake.errors import LogError

_LARGEST_SHARE = 0.5  # of the memory that the numbers of a log may take; the rest is for the work


def check_room(path: Path, count: int, words: str) -> None:
    """Raise a LogError if numbers and what is made of them would fill the memory.

    Args:
        count: How many numbers it has, of 8 bytes.
        words: What it has, such as "100 rows of 15 numbers".
    """
    needed, there = 8 * count, machine_memory()
    if needed > _LARGEST_SHARE * there:
        raise LogError(
            f"Log {str(path)!r} has {words}, {needed / 1e9:.3g} GB; this machine has "
            f"{there / 1e9:.3g} GB of memory.",
            advice="Give excerpts of it, or fewer columns.",
        )
