"""Imports go one way, and every module says what it is."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "geodrake"

LAYERS = (
    "errors",
    "compiling",
    "descent",
    "boundary",
    "inertia",
    "manifolds",
    "logs",
    "robot",
    "effects",
    "model",
    "identification",
    "diagnosis",
    "fleet",
    "excitation",
    "control",
    "report",
    "demo",
    "cli",
    "__init__",
    "__main__",
)
"""Modules and packages of geodrake, lowest first: imports only go up this list."""


def source_files(*folders):
    return sorted(p for folder in folders for p in folder.rglob("*.py"))


MODULES = source_files(PACKAGE)
SHIPPED = source_files(PACKAGE, ROOT / "diagrams")


def named(path):
    return str(path.relative_to(ROOT))


def module_name(path):
    """Return geodrake.effects for geodrake/effects/__init__.py, for example."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 2 else parts)


def layer(module):
    """Return the layer of a module, effects for geodrake.effects.base."""
    return module.split(".")[1]


NAMES = {module_name(path) for path in MODULES}


def imported(tree):
    """Yield modules of geodrake that a syntax tree imports anywhere, with the line."""
    for node in nodes(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            yield "." * node.level + (node.module or ""), node.lineno
            continue
        if isinstance(node, ast.ImportFrom):
            found = [(f"{node.module}.{alias.name}", node.module) for alias in node.names]
        elif isinstance(node, ast.Import):
            found = [(alias.name, alias.name) for alias in node.names]
        else:
            continue
        for full, module in found:
            if full.split(".")[0] == "geodrake":
                target = full if full in NAMES else module
                yield ("geodrake.__init__" if target == "geodrake" else target), node.lineno


def wrong_imports(module, tree):
    """Yield imports that go down the list, are relative, or lead nowhere."""
    height = {name: i for i, name in enumerate(LAYERS)}
    for target, line in imported(tree):
        if target not in NAMES:
            yield f"line {line} imports {target}: relative, or there is no such module"
        elif height[layer(target)] > height[layer(module)]:
            yield f"line {line} imports {target}, which is a higher layer"


@cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(tree):
    """Return all nodes of a syntax tree, which several tests use."""
    return tuple(ast.walk(tree))


@pytest.fixture(scope="module", autouse=True)
def forget_trees():
    yield
    nodes.cache_clear()  # they take much memory
    parsed.cache_clear()


def offenders(paths, problems):
    """Return what is wrong with each file, for files with problems."""
    found = {named(path): list(problems(path)) for path in paths}
    return {name: wrong for name, wrong in found.items() if wrong}


@pytest.mark.parametrize("name", sorted({layer(name) for name in NAMES}))
def test_every_module_has_a_layer(name):
    assert name in LAYERS, (
        f"geodrake.{name} is new: add {name!r} to LAYERS in tests/test_layering.py, above all that "
        "it imports and below all that imports it."
    )


def test_imports_go_one_way():
    assert not offenders(MODULES, lambda path: wrong_imports(module_name(path), parsed(path)))


def test_design_names_every_package_in_this_order():
    page = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    section = page.split("\n## Packages\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)
    assert rows[::-1] == [name for name in LAYERS if not name.startswith("__")]


def test_no_import_cycles():
    graph = {
        module_name(path): {target for target, _ in imported(parsed(path))} - {module_name(path)}
        for path in MODULES
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"imports in a circle: {' -> '.join(error.args[1])}")


def test_modules_say_what_they_are():
    def problems(path):
        if path.name in ("utils.py", "util.py", "helpers.py", "misc.py"):
            yield "its name says nothing"
        if not ast.get_docstring(parsed(path)):
            yield "no docstring"

    assert not offenders(SHIPPED, problems)


def test_no_two_classes_share_a_name():
    places = {}
    for path in MODULES:
        for node in nodes(parsed(path)):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(f"{named(path)}:{node.lineno}")
    assert not {name: found for name, found in places.items() if len(found) > 1}


def test_no_asserts_for_users():
    def problems(path):
        for node in nodes(parsed(path)):
            if isinstance(node, ast.Assert):
                yield f"line {node.lineno}: raise an error of geodrake.errors instead"

    assert not offenders(SHIPPED, problems)
