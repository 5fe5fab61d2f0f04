"""Commands in this process: what they say where they succeed, and the line where they do not."""

import re

from typer.testing import CliRunner

from geodrake.cli.app import app


def run(*arguments, **settings):
    """The result of a command, whatever it is."""
    return CliRunner().invoke(app, [str(each) for each in arguments], **settings)


def told(*arguments):
    """All that a command says that succeeds, with single blanks."""
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    return " ".join(result.output.split())


def refused(*arguments, code=2):
    """What a command says that ends with an error: one line, and nothing on standard output."""
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (code, ""), result.output
    # Warnings come before, and a busy machine is told every five seconds what is done.
    other = re.compile(r"Warning: | \(\d+ s\)$")
    lines = [line for line in result.stderr.splitlines() if not other.search(line)]
    assert len(lines) == 1 or lines[0].startswith("Usage"), result.stderr
    return result.stderr


def contents(folder):
    """All that is in a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
