"""Compiled loops: kept on disk, shared by processes, made anew when a file of theirs changes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from geodrake import compiling

ROOT = Path(__file__).parents[1]
EFFORT = (
    "import numpy as np\n"
    "from geodrake import load_model\n"
    "from geodrake.compiling import while_compiling\n"
    "from geodrake.robot.regressor import inverse_dynamics\n"
    f"model = load_model({str(ROOT / 'models' / 'double_pendulum.urdf')!r})\n"
    "told = []\n"
    "with while_compiling(lambda: told.append('begins'), lambda: told.append('ends')):\n"
    "    effort = inverse_dynamics(model.tree, *np.ones((3, 1, 2)), model.phi)\n"
    "print(effort.tolist(), ','.join(told) or 'nothing')\n"
)


def started(cache, **environment):
    """A process that computes an effort, with a folder for what it compiles."""
    own = {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)}
    return subprocess.Popen(
        [sys.executable, "-c", EFFORT],
        env={**os.environ, **own, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def two_at_once(tmp_path_factory):
    """What two processes say that compile at once, and their folder."""
    folder = tmp_path_factory.mktemp("compiled")
    both = [started(folder), started(folder)]
    return folder, [process.communicate(timeout=120) for process in both]


def test_two_processes_that_compile_at_once_do_no_harm(two_at_once):
    folder, outputs = two_at_once
    assert [error for _, error in outputs] == ["", ""]
    assert [out.split()[-1] for out, _ in outputs] == ["begins,ends"] * 2
    again, _ = started(folder).communicate(timeout=120)
    assert again.split() == [*outputs[0][0].split()[:-1], "nothing"]


def test_what_was_cut_off_is_compiled_anew(two_at_once, tmp_path):
    folder, outputs = two_at_once
    spoiled = shutil.copytree(folder, tmp_path / "spoiled")
    for path in spoiled.rglob("*.nbc"):
        path.write_bytes(path.read_bytes()[:40])
    out, error = started(spoiled).communicate(timeout=120)
    assert (out, error) == (outputs[0][0], "")


def test_without_room_it_is_compiled_all_the_same(monkeypatch, tmp_path):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(compiling.caching.FunctionCache, "save_overload", full)
    assert compiling.compiled(lambda x: x + 1.0)(1.0) == 2.0


def test_without_a_place_for_a_cache_it_is_compiled_all_the_same(monkeypatch):
    def nowhere(*arguments):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(compiling.caching.FunctionCache, "__init__", nowhere)
    assert compiling.compiled(lambda x: x + 1.0)(1.0) == 2.0


SOURCE = """
import sys
from geodrake.compiling import compiled, inlined
FACTOR = {factor}
@inlined
def scaled(x):
    return FACTOR * x
@compiled
def scaled_sum(x, y):
    return scaled(x) {operation} y
from geodrake.compiling import while_compiling
told = []
with while_compiling(lambda: told.append(1), lambda: None):
    print(scaled_sum(*map(eval, sys.argv[1:])), len(told))
"""


def said(folder, *, factor=2.0, operation="+", arguments=("1.0", "1.0")):
    """A result of the source with these changes, and how many functions were compiled for it."""
    path = folder / "scaled.py"
    path.write_text(SOURCE.format(factor=factor, operation=operation), "utf-8")
    os.utime(path, (1e9, 1e9))  # as files of one size that are written within a second
    done = subprocess.run(
        [sys.executable, "-B", "-m", "scaled", *arguments],
        env={**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_what_is_kept_is_used_as_long_as_all_that_it_came_from_stays(tmp_path):
    assert said(tmp_path) == ["3.0", "1"]
    assert said(tmp_path) == ["3.0", "0"]
    assert said(tmp_path, operation="-") == ["1.0", "1"]
    assert said(tmp_path, factor=4.0) == ["5.0", "1"]  # a constant


def test_every_signature_has_a_file_of_its_own(tmp_path):
    whole = ("1", "1")
    assert (said(tmp_path)[1], said(tmp_path, arguments=whole)[1]) == ("1", "1")
    assert len([*tmp_path.rglob("*scaled_sum*.nbc")]) == 2
    assert (said(tmp_path)[1], said(tmp_path, arguments=whole)[1]) == ("0", "0")


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
