"""Simulates a scenario: robots with adaptive controllers, tables, objects, messages of LCM.

A scenario is like one of Drake's hardware_sim; see `scenes/workcell.yaml` for some, and
`geodrake.control.scenes.Scenario` for all that one may say.

    python diagrams/run_scenario.py --scenario diagrams/scenes/workcell.yaml --scenario-name push
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from pydrake.geometry import Meshcat, MeshcatParams
from rich.console import Console
from rich.table import Table

from geodrake.boundary.escaping import printable
from geodrake.boundary.whole_files import write_whole
from geodrake.control.scenes import RobotRun, Scenario, SceneRun, load_scenario, run, write_logs
from geodrake.errors import GeodrakeError, OutputError
from geodrake.report import style
from geodrake.report.adaptation_view import save_recording

WORKCELL = Path(__file__).parent / "scenes" / "workcell.yaml"
QUICK = 0.3  # s
BAD_INPUT = 2


@dataclass(frozen=True)
class Tracking:
    """How well a robot followed its motion.

    Attributes:
        robot: Its model instance.
        law: Of adaptation.
        joint: The joint, or "all".
        rms: RMS error, rad or m.
        late: The same over the second half.
        largest: Largest error, rad or m.
    """

    robot: str
    law: str
    joint: str
    rms: float
    late: float
    largest: float


def tracking(done: SceneRun) -> list[Tracking]:
    """Rows of the table: every robot with a motion, all joints and then each."""
    rows = []
    for name, robot in done.robots.items():
        spec = done.scene.scenario.robots[name]
        if robot.error is None or spec.controller is None:
            continue
        known = np.isfinite(robot.error).all(1)
        error, late = robot.error[known], robot.time[known] >= 0.5 * robot.time[-1]
        columns = [("all", error), *zip(robot.joints, error.T, strict=True)]
        for joint, values in columns:
            size = np.sqrt(np.mean(values**2)), np.sqrt(np.mean(values[late] ** 2))
            rms, end = map(float, size)
            largest = float(np.abs(values).max())
            rows.append(Tracking(name, spec.controller.law, joint, rms, end, largest))
    return rows


def objects(done: SceneRun) -> dict[str, list[float]]:
    """Body that floats -> how far it was moved, m."""
    plant, end = done.scene.plant, done.context
    start = plant.GetMyContextFromRoot(done.scene.context())
    ends = plant.GetMyContextFromRoot(end)
    moved = {}
    for index in sorted(plant.GetFloatingBaseBodies(), key=int):
        body = plant.get_body(index)
        poses = (body.EvalPoseInWorld(context).translation() for context in (ends, start))
        moved[body.scoped_name().get_full()] = np.subtract(*poses).tolist()
    return moved


def error_figure(robots: Mapping[str, RobotRun]) -> Figure:
    """Errors of all joints over time, a panel a robot."""
    figure = style.new_figure(2.4 * len(robots))
    panels = figure.subplots(len(robots), 1, sharex=True, squeeze=False).ravel()
    for (name, robot), ax in zip(robots.items(), panels, strict=True):
        style.polish(ax)
        for joint, error in zip(robot.joints, np.transpose(robot.error), strict=True):
            ax.plot(robot.time, error, lw=1.2, label=joint)
        ax.set_title(f"{name}: q − q_d, rad or m", loc="left", **style.plain())
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)
    panels[-1].set_xlabel("time, s")
    return figure


def show(found: list[Tracking], moved: Mapping[str, list[float]]) -> None:
    """Prints the errors of robots, and where objects went."""
    console = Console(width=100)
    table = Table("robot", "law", title="error, rad or m", title_justify="left")
    for column in ("RMS", "second half", "largest"):
        table.add_column(column, justify="right")
    for row in (row for row in found if row.joint == "all"):
        values = (f"{value:.4f}" for value in (row.rms, row.late, row.largest))
        table.add_row(row.robot, row.law, *values)
    console.print(table)
    for name, way in moved.items():
        console.print(f"{name} moved by {np.round(way, 3).tolist()} m.", highlight=False)


def write(options: argparse.Namespace, name: str, done: SceneRun, meshcat: Meshcat | None) -> None:
    """Writes what was asked for, by the command line and by the scenario."""
    write_logs(done)
    recording = done.scene.scenario.meshcat.recording
    if recording and meshcat is not None:
        save_recording(meshcat, recording)
    if options.figures:
        if meshcat is not None:
            save_recording(meshcat, options.figures / f"{name}.html")
        tracked = {key: robot for key, robot in done.robots.items() if robot.error is not None}
        if tracked:
            error_figure(tracked).savefig(options.figures / f"{name}_errors.png")


def simulate(options: argparse.Namespace) -> None:
    """Reads, simulates, prints, and writes."""
    scenario, name = chosen(options)
    make_folders(options)
    recorded = bool(options.figures or scenario.meshcat.recording)
    meshcat = None
    if recorded or scenario.meshcat.show:
        meshcat = Meshcat(MeshcatParams(port=scenario.meshcat.port))
        if scenario.meshcat.show:
            print(f"The scene is at {meshcat.web_url()}.", flush=True)
        if recorded:
            meshcat.StartRecording(set_visualizations_while_recording=scenario.meshcat.show)
    begin = time.perf_counter()
    done = run(scenario=scenario, meshcat=meshcat)
    seconds = time.perf_counter() - begin
    found, moved = tracking(done), objects(done)
    show(found, moved)
    write(options, name, done, meshcat)
    if options.json:
        table = {
            "scenario": name,
            "simulated": scenario.simulation_duration,
            "seconds": seconds,
            "tracking": [asdict(row) for row in found],
            "moved": moved,
        }
        write_whole(options.json, json.dumps(table, indent=2) + "\n")


def make_folders(options: argparse.Namespace) -> None:
    """Makes the folders that are written to, before there is something to lose."""
    for folder in (options.json and options.json.parent, options.figures):
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(
                    f"There can be no folder {folder}: {error.strerror}.", advice="Choose another."
                ) from error


def chosen(options: argparse.Namespace) -> tuple[Scenario, str]:
    """The scenario that was asked for, and a name for its files."""
    name = options.scenario_name
    if name is None and options.scenario == WORKCELL:
        name = "push"
    scenario = load_scenario(options.scenario, name)
    if options.seed is not None:
        scenario.random_seed = options.seed
    if options.quick:
        scenario.simulation_duration = min(QUICK, scenario.simulation_duration)
    return scenario, name or options.scenario.stem


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", type=Path, default=WORKCELL, help="YAML file of scenarios")
    parser.add_argument("--scenario-name", help="which one, if the file has several")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} s at most")
    parser.add_argument("--seed", type=int, help="in place of the scenario's random_seed")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--figures", type=Path, help="folder for errors and MeshCat's recording")
    options = parser.parse_args()
    try:
        simulate(options)
    except GeodrakeError as error:
        print(f"Error: {printable(str(error))}", file=sys.stderr)
        sys.exit(BAD_INPUT)


if __name__ == "__main__":
    main()
