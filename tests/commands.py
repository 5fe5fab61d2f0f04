"""Commands in this process: their output on success, and their message on an error."""

import re

from typer.testing import CliRunner

from geodrake.cli.app import app


def run(*arguments, **settings):
    """Return the result of a command."""
    return CliRunner().invoke(app, [str(each) for each in arguments], **settings)


def told(*arguments):
    """Return the output of a command that succeeds, with single blanks."""
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    return " ".join(result.output.split())


def refused(*arguments, code=2):
    """Return the message of a command that fails: one line, and nothing on standard output."""
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (code, ""), result.output
    # Warnings come before, and a busy machine is told every five seconds what is done.
    other = re.compile(r"Warning: | \(\d+ s\)$")
    lines = [line for line in result.stderr.splitlines() if not other.search(line)]
    assert len(lines) == 1 or lines[0].startswith("Usage"), result.stderr
    return result.stderr


def contents(folder):
    """Return the contents of all files in a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
