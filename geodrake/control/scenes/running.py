"""A scenario simulated, and how well its robots followed their motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, EventStatus

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import one_line
from geodrake.boundary.whole_files import write_together
from geodrake.control.scenes.building import RobotInScene, Scene, build_scene
from geodrake.control.scenes.scenario import Scenario
from geodrake.errors import ConvergenceError
from geodrake.inertia import Array
from geodrake.logs import JointLog
from geodrake.logs.files import log_content


@dataclass(frozen=True, eq=False)
class RobotRun:
    """What a robot did.

    Attributes:
        joints: Names of its n joints.
        time: (N,) s.
        state: (N, 2 n) positions and velocities as its controller saw them, in a plant as they
            were.
        effort: (N, n) efforts, N·m or N; None if none were applied.
        desired_state: (N, 2 n) what it was to follow; None if nothing.
        parameters: (N, p) the controller's estimate; None without a controller.
    """

    joints: tuple[str, ...]
    time: Array
    state: Array
    effort: Array | None
    desired_state: Array | None
    parameters: Array | None

    @property
    def error(self) -> Array | None:
        """(N, n) q − q_d, rad or m."""
        if self.desired_state is None:
            return None
        return (self.state - self.desired_state)[:, : len(self.joints)]

    def rms(self, start: float = 0.0) -> float | None:
        """RMS of the error over all joints from a time on, rad or m."""
        if self.error is None or not (part := self.time >= start).any():
            return None
        error = self.error[part]
        known = error[np.isfinite(error).all(1)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else None

    def log(self, name: str) -> JointLog | None:
        """Return the run as a log of measurements; None without efforts."""
        if self.effort is None:
            return None
        n = len(self.joints)
        position, velocity = self.state[:, :n], self.state[:, n:]
        return JointLog(name, self.joints, self.time, position, self.effort, velocity)


@dataclass(frozen=True, eq=False)
class SceneRun:
    """What happened in a scene.

    Attributes:
        context: The Context at the end.
        robots: Model instance -> what the robot did.
    """

    scene: Scene
    context: Context
    robots: Mapping[str, RobotRun]


def run(
    *,
    scenario: Scenario,
    meshcat: Meshcat | None = None,
    monitor: Callable[[float], None] | None = None,
) -> SceneRun:
    """Simulates a scenario.

    Args:
        scenario: What there is, and what happens.
        meshcat: Where to draw it; nowhere if None.
        monitor: Told the time, s, after every step.

    Raises:
        GeodrakeError: As `build_scene`.
        ConvergenceError: The simulation cannot go on.
    """
    scene = build_scene(scenario=scenario, meshcat=meshcat)
    simulator = Simulator(scene.diagram, scene.context())
    ApplySimulatorConfig(scenario.simulator_config, simulator)

    def watch(root: Context) -> EventStatus:
        if monitor is not None:
            monitor(root.get_time())
        return EventStatus.DidNothing()

    simulator.set_monitor(watch)
    try:
        simulator.Initialize()
        simulator.AdvanceTo(scenario.simulation_duration)
    except (RuntimeError, SystemExit) as error:
        time = simulator.get_context().get_time()
        raise ConvergenceError(
            f"The simulation ends at {time:g} s: {one_line(error)}.",
            advice="Choose smaller steps, other gains, or wait longer for messages.",
        ) from error
    context = simulator.get_context()
    found = {name: _ran(robot, context) for name, robot in scene.robots.items()}
    robots = {name: each for name, each in found.items() if each is not None}
    return SceneRun(scene, context, robots)


def _ran(robot: RobotInScene, context: Context) -> RobotRun | None:
    """Return what was logged of a robot; None of one that nothing is asked of."""
    sinks = {name: sink.FindLog(context) for name, sink in robot.logs.items()}
    own = {name: np.array(log.data().T) for name, log in sinks.items()}
    loop = dict[str, Array]()
    if robot.loop is not None:
        time, loop = robot.loop.logged(context)
    elif sinks:
        time = np.array(next(iter(sinks.values())).sample_times())
    else:
        return None
    return RobotRun(
        robot.joints,
        time,
        own["state"] if "state" in own else loop["state"],
        own.get("effort", loop.get("actuation")),
        loop.get("desired_state"),
        loop.get("parameters"),
    )


@typed
def write_logs(done: SceneRun) -> tuple[Path, ...]:
    """Writes the logs that the scenario asks for.

    Returns:
        The files.

    Raises:
        OutputError: One cannot be written.
    """
    contents = {}
    for name, spec in done.scene.scenario.robots.items():
        log = done.robots[name].log(name) if spec.log and name in done.robots else None
        if log is not None:
            contents[Path(spec.log)] = log_content(log, spec.log)
    write_together(contents)
    return tuple(contents)
