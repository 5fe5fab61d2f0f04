"""Folders, disks, settings, streams and terminals of commands, and signals."""

import errno
import fcntl
import itertools
import os
import pty
import re
import resource
import shlex
import shutil
import signal
import stat
import sys
import time
from itertools import product
from pathlib import Path

import pytest
from hostile import KEPT, PASSING, Row, changed, contents, read_json
from processes import PACKAGES, PATIENCE, ended, run_forked, run_here, start

from geodrake.boundary import whole_files
from geodrake.cli import command, explaining

ALL = ["--save", "kept.yaml", "--json", "kept.json", "--report", "kept.html"]
COMPARE = ["compare", "robot.urdf", "log.csv", *ALL]
NEW = [*COMPARE[:-1], "new.html"]
EXPLAIN = ["explain", "robot.urdf", "log.csv"]
GEODRAKE = f"{shlex.quote(sys.executable)} -m geodrake"
BAD = b"foo: bar\nfont.size: x\n"
SETTINGS = {
    "no home, no such backend, no folder for passing files, the locale C, poor terminal": (
        {"HOME": None, "MPLBACKEND": "nonsense", "TMPDIR": "/none", "LC_ALL": "C", "LANG": None}
        | {"PYTHONUTF8": None, "TERM": "dumb", "COLUMNS": "10"},
        {},
    ),
    "no writable home, a backend with windows, no such locale, TeX, no terminal, ASCII": (
        {"HOME": "/proc/none", "MPLBACKEND": "tkagg", "DISPLAY": None, "LC_ALL": "xx_YY.UTF-8"}
        | {"MATPLOTLIBRC": "rc", "TERM": None, "COLUMNS": "0", "PYTHONIOENCODING": "ascii"},
        dict.fromkeys(("matplotlibrc", "rc"), "text.usetex: True\n"),
    ),
    "a home that is no folder, settings that are none, no columns, colours, strict ASCII": (
        {"HOME": "home", "XDG_CACHE_HOME": "home", "MATPLOTLIBRC": "rc", "COLUMNS": "many"}
        | {"LINES": "-1", "FORCE_COLOR": "", "NO_COLOR": "1", "PYTHONIOENCODING": "ascii:strict"},
        {"home": "not a folder", **dict.fromkeys(("matplotlibrc", "rc"), BAD)},
    ),
}
"""Wrong settings, several in a row, as each row starts Python and Drake."""


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", SETTINGS)
def test_settings(what, tmp_path):
    environment, make = SETTINGS[what]
    command, files = "compare robot.urdf log.csv", ("new.json", "new.html")
    command += " --json new.json --report new.html"
    Row(what, command, make=make, code=0, writes=files, environment=environment).check(tmp_path)


def test_a_removed_working_directory(filled):
    leave = "import os\nos.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')"
    run = started(["compare", str(filled / "robot.urdf"), "log.csv"], leave)
    assert ended(run) == (
        2,
        "",
        "Error: The working directory cannot be used: No such file or directory. "
        "Change to one that exists.\n",
    )


def test_a_narrow_terminal_shows_no_control_characters(filled, monkeypatch):
    """A terminal gets only the sequences of the progress bar and of bold letters."""
    log, blocks = "\x1b]0;owned\x07\x9bx.csv", []
    (filled / "log.csv").rename(log)
    monkeypatch.setenv("COLUMNS", "10")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("PYTHONPATH", PACKAGES)

    def read(terminal):
        blocks.append(os.read(terminal, 65536))
        return blocks[-1]

    status = pty.spawn([sys.executable, "-m", "geodrake", "compare", "robot.urdf", log], read)
    shown = b"".join(blocks).decode("utf-8", "replace")
    assert status == 0, shown
    assert not re.search("[\x07\x9b]|\x1b[^\\[]", shown)
    assert set(re.findall(r"\x1b\[[0-9;?]*(.)", shown)) <= set("mhlKAG")
    assert "owned" in shown.replace("\r\n", "")


DISK = OSError(errno.EIO, "Input/output error")


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("number", "error"), [*product((1, 2, 3), (DISK, KeyboardInterrupt()))])
def test_if_one_file_cannot_be_renamed_none_is_written(filled, monkeypatch, number, error):
    rename, numbers = whole_files._Part.rename, itertools.count(1)

    def failing(part):
        if next(numbers) == number:
            raise error
        rename(part)

    monkeypatch.setattr(whole_files._Part, "rename", failing)
    before = contents(filled)
    code, out, err = run_here(COMPARE)
    is_disk = error is DISK
    assert (code, out) == (2 if is_disk else 130, "")
    assert "Input/output error" in err if is_disk else err == "Interrupted.\n"
    assert contents(filled) == before


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [("new.html", Path.mkdir, "is a folder"), ("robot.urdf", Path.unlink, "is missing")],
)
def test_changes_during_the_work_are_noticed_before_files_are_written(
    name, change, says, filled, monkeypatch
):
    to_json = command.to_json

    def meanwhile(numbers):
        change(filled / name)
        return to_json(numbers)

    monkeypatch.setattr(command, "to_json", meanwhile)
    before = contents(filled)
    code, _, err = run_here(NEW)
    assert code == 2
    assert says in err
    assert changed(before, contents(filled)) == {name}


def test_permissions_stay_and_links_are_written_through(filled):
    (filled / "there").mkdir()
    (filled / "kept.json").rename(filled / "there" / "real.json")
    (filled / "kept.json").symlink_to("there/real.json")
    (filled / "new.html").symlink_to("there/later.html")
    modes = {"kept.yaml": 0o640, "there/real.json": 0o604}
    for name, mode in modes.items():
        (filled / name).chmod(mode)
    code, _, err = run_here(NEW)
    assert code == 0, err
    for name, mode in modes.items():
        assert stat.S_IMODE((filled / name).stat().st_mode) == mode
    assert (filled / "kept.json").readlink() == Path("there/real.json")
    assert read_json(filled / "there" / "real.json")["command"] == "compare"
    assert (filled / "new.html").readlink() == Path("there/later.html")
    assert (filled / "there" / "later.html").is_file()
    assert sorted(p.name for p in (filled / "there").iterdir()) == ["later.html", "real.json"]


def test_only_remains_of_killed_runs_are_removed(filled):
    ours = [".kept.json.123.part", ".kept.json.99999999.part"]
    theirs = [".kept.json.part", ".kept.json.x1.part", ".kept.jsonl.1.part", "kept.json.1.part"]
    theirs += [".kept.json.5.part.json", ".kept.yaml.77.part"]
    for name in [*ours, *theirs]:
        (filled / name).write_text("half", encoding="utf-8")
    with (filled / ".kept.json.456.part").open("wb") as written:
        fcntl.flock(written, fcntl.LOCK_EX)  # as whoever writes it does
        code, _, err = run_here(["compare", "robot.urdf", "log.csv", "--json", "kept.json"])
    assert code == 0, err
    left = sorted(p.name for p in filled.iterdir() if ".part" in p.name)
    assert left == sorted([*theirs, ".kept.json.456.part"])


def test_a_full_disk_leaves_files_as_they_were(filled):
    before = contents(filled)

    def begin():
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as Python does when it starts

    code, _, err = run_forked(COMPARE, begin)
    assert code == 2
    assert err == "Error: Cannot write kept.html: File too large. Choose another place.\n"
    assert contents(filled) == before


NUMBERS = "compare robot.urdf log.csv --json"
OUTPUTS = {
    "tables to a full disk": ("compare robot.urdf log.csv > /dev/full", 2, "No space left"),
    "numbers to a full disk": (f"{NUMBERS} - --quiet > /dev/full", 2, "No space"),
    "help to a full disk": ("--help > /dev/full", 2, "No space left"),
    "nobody to read tables": ("compare robot.urdf log.csv | true", 141, ""),
    "nobody to read numbers": (f"{NUMBERS} - 2> /dev/null | true", 141, ""),
    "closed output": ("compare robot.urdf log.csv >&-", 0, ""),
    "closed input": ("compare robot.urdf log.csv <&- > /dev/null", 0, ""),
    "closed errors": ("compare robot.urdf log.csv 2>&- > /dev/null", 0, ""),
    "a full disk for errors": ("no-such-command 2> /dev/full", 2, ""),
    "everything closed": (f"{NUMBERS} new.json <&- >&- 2>&-", 0, ""),
}


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.sampled(4)
@pytest.mark.parametrize("what", OUTPUTS)
def test_standard_streams(what, filled):
    command, code, says = OUTPUTS[what]
    run = start(["bash", "-o", "pipefail", "-c", f"{GEODRAKE} {command}"])
    ended_with, _, err = ended(run)
    assert ended_with == code, err
    told = [line for line in err.splitlines() if not PASSING.fullmatch(line)]
    assert bool(told) == bool(says) and says in "".join(told[-1:]), err
    if "new.json" in command:
        assert read_json(filled / "new.json")["command"] == "compare"
    assert not re.search("Traceback|Exception", err)


INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
SIGNALS = {
    INT: (130, "", "Interrupted.\n"),
    TERM: (143, "", "Terminated.\n"),
    HUP: (129, "", "Hung up.\n"),
}


def started(arguments, code=""):
    """Start a command in a new process, after some code, with a folder for temporary files."""
    (passing := Path("passing").absolute()).mkdir()
    # Jobs of a shell in the background ignore interrupts, and so do their children.
    heard = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)"
    program = f"{heard}\n{code}\nfrom geodrake.cli import main\nmain()"
    return start([sys.executable, "-c", program, *arguments], TMPDIR=str(passing))


def worked(run, seconds):
    """Wait until a process ends or has used some seconds of CPU time."""
    clock, told = os.sysconf("SC_CLK_TCK"), Path(f"/proc/{run.pid}/stat")
    if not told.exists():  # no Linux
        time.sleep(seconds)
        return
    while run.poll() is None:
        said = told.read_text().rpartition(")")[2].split()
        if (int(said[11]) + int(said[12])) / clock >= seconds:
            return
        time.sleep(0.01)


def others(before):
    """Return the names of files that have changed."""
    return changed(before, contents(Path())) - {"passing"}


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("seconds", "number"), [*product((1.5, 0.4), SIGNALS)])
def test_a_signal_at_any_time_prints_one_line(number, seconds, filled):
    before = contents(filled)
    run = started([*EXPLAIN, *ALL])
    worked(run, seconds)
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


def kill_self(*numbers):
    for number in numbers:
        os.kill(os.getpid(), number)


@pytest.mark.parametrize("at", [1, 3])
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


def test_an_interrupt_in_a_destructor_is_repeated(filled):
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
