"""The `geodrake` command: compare, diagnose, add, explain, demo."""

from geodrake.cli.app import main

__all__ = ["main"]
