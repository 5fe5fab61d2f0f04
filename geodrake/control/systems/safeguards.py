"""Safeguards of online systems: checks of arguments and samples, and what follows a bad one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex

from geodrake.boundary.arguments import number, one_or_each, real_array
from geodrake.boundary.showing import Short
from geodrake.compiling import compiled, contiguous, inlined
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.regressor import ControlModel, checked_control
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_plant
from geodrake.manifolds import Manifold

_MOVING = 1e-4  # rad/s or m/s, speed above which two equal measurements are one
_LARGEST = 1e6  # rad, m, rad/s or m/s, norm of a state that no robot has
SUSPECT = 0.25  # s, for which drift adds up, and for which a loop goes on before it is believed


@dataclass(frozen=True, eq=False)
class Safeguards(Short):
    """Limits of a controller.

    Attributes:
        effort_limits: (nv,) greatest efforts, N·m or N; None for no limits.
        stale_time: A measurement that has not changed for this long, in any digit, although it says
            that the robot moves, counts as missing, s; inf for never.
        dead_zone: (nv,) or one tracking error |r|, rad/s or m/s, that is not adapted to: what noise
            makes of the velocity. Adaptation by this error waits while all joints are inside.
        drift: What positions may drift from what velocities say within a quarter of a second, rad
            or m; several times the noise of positions. A state that goes further is not believed.
            inf to believe all.
        settling_time: For how long states must have been believed, and efforts within their limits,
            before adaptation goes on, s.
        factor: How many times the parameters of the model, or the first estimate, an estimate may
            reach, see `adaptation.outer_laws.limited`; inf for no limits.
    """

    effort_limits: ArrayLike | None = None
    stale_time: float = 0.05
    dead_zone: ArrayLike = 0.0
    drift: float = 0.02
    settling_time: float = 1.0
    factor: float = 10.0

    def __post_init__(self) -> None:
        for name, least in (("stale_time", 0.0), ("drift", 0.0), ("factor", 1.0)):
            if not number(given := getattr(self, name), name, finite=False) > least:
                raise ArgumentError(f"{name} must be above {least:g}; got {given}.")
        number(self.settling_time, "settling_time", lower=0.0)
        self.dead_zones(real_array(self.dead_zone, "dead_zone").size)
        if self.effort_limits is not None:
            self.limits(real_array(self.effort_limits, "effort_limits", finite=False).size)

    @classmethod
    def of_plant(cls, plant: MultibodyPlant, *, stale_time: float = 0.05) -> Safeguards:
        """Return the effort limits of a plant's actuators, at joints of one degree of freedom."""
        check_plant(plant)
        limits = np.full(plant.num_velocities(), np.inf)
        for index in range(plant.num_actuators()):
            actuator = plant.get_joint_actuator(JointActuatorIndex(index))
            limits[actuator.joint().velocity_start()] = actuator.effort_limit()
        return cls(limits, stale_time)

    def limits(self, nv: int) -> Array:
        """Return the effort limits (nv,), checked; infinite where there are none."""
        limits = np.inf if self.effort_limits is None else self.effort_limits
        return one_or_each(limits, "effort_limits", nv, strict=True, finite=False)

    def dead_zones(self, nv: int) -> Array:
        """Return the dead zone (nv,), checked."""
        return one_or_each(self.dead_zone, "dead_zone", nv)


class Seen(NamedTuple):
    """Signals that a controller uses at one sample, always finite."""

    q: Array  # (n,) positions
    qd: Array  # (n,) velocities
    q_d: Array  # (n,) desired positions
    v_d: Array  # (n,) desired velocities
    a_d: Array  # (n,) desired accelerations
    trusted: bool  # whether all of it was measured and asked for just now, and has been plausible
    repeated: bool  # whether all of it is usable but the state is the last one again
    known: bool  # whether there is anything to go by
    settled: bool  # whether nothing has interrupted the loop for the settling time

    def within_reach(self, rate: Array, braking: Array) -> Seen:
        """Return the same, with a desired motion that approaches from afar as fast as it can stop.

        An error e = q − q_d is to fall with ė = −s(e), which is λ e near zero, and beyond that the
        speed that a deceleration a brakes within the distance, √(2 a (|e| − a / 2 λ²)), with the
        rate λ (n,), 1/s, and the braking a (n,), rad/s² or m/s².
        """
        e, ed, knee = self.q - self.q_d, self.qd - self.v_d, braking / rate**2
        if not (far := np.abs(e) > knee).any():
            return self
        s = np.sign(e) * np.sqrt(2.0 * braking * (np.abs(e) - 0.5 * knee))
        r = ed + s
        return self._replace(
            q_d=np.where(far, self.q, self.q_d),
            v_d=np.where(far, self.v_d - s, self.v_d),
            a_d=np.where(far, self.a_d - braking / np.abs(s) * ed + rate * r, self.a_d),
        )


class Watch(NamedTuple):
    """Looks after a sensor, and replaces inputs that are missing.

    A state is missing where it is not finite, has stood still for too long, or contradicts the last
    one, as positions drift by more than `drift` from what velocities say of them:

        d ← exp(−h/τ) d + q − q⁻ − h (q̇ + q̇⁻)/2,   τ = 0.25 s

    The first state after `stale_time` without any, or 0.25 s of contradictions, is taken, whatever
    it says.

    A measured state that is missing is taken to be the desired one, which leaves the feedforward of
    the model. A desired motion that is missing is to rest at the last desired position, or if there
    was none at the measured one.

    The memory holds the last measured state, the last desired position, the drift, and for how many
    samples there was no new state, a moving robot has stood still, there was no contradiction, and
    nothing that `interrupt` was told of; this one is below zero while adaptation waits.
    """

    size: int  # number n of positions, which are as many as velocities
    period: float = 0.0  # from sample to sample, s; zero where nothing is remembered
    stale_time: float = np.inf
    drift: float = np.inf
    settling_time: float = 0.0

    def start(self) -> Array:
        """Return the memory (4 n + 4,) before the first sample."""
        never = np.finfo(float).max
        return np.concatenate(
            [np.full(3 * self.size, np.nan), np.zeros(self.size), [never, 0.0, never, 0.0]]
        )

    def measure(self, memory: Array, state: Array) -> tuple[bool, bool]:
        """Return whether a state (2 n,) is trusted and whether it is new, and remember it."""
        return calc_measured(contiguous(state), self, memory)

    def look(
        self, memory: Array, state: Array, desired: Array, acceleration: Array
    ) -> tuple[Seen, Array]:
        """Return what to go by, and the memory after the sample.

        Measured and desired states are (2 n,), positions and then velocities; accelerations (n,)
        are desired ones.
        """
        following, motion = memory.copy(), np.empty((5, self.size))
        inputs = contiguous(state), contiguous(desired), contiguous(acceleration)
        q, qd, q_d, v_d, a_d = motion
        answers = calc_looked(inputs, self, following, motion)
        return Seen(q, qd, q_d, v_d, a_d, *answers), following

    def interrupt(self, memory: Array) -> bool:
        """Return whether a loop that had gone on for a quarter of a second is interrupted.

        Adaptation waits from then on until the loop has gone on for the settling time. One that has
        just begun is no less settled than it was.
        """
        surprised = self.settling_time > 0 and memory[-1] * self.period >= SUSPECT
        waits = surprised or memory[-1] < 0.0
        memory[-1] = -self.settling_time / self.period if waits else 0.0
        return surprised


@compiled
def calc_measured(state: Array, watch: Watch, memory: Array) -> tuple[bool, bool]:
    """Kernel of `Watch.measure`; the memory (4 n + 4,) becomes that of this sample."""
    period, stale, n = watch.period, watch.stale_time, watch.size
    drift, counts = memory[3 * n : 4 * n], memory[4 * n :]
    counts[0] += 1.0
    counts[2:] += 1.0
    size, changed, moving = 0.0, False, False
    for i in range(2 * n):
        size += state[i] * state[i]
        changed |= state[i] != memory[i]
        moving |= i >= n and abs(state[i]) > _MOVING
    if not size < _LARGEST * _LARGEST:
        return False, False
    if not changed:
        counts[1] = counts[1] + 1.0 if moving else 0.0
        return counts[1] == 0.0 or counts[1] * period < stale, False
    gap, following, believed = counts[0] * period, np.zeros(n), True
    oldest = SUSPECT if counts[2] < counts[0] else min(stale, SUSPECT)
    for i in range(n) if gap <= oldest else range(0):
        off = state[i] - memory[i] - 0.5 * gap * (state[n + i] + memory[n + i])
        following[i] = np.exp(-gap / SUSPECT) * drift[i] + off
        believed &= not abs(following[i]) > watch.drift
    if not believed:
        counts[2] = 0.0
        return False, False
    for i in range(n):
        memory[i], memory[n + i], drift[i] = state[i], state[n + i], following[i]
    counts[0], counts[1] = 0.0, 0.0
    return True, True


@compiled
def calc_looked(
    inputs: tuple[Array, Array, Array], watch: Watch, memory: Array, motion: Array
) -> tuple[bool, bool, bool, bool]:
    """Kernel of `Watch.look`: write the five rows of `Seen`, and return its four answers."""
    (state, desired, acceleration), n = inputs, watch.size
    measured, new = calc_measured(state, watch, memory)
    last, (q, qd, q_d, v_d, a_d) = memory[2 * n : 3 * n], motion
    asked = is_usable(desired) and is_usable(acceleration)
    if asked:
        q_d[:], v_d[:], a_d[:] = desired[:n], desired[n:], acceleration
    else:
        q_d[:] = state[:n] if measured and not is_usable(last) else last
        v_d[:] = a_d[:] = 0.0
    known = is_usable(q_d)
    if known:
        last[:] = q_d
    if measured:
        q[:], qd[:] = state[:n], state[n:]
    else:
        q[:], qd[:] = q_d, v_d
    both, settled = measured and asked, memory[-2] * watch.period >= watch.settling_time
    return both and new and settled, both and not new, known, memory[-1] >= 0.0


@inlined
def is_usable(x: Array) -> bool:
    """Return whether all of x (n,) are numbers, and not absurdly large ones."""
    size = 0.0
    for i in range(len(x)):
        size += x[i] * x[i]
    return size < np.inf


@compiled
def calc_applied(effort: Array, limits: Array, applied: Array) -> tuple[bool, bool]:
    """Write efforts (n,) within limits; return whether all are finite, and whether any was not."""
    beyond = False
    for i in range(len(effort)):
        beyond |= abs(effort[i]) > limits[i]
        applied[i] = min(max(effort[i], -limits[i]), limits[i])
    return is_usable(effort), beyond


def require_single_joints(control: ControlModel) -> None:
    """Check that positions are as many as velocities, joint by joint, and that none is free."""
    if checked_control(control).floats:
        raise ArgumentError(
            "Controllers and estimators need a fixed base; this robot floats.",
            advice="Weld the base, or use geodrake.control.regressor from Python.",
        )
    if not control.single_joints:
        raise ArgumentError(
            "Controllers and estimators need joints with one degree of freedom; this robot "
            "has others.",
            advice="Weld the base, or use geodrake.control.regressor from Python.",
        )


def checked_estimate(
    control: ControlModel, domain: Manifold | UpdateLaw | None, parameters: ArrayLike | None
) -> Array:
    """Return a copy of parameters (p,) that an estimate can start from; the model's if None.

    Args:
        domain: The manifold where the estimate lives, or the law that moves it; None for neither.
    """
    given = control.prior if parameters is None else parameters
    p = real_array(given, "parameters", control.prior.shape).copy()
    if domain is None:
        return p
    if domain.dimension not in (None, len(p)):
        raise ArgumentError(
            f"The law has {domain.dimension} parameters, but the robot {len(p)}.",
            advice="Construct manifold and ControlModel from the same RobotModel.",
        )
    if not domain.contains(p):
        raise ArgumentError(
            f"These parameters are not inside the law's manifold: {p.tolist()}.",
            advice="Start from a physical estimate with positive friction.",
        )
    return p
