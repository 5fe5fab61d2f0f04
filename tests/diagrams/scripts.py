"""Run scripts of `diagrams/` as a user does, or in this process."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import processes
import pytest

ROOT = Path(__file__).parents[2]

FOLDER = ROOT / "diagrams"
SCRIPTS = {path.stem: f"diagrams.{path.parent.name}.{path.stem}" for path in FOLDER.glob("*/*.py")}


def start(name, *arguments):
    """Run a script in a new process; return its exit code and output."""
    command = [sys.executable, "-m", SCRIPTS[name], *map(str, arguments)]
    here = {"PYTHONWARNINGS": "error", "PYTHONPATH": f"{ROOT}:{processes.PACKAGES}"}
    process = processes.start(command, seconds=300, **here)
    out, err = process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def call(name, *arguments):
    """Run a script in this process, where Python and Drake are loaded; errors are raised."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{ROOT}:{processes.PACKAGES}")  # of its own processes
        patch.setattr(sys, "argv", [f"{name}.py", *map(str, arguments)])
        import_module(SCRIPTS[name]).main()
