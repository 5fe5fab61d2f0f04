"""Families of motions: positions, velocities and accelerations linear in a few coefficients.

Every joint has coefficients c of its own, and at times t

    q = Φ₀(t) c,   v = Φ₁(t) c,   v̇ = Φ₂(t) c,

so that a gradient with respect to the motion becomes one with respect to c by Φᵀ. The jerk is Φ₃ c.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from geodrake.boundary.arguments import integer, number, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import Array

_DURATIONS, _PERIODS = (1e-2, 1e5), (1e-4, 1e6)  # s; of the fastest and slowest part of a motion
_MOST_COEFFICIENTS = 1000  # of a joint
_LARGEST_BASIS = 30_000_000  # numbers: instants at which limits hold, times coefficients
_MOST_ORDERS = 8  # derivatives
_INDEPENDENT = 1e-9  # relative size of a condition that the others do not imply


class MotionFamily(abc.ABC):
    """Motions of one joint, linear in `count` coefficients.

    Class attributes:
        name: Name in commands and reports.
        timed: Whether the samples of a motion follow each other in time, so that a robot can
            execute it.
    """

    name: ClassVar[str]
    timed: ClassVar[bool] = True
    duration: float = 0.0

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """Number of coefficients of a joint."""

    @property
    def length(self) -> float:
        """Duration, s; zero if samples do not follow each other."""
        return self.duration

    @property
    @abc.abstractmethod
    def fastest(self) -> float:
        """Shortest time in which the motion does something, s: a period, or between knots."""

    @property
    def steepness(self) -> float:
        """Bound on the ratio of the maxima of a derivative and its function, 1/s; inf for none."""
        return np.inf

    @abc.abstractmethod
    def basis(self, times: ArrayLike, *, orders: int = 3) -> Array:
        """Return (orders, N, count) matrices Φ₀, Φ₁, Φ₂, … at times (N,), s."""

    def times(self, samples: int) -> Array:
        """Return (samples,) uniform instants from start to end, s."""
        return np.linspace(0.0, self.length, integer(samples, "samples", lower=1))

    def limit_times(self, share: float = 0.05) -> Array:
        """Return instants so close that limits which hold there hold between them."""
        needed = self.length / (number(share, "share", lower=0.0, strict=True) * self.fastest)
        if 3 * needed * self.count > _LARGEST_BASIS:
            raise ArgumentError(
                f"A {self.name} motion of {self.length:g} s with details of {self.fastest:g} "
                f"s is too long: limits would be checked at {needed:.2g} instants.",
                advice="Make it shorter or slower.",
            )
        return self.times(max(2, int(np.ceil(needed)) + 1))

    def conditions(self, *, rest: bool, start: bool) -> Array:
        """Return independent rows E (k, count) of the end conditions, which fix E c.

        Args:
            rest: Whether velocity and acceleration are zero at start and end.
            start: Whether the position at the start is given; it is the last row.
        """
        position, velocity, acceleration = self.basis([0.0, self.length])
        rows = [*velocity, *acceleration] if rest else []
        kept: list[Array] = []
        for row in [*rows, position[0]] if start else rows:
            if _is_new(row, kept):
                kept.append(row)
        if len(kept) >= self.count:
            raise ArgumentError(
                f"A {self.name} motion with {self.count} coefficients for each joint cannot "
                f"satisfy {len(kept)} end conditions and move.",
                advice="Use more coefficients.",
            )
        return np.array(kept).reshape(-1, self.count)


@dataclass(frozen=True)
class FourierMotion(MotionFamily):
    """A Fourier series, [Lee2019] Eq. (4.6.62).

        q = c₀ + Σⱼ aⱼ cos jωt + bⱼ sin jωt

    with the coefficients c₀ (unless left out), a₁, b₁, a₂, b₂, …

    Attributes:
        duration: Length of the motion, s.
        frequency: ω, rad/s; one period in the whole duration if None.
        offset: Whether there is a c₀.
    """

    duration: float = 10.0
    modes: int = 5
    frequency: float | None = None
    offset: bool = True

    name = "fourier"

    def __post_init__(self) -> None:
        number(self.duration, "duration", lower=_DURATIONS[0], upper=_DURATIONS[1])
        integer(self.modes, "modes", lower=1, upper=_MOST_COEFFICIENTS // 2 - 1)
        if self.frequency is not None:
            number(self.frequency, "frequency", lower=2.0 * np.pi / _PERIODS[1])
        number(self.fastest, "the period of the last mode", lower=_PERIODS[0])

    @property
    def omega(self) -> float:
        """Base frequency ω, rad/s."""
        return 2.0 * np.pi / self.duration if self.frequency is None else self.frequency

    @property
    def count(self) -> int:
        """Return two coefficients a mode, and the offset."""
        return 2 * self.modes + self.offset

    @property
    def fastest(self) -> float:
        """Period of the last mode, s."""
        return 2.0 * np.pi / (self.omega * self.modes)

    @property
    def steepness(self) -> float:
        """Return the last mode's rate, by Bernstein's inequality, for whole periods.

        |f'| ≤ nω max |f| for a trigonometric polynomial f of degree n.
        """
        is_whole = self.omega * self.duration >= 2.0 * np.pi * (1.0 - 1e-9)
        return self.omega * self.modes if is_whole else np.inf

    def basis(self, times: ArrayLike, *, orders: int = 3) -> Array:
        """Return (orders, N, count): 1, cos jωt, sin jωt and their derivatives."""
        orders = integer(orders, "orders", lower=1, upper=_MOST_ORDERS)
        t = real_array(np.atleast_1d(real_array(times, "times")), "times", ("N",))
        rates = self.omega * np.arange(1, self.modes + 1)
        cosine, sine = np.cos(np.outer(t, rates)), np.sin(np.outer(t, rates))
        turns = cosine, -sine, -cosine, sine  # cos and its derivatives; of sin, one turn behind
        first = 1 if self.offset else 0
        Phi = np.zeros((orders, len(t), self.count))
        for order in range(orders):
            Phi[order, :, first::2] = rates**order * turns[order % 4]
            Phi[order, :, first + 1 :: 2] = rates**order * turns[(order - 1) % 4]
        Phi[0, :, :first] = 1.0
        return Phi


@dataclass(frozen=True)
class SplineMotion(MotionFamily):
    """A B-spline with uniform knots, clamped at both ends.

    Attributes:
        duration: Length of the motion, s.
        points: Number of control points, which are the coefficients.
        degree: Degree of the polynomials, 3 to 5: five makes even the jerk smooth.
    """

    duration: float = 10.0
    points: int = 16
    degree: int = 5

    name = "spline"

    def __post_init__(self) -> None:
        number(self.duration, "duration", lower=_DURATIONS[0], upper=_DURATIONS[1])
        integer(self.degree, "degree", lower=3, upper=5)
        integer(self.points, "points", lower=self.degree + 1, upper=_MOST_COEFFICIENTS)

    @property
    def count(self) -> int:
        """Return the control points."""
        return self.points

    @property
    def fastest(self) -> float:
        """Two intervals between knots, s."""
        return 2.0 * self.duration / (self.points - self.degree)

    @property
    def knots(self) -> Array:
        """(points + degree + 1,) knots, s."""
        inner = np.linspace(0.0, self.duration, self.points - self.degree + 1)
        return np.concatenate([np.zeros(self.degree), inner, np.full(self.degree, self.duration)])

    def basis(self, times: ArrayLike, *, orders: int = 3) -> Array:
        """Return (orders, N, count): basis functions and their derivatives."""
        orders = integer(orders, "orders", lower=1, upper=_MOST_ORDERS)
        t = real_array(np.atleast_1d(real_array(times, "times")), "times", ("N",))
        spline = BSpline(self.knots, np.eye(self.points), self.degree)
        return np.stack([spline(t, nu=order) for order in range(orders)])


@dataclass(frozen=True)
class FreeSamples(MotionFamily):
    """Samples that need not follow each other: q, v and v̇ of each are coefficients.

    They bound what a motion can identify, and suit robots that are measured point by point.
    """

    samples: int = 50

    name = "samples"
    timed: ClassVar[bool] = False

    def __post_init__(self) -> None:
        integer(self.samples, "samples", lower=1, upper=_MOST_COEFFICIENTS)

    @property
    def count(self) -> int:
        """Three coefficients a sample: all q, then all v, then all v̇."""
        return 3 * self.samples

    @property
    def fastest(self) -> float:
        """Zero."""
        return 0.0

    def times(self, samples: int) -> Array:
        """Return a zero for each sample."""
        return np.zeros(self.samples)

    def limit_times(self, share: float = 0.05) -> Array:
        """Return a zero for each sample."""
        return np.zeros(self.samples)

    def basis(self, times: ArrayLike, *, orders: int = 3) -> Array:
        """Return (3, samples, count): each picks its third of the coefficients, at every time."""
        real_array(times, "times")
        if integer(orders, "orders", lower=1) > 3:
            raise ArgumentError("Free samples have no jerk.")
        return np.eye(self.count).reshape(3, self.samples, self.count)

    def conditions(self, *, rest: bool, start: bool) -> Array:
        """Return no rows, as there is neither start nor end."""
        return np.zeros((0, self.count))


def _is_new(row: Array, rows: list[Array]) -> bool:
    """Return whether a row is independent of others."""
    if not rows:
        return bool(row.any())
    units = np.array([r / np.linalg.norm(r) for r in rows]).T
    size = np.linalg.norm(row)
    if not size > 0:
        return False
    rest = row / size - units @ np.linalg.lstsq(units, row / size)[0]
    return bool(np.linalg.norm(rest) > _INDEPENDENT)
