"""Files that are damaged, or of another kind than their names say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from geodrake.errors import GeodrakeError, LogError


@contextmanager
def readable(path: Path, what: str, advice: str = "Write it again, or as CSV.") -> Iterator[None]:
    """Whatever is raised by the reader of a file that is none of its kind is an error of the log.

    Args:
        what: What it should be, such as "Parquet file".
    """
    try:
        yield
    except (GeodrakeError, MemoryError):
        raise
    except Exception as error:  # of readers and their decompressors: no list would be whole
        words = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise LogError(
            f"Log {str(path)!r} is no {what} that can be read: {words}.", advice=advice
        ) from error
