"""The source keeps its shape: imports go one way, functions stay small."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "geodrake"

LAYERS = (
    # What everything rests on: errors, rigid bodies, signals and logs.
    "errors",
    "arguments",
    "escaping",
    "interrupts",
    "whole_files",
    "input_files",
    "yaml_text",
    "positive_definite",
    "bodies",
    "inertia",
    "body_distances",
    "ellipsoids",
    "manifolds",
    "projections",
    "perturbation",
    "filtering",
    "white_noise",
    "time_stamps",
    "known_payload",
    "motion",
    "unit_hints",
    "smoothing",
    "sensor_faults",
    "repeated_logs",
    "uniform_log",
    "preparation",
    "folds",
    "log_files",
    # Models: files, the plant, its regressor, effects.
    "model_files",
    "repairs",
    "plant",
    "transmission",
    "transmission_parts",
    "joints",
    "kinematics",
    "recursion",
    "regressor",
    "effort_slopes",
    "reduction",
    "base_parameters",
    "floating_base",
    "effects",
    "model",
    "admissible",
    "held_payloads",
    "saved_model",
    "export",
    "control_regressor",
    # What is done with models.
    "identification",
    "excitation",
    "diagnosis",
    "drafting",
    "model_identification",
    "identifiability",
    "adaptation",
    "online_estimation",
    "systems",
    "loops",
    "rollout",
    # What the user sees.
    "visualization",
    "json_output",
    "excitation_json",
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
    for node in ast.walk(tree):
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


def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def functions(tree):
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return [node for node in ast.walk(tree) if isinstance(node, kinds)]


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


def test_wrong_imports_are_noticed():
    tree = ast.parse("def late():\n    from geodrake.diagnosis.compare import compare\n")
    assert list(wrong_imports("geodrake.model", tree)) == [
        "line 2 imports geodrake.diagnosis.compare, which is a higher layer"
    ]
    assert not list(wrong_imports("geodrake.diagnosis.explain", tree))
    assert list(wrong_imports("geodrake.cli.app", ast.parse("import geodrake.nothing")))
    assert list(wrong_imports("geodrake.model", ast.parse("from geodrake import load_model")))
    assert list(wrong_imports("geodrake.model", ast.parse("from . import saved_model")))


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


def test_functions_stay_short():
    def problems(path):
        for function in functions(parsed(path)):
            lines, count = lines_without_docstring(function), len(arguments(function))
            if lines > MOST_FUNCTION_LINES:
                yield f"{function.name} has {lines} lines without its docstring"
            if count > MOST_ARGUMENTS and function.name not in MANY_ARGUMENTS:
                yield f"{function.name} has {count} arguments"

    assert not offenders(SHIPPED, problems)


def test_no_asserts_for_users():
    def problems(path):
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.Assert):
                yield f"line {node.lineno}: raise an error of geodrake.errors instead"

    assert not offenders(SHIPPED, problems)
