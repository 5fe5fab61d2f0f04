"""A robot as one model instance of a plant: its joints, ports and base."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteSpring
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scenes import PENDULUM, plant_of, scene

from geodrake import load_model
from geodrake.errors import ArgumentError
from geodrake.robot import RobotInstance
from geodrake.robot.robot_instance import add_generalized_force

JOINTS = ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("joints", "actuated"), [(JOINTS, ()), (JOINTS[::-1], JOINTS), (JOINTS, JOINTS[::-1])]
)
def test_ports_have_the_joints_in_the_order_asked_for(joints, actuated):
    """State, acceleration and efforts against the plant's own, joint by joint."""
    builder = DiagramBuilder()
    plant = scene(builder, time_step=0.0, actuated=actuated)
    arm = plant.GetModelInstanceByName("arm")
    ports = RobotInstance(plant, "arm").ports(builder, joints)
    efforts = np.array([1.5, -0.7])
    source = builder.AddSystem(ConstantVectorSource(efforts))
    builder.Connect(source.get_output_port(), ports.effort)
    root = builder.Build().CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    of_joints = [plant.GetJointByName(joint, arm) for joint in joints]
    for k, joint in enumerate(of_joints):
        joint.set_angle(context, 0.3 + k)
        joint.set_angular_rate(context, -1.0 - k)
    at = [joint.velocity_start() for joint in of_joints]

    def value(port):
        return port.Eval(port.get_system().GetMyContextFromRoot(root))

    np.testing.assert_allclose(value(ports.state), [0.3, 1.3, -1.0, -2.0])
    applied = np.zeros(plant.num_velocities())
    applied[at] = efforts
    M = plant.CalcMassMatrix(context)
    rest = plant.CalcGravityGeneralizedForces(context) - plant.CalcBiasTerm(context)
    expected = np.linalg.solve(M, applied + rest)
    np.testing.assert_allclose(value(ports.acceleration), expected[at], rtol=1e-9)
    whole = plant.get_generalized_acceleration_output_port()
    np.testing.assert_allclose(value(whole), expected, rtol=1e-9, atol=1e-9)


def test_a_state_is_set_and_nothing_else_moves():
    plant = plant_of()
    context = plant.CreateDefaultContext()
    before = plant.GetPositionsAndVelocities(context)
    robot = RobotInstance(plant, "arm")
    robot.set_state(context, JOINTS[::-1], [0.1, 0.2, 0.3, 0.4])
    changed = np.flatnonzero(plant.GetPositionsAndVelocities(context) != before)
    q = robot.positions(JOINTS)
    v = plant.num_positions() + robot.velocities
    assert set(changed) == {*q, *v}
    np.testing.assert_allclose(plant.GetPositions(context)[q], [0.2, 0.1])


def test_forces_on_a_plant_add_up_however_many_come():
    builder = DiagramBuilder()
    plant = scene(builder)
    rng = np.random.default_rng(0)
    forces = rng.normal(size=(3, plant.num_velocities()))
    for force in forces:
        source = builder.AddSystem(ConstantVectorSource(force))
        add_generalized_force(builder, plant, source.get_output_port())
    root = builder.Build().CreateDefaultContext()
    port = plant.get_applied_generalized_force_input_port()
    found = port.Eval(plant.GetMyContextFromRoot(root))
    np.testing.assert_allclose(found, forces.sum(0), atol=1e-14)


def test_forces_that_are_an_input_of_the_diagram_stay_so():
    builder = DiagramBuilder()
    plant = scene(builder)
    builder.ExportInput(plant.get_applied_generalized_force_input_port(), "force")
    with pytest.raises(ArgumentError, match="before ExportInput"):
        RobotInstance(plant, "arm").ports(builder, JOINTS)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hand", "no model instance 'hand'. It has table, other, crate, arm"),
        ("table", "Model instance 'table' has no moving joint"),
    ],
)
def test_what_is_no_robot_is_refused(name, message):
    with pytest.raises(ArgumentError, match=message):
        RobotInstance(plant_of(), name)


@pytest.mark.parametrize(("name", "found"), [("arm", True), ("other", False), (None, True)])
def test_springs_at_joints_of_the_robot_are_terms_of_its(name, found):
    plant = plant_of(finalize=False)
    arm = plant.GetModelInstanceByName("arm")
    plant.AddForceElement(RevoluteSpring(plant.GetJointByName("elbow", arm), 0.1, 3.0))
    plant.Finalize()
    assert RobotInstance(plant, name).stated_terms == (("springs",) if found else ())


@pytest.mark.parametrize(
    ("name", "joints", "actuated", "message"),
    [
        ("arm", ("shoulder", "wrist"), (), "moves shoulder, elbow, but the controller"),
        (None, JOINTS, (), "RobotInstance"),
        ("crate", ("crate",), (), "but the controller crate"),
        ("arm", JOINTS, ("elbow",), "none at shoulder"),
    ],
)
def test_robots_that_do_not_fit_are_refused(name, joints, actuated, message):
    builder = DiagramBuilder()
    plant = scene(builder, actuated=actuated)
    with pytest.raises(ArgumentError, match=message):
        RobotInstance(plant, name).ports(builder, joints)


def test_a_floating_body_is_no_robot_with_joints_of_one_degree():
    robot = RobotInstance(plant_of(), "crate")
    with pytest.raises(ArgumentError, match="has 6 degrees of freedom"):
        robot.positions()


class TestBase:
    """Gravity on the base is what matters to efforts."""

    model = load_model(PENDULUM)

    def check(self, plant, **options):
        RobotInstance(plant, "arm").check_base(self.model.tree, self.model.joints, **options)

    def test_it_may_stand_anywhere_and_be_turned(self):
        turned = RigidTransform(RotationMatrix.MakeZRotation(0.7), [0.2, 0.1, 1.0])
        self.check(plant_of(X_TB=turned))
        with pytest.raises(ArgumentError, match="another orientation"):
            self.check(plant_of(X_TB=turned), turned=True)
        self.check(plant_of(X_TB=RigidTransform([1.0, 0.0, 0.0])), turned=True)

    @pytest.mark.parametrize("angle", [0.01, np.pi])
    def test_it_must_not_lean(self, angle):
        leaning = RigidTransform(RotationMatrix.MakeXRotation(angle), [0.0, 0.0, 1.0])
        with pytest.raises(ArgumentError, match=r"another inclination .* directives"):
            self.check(plant_of(X_TB=leaning))

    def test_gravity_must_be_the_same(self):
        plant = plant_of(finalize=False)
        plant.set_gravity_enabled(plant.GetModelInstanceByName("arm"), False)
        plant.Finalize()
        with pytest.raises(ArgumentError, match=r"\[-?0.0, -?0.0, -?0.0\] m/s² in the plant"):
            self.check(plant)

    def test_it_must_not_move(self):
        plant = MultibodyPlant(0.0)
        (below,) = Parser(plant).AddModels(str(PENDULUM))
        (above,) = Parser(plant, "above").AddModels(str(PENDULUM))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link", below))
        tip = plant.get_body(plant.GetBodyIndices(below)[-1])
        plant.WeldFrames(tip.body_frame(), plant.GetFrameByName("base_link", above))
        plant.Finalize()
        name = plant.GetModelInstanceName(above)
        with pytest.raises(ArgumentError, match=r"base of .* moves"):
            RobotInstance(plant, name).check_base(self.model.tree, self.model.joints)
