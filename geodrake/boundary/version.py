"""The version of the package."""

import importlib.metadata


def version() -> str:
    """Version of the installed package."""
    try:
        return importlib.metadata.version("geodrake")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"
