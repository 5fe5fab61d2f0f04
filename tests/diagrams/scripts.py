"""Scripts of `diagrams/`, as a user starts them or called in this process."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from processor_time import limited

import geodrake

ROOT = Path(__file__).parents[2]
PACKAGES = str(Path(geodrake.__file__).parents[1])  # with all that is compiled
FOLDER = ROOT / "diagrams"


def start(name, *arguments):
    """Runs a script in a process of its own; its exit code, and what it printed."""
    process = subprocess.Popen(
        [sys.executable, str(FOLDER / f"{name}.py"), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": PACKAGES, "PYTHONWARNINGS": "error"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    out, err = limited(process, 300).communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def call(name, *arguments):
    """Runs a script in this process, which has Python and Drake at hand; errors are raised."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        patch.setenv("PYTHONPATH", PACKAGES)  # for what a script measures in processes
        patch.setattr(sys, "argv", [f"{name}.py", *map(str, arguments)])
        import_module(name).main()
