"""A closed loop simulated, and what is read off it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, System
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from geodrake.control import AdaptiveController, AdaptiveLoop, add_adaptive_loop
from geodrake.inertia import Array

LOG_PERIOD = 1e-2  # s
_SHOWN = 5  # logged samples between those of time series
SHOWN_PERIOD = _SHOWN * LOG_PERIOD  # s
SIMULATION = SimulatorConfig(
    integration_scheme="runge_kutta3",
    max_step_size=1e-3,  # s; 1e-4 s gives the same four digits
    use_error_control=False,
)
LOST = 10.0  # rad, error of a joint at which a loop counts as unstable


def timed(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows with the times of their series, s."""
    return [
        {**row, "time": [SHOWN_PERIOD * k for k, _ in enumerate(row["series"])]} for row in rows
    ]


@dataclass(frozen=True, eq=False)
class Record:
    """Record of a closed loop, every 10 ms."""

    time: Array  # (N,) s
    error: Array  # (N, n) q − q_d, rad
    parameters: Array  # (N, p) the estimate
    lyapunov: Array  # (N,) V; empty where the truth is not known
    lost: bool  # whether the loop was unstable and stopped

    def rms(self, start: float = 0.0, end: float = np.inf) -> float:
        """Return RMS error of all joints between two times, degrees."""
        part = (self.time >= start) & (self.time < end)
        return float(np.degrees(np.sqrt(np.mean(self.error[part] ** 2)))) if part.any() else np.nan

    def told(self, draw: Any, controller: AdaptiveController) -> dict[str, Any]:
        """Return law and speed of a draw, its error, and whether V rose or the loop was lost."""
        rise = None if controller.law is None else self.rise
        own = {"law": draw.law, "speed": draw.speed, "rms": self.rms()}
        return {**own, "rise": rise, "lost": self.lost}

    @property
    def series(self) -> list[float]:
        """RMS errors of all joints every `SHOWN_PERIOD`, degrees."""
        error = self.error[::_SHOWN]
        return np.degrees(np.sqrt(np.mean(error**2, axis=1))).round(5).tolist()

    def rounds(self, period: float, count: int) -> list[float | None]:
        """Return RMS errors of rounds, degrees; None of those that a lost loop did not finish."""
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
    end: float | None = None,
    sensor: System | None = None,
) -> Record:
    """Simulate a loop until `end`, s, or the end of the motion, or until it is lost.

    The controller receives the state of the plant from `sensor`, if there is one.
    """
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    how = {"log_period": LOG_PERIOD, "sensor": sensor}
    loop = add_adaptive_loop(builder, plant, controller, motion, **how)
    return simulate_loop(builder, loop, plant, motion, end)


def simulate_loop(
    builder: DiagramBuilder,
    loop: AdaptiveLoop,
    plant: MultibodyPlant,
    motion: Trajectory,
    end: float | None,
    *,
    joints: Array | None = None,
    step: float | None = None,
    seen: Callable[[], object] | None = None,
) -> Record:
    """Simulate a logged loop.

    Args:
        joints: (nq, n) map of the motion to the plant's joints; None for the identity.
        step: Step of a loop whose plant has faults, s, which continues when it is lost.
        seen: Function that is called every ten seconds.
    """
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    if loop.robot is not None:
        loop.set_start(root)
    elif step is not None:
        at_first = np.vstack([motion.value(0.0), motion.EvalDerivative(0.0)])
        plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(root), at_first)
    simulator = Simulator(diagram, root)
    ApplySimulatorConfig(SIMULATION, simulator)
    J, gone = np.eye(motion.rows()) if joints is None else joints, [False]

    def watch(root: Context) -> EventStatus:
        state = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root))
        wanted = J @ motion.value(min(root.get_time(), motion.end_time())).ravel()
        miss = np.abs(state[: len(J)] - wanted).max()
        gone[0] = not (np.isfinite(state).all() and miss < LOST)
        if gone[0]:
            return EventStatus.ReachedTermination(diagram, "lost")
        return EventStatus.DidNothing()

    if step is None:
        simulator.set_monitor(watch)
    else:
        simulator.get_mutable_integrator().set_maximum_step_size(step)
    simulator.Initialize()
    last = motion.end_time() if end is None else end
    for stop in (*np.arange(10.0, last, 10.0), last) if seen else (last,):
        simulator.AdvanceTo(stop)
        if seen:
            seen()
    time, logs = loop.logged(simulator.get_context())
    return Record(
        time=time,
        error=(logs["state"] - logs["desired_state"])[:, : motion.rows()],
        parameters=logs["parameters"],
        lyapunov=logs["lyapunov"][:, 0] if "lyapunov" in logs else np.zeros(0),
        lost=gone[0],
    )


def on_its_base(path: Path, base: str, plant: MultibodyPlant, *, damping: float = 0.0) -> None:
    """Put a robot on its base into a plant, with an actuator and viscous friction at each joint."""
    Parser(plant).AddModels(str(path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(base))
    for index in plant.GetJointIndices():
        joint = plant.get_mutable_joint(index)
        if joint.num_velocities() == 1:
            joint.set_default_damping_vector([damping])
            if not plant.HasJointActuatorNamed(joint.name()):
                plant.AddJointActuator(joint.name(), joint)


def resting(parts: Iterable[tuple[Array, Array]]) -> PiecewisePolynomial:
    """Join splines, of times and positions (n, k) each, that rest at their ends."""
    whole = PiecewisePolynomial()
    for k, (time, q) in enumerate(parts):
        still = np.zeros((len(q), 1))
        part = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(time, q, still, still)
        if k:
            whole.ConcatenateInTime(part)
        else:
            whole = part
    return whole


def rounds(amplitudes: Sequence[float], period: float, joints: int) -> PiecewisePolynomial:
    """Return all joints at q = A (cos(2π t / T) − 1), one round for every amplitude A, rad."""
    t = np.linspace(0.0, period, 101)
    wave = np.cos(2.0 * np.pi * t / period) - 1.0
    return resting(
        (t + k * period, np.tile(amplitude * wave, (joints, 1)))
        for k, amplitude in enumerate(amplitudes)
    )
