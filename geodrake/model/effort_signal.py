"""Signals that replace measured efforts: kinds, gains and limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from geodrake.boundary.arguments import instance, number
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.logs.motion import SIGNAL_KINDS

COMMAND = "command"
"""Kind of a joint with nothing but position commands of a servo."""

EFFORT = "effort"
"""Kind of a joint with commanded efforts, which its motor limits."""

SERVO = "servo"
"""Name of the servo that converts a `COMMAND`, as among names of effects."""

KINDS = (EFFORT, *SIGNAL_KINDS, COMMAND)

_UNITS = {EFFORT: "", "current": "N·m/A", "voltage": "N·m/V", "pwm": "N·m", COMMAND: "N·m/rad"}
_NOT_NEGATIVE = (
    "deviation",
    "damping",
    "damping_deviation",
    "delay",
    "integral",
    "integral_deviation",
    "dead_band",
    "dead_band_deviation",
)


@dataclass(frozen=True)
class MotorLimit:
    """A speed-dependent limit of a motor's effort: −L (1 + v/w) ≤ effort ≤ L (1 − v/w).

    Attributes:
        effort: L, the stall effort, N·m or N.
        no_load_speed: w, rad/s or m/s; infinite for a constant limit.
    """

    effort: float
    no_load_speed: float = np.inf

    def times(self, factor: float) -> MotorLimit:
        """Return the limit of efforts multiplied by a factor above 0."""
        return replace(self, effort=factor * self.effort)

    def given(self, commanded: Array, velocity: Array) -> Array:
        """Return a motor's efforts (K,), N·m or N, for commanded ones at given velocities."""
        falling = velocity / self.no_load_speed
        return np.clip(commanded, -self.effort * (1.0 + falling), self.effort * (1.0 - falling))

    def beyond(self, commanded: Array, velocity: Array) -> tuple[float, float]:
        """Return the share of samples (K,) beyond the limit, and their mean squared excess."""
        excess = commanded - self.given(commanded, velocity)
        share = float(np.mean(excess != 0.0))
        return share, float(np.mean(excess**2)) / share if share else 1.0


@dataclass(frozen=True)
class EffortSignal:
    """A signal that replaces a joint's effort in logs, and its conversion to an effort.

    For a current, a voltage or a commanded effort s, the effort is gain·s. For a servo it is

        gain·e + damping·(ρ dc/dt(t − delay) − v) + integral·∫e dt,    e = dead(c(t − delay) − q)

    with the commanded position c and the dead band function dead, limited to
    ±limit (1 ∓ v / no_load_speed). The integral at the beginning of a log is unknown. It is chosen
    so that the servo's mean effort, up to friction, is the model's.

    Attributes:
        kind: "effort", "current", "voltage", "pwm" or "command".
        gain: N·m (N) per A, V or 1, 1 for efforts; for commands the stiffness, N·m/rad (N/m).
        deviation: Standard deviation of the gain, in its unit; 0 if it is exact.
        damping: Damping of a servo, N·m·s/rad (N·s/m).
        damping_deviation: Its standard deviation, in addition to that of the gain.
        rate_share: ρ, from 0 for damping of the motion to 1 for damping of the error.
        delay: Delay of the command, s.
        limit: Largest effort, N·m or N.
        integral: Integral gain of a servo, N·m/(rad·s) (N/(m·s)).
        integral_deviation: Its standard deviation, in addition to that of the gain.
        no_load_speed: Speed at which the motor's effort vanishes, rad/s or m/s; not for servos.
        dead_band: Largest position error that a servo ignores, rad or m.
        dead_band_deviation: Its standard deviation.
        effect_deviations: Effect of the joint, such as `viscous_friction` -> standard deviation of
            its parameter from logs of commands alone, in addition to that of the gain, N·m and s:
            delay, damping, friction and inertia compensate for one another.

    Raises:
        ArgumentError: The kind is unknown, or a number is out of range.
    """

    joint: str
    kind: str
    gain: float
    deviation: float = 0.0
    damping: float = 0.0
    damping_deviation: float = 0.0
    delay: float = 0.0
    limit: float = math.inf
    integral: float = 0.0
    integral_deviation: float = 0.0
    no_load_speed: float = math.inf
    rate_share: float = 1.0
    dead_band: float = 0.0
    dead_band_deviation: float = 0.0
    effect_deviations: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        instance(self.joint, "joint", str)
        if self.kind not in KINDS:
            raise ArgumentError(
                f"Efforts of {self.joint!r} have the unknown kind {self.kind!r}.",
                advice=f"Kinds are {', '.join(KINDS)}.",
            )
        number(self.gain, f"the gain of {self.joint}")
        if self.gain == 0.0 or (self.kind == COMMAND and self.gain < 0.0):
            raise ArgumentError(
                f"The gain of {self.joint!r} is {self.gain:.4g}; it must be "
                f"{'positive' if self.kind == COMMAND else 'nonzero'}."
            )
        if self.kind == EFFORT and (self.gain, self.deviation) != (1.0, 0.0):
            raise ArgumentError(
                f"Efforts of {self.joint!r} have the gain {self.gain:.4g} ± {self.deviation:.4g}.",
                advice="The gain of commanded efforts is 1 exactly; --gain corrects those of a "
                "log.",
            )
        for name in _NOT_NEGATIVE:
            number(getattr(self, name), f"{name} of {self.joint}", lower=0.0)
        for name, value in self.effect_deviations.items():
            number(value, f"deviation of {name} of {self.joint}", lower=0.0)
        number(self.rate_share, f"rate_share of {self.joint}", lower=0.0, upper=1.0)
        for name in ("limit", "no_load_speed"):
            value = number(getattr(self, name), f"{name} of {self.joint}", finite=False)
            if not value > 0.0:
                raise ArgumentError(f"{name} of {self.joint!r} is {value!r}; it must be positive.")
        if self.kind == COMMAND and math.isfinite(self.no_load_speed):
            raise ArgumentError(
                f"The servo of {self.joint!r} has a no-load speed, {self.no_load_speed:.4g}.",
                advice="Limits of servos do not depend on speed: omit no_load_speed.",
            )

    @property
    def unit(self) -> str:
        """Return the unit of the gain at a revolute joint."""
        return _UNITS[self.kind]

    @property
    def motor(self) -> MotorLimit:
        """Return the limits of the motor."""
        return MotorLimit(self.limit, self.no_load_speed)

    @property
    def uncertainty(self) -> float:
        """Return the relative standard deviation of the gain."""
        return self.deviation / abs(self.gain)


def signal_of(signals: Iterable[EffortSignal], joint: str) -> EffortSignal | None:
    """Return the signal that replaces a joint's efforts; None if efforts are measured."""
    return next((signal for signal in signals if signal.joint == joint), None)
