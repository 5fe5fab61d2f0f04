"""How much memory there is, and an end of it that can be told."""

from __future__ import annotations

import importlib
import os
from contextlib import suppress

_LARGEST_SHARE = 0.8  # of the memory that a command may take; the rest is for other programs


def machine_memory() -> int:
    """Return the bytes of memory of this machine; a huge number if the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 1 << 62


def limit_memory() -> None:
    """Let this process raise a MemoryError where the system would end some process without a word.

    A file of kilobytes may unpack to more than any machine holds. Where the system knows no such
    limit, nothing changes.
    """
    with suppress(ImportError, AttributeError, OSError, ValueError):
        resource = importlib.import_module("resource")
        soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
        most = int(_LARGEST_SHARE * machine_memory())
        if soft == resource.RLIM_INFINITY or soft > most:
            resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
