"""The version of the package, and of those that it is used with."""

import importlib.metadata
import platform
from functools import cache

_BESIDE = ("drake", "numpy", "scipy", "numba", "mujoco", "pin", "pandas")


@cache
def version() -> str:
    """Return the version of the installed package."""
    try:
        return importlib.metadata.version("geodrake")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


def versions() -> str:
    """Return the versions of the package and its dependencies in one line, for bug reports."""
    found = {}
    for name in _BESIDE:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "–"
    beside = ", ".join(f"{name} {number}" for name, number in found.items())
    system = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    return f"geodrake {version()} ({beside}; {system})"
