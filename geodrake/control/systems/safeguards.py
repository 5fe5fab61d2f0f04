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
from geodrake.compiling import compiled, contiguous, inlined
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_plant

_MOVING = 1e-4  # rad/s or m/s, speed above which two equal measurements are one


@dataclass(frozen=True, eq=False)
class Safeguards(Short):
    """Limits of a controller.

    Attributes:
        effort_limits: (nv,) greatest efforts, N·m or N; while one is reached, adaptation waits
            (anti-windup). None for no limits.
        stale_time: A measurement that has not changed for this long, in any digit, although it says
            that the robot moves, counts as missing, s; inf for never.
        dead_zone: (nv,) or one tracking error |r|, rad/s or m/s, that is not adapted to: what noise
            makes of the velocity. Adaptation by this error waits while all joints are inside.

    Raises:
        ArgumentError: The stale time is not positive.
    """

    effort_limits: ArrayLike | None = None
    stale_time: float = 0.05
    dead_zone: ArrayLike = 0.0

    def __post_init__(self) -> None:
        if not number(self.stale_time, "stale_time", finite=False) > 0:
            raise ArgumentError(f"A stale time is positive; got {self.stale_time} s.")
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

    def dead_zones(self, nv: int) -> Array:
        """The dead zone (nv,), checked."""
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
        trusted: Whether all of it was measured and asked for just now.
        repeated: Whether all of that is so but that the state is the last one again.
        known: Whether there is anything to go by.
    """

    q: Array
    qd: Array
    q_d: Array
    v_d: Array
    a_d: Array
    trusted: bool
    repeated: bool
    known: bool


@dataclass(frozen=True)
class Watch:
    """Replaces inputs that are missing.

    A measured state that is missing is taken to be the desired one, which leaves the feedforward of
    the model. A desired motion that is missing is to rest at the last desired position, or if there
    was none at the measured one. The memory holds the last measured state, for how many samples it
    has not changed, and the last desired position.

    Attributes:
        size: Number n of positions, which are as many as velocities.
        patience: Number of samples without change after which a moving robot's state is missing.
    """

    size: int
    patience: float = np.inf

    def start(self) -> Array:
        """The memory (3 n + 1,) before the first sample."""
        return np.concatenate([np.full(2 * self.size, np.nan), [0.0], np.full(self.size, np.nan)])

    def look(
        self, memory: Array, state: Array, desired: Array, acceleration: Array
    ) -> tuple[Seen, Array]:
        """What to go by, and the memory after the sample.

        Args:
            memory: (3 n + 1,) of the last sample.
            state: (2 n,) measured positions and velocities.
            desired: (2 n,) desired positions and velocities.
            acceleration: (n,) desired accelerations.
        """
        n, following = self.size, memory.copy()
        seen = np.empty((5, n))
        desired, acceleration = contiguous(desired), contiguous(acceleration)
        trusted, repeated, known = calc_look(
            (contiguous(state), desired, acceleration), self.patience, following, seen
        )
        q, qd, q_d, v_d, a_d = seen
        return Seen(q, qd, q_d, v_d, a_d, trusted, repeated, known), following


@compiled
def calc_look(
    inputs: tuple[Array, Array, Array], patience: float, memory: Array, seen: Array
) -> tuple[bool, bool, bool]:
    """Writes what to go by, and the memory after the sample; see `Watch.look`.

    Args:
        inputs: State (2 n,), desired state (2 n,) and acceleration (n,).
        patience: That of a `Watch`.
        memory: (3 n + 1,) of the last sample, then of this one.
        seen: (5, n) rows of a `Seen`.

    Returns:
        Whether it is trusted, repeated and known.
    """
    state, desired, acceleration = inputs
    n = len(acceleration)
    measured, new, count = look_at(state, patience, memory)
    memory[2 * n] = count
    if new:
        put_all(memory, state)
    asked = is_usable(desired) and is_usable(acceleration)
    last = memory[2 * n + 1 :]
    put_all(seen[2], desired[:n] if asked else last)
    for i in range(n):
        seen[3, i] = desired[n + i] if asked else 0.0
        seen[4, i] = acceleration[i] if asked else 0.0
    if measured and not is_usable(seen[2]):
        put_all(seen[2], state[:n])
    known = asked or is_usable(seen[2])
    if known:
        put_all(last, seen[2])
    put_all(seen[0], state[:n] if measured else seen[2])
    put_all(seen[1], state[n:] if measured else seen[3])
    both = measured and asked
    return both and new, both and not new, known


@compiled
def look_at(state: Array, patience: float, memory: Array) -> tuple[bool, bool, float]:
    """Whether a state can be used, whether it is new as well, and since how many samples not.

    Args:
        state: (2 n,) measured positions and velocities.
        patience: That of a `Watch`.
        memory: (2 n + 1, ...) of the last sample.
    """
    size = len(state)
    count = memory[size]
    if not is_usable(state):
        return False, False, count
    changed, moving = False, False
    for i in range(size):
        changed |= state[i] != memory[i]
        moving |= i >= size // 2 and abs(state[i]) > _MOVING
    if changed:
        return True, True, 0.0
    count = count + 1.0 if moving else 0.0
    return count < patience, count == 0.0, count


@inlined
def put_all(out: Array, x: Array) -> None:
    """Writes x (n,) into the first n of an array; an array's own assignment compiles slowly."""
    for i in range(len(x)):
        out[i] = x[i]


@inlined
def is_usable(x: Array) -> bool:
    """Whether all of x (n,) are numbers, and not absurdly large ones."""
    total = 0.0
    for value in x:
        total += value * value
    return total < np.inf


def usable(x: Array) -> bool:
    """Whether all of x (n,) are numbers, and not absurdly large ones."""
    return math.isfinite(x @ x)
