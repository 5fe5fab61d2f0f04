"""`python -m geodrake`: the same as the `geodrake` command."""

from geodrake.cli import main

if __name__ == "__main__":
    main()
