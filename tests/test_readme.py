"""The README's commands and lines do what it says."""

import re
import subprocess
import sys
from importlib import import_module
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from geodrake.cli.app import app
from geodrake.effects import Effect, catalogue

README = Path(__file__).parents[1] / "README.md"
TEXT = README.read_text(encoding="utf-8") if README.is_file() else ""


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.M | re.S)


def test_python_lines_print_what_is_shown(tmp_path, monkeypatch, capsys):
    code = next(block for block in blocks("python") if "explain" in block)
    shown = TEXT.split(code)[1].split("```")[2].strip("\n")
    monkeypatch.chdir(tmp_path)
    exec(code, {"__name__": "__main__"})
    assert capsys.readouterr().out.strip("\n") == shown
    assert (tmp_path / "arm.yaml").is_file()


def test_own_effect_of_the_readme_is_one():
    code = next(block for block in blocks("python") if "JointEffect" in block)
    names = {}
    exec(code, names)
    assert issubclass(names["HangingHose"], Effect)


def test_table_names_every_effect():
    for effect in catalogue():
        assert f"| `{effect.name}` |" in TEXT


def test_names_to_look_up_are_in_their_packages():
    table = TEXT.split("## Names to look up")[1].split("\n## ")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines() if line.startswith("| `")]
    named = {cell.strip(" `"): re.findall(r"`(\w+)`", names) for cell, names in rows}
    assert set(named) >= {"geodrake.diagnosis", "geodrake.control"}
    for package, names in named.items():
        missing = [n for n in names if n != "plant" and not hasattr(import_module(package), n)]
        assert not missing, f"{package} has no {missing}"


def test_packages_are_there_after_one_import():
    code = (
        "import sys, types, geodrake\n"
        "assert not [name for name in sys.modules if name.startswith('geodrake.')]\n"
        "for name in sys.argv[1:]:\n"
        "    assert type(getattr(geodrake, name)) is types.ModuleType, name\n"
        "assert callable(geodrake.load_model)\n"
    )
    packages = re.findall(r"^\| `geodrake\.(\w+)` \|", TEXT, re.MULTILINE)
    assert "diagnosis" in packages
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *packages],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr


def test_options_of_files_are_those_of_the_readme():
    """Which command takes which of --json, --report and --save."""
    words = TEXT.split("All take `--json`")[1].split("`--help` tells the rest")[0]
    saving, none = words.split("`--save` writes")[1].split(";")
    commands = {
        command.callback.__name__: {p.name for p in get_command(app).commands[name].params}
        for command in app.registered_commands
        for name in [command.callback.__name__]
    }
    assert {"compare", "excite", "demo"} <= commands.keys()
    assert all(
        {"json", "report"} <= commands[name]
        for name in commands.keys() - {"log", "check", "digest"}
    )
    assert {"json", "figure", "convert"} <= commands["log"]
    named = {text: set(re.findall(r"`(\w+)`", text)) for text in (saving, none)}
    assert named[saving] | named[none] == commands.keys()
    assert all("save" in commands[name] for name in named[saving])
    refusing = {"identifiable"}  # which says why it cannot
    assert not any("save" in commands[name] for name in named[none] - refusing)


def test_links_lead_somewhere():
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", TEXT):
        assert (README.parent / target).is_file(), target


@pytest.mark.parametrize("name", ["README.md", "BENCHMARKS.md", "docs/design.md"])
def test_files_that_documents_name_are_there(name):
    words = (README.parent / name).read_text(encoding="utf-8")
    paths = re.findall(r"\b(?:diagrams|docs|geodrake|tests)/[\w/]*(?:\.\w+)?", words)
    tests = {path.stem for path in README.parent.glob("tests/**/*.py")}
    scripts = set(re.findall(r"python (\S+\.py)", words))
    assert not [path for path in {*paths, *scripts} if not (README.parent / path).exists()]
    assert set(re.findall(r"`(test_\w+)`", words)) <= tests


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
