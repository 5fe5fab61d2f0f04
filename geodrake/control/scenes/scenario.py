"""What a scenario file says: models, robots with their controllers and motions, messages.

Drake reads the types of the fields as they are, so annotations of this module are evaluated.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import yaml  # type: ignore[import-untyped]
from pydrake.common.yaml import yaml_load_typed
from pydrake.lcm import DrakeLcmParams
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import GetIntegrationSchemes, SimulatorConfig

from geodrake.boundary.arguments import file_path, number, one_of, positive
from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import regular_file
from geodrake.boundary.yaml_text import yaml_text
from geodrake.errors import ArgumentError, GeodrakeError, ModelError

LAWS = ("natural", "pullback", "euclidean", "none")


@dataclass
class Waypoints:
    """A motion through positions, a spline at rest at both ends.

    Attributes:
        times: When, s, increasing.
        positions: Joint -> its position at each time, rad or m; joints that are left out stay where
            the model file has them.
    """

    times: list[float] = field(default_factory=list)
    positions: dict[str, list[float]] = field(default_factory=dict)


@dataclass
class LogMotion:
    """The motion of a log, a spline through its positions.

    Attributes:
        file: The log, as `read_log` takes it.
        period: Time between knots of the spline, s.
    """

    file: str = ""
    period: float = 0.05


@dataclass
class PredictionSpec:
    """Adaptation by the error of prediction of the controller's own efforts, a `PredictionError`.

    Attributes:
        weight: W, rad/s/(N·m) or m/s/N.
        bandwidth: That of the filtered regressor, 1/s.
        alone: Whether the tracking error does not move the estimate.
    """

    weight: float = 0.1
    bandwidth: float = 20.0
    alone: bool = False


@dataclass
class _AdaptiveControl:
    """What adaptive controllers have in common.

    Attributes:
        model: File of the model that the controller begins with; that of the robot if empty.
        rate: λ of the tracking errors, 1/s.
        time_step: Period of control, s; zero for continuous time.
        factor: First estimate over the parameters of the model.
        mass_uncertainty: δ of [Lee2019] (B.2.11), by which bodies of the first estimate are changed
            at random; zero for none.
        effort_limits: Whether the model's limits of efforts hold.
        prediction: Adaptation by the error of prediction too; null for none.
    """

    model: str = ""
    law: str = "natural"
    gamma: float = 1.0
    rate: float = 10.0
    time_step: float = 1e-3
    factor: float = 1.0
    mass_uncertainty: float = 0.0
    effort_limits: bool = True
    prediction: PredictionSpec | None = None


@dataclass
class PassivityControl(_AdaptiveControl):
    """A `PassivityBasedAdaptiveController`.

    Attributes:
        damping: K of `FixedGains`, N·m·s/rad or N·s/m, one or one a joint; `VaryingGains` if empty.
    """

    damping: list[float] = field(default_factory=list)


@dataclass
class ComputedTorqueControl(_AdaptiveControl):
    """An `AdaptiveComputedTorqueController`, which adapts by the error of prediction alone.

    Otherwise it needs measured accelerations, which a robot of the directives alone has.
    """

    prediction: PredictionSpec | None = field(default_factory=lambda: PredictionSpec(alone=True))


@dataclass
class IiwaMessages:
    """LCM channels between a robot and its controller, as those of Drake's `IiwaDriver`.

    Attributes:
        lcm_bus: One of the scenario's `lcm_buses`.
        status_channel: Channel of `lcmt_iiwa_status`, which the robot sends.
        command_channel: Channel of `lcmt_iiwa_command`, whose torques the controller sends.
        status_period: Time between status messages, s.
        command_period: Time between commands, s.
        gravity_model: File of the model whose gravity the robot's driver compensates on its own, so
            that commands are what is beside it; empty for a driver that does not. Drake's
            `IiwaDriver`, and the controller of a real iiwa, do.
        patience: For how long a controller waits for the first status of a robot that is not
            simulated here, s.
    """

    lcm_bus: str = "default"
    status_channel: str = "IIWA_STATUS"
    command_channel: str = "IIWA_COMMAND"
    status_period: float = 0.005
    command_period: float = 0.005
    gravity_model: str = ""
    patience: float = 10.0


@dataclass
class RobotSpec:
    """A robot: how it moves, and what controls it.

    Attributes:
        model: File of a geodrake model, fitted or not, that the robot of the directives moves as,
            with its inertias, effects and delays; empty for the robot as the directives have it.
        controller: What controls it; null for nothing, or for what sends messages.
        motion: What the controller is to follow.
        messages: How state and efforts travel; null for straight lines in the diagram.
        log: File for positions, velocities and efforts (`.csv`, `.npz`); empty for none.
    """

    model: str = ""
    controller: PassivityControl | ComputedTorqueControl | None = None
    motion: Waypoints | LogMotion | None = None
    messages: IiwaMessages | None = None
    log: str = ""


@dataclass
class MeshcatView:
    """MeshCat.

    Attributes:
        show: Whether to serve the scene while it runs.
        port: Where; null for a free port.
        publish_period: Time between two pictures, s.
        recording: HTML file for the recording; empty for none.
    """

    show: bool = False
    port: int | None = None
    publish_period: float = 1.0 / 32.0
    recording: str = ""


@dataclass
class Scenario:
    """A scene and what happens in it.

    The names are those of Drake's hardware_sim where it has them.

    Attributes:
        random_seed: Of first estimates.
        simulation_duration: How long, s.
        simulator_config: The integrator; by default as fast as it goes, in steps of 1 ms.
        plant_config: The plant; discrete by default, in steps of 1 ms.
        packages: Package -> its folder.
        directives: Models and welds, as in files of Drake directives.
        initial_position: Model instance -> joint -> its first positions; a robot with a motion
            begins there if it is not named.
        lcm_buses: Name -> parameters of LCM.
        robots: Model instance -> robot; a robot that is none of the directives' is controlled by
            messages alone.
        log_period: Period of logs, s.
        meshcat: How it is shown.
    """

    random_seed: int = 0
    simulation_duration: float = 1.0
    simulator_config: SimulatorConfig = field(
        default_factory=lambda: SimulatorConfig(
            max_step_size=1e-3, accuracy=1e-3, target_realtime_rate=0.0
        )
    )
    plant_config: MultibodyPlantConfig = field(default_factory=MultibodyPlantConfig)
    packages: dict[str, str] = field(default_factory=dict)
    directives: list[ModelDirective] = field(default_factory=list)
    initial_position: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    lcm_buses: dict[str, DrakeLcmParams] = field(default_factory=dict)
    robots: dict[str, RobotSpec] = field(default_factory=dict)
    log_period: float = 0.01
    meshcat: MeshcatView = field(default_factory=MeshcatView)


def load_scenario(path: str | Path, name: str | None = None) -> Scenario:
    """Reads a scenario from a YAML file, which has scenarios by their names.

    Paths of models, logs and packages in it are those from the folder of the file.

    Args:
        path: The file.
        name: Name of the scenario; None for the only one.

    Raises:
        ArgumentError: There is no such scenario, a number is out of its range, or a word is none of
            those that are known.
        ModelError: The file cannot be read, or says something that no scenario has.
    """
    path = regular_file(file_path(path), "scenario file", ModelError)
    text = yaml_text(path)
    try:
        name = _chosen(path, yaml.compose(text, yaml.SafeLoader), name)
        scenario = yaml_load_typed(schema=Scenario, data=text, child_name=name)
    except yaml.YAMLError as error:
        raise ModelError(
            f"{path} is not valid YAML: {one_line(error)}.", advice="Correct the file there."
        ) from error
    except GeodrakeError:
        raise
    except (RuntimeError, ValueError, TypeError, AttributeError, AssertionError) as error:
        raise ModelError(
            f"The scenario {name} of {path} cannot be read: {one_line(error)}.",
            advice="See geodrake.control.scenes.Scenario for what there is to say.",
            path=path,
        ) from error
    with within(f"{name} of {path}"):
        check_scenario(scenario)
    return _from_folder(scenario, path.parent.absolute())


def _chosen(path: Path, root: yaml.Node | None, name: str | None) -> str:
    if not isinstance(root, yaml.MappingNode) or not root.value:
        raise ModelError(
            f"{path} has no scenarios by their names.", advice="Write NAME: {directives: […], …}."
        )
    names = [str(key.value) for key, _ in root.value]
    if name is None and len(names) == 1:
        return names[0]
    if name not in names:
        what = "has several scenarios" if name is None else f"has no scenario {name!r}"
        raise ArgumentError(f"{path} {what}.", advice=f"It has {', '.join(names)}.")
    return name


def check_scenario(scenario: Scenario) -> None:
    """Refuses numbers that end a process, or mean nothing.

    Raises:
        ArgumentError: There is one.
    """
    positive(scenario.simulation_duration, "simulation_duration")
    positive(scenario.log_period, "log_period")
    positive(scenario.meshcat.publish_period, "meshcat.publish_period")
    number(scenario.plant_config.time_step, "plant_config.time_step", lower=0.0)
    config = scenario.simulator_config
    one_of(config.integration_scheme, "integration_scheme", GetIntegrationSchemes())
    for each in ("max_step_size", "accuracy"):
        positive(getattr(config, each), each)
    number(config.target_realtime_rate, "target_realtime_rate", lower=0.0)
    number(config.start_time, "start_time", lower=0.0, upper=0.0)
    number(scenario.random_seed, "random_seed", lower=0.0)
    for name, robot in scenario.robots.items():
        with within(f"robots.{name}"):
            _check_robot(robot, scenario)


def _check_robot(robot: RobotSpec, scenario: Scenario) -> None:
    if (robot.controller is None) != (robot.motion is None):
        raise ArgumentError(
            "A controller needs a motion, and a motion a controller.",
            advice="Give both, or none.",
        )
    if robot.controller is not None:
        if not (robot.controller.model or robot.model):
            raise ArgumentError("The controller has no model.", advice="Give model: FILE.")
        one_of(robot.controller.law, "law", LAWS)
        positive(robot.controller.factor, "factor")
        number(robot.controller.mass_uncertainty, "mass_uncertainty", lower=0.0, upper=0.99)
    if robot.messages is not None:
        for each in ("status_period", "command_period"):
            positive(getattr(robot.messages, each), each)
        number(robot.messages.patience, "patience", lower=0.0, finite=False)
        if robot.messages.lcm_bus not in scenario.lcm_buses:
            raise ArgumentError(
                f"There is no LCM bus {robot.messages.lcm_bus!r}.",
                advice=f"The scenario has {', '.join(scenario.lcm_buses) or 'none'}; add it to "
                "lcm_buses.",
            )


def _from_folder(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with paths that do not depend on where the process is."""

    def found(name: str) -> str:
        return str(folder / name) if name else ""

    robots = {}
    for name, robot in scenario.robots.items():
        controller, motion, messages = robot.controller, robot.motion, robot.messages
        if controller is not None:
            controller = replace(controller, model=found(controller.model))
        if isinstance(motion, LogMotion):
            motion = replace(motion, file=found(motion.file))
        if messages is not None:
            messages = replace(messages, gravity_model=found(messages.gravity_model))
        robots[name] = replace(
            robot, model=found(robot.model), controller=controller, motion=motion, messages=messages
        )
    packages = {name: found(place) for name, place in scenario.packages.items()}
    return replace(scenario, robots=robots, packages=packages)


@contextmanager
def within(where: str) -> Iterator[None]:
    """Says of errors where in the scenario they are."""
    try:
        yield
    except GeodrakeError as error:
        raise type(error)(
            f"{where}: {error.problem}", advice=error.advice, **error.evidence
        ) from error
