"""Input files are regular files; all else is refused before it is opened."""

import os
import socket
from pathlib import Path

import pytest

from geodrake.boundary.input_files import regular_file
from geodrake.errors import LogError


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
