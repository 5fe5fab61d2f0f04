"""Sensors and actuators that have faults for a while, and an adaptive loop with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    LeafSystem,
)
from pydrake.trajectories import Trajectory

from diagrams.studies.adaptive.loop import Record, simulate_loop
from geodrake.control import AdaptiveController, add_adaptive_loop
from geodrake.inertia import Array
from geodrake.robot import RobotPorts

PERIOD = 2e-3  # s, between samples of a sensor
DELAY = 10  # samples
NOISE = 0.05  # rad, and rad/s


@dataclass(frozen=True)
class Sample:
    """The state and its past, from which a faulty sensor makes its value."""

    true: Array  # (2 n,) the state
    earlier: Array  # (2 n,) the state of `DELAY` samples before
    held: Array  # (2 n,) the last state before the fault
    number: int
    rng: np.random.Generator

    def one(self) -> int:
        """Return a random component of the state."""
        return int(self.rng.integers(len(self.true)))

    def often(self, every: int, length: int = 1) -> bool:
        """Return whether a sample is one of the first `length` of `every`."""
        return self.number % every < length


def _put(sample: Sample, place: int, value: float) -> Array:
    changed = sample.true.copy()
    changed[place] = value
    return changed


def _frozen_positions(sample: Sample) -> Array:
    if not sample.often(100, 25):
        return sample.true
    half = len(sample.true) // 2
    return np.concatenate([np.full(half, 0.1), sample.true[half:]])


def _stuck(sample: Sample) -> Array:
    last = len(sample.true) // 2 - 1
    return _put(sample, last, sample.held[last])


SENSOR_FAULTS: dict[str, Callable[[Sample], Array]] = {
    # Gaussian, on positions and velocities
    "noise": lambda s: s.true + NOISE * s.rng.normal(size=len(s.true)),
    # one value of every eighth sample is 1e12
    "huge": lambda s: _put(s, s.one(), 1e12) if s.often(8) else s.true,
    # the first position of every tenth sample is a turn off
    "turns": lambda s: _put(s, 0, s.true[0] + 2.0 * np.pi) if s.often(10) else s.true,
    # no samples at all for two thirds of the time, 100 ms each
    "dropped": lambda s: np.full(len(s.true), np.nan) if s.often(75, 50) else s.true,
    # the last state before the fault
    "frozen": lambda s: s.held,
    # positions that are 0.1 rad for 50 ms of every 200, with velocities as they are
    "frozen positions": _frozen_positions,
    # one value of every third sample is NaN
    "not numbers": lambda s: _put(s, s.one(), np.nan) if s.often(3) else s.true,
    # every fifth sample has the wrong sign
    "flips": lambda s: -s.true if s.often(5) else s.true,
    # the first joint is measured in the other direction
    "reversed joint": lambda s: (
        s.true * np.where(np.arange(len(s.true)) % (len(s.true) // 2), 1, -1)
    ),
    # the encoder of the last joint says what it said; velocities are as they are
    "stuck": _stuck,
    # the state of 20 ms before
    "delayed": lambda s: s.earlier,
}
WEAK = "weak actuators"
FAULTS = (*SENSOR_FAULTS, WEAK)
"""Names of all faults."""


@dataclass(frozen=True)
class Episode:
    """A fault for a while."""

    fault: str | Callable[[Sample], Array]
    start: float
    end: float


class FaultySensor(LeafSystem):
    """Sensor of a state, with a fault during each episode."""

    def __init__(self, size: int, episodes: Sequence[Episode], *, seed: int) -> None:
        LeafSystem.__init__(self)
        self._episodes = [each for each in episodes if each.fault != WEAK]
        self._seed = seed
        self._state = self.DeclareVectorInputPort("state", BasicVector(size))
        self._held = self.DeclareDiscreteState(size)
        self._buffer = self.DeclareDiscreteState(size * (DELAY + 1))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._keep)
        self.DeclareVectorOutputPort("measured_state", BasicVector(size), self._measure)

    def _now(self, context: Context) -> Episode | None:
        t = context.get_time() + 1e-9
        return next((each for each in self._episodes if each.start <= t < each.end), None)

    def _keep(self, context: Context, values: DiscreteValues) -> None:
        state = self._state.Eval(context)
        buffer = context.get_discrete_state(self._buffer).value()
        values.set_value(self._buffer, np.concatenate([buffer[len(state) :], state]))
        if self._now(context) is None:
            values.set_value(self._held, state)

    def _measure(self, context: Context, output: BasicVector) -> None:
        state, episode = self._state.Eval(context), self._now(context)
        if episode is not None:
            number = round(context.get_time() / PERIOD)
            sample = Sample(
                state,
                context.get_discrete_state(self._buffer).value()[: len(state)],
                context.get_discrete_state(self._held).value(),
                number,
                np.random.default_rng([self._seed, number]),
            )
            known = isinstance(episode.fault, str)
            state = (SENSOR_FAULTS[episode.fault] if known else episode.fault)(sample)
        output.SetFromVector(state)


class WeakActuators(LeafSystem):
    """Actuators that lose most of their strength during episodes, unknown to controllers."""

    def __init__(self, limits: Array, episodes: Sequence[Episode]) -> None:
        """Construct the system with the remaining limits (n,) of efforts, N·m."""
        LeafSystem.__init__(self)
        self._limits = limits
        self._episodes = [each for each in episodes if each.fault == WEAK]
        self._wanted = self.DeclareVectorInputPort("wanted", BasicVector(len(limits)))
        self.DeclareVectorOutputPort("effort", BasicVector(len(limits)), self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        effort, t = self._wanted.Eval(context), context.get_time() + 1e-9
        if any(each.start <= t < each.end for each in self._episodes):
            effort = np.clip(effort, -self._limits, self._limits)
        output.SetFromVector(effort)


class NoisyVelocities(LeafSystem):
    """Exact positions, and velocities with white noise that is held for a millisecond."""

    def __init__(self, size: int, deviation: float, *, duration: float, seed: int) -> None:
        """Construct the system with a standard deviation of the noise, rad/s."""
        LeafSystem.__init__(self)
        rng = np.random.default_rng([seed, 58])
        self._noise = rng.normal(0.0, deviation, (round(1e3 * duration), size))
        self._size = size
        self._state = self.DeclareVectorInputPort("state", BasicVector(2 * size))
        self.DeclareVectorOutputPort("measured_state", BasicVector(2 * size), self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state = self._state.Eval(context).copy()
        sample = int(round(1e3 * context.get_time(), 6)) % len(self._noise)
        state[self._size :] += self._noise[sample]
        output.SetFromVector(state)


PLANT_STEP, LOGGED = 4e-3, 0.05  # s, steps of a third-order integrator, and between those logged
WEAKENED = 0.15  # of the limits of efforts, what a weak actuator has


def faulty_loop(
    controller: AdaptiveController,
    plant: MultibodyPlant,
    motion: Trajectory,
    episodes: Sequence[Episode],
    *,
    limits: Array,
    end: float,
    seed: int = 0,
    seen: Callable[[], object] | None = None,
) -> Record:
    """Simulate a loop with faults in continuous time, logged; call `seen` every ten seconds.

    The plant has an actuator at each joint in turn, with limits (n,) of the efforts, N·m.
    """
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    joints = controller.control.joints
    weak = builder.AddSystem(WeakActuators(WEAKENED * limits, episodes))
    builder.Connect(weak.get_output_port(), plant.get_actuation_input_port())
    ports = RobotPorts(joints, plant.get_state_output_port(), None, weak.get_input_port())
    how = {"sensor": FaultySensor(2 * len(joints), episodes, seed=seed), "log_period": LOGGED}
    loop = add_adaptive_loop(builder, ports, controller, motion, **how)
    return simulate_loop(builder, loop, plant, motion, end, step=PLANT_STEP, seen=seen)
