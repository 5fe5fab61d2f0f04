"""Safeguards of online systems: checks of arguments, monitoring of inputs, limits of efforts."""

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

_MOVING = 1e-4  # rad/s or m/s, speed above which an unchanged measurement is stale
_LARGEST = 1e6  # rad, m, rad/s or m/s, bound of the norm of a plausible state
SUSPECT = 0.25  # s, time constant of the drift, and time after which a loop is trusted


@dataclass(frozen=True, eq=False)
class Safeguards(Short):
    """Limits of a controller.

    Attributes:
        effort_limits: (nv,) effort limits, N·m or N; None for no limits.
        stale_time: Time, s, after which a state that is exactly constant, although its velocities
            are nonzero, counts as missing; inf for never.
        dead_zone: Scalar or (nv,) tracking error |r|, rad/s or m/s, due to velocity noise.
            Adaptation by this error pauses while all joints are within it.
        drift: Largest deviation, rad or m, of positions from integrated velocities within a quarter
            of a second; several times the position noise. States beyond it are rejected. inf to
            accept all.
        settling_time: Time, s, without rejected states or saturated efforts before adaptation
            resumes.
        factor: Bound of an estimate, as a multiple of the model's parameters or the first estimate,
            see `adaptation.outer_laws.limited`; inf for no limits.
    """

    effort_limits: ArrayLike | None = None
    stale_time: float = 0.05
    dead_zone: ArrayLike = 0.0
    drift: float = 0.02
    settling_time: float = 1.0
    factor: float = 10.0

    def __post_init__(self) -> None:
        for name, least in (("stale_time", 0.0), ("drift", 0.0), ("factor", 1.0)):
            if not number(value := getattr(self, name), name, finite=False) > least:
                raise ArgumentError(f"{name} must be above {least:g}; got {value}.")
        number(self.settling_time, "settling_time", lower=0.0)
        self.dead_zones(real_array(self.dead_zone, "dead_zone").size)
        if self.effort_limits is not None:
            self.limits(real_array(self.effort_limits, "effort_limits", finite=False).size)

    @classmethod
    def of_plant(cls, plant: MultibodyPlant, *, stale_time: float = 0.05) -> Safeguards:
        """Return safeguards with the effort limits of a plant's actuators."""
        check_plant(plant)
        limits = np.full(plant.num_velocities(), np.inf)
        for index in range(plant.num_actuators()):
            actuator = plant.get_joint_actuator(JointActuatorIndex(index))
            limits[actuator.joint().velocity_start()] = actuator.effort_limit()
        return cls(limits, stale_time)

    def limits(self, nv: int) -> Array:
        """Return the effort limits (nv,), checked; infinite for no limit."""
        limits = np.inf if self.effort_limits is None else self.effort_limits
        return one_or_each(limits, "effort_limits", nv, strict=True, finite=False)

    def dead_zones(self, nv: int) -> Array:
        """Return the dead zone (nv,), checked."""
        return one_or_each(self.dead_zone, "dead_zone", nv)


class Observation(NamedTuple):
    """State and desired motion that a controller uses at one sample, always finite."""

    q: Array  # (n,) positions
    qd: Array  # (n,) velocities
    q_d: Array  # (n,) desired positions
    v_d: Array  # (n,) desired velocities
    a_d: Array  # (n,) desired accelerations
    trusted: bool  # whether state and desired motion are new, valid, and have been plausible
    repeated: bool  # whether they are valid but the state is the last one again
    known: bool  # whether any valid position is available
    settled: bool  # whether the loop has had no interruption for the settling time

    def within_reach(self, rate: Array, braking: Array) -> Observation:
        """Return the observation with a desired motion that is approached at a brakable speed.

        An error e = q − q_d decreases by ė = −s(e). s is λ e near zero, and farther away the speed
        that a deceleration a can stop within the distance, √(2 a (|e| − a / 2 λ²)), with the rate λ
        (n,), 1/s, and the deceleration a (n,), rad/s² or m/s².
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


class InputMonitor(NamedTuple):
    """Monitors the inputs of a controller or estimator, and replaces missing ones.

    A state counts as missing if it is not finite, has been constant for too long, or contradicts
    the previous ones: positions drift from integrated velocities by more than `drift`,

        d ← exp(−h/τ) d + q − q⁻ − h (q̇ + q̇⁻)/2,   τ = 0.25 s

    The first state after `stale_time` without any, or after 0.25 s of contradictions, is accepted
    unconditionally.

    A missing state is replaced by the desired one, which yields feedforward by the model. A missing
    desired motion is replaced by rest at the last desired position, or the measured one.

    The memory contains the last measured state, the last desired position, the drift, and four
    counts of samples: without a new state, with a constant state of a moving robot, without a
    contradiction, and since the last call of `interrupt`. The last one is negative while
    adaptation is paused.
    """

    size: int  # number n of positions and of velocities
    period: float = 0.0  # sampling period, s; zero without memory
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
        """Return whether a state (2 n,) is accepted and whether it is new; update the memory."""
        return calc_measured(contiguous(state), self, memory)

    def observe(
        self, memory: Array, state: Array, desired: Array, acceleration: Array
    ) -> tuple[Observation, Array]:
        """Return the observation for states (2 n,), and the memory after the sample."""
        memory, motion = memory.copy(), np.empty((5, self.size))
        inputs = contiguous(state), contiguous(desired), contiguous(acceleration)
        q, qd, q_d, v_d, a_d = motion
        flags = calc_observed(inputs, self, memory, motion)
        return Observation(q, qd, q_d, v_d, a_d, *flags), memory

    def interrupt(self, memory: Array) -> bool:
        """Record a fault; return whether it interrupts a loop without faults for 0.25 s.

        Adaptation then pauses until there has been no fault for the settling time. A fault shortly
        after the start of a loop does not pause it.
        """
        is_new = self.settling_time > 0 and memory[-1] * self.period >= SUSPECT
        is_paused = is_new or memory[-1] < 0.0
        memory[-1] = -self.settling_time / self.period if is_paused else 0.0
        return is_new


@compiled
def calc_measured(state: Array, monitor: InputMonitor, memory: Array) -> tuple[bool, bool]:
    """Kernel of `InputMonitor.measure`; updates the memory (4 n + 4,)."""
    period, stale_time, n = monitor.period, monitor.stale_time, monitor.size
    drift, counts = memory[3 * n : 4 * n], memory[4 * n :]
    counts[0] += 1.0
    counts[2:] += 1.0
    square, changed, moving = 0.0, False, False
    for i in range(2 * n):
        square += state[i] * state[i]
        changed |= state[i] != memory[i]
        moving |= i >= n and abs(state[i]) > _MOVING
    if not square < _LARGEST * _LARGEST:
        return False, False
    if not changed:
        counts[1] = counts[1] + 1.0 if moving else 0.0
        return counts[1] == 0.0 or counts[1] * period < stale_time, False
    gap, new_drift, plausible = counts[0] * period, np.zeros(n), True
    longest = SUSPECT if counts[2] < counts[0] else min(stale_time, SUSPECT)
    for i in range(n) if gap <= longest else range(0):
        offset = state[i] - memory[i] - 0.5 * gap * (state[n + i] + memory[n + i])
        new_drift[i] = np.exp(-gap / SUSPECT) * drift[i] + offset
        plausible &= not abs(new_drift[i]) > monitor.drift
    if not plausible:
        counts[2] = 0.0
        return False, False
    for i in range(n):
        memory[i], memory[n + i], drift[i] = state[i], state[n + i], new_drift[i]
    counts[0], counts[1] = 0.0, 0.0
    return True, True


@compiled
def calc_observed(
    inputs: tuple[Array, Array, Array], monitor: InputMonitor, memory: Array, motion: Array
) -> tuple[bool, bool, bool, bool]:
    """Kernel of `InputMonitor.observe`: write the rows of `Observation`, and return its flags."""
    (state, desired, acceleration), n = inputs, monitor.size
    measured, new = calc_measured(state, monitor, memory)
    last_desired, (q, qd, q_d, v_d, a_d) = memory[2 * n : 3 * n], motion
    has_desired = is_usable(desired) and is_usable(acceleration)
    if has_desired:
        q_d[:], v_d[:], a_d[:] = desired[:n], desired[n:], acceleration
    else:
        q_d[:] = state[:n] if measured and not is_usable(last_desired) else last_desired
        v_d[:] = a_d[:] = 0.0
    known = is_usable(q_d)
    if known:
        last_desired[:] = q_d
    if measured:
        q[:], qd[:] = state[:n], state[n:]
    else:
        q[:], qd[:] = q_d, v_d
    valid = measured and has_desired
    plausible = memory[-2] * monitor.period >= monitor.settling_time
    return valid and new and plausible, valid and not new, known, memory[-1] >= 0.0


@inlined
def is_usable(x: Array) -> bool:
    """Return whether x (n,) is finite, without overflow of its squared norm."""
    square = 0.0
    for i in range(len(x)):
        square += x[i] * x[i]
    return square < np.inf


@compiled
def calc_applied(effort: Array, limits: Array, applied: Array) -> tuple[bool, bool]:
    """Write efforts (n,) clipped to limits; return whether all are finite, and any was clipped."""
    clipped = False
    for i in range(len(effort)):
        clipped |= abs(effort[i]) > limits[i]
        applied[i] = min(max(effort[i], -limits[i]), limits[i])
    return is_usable(effort), clipped


def require_single_joints(control: ControlModel) -> None:
    """Check that the base is fixed, and that every joint has one degree of freedom."""
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
    """Return a checked copy of an initial estimate (p,); the model's parameters if None.

    Args:
        domain: Manifold or law that must contain the estimate, if any.
    """
    values = control.prior if parameters is None else parameters
    p = real_array(values, "parameters", control.prior.shape).copy()
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
