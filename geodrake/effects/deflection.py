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
"""Usual damping of springs, as a share of the critical one."""

_DEGREE = 5


@dataclass(frozen=True, eq=False)
class Deflection:
    """How far a link lags behind its motor, over N samples."""

    lag: Array  # (N,) s, position of the motor less that of the link, rad or m
    rate: Array  # (N,) ṡ
    acceleration: Array  # (N,) s̈

    @classmethod
    def along(cls, lag: Array, time: Array | None) -> Deflection:
        """Return a smooth lag (N,), or several (N, n), with rates at instants (N,) of a series, s.

        The series is uniform. Rates are zero where there is no time, as it is no series.
        """
        if time is None or len(lag) <= _DEGREE:
            return cls(lag, np.zeros_like(lag), np.zeros_like(lag))
        spline = make_interp_spline(time, lag, k=_DEGREE)
        return cls(lag, np.asarray(spline(time, 1)), np.asarray(spline(time, 2)))

    def of(self, joint: int) -> Deflection:
        """Return one of several."""
        return Deflection(*(x[:, joint] for x in (self.lag, self.rate, self.acceleration)))

    def effort(self, slopes: EffortSlopes, joint: int) -> Array:
        """Change of the needed effort (nv, N), to first order in the lag, by slopes at motors.

        −(∂τ/∂q_j s + ∂τ/∂v_j ṡ + M_{·j} s̈), with the bodies' effort τ(q, v, v̇).
        """
        count, nv, _ = slopes.position.shape
        change = np.empty((nv, count))
        by_q, by_v, by_a = (
            contiguous(np.swapaxes(each, 1, 2))  # as they are in memory
            for each in (slopes.position, slopes.velocity, slopes.acceleration)
        )
        of_link = contiguous(self.lag), contiguous(self.rate), contiguous(self.acceleration)
        calc_change((by_q, by_v, by_a), joint, of_link, change)
        return change


@compiled
def calc_change(
    slopes: tuple[Array, Array, Array], joint: int, link: tuple[Array, Array, Array], out: Array
) -> None:
    """Write the change of efforts (nv, N); see `Deflection.effort`.

    Args:
        slopes: (N, nv, nv) by whose position, velocity and acceleration.
        link: (N,) lag, its rate, and its acceleration.
    """
    (by_q, by_v, by_a), (lag, rate, acceleration) = slopes, link
    for n in range(len(lag)):
        for i in range(len(out)):
            change = by_q[n, joint, i] * lag[n] + by_v[n, joint, i] * rate[n]
            out[i, n] = -(change + by_a[n, joint, i] * acceleration[n])


@dataclass(frozen=True)
class Give:
    """How far a link moves against its motor under a torque: a dead band, and a spring."""

    # Of the spring beyond the dead band, rad/(N·m) or m/N; 0 for a rigid one.
    compliance: float = 0.0
    play: float = 0.0  # half width of the dead band, rad or m
    # Of the spring, as a share of the critical one; None for the usual one.
    damping: float | None = None

    def __add__(self, other: Give) -> Give:
        """Return the values of both in series."""
        damping = other.damping if self.damping is None else self.damping
        return Give(self.compliance + other.compliance, self.play + other.play, damping)

    def __bool__(self) -> bool:
        """Return whether it gives way at all."""
        return bool(self.compliance > 0.0 or self.play > 0.0)


@dataclass(frozen=True)
class DeflectionEffect(JointEffect):
    """A joint whose link lags behind its motor. Subclasses define `deflection` and `give`.

    A fit sees the lag to first order (`deflection`). In a simulation motor and link are two bodies
    with what `give` says between them (`geodrake.model.simulation`); friction and rotor inertia are
    the motor's, and so are the positions and efforts that are measured.
    """

    role = Role.DEFLECTION
    depends_on = frozenset({"q", "v", "vd", "load", "time", "bodies"})

    @abc.abstractmethod
    def deflection(self, motion: RobotMotion) -> Deflection:
        """Return how far the link lags behind at a motion of the motors, for a parameter of one."""

    def give(self, parameters: Array) -> Give:
        """Return how motor and link are held together in a simulation, by parameters (k,)."""
        raise ArgumentError(
            f"{self.name} can be fitted only: it does not define the stiffness between motor "
            f"and link of parameters {parameters.tolist()}.",
            advice="Define give(parameters), which returns a geodrake.effects.deflection.Give.",
        )

    def rollout_values(self, parameters: Array) -> Values:
        """Return positive values that a simulated motion shows better than efforts do.

        They are of parameters (k,) and shapes, by their names; `geodrake.control.fit_rollouts` fits
        them.
        """
        del parameters
        return {}

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return the effect with some `rollout_values`."""
        raise NotImplementedError(
            f"{self.name} does not define how to combine {values} ± {deviations}."
        )

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """No columns of the joint's own motion."""
        return [np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[−(∂τ/∂q s + ∂τ/∂v ṡ + M s̈)] at all joints."""
        deflection = self.deflection(motion)
        efforts = deflection.effort(motion.effort_slopes, motion.index(self.joint))
        return {joint: own[:, None] for joint, own in zip(motion.joints, efforts, strict=True)}
