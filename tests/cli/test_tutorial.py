"""Run the commands of the tutorial in turn, on an arm whose truth is known."""

import re
import shlex
from pathlib import Path
from runpy import run_path

from commands import told

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial.md"
COMMANDS = [
    line
    for block in re.findall(r"^```\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    for line in block.splitlines()
    if line.startswith("geodrake ")
]


def test_a_newcomer_runs_all_commands_of_readme_and_tutorial():
    steps = run_path(str(ROOT / "tools" / "newcomer.py"))["steps"]
    told = [step.text for step in steps("docs/tutorial.md")]
    assert [text for text in told if text.startswith("geodrake ")] == COMMANDS
    first, *others = steps("README.md")
    assert first.text == "pip install . && geodrake demo"
    assert sum(step.kind == "python" for step in others) == 2
    assert any(step.text.startswith("geodrake explain robot.urdf log_1.csv") for step in others)


def test_commands_do_what_the_tutorial_says(working_folder):
    run_path(str(ROOT / "tools" / "tutorial_files.py"))["write_files"](working_folder)
    said = {}
    for command in COMMANDS:
        words = shlex.split(command)[1:]
        fast = ["--seeds", "1", "--iterations", "5"] if words[0] == "excite" else []
        said.setdefault(words[0], []).append(told(*words, *fast, "--quiet"))
    first, weighed, changed = said["explain"]
    assert "coulomb_friction" in first and "viscous_friction" in first
    assert "payload" not in weighed
    assert "payload" in changed and "flange" in changed
    for name in ("robot.yaml", "report.html", "motion.csv", "exported"):
        assert (working_folder / name).exists()
