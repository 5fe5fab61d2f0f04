"""`python -m geodrake`, equivalent to the `geodrake` command."""

from geodrake.cli import main

if __name__ == "__main__":
    main()
