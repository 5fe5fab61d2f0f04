"""Files that cannot be written, and what was there before."""

import errno
import fcntl
import itertools
import os
import re
import resource
import shlex
import shutil
import signal
import stat
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from hostile import (
    PASSING,
    Row,
    changed,
    contents,
    environment,
    read_json,
    run_forked,
    run_here,
)

from geodrake.cli import session

COMPARE = ["compare", "robot.urdf", "log.csv"]
ALL = ["--save", "kept.yaml", "--json", "kept.json", "--report", "kept.html"]
NEW = [*ALL[:-1], "new.html"]
GEODRAKE = f"{shlex.quote(sys.executable)} -m geodrake"


def fail_at(monkeypatch, number, error):
    """Let the renaming of files fail at one of them."""
    numbers, rename = itertools.count(1), Path.replace

    def failing(self, target):
        is_target = str(self).endswith(".part") and not str(target).endswith(".part")
        if is_target and next(numbers) == number:
            raise error
        return rename(self, target)

    monkeypatch.setattr(Path, "replace", failing)


DISK = OSError(errno.EIO, "Input/output error")


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("number", "error", "links"),
    [*product((1, 2, 3), (DISK, KeyboardInterrupt()), (True,)), (3, DISK, False)],
)
def test_where_one_file_cannot_be_renamed_none_is_new(filled, monkeypatch, number, error, links):
    def no_links(*_):
        raise OSError(errno.EPERM, "Operation not permitted")

    before = contents(filled)
    if not links:  # what was there is copied
        monkeypatch.setattr(Path, "hardlink_to", no_links)
    fail_at(monkeypatch, number, error)
    code, out, err = run_here([*COMPARE, *ALL])
    is_disk = error is DISK
    assert (code, out) == (2 if is_disk else 130, "")
    assert "Input/output error" in err if is_disk else err == "Interrupted.\n"
    assert contents(filled) == before


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [("new.html", Path.mkdir, "is a folder"), ("robot.urdf", Path.unlink, "is gone")],
)
def test_what_changes_during_the_work_is_noticed_before_files_are_written(
    name, change, says, filled, monkeypatch
):
    to_json = session.to_json

    def meanwhile(numbers):
        change(filled / name)
        return to_json(numbers)

    monkeypatch.setattr(session, "to_json", meanwhile)
    before = contents(filled)
    code, _, err = run_here([*COMPARE, *NEW])
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
    code, _, err = run_here([*COMPARE, *NEW])
    assert code == 0, err
    for name, mode in modes.items():
        assert stat.S_IMODE((filled / name).stat().st_mode) == mode
    assert (filled / "kept.json").readlink() == Path("there/real.json")
    assert read_json(filled / "there" / "real.json")["command"] == "compare"
    assert (filled / "new.html").readlink() == Path("there/later.html")
    assert (filled / "there" / "later.html").is_file()
    assert sorted(p.name for p in (filled / "there").iterdir()) == ["later.html", "real.json"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write what is read-only")
def test_read_only_files_are_known_before_the_work(tmp_path):
    command = "compare robot.urdf log.csv --json x.json"
    make = {"x.json": lambda path: path.touch(0o444)}
    Row("read-only", command, ("read-only",), make).check(tmp_path)


def test_left_overs_of_killed_runs_are_removed_and_nothing_else(filled):
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


def test_a_file_that_there_is_no_room_for_leaves_what_was_there(filled):
    before = contents(filled)

    def begin():
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as Python does when it starts

    code, _, err = run_forked([*COMPARE, *ALL], begin)
    assert code == 2
    assert err == "Error: Cannot write kept.html: File too large. Choose another place.\n"
    assert contents(filled) == before


NUMBERS = "compare robot.urdf log.csv --json"
OUTPUTS = {
    "tables to a full disk": ("compare robot.urdf log.csv > /dev/full", 2, "No space left"),
    "numbers to a full disk": (f"{NUMBERS} - --quiet > /dev/full", 2, "No space"),
    "help to a full disk": ("--help > /dev/full", 2, "No space left"),
    "the version to a full disk": ("--version > /dev/full", 2, "No space left"),
    "nobody to read tables": ("compare robot.urdf log.csv | true", 141, ""),
    "nobody to read numbers": (f"{NUMBERS} - 2> /dev/null | true", 141, ""),
    "closed output": ("compare robot.urdf log.csv >&-", 0, ""),
    "closed input": ("compare robot.urdf log.csv <&- > /dev/null", 0, ""),
    "closed errors": ("compare robot.urdf log.csv 2>&- > /dev/null", 0, ""),
    "closed errors and an error": ("no-such-command 2>&-", 2, ""),
    "a full disk for errors": ("no-such-command 2> /dev/full", 2, ""),
    "everything closed": (f"{NUMBERS} new.json <&- >&- 2>&-", 0, ""),
}


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.sampled(4)
@pytest.mark.parametrize("what", OUTPUTS)
def test_standard_streams(what, filled):
    command, code, says = OUTPUTS[what]
    shell = ["bash", "-o", "pipefail", "-c", f"{GEODRAKE} {command}"]
    done = subprocess.run(shell, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    told = [line for line in done.stderr.splitlines() if not PASSING.fullmatch(line)]
    assert bool(told) == bool(says) and says in "".join(told[-1:]), done.stderr
    if "new.json" in command:
        assert read_json(filled / "new.json")["command"] == "compare"
    assert not re.search("Traceback|Exception", done.stderr)
