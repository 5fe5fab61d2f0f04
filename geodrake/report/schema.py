"""The kinds of objects in JSON: their keys, types and units stand in `schema.yaml`.

Results are written by these tables, and `tools/result_schema.py` publishes them as JSON Schema. The
keys are a stable interface; more may be added, none are renamed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

import yaml  # type: ignore[import-untyped]

from geodrake.report.json_output import NoNumber

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast where it is built


@cache
def schema() -> Mapping[str, Any]:
    """Return the tables: `units` with their words, and `kinds` of objects with their keys."""
    text = (files("geodrake.report") / "schema.yaml").read_text(encoding="utf-8")
    found: Mapping[str, Any] = yaml.load(text, _LOADER)
    return found


@cache
def keys_of(kind: str) -> Mapping[str, tuple[Any, bool]]:
    """Return key -> its type, and whether it may be absent; inherited keys come first."""
    said = schema()["kinds"][kind]
    base = keys_of(said["is"]) if "is" in said else {}
    return {**base, **{k.rstrip("?"): (t, k.endswith("?")) for k, t in said["keys"].items()}}


def record(kind: str, source: object = None, /, **given: Any) -> dict[str, Any]:
    """Build an object of a kind from given values, and from attributes of the source for the rest.

    Nested objects are built likewise. An optional key is written only if it is given.
    """
    keys = keys_of(kind)
    if unknown := given.keys() - keys:
        raise KeyError(f"{kind} has no {', '.join(unknown)}")
    return {
        key: _made(said, given[key] if key in given else getattr(source, key))
        for key, (said, is_optional) in keys.items()
        if key in given or not is_optional
    }


def _made(said: Any, value: Any) -> Any:
    """Convert a value to its type, nested objects to records."""
    if value is None or isinstance(value, NoNumber):
        return value
    if isinstance(said, dict):
        (inner,) = said.values()
        return {name: _made(inner, one) for name, one in value.items()}
    if isinstance(said, list):
        is_plain = isinstance(said[0], str) and said[0] not in schema()["kinds"]
        if is_plain:
            return [*value] if isinstance(value, Iterator) else value
        return [_made(said[0], one) for one in value]
    if (name := said.rstrip("?")) not in schema()["kinds"]:
        return value
    return record(name, **value) if isinstance(value, Mapping) else record(name, value)
