"""Rows of the tables in this folder: an input that is wrong, unlucky or meant to harm, and its end.

Every row runs a command in a folder of its own that holds `robot.urdf`, `log.csv` and `other.csv`,
all in order, and `kept.yaml`, `kept.json` and `kept.html` from before. Whatever the input, the
command must end in time, with the exit code and the words of the row, without a traceback, without
calling it a bug of geodrake, without a control character on the terminal, and without a number that
is none. A command that fails leaves every file as it was.
"""

import json
import os
import re
import resource
import shlex
import signal
import stat
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

import geodrake
from geodrake.cli import main
from geodrake.cli.app import app

ROOT = Path(__file__).parents[2]
PACKAGES = Path(geodrake.__file__).parents[1]
"""Where a process finds the same geodrake as this one, with all that is compiled."""
PENDULUM = ROOT / "models" / "double_pendulum.urdf"
HEADER = "time,shoulder.position,elbow.position,shoulder.effort,elbow.effort"
KEPT = {"kept.yaml": "from before\n", "kept.json": "{}\n", "kept.html": "<p>from before</p>\n"}
SECONDS = 30  # of the processor, which no command may take longer
PATIENCE = 300  # seconds by the clock, for what waits for ever; a busy machine takes long, too
PROGRESS = re.compile(r".* \(\d+ s\)")  # what is said of work that takes long, as on a busy machine
INTERNAL = 70  # exit code of a copy that never came to its command

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\u2028\u2029]")
_NO_NUMBER = re.compile(r"(?<![\w.'\"])[-+]?(nan|inf)(?![\w'\"])")


class HangError(BaseException):
    """A command that did not end; no handler of errors may take it for one of its own."""


@contextmanager
def limited(what, seconds=SECONDS):
    """Raise a HangError if this process works for longer, or waits without an end."""

    def hang(number, _frame):
        raise HangError(f"{what} has not ended: {signal.Signals(number).name}")

    timers = {signal.SIGPROF: (signal.ITIMER_PROF, seconds)}
    timers[signal.SIGALRM] = (signal.ITIMER_REAL, PATIENCE)
    before = {number: signal.signal(number, hang) for number in timers}
    for timer, most in timers.values():
        signal.setitimer(timer, most)
    try:
        yield
    finally:
        for number, (timer, _) in timers.items():
            signal.setitimer(timer, 0)
            signal.signal(number, before[number])


def limit_own_time(seconds=SECONDS):
    """Let the system end this process, which was made for a command, when it works for longer."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))


@dataclass(frozen=True)
class Row:
    """One input, and what must become of it.

    Attributes:
        name: What the input is, in words.
        command: What follows `geodrake`, as typed in a shell in the folder.
        says: Words that must be in what is printed; on standard error if the command fails.
        make: Makes the input in the folder.
        code: Exit code; None for 0 or 2.
        writes: Files that the command writes, None for any; one that fails writes a proposed
            mapping at most, which is not named.
        apart: Whether it runs in a copy of this process, such as what once ended the process.
        environment: Variables of that copy, or else of a process that is started for it, of
            which None takes one out.
    """

    name: str
    command: str
    says: tuple[str, ...] = ()
    make: Callable[[Path], object] = lambda folder: None
    code: int | None = 2
    writes: tuple[str, ...] | None = ()
    apart: bool = False
    environment: Mapping[str, str | None] = field(default_factory=dict)

    def __str__(self):
        return self.name

    def run(self, arguments):
        """Exit code, standard output and standard error of the command."""
        if self.apart:
            return run_apart(arguments)
        return run_started(arguments, self.environment) if self.environment else run_here(arguments)

    def check(self, folder, monkeypatch):
        """Run the row in an empty folder and assert all that is promised."""
        fill(folder)
        self.make(folder)
        before = contents(folder)
        monkeypatch.chdir(folder)
        if self.apart:
            for name, value in self.environment.items():
                monkeypatch.setenv(name, value)
        code, out, err = self.run(shlex.split(self.command))
        expected = (0, 2) if self.code is None else (self.code,)
        assert code in expected, f"{self.name}: exit code {code}\n{out}\n{err}"
        check_words(out, err)
        if code:
            told = [line for line in err.strip().splitlines() if not PROGRESS.fullmatch(line)]
            assert len(told) == 1 or "Usage" in err, err
            assert out == ""
        for words in self.says:
            assert words in (err if code else out + err), f"no {words!r} in:\n{out}\n{err}"
        after = contents(folder)
        written = changed(before, after)
        if code:  # a mapping may be proposed for a log whose columns are not understood
            written = {name for name in written if not name.endswith(".mapping.yaml")}
        known = written if self.writes is None and code == 0 else set(self.writes or ())
        assert written <= known, written
        for name in written & {"new.json", "kept.json", *(self.writes or ())} if code == 0 else ():
            if name.endswith(".json"):
                read_json(folder / name)


def fill(folder):
    """Put what is in order into a folder."""
    (folder / "robot.urdf").write_bytes(PENDULUM.read_bytes())
    (folder / "log.csv").write_bytes(_log_file(1))
    (folder / "other.csv").write_bytes(_log_file(2))
    for name, text in KEPT.items():
        (folder / name).write_text(text, encoding="utf-8")


@cache
def _table(seed, seconds, rate):
    """A motion and efforts that have gravity, inertia and friction in them, in plain formulas."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    rates = 2 * np.pi * np.array([0.13, 0.31, 0.53])[:, None]
    angle = rates[:, None] * time[:, None] + rng.uniform(0, 2 * np.pi, (3, 1, 2))
    swing = rng.uniform(0.3, 0.6, (3, 1, 2))
    q = (swing * np.sin(angle)).sum(0)
    v = (swing * rates[:, None] * np.cos(angle)).sum(0)
    vd = -(swing * rates[:, None] ** 2 * np.sin(angle)).sum(0)
    effort = _efforts(q, v, vd) + 0.3 * np.tanh(50.0 * v) + 0.1 * v
    effort += 0.01 * rng.standard_normal(v.shape)
    return np.column_stack([time, q, effort])


def _efforts(q, v, vd):
    """(N, 2) of the pendulum in `models`, by the formulas of textbooks."""
    gravity, reach, coupling = 9.81, 0.2557, 0.6256 * 0.2 * 0.2557
    tip = gravity * 0.6256 * reach * np.sin(q.sum(1))
    lower, bent = 0.0099667 + 0.6256 * reach**2, coupling * np.cos(q[:, 1])
    upper = 0.01095 + (0.5235 + 0.6256) * 0.2**2
    turn = coupling * np.sin(q[:, 1])
    shoulder = (upper + lower + 2 * bent) * vd[:, 0] + (lower + bent) * vd[:, 1]
    shoulder += gravity * (0.5235 + 0.6256) * 0.2 * np.sin(q[:, 0]) + tip
    shoulder -= turn * v[:, 1] * (2 * v[:, 0] + v[:, 1])
    elbow = (lower + bent) * vd[:, 0] + lower * vd[:, 1] + turn * v[:, 0] ** 2 + tip
    return np.stack([shoulder, elbow], 1)


def table(*, seed=1, seconds=24.0, rate=100.0):
    """(N, 5) rows of a log of the pendulum, as `HEADER` has its columns."""
    return _table(seed, seconds, rate).copy()


def write_log(path, rows, header=HEADER):
    """Write rows of numbers, or of anything that has words, as a CSV file."""
    path.write_bytes(_csv(rows, header))
    return path


def _csv(rows, header=HEADER):
    lines = [header, *(",".join(map(str, row)) for row in np.asarray(rows, object).tolist())]
    return ("\n".join(lines) + "\n").encode()


@cache
def _log_file(seed):
    return _csv(table(seed=seed))


def contents(folder):
    """Every path below a folder, hidden ones too, with what it is and what is in it."""
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
    """Names of what is new, gone or different."""
    return {name for name in before.keys() | after if before.get(name) != after.get(name)}


def check_words(out, err):
    """No traceback, no excuse, no control character, no number that is none."""
    both = out + err
    assert "Traceback" not in both, f"traceback: {both}"
    assert "Internal error" not in both, f"internal error: {both}"
    assert not _CONTROL.search(both), f"control character: {both!a}"
    assert not _NO_NUMBER.search(out), f"no number: {out}"


def read_json(path):
    """A JSON file in which every number is finite, and every null has a reason."""

    def refuse(constant):
        raise AssertionError(f"{path} holds {constant}")

    found = json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=refuse)
    nulls = found.get("nulls", {})
    assert set(_nulls(found, "")) == set(nulls), f"nulls without a reason in {path}"
    assert all(isinstance(reason, str) and reason for reason in nulls.values())
    return found


def _nulls(value, place):
    """JSON pointers of all nulls."""
    if value is None:
        yield place
    pairs = value.items() if isinstance(value, dict) else ()
    for key, item in enumerate(value) if isinstance(value, list) else pairs:
        yield from _nulls(item, f"{place}/{str(key).replace('~', '~0').replace('/', '~1')}")


def run_here(arguments):
    """Exit code, standard output and standard error of a command in this process."""
    with limited(shlex.join(["geodrake", *arguments])):
        result = CliRunner().invoke(app, arguments)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def run_apart(arguments):
    """The same in a copy of this process; a negative code is the signal that ended it."""
    status, out, err = run_forked(arguments, Path.cwd())
    if status is None:
        raise HangError(f"geodrake {shlex.join(arguments)} has not ended")
    return os.waitstatus_to_exitcode(status), out, err


def run_forked(arguments, folder, begin=lambda: None):
    """Wait status (None after a hang) and output of a command in a copy of this process.

    Args:
        arguments: What follows `geodrake`.
        folder: Where it runs.
        begin: What the copy does before.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with warnings.catch_warnings():
            # pytest-xdist has a thread, of which the copy needs nothing.
            warnings.filterwarnings("ignore", r"This process .* is multi-threaded")
            process = os.fork()
        if process == 0:
            _become(arguments, folder, out, err, begin)
        end = time.monotonic() + PATIENCE
        while not (ended := os.waitpid(process, os.WNOHANG))[0] and time.monotonic() < end:
            time.sleep(0.002)
        status = ended[1]
        if not (in_time := ended[0] == process):
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
        in_time &= not (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode("utf-8", errors="replace"))
    return status if in_time else None, *texts


def _become(arguments, folder, out, err, begin):
    """Turn a forked process into one that runs the command and ends."""
    code = INTERNAL
    limit_own_time()
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for file, descriptor in ((out, 1), (err, 2)):
            os.dup2(file.fileno(), descriptor)
        sys.stdout, sys.stderr = (
            os.fdopen(descriptor, "w", encoding="utf-8", closefd=False) for descriptor in (1, 2)
        )
        os.chdir(folder)
        sys.argv = ["geodrake", *arguments]
        signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's job may ignore
        begin()
        main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        with suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def run_started(arguments, environment):
    """The same in a process that is started for it, with variables of its own."""
    variables = {**os.environ, "PYTHONPATH": str(PACKAGES), "MPLBACKEND": "Agg", **environment}
    done = subprocess.run(
        [sys.executable, "-m", "geodrake", *arguments],
        env={name: value for name, value in variables.items() if value is not None},
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        stdin=subprocess.DEVNULL,
        timeout=PATIENCE,
        preexec_fn=limit_own_time,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr
