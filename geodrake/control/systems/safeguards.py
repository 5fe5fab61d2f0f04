"""What an online system believes, and what it does when it cannot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex

from geodrake.boundary.arguments import number, real_array
from geodrake.boundary.showing import Short
from geodrake.compiling import compiled, contiguous
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_plant

_MOVING = 1e-4  # rad/s or m/s, speed above which two equal measurements are one
_LARGEST = 1e6  # rad, m, rad/s or m/s, norm of a state that no robot has
_FORGOTTEN = 0.25  # s, for which drift adds up, and over which noise of velocities is measured
_LEVEL = 1.0  # s, over which drift is measured
_DOUBTED = 0.25  # s, for which states that contradict the last one are not believed
_OUTLIER = 5.0  # standard deviations
_ROWS = 8  # of the memory of a watch: q, q̇, q_d, drift, its mean square, change of q̇, noise²


@dataclass(frozen=True, eq=False)
class Safeguards(Short):
    """Limits of a controller.

    Attributes:
        effort_limits: (nv,) greatest efforts, N·m or N; while one is reached, adaptation waits
            (anti-windup). None for no limits.
        stale_time: A measurement that has not changed for this long, in any digit, although it says
            that the robot moves, counts as missing, s; inf for never.
        dead_zone: (nv,) or one tracking error |r|, rad/s or m/s, that is not adapted to. Adaptation
            by this error waits while all joints are inside. None for three standard deviations of
            what noise makes of r, as it is measured all the time.
        drift: What positions may drift from what velocities say, rad or m: a state that goes
            further, and further than noise explains, is not believed. inf to believe all.
        settling_time: For how long states must have been believed before adaptation goes on, s.
        factor: How many times the parameters of the model, or the first estimate, an estimate may
            reach, see `plausible_limits`; inf for no limits.
        fastest: How fast a tracking error may move the estimate, lengths of the metric (in which a
            factor of e has the length 1 to 2) a second; inf for any. Not with time step zero.
        leakage: σ of the law's `leak` toward the parameters of the model, 1/s; zero for none.

    Raises:
        ArgumentError: A number is out of range.
    """

    effort_limits: ArrayLike | None = None
    stale_time: float = 0.05
    dead_zone: ArrayLike | None = None
    drift: float = 0.02
    settling_time: float = 1.0
    factor: float = 10.0
    fastest: float = 10.0
    leakage: float = 0.0

    def __post_init__(self) -> None:
        for name in ("stale_time", "drift", "fastest"):
            if not number(given := getattr(self, name), name, finite=False) > 0:
                raise ArgumentError(f"{name} must be positive; got {given}.")
        number(self.settling_time, "settling_time", lower=0.0)
        number(self.leakage, "leakage", lower=0.0)
        if not number(self.factor, "factor", finite=False) > 1:
            raise ArgumentError(f"factor must be above one; got {self.factor}.")
        if self.dead_zone is not None:
            zone = real_array(self.dead_zone, "dead_zone")
            if zone.ndim > 1 or not (zone >= 0).all():
                raise ArgumentError(f"A dead zone is zero or more; got {zone.tolist()}.")
        if self.effort_limits is not None:
            limits = real_array(self.effort_limits, "effort_limits", finite=False)
            if limits.ndim > 1 or not (limits > 0).all():
                raise ArgumentError(f"Effort limits must be positive; got {limits.tolist()}.")

    @classmethod
    def of_plant(cls, plant: MultibodyPlant, *, stale_time: float = 0.05) -> Safeguards:
        """The effort limits of a plant's actuators, which must be at single-degree joints.

        Args:
            plant: A finalized plant.
            stale_time: Age of a sample from which a sensor counts as failed, s.
        """
        check_plant(plant)
        limits = np.full(plant.num_velocities(), np.inf)
        for index in range(plant.num_actuators()):
            actuator = plant.get_joint_actuator(JointActuatorIndex(index))
            limits[actuator.joint().velocity_start()] = actuator.effort_limit()
        return cls(limits, stale_time)

    def limits(self, nv: int) -> Array | None:
        """The effort limits (nv,), checked."""
        if self.effort_limits is None:
            return None
        limits = np.asarray(self.effort_limits, float)
        if limits.shape not in ((), (nv,)):
            raise ArgumentError(f"Effort limits are one or {nv}; got {limits.tolist()}.")
        return np.broadcast_to(limits, (nv,))

    def dead_zones(self, nv: int) -> Array | None:
        """The dead zone (nv,), checked; None if it is measured."""
        if self.dead_zone is None:
            return None
        zone = np.asarray(self.dead_zone, float)
        if zone.shape not in ((), (nv,)):
            raise ArgumentError(f"A dead zone is one or {nv}; got {zone.tolist()}.")
        return np.broadcast_to(zone, (nv,))


@dataclass(frozen=True, eq=False)
class Seen:
    """What a controller goes by at one sample, always finite.

    Attributes:
        q: (n,) positions.
        qd: (n,) velocities.
        q_d: (n,) desired positions.
        v_d: (n,) desired velocities.
        a_d: (n,) desired accelerations.
        noise: (2, n) standard deviations of the noise of q and q̇, as far as it was measured.
        trusted: Whether all of it was measured and asked for just now, and has been plausible.
        repeated: Whether all of it is usable but the state is the last one again.
        known: Whether there is anything to go by.
    """

    q: Array
    qd: Array
    q_d: Array
    v_d: Array
    a_d: Array
    noise: Array
    trusted: bool
    repeated: bool
    known: bool


@dataclass(frozen=True)
class Watch:
    """Looks after a sensor, and replaces inputs that are missing.

    A state is missing where it is not finite, has stood still for too long, or contradicts itself,
    as positions drift from what velocities say of them:

        d ← exp(−h/τ) d + q − q⁻ − h (q̇ + q̇⁻)/2

    is more than `drift`, and five times its own RMS value of the last second. The next state is
    taken, whatever it says, after `stale_time` without one, and after a quarter of a second of
    contradictions.

    A measured state that is missing is taken to be the desired one, which leaves the feedforward of
    the model. A desired motion that is missing is to rest at the last desired position, or if there
    was none at the measured one.

    Attributes:
        size: Number n of positions, which are as many as velocities.
        period: From sample to sample, s; zero where nothing is remembered.
        stale_time, drift, settling_time: Those of `Safeguards`.
    """

    size: int
    period: float = 0.0
    stale_time: float = np.inf
    drift: float = np.inf
    settling_time: float = 0.0

    def start(self) -> Array:
        """The memory (8 n + 3,) before the first sample."""
        rows = np.zeros((_ROWS, self.size))
        rows[[0, 1, 2, 5]] = np.nan
        return np.append(rows, [0.0, 0.0, np.finfo(float).max])

    def measure(self, memory: Array, state: Array) -> tuple[bool, bool]:
        """Whether a state (2 n,) is believed, and whether it is new; puts it into the memory."""
        times = self.period, self.stale_time, self.drift
        return calc_measured(contiguous(state), times, memory)

    def look(
        self, memory: Array, state: Array, desired: Array, acceleration: Array
    ) -> tuple[Seen, Array]:
        """What to go by, and the memory after the sample.

        Args:
            memory: (8 n + 3,) of the last sample.
            state: (2 n,) measured positions and velocities.
            desired: (2 n,) desired positions and velocities.
            acceleration: (n,) desired accelerations.
        """
        n, following = self.size, memory.copy()
        measured, new = self.measure(following, state)
        rows = following[:-3].reshape(_ROWS, n)
        last, asked = rows[2].copy(), usable(desired) and usable(acceleration)
        if asked:
            q_d, v_d, a_d = desired[:n], desired[n:], acceleration
        else:
            q_d = state[:n] if measured and not usable(last) else last
            v_d = a_d = np.zeros(n)
        if known := usable(q_d):
            rows[2] = q_d
        q, qd = (state[:n], state[n:]) if measured else (q_d, v_d)
        settled = bool(following[-1] * self.period >= self.settling_time)
        trusted, repeated = measured and asked and new, measured and asked and not new
        noise = np.sqrt(rows[6:])
        return Seen(q, qd, q_d, v_d, a_d, noise, trusted and settled, repeated, known), following


@compiled
def calc_measured(
    state: Array, times: tuple[float, float, float], memory: Array
) -> tuple[bool, bool]:
    """Kernel of `Watch.measure`.

    Args:
        state: (2 n,) measured positions and velocities.
        times: Period, stale time and drift of a `Watch`.
        memory: (8 n + 3,) of the last sample; its last three numbers count samples since the last
            new state, since a robot that moves stands still, and since the last contradiction.
    """
    period, stale, most = times
    n = len(state) // 2
    rows, counts = memory[: 8 * n].reshape((8, n)), memory[8 * n :]
    counts[0] += 1.0
    counts[2] += 1.0
    size = 0.0
    for value in state:
        size += value * value
    if not size < _LARGEST * _LARGEST:
        return False, False
    changed, moving = False, False
    for i in range(n):
        changed |= state[i] != rows[0, i] or state[n + i] != rows[1, i]
        moving |= abs(state[n + i]) > _MOVING
    if not changed:
        counts[1] = counts[1] + 1.0 if moving else 0.0
        return counts[1] == 0.0 or counts[1] * period < stale, False
    gap = counts[0] * period
    oldest = _DOUBTED if counts[2] < counts[0] else min(stale, _DOUBTED)
    compared = gap <= oldest and np.isfinite(rows[0, 0])
    fresh, level = min(period / _FORGOTTEN, 1.0), min(period / _LEVEL, 1.0)
    kept, drift, believed = np.exp(-gap / _FORGOTTEN), np.zeros(n), True
    for i in range(n) if compared else range(0):
        off = state[i] - rows[0, i] - 0.5 * gap * (state[n + i] + rows[1, i])
        # (Of what velocities between the samples may be, half is forgiven.)
        forgiven = 0.25 * gap * abs(state[n + i] - rows[1, i])
        drift[i] = kept * rows[3, i] + np.sign(off) * max(abs(off) - forgiven, 0.0)
        limit = max(most, _OUTLIER * np.sqrt(rows[4, i]))
        believed &= abs(drift[i]) <= limit
        rows[4, i] += level * (min(abs(drift[i]), limit) ** 2 - rows[4, i])
    if not believed:
        counts[2] = 0.0
        return False, False
    for i in range(n):
        change = (state[n + i] - rows[1, i]) / counts[0] if compared else np.nan
        second = change - rows[5, i]
        if np.isfinite(second):  # white noise of velocities has √6 times its deviation there
            rows[7, i] += fresh * (second * second / 6.0 - rows[7, i])
        rows[6, i] += fresh * (drift[i] * drift[i] - rows[6, i])
        rows[0, i], rows[1, i], rows[3, i], rows[5, i] = state[i], state[n + i], drift[i], change
    counts[0], counts[1] = 0.0, 0.0
    return True, True


def usable(x: Array) -> bool:
    """Whether all of x (n,) are numbers, and not absurdly large ones."""
    return math.isfinite(x @ x)
