"""Expansion of xacro files with the package xacro.

Expressions in xacro are Python with a few builtins. Attributes of values that lead to a class or a
frame would give access to all of Python, so they are refused unless the user trusts the file. The
results of all expressions have a size limit.
"""

from __future__ import annotations

import ast
import builtins
import hashlib
import importlib
import importlib.util
import io
import re
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from functools import partial
from itertools import count
from pathlib import Path
from threading import RLock
from typing import Any

import yaml  # type: ignore[import-untyped]

from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import read_regular
from geodrake.errors import GeodrakeError, ModelError
from geodrake.robot.files.includes import folder_of_package
from geodrake.robot.files.load_options import Expanded, Given
from geodrake.robot.files.xml_text import LARGEST_FILE

_TAG = re.compile(rb"<xacro:\w")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_NO_ARGUMENT = re.compile(r"Undefined substitution argument (\S+)")
_MOST_CALLS = 10_000  # of macros, whose number may grow exponentially
_MOST_FILES = 500  # read per file, as includes may grow exponentially
_MOST_ITEMS = 1_000_000  # in a list, text or range made by an expression
_MOST_BITS = 100_000  # of an integer made by an expression
_CLASS = re.compile(r"<class '[\w.]+'>:? ?")
_ONE_AT_A_TIME = RLock()
_INNER = (
    types.AsyncGeneratorType,
    types.CodeType,
    types.CoroutineType,
    types.FrameType,
    types.GeneratorType,
    types.TracebackType,
)
_REFUSED = {name for kind in _INNER for name in dir(kind) if "_" in name} | {"mro"}
_REFUSED |= {"format", "format_map"}  # give access to attributes of values
_WITHHELD = ("type", "vars")  # give access to classes and their contents


class RefusedError(BaseException):
    """A forbidden expression; not an Exception, as xacro catches and wraps those."""


def is_xacro(path: Path) -> bool:
    """Return whether a model file has the suffix `.xacro` or elements of xacro."""
    data = read_regular(path, "model file", ModelError, largest=LARGEST_FILE)
    return path.suffix == ".xacro" or _TAG.search(_COMMENT.sub(b"", data)) is not None


def read_expanded(path: Path, given: Given) -> bytes:
    """Return the bytes of a model file, expanded if it is a xacro file.

    Expansions are cached in `given` while the file and all files that it reads are unchanged.
    """
    if not is_xacro(path):
        return read_regular(path, "model file", ModelError, largest=LARGEST_FILE)
    known = given.expansions.get(path)
    if known is None or any(_digest(file) != digest for file, digest in known.read.items()):
        read = {path: _digest(path)}
        known = given.expansions[path] = Expanded(read, _expanded(path, given, read))
    return known.data


def _expanded(path: Path, given: Given, read: dict[Path, bytes | None]) -> bytes:
    """Return the expansion of a file, and record the files it reads."""
    if importlib.util.find_spec("xacro") is None:
        raise ModelError(
            f"{path} is a xacro file, but the package xacro is not installed.",
            advice='Install it: pip install "geodrake[robots]"; or expand the file first: '
            "xacro robot.urdf.xacro > robot.urdf.",
        )

    calls = count(1)

    def opened(name: str) -> io.TextIOWrapper:
        if next(calls) > _MOST_FILES:
            raise ModelError(
                f"{path} reads more than {_MOST_FILES} files, or an endless one.",
                advice="Correct the file.",
            )
        place = Path(name).absolute()
        read[place] = _digest(place)
        place.stat()  # raises for a missing file, which xacro may accept
        what = f"file that {path} includes,"
        data = read_regular(place, what, ModelError, largest=LARGEST_FILE, empty=True)
        return io.TextIOWrapper(io.BytesIO(data), "utf-8")

    with _private_xacro() as xacro, redirect_stderr(io.StringIO()):
        xacro.open = opened
        arguments = xacro.substitution_args
        arguments._eval_find = arguments._eval_dict["find"] = lambda name: str(
            folder_of_package(name, path, given.packages)
        )
        _limit(xacro, _Limited(path, given.trust_xacro))
        try:
            document = xacro.process_file(str(path), mappings=dict(given.xacro))
            return bytes(document.toxml(encoding="utf-8"))
        except RefusedError as error:
            raise ModelError(
                f"{path} is a xacro file with an expression that is not evaluated by "
                f"default: {error}.",
                advice="Remove it or, if you trust the author of the file, use --trust-xacro.",
            ) from error
        except Exception as error:
            inner: Any = error
            while getattr(inner, "exc", None) is not None:  # unwrap xacro's exception
                inner = inner.exc
            if isinstance(inner, GeodrakeError):
                raise inner from error
            words = _words(inner) or _CLASS.sub("", str(error)) or type(inner).__name__
            half = len(words) // 2
            words = words[:half] if words[:half] == words[half + 1 :] else words  # duplicated
            files = [file for file in xacro.filestack or () if file != str(path)]
            words = one_line(Exception(words + (f" (in {files[-1]})" if files else "")))
            missing = _NO_ARGUMENT.search(words)
            raise ModelError(
                f"{path} cannot be expanded by xacro: {words}.",
                advice=f"Give it: --xacro-arg {missing[1]}:=VALUE."
                if missing
                else "Correct the file, or give its arguments with --xacro-arg.",
            ) from error


def _digest(file: Path) -> bytes | None:
    """Return a checksum of a file; None if it cannot be read."""
    try:
        data = read_regular(file, "file", ModelError, largest=LARGEST_FILE, empty=True)
    except GeodrakeError:
        return None
    return hashlib.sha256(data).digest()


@contextmanager
def _private_xacro() -> Iterator[Any]:
    """Import a private copy of xacro, whose evaluation can be modified."""

    def taken_out() -> dict[str, types.ModuleType]:
        names = [name for name in sys.modules if name.partition(".")[0] == "xacro"]
        return {name: sys.modules.pop(name) for name in names}

    with _ONE_AT_A_TIME:
        theirs, loader = taken_out(), yaml.SafeLoader
        constructors = loader.yaml_constructors
        loader.yaml_constructors = dict(constructors)
        try:
            importlib.import_module("xacro.substitution_args")
            yield sys.modules["xacro"]
        finally:
            loader.yaml_constructors = constructors
            taken_out()
            sys.modules.update(theirs)


class _Limited(ast.NodeTransformer):
    """Expressions with limited run time and memory, and in untrusted files without internals.

    `functions` replace operations of Python and limit the size of results.
    """

    def __init__(self, path: Path, trusted: bool) -> None:
        self.path, self.trusted = path, trusted
        self.functions = {
            "range": self._range,
            **{method.__name__: method for method in (self.Mult, self.Pow, self.LShift)},
        }

    def text(self, text: str) -> str:
        """Return an expression with functions in place of operations."""
        try:
            tree = ast.parse(text.strip(), "<expression>", mode="eval")
        except SyntaxError as error:
            what = f"{one_line(Exception(text))!r:.80}, which is incomplete or not valid Python"
            raise self._wrong(f"has the expression {what}: {error.msg}") from error
        for node in ast.walk(tree) if not self.trusted else ():
            name, attribute = getattr(node, "id", ""), getattr(node, "attr", "")
            if name.startswith("__") or attribute.startswith("_") or attribute in _REFUSED:
                raise RefusedError(f"{name or attribute} is used in '{text}'")
        return ast.unparse(self.visit(tree))

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Replace an operation by a function."""
        self.generic_visit(node)
        name = type(node.op).__name__
        if name not in self.functions:
            return node
        return ast.Call(ast.Name(name, ast.Load()), [node.left, node.right], [])

    def Mult(self, a: Any, b: Any) -> Any:
        """Return a * b."""
        for some, often in ((a, b), (b, a)):
            if isinstance(some, str | bytes | list | tuple) and isinstance(often, int):
                self._check(len(some) * often, _MOST_ITEMS, "items or characters")
        return a * b

    def Pow(self, a: Any, b: Any) -> Any:
        """Return a ** b."""
        if isinstance(a, int) and isinstance(b, int):
            self._check(a.bit_length() * b, _MOST_BITS, "bits")
        return a**b

    def LShift(self, a: Any, b: Any) -> Any:
        """Return a << b."""
        self._check(b, _MOST_BITS, "bits")
        return a << b

    def _range(self, *ends: Any) -> range:
        found = range(*ends)
        self._check((found.stop - found.start) // found.step, _MOST_ITEMS, "items")
        return found

    def _check(self, size: Any, most: int, what: str) -> None:
        if size > most:
            raise self._wrong(f"has an expression that makes more than {most:,} {what}")

    def _wrong(self, what: str) -> ModelError:
        return ModelError(f"{self.path} {what}.", advice="Correct the file.")


def _limit(xacro: Any, limited: _Limited) -> None:
    """Make xacro evaluate limited expressions, and restrict untrusted files further."""
    if not hasattr(xacro, "safe_eval"):
        raise ModelError(
            "The installed xacro is older than 2.1, and evaluates arbitrary expressions.",
            advice="Update it: pip install -U xacro.",
        )
    evaluated, symbols = xacro.safe_eval, xacro._global_symbols
    handle, calls = xacro.handle_macro_call, count(1)

    def called(*args: Any) -> Any:
        if next(calls) > _MOST_CALLS:
            raise RefusedError(f"its macros are called more than {_MOST_CALLS} times")
        return handle(*args)

    def refuse(name: str, *_: Any, **__: Any) -> None:
        raise RefusedError(f"{name} is used")

    letters = 0

    def counted(text: str, *names: Any) -> Any:
        nonlocal letters
        value = evaluated(limited.text(text), *names)
        letters += len(value) if isinstance(value, str) else 0
        if letters > LARGEST_FILE:
            raise RefusedError(
                f"its expressions expand to more than {LARGEST_FILE / 1e6:.0f} MB of text"
            )
        return value

    symbols.update(limited.functions)
    symbols["python"]["range"] = limited.functions["range"]
    if not limited.trusted:
        symbols["python"].update({name: partial(refuse, name) for name in _WITHHELD})
        xacro.handle_macro_call = called
    namespace = {**(vars(builtins) if limited.trusted else {}), **symbols["python"]}
    namespace |= limited.functions
    xacro.safe_eval = counted
    xacro.substitution_args.eval = lambda text, _, names: counted(text, dict(namespace), names)


def _words(error: Exception) -> str:
    """Describe an exception without a message."""
    if isinstance(error, MemoryError):
        return "it needs too much memory"
    is_endless = isinstance(error, RecursionError)
    return "its macros or files include themselves, or are nested too deeply" if is_endless else ""
