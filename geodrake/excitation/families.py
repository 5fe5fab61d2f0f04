"""Families of motions: positions, velocities and accelerations linear in a few coefficients.

Every joint has its own coefficients c, and at times t

    q = Φ₀(t) c,   v = Φ₁(t) c,   v̇ = Φ₂(t) c,

so Φᵀ maps a gradient with respect to the motion to one with respect to c. The jerk is Φ₃ c.
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
_MOST_COEFFICIENTS = 1000  # per joint
_LARGEST_BASIS = 30_000_000  # entries of a basis: instants times coefficients
_MOST_ORDERS = 8  # derivatives
_INDEPENDENT = 1e-9  # rank tolerance of end conditions


class MotionFamily(abc.ABC):
    """Motions of one joint, linear in `count` coefficients.

    Class attributes:
        name: Name in commands and reports.
        timed: Whether samples are ordered in time, so a robot can execute the motion.
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
        """Duration, s; zero if samples are not ordered in time."""
        return self.duration

    @property
    @abc.abstractmethod
    def fastest(self) -> float:
        """Shortest time scale of the motion, s: a period, or intervals between knots."""

    @property
    def steepness(self) -> float:
        """Upper bound on max |ḟ| / max |f| for all functions of the family, 1/s; inf for none."""
        return np.inf

    def basis(self, times: ArrayLike, *, orders: int = 3) -> Array:
        """Return the matrices Φ₀, Φ₁, Φ₂, … (orders, N, count) at times (N,), s."""
        integer(orders, "orders", lower=1, upper=_MOST_ORDERS)
        t = np.atleast_1d(real_array(times, "times"))
        return np.asarray(self._basis(real_array(t, "times", ("N",)), orders))

    @abc.abstractmethod
    def _basis(self, t: Array, orders: int) -> Array:
        """Return the matrices at instants (N,)."""

    def times(self, samples: int) -> Array:
        """Return uniform instants (samples,) from start to end, s."""
        return np.linspace(0.0, self.length, integer(samples, "samples", lower=1))

    def limit_times(self, share: float = 0.05) -> Array:
        """Return instants at steps of a share of the shortest time scale, to check limits, s."""
        instants = self.length / (number(share, "share", lower=0.0, strict=True) * self.fastest)
        if 3 * instants * self.count > _LARGEST_BASIS:
            raise ArgumentError(
                f"A {self.name} motion of {self.length:g} s with details of {self.fastest:g} "
                f"s is too long: limits would be checked at {instants:.2g} instants.",
                advice="Make it shorter or slower.",
            )
        return self.times(max(2, int(np.ceil(instants)) + 1))

    def conditions(self, *, rest: bool, start: bool) -> Array:
        """Return independent rows E (k, count) of the end conditions, which fix E c.

        Args:
            rest: Whether velocity and acceleration are zero at start and end.
            start: Whether the position at the start is given; it is the last row.
        """
        position, velocity, acceleration = self.basis([0.0, self.length])
        rows = np.vstack([velocity, acceleration, position[:1]])
        rows = rows[0 if rest else 4 : 5 if start else 4]
        sizes = np.linalg.norm(rows, axis=1, keepdims=True)
        units = rows / np.where(sizes > 0, sizes, 1.0)
        kept: list[int] = []
        for k in range(len(rows)):
            if np.linalg.matrix_rank(units[[*kept, k]], tol=_INDEPENDENT) > len(kept):
                kept.append(k)
        if len(kept) >= self.count:
            raise ArgumentError(
                f"A {self.name} motion with {self.count} coefficients for each joint cannot "
                f"satisfy {len(kept)} end conditions and move.",
                advice="Use more coefficients.",
            )
        return np.asarray(rows[kept])


@dataclass(frozen=True)
class FourierMotion(MotionFamily):
    """A Fourier series, [Lee2019] Eq. (4.6.62).

        q = c₀ + Σⱼ aⱼ cos jωt + bⱼ sin jωt

    with the coefficients c₀ (if any), a₁, b₁, a₂, b₂, …

    Attributes:
        duration: Length of the motion, s.
        frequency: ω, rad/s; one period in the whole duration if None.
        offset: Whether to include c₀.
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
        """Two coefficients per mode, plus the offset."""
        return 2 * self.modes + self.offset

    @property
    def fastest(self) -> float:
        """Period of the last mode, s."""
        return 2.0 * np.pi / (self.omega * self.modes)

    @property
    def steepness(self) -> float:
        """The rate of the last mode by Bernstein's inequality, if the motion has a whole period.

        |f'| ≤ nω max |f| for a trigonometric polynomial f of degree n.
        """
        is_whole = self.omega * self.duration >= 2.0 * np.pi * (1.0 - 1e-9)
        return self.omega * self.modes if is_whole else np.inf

    def _basis(self, t: Array, orders: int) -> Array:
        """Return 1, cos jωt, sin jωt and their derivatives."""
        rates = self.omega * np.arange(1, self.modes + 1)
        cosine, sine = np.cos(np.outer(t, rates)), np.sin(np.outer(t, rates))
        derivatives = cosine, -sine, -cosine, sine  # of cos; those of sin lag by one
        first = 1 if self.offset else 0
        Phi = np.zeros((orders, len(t), self.count))
        for order in range(orders):
            Phi[order, :, first::2] = rates**order * derivatives[order % 4]
            Phi[order, :, first + 1 :: 2] = rates**order * derivatives[(order - 1) % 4]
        Phi[0, :, :first] = 1.0
        return Phi


@dataclass(frozen=True)
class SplineMotion(MotionFamily):
    """A B-spline with uniform knots, clamped at both ends.

    Attributes:
        duration: Length of the motion, s.
        points: Number of control points, which are the coefficients.
        degree: Degree of the polynomials, 3 to 5; with 5 the jerk is smooth.
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
        """Number of control points."""
        return self.points

    @property
    def fastest(self) -> float:
        """Two intervals between knots, s, or the duration if there is only one."""
        return 2.0 * self.duration / max(self.points - self.degree, 2)

    @property
    def knots(self) -> Array:
        """(points + degree + 1,) knots, s."""
        inner = np.linspace(0.0, self.duration, self.points - self.degree + 1)
        return np.concatenate([np.zeros(self.degree), inner, np.full(self.degree, self.duration)])

    def _basis(self, t: Array, orders: int) -> Array:
        """Return the basis functions and their derivatives."""
        spline = BSpline(self.knots, np.eye(self.points), self.degree)
        return np.stack([spline(t, nu=order) for order in range(orders)])


@dataclass(frozen=True)
class FreeSamples(MotionFamily):
    """Samples that are not ordered in time; q, v and v̇ of each are coefficients.

    They bound the information of any motion, and suit robots that are measured point by point.
    """

    samples: int = 50

    name = "samples"
    timed: ClassVar[bool] = False

    def __post_init__(self) -> None:
        integer(self.samples, "samples", lower=1, upper=_MOST_COEFFICIENTS)

    @property
    def count(self) -> int:
        """Three coefficients per sample: all q, then all v, then all v̇."""
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

    def _basis(self, t: Array, orders: int) -> Array:
        """Return (3, samples, count) matrices that select q, v and v̇ of every sample."""
        if orders > 3:
            raise ArgumentError("Free samples have no jerk.")
        return np.eye(self.count).reshape(3, self.samples, self.count)

    def conditions(self, *, rest: bool, start: bool) -> Array:
        """Return no rows: there is no start or end."""
        return np.zeros((0, self.count))


@dataclass(frozen=True)
class JoinedMotion(MotionFamily):
    """A sequence of motions, with concatenated coefficients."""

    parts: tuple[MotionFamily, ...]

    name = "joined"

    @property
    def starts(self) -> Array:
        """Start times of the parts, s, and the end."""
        return np.cumsum([0.0, *(part.length for part in self.parts)])

    @property
    def count(self) -> int:
        """Number of coefficients of all parts."""
        return sum(part.count for part in self.parts)

    @property
    def length(self) -> float:
        """Duration, s."""
        return float(self.starts[-1])

    @property
    def fastest(self) -> float:
        """Shortest time scale of all parts, s."""
        return min(part.fastest for part in self.parts)

    def limit_times(self, share: float = 0.05) -> Array:
        """Return the instants of all parts."""
        times = [part.limit_times(share)[1:] for part in self.parts]
        return np.concatenate([[0.0], *map(np.add, self.starts[:-1], times)])

    def _basis(self, t: Array, orders: int) -> Array:
        """Return the bases of the parts, each at its own instants."""
        starts = self.starts
        active = np.clip(np.searchsorted(starts, t, side="left") - 1, 0, len(self.parts) - 1)
        Phi, first = np.zeros((orders, len(t), self.count)), 0
        for k, part in enumerate(self.parts):
            rows, last = np.flatnonzero(active == k), first + part.count
            local = np.clip(t[rows] - starts[k], 0.0, part.length)
            Phi[:, rows, first:last] = part.basis(local, orders=orders)
            first = last
        return Phi
