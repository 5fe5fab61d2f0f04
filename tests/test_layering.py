"""The source keeps its shape: imports go one way, functions stay small."""

import ast
import re
from collections import defaultdict
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

MOST_FUNCTION_LINES = 60
MOST_ARGUMENTS = 8
MANY_ARGUMENTS = ("identify",)  # whose signature is one of the interfaces that stay stable


def source_files(*folders):
    return sorted(p for folder in folders for p in folder.rglob("*.py"))


MODULES = source_files(PACKAGE)
SHIPPED = source_files(PACKAGE, ROOT / "diagrams")


def named(path):
    return str(path.relative_to(ROOT))


def module_name(path):
    """geodrake.effects for geodrake/effects/__init__.py, geodrake.__init__ for geodrake's own."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 2 else parts)


def layer(module):
    """geodrake.effects.base belongs to the layer effects."""
    return module.split(".")[1]


NAMES = {module_name(path) for path in MODULES}


def imported(tree):
    """Modules of geodrake that a syntax tree imports, wherever in it, with the line."""
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
    """Imports of a module that go down the list, are relative, or lead nowhere."""
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
    """All nodes of a syntax tree, which several tests look through."""
    return tuple(ast.walk(tree))


@pytest.fixture(scope="module", autouse=True)
def forget_trees():
    yield
    nodes.cache_clear()  # they take much memory
    parsed.cache_clear()


def functions(tree):
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return [node for node in nodes(tree) if isinstance(node, kinds)]


def lines_without_docstring(function):
    total = function.end_lineno - function.lineno + 1
    if ast.get_docstring(function, clean=False) is None:
        return total
    docstring = function.body[0]
    return total - (docstring.end_lineno - docstring.lineno + 1)


def arguments(function):
    """Names of the arguments, without self and cls."""
    a = function.args
    every = [*a.posonlyargs, *a.args, *a.kwonlyargs]
    return [argument.arg for argument in every if argument.arg not in ("self", "cls")]


def offenders(paths, problems):
    """File -> what is wrong with it, for the files with which something is."""
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
    rooms = (ROOT / "docs" / "design.md").read_text(encoding="utf-8").split("## Rooms")[1]
    rows = re.findall(r"^\| `(\w+)` \|", rooms.split("\n## ")[0], re.MULTILINE)
    assert rows[::-1] == [name for name in LAYERS if not name.startswith("__")]


def test_wrong_imports_are_noticed():
    tree = ast.parse("def late():\n    from geodrake.identification.logs.compare import compare\n")
    assert list(wrong_imports("geodrake.model.robot_model", tree)) == [
        "line 2 imports geodrake.identification.logs.compare, which is a higher layer"
    ]
    assert not list(wrong_imports("geodrake.diagnosis.explain", tree))
    assert list(wrong_imports("geodrake.cli.app", ast.parse("import geodrake.nothing")))
    assert list(
        wrong_imports("geodrake.model.robot_model", ast.parse("from geodrake import load_model"))
    )
    assert list(wrong_imports("geodrake.model.robot_model", ast.parse("from . import saved_model")))


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


def test_functions_stay_short():
    def problems(path):
        for function in functions(parsed(path)):
            lines, count = lines_without_docstring(function), len(arguments(function))
            if lines > MOST_FUNCTION_LINES:
                yield f"{function.name} has {lines} lines without its docstring"
            if count > MOST_ARGUMENTS and function.name not in MANY_ARGUMENTS:
                yield f"{function.name} has {count} arguments"

    assert not offenders(SHIPPED, problems)


def is_inlined(node):
    return "inlined" in {getattr(each, "id", "") for each in getattr(node, "decorator_list", [])}


def public_functions(tree):
    """Public functions, and public methods of public classes, each with its class or None.

    What is inlined is a part of a kernel, an equation of numbers.
    """
    pending = [(None, tree)]
    while pending:
        owner, node = pending.pop()
        for child in node.body:
            if getattr(child, "name", "_").startswith("_") or is_inlined(child):
                continue
            if isinstance(child, ast.ClassDef):
                pending.append((child, child))
            else:
                yield owner, child


def documented_arguments(function):
    """Names under Args in a docstring."""
    text = ast.get_docstring(function) or ""
    section = re.search(r"^Args:\n((?:(?:    .*)?\n)*(?:    .*)?)", text, re.MULTILINE)
    names = re.findall(r"^    (\*{0,2}\w[\w, *]*):", section[1], re.MULTILINE) if section else []
    return {name.strip(" *") for entry in names for name in entry.split(",")}


def overridden(owner, name, classes):
    """Methods of that name in the classes that a class derives from."""
    for base in owner.bases if owner else ():
        for parent in classes.get(getattr(base, "id", getattr(base, "attr", None)), ()):
            yield from (f for _, f in public_functions(ast.Module([parent], [])) if f.name == name)
            yield from overridden(parent, name, classes)


def test_public_functions_say_what_they_take():
    """Args with every argument, or "See `name`" for those of another function.

    An override of a method of geodrake's that says so needs neither.
    """
    trees = {path: parsed(path) for path in MODULES}
    classes, known = defaultdict(list), defaultdict(set)
    for tree in trees.values():
        for node in nodes(tree):
            if isinstance(node, ast.ClassDef):
                classes[node.name].append(node)
        for _, function in public_functions(tree):
            known[function.name] |= documented_arguments(function)

    def is_documented(function):
        text = ast.get_docstring(function) or ""
        others = re.findall(r"(?:[Ss]ee|Kernel of) `(?:[\w.]+\.)?(\w+)`", text)
        there = documented_arguments(function).union(*(known[name] for name in others))
        return there.issuperset(arguments(function))

    def problems(path):
        for owner, function in public_functions(trees[path]):
            if len(arguments(function)) < 2 or is_documented(function):
                continue
            if not any(is_documented(f) for f in overridden(owner, function.name, classes)):
                yield f"line {function.lineno}: {function.name} lacks Args, or some of them"

    assert not offenders(MODULES, problems)


def test_no_asserts_for_users():
    def problems(path):
        for node in nodes(parsed(path)):
            if isinstance(node, ast.Assert):
                yield f"line {node.lineno}: raise an error of geodrake.errors instead"

    assert not offenders(SHIPPED, problems)
