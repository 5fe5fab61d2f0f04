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

Expressions are Python's, without its builtins but those that xacro gives. Whoever reaches a class
or a frame by the attributes of a value reaches all of Python, so the names of such are refused.
"""

from __future__ import annotations

import ast
import importlib
import io
import json
import resource
import signal
import sys
import types
from types import SimpleNamespace
from typing import Any

CPU_SECONDS = 10
"""Of the processor's time; ten times of it for files that are trusted, which may be large ones."""

WALL_SECONDS = 20 * CPU_SECONDS
MEMORY = 2_000_000_000
"""Bytes."""

_INNER = (
    types.AsyncGeneratorType,
    types.CodeType,
    types.CoroutineType,
    types.FrameType,
    types.GeneratorType,
    types.TracebackType,
)
_REFUSED = {name for kind in _INNER for name in dir(kind) if "_" in name} | {"mro"}
_REFUSED |= {"format", "format_map"}  # which reach the attributes of values
_WITHHELD = ("type", "vars")  # which give classes, and what they are made of


class RefusedError(BaseException):
    """An expression asks for more than values; no Exception, as xacro catches and wraps those."""


def expand() -> None:
    """Expand the file that the first line names."""
    sys.path += sys.argv[1:]
    sys.stdout, out = sys.stderr, sys.stdout
    xacro = importlib.import_module("xacro")
    for needed in ("xacro.substitution_args", "xml.dom.expatbuilder", "yaml"):
        importlib.import_module(needed)  # later, no file can be opened
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
            limit_expressions(xacro)
        document = xacro.process_file(path, mappings=arguments)
        tell("done", document.toxml(encoding="utf-8").decode())
    except RefusedError as error:
        tell("refused", str(error))
    except Exception as error:
        files = [file for file in xacro.filestack or () if file != path]
        tell("failed", _words(error) + (f" (in {files[-1]})" if files else ""))


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


def limit_expressions(xacro: Any) -> None:
    """Have xacro evaluate expressions of values alone."""
    if not hasattr(xacro, "safe_eval"):
        raise ImportError("the package xacro is older than 2.1: pip install -U xacro")
    evaluated, python = xacro.safe_eval, xacro._global_symbols["python"]

    def withheld(name: str) -> Any:
        def refuse(*_: Any, **__: Any) -> None:
            raise RefusedError(f"{name} is asked for")

        return refuse

    python.update({name: withheld(name) for name in _WITHHELD})
    xacro.safe_eval = lambda text, names: evaluated(_checked(text), names)
    xacro.substitution_args.eval = lambda text, _, names: evaluated(
        _checked(text), dict(python), names
    )


def _checked(text: str) -> str:
    """Return an expression, or refuse one that asks for names of what Python is made of."""
    for node in ast.walk(ast.parse(text.strip(), "<expression>", mode="eval")):
        name, attribute = getattr(node, "id", ""), getattr(node, "attr", "")
        if name.startswith("__") or attribute.startswith("_") or attribute in _REFUSED:
            raise RefusedError(f"{name or attribute} is asked for in '{text}'")
    return text


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


if __name__ == "__main__":
    expand()
