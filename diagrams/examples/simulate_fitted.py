"""Simulated robots under one controller: do they need the efforts that the real one needed?

`explain` finds a payload and friction in the demo's log. Three robots then stand in one Drake
diagram: that of the model file, one with the fitted bodies and the payload but without friction,
and the fitted one. Each follows the logged motion by computed torque on the fitted bodies, so by
feedback where it has other ones, or friction; its efforts are compared with the log's.

    python -m diagrams.examples.simulate_fitted --json simulate_fitted.json --figures figures
"""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import InverseDynamicsController
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from diagrams.harness import chart, first_samples, script_parser, show, write
from geodrake import load_model
from geodrake.diagnosis import explain
from geodrake.effects import Role
from geodrake.logs import JointLog
from geodrake.logs.files import read_log
from geodrake.model import RobotModel

Array = NDArray[np.float64]

DEMO = Path(str(files("geodrake") / "demo"))
FILE, BODIES, FITTED = "model file", "fitted bodies", "fitted, with friction"
KNOT = 0.04  # s between those of the motion that is followed
BANDWIDTH = 60.0  # of the controller, rad/s
SETTLED = 0.2  # s from the start on that are not compared


def robots(log: JointLog) -> dict[str, RobotModel]:
    """The model of the file, and what `explain` makes of it, without friction and with it."""
    model = load_model(DEMO / "demo.urdf")
    found = explain(model, [log]).model
    payloads = tuple(f for f in found.effects if f.effect.role is Role.BODY)
    return {FILE: model, BODIES: replace(found, effects=payloads), FITTED: found}


def simulate(models: dict[str, RobotModel], log: JointLog, seconds: float) -> dict[str, Array]:
    """Efforts (K, nv) of each robot at the first instants of the log, while it follows it."""
    builder = DiagramBuilder()
    period = float(np.median(np.diff(log.time)))
    knots = slice(None, None, round(KNOT / period))
    time, positions = log.time[knots] - log.time[0], log.position[knots].T
    motion = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(time, positions)
    desired = builder.AddSystem(TrajectorySource(motion, output_derivative_order=1))
    placed = {name: model.add_to_builder(builder, name=name) for name, model in models.items()}
    known = placed[FITTED].plant  # whose inertias are the fitted ones
    logs = {}
    for name, robot in placed.items():
        ones = np.ones(known.num_velocities())
        gains = BANDWIDTH**2 * ones, 0.0 * ones, 2.0 * BANDWIDTH * ones
        controller = builder.AddSystem(InverseDynamicsController(known, *gains, False))
        builder.Connect(desired.get_output_port(), controller.get_input_port_desired_state())
        builder.Connect(robot.state, controller.get_input_port_estimated_state())
        builder.Connect(controller.get_output_port_control(), robot.effort)
        logs[name] = LogVectorOutput(robot.logged_effort, builder, period)
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    for robot in placed.values():
        robot.set_state(root, motion.value(0.0).ravel(), motion.EvalDerivative(0.0).ravel())
    simulator.AdvanceTo(seconds)
    return {name: sink.FindLog(root).data().T for name, sink in logs.items()}


def errors(log: JointLog, efforts: dict[str, Array]) -> list[dict[str, Any]]:
    """Return RMS differences of simulated and logged efforts, once the controllers have settled."""
    found = []
    for name, simulated in efforts.items():
        first = int(np.searchsorted(log.time - log.time[0], SETTLED))
        logged = log.effort[first : len(simulated)]
        rms = np.sqrt(np.square(simulated[first:] - logged).mean(0))
        found += [
            {"robot": name, "joint": joint, "rms": error, "logged": own}
            for joint, error, own in zip(
                log.joints, rms.tolist(), logged.std(0).tolist(), strict=True
            )
        ]
    return found


def effort_figure(log: JointLog, efforts: dict[str, Array]) -> Figure:
    """Return every joint: the logged effort, and that of each robot."""
    count = len(efforts[FILE])
    rows = [
        {"robot": name, "joint": joint, "time": log.time[:count].tolist(), "N·m": values.tolist()}
        for name, own in {"log": log.effort[:count], **efforts}.items()
        for joint, values in zip(log.joints, own.T, strict=True)
    ]
    return chart(rows, "time", "N·m", "robot", panel="joint")


def main() -> None:
    """Explains, simulates, prints, and writes what was asked for."""
    options = script_parser(__doc__, "4 s of the log, and 0.5 s of motion").parse_args()
    log = read_log(DEMO / "demo.csv")
    if options.quick:
        log = first_samples(log, 800)
    efforts = simulate(robots(log), log, 0.5 if options.quick else 8.0)
    found = errors(log, efforts)
    lines = [
        one | {other["robot"]: other["rms"] for other in found if other["joint"] == one["joint"]}
        for one in found[: len(log.joints)]
    ]
    show("RMS of simulated − logged effort, N·m", lines, "joint", FILE, BODIES, FITTED, "logged")
    write(options, found, simulate_fitted=lambda: effort_figure(log, efforts))


if __name__ == "__main__":
    main()
