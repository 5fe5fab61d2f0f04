"""Efforts caused by deflection between motor and link."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from geodrake.compiling import compiled, contiguous
from geodrake.effects.base import (
    Array,
    FittedEffect,
    JointEffect,
    JointMotion,
    RobotMotion,
    Role,
    Values,
)
from geodrake.errors import ArgumentError
from geodrake.robot.effort_slopes import EffortSlopes

SPRING_DAMPING = 0.05
"""Default damping ratio of joint springs."""

_DEGREE = 5


@dataclass(frozen=True, eq=False)
class Deflection:
    """How far a link lags behind its motor, over N samples."""

    lag: Array  # (N,) s, position of the motor minus that of the link, rad or m
    rate: Array  # (N,) ṡ
    acceleration: Array  # (N,) s̈

    @classmethod
    def along(cls, lag: Array, time: Array | None) -> Deflection:
        """Return a lag (N,), or several (N, n), with its rates by a spline over times (N,), s.

        Without `time` the samples are not a series, and the rates are zero.
        """
        if time is None or len(lag) <= _DEGREE:
            return cls(lag, np.zeros_like(lag), np.zeros_like(lag))
        spline = make_interp_spline(time, lag, k=_DEGREE)
        return cls(lag, np.asarray(spline(time, 1)), np.asarray(spline(time, 2)))

    def of(self, joint: int) -> Deflection:
        """Return the deflection of one joint."""
        return Deflection(*(x[:, joint] for x in (self.lag, self.rate, self.acceleration)))

    def effort(self, slopes: EffortSlopes, joint: int) -> Array:
        """Return the change (nv, N) of the needed effort, to first order in the lag.

        It is −(∂τ/∂q_j s + ∂τ/∂v_j ṡ + M_{·j} s̈), with the bodies' effort τ(q, v, v̇).
        """
        count, nv, _ = slopes.position.shape
        change = np.empty((nv, count))
        by_q, by_v, by_a = (
            contiguous(np.swapaxes(slope, 1, 2))  # their memory layout, so without a copy
            for slope in (slopes.position, slopes.velocity, slopes.acceleration)
        )
        link = contiguous(self.lag), contiguous(self.rate), contiguous(self.acceleration)
        calc_change((by_q, by_v, by_a), joint, link, change)
        return change


@compiled
def calc_change(
    slopes: tuple[Array, Array, Array], joint: int, link: tuple[Array, Array, Array], out: Array
) -> None:
    """Write the change of efforts (nv, N); see `Deflection.effort`.

    Args:
        slopes: (N, nv, nv) derivatives by position, velocity and acceleration of the first index.
        link: (N,) lag and its first and second derivatives.
    """
    (by_q, by_v, by_a), (lag, rate, acceleration) = slopes, link
    for n in range(len(lag)):
        for i in range(len(out)):
            change = by_q[n, joint, i] * lag[n] + by_v[n, joint, i] * rate[n]
            out[i, n] = -(change + by_a[n, joint, i] * acceleration[n])


@dataclass(frozen=True)
class Give:
    """Dead band and spring between a motor and its link."""

    compliance: float = 0.0  # of the spring beyond the dead band, rad/(N·m) or m/N; 0 if rigid
    play: float = 0.0  # half width of the dead band, rad or m
    damping: float | None = None  # damping ratio of the spring; None for `SPRING_DAMPING`

    def __add__(self, other: Give) -> Give:
        """Return the series connection of both."""
        damping = other.damping if self.damping is None else self.damping
        return Give(self.compliance + other.compliance, self.play + other.play, damping)

    def __bool__(self) -> bool:
        """Return whether the connection is not rigid."""
        return bool(self.compliance > 0.0 or self.play > 0.0)


@dataclass(frozen=True)
class DeflectionEffect(JointEffect):
    """A joint whose link lags behind its motor. Subclasses define `deflection` and `give`.

    Fits use the lag to first order (`deflection`). In a simulation motor and link are two bodies
    connected as `give` specifies (`geodrake.model.simulation`). Friction, rotor inertia, and the
    measured positions and efforts are those of the motor.
    """

    role = Role.DEFLECTION
    depends_on = frozenset({"q", "v", "vd", "load", "time", "bodies"})

    @abc.abstractmethod
    def deflection(self, motion: RobotMotion) -> Deflection:
        """Return the link's lag at a motion of the motors, for a unit parameter."""

    def give(self, parameters: Array) -> Give:
        """Return the connection of motor and link in a simulation, for parameters (k,)."""
        raise ArgumentError(
            f"{self.name} can be fitted only: it does not define the stiffness between motor "
            f"and link of parameters {parameters.tolist()}.",
            advice="Define give(parameters), which returns a geodrake.effects.deflection.Give.",
        )

    def rollout_values(self, parameters: Array) -> Values:
        """Return the positive values by name that `geodrake.control.fit_rollouts` fits.

        Simulated motion determines them better than efforts do. They derive from parameters (k,)
        and shapes.
        """
        del parameters
        return {}

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return the effect with new `rollout_values`."""
        raise NotImplementedError(
            f"{self.name} does not define how to combine {values} ± {deviations}."
        )

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Return zeros: nothing depends on the joint's own motion only."""
        return [np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[−(∂τ/∂q s + ∂τ/∂v ṡ + M s̈)] at all joints."""
        deflection = self.deflection(motion)
        efforts = deflection.effort(motion.effort_slopes, motion.index(self.joint))
        return {joint: x[:, None] for joint, x in zip(motion.joints, efforts, strict=True)}
