"""Where a command runs: its locale, folders, settings and terminal, and what stops it."""

import itertools
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from hostile import (
    KEPT,
    PATIENCE,
    Row,
    changed,
    contents,
    environment,
    read_json,
    run_forked,
)

from geodrake.boundary import whole_files
from geodrake.cli import explaining

ALL = ["--save", "kept.yaml", "--json", "kept.json", "--report", "kept.html"]
COMPARE = ["compare", "robot.urdf", "log.csv", *ALL]
EXPLAIN = ["explain", "robot.urdf", "log.csv"]
BAD = b"foo: bar\nfont.size: x\n"
SETTINGS = {
    "no home, no such backend, no folder for passing files, the locale C, poor terminal": (
        {"HOME": None, "MPLBACKEND": "nonsense", "TMPDIR": "/none", "LC_ALL": "C", "LANG": None},
        {"PYTHONUTF8": None, "TERM": "dumb", "COLUMNS": "10"},
        {},
    ),
    "no writable home, a backend with windows, no such locale, TeX, no terminal, ASCII": (
        {"HOME": "/proc/none", "MPLBACKEND": "tkagg", "DISPLAY": None, "LC_ALL": "xx_YY.UTF-8"},
        {"MATPLOTLIBRC": "rc", "TERM": None, "COLUMNS": "0", "PYTHONIOENCODING": "ascii"},
        dict.fromkeys(("matplotlibrc", "rc"), "text.usetex: True\n"),
    ),
    "a home that is no folder, settings that are none, no columns, colours, strict ASCII": (
        {"HOME": "home", "XDG_CACHE_HOME": "home", "MATPLOTLIBRC": "rc", "COLUMNS": "many"},
        {"LINES": "-1", "FORCE_COLOR": "", "NO_COLOR": "1", "PYTHONIOENCODING": "ascii:strict"},
        {"home": "no folder", **dict.fromkeys(("matplotlibrc", "rc"), BAD)},
    ),
}
"""What surroundings may lack or have wrong, a few at a time: each row starts Python and Drake."""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", SETTINGS)
def test_settings(what, tmp_path):
    some, others, files = SETTINGS[what]
    command = "compare robot.urdf log.csv --json new.json --report new.html"
    row = Row(what, command, make=files, code=0, environment=some | others)
    replace(row, writes=("new.json", "new.html")).check(tmp_path)


def test_a_working_directory_that_is_gone(filled):
    leave = "import os\nos.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')"
    run = started(["compare", str(filled / "robot.urdf"), "log.csv"], leave)
    assert ended(run) == (
        2,
        "",
        "Error: The working directory cannot be used: No such file or directory. "
        "Change to one that exists.\n",
    )


@pytest.mark.parametrize(
    "columns", [10, *(pytest.param(n, marks=pytest.mark.thorough) for n in (40, 200))]
)
def test_a_terminal_of_any_width_shows_no_name_raw(columns, filled):
    """A terminal gets the sequences of the progress bar and of bold letters, no others."""
    log = "\x1b]0;owned\x07\x9bx.csv"
    (filled / "log.csv").rename(log)
    status, shown = in_terminal(["compare", "robot.urdf", log], columns)
    assert status == 0, shown
    assert not re.search("[\x07\x9b]|\x1b[^\\[]", shown)
    assert set(re.findall(r"\x1b\[[0-9;?]*(.)", shown)) <= set("mhlKAG")
    assert "owned" in shown.replace("\r\n", "")


def in_terminal(arguments, columns):
    """Exit status of a command in a terminal, and all that it sent there."""
    child, terminal = pty.fork()
    if child == 0:
        command = [sys.executable, "-m", "geodrake", *arguments]
        variables = environment(COLUMNS=str(columns), TERM="xterm-256color")
        os.execve(sys.executable, command, variables)
    shown = b""
    while select.select([terminal], [], [], PATIENCE)[0]:
        try:
            block = os.read(terminal, 65536)
        except OSError:  # the other end is closed
            break
        if not block:
            break
        shown += block
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), shown.decode("utf-8", "replace")


INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
SIGNALS = {
    INT: (130, "", "Interrupted.\n"),
    TERM: (143, "", "Terminated.\n"),
    HUP: (129, "", "Hung up.\n"),
}


def started(arguments, code=""):
    """A command in a process of its own, after code, with a folder for its temporary files."""
    Path("passing").mkdir()
    # Jobs of a shell in the background ignore interrupts, and so do their children.
    heard = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)"
    run = "from geodrake.cli import main\nmain()"
    return subprocess.Popen(
        [sys.executable, "-c", f"{heard}\n{code}\n{run}", *arguments],
        env=environment(TMPDIR=str(Path("passing").absolute())),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(run):
    """Exit code, standard output and standard error of a process."""
    out, err = run.communicate(timeout=PATIENCE)
    return run.returncode, out, err


def others(before):
    """Names of files that are no longer as they were."""
    return changed(before, contents(Path())) - {"passing"}


MOMENTS = [(INT, 1.5), *product(SIGNALS, (0.4,)), (TERM, 1.5), (HUP, 1.5)]


@pytest.mark.sampled(len(MOMENTS))
@pytest.mark.parametrize(("number", "seconds"), MOMENTS)
def test_a_signal_at_any_time_leaves_a_word_alone(number, seconds, filled):
    before = contents(filled)
    run = started([*EXPLAIN, *ALL])
    time.sleep(seconds)
    run.send_signal(number)
    code, out, err = ended(run)
    if code == 0:  # the machine was quick
        assert others(before) == set(KEPT)
    elif "keeping what was found" in err:  # a search that has found something keeps it
        assert number is INT and code == 130
        assert read_json("kept.json")["interrupted"] is True
    else:
        assert (code, out, err.splitlines(keepends=True)[-1]) == SIGNALS[number]
        assert not others(before)


HOOK = """
import importlib.abc, os, signal, sys
class Hook(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {name!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.{signal})
sys.meta_path.insert(0, Hook())
"""
LOADED = ("geodrake.cli.app", "typer", "numpy", "pydrake", "numba", "jinja2")


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("name", "number"), list(product(LOADED, (INT, TERM))))
def test_a_signal_while_modules_load(name, number, filled):
    before = contents(filled)
    assert ended(started(COMPARE, HOOK.format(name=name, signal=number.name))) == SIGNALS[number]
    assert not others(before)


@pytest.mark.thorough
def test_a_signal_that_is_to_be_ignored_is_ignored(filled):
    ignore = "import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    hook = ignore + HOOK.format(name="numpy", signal="SIGHUP")
    code, _, err = ended(started(["check", "robot.urdf", "--samples", "2", "--quiet"], hook))
    assert (code, err) == (0, "")


def kill_self(*numbers):
    for number in numbers:
        os.kill(os.getpid(), number)


@pytest.mark.parametrize("at", [1, pytest.param(2, marks=pytest.mark.thorough), 3])
def test_a_signal_between_files_waits_until_all_are_there(at, filled):
    def begin():
        rename, calls = Path.replace, itertools.count(1)

        def replace(self, target):
            if next(calls) == at:
                kill_self(TERM, INT)
            return rename(self, target)

        Path.replace = replace

    before = contents(filled)
    assert run_forked(COMPARE, begin)[::2] in [end[::2] for end in SIGNALS.values()]
    assert others(before) == set(KEPT)
    assert read_json("kept.json")["command"] == "compare"


def test_a_signal_while_files_are_written_leaves_none_of_them(filled):
    def begin():
        write = whole_files._Part.write

        def stopped(self, content):
            kill_self(TERM)
            return write(self, content)

        whole_files._Part.write = stopped

    before = contents(filled)
    assert run_forked(COMPARE, begin) == SIGNALS[TERM]
    assert not others(before)


def test_an_interrupt_that_nothing_can_raise_comes_again(filled):
    class Gone:
        def __del__(self):
            kill_self(INT)
            for _ in range(1000):
                pass

    def begin():
        def work(*_given, **_more):
            Gone()
            time.sleep(PATIENCE)

        explaining.investigate = work

    assert run_forked(EXPLAIN, begin) == SIGNALS[INT]
