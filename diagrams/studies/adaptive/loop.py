"""A closed loop simulated, and what is read off it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, System
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from geodrake.control import add_adaptive_loop
from geodrake.control.systems import AdaptiveController
from geodrake.effects import Effect

Array = NDArray[np.float64]

LOG_PERIOD = 1e-2  # s
PLANT_STEP = 1e-3  # s, of a third-order integrator; 1e-4 s gives the same four digits
LOST = 10.0  # rad, error of a joint at which a loop counts as unstable


@dataclass(frozen=True, eq=False)
class Record:
    """What a closed loop did, every 10 ms.

    Attributes:
        time: (N,) s.
        error: (N, n) q − q_d, rad.
        parameters: (N, p) the estimate.
        lyapunov: (N,) V; empty where the truth is not known.
        lost: Whether the loop was unstable and stopped.
    """

    time: Array
    error: Array
    parameters: Array
    lyapunov: Array
    lost: bool

    def rms(self, start: float = 0.0, end: float = np.inf) -> float:
        """RMS error of all joints between two times, degrees."""
        part = (self.time >= start) & (self.time < end)
        return float(np.degrees(np.sqrt(np.mean(self.error[part] ** 2)))) if part.any() else np.nan

    def rounds(self, period: float, count: int) -> list[float | None]:
        """RMS errors of rounds, degrees; None of those that an unstable loop did not finish."""
        ends = period * np.arange(1, count + 1)
        return [
            None if self.lost and end > self.time[-1] else self.rms(end - period, end)
            for end in ends
            if end - period < self.time[-1]
        ]

    @property
    def rise(self) -> float | None:
        """Greatest rise of V above its least value before, over V at the start."""
        if not self.lyapunov.size or self.lyapunov[0] <= 0:
            return None
        least = np.minimum.accumulate(self.lyapunov)
        return float((self.lyapunov - least).max() / self.lyapunov[0])


def simulate(
    controller: AdaptiveController,
    plant: MultibodyPlant,
    motion: Trajectory,
    *,
    effects: Sequence[tuple[Effect, ArrayLike]] = (),
    end: float | None = None,
    sensor: System | None = None,
) -> Record:
    """Simulates a loop over a whole motion, or until it is lost.

    Args:
        controller: The controller, which says how often it acts.
        plant: A finalized continuous plant, actuated at every joint.
        motion: What is to be tracked.
        effects: What acts on the plant beside rigid bodies, with parameters.
        end: When to stop, s; None for the end of the motion.
        sensor: What the controller sees the plant through; nothing if None.
    """
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    loop = add_adaptive_loop(
        builder,
        plant,
        controller,
        motion,
        effects=effects,
        log_period=LOG_PERIOD,
        sensor=sensor,
    )
    diagram = builder.Build()
    simulator = Simulator(diagram, loop.context(diagram))
    config = SimulatorConfig(
        integration_scheme="runge_kutta3",
        max_step_size=PLANT_STEP,
        use_error_control=False,
    )
    ApplySimulatorConfig(config, simulator)
    n, gone = plant.num_positions(), [False]

    def watch(root: Context) -> EventStatus:
        state = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root))
        wanted = motion.value(min(root.get_time(), motion.end_time())).ravel()
        miss = np.abs(state[:n] - wanted).max()
        gone[0] = not (np.isfinite(state).all() and miss < LOST)
        if gone[0]:
            return EventStatus.ReachedTermination(diagram, "lost")
        return EventStatus.DidNothing()

    simulator.set_monitor(watch)
    simulator.Initialize()
    simulator.AdvanceTo(motion.end_time() if end is None else end)
    time, logs = loop.logged(simulator.get_context())
    return Record(
        time=time,
        error=(logs["state"] - logs["desired_state"])[:, :n],
        parameters=logs["parameters"],
        lyapunov=logs["lyapunov"][:, 0] if "lyapunov" in logs else np.zeros(0),
        lost=gone[0],
    )


def rounds(amplitudes: Sequence[float], period: float, joints: int) -> PiecewisePolynomial:
    """All joints at q = A (cos(2π t / T) − 1), one round for every amplitude A, rad."""
    t = np.linspace(0.0, period, 101)
    still = np.zeros((joints, 1))
    whole = PiecewisePolynomial()
    for k, amplitude in enumerate(amplitudes):
        q = np.tile(amplitude * (np.cos(2.0 * np.pi * t / period) - 1.0), (joints, 1))
        part = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
            t + k * period, q, still, still
        )
        if k:
            whole.ConcatenateInTime(part)
        else:
            whole = part
    return whole
