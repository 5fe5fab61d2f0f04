"""Xacro files expanded to what they describe, by the package xacro if it is installed."""

from __future__ import annotations

import importlib
import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from types import ModuleType

from geodrake.boundary.escaping import one_line
from geodrake.errors import ModelError
from geodrake.robot.files.given import Given
from geodrake.robot.files.packages import folder_of_package

_TAG = re.compile(rb"<xacro:\w")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_NO_ARGUMENT = re.compile(r"Undefined substitution argument (\S+)")


def is_xacro(data: bytes) -> bool:
    """Whether a model file has elements of xacro."""
    return _TAG.search(_COMMENT.sub(b"", data)) is not None


def read_expanded(path: Path, given: Given) -> bytes:
    """Bytes of a model file, those that it expands to where it is a xacro file.

    Args:
        path: The file.
        given: Arguments of xacro, and folders of packages.

    Raises:
        ModelError: The package xacro is not installed, or cannot expand the file.
    """
    data = path.read_bytes()
    if not is_xacro(data):
        return data
    try:
        xacro = importlib.import_module("xacro")
    except ImportError as error:
        raise ModelError(
            f"{path} is a xacro file, and the package xacro is not installed.",
            advice='Install it: pip install "geodrake[xacro]"; or expand the file first: xacro '
            "robot.urdf.xacro > robot.urdf.",
            path=path,
        ) from error
    return _expanded(xacro, path, given)


def _expanded(xacro: ModuleType, path: Path, given: Given) -> bytes:
    silence = io.StringIO()
    try:
        with (
            _finding(lambda name: str(folder_of_package(name, path, given.packages))),
            redirect_stdout(silence),
            redirect_stderr(silence),
        ):
            document = xacro.process_file(str(path), mappings=dict(given.xacro))
        return bytes(document.toxml(encoding="utf-8"))
    except (MemoryError, ModelError):
        raise
    except (Exception, SystemExit) as error:  # files hold expressions, which may raise anything
        _reraise_own(error)
        words = one_line(error)
        missing = _NO_ARGUMENT.search(words)
        advice = f"Give it: --xacro-arg {missing[1]}:=VALUE." if missing else ""
        raise ModelError(
            f"xacro cannot expand {path}: {words}.",
            advice=advice or "Correct the file, or give its arguments with --xacro-arg.",
            path=path,
        ) from error


def _reraise_own(error: BaseException) -> None:
    """Raises what geodrake raised while xacro worked, which xacro wraps."""
    cause: BaseException | None = error
    while cause is not None:
        for inner in (cause, getattr(cause, "exc", None)):
            if isinstance(inner, ModelError):
                raise inner
        cause = cause.__cause__ or cause.__context__


@contextmanager
def _finding(find: Callable[[str], str]) -> Iterator[None]:
    """$(find PACKAGE) leads where other URLs of packages lead, with or without an ament index."""
    substitution = importlib.import_module("xacro.substitution_args")
    before = substitution._eval_find
    setattr(substitution, "_eval_find", find)  # noqa: B010
    try:
        yield
    finally:
        setattr(substitution, "_eval_find", before)  # noqa: B010
