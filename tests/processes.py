"""Commands in this process, in a copy of it or in a new one, all with time limits.

Limits count CPU time, which does not depend on the load of the machine, and wall-clock time where
a process may wait forever.
"""

import os
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import warnings
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path

from typer.testing import CliRunner

import geodrake
from geodrake.cli import main
from geodrake.cli.app import app

PACKAGES = str(Path(geodrake.__file__).parents[1])
"""Where a process finds the same geodrake as this one, with all that is compiled."""
SECONDS = 30  # of the processor, which no command may take longer
PATIENCE = 300  # seconds by the clock, for what waits for ever; a busy machine takes long, too
INTERNAL = 70  # exit code of a copy that never came to its command


class HangError(BaseException):
    """Raised if a command does not end; no handler of errors may catch it."""


@contextmanager
def time_limit(what, seconds=SECONDS):
    """Raise a HangError if this process takes longer, or waits forever."""

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
    """Let the system end this process if it takes longer."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))


def limited(process, seconds):
    """Return a new process, which the system ends after some CPU time.

    Waiting takes no CPU time. Without `prlimit` there is no limit.
    """
    if hasattr(resource, "prlimit"):
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (seconds, seconds))
    return process


def run_here(arguments):
    """Return exit code, standard output and standard error of a command in this process."""
    with time_limit(shlex.join(["geodrake", *arguments])):
        result = CliRunner().invoke(app, arguments)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def run_forked(arguments, begin=lambda: None):
    """Return the same of a command in a copy of this process, after a call of `begin`.

    A negative exit code is the signal that ended it.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        copy = get_context("fork").Process(target=_become, args=(arguments, out, err, begin))
        with warnings.catch_warnings():
            # pytest-xdist has a thread, of which the copy needs nothing.
            warnings.filterwarnings("ignore", r"This process .* is multi-threaded")
            copy.start()
        copy.join(PATIENCE)
        if copy.is_alive() or copy.exitcode == -signal.SIGXCPU:
            copy.kill()
            raise HangError(f"geodrake {shlex.join(arguments)} has not ended")
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode("utf-8", errors="replace"))
    return copy.exitcode, *texts


def _become(arguments, out, err, begin):
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


def run_started(arguments, variables):
    """Return the same of a command in a new process with further environment variables."""
    return ended(start([sys.executable, "-m", "geodrake", *arguments], **variables))


def start(command, *, folder=None, seconds=SECONDS, **variables):
    """Start a process that finds the same geodrake, with other variables; None removes one."""
    found = {**os.environ, "PYTHONPATH": PACKAGES, "MPLBACKEND": "Agg", **variables}
    process = subprocess.Popen(
        command,
        cwd=folder,
        env={name: value for name, value in found.items() if value is not None},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
    )
    return limited(process, seconds)


def ended(process):
    """Return exit code, standard output and standard error of a process that was started."""
    out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, err
