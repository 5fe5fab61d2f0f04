"""Signed numbers of a servo's registers that were logged as if they had no sign."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_COMPLEMENTS = (16, 32)  # bits of registers in two's complement
_SIGN_BITS = (10, 15)  # bits that hold a sign beside a magnitude, as of Feetech's servos
_LEAST = 3  # rows with either sign
_ROUNDING = 1e-3  # by which a whole number is off after a unit's factor


def signed_register(numbers: Array, *, magnitudes: bool) -> tuple[Array, str] | None:
    """Return numbers (N,) with their signs, and how they were written; None if they have signs.

    A register of k bits that is read without its sign shows small numbers, numbers next to 2ᵏ, and
    none in between: at least half of the range is never visited. With a bit for the sign the
    others begin at that bit; this is looked for if `magnitudes`.
    """
    largest = np.fmax.reduce(numbers, initial=0.0)
    if largest < 2 ** _SIGN_BITS[0] or np.fmin.reduce(numbers) < -_ROUNDING:
        return None
    if not are_whole(numbers):
        return None
    known = np.rint(numbers[np.isfinite(numbers)])
    for bits in _COMPLEMENTS:
        half = 2.0 ** (bits - 1)
        least = known.min(initial=np.inf, where=known >= half)
        if largest < 2.0 * half - 0.5 and _are_apart(known, half, least):
            words = f"two's complement of {bits} bits: {largest:.0f} is {largest - 2 * half:.0f}"
            return np.where(numbers >= half, numbers - 2.0 * half, numbers), words
    for bit in _SIGN_BITS if magnitudes else ():
        half = 2.0**bit
        if largest < 1.5 * half and _are_apart(known, half, 1.5 * half):
            words = f"magnitudes with a sign in bit {bit}: {largest:.0f} is {half - largest:.0f}"
            return np.where(numbers >= half, half - numbers, numbers), words
    return None


def are_whole(numbers: Array) -> bool:
    """Return whether numbers (N,) are whole ones, but for rounding and empty cells."""
    return not np.any(np.abs(numbers - np.rint(numbers)) > _ROUNDING)


def _are_apart(numbers: Array, half: float, least: float) -> bool:
    """Return whether numbers below `half` stay half of it away from `least`, and both occur."""
    above = numbers >= half
    crossings = np.count_nonzero(above[1:] != above[:-1])
    few = min(np.count_nonzero(above), np.count_nonzero(~above)) < _LEAST
    return bool(not few and crossings >= 2 and least - numbers[~above].max() >= half)
