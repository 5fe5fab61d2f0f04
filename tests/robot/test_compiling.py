"""Compiled loops: kept on disk, shared by processes, and made anew when a helper changes."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from geodrake.robot import compiling, recursion

ROOT = Path(__file__).parents[2]
EFFORT = (
    "import numpy as np\n"
    "from geodrake import load_model\n"
    "from geodrake.robot.compiling import while_compiling\n"
    "from geodrake.robot.regressor import inverse_dynamics\n"
    f"model = load_model({str(ROOT / 'models' / 'double_pendulum.urdf')!r})\n"
    "told = []\n"
    "with while_compiling(lambda: told.append(1), lambda: None):\n"
    "    effort = inverse_dynamics(model.tree, *np.ones((3, 1, 2)), model.phi)\n"
    "print(effort.tolist(), bool(told))\n"
)


def started(cache):
    """A process that computes an effort, with a folder for what it compiles."""
    return subprocess.Popen(
        [sys.executable, "-c", EFFORT],
        env={**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_two_processes_that_compile_at_once_do_no_harm(tmp_path):
    both = [started(tmp_path), started(tmp_path)]
    outputs = [process.communicate(timeout=120) for process in both]
    assert [error for _, error in outputs] == ["", ""]
    assert [out.split()[-1] for out, _ in outputs] == ["True", "True"]
    again, _ = started(tmp_path).communicate(timeout=120)
    assert again == outputs[0][0].replace("True", "False") == outputs[1][0].replace("True", "False")


def test_without_a_place_for_a_cache_it_is_compiled_all_the_same(monkeypatch):
    def nowhere(*functions, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return numba.njit(*functions, **options)

    monkeypatch.setattr(compiling, "njit", nowhere)
    assert compiling.compiled(lambda x: x + 1.0)(1.0) == 2.0


def test_a_change_of_any_kernel_s_file_is_seen():
    names = [name for name, _, _ in compiling._sources()]
    assert {"joints.py", "recursion.py", "vectors.py"} <= set(names)
    stamp = recursion.calc_regressor._cache._cache_file._source_stamp
    assert stamp[1] == compiling._sources()


def test_compiling_is_told():
    told = []
    with compiling.while_compiling(lambda: told.append("begins"), lambda: told.append("ends")):
        assert compiling.compiled(lambda x: 2.0 * x)(1.5) == 3.0
    assert told[0] == "begins" and told[-1] == "ends"


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
