"""Make docs/results.schema.json: JSON Schema of what commands write with --json.

python tools/result_schema.py
"""

from collections.abc import Mapping, Sequence
from functools import cache
from json import dumps
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from geodrake.report.json_output import keys_of, schema, type_and_reason

PAGE = Path(__file__).parents[1] / "docs" / "results.schema.json"
COMMANDS = {
    "compare": "Comparison",
    "diagnose": "Diagnosis",
    "add": "Explanation",
    "explain": "Explanation",
    "demo": "Explanation",
    "identify": "Identification",
    "rollout": "RolloutBeside",
    "play": "Played",
    "excite": "Excitation",
    "identifiable": "Identifiability",
    "digest": "Digests",
    "fleet": "Fleet",
    "export": "Export",
    "check": "Check",
    "log": "InspectedLogs",
}
SCALARS = {
    "text": str,
    "boolean": bool,
    "integer": int,
    "number": float | None,
    "text or number": str | float | None,
}


@cache
def type_of(name: str, whole: bool = False) -> Any:
    """Return a kind of object as a type; as the whole of a result, with what all of these have."""
    found = {**keys_of(name), **(keys_of("Result") if whole else {})}
    fields = [
        (name, _type(key.type) | UnsetType, UNSET) if key.is_optional else (name, _type(key.type))
        for name, key in found.items()
    ]
    if whole:
        commands = tuple(command for command, kind in COMMANDS.items() if kind == name)
        fields = [("command", Literal[commands]) if f[0] == "command" else f for f in fields]
    how = {"bases": (Closed,), "namespace": {"__doc__": schema()["kinds"][name]["says"]}}
    return msgspec.defstruct(name, fields, **how, kw_only=True)


class Closed(msgspec.Struct, forbid_unknown_fields=True):
    """An object without other keys."""


def _type(said: Any) -> Any:
    if isinstance(said, list):
        return Sequence[_type(said[0])]
    if isinstance(said, dict):
        return Mapping[str, _type(next(iter(said.values())))]
    name, reason = type_and_reason(said)
    units = schema()["units"]
    words = "; ".join(filter(None, [units.get(name), reason and f"null where {reason}"]))
    found = SCALARS.get(name) or (float | None if name in units else type_of(name))
    if reason or said.endswith("*"):
        found = found | None
    return Annotated[found, Meta(description=words)] if words else found


def written_by(command: str) -> Any:
    """Return the type of what a command writes."""
    return type_of(COMMANDS[command], whole=True)


def published() -> str:
    """Return the JSON Schema of all commands."""
    types = {command: written_by(command) for command in COMMANDS}
    alike, kinds = msgspec.json.schema_components(types.values(), ref_template="#/$defs/{name}")
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "What commands of geodrake write with --json",
        "description": schema()["kinds"]["Result"]["says"],
        "anyOf": [one for k, one in enumerate(alike) if one not in alike[:k]],
    }
    lines = (f"  {dumps(name)}: {dumps(kind, ensure_ascii=False)}" for name, kind in kinds.items())
    start = dumps(head, indent=1, ensure_ascii=False).removesuffix("\n}")
    return f'{start},\n "$defs": {{\n' + ",\n".join(lines) + "\n }\n}\n"


if __name__ == "__main__":
    PAGE.write_text(published(), encoding="utf-8")
