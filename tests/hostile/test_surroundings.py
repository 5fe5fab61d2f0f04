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
from itertools import product
from pathlib import Path

import matplotlib
import pytest
from hostile import KEPT, PACKAGES, PATIENCE, Row, changed, contents, fill, read_json, run_forked

from geodrake import load_model
from geodrake.boundary import whole_files
from geodrake.cli import explaining
from geodrake.diagnosis import compare
from geodrake.report import render_comparison

COMPARE = "compare robot.urdf log.csv --json new.json --report new.html"
WRITES = ("new.json", "new.html")


def settings(text):
    """Writes settings of matplotlib, where it looks for them first, and where it is told to."""

    def make(folder):
        for name in ("matplotlibrc", "rc"):
            (folder / name).write_bytes(text)

    return make


def without_home(folder):
    (folder / "home").write_text("no folder", encoding="utf-8")


TOGETHER = [
    Row(what, COMPARE, make=make, code=0, writes=WRITES, environment=environment)
    for what, environment, make in (
        (
            "no home, no such backend, no folder for passing files, the locale C, poor terminal",
            {
                **{"HOME": None, "MPLBACKEND": "nonsense", "TMPDIR": "/none"},
                **{"LC_ALL": "C", "LANG": None, "PYTHONUTF8": None},
                **{"TERM": "dumb", "COLUMNS": "10"},
            },
            lambda folder: None,
        ),
        (
            "no writable home, a backend with windows, no such locale, TeX, no terminal, ASCII",
            {
                **{"HOME": "/proc/none", "MPLBACKEND": "tkagg", "DISPLAY": None},
                **{"LC_ALL": "xx_YY.UTF-8", "MATPLOTLIBRC": "rc"},
                **{"TERM": None, "COLUMNS": "0", "PYTHONIOENCODING": "ascii"},
            },
            settings(b"text.usetex: True\n"),
        ),
        (
            "a home that is no folder, settings that are none, no columns, colours, strict ASCII",
            {
                **{"HOME": "home", "XDG_CACHE_HOME": "home", "MATPLOTLIBRC": "rc"},
                **{"COLUMNS": "many", "LINES": "-1", "FORCE_COLOR": "", "NO_COLOR": "1"},
                "PYTHONIOENCODING": "ascii:strict",
            },
            lambda folder: (
                without_home(folder),
                settings(b"foo: bar\nfont.size: x\n")(folder),
            ),
        ),
    )
]
"""What surroundings may lack or have wrong, a few at a time: each row starts Python and Drake."""
REFUSED = [
    Row(
        "files in ASCII",
        "compare robot.urdf log.csv --save kept.yaml",
        ("PYTHONUTF8=1",),
        environment={"LC_ALL": "C", "PYTHONUTF8": "0"},
    ),
]


OTHERS = [pytest.param(row, marks=pytest.mark.thorough) for row in TOGETHER[1:]]


@pytest.mark.parametrize("row", [TOGETHER[0], *REFUSED, *OTHERS], ids=str)
def test_row(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)


def python(code, folder, **more):
    """Runs code in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(PACKAGES)},
        capture_output=True,
        text=True,
        check=False,
        **more,
    )


def test_a_working_directory_that_is_gone(tmp_path):
    fill(tmp_path)
    code = (
        "import os, sys\n"
        "os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')\n"
        f"sys.argv[1:] = ['compare', {str(tmp_path / 'robot.urdf')!r}, 'log.csv']\n"
        "from geodrake.cli import main\nmain()\n"
    )
    done = python(code, tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        "Error: The working directory cannot be used: No such file or directory. "
        "Change to one that exists.\n"
    )


def test_figures_are_the_same_whatever_matplotlib_is_told(tmp_path):
    fill(tmp_path)
    found = compare(load_model(tmp_path / "robot.urdf"), [tmp_path / "log.csv"])
    words = {"title": "t", "model_name": "m", "log_names": ["l"]}
    usual = render_comparison(found, **words)
    told = {"text.usetex": True, "font.family": "monospace", "axes.grid": True, "font.size": 30}
    with matplotlib.rc_context(told):
        assert render_comparison(found, **words) == usual
        assert matplotlib.rcParams["font.size"] == 30


@pytest.mark.parametrize(
    "columns", [10, *(pytest.param(n, marks=pytest.mark.thorough) for n in (40, 200))]
)
def test_a_terminal_of_any_width_shows_no_name_raw(columns, tmp_path):
    """A terminal gets the sequences of the progress bar and of bold letters, no others."""
    fill(tmp_path)
    log = "\x1b]0;owned\x07\x9bx.csv"
    (tmp_path / "log.csv").rename(tmp_path / log)
    status, shown = in_terminal(["compare", "robot.urdf", log], tmp_path, columns)
    assert status == 0, shown
    assert not re.search("[\x07\x9b]|\x1b[^\\[]", shown)
    assert set(re.findall(r"\x1b\[[0-9;?]*(.)", shown)) <= set("mhlKAG")
    assert "owned" in shown.replace("\r\n", "")


def in_terminal(arguments, folder, columns):
    """Exit status of a command in a terminal, and all that it sent there."""
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        variables = {"PYTHONPATH": str(PACKAGES), "COLUMNS": str(columns), "TERM": "xterm-256color"}
        os.execve(
            sys.executable,
            [sys.executable, "-m", "geodrake", *arguments],
            {**os.environ, **variables},
        )
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


SIGNALS = {
    signal.SIGINT: (130, "Interrupted.\n"),
    signal.SIGTERM: (143, "Terminated.\n"),
    signal.SIGHUP: (129, "Hung up.\n"),
}
EXPLAIN = ["explain", "robot.urdf", "log.csv"]
ALL = ["--save", "kept.yaml", "--json", "kept.json", "--report", "kept.html"]


def started(arguments, folder, code=""):
    """A command in a process of its own, with temporary files in a folder of their own."""
    (folder / "passing").mkdir(exist_ok=True)
    # Jobs of a shell in the background ignore interrupts, and so do their children.
    heard = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)"
    run = "from geodrake.cli import main\nmain()"
    return subprocess.Popen(
        [sys.executable, "-c", f"{heard}\n{code}\n{run}", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(PACKAGES), "TMPDIR": str(folder / "passing")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize(
    ("number", "seconds"),
    [
        (signal.SIGINT, 1.5),
        *(pytest.param(number, 0.4, marks=pytest.mark.thorough) for number in SIGNALS),
        pytest.param(signal.SIGTERM, 1.5, marks=pytest.mark.thorough),
        pytest.param(signal.SIGHUP, 1.5, marks=pytest.mark.thorough),
    ],
)
def test_a_signal_at_any_time_leaves_a_word_alone(number, seconds, tmp_path):
    fill(tmp_path)
    (tmp_path / "passing").mkdir()
    before = contents(tmp_path)
    run = started([*EXPLAIN, *ALL], tmp_path)
    time.sleep(seconds)
    run.send_signal(number)
    out, err = run.communicate(timeout=PATIENCE)
    if run.returncode == 0:  # the machine was quick
        assert changed(before, contents(tmp_path)) == set(KEPT)
        return
    if "keeping what was found" in err:  # a search that has found something keeps it
        assert number is signal.SIGINT and run.returncode == 130
        assert read_json(tmp_path / "kept.json")["interrupted"] is True
        return
    assert (run.returncode, err.splitlines()[-1] + "\n") == SIGNALS[number]
    assert out == ""
    assert contents(tmp_path) == before


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
INT, TERM = signal.SIGINT, signal.SIGTERM


@pytest.mark.parametrize(
    ("name", "number"),
    [
        # What loads soon, by either signal; all others in a thorough run.
        ("geodrake.cli.app", INT),
        ("typer", TERM),
        ("pydrake", TERM),
        *(
            pytest.param(name, number, marks=pytest.mark.thorough)
            for name, number in product(LOADED, (INT, TERM))
            if (name, number) not in (("geodrake.cli.app", INT), ("typer", TERM), ("pydrake", TERM))
        ),
    ],
)
def test_a_signal_while_modules_load(name, number, tmp_path):
    fill(tmp_path)
    (tmp_path / "passing").mkdir()
    before = contents(tmp_path)
    hook = HOOK.format(name=name, signal=number.name)
    run = started(["compare", "robot.urdf", "log.csv", *ALL], tmp_path, hook)
    out, err = run.communicate(timeout=PATIENCE)
    assert (run.returncode, err) == SIGNALS[number]
    assert out == ""
    assert contents(tmp_path) == before


def stopped_in(folder, arguments, begin):
    """A command in a copy of this process that stops itself: exit code, standard output, errors."""
    status, out, err = run_forked(arguments, folder, begin)
    return os.waitstatus_to_exitcode(status), out, err


@pytest.mark.parametrize("at", [1, pytest.param(2, marks=pytest.mark.thorough), 3])
def test_a_signal_between_files_waits_until_all_are_there(at, tmp_path):
    def begin():
        rename, calls = Path.replace, itertools.count(1)

        def replace(self, target):
            if next(calls) == at:
                os.kill(os.getpid(), signal.SIGTERM)
                os.kill(os.getpid(), signal.SIGINT)
            return rename(self, target)

        Path.replace = replace

    fill(tmp_path)
    before = contents(tmp_path)
    code, _, err = stopped_in(tmp_path, ["compare", "robot.urdf", "log.csv", *ALL], begin)
    assert (code, err) in SIGNALS.values()
    assert changed(before, contents(tmp_path)) == set(KEPT)
    assert read_json(tmp_path / "kept.json")["command"] == "compare"


def test_a_signal_while_files_are_written_leaves_none_of_them(tmp_path):
    def begin():
        write = whole_files._Part.write

        def stopped(self, content):
            os.kill(os.getpid(), signal.SIGTERM)
            return write(self, content)

        whole_files._Part.write = stopped

    fill(tmp_path)
    before = contents(tmp_path)
    ended = stopped_in(tmp_path, ["compare", "robot.urdf", "log.csv", *ALL], begin)
    assert ended == (143, "", "Terminated.\n")
    assert contents(tmp_path) == before


def test_an_interrupt_that_nothing_can_raise_comes_again(tmp_path):
    class Gone:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000):
                pass

    def begin():
        def work(*_given, **_more):
            Gone()
            time.sleep(PATIENCE)

        explaining.investigate = work

    fill(tmp_path)
    assert stopped_in(tmp_path, EXPLAIN, begin) == (130, "", "Interrupted.\n")


@pytest.mark.thorough
def test_a_signal_that_is_to_be_ignored_is_ignored(tmp_path):
    fill(tmp_path)
    code = "import signal, os\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + HOOK.format(
        name="numpy", signal="SIGHUP"
    )
    run = started(["check", "robot.urdf", "--samples", "2", "--quiet"], tmp_path, code)
    _, err = run.communicate(timeout=PATIENCE)
    assert (run.returncode, err) == (0, "")
