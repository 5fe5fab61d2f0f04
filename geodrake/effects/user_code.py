"""Users' own effects: their files and their candidates."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from importlib.machinery import SourceFileLoader
from itertools import islice
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from geodrake.boundary.arguments import file_path
from geodrake.boundary.input_files import regular_file
from geodrake.effects.base import Effect
from geodrake.effects.class_checks import check_class, field_names
from geodrake.effects.column_checks import line_of, telling
from geodrake.effects.lookup import catalogue, classes_in, effects_in
from geodrake.effects.place import PLACES
from geodrake.errors import ArgumentError, ModelError

_MOST_CANDIDATES = 1000


def load_effect_file(path: str | Path) -> tuple[type[Effect], ...]:
    """Runs a Python file of a user and collects the effects that it defines.

    Args:
        path: A file such as the one in the documentation of `geodrake.effects`.

    Returns:
        Its effects in the order of definition, to be passed on as `extra`.

    Raises:
        ModelError: There is no such file, it cannot be run, or it defines no usable effect.
    """
    path = regular_file(file_path(path), "file of effects", ModelError)
    module = _import(path)
    classes, effects = classes_in(module), effects_in(module)
    unfinished = [c for c in classes if c not in effects and (not effects or "name" in vars(c))]
    if unfinished:
        raise ModelError(
            f"The effect {unfinished[-1].__name__} of {path} lacks "
            f"{', '.join(sorted(unfinished[-1].__abstractmethods__))}.",
            advice="Define it as a method.",
        )
    if not effects:
        raise ModelError(
            f"{path} defines no effect.",
            advice="Derive a class from geodrake.effects.JointEffect and define its columns().",
        )
    taken = {effect.name for effect in catalogue()}
    for effect in effects:
        name = getattr(effect, "name", None)
        missing = [key for key in ("name", "parameters", "places") if not hasattr(effect, key)]
        if missing or not is_dataclass(effect):
            what = ", ".join(missing) or "the line @dataclass(frozen=True)"
            raise ModelError(f"The effect {effect.__name__} of {path} lacks {what}.")
        try:
            check_class(effect)
        except ArgumentError as error:
            raise ModelError(f"{path}: {error.problem}", advice=error.advice) from error
        place = PLACES.get(str(effect.places))
        if place is None or not (
            effect.places in ("log", "robot") or place.field in field_names(effect)
        ):
            raise ModelError(
                f"The effect {effect.__name__} of {path} has places = {effect.places!r} and the "
                f"fields {field_names(effect)}.",
                advice="Derive it from JointEffect, JointPairEffect or BodyEffect, which have "
                "the field that says where the effect is.",
            )
        if name in taken:
            raise ModelError(
                f"The effect {effect.__name__} of {path} has the name {name!r} of another effect.",
                advice="Give it a name of its own.",
            )
        taken.add(effect.name)
    return tuple(effects)


def candidates_of(effect: type[Effect], *place: Any) -> tuple[Effect, ...]:
    """What `Effect.candidates` gives at a place.

    Raises:
        ArgumentError: They are no instances of the effect, or endlessly many.
    """
    line = line_of(effect, "candidates")
    with telling(effect.name, line):
        made: Any = effect.candidates(*place)
        listed = isinstance(made, Sequence | Iterator | frozenset | set)
        found = list(islice(made, _MOST_CANDIDATES + 1)) if listed else [made]
    if len(found) > _MOST_CANDIDATES:
        raise ArgumentError(f"{effect.name} has more than {_MOST_CANDIDATES} candidates{line}.")
    wrong = [one for one in found if getattr(one, "name", None) != effect.name]
    if wrong:
        raise ArgumentError(
            f"{effect.name} has {wrong[0]!r:.80} among its candidates{line}.",
            advice="Let candidates() return instances of the effect.",
        )
    return tuple(found)


class _AsItStands(SourceFileLoader):
    """Compiles a file anew: kept bytecode counts as that of a file of the same second and size."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


def _import(path: Path) -> ModuleType:
    """Imports a file under a name that depends on where it is, so that files do not collide."""
    digest = hashlib.sha256(os.fsencode(path.resolve())).hexdigest()[:12]
    name = f"geodrake_user_effects_{digest}"
    spec = importlib.util.spec_from_file_location(name, path.absolute())
    if spec is None or spec.loader is None:
        raise ModelError(f"{path} is not a Python file.", advice="Give a file that ends in .py.")
    if isinstance(spec.loader, SourceFileLoader):
        spec.loader = _AsItStands(name, str(path.absolute()))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up while they are made
    folder = Path.cwd()
    try:
        with contextlib.redirect_stdout(sys.stderr):  # standard output is for results
            spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever it raises is the file's
        del sys.modules[name]
        words = " ".join(str(error).split()).rstrip(".")
        raise ModelError(
            f"{path} cannot be run: {_line(error, path)}{type(error).__name__}: {words}.",
            advice="Run it with python to see where it fails.",
        ) from error
    if Path.cwd() != folder:
        os.chdir(folder)
        raise ModelError(
            f"{path} changes the working directory to which all other paths belong.",
            advice="Take os.chdir out of it.",
        )
    return module


def _line(error: BaseException, path: Path) -> str:
    """The innermost line of a file that an error came through, in words."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename) == path.absolute()]
    if isinstance(error, SyntaxError) and error.filename == str(path.absolute()):
        lines.append(error.lineno)
    return f"line {lines[-1]}: " if lines and lines[-1] else ""
