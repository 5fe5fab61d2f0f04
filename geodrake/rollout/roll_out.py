"""Rollouts: the model simulated under the measured efforts, held against the measured motion.

Where `geodrake.diagnosis.compare` asks which effort a motion needs, a rollout asks which motion an
effort makes. Every window of a log starts at the measured state; from there on the simulated robot
is alone with the efforts that were logged, until the window ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import Adder, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from geodrake.diagnosis.case import Case, open_case
from geodrake.effects import EffortDelay
from geodrake.errors import ArgumentError, LogError
from geodrake.held_payloads import holding
from geodrake.identification.reduce import peak_speeds
from geodrake.model import RobotModel
from geodrake.motion import JointLog, Segment
from geodrake.plant import load_plant, set_inertial_parameters
from geodrake.systems import EffectForce

Array = NDArray[np.float64]

HORIZON = 0.5
"""Length of a window, s."""

MOST_WINDOWS = 12
"""Windows that are simulated, spread evenly over the logs."""

_LARGEST_STEP = 5e-3  # of the integrator, s
_ACCURACY = 1e-3
_STIFF = 4e3  # rate of decay from which on an implicit integrator is the faster one, 1/s
_SIGN_WIDTH = 5e-3  # share of a joint's peak speed below which dry friction fades
_MOVING = 0.05  # share of the peak speeds that the mean speed of a window must have


@dataclass(frozen=True, eq=False)
class Window:
    """One simulated stretch of a log.

    Attributes:
        log: Name of the log.
        time: (K,) instants, s.
        measured: (K, nv) positions, rad or m.
        simulated: (K, nv) positions; NaN from where the simulation broke off.
    """

    log: str
    time: Array
    measured: Array
    simulated: Array

    @property
    def departure(self) -> Array:
        """(K, nv) simulated − measured position."""
        return self.simulated - self.measured


@dataclass(frozen=True)
class JointDeparture:
    """How far one joint departs from what was measured.

    Attributes:
        joint: Name of the joint.
        rms: RMS of simulated − measured position over all windows, rad or m.
        moved: RMS of what the joint moved since the start of its window, rad or m.
        worst: Log and start of the window in which it departs most, s.
    """

    joint: str
    rms: float
    moved: float
    worst: tuple[str, float]

    @property
    def relative(self) -> float:
        """RMS departure over RMS motion: 1 for a robot that stands still."""
        return self.rms / self.moved if self.moved > 0 else np.inf


@dataclass(frozen=True, eq=False)
class Rollout:
    """A model simulated under measured efforts.

    Attributes:
        joints: Departures of every joint.
        windows: What was simulated.
        horizon: Length of the windows, s.
        broken: Windows in which the simulation could not go on to the end.
    """

    joints: tuple[JointDeparture, ...]
    windows: tuple[Window, ...]
    horizon: float
    broken: int

    @property
    def relative(self) -> float:
        """Root mean square over joints of departure over motion."""
        return float(np.sqrt(np.mean([joint.relative**2 for joint in self.joints])))


Progress = Callable[[str, float], None]


def roll_out(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    horizon: float = HORIZON,
    most: int = MOST_WINDOWS,
    bandwidth: float | None = None,
    progress: Progress | None = None,
) -> Rollout:
    """Simulate a model under the efforts of logs, window by window.

    The simulation is a Drake diagram: the plant with the model's inertias, `EffectForce` with its
    effects, and the measured efforts, advanced by the model's delay.

    Args:
        model: The model.
        logs: Logs or their files.
        horizon: Length of a window, s.
        most: Most windows; they are spread evenly over all that moves.
        bandwidth: Bandwidth of the filter that the initial states are smoothed with, Hz; by default
            chosen from the data.
        progress: Told about each window: its log, and the share that is done.

    Raises:
        ArgumentError: A setting is not positive.
        LogError: A log cannot be used, or none moves for as long as a window.
    """
    if not (0.0 < horizon < np.inf and most >= 1):
        raise ArgumentError(
            f"A rollout needs a horizon above 0 s and a window at least; it got {horizon} s and "
            f"{most}."
        )
    case = open_case(model, logs, candidates=False, bandwidth=bandwidth)
    stretches = _stretches(case, horizon)
    chosen = np.unique(np.linspace(0, len(stretches) - 1, most).round().astype(int))
    least = _SIGN_WIDTH * np.maximum(peak_speeds(case.trajectories), 1e-3)
    width, held = model.sign_widths(least), {t.name: t.payloads for t in case.trajectories}
    simulations = {load: _Simulation(holding(model, load), width) for load in set(held.values())}
    windows = []
    for count, k in enumerate(chosen):
        log, segment = stretches[k]
        if progress is not None:
            progress(f"{log} {segment.time[0]:.1f} s", count / len(chosen))
        positions = simulations[held[log]].positions(segment)
        windows.append(Window(log, segment.time, segment.position, positions))
    return _rollout(model, windows, horizon)


def _rollout(model: RobotModel, windows: Sequence[Window], horizon: float) -> Rollout:
    departures = [np.nan_to_num(w.departure, nan=np.inf) for w in windows]
    squares = np.array([np.mean(np.square(d), 0) for d in departures])
    moved = np.array([np.mean(np.square(w.measured - w.measured[0]), 0) for w in windows])
    joints = []
    for j, joint in enumerate(model.joints):
        worst = windows[int(np.argmax(squares[:, j]))]
        joints.append(
            JointDeparture(
                joint,
                float(np.sqrt(squares[:, j].mean())),
                float(np.sqrt(moved[:, j].mean())),
                (worst.log, float(worst.time[0])),
            )
        )
    broken = sum(bool(np.isnan(w.simulated).any()) for w in windows)
    return Rollout(tuple(joints), tuple(windows), horizon, broken)


def _stretches(case: Case, horizon: float) -> list[tuple[str, Segment]]:
    """Stretches of a length in which the robot moves, with the names of their logs."""
    peak = peak_speeds(case.trajectories)
    delay = case.model.delay
    found = []
    for trajectory in case.trajectories:
        for stretch in trajectory.segments:
            count = round(horizon / stretch.period) + 1
            ahead = round(abs(delay) / stretch.period) + 1
            for start in range(ahead, len(stretch) - count - ahead, count):
                near = stretch[start - ahead : start + count + ahead]
                inner = near[ahead : ahead + count]
                speed = np.abs(inner.velocity) / np.maximum(peak, 1e-300)
                if speed.mean(0).max() > _MOVING:
                    effort = EffortDelay(-delay).delayed(near.effort, stretch.period)
                    found.append((trajectory.name, replace(inner, effort=effort[ahead:][:count])))
    if not found:
        raise LogError(
            f"In no log does the robot move for {horizon:g} s without a gap.",
            advice="Give a shorter horizon, or a longer log.",
        )
    return found


class _Simulation:
    """The diagram: measured efforts, effects, and the plant."""

    def __init__(self, model: RobotModel, sign_width: Array) -> None:
        self._model = model
        builder = DiagramBuilder()
        self._plant = builder.AddSystem(load_plant(model.path, floating=model.floating).plant)
        effects = [
            (fitted.effect, fitted.parameters)
            for fitted in model.effects
            if fitted.effect.is_force and fitted.effect.name != "payload"
        ]
        force = builder.AddSystem(
            EffectForce(self._plant, effects, sign_width=sign_width, phi=model.total_phi)
        )
        nv = len(model.joints)
        self._effort = builder.AddSystem(TrajectorySource(PiecewisePolynomial(np.zeros(nv))))
        total = builder.AddSystem(Adder(2, nv))
        builder.Connect(self._plant.get_state_output_port(), force.GetInputPort("state"))
        builder.Connect(self._effort.get_output_port(), force.GetInputPort("applied_effort"))
        builder.Connect(self._effort.get_output_port(), total.get_input_port(0))
        builder.Connect(force.GetOutputPort("generalized_force"), total.get_input_port(1))
        builder.Connect(
            total.get_output_port(), self._plant.get_applied_generalized_force_input_port()
        )
        self._diagram = builder.Build()
        # Where the position of each velocity stands.
        places = model.positions(np.arange(nv, dtype=float)[None])[0]
        self._order = np.argsort(places)

    def positions(self, segment: Segment) -> Array:
        """(K, nv) positions from a segment's first state on, under its efforts."""
        time = segment.time - segment.time[0]
        self._effort.UpdateTrajectory(
            PiecewisePolynomial.FirstOrderHold(time, np.asarray(segment.effort).T)
        )
        simulator = Simulator(self._diagram)
        context = self._plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        set_inertial_parameters(self._plant, context, self._model.total_phi)
        self._plant.SetPositions(context, self._model.positions(segment.position[:1])[0])
        scheme = "radau3" if self._decay(context) > _STIFF else "runge_kutta3"
        self._plant.SetVelocities(context, segment.velocity[0])
        ResetIntegratorFromFlags(simulator, scheme, _LARGEST_STEP)
        simulator.get_mutable_integrator().set_target_accuracy(_ACCURACY)
        simulator.Initialize()
        simulated = np.full(segment.position.shape, np.nan)
        for k, instant in enumerate(time):
            try:
                simulator.AdvanceTo(instant)
            except RuntimeError:  # the integrator gives up: the robot flies apart
                break
            simulated[k] = self._plant.GetPositions(context)[self._order]
        return simulated

    def _decay(self, context: Context) -> float:
        """The fastest rate, 1/s, at which velocities near rest decay by friction."""
        nv = self._plant.num_velocities()
        port = self._plant.get_generalized_acceleration_output_port()
        slopes = []
        for change in 1e-6 * np.vstack([np.zeros(nv), np.eye(nv)]):
            self._plant.SetVelocities(context, change)
            slopes.append(port.Eval(context))
        slope = (np.array(slopes[1:]) - slopes[0]).T / 1e-6
        return float(np.abs(np.linalg.eigvals(slope)).max())
