"""An adaptive loop whose sensors and actuators have faults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import Trajectory

from diagrams.studies.adaptive.faults import Array, Episode, FaultySensor, WeakActuators
from geodrake.control import add_adaptive_loop
from geodrake.control.systems import AdaptiveController
from geodrake.robot import RobotPorts

PLANT_STEP = 4e-3  # s, of a third-order integrator
WEAKENED = 0.15  # of the limits of efforts, what a weak actuator has


@dataclass(frozen=True)
class Moment:
    """A loop at one time.

    Attributes:
        time: s.
        error: (n,) q − q_d, rad.
        parameters: (p,) the estimate.
        effort: (n,) what the controller asks for.
    """

    time: float
    error: Array
    parameters: Array
    effort: Array


def moments(
    controller: AdaptiveController,
    plant: MultibodyPlant,
    motion: Trajectory,
    episodes: Sequence[Episode],
    *,
    limits: Array,
    end: float,
    seed: int = 0,
    period: float = 0.02,
) -> Iterator[Moment]:
    """Simulates a loop, and reports now and then; nothing is logged.

    Args:
        controller: The controller, which says how often it acts.
        plant: What is controlled, in continuous time, with an actuator at each joint in turn.
        motion: What is to be tracked.
        episodes: The faults.
        limits: (n,) limits of the efforts, N·m.
        end: When to stop, s.
        seed: Of the faults.
        period: From one moment to the next, s.
    """
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    joints = controller.control.joints
    weak = builder.AddSystem(WeakActuators(WEAKENED * limits, episodes))
    builder.Connect(weak.get_output_port(), plant.get_actuation_input_port())
    ports = RobotPorts(joints, plant.get_state_output_port(), None, weak.get_input_port())
    sensor = FaultySensor(2 * len(joints), episodes, seed=seed)
    loop = add_adaptive_loop(builder, ports, controller, motion, sensor=sensor)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    at_first = np.concatenate([motion.value(0.0).ravel(), motion.EvalDerivative(0.0).ravel()])
    plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(root), at_first)
    simulator = Simulator(diagram, root)
    config = SimulatorConfig(
        integration_scheme="runge_kutta3", max_step_size=PLANT_STEP, use_error_control=False
    )
    ApplySimulatorConfig(config, simulator)
    simulator.Initialize()
    n = len(joints)
    own = controller.GetMyContextFromRoot(root)
    for k in range(1, round(end / period) + 1):
        simulator.AdvanceTo(k * period)
        state = loop.state.Eval(loop.state.get_system().GetMyContextFromRoot(root))
        source = loop.desired_state.get_system()
        wanted = loop.desired_state.Eval(source.GetMyContextFromRoot(root))
        yield Moment(
            root.get_time(),
            (state - wanted)[:n],
            controller.parameters(own),
            loop.actuation.Eval(own),
        )
