"""Transmissions from one actuator to one joint whose ratio changes with the position.

    θ = f(q),   J = f′(q)                                              [Lee2019] Eq. (3.6.57)

so that J̇ = f″ q̇.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from scipy.interpolate import CubicSpline

from geodrake.boundary.arguments import number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.robot.transmission.base import Transmission

_OFF_THE_END = 1e-3  # of the range, where a linkage still moves
_LEAST_POINTS = 3  # of a table, whose spline has curvature


class ScalarTransmission(Transmission):
    """θ = f(q) of one actuator and one joint."""

    @property
    def shape(self) -> tuple[int, int]:
        """One, and one."""
        return 1, 1

    @abc.abstractmethod
    def derivative(self, q: Array, order: int) -> Array:
        """Return f, f′ or f″ (N,) at q (N,), by the order 0, 1 or 2."""

    @property
    def range(self) -> tuple[float, float]:
        """Between which q f is known."""
        return -np.inf, np.inf

    def joint_positions(self, q: Array) -> Array:
        """θ = f(q)."""
        return self.derivative(self._q(q)[:, 0], 0)[:, None]

    def jacobian(self, q: Array) -> Array:
        """J = f′(q)."""
        return self.derivative(self._q(q)[:, 0], 1)[:, None, None]

    def inside(self, q: Array) -> Array:
        """Positions moved to where f is known, a little off its ends."""
        low, high = self.range
        if not np.isfinite([low, high]).all():
            return q
        off = _OFF_THE_END * (high - low)
        return np.clip(q, low + off, high - off)

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """J̇ = f″(q) q̇, of q and q̇ (N, 1)."""
        q, v = self._q(q)[:, 0], real_array(v, "v", ("N", 1))[:, 0]
        rate = self.derivative(q, 2) * v
        return rate[:, None, None]


@dataclass(frozen=True, eq=False)
class PolynomialTransmission(ScalarTransmission, Short):
    """θ = c₀ + c₁ q + c₂ q² + …, as MuJoCo's `polycoef` has it.

    Attributes:
        coefficients: (m,) c, the constant first.
    """

    coefficients: Array

    def __post_init__(self) -> None:
        c = real_array(self.coefficients, "coefficients", ("m",))
        if not c[1:].any():
            raise ArgumentError(f"coefficients must have one beyond c₀ that is not 0; got {c}.")
        object.__setattr__(self, "coefficients", c)

    def derivative(self, q: Array, order: int) -> Array:
        """Return the polynomial, or its derivative."""
        return np.asarray(polyval(q, polyder(self.coefficients, order)))


@dataclass(frozen=True, eq=False)
class TableTransmission(ScalarTransmission, Short):
    """θ between measured or computed pairs by a cubic spline, and straight on beyond its ends.

    Attributes:
        actuator_points: (m,) q, increasing.
        joint_points: (m,) θ at these.
    """

    actuator_points: Array
    joint_points: Array

    def __post_init__(self) -> None:
        q = real_array(self.actuator_points, "actuator_points", ("m",))
        if len(q) < _LEAST_POINTS or not (np.diff(q) > 0.0).all():
            raise ArgumentError(
                f"A table needs {_LEAST_POINTS} actuator positions or more, which increase; "
                f"got {q.tolist()}."
            )
        theta = real_array(self.joint_points, "joint_points", (len(q),))
        object.__setattr__(self, "actuator_points", q)
        object.__setattr__(self, "joint_points", theta)

    @cached_property
    def _spline(self) -> CubicSpline:
        # Natural ends: no curvature there, so that it goes straight on without a step in f″.
        return CubicSpline(self.actuator_points, self.joint_points, bc_type="natural")

    def derivative(self, q: Array, order: int) -> Array:
        """Return the spline, or its derivative."""
        inside = np.clip(q, self.actuator_points[0], self.actuator_points[-1])
        found = self._spline(inside, order)
        return np.asarray(found if order else found + self._spline(inside, 1) * (q - inside))


@dataclass(frozen=True)
class FourBar(ScalarTransmission):
    """A four-bar linkage: q turns the crank, and the rocker turns the joint.

    Crank and rocker turn about parallel axes on the ground link, and the coupler joins their ends.
    Their angles are counted from the line from the crank's pivot to the rocker's.

    Attributes:
        ground: Distance of the two pivots, m; only ratios of the four lengths matter.
        crank: Length of the crank, m.
        coupler: Length of the coupler, m.
        rocker: Length of the rocker, m.
        crank_angle: Angle of the crank where q = 0, rad.
        rocker_angle: Angle of the rocker where θ = 0, rad.
        crossed: Whether coupler and ground link cross: the other way to put the bars together.
    """

    ground: float
    crank: float
    coupler: float
    rocker: float
    crank_angle: float
    rocker_angle: float
    crossed: bool = False

    def __post_init__(self) -> None:
        for name in ("ground", "crank", "coupler", "rocker"):
            number(getattr(self, name), name, lower=0.0, strict=True)
        for name in ("crank_angle", "rocker_angle"):
            number(getattr(self, name), name)
        low, high = self.range
        if not low < 0.0 < high:
            raise ArgumentError(
                f"The bars of the four-bar linkage do not reach each other where q = 0, with the "
                f"crank at {self.crank_angle:g} rad.",
                advice="Check its lengths and crank_angle.",
            )

    @property
    def range(self) -> tuple[float, float]:
        """Between which q the bars reach each other, rad; infinite where the crank goes around.

        The diagonal from the crank's end to the rocker's pivot is between |r − c| and r + c.
        """
        sides = self.crank**2 + self.ground**2
        spans = (self.rocker + self.coupler) ** 2, (self.rocker - self.coupler) ** 2
        least, most = ((sides - span) / (2.0 * self.crank * self.ground) for span in spans)
        if least >= 1.0 or most <= -1.0:
            return 0.0, 0.0
        crank = float(np.mod(self.crank_angle + np.pi, 2.0 * np.pi) - np.pi)
        outer = np.arccos(least) if least > -1.0 else np.pi
        inner = np.arccos(most) if most < 1.0 else 0.0
        if outer == np.pi and inner == 0.0:
            return -np.inf, np.inf
        if inner == 0.0:
            return float(-outer - crank), float(outer - crank)
        if outer == np.pi:
            crank = crank % (2.0 * np.pi)
            return float(inner - crank), float(2.0 * np.pi - inner - crank)
        side = np.sign(crank) if crank else 1.0
        ends = sorted((side * inner - crank, side * outer - crank))
        return float(ends[0]), float(ends[1])

    def derivative(self, q: Array, order: int) -> Array:
        """Return the rocker's angle from where θ = 0, within half a turn of it, or its derivative.

        The slope is r_crank sin(φ − κ) / (r_rocker sin(ψ − κ)), with κ the angle of the coupler,
        whose own slope follows from the loop.
        """
        crank, rocker, coupler = self._angles(q)
        if order == 0:
            return np.asarray(np.mod(rocker - self.rocker_angle + np.pi, 2.0 * np.pi) - np.pi)
        lever = self.rocker * np.sin(rocker - coupler)
        slope = self.crank * np.sin(crank - coupler) / lever
        if order == 1:
            return np.asarray(slope)
        turn = self.crank * np.sin(crank - rocker) / (self.coupler * np.sin(rocker - coupler))
        driven = self.crank * np.cos(crank - coupler) * (1.0 - turn)
        driving = slope * self.rocker * np.cos(rocker - coupler) * (slope - turn)
        return np.asarray((driven - driving) / lever)

    def _angles(self, q: Array) -> tuple[Array, Array, Array]:
        """Angles (N,) of crank, rocker and coupler."""
        crank = q + self.crank_angle
        x, y = self.crank * np.cos(crank) - self.ground, self.crank * np.sin(crank)
        diagonal = np.hypot(x, y)
        cosine = (diagonal**2 + self.rocker**2 - self.coupler**2) / (2.0 * self.rocker * diagonal)
        if (beyond := ~(np.abs(cosine) < 1.0)).any():
            raise ArgumentError(
                f"The bars of the four-bar linkage do not reach each other at q = "
                f"{q[beyond][0]:.4g} rad.",
                advice="Check its lengths and crank_angle, and that the log is of this actuator.",
            )
        bend = np.arccos(cosine)
        rocker = np.arctan2(y, x) + (bend if self.crossed else -bend)
        ends = self.rocker * np.cos(rocker) - x, self.rocker * np.sin(rocker) - y
        return crank, rocker, np.arctan2(ends[1], ends[0])


@dataclass(frozen=True)
class Cylinder(ScalarTransmission):
    """A cylinder, ball screw or cable across a joint: its length turns the joint.

    Two sides of a triangle, from the joint's axis to the ends of the cylinder, enclose an angle
    γ with L² = a² + b² − 2 a b cos γ.

    Attributes:
        base: a, distance of the joint's axis from the end on its inboard side, m.
        lever: b, distance of the joint's axis from the end on its outboard side, m.
        length: L where q = 0, m.
        angle: γ where θ = 0, rad, between 0 and π.
        reversed: Whether θ falls as the cylinder grows.
    """

    base: float
    lever: float
    length: float
    angle: float
    reversed: bool = False

    def __post_init__(self) -> None:
        for name in ("base", "lever"):
            number(getattr(self, name), name, lower=0.0, strict=True)
        number(self.length, "length", lower=0.0)
        number(self.angle, "angle", lower=0.0, upper=float(np.pi))

    @property
    def range(self) -> tuple[float, float]:
        """Between which q the triangle closes, m."""
        ends = abs(self.base - self.lever), self.base + self.lever
        return ends[0] - self.length, ends[1] - self.length

    def derivative(self, q: Array, order: int) -> Array:
        """Return γ less that at θ = 0, with its sign, or its derivative.

        The slope is L / (a b sin γ).
        """
        sign, cosine = -1.0 if self.reversed else 1.0, self._cosine(q)
        if order == 0:
            return np.asarray(sign * (np.arccos(cosine) - self.angle))
        area, sine = self.base * self.lever, np.sqrt(1.0 - cosine**2)
        if order == 1:
            return np.asarray(sign * (q + self.length) / (area * sine))
        bend = cosine * ((q + self.length) / (area * sine)) ** 2
        return np.asarray(sign * (1.0 / area - bend) / sine)

    def _cosine(self, q: Array) -> Array:
        squares = self.base**2 + self.lever**2 - (q + self.length) ** 2
        cosine = squares / (2.0 * self.base * self.lever)
        if (beyond := ~(np.abs(cosine) < 1.0)).any():
            low, high = self.range
            raise ArgumentError(
                f"The cylinder cannot be where q = {q[beyond][0]:.4g} m: its triangle closes from "
                f"{low:.4g} to {high:.4g} m.",
                advice="Check base, lever and length, and that the log is of this actuator.",
            )
        return np.asarray(cosine)
