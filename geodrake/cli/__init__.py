"""The `geodrake` command line."""

from geodrake.cli.interruption import interruptible

__all__ = ["main"]


def main() -> None:
    """Run the command. Interrupts end it with one word, even during imports."""
    with interruptible():
        from geodrake.cli.app import main as run

        run()
