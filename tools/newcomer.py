"""Go a newcomer's way: a fresh environment, and all commands of README and tutorial.

    python tools/newcomer.py [--keep FOLDER]

It clones the last commit, installs it as README says, and runs every command and all lines of
Python in the order of the pages, to the letter, on an arm whose truth is known. The first one that
fails ends it. Commands of other programs, such as ros2, are left out and named.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import venv
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/tutorial.md")
_LOGS = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from tutorial_files import write_files
write_files(Path(sys.argv[2]))
"""


@dataclass(frozen=True)
class Step:
    """A command of a page, or lines of Python."""

    page: str
    kind: str
    text: str


def steps(page: str) -> list[Step]:
    """Return what a page tells to run, in its order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = []
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```", text, re.M | re.S):
        if language == "python":
            found.append(Step(page, "python", block))
        elif language == "":
            lines = [line for line in block.splitlines() if _is_command(line)]
            found += [Step(page, "command", line) for line in lines]
    return found


def _is_command(line: str) -> bool:
    return line.split(" ", maxsplit=1)[0] in ("pip", "geodrake", "python", "ros2")


def main() -> int:
    """Run all steps; return the number of those that failed, at most one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--keep", type=Path, help="Work in this new folder, and keep it.")
    keep = parser.parse_args().keep
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if keep is None else keep.resolve()
        return int(not _runs(folder))


def _runs(folder: Path) -> bool:
    """Whether all steps end well in a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    clone, work, fresh = folder / "geodrake", folder / "work", folder / "fresh"
    subprocess.run(["git", "clone", "-q", ROOT, clone], check=True)
    venv.create(fresh, with_pip=True)
    work.mkdir()
    for page in PAGES:
        for step in steps(page):
            installs = step.text.startswith("pip install")
            if step.text.startswith("ros2") or "pytest" in step.text:
                print(f"left out: {step.text}", flush=True)
                continue
            print(f"{step.page}: {step.text.splitlines()[0]}", flush=True)
            if not _ends_well(step, clone if installs else work, fresh):
                print(f"FAILED: {step.text}")
                return False
            if installs:
                logs = [fresh / "bin" / "python", "-c", _LOGS, ROOT / "tools", work]
                subprocess.run(logs, check=True)
    print("All steps ended well.")
    return True


def _ends_well(step: Step, folder: Path, fresh: Path) -> bool:
    activate = f"set -e; . {fresh}/bin/activate; "
    command = ["bash", "-c", activate + (step.text if step.kind == "command" else "exec python -")]
    given = step.text if step.kind == "python" else ""
    return subprocess.run(command, cwd=folder, input=given, text=True, check=False).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
