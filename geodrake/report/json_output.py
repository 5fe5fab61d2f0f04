"""Results as JSON: plain dictionaries of finite numbers and names; every null comes with a reason.

The kinds of objects, with keys, types, units and reasons, stand in `schema.yaml`. Results are
written by these tables, and `tools/result_schema.py` publishes them as JSON Schema. The keys are a
stable interface; more may be added, none are renamed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib.resources import files
from inspect import isroutine
from pathlib import Path
from typing import Any, NamedTuple

import yaml  # type: ignore[import-untyped]

from geodrake.boundary.escaping import json_text

_TOKENS = str.maketrans({"~": "~0", "/": "~1"})  # of keys in a JSON pointer (RFC 6901)
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast where it is built


@dataclass(frozen=True)
class NoNumber:
    """A missing number: null in JSON, with the reason."""

    reason: str


class Key(NamedTuple):
    """A key of an object."""

    type: Any
    is_optional: bool  # whether it may be absent
    place: Any  # where its value is in what the object is of, as `schema.yaml` says it


def picked(value: object, *names: str) -> dict[str, Any]:
    """Return attributes of an object by their names."""
    return {name: getattr(value, name) for name in names}


@cache
def schema() -> Mapping[str, Any]:
    """Return the tables: `units` with their words, and `kinds` of objects with their keys."""
    text = (files("geodrake.report") / "schema.yaml").read_text(encoding="utf-8")
    found: Mapping[str, Any] = yaml.load(text, _LOADER)
    return found


@cache
def keys_of(kind: str) -> Mapping[str, Key]:
    """Return the keys of a kind of object by name; inherited ones come first."""
    said = schema()["kinds"][kind]
    base, places = keys_of(said["is"]) if "is" in said else {}, said.get("from", {})
    own = {name.rstrip("*"): (type_, name.endswith("*")) for name, type_ in said["keys"].items()}
    return {**base, **{name: Key(*each, places.get(name, name)) for name, each in own.items()}}


def type_and_reason(said: str) -> tuple[str, str]:
    """Return the name of a type without its mark, and why a value may be null, or ""."""
    name, _, reason = said.partition(" | ")
    return name.rstrip("*"), reason


def record(kind: str, source: object = None, /, **given: Any) -> dict[str, Any]:
    """Build an object of a kind from given values, and from what the source has for the rest.

    Nested objects are built likewise, also from tuples of their values. An optional key is written
    only if it is given.
    """
    keys = keys_of(kind)
    if unknown := given.keys() - keys:
        raise KeyError(f"{kind} has no {', '.join(unknown)}")
    return {
        name: _made(key.type, given[name] if name in given else _at(source, key.place))
        for name, key in keys.items()
        if name in given or not key.is_optional
    }


def _at(source: Any, place: Any) -> Any:
    """Return the value at a path of an object, or several by name."""
    if isinstance(place, Mapping):
        return {name: _at(source, each) for name, each in place.items()}
    values, by, names = place.partition(" for ")
    if by:
        return _by_name(_at(source, names), _at(source, values))
    for part in values.split("."):
        source = _part(source, part)
    return source


def _part(source: Any, name: str) -> Any:
    """Return the object itself, an entry by its number, an attribute, or that of each entry."""
    if name == "self":
        return source
    if name.lstrip("-").isdigit():
        return source[int(name)]
    if isinstance(source, list | tuple):
        return [getattr(one, name) for one in source]
    found = getattr(source, name)
    return found() if isroutine(found) else found


def _by_name(names: Sequence[str], values: Sequence[Any] | None) -> dict[str, Any]:
    return dict.fromkeys(names) if values is None else dict(zip(names, values, strict=True))


def _made(said: Any, value: Any) -> Any:
    """Convert a value to its type, nested objects to records, missing values to their reason."""
    if isinstance(value, NoNumber):
        return value
    if isinstance(said, dict):
        (inner,) = said.values()
        return {name: _made(inner, one) for name, one in value.items()}
    if isinstance(said, list):
        (inner,) = said
        is_plain = isinstance(inner, str) and type_and_reason(inner)[0] not in schema()["kinds"]
        is_there = is_plain and not isinstance(value, Iterator)
        return value if is_there else [_made(inner, one) for one in value]
    name, reason = type_and_reason(said)
    if reason and (value is None or (isinstance(value, float) and not math.isfinite(value))):
        return NoNumber(reason)
    if value is None or name not in schema()["kinds"]:
        return value
    if isinstance(value, tuple):
        value = _by_name([*keys_of(name)], value)
    return record(name, **value) if isinstance(value, Mapping) else record(name, value)


def to_json(result: Mapping[str, Any]) -> str:
    """Return the text of a result; every number in it is finite, or null with a reason.

    Where there is a null, the key `nulls` says of each why: its place as a JSON pointer, such as
    `/steps/0/deviations/flange/mass`, and the reason in words.
    """
    nulls: dict[str, str] = {}
    plain = plain_of(result, "", nulls)
    if nulls:
        plain["nulls"] = nulls
    return json_text(json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)) + "\n"


def plain_of(value: Any, place: str, nulls: dict[str, str]) -> Any:
    """Return a value in dictionaries, lists, strings, Python numbers and None.

    Args:
        place: JSON pointer to the value.
        nulls: Filled with the place of each None, and its reason.
    """
    if isinstance(value, float) and not math.isfinite(value):
        value = NoNumber("was not determined" if math.isnan(value) else "is infinite")
    elif value is None:
        value = NoNumber("does not apply here")
    if isinstance(value, NoNumber):
        nulls[place] = value.reason
        return None
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {
            str(k): plain_of(v, f"{place}/{str(k).translate(_TOKENS)}", nulls)
            for k, v in value.items()
        }
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return plain_of(value.tolist(), place, nulls)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [plain_of(item, f"{place}/{k}", nulls) for k, item in enumerate(value)]
    return value
