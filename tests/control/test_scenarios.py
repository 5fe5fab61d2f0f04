"""Scenario files: read, built, simulated, and driven by messages of LCM."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.common.yaml import yaml_dump_typed
from pydrake.lcm import DrakeLcm, DrakeLcmParams, Subscriber
from pydrake.manipulation import (
    ApplyDriverConfigs,
    IiwaCommandReceiver,
    IiwaControlMode,
    IiwaDriver,
    IiwaStatusSender,
)
from pydrake.multibody.parsing import (
    LoadModelDirectivesFromString,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import ApplyLcmBusConfig, LcmPublisherSystem, LcmSubscriberSystem
from pydrake.trajectories import PiecewisePolynomial
from scenes import MODELS, PENDULUM, SCENES

from geodrake import effects, load_model, save_model
from geodrake.control import (
    ControlModel,
    PassivityBasedAdaptiveController,
    VaryingGains,
    add_adaptive_loop,
)
from geodrake.control.scenes import (
    IiwaCommandWriter,
    IiwaMessages,
    IiwaStatusReader,
    Scenario,
    build_scene,
    iiwa_ports,
    load_scenario,
    run,
    write_logs,
)
from geodrake.control.scenes.iiwa_messages import command_of, state_of
from geodrake.effects import FittedEffect
from geodrake.errors import ArgumentError, ConvergenceError, ModelError
from geodrake.logs.files import read_log

WORKCELL = SCENES / "workcell.yaml"
NAMES = ("push", "carry", "messages", "controller")

SMALL = """
swing:
  simulation_duration: 0.1
  log_period: 0.01
  packages: {models: MODELS}
  directives:
    - add_model: {name: arm, file: package://models/double_pendulum.urdf}
    - add_weld: {parent: world, child: arm::base_link}
  lcm_buses: {default: {lcm_url: "memq://"}}
  robots:
    arm:
      controller: !PassivityControl
        {model: MODELS/double_pendulum.urdf, gamma: 30.0, rate: 10.0, factor: 1.2}
      motion: !Waypoints
        times: [0.0, 1.0, 2.0]
        positions: {shoulder: [0.1, 0.4, 0.1]}
      log: LOG
""".replace("MODELS", str(MODELS))


@pytest.fixture
def small(tmp_path):
    """A scenario of the pendulum alone, in a file."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL.replace("LOG", str(tmp_path / "arm.csv")))
    return path


def written(tmp_path, scenario, name="again"):
    """A scenario in a file of its own."""
    path = tmp_path / f"{name}.yaml"
    path.write_text(yaml_dump_typed(scenario, child_name=name))
    return path


class TestFiles:
    @pytest.mark.parametrize("name", NAMES)
    def test_a_scenario_comes_back_as_it_was_written(self, tmp_path, name):
        scenario = load_scenario(WORKCELL, name)
        again = load_scenario(written(tmp_path, scenario))
        assert yaml_dump_typed(again) == yaml_dump_typed(scenario)

    def test_what_is_left_out_is_the_default(self, tmp_path):
        path = tmp_path / "little.yaml"
        path.write_text("little: {simulation_duration: 2.0}")
        expected = Scenario(simulation_duration=2.0)
        assert yaml_dump_typed(load_scenario(path)) == yaml_dump_typed(expected)

    def test_paths_are_those_from_the_folder_of_the_file(self):
        scenario = load_scenario(WORKCELL, "push")
        assert Path(scenario.robots["arm"].controller.model).samefile(MODELS / "arm7.urdf")
        assert Path(scenario.packages["scenes"]).samefile(SCENES)


class TestRun:
    def test_a_robot_follows_its_motion_and_is_logged(self, small):
        done = run(scenario=load_scenario(small))
        robot = done.robots["arm"]
        assert robot.joints == ("shoulder", "elbow")
        np.testing.assert_allclose(robot.time, np.linspace(0.0, 0.1, 11))
        np.testing.assert_allclose(robot.desired_state[0], [0.1, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(robot.error[0], 0.0, atol=1e-12)
        assert 0.0 < robot.rms() < 0.02
        (path,) = write_logs(done)
        log = read_log(path, joints=robot.joints)
        np.testing.assert_allclose(log.position, robot.state[:, :2])
        np.testing.assert_allclose(log.effort, robot.effort)

    def test_the_seed_decides_the_first_estimate(self, small):
        scenario = load_scenario(small)
        scenario.robots["arm"].controller.mass_uncertainty = 0.1
        starts = []
        for seed in (0, 0, 1):
            scenario.random_seed = seed
            controller = build_scene(scenario=scenario).robots["arm"].loop.controller
            starts.append(controller.parameters(controller.CreateDefaultContext()))
        np.testing.assert_array_equal(starts[0], starts[1])
        assert np.abs(starts[2] - starts[0]).max() > 1e-3

    def test_a_saved_model_moves_with_its_inertias_and_effects(self, small, tmp_path):
        """As the pendulum of the same numbers in a diagram of its own."""
        model = load_model(PENDULUM)
        friction = FittedEffect(effects.ViscousFriction("elbow"), np.array([0.7]))
        model = type(model)(**{**vars_of(model), "phi": 1.3 * model.phi, "effects": (friction,)})
        save_model(model, tmp_path / "fitted.yaml")
        scenario = load_scenario(small)
        spec = scenario.robots["arm"]
        spec.model, spec.controller, spec.motion = str(tmp_path / "fitted.yaml"), None, None
        scenario.initial_position = {"arm": {"shoulder": np.array([0.5]), "elbow": np.array([0.2])}}
        state = run(scenario=scenario).robots["arm"].state
        builder = DiagramBuilder()
        robot = model.add_to_builder(builder, time_step=scenario.plant_config.time_step)
        simulator = Simulator(builder.Build())
        robot.set_state(simulator.get_mutable_context(), [0.5, 0.2])
        simulator.AdvanceTo(0.1)
        context = robot.plant.GetMyContextFromRoot(simulator.get_context())
        expected = robot.plant.GetPositionsAndVelocities(context)
        np.testing.assert_allclose(state[-1], expected, rtol=1e-5, atol=1e-6)

    def test_links_of_soft_joints_begin_where_their_load_has_them(self, small, tmp_path):
        """As by `RobotInDiagram.set_state`, in a diagram of the model's own."""
        soft = FittedEffect(effects.JointElasticity("elbow"), np.array([2e-3]))
        model = replace(load_model(PENDULUM), effects=(soft,))
        save_model(model, tmp_path / "soft.yaml")
        scenario = load_scenario(small)
        spec = scenario.robots["arm"]
        spec.model, spec.controller, spec.motion = str(tmp_path / "soft.yaml"), None, None
        scenario.initial_position = {"arm": {"shoulder": np.array([0.5]), "elbow": np.array([0.2])}}
        scene = build_scene(scenario=scenario)
        links = scene.plant.GetPositions(scene.plant.GetMyContextFromRoot(scene.context()))
        builder = DiagramBuilder()
        robot = model.add_to_builder(builder)
        root = builder.Build().CreateDefaultContext()
        robot.set_state(root, [0.5, 0.2])
        expected = robot.plant.GetPositions(robot.plant.GetMyContextFromRoot(root))
        assert abs(expected[1] - 0.2) > 1e-3
        np.testing.assert_allclose(links, expected, rtol=1e-9)

    def test_a_logged_motion_is_followed(self, small, tmp_path):
        scenario = load_scenario(small)
        write_logs(run(scenario=scenario))
        text = small.read_text()
        start, end = text.index("      motion:"), text.index("      log:")
        follow = "      motion: !LogMotion {file: arm.csv, period: 0.02}\n"
        small.write_text(text[:start] + follow + text[end:].replace("arm.csv", "again.csv"))
        done = run(scenario=load_scenario(small))
        log = read_log(tmp_path / "arm.csv")
        np.testing.assert_allclose(done.robots["arm"].desired_state[:, :2], log.position, atol=1e-3)

    def test_a_crate_is_pushed(self):
        """Contact acts on both: the crate goes, and the arm tracks worse while it pushes."""
        scenario = load_scenario(WORKCELL, "push")
        del scenario.robots["second"]
        arm = scenario.robots["arm"]
        arm.motion.times = [0.0, 0.4]
        for joint, values in arm.motion.positions.items():
            arm.motion.positions[joint] = values[1:3]
        arm.controller.law = "none"
        scenario.simulation_duration = 0.4
        done = run(scenario=scenario)
        plant = done.scene.plant
        crate = plant.GetBodyByName("crate").EvalPoseInWorld(
            plant.GetMyContextFromRoot(done.context)
        )
        assert 0.02 < crate.translation()[0] - 0.16 < 0.2
        error = np.abs(done.robots["arm"].error).max(1)
        assert error[-1] > 3.0 * error[5]


def vars_of(model):
    """Fields of a model."""
    return {name: getattr(model, name) for name in type(model).__dataclass_fields__}


class TestMessages:
    def test_a_status_is_read_as_drake_writes_it(self):
        lcm, n = DrakeLcm("memq://"), 3
        builder = DiagramBuilder()
        sender = builder.AddSystem(IiwaStatusSender(n))
        publisher = LcmPublisherSystem.Make(
            channel="S", lcm_type=lcmt_iiwa_status, lcm=lcm, use_cpp_serializer=True
        )
        builder.AddSystem(publisher)
        builder.Connect(sender.get_output_port(), publisher.get_input_port())
        for name in ("position_commanded", "position_measured", "torque_commanded"):
            builder.ExportInput(sender.GetInputPort(name), name)
        builder.ExportInput(sender.GetInputPort("velocity_estimated"), "velocity")
        diagram = builder.Build()
        context = diagram.CreateDefaultContext()
        values = np.arange(12.0).reshape(4, 3)
        for port, value in enumerate(values):
            diagram.get_input_port(port).FixValue(context, value)
        subscriber = Subscriber(lcm, "S", lcmt_iiwa_status)
        diagram.ForcedPublish(context)
        lcm.HandleSubscriptions(0)
        assert subscriber.count > 0
        np.testing.assert_array_equal(state_of(subscriber.message, n), [*values[1], *values[3]])
        with pytest.raises(ArgumentError, match="status of 3 joints came; the controller knows 4"):
            state_of(subscriber.message, 4)

    def test_a_command_is_what_drake_reads(self):
        lcm, efforts = DrakeLcm("memq://"), [1.5, -2.0, 0.25]
        builder = DiagramBuilder()
        subscriber = builder.AddSystem(
            LcmSubscriberSystem.Make(
                channel="C", lcm_type=lcmt_iiwa_command, lcm=lcm, use_cpp_serializer=True
            )
        )
        receiver = builder.AddSystem(IiwaCommandReceiver(3, IiwaControlMode.kTorqueOnly))
        builder.Connect(subscriber.get_output_port(), receiver.GetInputPort("lcmt_iiwa_command"))
        diagram = builder.Build()
        sent = command_of(0.25, efforts)
        lcm.Publish("C", sent.encode())
        simulator = Simulator(diagram)
        lcm.HandleSubscriptions(0)
        simulator.Initialize()
        context = receiver.GetMyContextFromRoot(simulator.get_context())
        np.testing.assert_array_equal(receiver.GetOutputPort("torque").Eval(context), efforts)
        assert receiver.GetOutputPort("time").Eval(context) == [0.25]
        again = lcmt_iiwa_command.decode(sent.encode())
        assert list(again.joint_torque) == efforts
        assert again.utime == 250_000

    def test_before_a_status_nothing_is_known_and_no_effort_is_no_number(self):
        reader, writer = IiwaStatusReader(2), IiwaCommandWriter(2)
        context = reader.CreateDefaultContext()
        reader.get_input_port().FixValue(context, lcmt_iiwa_status())
        assert np.isnan(reader.get_output_port().Eval(context)).all()
        context = writer.CreateDefaultContext()
        writer.get_input_port().FixValue(context, [np.nan, 1.0])
        assert list(writer.get_output_port().Eval(context).joint_torque) == [0.0, 0.0]

    @pytest.mark.parametrize("gravity", ["", str(PENDULUM)])
    def test_a_loop_by_messages_follows_nearly_as_one_of_straight_lines(self, small, gravity):
        """The first efforts are late, and so the arm falls for some steps."""
        scenario = load_scenario(small)
        controller = scenario.robots["arm"].controller
        controller.law, controller.factor = "none", 1.0
        there = run(scenario=scenario).robots["arm"]
        scenario.robots["arm"].messages = IiwaMessages(
            status_period=1e-3, command_period=1e-3, gravity_model=gravity
        )
        here = run(scenario=scenario).robots["arm"]
        assert there.rms() < 1e-3
        assert 0.0 < here.rms() < 5e-3
        np.testing.assert_allclose(here.effort[-1], there.effort[-1], rtol=0.1, atol=0.1)
        assert not here.effort[0].any() or gravity  # which the driver compensates at once

    def test_a_controller_drives_drakes_own_iiwa_driver(self, tmp_path):
        """That of hardware_sim, in torque_only mode, which compensates gravity on its own."""
        path = tmp_path / "arm.urdf"
        path.write_text(with_transmissions((MODELS / "arm7.urdf").read_text()))
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
        lcm = buses.Find("the test", "default")
        messages = IiwaMessages(command_period=1e-3)
        ports = iiwa_ports(builder, model.joints, lcm, messages, gravity_plant=model.plant)
        controller = PassivityBasedAdaptiveController(
            ControlModel.of(model), None, gains=VaryingGains(15.0)
        )
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
        assert np.isfinite(error).all()
        # Where gravity is counted twice, it is 0.05 rad.
        assert np.abs(error).max() < 2e-3

    def test_a_robot_elsewhere_that_is_silent_ends_the_wait(self):
        scenario = load_scenario(WORKCELL, "controller")
        scenario.lcm_buses["default"].lcm_url = "memq://"
        scenario.robots["arm"].messages.patience = 0.01
        with pytest.raises(ConvergenceError, match="ends at 0 s"):
            run(scenario=scenario)


def with_transmissions(urdf):
    """A URDF with an actuator at every revolute joint."""
    names = [part.split('"')[0] for part in urdf.split('<joint name="')[1:]]
    added = "".join(
        f'<transmission name="to_{name}"><type>SimpleTransmission</type><joint name="{name}">'
        "<hardwareInterface>EffortJointInterface</hardwareInterface></joint>"
        f'<actuator name="motor_{name}"/></transmission>'
        for name in names
    )
    return urdf.replace("</robot>", f"{added}</robot>")


WRONG = {
    "an unknown key": ("log_period", "log_periods", "['log_periods'] were unknown"),
    "a word for a number": ("duration: 0.1", "duration: long", "could not convert"),
    "a negative number": ("duration: 0.1", "duration: -1", "must be a finite number above 0"),
    "an endless time": ("duration: 0.1", "duration: .inf", "above 0"),
    "an unknown instance": ("    arm:\n", "    leg:\n", "no model instance 'leg'. They have arm"),
    "an unknown law": ("{model: ", "{law: fast, model: ", 'one of "natural", "pullback"'),
    "a bad factor": ("factor: 1.2", "factor: 0.0", "robots.arm: factor must be"),
    "a bad rate": ("rate: 10.0", "rate: -1.0", "robots.arm: controller: rate must be"),
    "a missing model": ("double_pendulum.urdf, g", "gone.urdf, g", "gone.urdf does not exist"),
    "a missing description": ("models/double_pendulum.urdf}", "models/gone.urdf}", "gone.urdf"),
    "a missing package": ("{models: ", "{models: /nowhere", "package 'models' is not there"),
    "an unknown controller": ("!PassivityControl", "!Magic", "'Magic' did not match"),
    "an unknown joint": ("{shoulder: ", "{knee: ", "robots.arm: motion: The robot has no joint"),
    "times that stand": ("1.0, 2.0]", "2.0, 2.0]", "two times or more, increasing"),
    "too few positions": ("[0.1, 0.4, 0.1]", "[0.1, 0.4]", "positions of shoulder must be (3,)"),
    "a motion alone": ("controller: !PassivityControl\n        {", "#", "needs a motion"),
    "an unknown weld": ("arm::base_link", "arm::foot", "foot"),
    "a list for a map": ("robots:\n", "robots: [1]\nother:\n", "cannot be read"),
    "an integrator": (
        "  log_period",
        "  simulator_config: {integration_scheme: x}\n  log_period",
        "integration_scheme must be one of",
    ),
    "a time step": (
        "  log_period",
        "  plant_config: {time_step: -1.0}\n  log_period",
        "plant_config.time_step",
    ),
    "a contact model": (
        "  log_period",
        "  plant_config: {contact_model: x}\n  log_period",
        "plant_config",
    ),
    "positions of a stranger": (
        "  log_period",
        "  initial_position: {x: {y: [1]}}\n  log_period",
        "no model instance 'x'",
    ),
    "an unknown bus": (
        "      log:",
        "      messages: {lcm_bus: lab}\n      log:",
        "no LCM bus 'lab'",
    ),
    "a channel's period": (
        "      log:",
        "      messages: {status_period: 0}\n      log:",
        "status_period must be",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_in_a_file_is_one_clear_line(small, case):
    old, new, message = WRONG[case]
    text = small.read_text()
    assert old in text
    small.write_text(text.replace(old, new, 1))
    with pytest.raises((ArgumentError, ModelError)) as found:
        run(scenario=load_scenario(small, "swing"))
    assert message in str(found.value)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        (None, None, "does not exist"),
        ("", None, "is empty"),
        ("[1, 2]", None, "no scenarios by their names"),
        ("a: {}\nb: {}", None, "has several scenarios. It has a, b"),
        ("a: {}", "c", "has no scenario 'c'. It has a"),
        ("a: {", None, "not valid YAML"),
        ("a: 3", None, "cannot be read"),
    ],
)
def test_files_without_the_scenario_are_refused(tmp_path, content, name, message):
    path = tmp_path / "some.yaml"
    if content is not None:
        path.write_text(content)
    with pytest.raises((ArgumentError, ModelError), match=message):
        load_scenario(path, name)


MJCF = """<mujoco model="m"><default><default class="thick"><geom density="3000"/>
<joint armature=".1"/></default></default><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<frame pos="0 0 .5" euler="0 0 30"><body name="one" childclass="thick">
<joint name="a" axis="0 1 0" damping=".2"/><geom name="g" type="box" size=".1 .02 .03" pos=".1 0 0"
friction=".7"/><body name="two" pos=".2 0 0"><joint name="b" axis="0 0 1" ref="20"/>
<geom name="h" type="capsule" fromto="0 0 0 .2 0 .1" size=".02"/>
<geom name="look" type="sphere" size=".03" contype="0" conaffinity="0" mass="0"/></body></body>
</frame></worldbody></mujoco>"""


def test_an_mjcf_of_a_scene_is_what_mujoco_makes_of_it(tmp_path):
    file = tmp_path / "m.xml"
    file.write_text(MJCF, encoding="utf-8")
    path = tmp_path / "scene.yaml"
    path.write_text(
        f"""scene:
  directives:
    - add_model: {{name: arm, file: "file://{file}"}}
    - add_model: {{name: crate, file: "file://{SCENES / "crate.sdf"}"}}
""",
        encoding="utf-8",
    )
    scene = build_scene(scenario=load_scenario(path, "scene"))
    root, theirs = scene.context(), mujoco.MjModel.from_xml_path(str(file))
    plant, inspector = scene.plant, scene.scene_graph.model_inspector()
    context, data = plant.GetMyMutableContextFromRoot(root), mujoco.MjData(theirs)
    arm = plant.GetModelInstanceByName("arm")
    q = np.array([0.3, -0.5])
    plant.SetPositions(context, arm, q)
    data.qpos[:] = q
    mujoco.mj_forward(theirs, data)
    query = scene.scene_graph.get_query_output_port().Eval(
        scene.scene_graph.GetMyContextFromRoot(root)
    )
    names = {"one": ["g"], "two": ["h"]}
    for link, own in names.items():
        body = plant.GetBodyByName(link, arm)
        solids = plant.GetCollisionGeometriesForBody(body)
        assert [inspector.GetName(each).rpartition("::")[2] for each in solids] == own
        for each, name in zip(solids, own, strict=True):
            X_WG = query.GetPoseInWorld(each)
            np.testing.assert_allclose(X_WG.translation(), data.geom(name).xpos, atol=1e-12)
    friction = inspector.GetProximityProperties(solids[0]).GetProperty(
        "material", "coulomb_friction"
    )
    assert friction.static_friction() == 1.0
    assert len(plant.GetVisualGeometriesForBody(body)) == 2
    (floor,) = plant.GetCollisionGeometriesForBody(plant.world_body())
    assert inspector.GetName(floor).endswith("arm_floor")
    model = load_model(file)
    own = model.plant.CreateDefaultContext()
    model.plant.SetPositions(own, q)
    at = [plant.GetJointByName(name, arm).velocity_start() for name in ("a", "b")]
    M = plant.CalcMassMatrix(context)[np.ix_(at, at)]
    np.testing.assert_allclose(M, model.plant.CalcMassMatrix(own), rtol=1e-12)
