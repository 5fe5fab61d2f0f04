"""Files are read and written whole, or refused."""

import errno
import os
import signal
import socket
import stat
from pathlib import Path

import numpy as np
import pytest

from geodrake.boundary import whole_files
from geodrake.boundary.input_files import regular_file
from geodrake.boundary.whole_files import (
    check_writable,
    made_folder,
    write_new,
    write_together,
    write_whole,
)
from geodrake.errors import GeodrakeError, LogError, OutputError
from geodrake.logs import JointLog, write_log


def refusal(path, **settings):
    with pytest.raises(LogError) as caught:
        regular_file(path, "log", LogError, **settings)
    assert caught.value.evidence["path"] == path
    return str(caught.value)


def test_a_file_and_a_link_to_it_are_given_back(tmp_path):
    file, link = tmp_path / "a.csv", tmp_path / "link.csv"
    file.write_text("time")
    link.symlink_to(file)
    for path in (file, link):
        assert regular_file(path, "log", LogError, largest=4) == path


def test_what_is_no_file_is_refused_without_being_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
    (tmp_path / "empty").touch()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
    for name, words in [
        ("", "is a folder, not a file"),
        ("pipe", "is a pipe, not a file"),
        ("socket", "is a socket, not a file"),
        ("/dev/zero", "is a device, not a file"),
        ("gone", "does not exist"),
        ("nowhere", "does not exist"),
        ("loop", "symbolic links"),
        ("empty/below", "Not a directory"),
        ("x" * 300, "name too long"),
        ("a\x00b", "null"),
        ("empty", "is empty"),
    ]:
        message = refusal(tmp_path / name)
        assert words in message
        assert message.startswith(f"The log {tmp_path / name} ")


def test_size_is_judged_before_reading(tmp_path):
    sparse = tmp_path / "sparse"
    with sparse.open("wb") as file:
        file.truncate(6_000_000_000)
    assert "has 6,000 MB; at most 2 MB are read" in refusal(sparse, largest=2_000_000)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_what_must_not_be_read_is_refused(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("time")
    secret.chmod(0)
    assert "Permission denied" in refusal(Path(secret))


def full(file):
    file.write(b"some")
    raise OSError(errno.ENOSPC, "No space left on device")


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


@pytest.fixture
def sticky(tmp_path, monkeypatch):
    """Return another user's file in a folder such as /tmp, where only its owner may replace it."""
    folder = tmp_path / "sticky"
    folder.mkdir()
    folder.chmod(0o1777)
    target = folder / "a.json"
    target.write_text("theirs", encoding="utf-8")
    target.chmod(0o666)
    other = os.geteuid() + 1
    monkeypatch.setattr(whole_files.os, "geteuid", lambda: other)
    return target


def test_what_is_another_users_is_refused_before_the_work_and_nothing_is_left(sticky):
    for refused in (
        lambda: check_writable(sticky),
        lambda: write_together({sticky: "mine", sticky.with_name("b.json"): "mine"}),
    ):
        with pytest.raises(OutputError, match=r"a\.json: it belongs to another user"):
            refused()
    assert files_in(sticky.parent) == ["a.json"]
    assert sticky.read_text(encoding="utf-8") == "theirs"


def test_folders_that_were_made_in_vain_go_and_others_stay(tmp_path):
    folder = tmp_path / "there" / "x" / "y"
    for written in ([], ["there/x/a"]):
        (tmp_path / "there").mkdir(exist_ok=True)
        with pytest.raises(OutputError, match="No space"), made_folder(folder):
            write_together({tmp_path / name: "whole" for name in written})
            write_together({folder / "z": full})
        assert files_in(tmp_path) == ["there", *(["there/x", *written] if written else [])]


def test_a_folder_below_a_file_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(OutputError, match="cannot be created: Not a directory"),
        made_folder(tmp_path / "file" / "x"),
    ):
        pass


def test_what_is_new_is_written_with_what_belongs_to_it_or_not_at_all(tmp_path):
    settings, data = tmp_path / "settings", tmp_path / "data"
    with pytest.raises(OutputError, match="No space"):
        write_new(settings, "mine", {data: full})
    assert files_in(tmp_path) == []
    assert write_new(settings, "mine", {data: "by mine"})
    assert not write_new(settings, "yours", {data: "by yours"})
    assert (settings.read_text("utf-8"), data.read_text("utf-8")) == ("mine", "by mine")


def test_new_files_have_the_permissions_that_the_user_wants(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "new", "{}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640


def test_a_target_whose_temporary_name_is_taken(tmp_path):
    taken = tmp_path / f".kept.{os.getpid()}.part"
    taken.mkdir()
    write_whole(tmp_path / "kept", "[]")
    assert (tmp_path / "kept").read_text(encoding="utf-8") == "[]"
    assert taken.is_dir()


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (".", "is a folder"),
        ("/dev/full", "is not a regular file"),
        ("/dev/null", "is not a regular file"),
        ("none/x.csv", "No such file"),
        ("a\0b.csv", "null"),
        ("x" * 300 + ".csv", "too long"),
        ("/proc/self/x.csv", "No such file"),
    ],
)
def test_what_cannot_be_written_is_refused(target, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for write in (lambda: write_whole(target, b"x"), lambda: check_writable(target)):
        with pytest.raises(OutputError, match=words):
            write()
    log = JointLog("l", ("j",), np.arange(3.0), np.zeros((3, 1)), np.zeros((3, 1)))
    if target.endswith(".csv"):
        with pytest.raises(GeodrakeError, match=words.replace("null", r"a\\x00b")):
            write_log(log, target)
    assert not files_in(tmp_path)


def test_content_that_cannot_be_made_leaves_what_was_there(tmp_path):
    def broken(file):
        file.write(b"half")
        raise ZeroDivisionError

    (tmp_path / "kept").write_text("before", encoding="utf-8")
    with pytest.raises(ZeroDivisionError):
        write_together({tmp_path / "new": "all", tmp_path / "kept": broken})
    assert files_in(tmp_path) == ["kept"]
    assert (tmp_path / "kept").read_text(encoding="utf-8") == "before"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_the_owner_stays(tmp_path):
    (kept := tmp_path / "kept").touch()
    os.chown(kept, 12345, 23456)
    write_whole(kept, "{}")
    assert (kept.stat().st_uid, kept.stat().st_gid) == (12345, 23456)


def test_files_are_written_where_the_callers_handler_returns(tmp_path):
    came = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))

    def content(file):
        file.write(b"new")
        if not came:
            signal.raise_signal(signal.SIGINT)

    try:
        write_together({tmp_path / "one": content, tmp_path / "two": "new"})
    finally:
        signal.signal(signal.SIGINT, before)
    assert came == [signal.SIGINT]
    assert [path.read_text() for path in tmp_path.iterdir()] == ["new", "new"]
