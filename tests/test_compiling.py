"""Compiled loops are kept on disk, shared by processes, and compiled anew after changes."""

import fcntl
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from geodrake import compiling

ROOT = Path(__file__).parents[1]


def test_without_room_it_is_compiled_all_the_same(monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(compiling.tempfile, "NamedTemporaryFile", full)
    assert compiling.compiled(lambda x: x + 1.0)(1.0) == 2.0


def keep_in(folder, monkeypatch):
    """Let Numba store compiled code in a folder; it reads its variables again when they change."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    monkeypatch.setattr(compiling.config, "CACHE_DIR", str(folder))


@pytest.fixture
def kept(monkeypatch, tmp_path):
    """Return a function that was compiled and stored, and its file."""
    folder = tmp_path / "kept"
    folder.mkdir(mode=0o700)
    keep_in(folder, monkeypatch)

    def function(x):
        return x + 1.0

    def again():
        """Return the function, and how often it is found."""
        dispatcher = compiling.compiled(function)
        assert dispatcher(1.0) == 2.0
        return sum(dispatcher.stats.cache_hits.values())

    assert again() == 0
    (file,) = folder.rglob("*.nbc")
    assert again() == 1
    return again, file


def test_what_is_kept_no_other_user_can_write_whatever_the_umask(kept):
    again, file = kept
    file.unlink()
    before = os.umask(0)
    try:
        assert again() == 0
    finally:
        os.umask(before)
    assert file.stat().st_mode & 0o777 == 0o644
    assert again() == 1


def test_what_another_process_compiles_is_waited_for(kept):
    again, file = kept
    aside = file.rename(file.with_suffix(".aside"))
    lock = file.with_suffix(".lock").open("wb")
    fcntl.flock(lock, fcntl.LOCK_EX)

    def compiled():
        aside.rename(file)
        lock.close()

    threading.Timer(0.2, compiled).start()
    assert again() == 1
    assert not file.with_suffix(".lock").exists()


def others_can_write(file, monkeypatch):
    file.chmod(0o666)


def group_can_write(file, monkeypatch):
    file.chmod(0o664)


def is_a_link(file, monkeypatch):
    file.rename(file.with_suffix(".real"))
    file.symlink_to(file.with_suffix(".real"))


def is_a_pipe(file, monkeypatch):
    file.unlink()
    os.mkfifo(file)


def is_of_another_user(file, monkeypatch):
    owner = os.geteuid() or 12345
    if os.geteuid() == 0:
        os.chown(file, owner, owner)
    else:
        monkeypatch.setattr(compiling.os, "geteuid", lambda: owner + 1)


@pytest.mark.parametrize(
    "spoil", [others_can_write, group_can_write, is_a_link, is_a_pipe, is_of_another_user]
)
def test_a_kept_file_that_others_may_have_written_is_not_read(kept, monkeypatch, spoil):
    again, file = kept
    spoil(file, monkeypatch)
    monkeypatch.setattr(compiling.pickle, "loads", lambda data: pytest.fail("it is unpickled"))
    assert again() == 0


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o1777])
def test_a_folder_that_others_can_write_keeps_nothing(monkeypatch, tmp_path, mode):
    for name in ("asked", "home"):
        (tmp_path / name).mkdir()
    keep_in(tmp_path / "asked", monkeypatch)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    place = Path(compiling.compiled(lambda x: x)._cache.cache_path)
    assert place.is_relative_to(tmp_path / "asked")
    place.chmod(mode)
    assert not Path(compiling.compiled(lambda x: x)._cache.cache_path).is_relative_to(tmp_path)
    places = compiling._places
    elsewhere = lambda path: [each for each in places(path) if each[0].name != "__pycache__"]  # noqa: E731
    monkeypatch.setattr(compiling, "_places", elsewhere)
    place = Path(compiling.compiled(lambda x: x)._cache.cache_path)
    assert place.is_relative_to(tmp_path / "home")
    assert place.stat().st_mode & 0o777 == 0o700


def test_without_a_place_for_a_cache_it_is_compiled_all_the_same(monkeypatch):
    monkeypatch.setattr(compiling, "_places", lambda path: [])
    assert compiling.compiled(lambda x: x + 1.0)(1.0) == 2.0


def test_what_another_compiler_made_is_not_used(monkeypatch):
    def function(x):
        return x

    def digest():
        compiling.compiled(function)
        return compiling._SOURCES[function]

    first = digest()
    assert digest() == first
    monkeypatch.setattr(compiling, "numba_version", "another")
    assert digest() != first


def test_divisions_by_zero_are_infinite():
    assert compiling.compiled(lambda x: 1.0 / x)(0.0) == np.inf


@pytest.mark.parametrize("nothing", [None, "NUMBA_DISABLE_JIT"])
def test_a_compiler_that_is_absent_or_refuses_is_a_clear_error(nothing, tmp_path):
    (tmp_path / "numba.py").write_text("raise ImportError('no such wheel')\n", "utf-8")
    other = {nothing: "1"} if nothing else {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    done = subprocess.run(
        [sys.executable, "-m", "geodrake", "compare", "models/double_pendulum.urdf", "a.csv"],
        env={**os.environ, "PYTHONPATH": str(ROOT), **other},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "geodrake needs Numba" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("command", [["-m", "geodrake", "--help"], ["-c", "import geodrake"]])
def test_what_computes_nothing_imports_no_compiler(command):
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *command],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "numpy" not in done.stderr and "numba" not in done.stderr
