"""The README's commands and code do what it says."""

import json
import re
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest
from typer.main import get_command

from geodrake import load_model, save_model
from geodrake.cli.app import EXAMPLES, app

README = Path(__file__).parents[1] / "README.md"
TEXT = README.read_text(encoding="utf-8") if README.is_file() else ""
NAMES, COMMANDS = (
    (README.parent / "docs" / name).read_text(encoding="utf-8")
    for name in ("api.md", "commands.md")
)


def blocks(language):
    found = re.findall(r"^```(\w*)\n(.*?)^```", TEXT, re.M | re.S)
    return [block for own, block in found if own == language]


def test_python_lines_print_what_is_shown(tmp_path, monkeypatch, capsys):
    code = next(block for block in blocks("python") if "explain" in block)
    shown = next(block for block in blocks("") if "explained: nrms" in block).strip("\n")
    monkeypatch.chdir(tmp_path)
    exec(code, {"__name__": "__main__"})
    assert capsys.readouterr().out.strip("\n") == shown
    assert (tmp_path / "arm.yaml").is_file()


def test_packages_are_there_after_one_import():
    code = (
        "import sys, types, geodrake\n"
        "assert not [name for name in sys.modules if name.startswith('geodrake.')]\n"
        "for name in sys.argv[1:]:\n"
        "    assert type(getattr(geodrake, name)) is types.ModuleType, name\n"
        "assert callable(geodrake.load_model)\n"
    )
    packages = re.findall(r"^\| `geodrake\.(\w+)` \|", NAMES, re.MULTILINE)
    assert "diagnosis" in packages
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *packages],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr


def test_options_of_files_are_those_of_the_page_of_commands():
    """Check which commands take --json, --report and --save."""
    words = COMMANDS.split("All commands take `--json`")[1].split("hides progress")[0]
    saving, none = words.split("`--save` writes")[1].split(";")
    commands = {
        name: {p.name for p in command.params}
        for name, command in get_command(app).commands.items()
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


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_of_help_have_options_that_are_there(name):
    command = get_command(app).commands[name]
    options = {option for param in command.params for option in param.opts}
    for example in EXAMPLES[name]:
        assert f"geodrake {name} {example}" in command.epilog
        assert {word for word in example.split() if word.startswith("--")} <= options


@pytest.mark.parametrize("name", ["README.md", "docs/benchmarks.md", "docs/design.md"])
def test_files_that_documents_name_are_there(name):
    words = (README.parent / name).read_text(encoding="utf-8")
    paths = re.findall(r"\b(?:diagrams|docs|geodrake|tests)/[\w/]*(?:\.\w+)?", words)
    tests = {path.stem for path in README.parent.glob("tests/**/*.py")}
    scripts = {
        f"{m.replace('.', '/')}.py" for m in re.findall(r"python -m (diagrams[\w.]+)", words)
    }
    assert not [path for path in {*paths, *scripts} if not (README.parent / path).exists()]
    assert set(re.findall(r"`(test_\w+)`", words)) <= tests


def test_diagram_of_the_readme_runs(tmp_path, monkeypatch):
    code = next(block for block in blocks("python") if "add_to_builder" in block)
    model = load_model(files("geodrake.demo") / "demo.urdf")
    monkeypatch.chdir(tmp_path)
    save_model(model, "arm.yaml")
    names = {}
    exec(code, names)
    assert names["simulator"].get_context().get_time() == 1.0


@pytest.mark.parametrize(
    "row, before, after, mass",
    [
        ("UR10e, free motion", "ur10e_before", "ur10e", None),
        ("the same on another day", None, "another_day", None),
        ("the same with 2.805 kg", "loaded_before", "loaded", "loaded"),
        ("KUKA KR300", "kr300_before", "kr300", "kr300"),
        ("Staubli TX40", "tx40_before", "tx40", None),
        ("AcroMonk", "acromonk_before", "acromonk", None),
        ("double pendulum", "pendulum_before", "pendulum", None),
    ],
)
def test_figures_of_real_robots_are_those_that_were_measured(row, before, after, mass):
    """The table and the page of benchmarks come from one run."""
    measured = json.loads((README.parent / "diagrams" / "benchmarks.json").read_text())
    figures = measured["real_robots"]["figures"]
    cells = re.search(rf"^\| {row}.*", TEXT, re.M)[0].split("|")
    told = {before: cells[3].strip(), after: cells[5].strip()}
    if mass is not None:
        told[f"{mass}_mass"], told[f"{mass}_deviation"] = re.search(
            r"payload of ([\d.]+) ± ([\d.]+) kg", cells[2]
        ).groups()
    told.pop(None, None)
    for name, text in told.items():
        digits = len(text.partition(".")[2])
        assert round(figures[name], digits) == float(text), name
