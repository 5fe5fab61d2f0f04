"""The process that expands a xacro file: a script, which geodrake runs and never imports.

It imports the packages xacro and PyYAML, and gives up everything else before it reads the file: it
cannot open a file or a socket, write, or start a process, and its time and memory are limited. It
asks for what it needs by lines of JSON, `[kind, value]`, to which each answer is a line:

    ["open", path]      the file, a letter a byte; or [number, words] of why there is none
    ["glob", pattern]   paths
    ["find", package]   its folder
    ["done", text]      what the file expands to; the last line, as the next two
    ["refused", words]  an expression asks for more than values
    ["failed", words]   anything else

Its arguments are folders of packages. The first line that it reads is `[path, arguments, trusted]`.
"""

from __future__ import annotations

import importlib
import io
import json
import resource
import runpy
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

CPU_SECONDS = 10
"""Of the processor's time; ten times of it for files that are trusted, which may be large ones."""

WALL_SECONDS = 20 * CPU_SECONDS
MEMORY = 2_000_000_000
"""Bytes."""


def expand() -> None:
    """Expand the file that the first line names."""
    sys.path += sys.argv[1:]
    sys.stdout, out = sys.stderr, sys.stdout
    xacro = importlib.import_module("xacro")
    for needed in ("xacro.substitution_args", "xml.dom.expatbuilder", "yaml"):
        importlib.import_module(needed)  # later, no file can be opened
    rules = runpy.run_path(str(Path(__file__).with_name("xacro_expressions.py")))
    path, arguments, trusted = json.loads(sys.stdin.readline())

    def tell(kind: str, value: Any) -> None:
        out.write(json.dumps([kind, value]) + "\n")
        out.flush()

    def ask(kind: str, value: Any) -> Any:
        tell(kind, value)
        return json.loads(sys.stdin.readline())

    try:
        _give_up(CPU_SECONDS * (10 if trusted else 1))
        _serve_files(xacro, ask)
        if not trusted:
            _limit_expressions(xacro, rules)
        document = xacro.process_file(path, mappings=arguments)
        tell("done", document.toxml(encoding="utf-8").decode())
    except rules["RefusedError"] as error:
        tell("refused", str(error))
    except Exception as error:
        tell("failed", _words(error) + _place(xacro, path))


def _give_up(seconds: int) -> None:
    """Give up what is not needed, for good; a signal ends this after seconds of the processor."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is told to the process that asked
    signal.alarm(WALL_SECONDS)
    limits = {
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NPROC: 0,
        resource.RLIMIT_NOFILE: 0,  # what is open stays so
    }
    if sys.platform != "darwin":  # whose system takes no such limit
        limits[resource.RLIMIT_AS] = MEMORY
    for what, most in limits.items():
        _, hard = resource.getrlimit(what)
        allowed = most if hard == resource.RLIM_INFINITY else min(most, hard)
        # The processor's soft limit ends this by its own signal, which says why, before the hard.
        resource.setrlimit(what, (allowed, hard if what == resource.RLIMIT_CPU else allowed))


def _serve_files(xacro: Any, ask: Any) -> None:
    """Have xacro ask for files and packages."""

    def opened(path: str) -> io.TextIOWrapper:
        answer = ask("open", path)
        if isinstance(answer, list):
            raise OSError(*answer, path)
        return io.TextIOWrapper(io.BytesIO(answer.encode("latin-1")), "utf-8")

    xacro.open = opened
    xacro.glob = SimpleNamespace(glob=lambda pattern: ask("glob", pattern))
    own = xacro.substitution_args
    own._eval_find = own._eval_dict["find"] = lambda package: ask("find", package)


def _limit_expressions(xacro: Any, rules: dict[str, Any]) -> None:
    """Have xacro evaluate expressions within bounds."""
    if not hasattr(xacro, "safe_eval"):
        raise ImportError("the package xacro is older than 2.1: pip install -U xacro")
    functions_of = rules["functions_of"]
    python = xacro._global_symbols["python"]
    rules["withhold"](python)
    known = functions_of(xacro._global_symbols)

    def evaluated(text: str, names: Any, functions: list[Any]) -> Any:
        kinds = xacro.NameSpace, xacro.YamlDictWrapper
        return rules["Expressions"](names, functions, *kinds).evaluate(text)

    def of_substitution(text: str, _: Any, names: Any) -> Any:
        own = functions_of(names._functions)
        return evaluated(text, rules["NamesWithin"](names, python), known + own)

    xacro.safe_eval = lambda text, names: evaluated(text, names, known)
    xacro.substitution_args.eval = of_substitution


def _words(error: Exception) -> str:
    """Say what is wrong, which xacro wraps."""
    inner: Any = error
    while getattr(inner, "exc", None) is not None:
        inner = inner.exc
    if isinstance(inner, MemoryError):
        return f"it needs more than {MEMORY / 1e9:g} GB"
    if isinstance(inner, RecursionError):
        return "its macros or files hold themselves, or each other too deeply"
    return str(error) or type(inner).__name__


def _place(xacro: Any, path: str) -> str:
    """Say which included file is at fault."""
    files = [file for file in xacro.filestack or () if file != path]
    return f" (in {files[-1]})" if files else ""


if __name__ == "__main__":
    expand()
