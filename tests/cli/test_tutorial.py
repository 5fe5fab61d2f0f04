"""The commands of the tutorial, one after the other, on an arm whose truth is known."""

import re
import shlex
from pathlib import Path
from runpy import run_path

import pytest
from typer.testing import CliRunner

from geodrake.cli.app import app

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial.md"
COMMANDS = [
    line
    for block in re.findall(r"^```\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    for line in block.splitlines()
    if line.startswith("geodrake ")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with the files that the tutorial speaks of."""
    folder = tmp_path_factory.mktemp("tutorial")
    run_path(str(ROOT / "tools" / "tutorial_files.py"))["write_files"](folder)
    return folder


def test_a_newcomer_runs_all_commands_of_readme_and_tutorial():
    steps = run_path(str(ROOT / "tools" / "newcomer.py"))["steps"]
    told = [step.text for step in steps("docs/tutorial.md")]
    assert [text for text in told if text.startswith("geodrake ")] == COMMANDS
    first, *others = steps("README.md")
    assert first.text == "pip install . && geodrake demo"
    assert sum(step.kind == "python" for step in others) == 2
    assert any(step.text.startswith("geodrake explain robot.urdf log_1.csv") for step in others)


def test_commands_do_what_the_tutorial_says(folder, monkeypatch):
    monkeypatch.chdir(folder)
    told = {}
    for command in COMMANDS:
        words = shlex.split(command)[1:]
        fast = ["--seeds", "1", "--iterations", "5"] if words[0] == "excite" else []
        result = CliRunner().invoke(app, [*words, *fast, "--quiet"])
        assert result.exit_code == 0, (command, result.output)
        told.setdefault(words[0], []).append(result.output)
    first, weighed, changed = told["explain"]
    assert "coulomb_friction" in first and "viscous_friction" in first
    assert "payload" not in weighed.split("Verdict")[0]
    assert "payload" in changed and "flange" in changed
    for name in ("robot.yaml", "report.html", "motion.csv", "exported"):
        assert (folder / name).exists()
