"""Rows of the tables in this folder: a command with bad input, and its end.

Each command runs in a folder of good files: `robot.urdf`, `log.csv`, `other.csv`, and the older
`kept.yaml`, `kept.json` and `kept.html`. It must end in time, with the exit code and the words of
its row, and without a traceback, a control character on the terminal, or a number that is not
finite. A command that fails leaves every file as it was.
"""

import json
import os
import re
import shlex
import stat
from collections.abc import Callable, Mapping
from contextlib import chdir
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from pendulum_logs import PENDULUM, body_effort
from processes import run_forked, run_here, run_started

HEADER = "time,shoulder.position,elbow.position,shoulder.effort,elbow.effort"
KEPT = {"kept.yaml": "from before\n", "kept.json": "{}\n", "kept.html": "<p>from before</p>\n"}
PASSING = re.compile(
    r".* \(\d+ s\)|Warning: .* was repaired\. .*"
)  # of work that takes long, and of repairs

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\u2028\u2029]")
_NO_NUMBER = re.compile(r"(?<![\w.'\"])[-+]?(nan|inf)(?![\w'\"])")


Files = Mapping[str, str | bytes | Callable[[Path], object]]
"""Name of a file -> its content, or a function that creates it."""


@dataclass(frozen=True)
class Row:
    """One command, and how it must end.

    Attributes:
        name: The input in words.
        command: The words after `geodrake`, as typed in a shell in the folder.
        says: Words that must be printed; on standard error if the command fails.
        make: The input: files, or a function that creates them in the folder.
        code: Exit code; None for 0 or 2.
        writes: Files that the command writes, None for any. One that fails writes at most a
            proposed mapping.
        apart: Whether it runs in a copy of this process, as it might end the process.
        environment: Variables of that copy or of a new process; None removes one.
    """

    name: str
    command: str
    says: tuple[str, ...] = ()
    make: Files | Callable[[Path], object] = field(default_factory=dict)
    code: int | None = 2
    writes: tuple[str, ...] | None = ()
    apart: bool = False
    environment: Mapping[str, str | None] = field(default_factory=dict)

    def __str__(self):
        return self.name

    def run(self):
        """Return exit code, standard output and standard error of the command."""
        arguments = shlex.split(self.command)
        if self.apart:
            return run_forked(arguments, lambda: os.environ.update(self.environment))
        return run_started(arguments, self.environment) if self.environment else run_here(arguments)

    def check(self, folder):
        """Run the row in an empty folder and check its end; return the folder."""
        fill(folder)
        if callable(self.make):
            self.make(folder)
        else:
            put(folder, self.make)
        before = contents(folder)
        with chdir(folder):
            code, out, err = self.run()
        expected = (0, 2) if self.code is None else (self.code,)
        assert code in expected, f"{self.name}: exit code {code}\n{out}\n{err}"
        check_words(out, err)
        if code:
            told = [line for line in err.strip().splitlines() if not PASSING.fullmatch(line)]
            assert len(told) == 1 or "Usage" in err, err
            assert out == ""
        for words in self.says:
            assert words in (err if code else out + err), f"no {words!r} in:\n{out}\n{err}"
        written = changed(before, contents(folder))
        if code:  # a mapping may be proposed for a log whose columns are not understood
            written = {name for name in written if not name.endswith(".mapping.yaml")}
        if code or self.writes is not None:
            assert written <= (set() if code else set(self.writes)), written
        for name in {"new.json", "kept.json", *(self.writes or ())} & written:
            if name.endswith(".json"):
                read_json(folder / name)
        return folder


def put(folder, files: Files):
    """Create files in a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        made = content
        while callable(made):
            made = made(path)
        if isinstance(made, str):
            made = made.replace("{folder}", str(folder)).encode()
        if isinstance(made, bytes):
            path.write_bytes(made)


def link(target):
    """Return a function that creates a link to a target."""
    return lambda path: path.symlink_to(target)


def fill(folder):
    """Create the good files."""
    logs = {"log.csv": _log_file(1), "other.csv": _log_file(2)}
    put(folder, {"robot.urdf": PENDULUM.read_bytes(), **logs, **KEPT})


@cache
def _table(seed, seconds, rate):
    """Return a motion and efforts with friction."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    rates = 2 * np.pi * np.array([0.13, 0.31, 0.53])[:, None]
    angle = rates[:, None] * time[:, None] + rng.uniform(0, 2 * np.pi, (3, 1, 2))
    swing = rng.uniform(0.3, 0.6, (3, 1, 2))
    q = (swing * np.sin(angle)).sum(0)
    v = (swing * rates[:, None] * np.cos(angle)).sum(0)
    vd = -(swing * rates[:, None] ** 2 * np.sin(angle)).sum(0)
    effort = body_effort(q, v, vd) + 0.3 * np.tanh(50.0 * v) + 0.1 * v
    effort += 0.01 * rng.standard_normal(v.shape)
    return np.column_stack([time, q, effort])


def table(*, seed=1, seconds=24.0, rate=100.0):
    """Return (N, 5) rows of a log of the pendulum, with the columns of `HEADER`."""
    return _table(seed, seconds, rate).copy()


def write_log(path, rows, header=HEADER):
    """Write rows as a CSV file."""
    path.write_bytes(csv(rows, header))
    return path


def csv(rows, header=HEADER):
    lines = [header, *(",".join(map(str, row)) for row in np.asarray(rows, object).tolist())]
    return ("\n".join(lines) + "\n").encode()


@cache
def _log_file(seed):
    return csv(table(seed=seed))


def contents(folder):
    """Return the kind and content of every path below a folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        name = os.fsdecode(path.relative_to(folder))
        if stat.S_ISLNK(status.st_mode):
            found[name] = ("link", str(path.readlink()))
        elif stat.S_ISREG(status.st_mode):
            found[name] = (oct(status.st_mode), path.read_bytes())
        elif "__pycache__" not in path.parts:
            found[name] = (oct(status.st_mode), None)
    return {name: what for name, what in found.items() if "__pycache__" not in name}


def changed(before, after):
    """Return the names of new, missing and different paths."""
    return {name for name in before.keys() | after if before.get(name) != after.get(name)}


def check_words(out, err):
    """Refuse tracebacks, control characters, and numbers that are not finite."""
    both = out + err
    assert "Traceback" not in both, f"traceback: {both}"
    assert "Internal error" not in both, f"internal error: {both}"
    assert not _CONTROL.search(both), f"control character: {both!a}"
    assert not _NO_NUMBER.search(out), f"no number: {out}"


def read_json(path):
    """Return a JSON file in which every number is finite and every null has a reason."""

    def refuse(constant):
        raise AssertionError(f"{path} holds {constant}")

    found = json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=refuse)
    nulls = found.get("nulls", {})
    assert set(_nulls(found, "")) == set(nulls), f"nulls without a reason in {path}"
    assert all(isinstance(reason, str) and reason for reason in nulls.values())
    return found


def _nulls(value, place):
    """Yield JSON pointers of all nulls."""
    if value is None:
        yield place
    pairs = value.items() if isinstance(value, dict) else ()
    for key, item in enumerate(value) if isinstance(value, list) else pairs:
        yield from _nulls(item, f"{place}/{str(key).replace('~', '~0').replace('/', '~1')}")
