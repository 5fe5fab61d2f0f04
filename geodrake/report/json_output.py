"""Results as JSON: plain dictionaries of finite numbers and names; every null comes with a reason.

The keys of an explanation are a stable interface; more may be added, none are renamed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any

from geodrake.boundary.escaping import json_text

if TYPE_CHECKING:
    from geodrake.diagnosis.columns import ColumnFinding


_TOKENS = str.maketrans({"~": "~0", "/": "~1"})  # of keys in a JSON pointer (RFC 6901)


@dataclass(frozen=True)
class NoNumber:
    """What stands for a number that there is not: null in JSON, with the reason."""

    reason: str


def number_or(value: float | None, reason: str) -> float | NoNumber:
    """Return a finite number, or the word for one that is not."""
    return NoNumber(reason) if value is None or not math.isfinite(value) else value


def picked(value: object, *names: str, **others: str) -> dict[str, Any]:
    """Return attributes of an object by their names, or by others: `key="attribute"`."""
    return {key: getattr(value, name) for key, name in ({n: n for n in names} | others).items()}


def finite(value: object, reason: str, *names: str) -> dict[str, Any]:
    """Return numbers of an object by their names, with a reason for those that are none."""
    return {name: number_or(getattr(value, name), reason) for name in names}


def columns_list(columns: Sequence[ColumnFinding]) -> list[dict[str, Any]]:
    """Return what is wrong with columns as plain data."""
    return [
        asdict(each) | {"rivals": [{"words": w, "probability": p} for w, p in each.rivals]}
        for each in columns
    ]


def to_json(result: Mapping[str, Any]) -> str:
    """Return the text of a result; every number in it is finite, or null with a reason.

    Where there is a null, the key `nulls` says of each why: its place as a JSON pointer, such as
    `/steps/0/deviations/flange/mass`, and the reason in words.
    """
    nulls: dict[str, str] = {}
    plain = _plain(result, "", nulls)
    if nulls:
        plain["nulls"] = nulls
    return json_text(json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)) + "\n"


def _plain(value: Any, place: str, nulls: dict[str, str]) -> Any:
    """Return the value in dictionaries, lists, strings, Python numbers and None."""
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
            str(k): _plain(v, f"{place}/{str(k).translate(_TOKENS)}", nulls)
            for k, v in value.items()
        }
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return _plain(value.tolist(), place, nulls)
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_plain(item, f"{place}/{k}", nulls) for k, item in enumerate(value)]
    return value
