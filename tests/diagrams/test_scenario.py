"""Scenarios of a file: built, simulated, and driven by messages of LCM."""

import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.lcm import DrakeLcmParams
from pydrake.manipulation import ApplyDriverConfigs, IiwaDriver
from pydrake.multibody.parsing import LoadModelDirectivesFromString, Parser, ProcessModelDirectives
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import ApplyLcmBusConfig
from pydrake.trajectories import PiecewisePolynomial
from scenes import MODELS, PENDULUM, SCENES

from diagrams.examples.iiwa_messages import CommandWriter, IiwaMessages, StatusReader, iiwa_ports
from diagrams.examples.run_scenario import load_scenario, simulate
from geodrake import load_model
from geodrake.control import (
    ControlModel,
    PassivityBasedAdaptiveController,
    VaryingGains,
    add_adaptive_loop,
)
from geodrake.errors import ArgumentError, ConvergenceError, ModelError

WORKCELL = SCENES / "workcell.yaml"
SMALL = f"""
swing:
  simulation_duration: 0.1
  packages: {{models: {MODELS}}}
  directives:
    - add_model: {{name: arm, file: package://models/double_pendulum.urdf}}
    - add_weld: {{parent: world, child: arm::base_link}}
  lcm_buses: {{default: {{lcm_url: "memq://"}}}}
  robots:
    arm:
      control: {{model: {PENDULUM}, gamma: 30.0, rate: 10.0, factor: 1.2}}
      motion: {{times: [0.0, 1.0, 2.0], positions: {{shoulder: [0.1, 0.4, 0.1]}}}}
"""


@pytest.fixture
def small(tmp_path):
    """Return the path of a scenario of the pendulum alone."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


def logged(scenario, folder):
    _, robots, (_, end) = simulate(scenario=scenario, folder=folder)
    return robots["arm"].logged(end)


def rms(logs):
    return np.sqrt(np.mean((logs["state"] - logs["desired_state"])[:, :2] ** 2))


def test_a_robot_follows_its_motion(small):
    time, logs = logged(load_scenario(small, None), small.parent)
    np.testing.assert_allclose(time, np.linspace(0.0, 0.1, 11))
    np.testing.assert_allclose(logs["state"][0], [0.1, 0.0, 0.0, 0.0], atol=1e-12)
    assert 0.0 < rms(logs) < 0.02


def test_a_crate_is_pushed():
    """Contact moves the crate, and the arm tracks worse while it pushes."""
    scenario = load_scenario(WORKCELL, "push")
    del scenario.robots["second"]
    arm = scenario.robots["arm"]
    arm.motion.times = [0.0, 0.4]
    for joint, values in arm.motion.positions.items():
        arm.motion.positions[joint] = values[1:3]
    arm.control.law, scenario.simulation_duration = "none", 0.4
    plant, robots, (_, end) = simulate(scenario=scenario, folder=SCENES)
    crate = plant.GetBodyByName("crate").EvalPoseInWorld(plant.GetMyContextFromRoot(end))
    assert 0.02 < crate.translation()[0] - 0.16 < 0.2
    _, logs = robots["arm"].logged(end)
    error = np.abs(logs["state"] - logs["desired_state"])[:, :7].max(1)
    assert error[-1] > 3.0 * error[5]


@pytest.mark.parametrize("gravity", ["", str(PENDULUM)])
def test_a_loop_by_messages_follows_nearly_as_one_of_straight_lines(small, gravity):
    """The first efforts are late, so the arm falls for some steps."""
    scenario = load_scenario(small, None)
    control = scenario.robots["arm"].control
    control.law, control.factor = "none", 1.0
    _, there = logged(scenario, small.parent)
    scenario.robots["arm"].messages = IiwaMessages(
        status_period=1e-3, command_period=1e-3, gravity_model=gravity
    )
    _, here = logged(scenario, small.parent)
    assert rms(there) < 1e-3
    assert 0.0 < rms(here) < 5e-3
    np.testing.assert_allclose(here["effort"][-1], there["effort"][-1], rtol=0.1, atol=0.1)
    assert not here["effort"][0].any() or gravity  # which the driver compensates at once


def test_a_controller_drives_drakes_own_iiwa_driver(tmp_path):
    """In torque_only mode, the driver of hardware_sim compensates gravity itself."""
    urdf = (MODELS / "arm7.urdf").read_text()
    names = [part.split('"')[0] for part in urdf.split('<joint name="')[1:]]
    added = "".join(
        f'<transmission name="to_{name}"><type>SimpleTransmission</type><joint name="{name}">'
        "<hardwareInterface>EffortJointInterface</hardwareInterface></joint>"
        f'<actuator name="motor_{name}"/></transmission>'
        for name in names
    )
    path = tmp_path / "arm.urdf"
    path.write_text(urdf.replace("</robot>", f"{added}</robot>"))
    directives = f"""
directives:
- add_model: {{name: arm, file: "file://{path}"}}
- add_weld: {{parent: world, child: "arm::link_0"}}
"""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    infos = ProcessModelDirectives(LoadModelDirectivesFromString(directives), Parser(plant))
    plant.Finalize()
    buses = ApplyLcmBusConfig({"default": DrakeLcmParams(lcm_url="memq://")}, builder)
    driver = IiwaDriver(control_mode="torque_only", lcm_status_period=1e-3)
    ApplyDriverConfigs(
        driver_configs={"arm": driver},
        sim_plant=plant,
        models_from_directives=infos,
        lcm_buses=buses,
        builder=builder,
    )
    model = load_model(MODELS / "arm7.urdf")
    lcm, messages = buses.Find("the test", "default"), IiwaMessages(command_period=1e-3)
    ports = iiwa_ports(builder, model.joints, lcm, messages, gravity_plant=model.plant)
    gains = VaryingGains(15.0)
    controller = PassivityBasedAdaptiveController(ControlModel.of(model), None, gains=gains)
    t = np.linspace(0.0, 1.0, 6)
    q = 0.3 + 0.2 * np.cos(np.outer(np.linspace(1.0, 2.0, 7), t))
    motion = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, q)
    loop = add_adaptive_loop(builder, ports, controller, motion, log_period=0.01)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositions(context, q[:, 0])
    simulator.AdvanceTo(0.15)
    _, logs = loop.logged(simulator.get_context())
    error = (logs["state"] - logs["desired_state"])[1:, :7]
    assert np.abs(error).max() < 2e-3  # where gravity is counted twice, it is 0.05 rad


def test_before_a_status_the_state_is_unknown_and_efforts_are_zero():
    reader, writer = StatusReader(2), CommandWriter(2, load_model(PENDULUM).plant)
    context = reader.CreateDefaultContext()
    reader.get_input_port().FixValue(context, lcmt_iiwa_status())
    state = reader.get_output_port().Eval(context)
    assert np.isnan(state).all()
    context = writer.CreateDefaultContext()
    writer.GetInputPort("effort").FixValue(context, [3.0, 1.0])
    writer.GetInputPort("state").FixValue(context, state)
    sent = writer.get_output_port().Eval(context)
    assert lcmt_iiwa_command.decode(sent.encode()).joint_torque == (0.0, 0.0)


def test_waiting_for_a_silent_robot_ends():
    scenario = load_scenario(WORKCELL, "controller")
    scenario.lcm_buses["default"].lcm_url = "memq://"
    scenario.robots["arm"].messages.patience = 0.01
    with pytest.raises(ConvergenceError, match="ends at 0 s"):
        simulate(scenario=scenario, folder=SCENES)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("packages:", "package:", "['package'] were unknown"),
        ("duration: 0.1", "duration: -1", "must be a finite number above 0"),
        ("    arm:\n", "    leg:\n", "no model instance 'leg'"),
        ("gamma: 30.0", "law: fast", 'one of "natural", "pullback"'),
        ("factor: 1.2", "factor: 0.0", "robots.arm: control: factor must be"),
        ("double_pendulum.urdf, g", "gone.urdf, g", "gone.urdf does not exist"),
        (f"{{models: {MODELS}", "{models: /nowhere", "package 'models' is not there"),
        ("1.0, 2.0]", "2.0, 2.0]", "two times or more, increasing"),
        ("arm::base_link", "arm::foot", "foot"),
        ("      motion:", "      messages: {lcm_bus: lab}\n      motion:", "lab"),
        ("swing:", "swing: {", "cannot read"),
    ],
)
def test_errors_in_a_scenario_are_one_line(small, old, new, message):
    text = small.read_text()
    assert old in text
    small.write_text(text.replace(old, new, 1))
    with pytest.raises((ArgumentError, ModelError)) as found:
        simulate(scenario=load_scenario(small, "swing"), folder=small.parent)
    assert message in str(found.value) and "\n" not in str(found.value)
