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
"""Kind of a joint with position commands of a servo only."""

EFFORT = "effort"
"""Kind of a joint with commanded efforts, which its motor gives within a limit."""

SERVO = "servo"
"""Name, among those of effects, of the servo that follows a `COMMAND`."""

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
    """A motor gives the less the faster it drives: −L (1 + v/w) ≤ effort ≤ L (1 − v/w).

    Attributes:
        effort: L, its largest effort, N·m or N.
        no_load_speed: w, at which it gives none, rad/s or m/s; infinite if the limit is the same
            at every speed.
    """

    effort: float
    no_load_speed: float = np.inf

    def times(self, factor: float) -> MotorLimit:
        """Return that of efforts multiplied by a factor above 0."""
        return replace(self, effort=factor * self.effort)

    def given(self, asked: Array, velocity: Array) -> Array:
        """Return efforts (K,), N·m or N, of a motor for commanded ones at given velocities."""
        falling = velocity / self.no_load_speed
        return np.clip(asked, -self.effort * (1.0 + falling), self.effort * (1.0 - falling))

    def beyond(self, asked: Array, velocity: Array) -> tuple[float, float]:
        """Return the share of samples (K,) beyond the limit, and their mean square beyond it."""
        excess = asked - self.given(asked, velocity)
        share = float(np.mean(excess != 0.0))
        return share, float(np.mean(excess**2)) / share if share else 1.0


@dataclass(frozen=True)
class EffortSignal:
    """A signal that replaces a joint's effort in logs, and its conversion to an effort.

    The effort is gain·s of a signal s, a current, a voltage, or the effort that the motor is asked
    for. Of a servo it is

        gain·e + damping·(ρ dc/dt(t − delay) − v) + integral·∫e dt,    e = dead(c(t − delay) − q)

    with the commanded position c, where dead takes the dead band off an error. It is within
    ±limit (1 ∓ v / no_load_speed). What the integral was when a log began is not known: it begins
    so that the servo gives in the mean, beside friction, what the model needs.

    Attributes:
        kind: "effort", "current", "voltage", "pwm" or "command".
        gain: N·m (N) per A, V or 1, 1 for efforts; for commands the stiffness, N·m/rad (N/m).
        deviation: Standard deviation of the gain, in its unit; 0 if it is known exactly.
        damping: Of a servo, N·m·s/rad (N·s/m).
        damping_deviation: Its standard deviation, beside that of the gain.
        rate_share: ρ, from 0 for damping of the motion alone to 1 for damping of its error.
        delay: How late the command acts, s.
        limit: Largest effort, N·m or N.
        integral: Of a servo, effort per integral of its error, N·m/(rad·s) (N/(m·s)).
        integral_deviation: Its standard deviation, beside that of the gain.
        no_load_speed: At which the motor gives no effort, rad/s or m/s; of no servo.
        dead_band: Error of position up to which a servo does nothing about it, rad or m.
        dead_band_deviation: Its standard deviation.
        effect_deviations: Effect of the joint, such as `viscous_friction` -> standard deviation of
            its parameter where logs of commands alone tell it, beside that of the gain, N·m and s:
            delay, damping, friction and inertia make up for one another.

    Raises:
        ArgumentError: There is no such kind, or a number is out of its range.
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
        """Unit of the gain at a joint that turns."""
        return _UNITS[self.kind]

    @property
    def motor(self) -> MotorLimit:
        """Limits of its motor."""
        return MotorLimit(self.limit, self.no_load_speed)

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the gain as a share of it."""
        return self.deviation / abs(self.gain)


def signal_of(signals: Iterable[EffortSignal], joint: str) -> EffortSignal | None:
    """Return the signal that replaces a joint's efforts; None if efforts are measured."""
    return next((signal for signal in signals if signal.joint == joint), None)
