"""Scripts of `diagrams/`, as a user starts them or called in this process."""

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
    """Runs a script in a process of its own; its exit code, and what it printed."""
    command = [sys.executable, "-m", SCRIPTS[name], *map(str, arguments)]
    here = {"PYTHONWARNINGS": "error", "PYTHONPATH": f"{ROOT}:{processes.PACKAGES}"}
    process = processes.start(command, seconds=300, **here)
    out, err = process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def call(name, *arguments):
    """Runs a script in this process, which has Python and Drake at hand; errors are raised."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{ROOT}:{processes.PACKAGES}")  # of its own processes
        patch.setattr(sys, "argv", [f"{name}.py", *map(str, arguments)])
        import_module(SCRIPTS[name]).main()
