"""The version of the package."""

import importlib.metadata
from functools import cache


@cache
def version() -> str:
    """Version of the installed package."""
    try:
        return importlib.metadata.version("geodrake")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"
