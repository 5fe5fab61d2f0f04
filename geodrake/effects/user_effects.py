"""Load user-defined effects, and check their classes and candidates."""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import importlib.util
import keyword
import os
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib.machinery import SourceFileLoader
from inspect import get_annotations
from itertools import islice
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from geodrake.boundary.arguments import file_path
from geodrake.boundary.input_files import regular_file
from geodrake.effects.base import SIGNALS, Effect, JointEffect
from geodrake.effects.column_checks import exits_as_errors, line_of
from geodrake.effects.declarations import PLACES, Parameter, Proposer, Role, Shape
from geodrake.effects.deflection import DeflectionEffect
from geodrake.effects.episode import Episode, PointEpisode
from geodrake.effects.friction import SharedActuatorEffect
from geodrake.effects.lookup import catalogue, classes_in, effect_of, effects_in, file_effects
from geodrake.errors import ArgumentError, ModelError

_MOST_CANDIDATES = 1000
_MISSPELLED = 0.8
"""Similarity, up to 1, above which an attribute counts as a misspelled declaration."""

_KINDS: Mapping[type, tuple[Any, str]] = {
    str: (str, "words"),
    bool: (bool, "True or False"),
    int: (int, "an integer"),
    tuple: ((tuple, list), "a tuple"),
    frozenset: ((frozenset, set), "a set"),
    Role: (Role, "a Role"),
}
"""Valid types of class attributes of `Effect`, and their description."""

_BASES: Mapping[Role, type] = {Role.DEFLECTION: DeflectionEffect, Role.EPISODE: Episode}
"""Base class that a role requires; other roles require the catalogue effect with that role."""

_PROPOSED: Mapping[Proposer, type] = {
    Proposer.BENDING: DeflectionEffect,
    Proposer.PLAY: DeflectionEffect,
    Proposer.SHARED_ACTUATOR: SharedActuatorEffect,
    Proposer.WAVES: JointEffect,
    Proposer.WARMING: JointEffect,
    Proposer.BRISTLES: JointEffect,
    Proposer.EPISODE: PointEpisode,
    Proposer.HANDLING: Episode,
}
"""Base class that a proposer requires."""


def load_effect_file(path: str | Path) -> tuple[type[Effect], ...]:
    """Run a user's Python file and return the effects that it defines.

    Args:
        path: A file such as the one in the documentation of `geodrake.effects`.

    Returns:
        Its effects in the order of definition, for use as `extra`.

    Raises:
        ModelError: There is no such file, it cannot be run, or it defines no valid effect.
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
            advice="Derive a class from geodrake.effects.JointEffect and implement columns().",
        )
    taken = {effect.name for effect in (*catalogue(), *file_effects())}
    for effect in effects:
        name = getattr(effect, "name", None)
        missing = [key for key in ("name", "parameters", "places") if not hasattr(effect, key)]
        if missing or not is_dataclass(effect):
            lacking = ", ".join(missing) or "the line @dataclass(frozen=True)"
            raise ModelError(f"The effect {effect.__name__} of {path} lacks {lacking}.")
        try:
            check_class(effect)
        except ArgumentError as error:
            raise ModelError(f"{path}: {error.problem}", advice=error.advice) from error
        place, names = PLACES.get(str(effect.places)), _field_names(effect)
        if place is None or not (effect.places in ("log", "robot") or place.field in names):
            raise ModelError(
                f"The effect {effect.__name__} of {path} has places = {effect.places!r}, but "
                f"the fields {names}.",
                advice="Derive it from JointEffect, JointPairEffect or BodyEffect, which have "
                "the field that says where the effect is.",
            )
        if name in taken:
            raise ModelError(
                f"The effect {effect.__name__} of {path} has the name {name!r} of another effect.",
                advice="Give it another name.",
            )
        taken.add(effect.name)
    return tuple(effects)


def candidates_of(effect: type[Effect], *place: Any) -> tuple[Effect, ...]:
    """Return the candidates of `Effect.candidates` at a place."""
    line = line_of(effect, "candidates")
    with exits_as_errors(effect.name, line):
        result: Any = effect.candidates(*place)
        is_several = isinstance(result, Sequence | Iterator | frozenset | set)
        candidates = list(islice(result, _MOST_CANDIDATES + 1)) if is_several else [result]
    if len(candidates) > _MOST_CANDIDATES:
        raise ArgumentError(f"{effect.name} has more than {_MOST_CANDIDATES} candidates{line}.")
    foreign = [value for value in candidates if getattr(value, "name", None) != effect.name]
    if foreign:
        raise ArgumentError(
            f"{effect.name} has {foreign[0]!r:.80} among its candidates{line}.",
            advice="Let candidates() return instances of the effect.",
        )
    return tuple(candidates)


def check_class(effect: type[Effect]) -> None:
    """Raise if the class attributes of an effect are invalid."""
    _check_names(effect)

    def check(valid: bool, has: str, wanted: str) -> None:
        if not valid:
            raise _class_error(effect, has, wanted)

    name: Any = effect.name
    is_name = isinstance(name, str) and name.isidentifier() and not keyword.iskeyword(name)
    check(is_name, f"the name {name!r}", "words joined by underscores")
    parameters: Any = effect.parameters
    listed = isinstance(parameters, tuple | list) and len(parameters) > 0
    check(
        listed and all(isinstance(parameter, Parameter) for parameter in parameters),
        f"parameters = {parameters!r:.60}",
        "a tuple of one Parameter or more",
    )
    names = [parameter.name for parameter in parameters]
    repeated = [name for name in names if names.count(name) > 1]
    check(not repeated, f"two parameters {', '.join(repeated[:1])!r}", "distinct names")
    for attribute in Effect.__annotations__:
        kind = type(getattr(Effect, attribute, None))
        value = getattr(effect, attribute)
        if kind in _KINDS and not isinstance(value, property):
            kinds, wanted = _KINDS[kind]
            fits = isinstance(value, kinds) and not (isinstance(value, bool) and kind is not bool)
            check(fits, f"{attribute} = {value!r:.60}", wanted)
    signals = f"some of {', '.join(sorted(SIGNALS))}"
    check(effect.depends_on <= SIGNALS, f"depends_on = {effect.depends_on!r:.60}", signals)
    shapes = all(isinstance(shape, Shape) for shape in effect.shapes)
    check(shapes, f"shapes = {effect.shapes!r:.60}", "a tuple of Shape")
    check(effect.state_count >= 0, f"state_count = {effect.state_count}", "0 or more")
    related = all(_is_effect(kind) for kind in effect.contains)
    check(related, f"contains = {effect.contains!r:.60}", "a tuple of classes of effects")
    related = effect.companion is None or _is_effect(effect.companion)
    check(related, f"companion = {effect.companion!r:.60}", "the class of an effect, or None")
    role, proposer = effect.role, effect.proposer
    if role is not Role.FORCE:
        base = _BASES.get(role) or effect_of(role)
        check(issubclass(effect, base), f"role = {role}", f"the base {base.__name__} for it")
    if proposer is None:
        return
    has, names = f"proposer = {proposer!s:.60}", _field_names(effect)
    check(isinstance(proposer, Proposer), f"proposer = {proposer!r:.60}", "a Proposer, or None")
    base = _PROPOSED[proposer]
    check(issubclass(effect, base), has, f"the base {base.__name__} for it")
    has_order = proposer is not Proposer.WAVES or len(names) == 2
    check(has_order, f"{has} and the fields {names}", "the joint and the order of the waves")
    needs_course = proposer in (Proposer.WARMING, Proposer.BRISTLES)
    check(not needs_course or effect.course is not Effect.course, has, "the method course() for it")


def _check_names(effect: type[Effect]) -> None:
    """Raise if an attribute hides a method of geodrake, or misspells a declaration."""
    user = [kind for kind in effect.__mro__ if issubclass(kind, Effect) and not _is_ours(kind)]
    ours: Any = next(kind for kind in effect.__mro__ if _is_ours(kind))
    declared = set(Effect.__annotations__)
    for kind in user:
        known = declared | {"where"} | set(get_annotations(kind))
        for attribute, value in tuple(vars(kind).items()):
            is_code = callable(value) or hasattr(value, "__get__")
            if attribute in known or attribute.startswith("_") or is_code:
                continue
            has, hidden = f"{attribute} = {value!r:.60}", getattr(ours, attribute, None)
            if hidden is not None and not getattr(hidden, "__isabstractmethod__", False):
                raise _class_error(effect, has, "a method of that name")
            if similar := difflib.get_close_matches(attribute, declared, 1, _MISSPELLED):
                raise _class_error(effect, f"{has}, which is not used", similar[0])


def _is_ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "geodrake"


def _is_effect(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, Effect)


def _class_error(effect: type[Effect], has: str, wanted: str) -> ArgumentError:
    return ArgumentError(f"The effect {effect.__name__} has {has}; it needs {wanted}.")


def _field_names(effect: type[Effect]) -> list[str]:
    return [field.name for field in fields(effect)]  # type: ignore[arg-type]


class _UncachedLoader(SourceFileLoader):
    """Always compile the file: cached bytecode is not invalidated by a quick edit of equal size."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


def _import(path: Path) -> ModuleType:
    """Import a file under a name derived from its path, so that files do not collide."""
    digest = hashlib.sha256(os.fsencode(path.resolve())).hexdigest()[:12]
    name = f"geodrake_user_effects_{digest}"
    spec = importlib.util.spec_from_file_location(name, path.absolute())
    if spec is None or spec.loader is None:
        raise ModelError(f"{path} is not a Python file.", advice="Give a file that ends in .py.")
    if isinstance(spec.loader, SourceFileLoader):
        spec.loader = _UncachedLoader(name, str(path.absolute()))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look up their module
    folder = Path.cwd()
    try:
        with contextlib.redirect_stdout(sys.stderr):  # standard output is for results
            spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # including SystemExit
        del sys.modules[name]
        words = " ".join(str(error).split()).rstrip(".")
        raise ModelError(
            f"{path} cannot be run: {_line(error, path)}{type(error).__name__}: {words}.",
            advice="Run it with python to see where it fails.",
        ) from error
    if Path.cwd() != folder:
        os.chdir(folder)
        raise ModelError(
            f"{path} changes the working directory, but other paths are relative to it.",
            advice="Remove os.chdir from it.",
        )
    return module


def _line(error: BaseException, path: Path) -> str:
    """Return "line N: " for the innermost line of a file in a traceback."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename) == path.absolute()]
    if isinstance(error, SyntaxError) and error.filename == str(path.absolute()):
        lines.append(error.lineno)
    return f"line {lines[-1]}: " if lines and lines[-1] else ""
