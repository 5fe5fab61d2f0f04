"""What YAML files hold, as schemas have it: errors name the place and the value."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterable
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from geodrake.errors import ArgumentError

T = TypeVar("T")


class Schema(msgspec.Struct, forbid_unknown_fields=True):
    """A table of a file: its fields, their types and defaults."""


def as_schema(content: object, schema: type[T]) -> T:
    """Return what is there as a schema has it; text of a number counts as the number.

    Raises:
        ArgumentError: Some field is none of the schema's, is not there, or is of another type.
    """
    try:
        return msgspec.convert(content, schema, strict=False)
    except (msgspec.MsgspecError, RecursionError, OverflowError) as error:
        place, value, kind = _fault(content, schema, "")
        raise _refusal(place, value, kind) from error


def _fault(content: object, schema: Any, place: str) -> tuple[str, object, Any]:
    """Return the place, value and schema of the innermost that does not fit."""
    for key, value, kind in _children(content, schema):
        if _misfit(value, kind) is not None:
            inner = f"{place}[{key}]" if isinstance(key, int) else f"{place}.{key}".lstrip(".")
            return _fault(value, kind, inner)
    return place, content, schema


def _misfit(content: object, schema: Any) -> Exception | None:
    try:
        msgspec.convert(content, schema, strict=False)
    except (msgspec.MsgspecError, RecursionError, OverflowError) as error:
        return error
    return None


def _children(content: object, schema: Any) -> Iterable[tuple[Any, object, Any]]:
    """Yield key, value and schema of what is in a list or table."""
    if get_origin(schema) in (Union, types.UnionType):
        schema = next(x for x in get_args(schema) if x is not type(None))
    if isinstance(content, dict) and isinstance(schema, type) and issubclass(schema, Schema):
        kinds = get_type_hints(schema)
        return [(key, value, kinds[key]) for key, value in content.items() if key in kinds]
    inside = get_args(schema)[-1:]
    if isinstance(content, list) and get_origin(schema) is list:
        return [(at, value, inside[0]) for at, value in enumerate(content)]
    if isinstance(content, dict) and get_origin(schema) is dict:
        return [(key, value, inside[0]) for key, value in content.items()]
    return []


def _refusal(place: str, value: object, schema: Any) -> ArgumentError:
    what = place or "it"
    fields = list(get_type_hints(schema)) if hasattr(schema, "__struct_fields__") else []
    advice = f"Its fields are: {', '.join(fields)}." if fields else ""
    odd = [key for key in value if key not in fields] if isinstance(value, dict) and fields else []
    if odd:
        near = difflib.get_close_matches(str(odd[0]), fields, 1)
        meant = f" (was {near[0]} meant?)" if near else ""
        return ArgumentError(f"{what} has {odd[0]!r:.60}, which is none{meant}.", advice=advice)
    reason = str(_misfit(value, schema)).partition(" - at `")[0].replace("`", "")
    if isinstance(value, dict):
        return ArgumentError(f"{what} lacks its {reason.rpartition(' ')[2]}.", advice=advice)
    wanted = reason.replace("object", "table of fields").replace("array", "list")
    return ArgumentError(f"{what} = {value!s:.80}: {wanted[0].lower()}{wanted[1:]}.", advice=advice)
