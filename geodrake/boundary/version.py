"""The versions of the package and its dependencies."""

import importlib.metadata
import platform
from functools import cache

_DEPENDENCIES = ("drake", "numpy", "scipy", "numba", "mujoco", "pin", "pandas")


@cache
def version() -> str:
    """Return the version of the installed package."""
    try:
        return importlib.metadata.version("geodrake")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


def versions() -> str:
    """Return the versions of the package and its dependencies in one line, for bug reports."""
    numbers = {}
    for name in _DEPENDENCIES:
        try:
            numbers[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            numbers[name] = "–"
    dependencies = ", ".join(f"{name} {number}" for name, number in numbers.items())
    system = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    return f"geodrake {version()} ({dependencies}; {system})"
