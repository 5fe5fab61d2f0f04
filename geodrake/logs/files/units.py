"""Units that columns of a log may be in, and how many SI units each is."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from geodrake.errors import ArgumentError

_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi}
_ANGLES["mdeg"] = 1e-3 * _ANGLES["deg"]
_ANGLES["ticks"] = 2 * math.pi / 4096  # of servos with twelve bits a turn
_MIDDLE = "ticks@2048"  # from the middle of the turn on, as drivers of such servos count angles
_PLACES = {_MIDDLE: _ANGLES["ticks"]}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "days": 86400.0}
_EFFORTS = {"Nm": 1.0, "Nmm": 1e-3, "mNm": 1e-3, "Ncm": 1e-2, "kNm": 1e3, "N": 1.0, "kN": 1e3}
_SIGNALS = {
    "current": {"A": 1.0, "mA": 1e-3},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "pwm": {"share": 1.0, "%": 1e-2, "permille": 1e-3},
}

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": _TIMES,
    "position": _ANGLES | _PLACES | _LENGTHS,
    "velocity": {f"{unit}/s": factor for unit, factor in (_ANGLES | _LENGTHS).items()}
    | {"rpm": 2 * math.pi / 60},
    "acceleration": {f"{unit}/s²": factor for unit, factor in (_ANGLES | _LENGTHS).items()},
    "effort": _EFFORTS | _SIGNALS["current"] | _SIGNALS["voltage"] | _SIGNALS["pwm"],
    **_SIGNALS,
    "command": _ANGLES | _PLACES | _LENGTHS,
    "temperature": {"°C": 1.0, "°F": 5.0 / 9.0, "K": 1.0},
}
"""Quantity -> unit -> how many rad, m, s, N·m, N, A, V, shares of the supply or °C it is."""

_OFFSETS = {"°F": -160.0 / 9.0, "K": -273.15, _MIDDLE: -math.pi}  # °C, and rad, at 0 of them

_SPELLINGS = {
    spelling: unit
    for unit, spellings in {
        "deg": "° degree degrees",
        "ticks": "tick",
        "rad": "radian radians",
        "rad/s": "rads",
        "deg/s": "degs",
        "rev/s": "rps",
        "rev": "turn turns revs",
        "rpm": "1/min",
        "s": "sec secs second seconds",
        "ms": "msec millis milliseconds",
        "us": "µs μs usec",
        "ns": "nsec nsecs nanosec nanosecs",
        "A": "amp amps",
        "V": "volt volts",
        "%": "percent pct",
        "permille": "‰",
        "°C": "c degc celsius",
        "°F": "f degf fahrenheit",
        "K": "kelvin",
        "days": "day",
    }.items()
    for spelling in spellings.split()
}
"""What people write, in small letters -> how it is written here."""


@dataclass(frozen=True)
class Unit:
    """A unit of a quantity."""

    name: str
    factor: float
    offset: float = 0.0  # what 0 of it is in SI units

    @property
    def signal(self) -> str | None:
        """What it measures in the place of efforts, "current" for mA; None for other units."""
        return next((kind for kind, units in _SIGNALS.items() if self.name in units), None)


def unit_of(text: str, quantity: str) -> Unit:
    """Return the unit that a text stands for, such as `deg`, `°/s`, `N·mm` or `rad_s`."""
    if quantity not in UNITS:
        raise ArgumentError(
            f"There is no quantity {quantity!r} that has a unit.",
            advice=f"Quantities are {', '.join(UNITS)}.",
        )
    unit = scaled_unit(text, quantity)
    if unit is None:
        raise ArgumentError(
            f"{text!r} is no known unit of {quantity}.",
            advice=f"Known are {', '.join(UNITS[quantity])}; others as a gain to SI.",
        )
    return unit


def find_unit(text: str, quantity: str) -> Unit | None:
    """Return the unit that a text stands for, or None; see `unit_of`."""
    known = UNITS.get(quantity, {})
    for name in _spelled(text.strip()) if text else ():
        if name in known:
            return Unit(name, known[name], _OFFSETS.get(name, 0.0))
    return None


def scaled_unit(text: str, quantity: str) -> Unit | None:
    """Return the unit that a text stands for, which a power of ten may precede: `0.001deg`."""
    if (unit := find_unit(text, quantity)) is not None:
        return unit
    found = re.fullmatch(r"(\d*\.?\d+(?:[eE][+-]?\d+)?)[\s*·]*(\D+)", text.strip())
    inner = find_unit(found[2], quantity) if found else None
    if inner is None or found is None or inner.offset or not _TEN.fullmatch(found[1]):
        return None
    return Unit(f"{found[1]} {inner.name}", float(found[1]) * inner.factor)


_TEN = re.compile(r"10*(\.0*)?|0?\.0*10*|1(\.0*)?[eE][+-]?\d+")  # powers of it


@lru_cache(1024)
def _spelled(text: str) -> tuple[str, ...]:
    """Return ways to write a unit: as it is, without dots, with a slash, in small letters."""
    plain = re.sub(r"[·*\s.⋅-]", "", text).replace("^2", "²").replace("s2", "s²")
    over = re.sub(r"(?:_|per)(s|min)", r"/\1", plain)
    over = over.replace("/s/s", "/s²").replace("/sec", "/s")
    found = [plain, over]
    for each in (plain, over):
        head, stroke, tail = each.partition("/")
        found += [_SPELLINGS.get(each.lower(), each), _SPELLINGS.get(head.lower(), head)]
        found[-1] += stroke + tail
        found.append(found[-1].lower())
    return tuple(each.replace("rev/min", "rpm") for each in found)
