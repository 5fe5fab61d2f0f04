"""Simulates a scenario: robots with adaptive controllers, tables, objects, messages of LCM.

A scenario is one of Drake's hardware_sim with `robots` instead of drivers: see
`scenes/workcell.yaml` for examples and `Scenario` for all fields. (Drake reads the types of fields,
so this module's annotations are evaluated.)

    python -m diagrams.examples.run_scenario --scenario-name push --figures figures
"""

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from matplotlib.figure import Figure
from pydrake.common.yaml import yaml_load_typed
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.lcm import DrakeLcmInterface, DrakeLcmParams
from pydrake.multibody.parsing import (
    ModelDirective,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.lcm import ApplyLcmBusConfig
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink
from pydrake.trajectories import PiecewisePolynomial

from diagrams.examples.iiwa_messages import IiwaMessages, add_simulated_iiwa, iiwa_ports
from diagrams.harness import chart, script_parser, show, write
from geodrake import load_model
from geodrake.boundary.arguments import one_of, positive
from geodrake.boundary.escaping import printable
from geodrake.control import (
    AdaptiveComputedTorqueController,
    AdaptiveController,
    AdaptiveLoop,
    ControlModel,
    FixedGains,
    PassivityBasedAdaptiveController,
    PredictionError,
    Safeguards,
    VaryingGains,
    add_adaptive_loop,
    euclidean_adaptation,
    natural_adaptation,
    parameter_manifold,
    pullback_adaptation,
)
from geodrake.errors import ArgumentError, ConvergenceError, GeodrakeError, ModelError, OutputError
from geodrake.inertia import Array
from geodrake.logs import JointLog, write_log
from geodrake.model import RobotModel
from geodrake.model.simulation.robot_in_diagram import RobotInDiagram
from geodrake.report import save_recording
from geodrake.robot import RobotInstance, take_out_stated
from geodrake.robot.files.description import drake_errors

WORKCELL = Path(__file__).parent / "scenes" / "workcell.yaml"
QUICK = 0.3  # s
BAD_INPUT = 2
LAWS = ("natural", "pullback", "euclidean", "none")
ADVICE = "Correct the scenario."


@dataclass
class Motion:
    """A spline through positions, at rest at both ends."""

    times: list[float] = field(default_factory=list)  # when, s, increasing
    # Joint -> its position at each time, rad or m; joints that are left out stay where the model
    # file has them.
    positions: dict[str, list[float]] = field(default_factory=dict)


@dataclass
class Control:
    """An adaptive controller."""

    model: str = ""  # file of the model that it begins with; that of the robot if empty
    law: str = "natural"  # "natural", "pullback", "euclidean" or "none"
    gamma: float = 1.0
    rate: float = 10.0  # λ of the tracking errors, 1/s
    # K of `FixedGains`, N·m·s/rad or N·s/m, one a joint; `VaryingGains` if empty.
    damping: list[float] = field(default_factory=list)
    # Whether it is an `AdaptiveComputedTorqueController`, which adapts by the error of prediction
    # alone, instead of a `PassivityBasedAdaptiveController`.
    computed_torque: bool = False
    # Weight of the error of prediction, rad/s/(N·m) or m/s/N; 0 to leave it out.
    prediction: float = 0.0
    factor: float = 1.0  # first estimate over the parameters of the model


@dataclass
class Robot:
    """A robot with its motion and its controller."""

    # File of a geodrake model, fitted or not, that the robot of the directives moves as, with its
    # inertias, effects and delays; empty for the robot as the directives have it.
    model: str = ""
    control: Control | None = None  # its controller, which follows `motion`; null for none here
    motion: Motion = field(default_factory=Motion)
    # How state and efforts travel; null for straight lines in the diagram.
    messages: IiwaMessages | None = None
    log: str = ""  # file for positions, velocities and efforts (`.csv`, `.npz`); empty for none


@dataclass
class Scenario:
    """A scene and its robots; names are those of Drake's hardware_sim where it has them."""

    random_seed: int = 0  # of hardware_sim; nothing here is random
    simulation_duration: float = 1.0
    simulator_config: SimulatorConfig = field(
        default_factory=lambda: SimulatorConfig(
            max_step_size=1e-3, accuracy=1e-3, target_realtime_rate=0.0
        )
    )
    plant_config: MultibodyPlantConfig = field(default_factory=MultibodyPlantConfig)
    # Package -> its folder. All paths are those from the folder of the file.
    packages: dict[str, str] = field(default_factory=dict)
    directives: list[ModelDirective] = field(default_factory=list)
    lcm_buses: dict[str, DrakeLcmParams] = field(default_factory=dict)
    # Model instance -> robot; one that the directives do not have is controlled by messages alone.
    robots: dict[str, Robot] = field(default_factory=dict)
    log_period: float = 0.01  # period of logs, s


def load_scenario(path: Path, name: str | None) -> Scenario:
    """Read a scenario from a YAML file, by its name if there are several."""
    if not path.is_file():
        raise ArgumentError(f"{path} does not exist, or is no file.", advice="Check the path.")
    with drake_errors(path, advice=ADVICE):
        text = path.read_text(encoding="utf-8")
        names = [key.value for key, _ in yaml.compose(text, yaml.SafeLoader).value]
        if name is None and len(names) == 1:
            name = names[0]
        if name not in names:
            raise ArgumentError(f"No scenario {name!r}.", advice=f"It has {', '.join(names)}.")
        scenario = yaml_load_typed(schema=Scenario, data=text, child_name=name)
    positive(scenario.simulation_duration, "simulation_duration")  # others would end the process
    positive(scenario.log_period, "log_period")
    return scenario


@contextmanager
def within(where: str) -> Iterator[None]:
    """Add a place in the scenario to the messages of errors."""
    try:
        yield
    except GeodrakeError as error:
        raise type(error)(f"{where}: {error.problem}", advice=error.advice) from error


def motion_of(spec: Motion, model: RobotModel) -> PiecewisePolynomial:
    """Return the spline of a model's joints."""
    strange = [joint for joint in spec.positions if joint not in model.joints]
    if strange or len(spec.times) < 2 or not (np.diff(spec.times) > 0).all():
        raise ArgumentError(
            f"A motion needs two times or more, increasing, and joints of the robot; got "
            f"{spec.times} and {', '.join(strange) or 'its joints'}."
        )
    rests = {joint: [model.default_position(joint)] * len(spec.times) for joint in model.joints}
    positions = np.array([*{**rests, **spec.positions}.values()])
    still = np.zeros((len(model.joints), 1))
    spline = PiecewisePolynomial.CubicWithContinuousSecondDerivatives
    return spline(spec.times, positions, still, still)


def controller_of(spec: Control, model: RobotModel) -> AdaptiveController:
    """Return the controller that a scenario describes."""
    control = ControlModel.of(model)
    start = positive(spec.factor, "factor") * control.prior
    manifold = parameter_manifold(model)
    law = {
        "natural": lambda: natural_adaptation(manifold, spec.gamma),
        "pullback": lambda: pullback_adaptation(manifold, start, spec.gamma),
        "euclidean": lambda: euclidean_adaptation(len(start), spec.gamma),
        "none": lambda: None,
    }[one_of(spec.law, "law", LAWS)]()
    alone, weight = spec.computed_torque, spec.prediction
    options = {
        "prediction": PredictionError(weight, alone=alone) if weight else None,
        "time_step": 1e-3,
        "parameters": start,
        "safeguards": Safeguards(model.effort_limits),
    }
    if spec.computed_torque:
        return AdaptiveComputedTorqueController(control, law, rate=spec.rate, **options)
    gains = FixedGains(spec.damping, spec.rate) if spec.damping else VaryingGains(spec.rate)
    return PassivityBasedAdaptiveController(control, law, gains=gains, **options)


@dataclass(frozen=True, eq=False)
class Placed:
    """A robot in the diagram."""

    joints: tuple[str, ...]  # names of its n joints, in the order of its controller
    instance: RobotInstance | None  # it in the plant; None if it is elsewhere
    model: RobotInDiagram | None  # the model that it moves as; None for the robot of the directives
    loop: AdaptiveLoop | None
    logs: Mapping[str, VectorLogSink]  # sinks of "state" and "effort" of a robot in the plant
    kept: RobotModel | None  # what must live as long as the diagram

    def start(self, root: Context) -> None:
        """Put the robot at the start of its motion, with the model's inertias."""
        if self.model is not None:
            self.model.set_inertias(root)
        if self.instance is not None and self.loop is not None:
            port = self.loop.desired_state
            desired = port.Eval(port.get_system().GetMyContextFromRoot(root))
            plant = self.instance.plant
            self.instance.set_state(plant.GetMyMutableContextFromRoot(root), self.joints, desired)
        if self.model is not None and self.model.effect_force is not None:
            self.model.effect_force.deflect(root)

    def logged(self, context: Context) -> tuple[Array, dict[str, Array]]:
        """Return times (N,) and logged values (N, ·), of the plant if the robot is in it."""
        sinks = {name: sink.FindLog(context) for name, sink in self.logs.items()}
        own = {name: np.array(log.data().T) for name, log in sinks.items()}
        if self.loop is None:
            return np.array(next(iter(sinks.values())).sample_times()), own
        times, logs = self.loop.logged(context)
        return times, {"effort": logs["actuation"], **logs, **own}


def add_plant(builder: DiagramBuilder, scenario: Scenario, folder: Path) -> MultibodyPlant:
    """Add the plant of the directives."""
    with drake_errors(folder / "the directives", advice=ADVICE):
        plant, _ = AddMultibodyPlant(scenario.plant_config, builder)
        parser = Parser(plant)
        for name, place in scenario.packages.items():
            if not (folder / place).is_dir():
                raise ModelError(f"The folder {folder / place} of package {name!r} is not there.")
            parser.package_map().Add(name, str(folder / place))
        ProcessModelDirectives(ModelDirectives(directives=scenario.directives), parser)
        for name, robot in scenario.robots.items():
            if robot.model and plant.HasModelInstanceNamed(name):
                take_out_stated(plant, name)
        plant.Finalize()
    return plant


def add_robot(
    builder: DiagramBuilder,
    spec: Robot,
    place: RobotInstance | None,
    *,
    folder: Path,
    lcm: DrakeLcmInterface | None,
    log_period: float,
) -> Placed:
    """Add a robot, at its place in the plant or elsewhere, with its controller if it has one."""
    own, messages = load_model(folder / spec.model) if spec.model else None, spec.messages
    known = own
    if spec.control is not None and spec.control.model:
        known = load_model(folder / spec.control.model)
    joints = known.joints if known else place.joints if place else ()
    model = own.add_to_scene(builder, place) if own and place else None
    ports = model.ports() if model else None
    if ports is None and place is not None and (spec.control or messages):
        ports = place.ports(builder, joints)
    logs, effort, gravity, loop = {}, None, None, None
    if place is not None and ports is not None:
        logs["state"] = LogVectorOutput(ports.state, builder, log_period)
    if messages is not None and lcm is not None:
        gravity = load_model(folder / messages.gravity_model) if messages.gravity_model else None
        options = {"gravity_plant": gravity and gravity.plant}
        if ports is not None:
            effort = add_simulated_iiwa(builder, ports, lcm, messages, **options)
        options["elsewhere"] = place is None
        ports = iiwa_ports(builder, joints, lcm, messages, **options) if spec.control else None
    if spec.control is not None:
        if known is None or ports is None:
            raise ArgumentError("A controller needs a model, and a robot or messages.")
        with within("control"):
            controller = controller_of(spec.control, known)
        with within("motion"):
            motion = motion_of(spec.motion, known)
        loop = add_adaptive_loop(builder, ports, controller, motion, log_period=log_period)
        effort = effort or loop.actuation
    effort = model.logged_effort if model else effort
    if place is not None and effort is not None:
        logs["effort"] = LogVectorOutput(effort, builder, log_period)
    return Placed(joints, place, model, loop, logs, gravity)


def simulate(
    *, scenario: Scenario, folder: Path, meshcat: Meshcat | None = None
) -> tuple[MultibodyPlant, dict[str, Placed], tuple[Context, Context]]:
    """Simulate a scenario: its plant, its robots, and the Contexts at the start and the end."""
    builder = DiagramBuilder()
    plant = add_plant(builder, scenario, folder)
    with drake_errors(Path("lcm_buses"), advice=ADVICE):
        buses = ApplyLcmBusConfig(scenario.lcm_buses, builder)
    robots = {}
    for name, spec in scenario.robots.items():
        with within(f"robots.{name}"), drake_errors(Path("lcm_bus"), advice=ADVICE):
            lcm = buses.Find(name, spec.messages.lcm_bus) if spec.messages else None
            there = plant.HasModelInstanceNamed(name) or spec.messages is None
            place = RobotInstance(plant, name) if there else None
            options = {"folder": folder, "lcm": lcm, "log_period": scenario.log_period}
            robots[name] = add_robot(builder, spec, place, **options)
    if meshcat is not None:
        scene_graph = plant.get_geometry_query_input_port()
        source = builder.connection_map()[plant, scene_graph.get_index()][0]
        MeshcatVisualizer.AddToBuilder(builder, source, meshcat)
    diagram = builder.Build()
    start = diagram.CreateDefaultContext()
    for robot in robots.values():
        robot.start(start)
    simulator = Simulator(diagram, start.Clone())
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    try:
        simulator.Initialize()
        simulator.AdvanceTo(scenario.simulation_duration)
    except (RuntimeError, SystemExit) as error:
        raise ConvergenceError(
            f"The simulation ends at {simulator.get_context().get_time():g} s: {error}.",
            advice="Choose smaller steps, other gains, or wait longer for messages.",
        ) from error
    return plant, robots, (start, simulator.get_context())


def tracking(
    law: str, name: str, joints: tuple[str, ...], times: Array, error: Array
) -> list[dict]:
    """Return rows of errors (N, n), rad or m, of all joints and each; "late" is the second half."""
    known = np.isfinite(error).all(1)
    error, late = error[known], times[known] >= 0.5 * times[-1]
    return [
        {
            "robot": name,
            "law": law,
            "joint": joint,
            "rms": float(np.sqrt(np.mean(values**2))),
            "late": float(np.sqrt(np.mean(values[late] ** 2))),
            "largest": float(np.abs(values).max()),
        }
        for joint, values in [("all", error), *zip(joints, error.T, strict=True)]
    ]


def moved_objects(plant: MultibodyPlant, contexts: tuple[Context, Context]) -> dict[str, list]:
    """Return the displacement of each floating body, m."""
    own = [plant.GetMyContextFromRoot(root) for root in contexts]
    bodies = [plant.get_body(i) for i in sorted(plant.GetFloatingBaseBodies(), key=int)]
    places = {
        body.scoped_name().get_full(): [body.EvalPoseInWorld(c).translation() for c in own]
        for body in bodies
    }
    return {name: (end - start).tolist() for name, (start, end) in places.items()}


def error_figure(errors: Mapping[str, tuple[tuple[str, ...], Array, Array]]) -> Figure:
    """Draw errors of all joints over time, with a panel for each robot."""
    rows = [
        {"robot": name, "joint": joint, "time": times.tolist(), "q − q_d": values.tolist()}
        for name, (joints, times, error) in errors.items()
        for joint, values in zip(joints, error.T, strict=True)
    ]
    return chart(rows, "time", "q − q_d", "joint", panel="robot", note="rad or m, s")


def run(options: argparse.Namespace) -> None:
    """Read, simulate, print, and write."""
    name = options.scenario_name
    if name is None and options.scenario == WORKCELL:
        name = "push"
    scenario, folder = load_scenario(options.scenario, name), options.scenario.parent.absolute()
    if options.quick:
        scenario.simulation_duration = min(QUICK, scenario.simulation_duration)
    for place in filter(None, (options.json and options.json.parent, options.figures)):
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"There can be no folder {place}: {error.strerror}.") from error
    meshcat = Meshcat() if options.show or options.figures else None
    if meshcat is not None:
        print(f"The scene is at {meshcat.web_url()}.", flush=True)
        meshcat.StartRecording(set_visualizations_while_recording=options.show)
    begin = time.perf_counter()
    plant, robots, contexts = simulate(scenario=scenario, folder=folder, meshcat=meshcat)
    seconds, found, errors = time.perf_counter() - begin, [], {}
    for each, robot in robots.items():
        times, logs = robot.logged(contexts[1])
        n, spec = len(robot.joints), scenario.robots[each]
        if robot.loop is not None:
            errors[each] = robot.joints, times, (logs["state"] - logs["desired_state"])[:, :n]
            found += tracking(spec.control.law, each, *errors[each])
        if spec.log and "effort" in logs:
            position, velocity = logs["state"][:, :n], logs["state"][:, n:]
            log = JointLog(each, robot.joints, times, position, logs["effort"], velocity)
            write_log(log, folder / spec.log)
    moved, label = moved_objects(plant, contexts), name or options.scenario.stem
    errors_of_all = [row for row in found if row["joint"] == "all"]
    show("Errors, rad or m; late: of the second half", errors_of_all)
    for each, way in moved.items():
        print(f"{each} moved by {np.round(way, 3).tolist()} m.")
    if options.figures:
        save_recording(meshcat, options.figures / f"{label}.html")
    drawn = {f"{label}_errors": lambda: error_figure(errors)} if errors else {}
    took = {"simulated": scenario.simulation_duration, "seconds": seconds}
    write(options, {"scenario": label, **took, "tracking": found, "moved": moved}, **drawn)


def main() -> None:
    """Run the command line."""
    parser = script_parser(__doc__, f"{QUICK} s at most", figures=True)
    parser.add_argument("--scenario", type=Path, default=WORKCELL, help="YAML file of scenarios")
    parser.add_argument("--scenario-name", help="which one, if the file has several")
    parser.add_argument("--show", action="store_true", help="serve the scene while it runs")
    try:
        run(parser.parse_args())
    except GeodrakeError as error:
        print(f"Error: {printable(str(error))}", file=sys.stderr)
        sys.exit(BAD_INPUT)


if __name__ == "__main__":
    main()
