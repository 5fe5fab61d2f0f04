"""Scripts of `diagrams/`, as a user starts them or called in this process."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import processes
import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "diagrams"


def start(name, *arguments):
    """Runs a script in a process of its own; its exit code, and what it printed."""
    command = [sys.executable, str(FOLDER / f"{name}.py"), *map(str, arguments)]
    process = processes.start(command, seconds=300, PYTHONWARNINGS="error")
    out, err = process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def call(name, *arguments):
    """Runs a script in this process, which has Python and Drake at hand; errors are raised."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        patch.setenv("PYTHONPATH", processes.PACKAGES)  # for what a script measures in processes
        patch.setattr(sys, "argv", [f"{name}.py", *map(str, arguments)])
        import_module(name).main()
