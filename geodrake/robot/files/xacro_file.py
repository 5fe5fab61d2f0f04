"""Xacro files expanded to what they describe, by the package xacro, in a process without powers."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from glob import iglob
from itertools import islice
from pathlib import Path
from typing import IO, Any, cast

from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import read_regular
from geodrake.errors import ModelError
from geodrake.robot.files import xacro_process
from geodrake.robot.files.given import Expanded, Given
from geodrake.robot.files.packages import folder_of_package
from geodrake.robot.files.xml_text import LARGEST_FILE

_TAG = re.compile(rb"<xacro:\w")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_NO_ARGUMENT = re.compile(r"Undefined substitution argument (\S+)")
_PACKAGES = ("xacro", "yaml")
_MOST_FILES = 500  # read for one
_MOST_WILD = 2  # names of a pattern with wildcards, as the time grows by a power
_WILD = re.compile(r"[*?[]")
_LONGEST = 4 * LARGEST_FILE  # letters of a line from the process
_ENDS: Mapping[int, str] = {
    signal.SIGXCPU: "takes more of the processor's time than it may",
    signal.SIGALRM: f"takes more than {xacro_process.WALL_SECONDS} s",
}


def is_xacro(path: Path) -> bool:
    """Return whether a model file has elements of xacro."""
    return _has_elements(read_regular(path, "model file", ModelError, largest=LARGEST_FILE))


def _has_elements(data: bytes) -> bool:
    return _TAG.search(_COMMENT.sub(b"", data)) is not None


def read_expanded(path: Path, given: Given) -> bytes:
    """Return the bytes of a model file, those that it expands to where it is a xacro file.

    They are kept in `given`, and taken from there while the file, and whatever it asks for while it
    is expanded, is the same.
    """
    data = read_regular(path, "model file", ModelError, largest=LARGEST_FILE)
    if not _has_elements(data):
        return data
    begin = _checksum([data.decode("latin-1"), dict(given.xacro)])
    known = given.expansions.get(path)
    if known is None or known.begin != begin or not _Expansion(path, given).is_still(known.asked):
        expansion = _Expansion(path, given)
        known = given.expansions[path] = Expanded(begin, expansion.asked, expansion.expanded())
    return known.data


class _Expansion:
    """Expands a file, by answers to what a process asks (`xacro_process`)."""

    def __init__(self, path: Path, given: Given) -> None:
        self._path, self._given, self._count = path, given, 0
        self.asked = list[tuple[str, Any, bytes]]()  # kind, value and checksum of the answer
        around = _place(path).parents
        package = next((each for each in around if (each / "package.xml").is_file()), around[0])
        self._reach = {around[0], package, *map(_place, given.packages.values())}

    def expanded(self) -> bytes:
        """Return what the file expands to."""
        script = str(xacro_process.__file__)
        command = [sys.executable, "-IBS", script, *map(str, self._folders())]
        pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=nowhere) as process:
            try:
                _tell(process, [str(self._path), dict(self._given.xacro), self._given.trust_xacro])
                while True:
                    kind, value = self._told(process)
                    if kind == "done":
                        return str(value).encode()
                    answer = self._answer(kind, value)
                    self.asked.append((kind, value, _checksum(answer)))
                    _tell(process, answer)
            finally:
                process.kill()

    def is_still(self, asked: Sequence[tuple[str, Any, bytes]]) -> bool:
        """Return whether what was asked for once is answered as it was."""
        return all(_checksum(self._answer(kind, value)) == known for kind, value, known in asked)

    def _folders(self) -> list[Path]:
        """Return where the packages are that the process imports."""
        found = [importlib.util.find_spec(name) for name in _PACKAGES]
        places = [Path(spec.origin) for spec in found if spec is not None and spec.origin]
        if len(places) < len(_PACKAGES):
            raise ModelError(
                f"{self._path} is a xacro file, and the package xacro is not installed.",
                advice='Install it: pip install "geodrake[robots]"; or expand the file first: '
                "xacro robot.urdf.xacro > robot.urdf.",
                path=self._path,
            )
        return [place.parents[1] for place in places]

    def _told(self, process: subprocess.Popen[bytes]) -> tuple[str, Any]:
        """Return the next kind and value that the process tells."""
        line = cast(IO[bytes], process.stdout).readline(_LONGEST)
        if line.endswith(b"\n"):
            kind, value = json.loads(line)
            return kind, value
        if len(line) == _LONGEST:
            end = f"expands to more than {LARGEST_FILE / 1e6:.0f} MB"
        else:
            code = process.wait()
            end = _ENDS.get(-code, f"ends the process that expands it (exit code {code})")
        raise self._error(
            f"cannot be expanded: it {end}.",
            "Correct the file; or, if it is but large and you trust it, give --trust-xacro.",
        )

    def _answer(self, kind: str, value: Any) -> Any:
        if kind == "open":
            return self._file(_place(value))
        if kind == "glob":
            return self._files(_place(value))
        if kind == "find":
            folder = folder_of_package(value, self._path, self._given.packages)
            self._reach.add(_place(folder))
            return str(folder)
        words = one_line(Exception(value))
        if kind == "refused":
            raise self._error(
                f"is a xacro file that geodrake does not expand unasked: {words}.",
                "Write it without that; or, if you trust who wrote the file, give --trust-xacro.",
            )
        missing = _NO_ARGUMENT.search(words)
        advice = f"Give it: --xacro-arg {missing[1]}:=VALUE." if missing else ""
        raise self._error(
            f"cannot be expanded by xacro: {words}.",
            advice or "Correct the file, or give its arguments with --xacro-arg.",
        )

    def _file(self, place: Path) -> Any:
        """Return what is in a file, or the number and words of why there is none."""
        self._count += 1
        if self._count > _MOST_FILES:
            raise self._error(f"reads more than {_MOST_FILES} files, or some without an end.")
        if not self._within(place):
            raise self._error(
                f"reads {place}, which is neither in its folder nor in its packages.",
                "Name the folder: --package NAME=FOLDER; or, if you trust who wrote the file, give "
                "--trust-xacro.",
            )
        try:
            place.stat()
        except (OSError, ValueError) as error:  # a file may be one that need not be there
            return [getattr(error, "errno", 0), getattr(error, "strerror", str(error))]
        what = f"file that {self._path} includes,"
        data = read_regular(place, what, ModelError, largest=LARGEST_FILE, empty=True)
        return data.decode("latin-1")

    def _files(self, pattern: Path) -> list[str]:
        """Return the files that a pattern stands for, within reach."""
        if sum(_WILD.search(part) is not None for part in pattern.parts) > _MOST_WILD:
            raise self._error(
                f"includes {pattern}, with wildcards for more than {_MOST_WILD} names."
            )
        found = map(Path, iglob(str(pattern)))  # noqa: PTH207  # which leaves hidden files out
        return [str(each) for each in islice(filter(self._within, found), _MOST_FILES + 1)]

    def _within(self, place: Path) -> bool:
        return self._given.trust_xacro or any(map(place.is_relative_to, self._reach))

    def _error(self, what: str, advice: str = "Correct the file.") -> ModelError:
        return ModelError(f"{self._path} {what}", advice=advice, path=self._path)


def _checksum(value: Any) -> bytes:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).digest()


def _tell(process: subprocess.Popen[bytes], answer: Any) -> None:
    pipe = cast(IO[bytes], process.stdin)
    with suppress(OSError):  # if it has ended, its next line says so
        pipe.write(json.dumps(answer).encode() + b"\n")
        pipe.flush()


def _place(path: str | Path) -> Path:
    """Return an absolute path without `..`; links are not followed, as tools link into packages."""
    return Path(os.path.normpath(Path(path).absolute()))
