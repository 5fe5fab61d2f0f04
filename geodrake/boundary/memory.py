"""The machine's memory, and a limit that raises a MemoryError."""

from __future__ import annotations

import importlib
import os
from contextlib import suppress

_LARGEST_SHARE = 0.8  # of the memory that a command may use


def machine_memory() -> int:
    """Return this machine's memory, bytes; a huge number if unknown."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 1 << 62


def limit_memory() -> None:
    """Limit the memory, so that a MemoryError is raised before the system kills the process.

    Small files may unpack to enormous sizes. Systems without such a limit are not affected.
    """
    with suppress(ImportError, AttributeError, OSError, ValueError):
        resource = importlib.import_module("resource")
        soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
        most = int(_LARGEST_SHARE * machine_memory())
        if soft == resource.RLIM_INFINITY or soft > most:
            resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
