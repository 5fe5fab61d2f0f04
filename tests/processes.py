"""Commands in this process, in a copy of it or in one of their own, all with limits of time.

Limits count the processor's seconds, of which a busy machine takes no more, and where something may
wait for ever, those of the clock, too.
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
    """A command that did not end; no handler of errors may take it for one of its own."""


@contextmanager
def time_limit(what, seconds=SECONDS):
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


def limited(process, seconds):
    """A process that was just begun, which is ended when it has worked for so long.

    What waits for nothing is not: it does not work. (Where there is no `prlimit`, nothing is.)
    """
    if hasattr(resource, "prlimit"):
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (seconds, seconds))
    return process


def run_here(arguments):
    """Exit code, standard output and standard error of a command in this process."""
    with time_limit(shlex.join(["geodrake", *arguments])):
        result = CliRunner().invoke(app, arguments)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def run_forked(arguments, begin=lambda: None):
    """The same in a copy of this process, which begins with something else.

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
    """The same in a process that is started for it, with variables of its own."""
    return ended(start([sys.executable, "-m", "geodrake", *arguments], **variables))


def start(command, *, folder=None, seconds=SECONDS, **variables):
    """A process that finds the same geodrake, with other variables; None takes one out."""
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
    """Exit code, standard output and standard error of a process that was started."""
    out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, err
