"""Effects of effort and force sensors: offsets, gains and delays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import positive, real_array
from geodrake.effects.base import (
    Array,
    BodyEffect,
    Effect,
    FileTerm,
    JointEffect,
    JointMotion,
    Parameter,
    RobotMotion,
    Role,
    Rows,
    Shape,
)
from geodrake.errors import ArgumentError
from geodrake.logs.filtering import spline_through


@dataclass(frozen=True)
class EffortOffset(JointEffect):
    """Constant effort: a sensor's zero, a current offset, a constant-force balancer.

    effort = o, in N·m.
    """

    name = "effort_offset"
    file_term = FileTerm(servo="offset")
    of_motor = True
    law = "o"
    complexity = 0
    parameters = (Parameter("offset", "N·m"),)
    signature = "the same at all times"
    depends_on = frozenset()

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[1]."""
        return [np.ones_like(joint.v)]


@dataclass(frozen=True)
class WrenchOffset(BodyEffect):
    """Offset of a force sensor, such as that of a foot: a constant wrench in the body's axes.

    effort = Jᵀ w₀, with the force in N and the moment about the sensor's origin in N·m. Where the
    logged forces of a foot count as efforts of the base and the joints, an error of them does, too.
    If one body has several sensors, as at heel and toe, only the sum of their offsets can be
    identified. It is reported about the origin of the first sensor.

    Attributes:
        x: Position of the sensor's origin from Bo along x of the body's frame, m.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    name = "wrench_offset"
    law = "Jᵀ w₀ of a constant wrench on a body, where a log has a force measured there"
    shapes = tuple(Shape(axis, "m") for axis in "xyz")
    parameters = (
        *(Parameter(f"force_{axis}", "N") for axis in "xyz"),
        *(Parameter(f"moment_{axis}", "N·m") for axis in "xyz"),
    )
    signature = "a constant wrench in the axes of a body, at the base and all joints up to it"
    depends_on = frozenset({"q", "bodies"})
    complexity = 2
    of_force_sensor = True
    free_shapes = 0  # the sensor's place is known

    @classmethod
    def candidates(cls, body: str, *origin: float) -> tuple[WrenchOffset, ...]:
        """Return the offset about the origin of the sensor, m, in the body's frame."""
        return (cls(body, *origin),)

    def rows(self, motion: RobotMotion) -> Rows:
        """[Jᵀ R_WB] of the force and of the moment, at the joints that move the body."""
        body = motion.body_motions(self.name).motion(self.body)
        J = np.stack([body.jacobian_at(np.array([self.x, self.y, self.z])), body.angular], 1)
        columns = np.einsum("nkij,nia->njka", J, body.rotation).reshape(*motion.v.shape, 6)
        return {motion.joints[dof]: columns[:, dof] for dof in body.dofs}


@dataclass(frozen=True)
class ThermalOffset(JointEffect):
    """Offset that drifts with the joint's temperature, as that of a torque sensor.

    effort = o + k (T − T₀), with o in N·m and k in N·m/°C, at T °C.

    It contains the constant `effort_offset`. Unknown temperatures are taken to be T₀.

    Attributes:
        reference: T₀, °C; a diagnosis takes the mean of the logs.
    """

    reference: float

    name = "thermal_offset"
    law = "o + k (T − T₀), where the log has the joint's temperature T"
    complexity = 1
    contains = (EffortOffset,)
    shapes = (Shape("reference", "°C", grid=(1.0,), scale="temperature", usual=25.0),)
    parameters = (Parameter("offset", "N·m"), Parameter("slope", "N·m/°C"))
    signature = "an offset that varies with the logged temperature of the joint"
    depends_on = frozenset({"temperature"})
    free_shapes = 0  # another T₀ only changes the offset

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[1, 0], as at T₀."""
        return [np.ones_like(joint.v), np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Rows:
        """[1, T − T₀]; [1, 0] where T is unknown."""
        warmer = motion.warmer(self.joint, self.reference)
        return {self.joint: np.stack([np.ones_like(warmer), warmer], -1)}


@dataclass(frozen=True)
class EffortScale(JointEffect):
    """Gain error of a joint's effort: a wrong torque constant, gear ratio or sensor slope.

    effort = (1 + ε) × all that the joint needs otherwise, so that ε times it is added; ε > −1.

    A joint that reads 10 % too much looks like bodies that are 10 % heavier. The gain can be
    identified only with independent knowledge: inertias fitted to other logs; a payload of known
    mass in some but not all logs, for the joints that bear it; or measured ground forces, for the
    limbs of a free base. A diagnosis tries it only then. If a stated mass is too large by some
    factor, the gains of all these joints appear too small by the same factor.
    """

    name = "effort_scale"
    of_motor = True
    law = (
        "(1 + ε) times the joint's effort; needs trusted inertia, a known payload in one "
        "log, or known ground forces"
    )
    complexity = 1
    role = Role.SCALE
    parameters = (Parameter("gain_error", "1", lower=-0.99),)
    signature = "in proportion to everything else that the joint needs"
    depends_on = frozenset({"load"})
    needs_known_inertia = True

    def columns(self, joint: JointMotion) -> tuple[Array]:
        """[τ] of the rigid bodies."""
        return (joint.load,)

    def rows(self, motion: RobotMotion) -> Rows:
        """[τ], with all other effects of the model if `motion.effort` is available."""
        if motion.effort is None:
            return super().rows(motion)
        return {self.joint: motion.effort()[:, motion.index(self.joint), None]}


@dataclass(frozen=True)
class EffortDelay(Effect):
    """Time by which logged efforts lag behind logged motion.

    effort logged at t = effort needed at t − δ.

    It has no columns, but shifts those of all other effects: `delayed` turns the needed efforts, or
    their regressor columns, into those that the log shows. Shift before filtering. In simulations
    use `geodrake.control.DelayedEffort`.

    Commanded (not measured) efforts that act late are ahead of the motion: δ is then negative, and
    −δ is the latency of a command.

    Attributes:
        delay: δ, s; negative if the efforts are ahead.
        joint: The joint whose effort lags; all joints of the log if None.
    """

    delay: float
    joint: str | None = None

    name = "effort_delay"
    law = "effort(t − δ); δ < 0 for a command that acts late"
    complexity = 1
    role = Role.DELAY
    shapes = (Shape("delay", "s"),)
    parameters = ()
    places: ClassVar[str] = "log"
    signature = "follows the rate of change of the effort, so it is largest in fast motion"
    depends_on = frozenset()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.isfinite(self.delay):
            raise ArgumentError(f"{self.name} needs a finite delay; it got {self.delay}.")

    def rows(self, motion: RobotMotion) -> Rows:
        """Return no rows: a delay adds no effort."""
        del motion
        return {}

    def delayed(self, signal: ArrayLike, period: float) -> Array:
        """Return the signal delayed by δ, by quintic spline interpolation.

        Args:
            signal: (N, ...) samples at a uniform rate.
            period: Time between samples, s.

        Returns:
            (N, ...) samples at t − δ, extended by the first or last sample at the ends.

        Raises:
            ArgumentError: The period is not positive, or there are no samples.
        """
        signal, period = real_array(signal, "signal"), positive(period, "period")
        if signal.size == 0 or signal.ndim == 0:
            raise ArgumentError(f"A delay needs samples; its signal has the shape {signal.shape}.")
        if self.delay == 0 or len(signal) == 1:
            return signal.copy()
        samples = np.arange(len(signal), dtype=float)
        at = np.clip(samples - self.delay / period, 0, samples[-1])
        return np.asarray(spline_through(signal)(at))


def delays_of(effects: Sequence[Effect], joints: Sequence[str]) -> Array:
    """Return (n,) total delays, s, of effects at n joints."""
    delays = np.zeros(len(joints))
    for effect in effects:
        if effect.role is Role.DELAY:
            delayed = [not effect.where or joint in effect.where for joint in joints]
            delays[delayed] += effect.shape["delay"]
    return delays


def effort_delays(delays: ArrayLike, joints: Sequence[str]) -> list[EffortDelay]:
    """Return the effects that delay n joints by (n,) s; a single one if all delays are equal."""
    seconds = np.asarray(delays, float).tolist()
    if len(set(seconds)) == 1:
        return [EffortDelay(seconds[0])] if seconds[0] else []
    return [EffortDelay(delay, name) for delay, name in zip(seconds, joints, strict=True) if delay]


def delayed_by(delays: ArrayLike, signals: Array, period: float) -> Array:
    """Return signals (N, n) with a sampling period, delayed by (n,) s."""
    seconds = np.asarray(delays, float).tolist()
    if len(set(seconds)) == 1:
        return EffortDelay(seconds[0]).delayed(signals, period)
    pairs = zip(seconds, signals.T, strict=True)
    return np.stack([EffortDelay(delay).delayed(x, period) for delay, x in pairs], axis=1)
