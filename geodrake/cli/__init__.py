"""The `geodrake` command: compare, diagnose, add, explain, identify, demo."""

from geodrake.cli.interruption import interruptible

__all__ = ["main"]


def main() -> None:
    """Run the command; what stops it is said in a word, even while it is still being imported."""
    with interruptible():
        from geodrake.cli.app import main as run

        run()
