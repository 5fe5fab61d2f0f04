"""The memory of the machine, and a limit whose excess can be reported."""

from __future__ import annotations

import importlib
import os
from contextlib import suppress

_LARGEST_SHARE = 0.8  # of the memory that a command may take; the rest is for other programs


def machine_memory() -> int:
    """Return the bytes of memory of this machine; a huge number if the system reports none."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 1 << 62


def limit_memory() -> None:
    """Limit the memory, so that a MemoryError is raised before the system kills a process.

    A file of kilobytes may unpack to more than any machine holds. Where the system knows no such
    limit, nothing changes.
    """
    with suppress(ImportError, AttributeError, OSError, ValueError):
        resource = importlib.import_module("resource")
        soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
        most = int(_LARGEST_SHARE * machine_memory())
        if soft == resource.RLIM_INFINITY or soft > most:
            resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
