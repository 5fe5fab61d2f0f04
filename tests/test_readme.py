"""The README's commands and lines do what it says."""

import re
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from geodrake.effects import Effect, catalogue

README = Path(__file__).parents[1] / "README.md"
TEXT = README.read_text(encoding="utf-8") if README.is_file() else ""


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.M | re.S)


def test_python_lines_print_what_is_shown(tmp_path):
    code = next(block for block in blocks("python") if "explain" in block)
    shown = TEXT.split(code)[1].split("```")[2].strip("\n")
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    wanted, found = shown.splitlines(), run.stdout.splitlines()
    numbers = r"\d+\.\d+"
    assert [re.sub(numbers, "x", line) for line in found] == [
        re.sub(numbers, "x", line) for line in wanted
    ]
    for want, got in zip(re.findall(numbers, shown), re.findall(numbers, run.stdout), strict=True):
        assert float(got) == pytest.approx(float(want), abs=2e-3)
    assert (tmp_path / "arm.yaml").is_file()


def test_own_effect_of_the_readme_is_one():
    code = next(block for block in blocks("python") if "JointEffect" in block)
    names = {}
    exec(code, names)
    assert issubclass(names["HangingHose"], Effect)


def test_table_names_every_effect():
    for effect in catalogue():
        assert f"| `{effect.name}` |" in TEXT


def test_links_lead_somewhere():
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", TEXT):
        assert (README.parent / target).is_file(), target


def test_adaptive_loop_of_the_readme_runs(tmp_path, monkeypatch):
    code = next(block for block in blocks("python") if "add_adaptive_loop" in block)
    demo = files("geodrake.demo") / "demo.urdf"
    (tmp_path / "robot.urdf").write_bytes(demo.read_bytes())
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(code, names)
    error = np.abs(names["logs"]["state"] - names["logs"]["desired_state"])[:, :6]
    assert names["time"][-1] == 4.0
    assert error[200:].max() < 0.5 * error[:100].max()
