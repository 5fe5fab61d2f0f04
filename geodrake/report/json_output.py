"""Results as JSON: plain dictionaries of finite numbers and names, with a reason for every null.

`schema.yaml` defines the kinds of objects, with keys, types, units and reasons;
`tools/result_schema.py` publishes it as JSON Schema. The keys are a stable interface: more may be
added, none are renamed.
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
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, if available


@dataclass(frozen=True)
class NoNumber:
    """A missing number: null in JSON, with the reason."""

    reason: str


class Key(NamedTuple):
    """A key of an object."""

    type: Any
    is_optional: bool  # whether it may be absent
    path: Any  # to its value in the source of the object, as in `schema.yaml`


def picked(value: object, *names: str) -> dict[str, Any]:
    """Return attributes of an object by their names."""
    return {name: getattr(value, name) for name in names}


@cache
def schema() -> Mapping[str, Any]:
    """Return the descriptions of `units`, and the `kinds` of objects with their keys."""
    text = (files("geodrake.report") / "schema.yaml").read_text(encoding="utf-8")
    tables: Mapping[str, Any] = yaml.load(text, _LOADER)
    return tables


@cache
def keys_of(kind: str) -> Mapping[str, Key]:
    """Return the keys of a kind of object by name; inherited ones come first."""
    entry = schema()["kinds"][kind]
    base, paths = keys_of(entry["is"]) if "is" in entry else {}, entry.get("from", {})
    own = {name.rstrip("*"): (type_, name.endswith("*")) for name, type_ in entry["keys"].items()}
    return {**base, **{name: Key(*each, paths.get(name, name)) for name, each in own.items()}}


def type_and_reason(text: str) -> tuple[str, str]:
    """Return the name of a type without its mark, and the reason why it may be null, or ""."""
    name, _, reason = text.partition(" | ")
    return name.rstrip("*"), reason


def record(kind: str, source: object = None, /, **given: Any) -> dict[str, Any]:
    """Build an object of a kind from given values, and from the source for the other keys.

    Nested objects are built likewise, also from tuples of their values. An optional key is written
    only if it is given.
    """
    keys = keys_of(kind)
    if unknown := given.keys() - keys:
        raise KeyError(f"{kind} has no {', '.join(unknown)}")
    return {
        name: _converted(key.type, given[name] if name in given else _value_at(source, key.path))
        for name, key in keys.items()
        if name in given or not key.is_optional
    }


def _value_at(source: Any, path: Any) -> Any:
    """Return the value at a path of an object, or several by name."""
    if isinstance(path, Mapping):
        return {name: _value_at(source, each) for name, each in path.items()}
    values, is_mapping, names = path.partition(" for ")
    if is_mapping:
        return _by_name(_value_at(source, names), _value_at(source, values))
    for part in values.split("."):
        source = _part(source, part)
    return source


def _part(source: Any, name: str) -> Any:
    """Return the object itself, an entry by index, an attribute, or that of each entry."""
    if name == "self":
        return source
    if name.lstrip("-").isdigit():
        return source[int(name)]
    if isinstance(source, list | tuple):
        return [getattr(entry, name) for entry in source]
    value = getattr(source, name)
    return value() if isroutine(value) else value


def _by_name(names: Sequence[str], values: Sequence[Any] | None) -> dict[str, Any]:
    return dict.fromkeys(names) if values is None else dict(zip(names, values, strict=True))


def _converted(type_: Any, value: Any) -> Any:
    """Convert a value to its type, nested objects to records, missing values to their reason."""
    if isinstance(value, NoNumber):
        return value
    if isinstance(type_, dict):
        (inner,) = type_.values()
        return {name: _converted(inner, entry) for name, entry in value.items()}
    if isinstance(type_, list):
        (inner,) = type_
        is_plain = isinstance(inner, str) and type_and_reason(inner)[0] not in schema()["kinds"]
        is_list = is_plain and not isinstance(value, Iterator)
        return value if is_list else [_converted(inner, entry) for entry in value]
    name, reason = type_and_reason(type_)
    if reason and (value is None or (isinstance(value, float) and not math.isfinite(value))):
        return NoNumber(reason)
    if value is None or name not in schema()["kinds"]:
        return value
    if isinstance(value, tuple):
        value = _by_name([*keys_of(name)], value)
    return record(name, **value) if isinstance(value, Mapping) else record(name, value)


def to_json(result: Mapping[str, Any]) -> str:
    """Return a result as JSON text; every number is finite, or null.

    The key `nulls` has the reason for each null, by its place as a JSON pointer, such as
    `/steps/0/deviations/flange/mass`.
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
        nulls: Output; place of each None -> reason.
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
