"""Formatting of numbers, standard deviations, shares, probabilities and units."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from geodrake.boundary.escaping import printable
from geodrake.effects import Effect, catalogue
from geodrake.effects.declarations import Role, when_sliding
from geodrake.model.effort_signal import SERVO
from geodrake.model.robot_model import RobotModel

UNKNOWN = "–"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SERVO_UNITS = {"gain": "N·m/rad", "damping": "N·m·s/rad", "integral": "N·m/(rad·s)", "delay": "s"}
_LEAST_CHANCE = 1e-6
_NOTICED = 0.3  # largest statistical over systematic deviation at which the latter is shown


def number(value: float, digits: int = 3) -> str:
    """Return a value with the given significant digits, times 10ⁿ if very small or large."""
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0:
        return "0"
    exponent = _exponent(value, digits)
    if not -4 <= exponent < max(6, digits):
        return f"{_fixed(value / 10.0**exponent, digits - 1)}{_power(exponent)}"
    return _fixed(value, digits - 1 - exponent)


def with_deviation(value: float, deviation: float, systematic: float = math.nan) -> str:
    """Return a value with its standard deviation and matching digits, such as `3.084 ± 0.012`.

    A systematic deviation, which more data do not reduce, is added if it is large enough:
    `3.084 ± 0.012 ± 0.154`. The deviation is omitted unless it is positive and finite.
    """
    if not (math.isfinite(value) and math.isfinite(deviation) and deviation > 0):
        return number(value)
    exponent = _exponent(deviation, 2)
    digits = 2 if round(deviation / 10.0**exponent, 1) < 3 else 1
    largest = _exponent(max(abs(value), deviation), 3)
    scale = 0 if -4 <= largest < 6 else largest
    decimals = digits - 1 - exponent + scale
    parts = [value, deviation]
    if is_noticed(deviation, systematic):
        parts.append(systematic)
    text = " ± ".join(_fixed(part / 10.0**scale, decimals) for part in parts)
    return f"({text}){_power(scale)}" if scale else text


def if_known(value: float, deviation: float) -> str:
    """Return `with_deviation`, or `unknown, ± …` if the deviation is at least the value."""
    if math.isfinite(deviation) and deviation >= abs(value):
        return f"unknown, ± {number(deviation, 2)}"
    return with_deviation(value, deviation)


def is_noticed(deviation: float, systematic: float) -> bool:
    """Return whether a systematic deviation is large enough to be shown."""
    return math.isfinite(systematic) and 0.0 < deviation < systematic / _NOTICED


def estimate(value: float, deviation: float, systematic: float = math.nan) -> str:
    """Return a value with its standard deviation, or in plain digits without one."""
    if math.isfinite(deviation):
        return with_deviation(value, deviation, systematic)
    text = number(value, 4)
    return text.rstrip("0").rstrip(".") if "." in text and "·" not in text else text


def percent(share: float) -> str:
    """Return a share in percent, with more digits near 0 and 100 %."""
    if not math.isfinite(share):
        return UNKNOWN
    if 0.9995 <= share < 1:
        return "> 99.9 %"
    if 0 < share < 0.0005:
        return "< 0.1 %"
    close = 0 < share < 0.0995 or 0.9895 <= share < 1
    return f"{100 * share:.{1 if close else 0}f} %".replace("-", "−")


def chance(probability: float) -> str:
    """Return a probability, or `< 10⁻⁶`."""
    return "< 10⁻⁶" if probability < _LEAST_CHANCE else number(probability, 2)


def relative(deviation: float) -> str:
    """Return a relative deviation: `12 %`, or `3.1 times its size`."""
    if not math.isfinite(deviation):
        return "unknown"
    return percent(deviation) if deviation < 1 else f"{number(deviation)} times its size"


def shortened(text: str, most: int) -> str:
    """Return a printable text of at most `most` characters, omitting its middle if needed."""
    text = printable(text)
    if len(text) <= most:
        return text
    tail = (most - 1) // 2
    return f"{text[: most - 1 - tail]}…{text[len(text) - tail :]}"


@dataclass(frozen=True)
class Units:
    """Units of a robot's joints and of the parameters of effects.

    Attributes:
        joints: Names of all joints.
        prismatic: Names of joints whose effort is a force, N, and whose position is in m.
        effects: Effect classes by name, of the catalogue and the user.
        base: Names of the joints of a free base, which have no joint effects.
    """

    joints: tuple[str, ...] = ()
    prismatic: frozenset[str] = frozenset()
    effects: Mapping[str, type[Effect]] = field(
        default_factory=lambda: {effect.name: effect for effect in catalogue()}
    )
    base: frozenset[str] = frozenset()

    @property
    def driven(self) -> tuple[str, ...]:
        """All joints except those of a free base."""
        return tuple(joint for joint in self.joints if joint not in self.base)

    @classmethod
    def of(cls, model: RobotModel, extra: Sequence[type[Effect]] = ()) -> Units:
        """Return the units of a model's joints and effects, and of further effects."""
        kinds = {kind.name: kind for kind in (*extra, *(type(f.effect) for f in model.effects))}
        effects, base = {**cls().effects, **kinds}, frozenset(model.base_joints)
        return cls(model.joints, frozenset(model.sliding_joints), effects, base)

    def at(self, joint: str, unit: str) -> str:
        """Return the unit at a joint, given that at a revolute joint."""
        return when_sliding(unit) if joint in self.prismatic else unit

    def effort(self, joints: Collection[str] | None = None) -> str:
        """Return the unit of the efforts of several joints, or of all: `N·m`, `N` or `N·m or N`."""
        names = self.joints if joints is None else joints
        units = {self.at(joint, "N·m") for joint in names} or {"N·m"}
        return " or ".join(sorted(units, reverse=True))

    def parameter(self, effect: str, name: str, place: str) -> str:
        """Return the unit of a parameter at a place, such as `a & b`; "" if dimensionless."""
        if self._in_milliseconds(effect, name):
            return "ms"
        unit = self._unit(effect, name)
        return "" if unit == "1" else self.at(place.partition(" & ")[0], unit)

    def shown(self, effect: str, name: str, value: float) -> float:
        """Return a parameter's value in its displayed unit; see `parameter`."""
        return 1e3 * value if self._in_milliseconds(effect, name) else value

    def _in_milliseconds(self, effect: str, name: str) -> bool:
        """Return whether a parameter is a delay, which is shown in milliseconds."""
        kind = self.effects.get(effect)
        has_delay = effect == SERVO if kind is None else kind.role is Role.DELAY
        return has_delay and self._unit(effect, name) == "s"

    def _unit(self, effect: str, name: str) -> str:
        """Return the SI unit at a revolute joint; "1" if unknown."""
        if effect in self.effects:
            return self.effects[effect].unit_of(name)
        return _SERVO_UNITS.get(name, "1") if effect == SERVO else "1"


def _exponent(value: float, digits: int) -> int:
    """Return the power of ten of a value's first digit, after rounding to some digits."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])


def _fixed(value: float, decimals: int) -> str:
    """Return a value rounded to decimals, which may be negative, with a typographic minus."""
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("-")


def _power(exponent: int) -> str:
    return f"·10{str(exponent).translate(_SUPERSCRIPTS)}"
