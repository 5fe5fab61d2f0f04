"""The `geodrake` command: compare, diagnose, add, explain, identify, demo."""

import sys

__all__ = ["main"]


def main() -> None:
    """Run the command; Ctrl-C is said in a word, even while it is still being imported."""
    try:
        from geodrake.cli.app import main as run

        run()
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        sys.exit(130)
