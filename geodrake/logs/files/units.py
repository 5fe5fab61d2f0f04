"""Units of log columns, and their conversion to SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec

from geodrake.errors import ArgumentError, nearest

WORDS: Mapping[str, Any] = msgspec.yaml.decode(
    Path(__file__).with_name("words.yaml").read_bytes(), type=dict[str, Any]
)
"""Vocabulary of column names and units."""

_UNITS: dict[str, dict[str, float]] = WORDS["units"]
_MOTIONS = _UNITS["angle"] | _UNITS["length"]
_POSITIONS = _MOTIONS | _UNITS["range"]
_SIGNALS = {kind: _UNITS[kind] for kind in ("current", "voltage", "pwm")}

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": _UNITS["time"],
    "position": _POSITIONS,
    "velocity": {f"{unit}/s": factor for unit, factor in _MOTIONS.items()} | _UNITS["speed"],
    "acceleration": {f"{unit}/s²": factor for unit, factor in _MOTIONS.items()} | {"g": 9.80665},
    "effort": _UNITS["effort"] | _SIGNALS["current"] | _SIGNALS["voltage"] | _SIGNALS["pwm"],
    **_SIGNALS,
    "command": _POSITIONS,
    "temperature": _UNITS["temperature"],
}
"""Quantity -> unit -> factor to rad, m, s, N·m, N, A, V, fraction of the supply or °C.

The factor is NaN if unknown.
"""

_OFFSETS = {"°F": -160.0 / 9.0, "K": -273.15}  # value of 0 in °C
_SPELLINGS = {
    spelling: unit
    for unit, spellings in WORDS["spellings"].items()
    for spelling in spellings.split()
}
_SCALED = re.compile(
    r"(?:(?P<factor>\d*\.?\d+(?:[eE][+-]?\d+)?)[\s*·]*)?(?P<unit>[^\d@]+?)"
    r"(?:/(?P<share>\d+\.?\d*))?(?:@(?P<zero>-?\d+\.?\d*))?"
)
_TEN = re.compile(r"10*(\.0*)?|0?\.0*10*|1(\.0*)?[eE][+-]?\d+")  # powers of ten
_FORM = (
    "or 0.001deg, or rev/4096 for an encoder with 4096 counts a turn, and rev/4096@2048 if "
    "it counts 2048 at position 0."
)


@dataclass(frozen=True)
class Unit:
    """A unit of a quantity; its factor is NaN if unknown."""

    name: str
    factor: float
    offset: float = 0.0  # value of 0 in SI units

    @property
    def signal(self) -> str | None:
        """Signal with this unit that may replace effort, such as "current" for mA; else None."""
        plain = self.name.rpartition(" ")[2]  # without a power of ten
        return next((kind for kind, units in _SIGNALS.items() if plain in units), None)


def unit_advice(quantity: str) -> str:
    """Return advice on the known units of a quantity."""
    return f"Known are {_known(quantity)}; {_FORM}"


def unit_names() -> str:
    """Return the known units of each quantity as text."""
    return "; ".join(f"{quantity} {_known(quantity)}" for quantity in UNITS)


def _known(quantity: str) -> str:
    return ", ".join(name for name, factor in UNITS[quantity].items() if not math.isnan(factor))


def unit_of(text: str, quantity: str) -> Unit:
    """Return the unit given by a user, such as `deg`, `N·mm`, `0.001deg` or `rev/4096@2048`."""
    if quantity not in UNITS:
        raise ArgumentError(
            f"Quantity {quantity!r} is unknown or has no unit.",
            advice=f"{nearest(quantity, UNITS)}Quantities are {', '.join(UNITS)}.",
        )
    unit = _scaled(text, quantity)
    if unit is None or math.isnan(unit.factor):
        raise ArgumentError(
            f"{text!r} is not a known unit of {quantity}.",
            advice=f"{nearest(text, UNITS[quantity])}{unit_advice(quantity)}",
        )
    return unit


def find_unit(text: str, quantity: str) -> Unit | None:
    """Return the unit named by a text such as `°/s`, `N·mm` or `rad_s`, or None."""
    units = UNITS.get(quantity, {})
    for name in _spelled(text.strip()) if text else ():
        if name in units:
            return Unit(name, units[name], _OFFSETS.get(name, 0.0))
    return None


def scaled_unit(text: str, quantity: str) -> Unit | None:
    """Return the unit in a column name, perhaps after a power of ten, or None."""
    match = _SCALED.fullmatch(text.strip())
    is_plain = match is None or not (match["share"] or match["zero"])
    is_scale = match is None or not match["factor"] or _TEN.fullmatch(match["factor"])
    return _scaled(text, quantity) if is_plain and is_scale else find_unit(text, quantity)


def _scaled(text: str, quantity: str) -> Unit | None:
    """Parse a unit with an optional factor, divisor and count at zero."""
    match = _SCALED.fullmatch(text.strip())
    if (plain := find_unit(text, quantity)) is not None or match is None:
        return plain
    factor, inner, share, zero = match.group("factor", "unit", "share", "zero")
    unit = find_unit(inner, quantity)
    scale = float(factor or 1.0) / (float(share or 1.0) or math.inf)
    is_of_model = unit is not None and unit.name in _UNITS["range"]  # scaled by the model
    if unit is None or unit.offset or is_of_model or not 0.0 < scale < math.inf:
        return None
    name = (f"{factor} " if factor else "") + unit.name + (f"/{share}" if share else "")
    if zero is None:
        return Unit(name, scale * unit.factor)
    if quantity not in ("position", "command"):
        return None
    return Unit(f"{name}@{zero}", scale * unit.factor, -float(zero) * scale * unit.factor)


@lru_cache(1024)
def _spelled(text: str) -> tuple[str, ...]:
    """Return alternative spellings: without dots, with a slash, in lower case, singular."""
    text = text[0] if text.startswith(("%", "‰")) else text  # as `% rated`
    plain = re.sub(r"[·*\s.⋅-]", "", text).replace("^2", "²").replace("s2", "s²")
    over = re.sub(r"(?i:_per_|_|per)([Ss]|[Mm]in)", lambda forms: f"/{forms[1].lower()}", plain)
    over = over.replace("/s/s", "/s²")
    over = re.sub(r"/sec(?:ond)?", "/s", over)
    forms = [plain, over]
    for each in (plain, over):
        head, stroke, tail = each.partition("/")
        forms += [_SPELLINGS.get(each.lower(), each), _SPELLINGS.get(head.lower(), head)]
        forms[-1] += stroke + tail
        forms.append(forms[-1].lower())
        if head.islower() and head.endswith("s") and len(head) > 3:  # as in `rads`
            forms.append(head[:-1] + stroke + tail)
    return tuple(each.replace("rev/min", "rpm") for each in forms)
