"""Schemas of YAML files, with errors that name the place and the value."""

from __future__ import annotations

import dataclasses
import difflib
import types
from collections.abc import Iterable
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from geodrake.errors import ArgumentError

T = TypeVar("T")

_WORDS = {
    "float": "a number",
    "int": "an integer",
    "str": "text",
    "bool": "true or false",
    "object": "a table of fields",
    "array": "a list",
    "null": "nothing",
}


class Schema(msgspec.Struct, forbid_unknown_fields=True):
    """A table of a file: its fields, their types and defaults."""


def schema_of(kind: Any) -> type[Schema]:
    """Return the schema of a table with the fields of a dataclass."""
    hints, fields = get_type_hints(kind), list[tuple[str, Any, Any]]()
    for field in dataclasses.fields(kind):
        default, factory = field.default, field.default_factory
        options = {} if default is dataclasses.MISSING else {"default": default}
        options |= {} if factory is dataclasses.MISSING else {"default_factory": factory}
        fields.append((field.name, hints[field.name], msgspec.field(**options)))
    return msgspec.defstruct(kind.__name__, fields, bases=(Schema,))  # type: ignore[return-value]


def as_schema(content: object, schema: type[T]) -> T:
    """Convert a value to a schema; numeric text is converted to numbers.

    Raises:
        ArgumentError: A field is unknown, missing, or of another type.
    """
    try:
        return msgspec.convert(content, schema, strict=False)
    except (msgspec.MsgspecError, RecursionError, OverflowError) as error:
        place, value, kind = _fault(content, schema, "")
        raise _refusal(place, value, kind) from error


def _fault(content: object, schema: Any, place: str) -> tuple[str, object, Any]:
    """Return the place, value and schema of the innermost invalid value."""
    for key, value, kind in _children(content, schema):
        if _misfit(value, kind):
            inner = f"{place}[{key}]" if isinstance(key, int) else f"{place}.{key}".lstrip(".")
            return _fault(value, kind, inner)
    return place, content, schema


def _misfit(content: object, schema: Any) -> str:
    """Return msgspec's message about a value, without its place; "" if valid."""
    try:
        msgspec.convert(content, schema, strict=False)
    except (msgspec.MsgspecError, RecursionError, OverflowError) as error:
        return str(error).partition(" - at `")[0].replace("`", "")
    return ""


def _children(content: object, schema: Any) -> Iterable[tuple[Any, object, Any]]:
    """Return key, value and schema of the items of a list or table."""
    if get_origin(schema) in (Union, types.UnionType):
        schema = next(x for x in get_args(schema) if x is not type(None))
    item = get_args(schema)[-1:]
    if isinstance(content, list) and get_origin(schema) is list:
        return [(k, value, item[0]) for k, value in enumerate(content)]
    if not isinstance(content, dict):
        return []
    if get_origin(schema) is dict:
        return [(str(key), value, item[0]) for key, value in content.items()]
    kinds = get_type_hints(schema) if _fields(schema) else {}
    return [(key, x, kinds[key]) for key, x in content.items() if key in _fields(schema)]


def _fields(schema: Any) -> tuple[str, ...]:
    return getattr(schema, "__struct_fields__", ())


def _refusal(place: str, value: object, schema: Any) -> ArgumentError:
    subject, fields, reason = place or "it", _fields(schema), _misfit(value, schema)
    advice = f"Its fields are {', '.join(fields)}." if fields else ""
    unknown = [key for key in value if key not in fields] if isinstance(value, dict) else []
    if fields and unknown:
        similar = difflib.get_close_matches(str(unknown[0]), fields, 1)
        hint = f" (was {similar[0]} meant?)" if similar else ""
        problem = f"{subject} has the unknown field {unknown[0]!r:.60}{hint}."
        return ArgumentError(problem, advice=advice)
    if any(not isinstance(key, str) for key in unknown):
        name = next(key for key in unknown if not isinstance(key, str))
        return ArgumentError(f"{subject} has {name!r:.60} as a name.", advice="Put it in quotes.")
    if reason.startswith("Object missing"):
        return ArgumentError(f"{subject} lacks its {reason.rpartition(' ')[2]}.", advice=advice)
    words = " ".join(_WORDS.get(word, word) for word in reason.lower().replace(",", " but").split())
    if get_origin(schema) is Literal:
        words = f"expected one of {', '.join(repr(choice) for choice in get_args(schema))}"
    shown = f" = {value!s:.80}" if place else ""
    return ArgumentError(f"{subject}{shown}: {words}.", advice=advice)
