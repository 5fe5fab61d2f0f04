"""Numbers as people read them: sensible digits, standard deviations, shares, chances."""

from __future__ import annotations

import math

from geodrake.escaping import printable

UNKNOWN = "–"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LEAST_CHANCE = 1e-6


def number(value: float, digits: int = 3) -> str:
    """A value with so many significant digits; as a multiple of 10ⁿ if very small or large."""
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0:
        return "0"
    exponent = _exponent(value, digits)
    if not -4 <= exponent < max(6, digits):
        return f"{_fixed(value / 10.0**exponent, digits - 1)}{_power(exponent)}"
    return _fixed(value, digits - 1 - exponent)


def with_deviation(value: float, deviation: float) -> str:
    """`3.084 ± 0.012`: both to the last digit that the standard deviation leaves certain.

    Args:
        value: The value.
        deviation: Its standard deviation; left out where it is not a positive finite number.
    """
    if not (math.isfinite(value) and math.isfinite(deviation) and deviation > 0):
        return number(value)
    exponent = _exponent(deviation, 2)
    digits = 2 if round(deviation / 10.0**exponent, 1) < 3 else 1
    largest = _exponent(max(abs(value), deviation), 3)
    scale = 0 if -4 <= largest < 6 else largest
    decimals = digits - 1 - exponent + scale
    text = f"{_fixed(value / 10.0**scale, decimals)} ± {_fixed(deviation / 10.0**scale, decimals)}"
    return f"({text}){_power(scale)}" if scale else text


def percent(share: float) -> str:
    """A share in percent, with more digits where it is close to none or all of it."""
    if not math.isfinite(share):
        return UNKNOWN
    if 0.9995 <= share < 1:
        return "> 99.9 %"
    if 0 < share < 0.0005:
        return "< 0.1 %"
    close = 0 < share < 0.0995 or 0.9895 <= share < 1
    return f"{100 * share:.{1 if close else 0}f} %".replace("-", "−")


def chance(probability: float) -> str:
    """A probability, those below a millionth as `< 10⁻⁶`."""
    return "< 10⁻⁶" if probability < _LEAST_CHANCE else number(probability, 2)


def shortened(text: str, most: int) -> str:
    """A printable text of at most so many characters, its middle left out where it is longer."""
    text = printable(text)
    if len(text) <= most:
        return text
    tail = (most - 1) // 2
    return f"{text[: most - 1 - tail]}…{text[len(text) - tail :]}"


def _exponent(value: float, digits: int) -> int:
    """The power of ten of a value's first digit, after rounding to so many digits."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])


def _fixed(value: float, decimals: int) -> str:
    """A value rounded to decimals, which may be negative, with a true minus sign."""
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("-")


def _power(exponent: int) -> str:
    return f"·10{str(exponent).translate(_SUPERSCRIPTS)}"
