"""A model added to a Drake diagram, against Pinocchio, rollouts and closed forms."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pinocchio as pin
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from geodrake import effects, load_model
from geodrake.control import EffectForce
from geodrake.effects import FittedEffect
from geodrake.errors import ArgumentError, ModelError
from geodrake.logs.motion import Motion

DEMO = files("geodrake") / "demo" / "demo.urdf"

WELDED = """<robot name="r">
  <link name="base"/>
  <link name="arm"><inertial><mass value="2"/><origin xyz="0 0 0.2"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"><inertial><mass value="1"/>
    <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry>SHAPE</geometry></visual></link>
  <joint name="elbow" type="continuous"><parent link="base"/><child link="arm"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="flange" type="fixed"><parent link="arm"/><child link="tool"/>
    <origin xyz="0.1 0 0.4" rpy="0.3 0 0"/></joint>
</robot>"""


def fitted(effect, *parameters):
    return FittedEffect(effect, np.array(parameters))


def rigid():
    """Return the demo's arm with other inertias and a payload, and Pinocchio's model of it."""
    model = load_model(DEMO)
    payload = fitted(effects.Payload(model.bodies[-1]), *(1.5 * model.phi[-1]))
    model = replace(model, phi=1.2 * model.phi, effects=(payload,))
    other = pin.buildModelFromUrdf(str(DEMO))
    for at in range(1, other.njoints):
        phi = model.phi[at - 1] + (at == other.njoints - 1) * payload.parameters
        m, *h, xx, yy, zz, xy, yz, zx = phi
        about_origin = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
        com = np.array(h) / m
        shift = m * (com @ com * np.eye(3) - np.outer(com, com))
        other.inertias[at] = pin.Inertia(m, com, about_origin - shift)
    return model, other


def acceleration(model, q, v, u, **options):
    """Return v̇ in a diagram, from the port of its plant."""
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder, **options)
    builder.ExportInput(robot.effort, "effort")
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    robot.set_state(root, q, v)
    diagram.GetInputPort("effort").FixValue(root, u)
    port = robot.plant.get_generalized_acceleration_output_port()
    return port.Eval(robot.plant.GetMyContextFromRoot(root))


def test_inertias_a_payload_rotors_damping_and_a_gain_are_pinocchios():
    """A joint feels u / (1 + ε) of what is commanded in units of the log."""
    model, other = rigid()
    q, v, u = np.random.default_rng(2).normal(size=(3, 6))
    damping, rotors = np.linspace(1.0, 2.0, 6), np.linspace(0.1, 0.6, 6)
    own = [
        fitted(kind(joint), value)
        for kind, values in ((effects.RotorInertia, rotors), (effects.ViscousFriction, damping))
        for joint, value in zip(model.joints, values, strict=True)
    ]
    gain = fitted(effects.EffortScale("elbow_pitch"), 0.25)
    model = replace(model, effects=(*model.effects, *own, gain))
    other.armature[:] = rotors
    share = np.where(np.array(model.joints) == "elbow_pitch", 1.25, 1.0)
    expected = pin.aba(other, other.createData(), q, v, 10 * u / share - damping * v)
    np.testing.assert_allclose(acceleration(model, q, v, 10 * u), expected, rtol=1e-9)


def with_effects(delay):
    """Return the demo's arm with everything that `EffectForce` and the plant carry, and a delay."""
    model = load_model(DEMO)
    shoulder, elbow, wrist = "shoulder_pitch", "elbow_pitch", model.joints[-1]
    return replace(
        model,
        phi=1.1 * model.phi,
        effects=(
            fitted(effects.Payload(model.bodies[-1]), *model.phi[-1]),
            fitted(effects.CoulombFriction(shoulder), 2.0),
            fitted(effects.ViscousFriction(elbow), 3.0),
            fitted(effects.RotorInertia(wrist), 0.2),
            fitted(effects.EffortDelay(delay)),
        ),
    )


def simulated_log(model, seconds=1.5, period=2e-3):
    """Return a log of efforts of a motion, and of the diagram's motion under them."""
    time = np.arange(0.0, seconds + period / 2, period)
    phase = np.outer(time, np.linspace(2.0, 4.0, 6))
    rates = np.linspace(2.0, 4.0, 6)
    q, v, vd = 0.4 * np.sin(phase), 0.4 * rates * np.cos(phase), -0.4 * rates**2 * np.sin(phase)
    needed = model.effort(Motion(q, v, vd), sign_width=0.05)
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder, sign_width=0.05)
    hold = PiecewisePolynomial.FirstOrderHold(time, needed.T)
    source = builder.AddSystem(TrajectorySource(hold))
    builder.Connect(source.get_output_port(), robot.effort)
    states, efforts = (
        LogVectorOutput(port, builder, period) for port in (robot.state, robot.logged_effort)
    )
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_maximum_step_size(period)
    robot.set_state(simulator.get_mutable_context(), q[0], v[0])
    simulator.AdvanceTo(time[-1])
    root = simulator.get_context()
    state, effort = (sink.FindLog(root).data().T for sink in (states, efforts))
    return time, q, needed, state, effort


@pytest.fixture(scope="module")
def run():
    model = with_effects(0.02)
    return model, *simulated_log(model)


class TestMotion:
    def test_a_delay_is_in_the_logged_effort_alone(self, run):
        _, time, _, needed, _, effort = run
        late = np.array([np.interp(time - 0.02, time, own) for own in needed.T]).T
        np.testing.assert_allclose(effort[1:], late[1:], atol=1e-2 * np.abs(needed).max())


class TestNaturalAttempts:
    def test_a_payload_beside_phi_is_refused(self):
        model = with_effects(0.0)
        with pytest.raises(ArgumentError, match=r"payload of .* would count twice"):
            EffectForce(model.plant, model.effects[:1], phi=model.total_phi)

    def test_a_delay_names_the_way(self):
        model = with_effects(0.01)
        with pytest.raises(ArgumentError, match="add_to_builder"):
            EffectForce(model.plant, model.effects)


class TestFiles:
    def test_shapes_are_shown(self, tmp_path):
        path = tmp_path / "r.urdf"
        path.write_text(WELDED.replace("SHAPE", '<sphere radius="0.1"/>'))
        builder = DiagramBuilder()
        robots = [load_model(path).add_to_builder(builder, scene_graph=True, name="one")]
        scene_graph = robots[0].scene_graph
        robots += [load_model(path).add_to_builder(builder, scene_graph=scene_graph, name="two")]
        inspector = scene_graph.model_inspector()
        assert inspector.num_geometries() == 2
        names = {inspector.GetName(inspector.GetFrameId(g)) for g in inspector.GetAllGeometryIds()}
        assert names == {"r::tool"}
        assert [robot.notes for robot in robots] == [(), ()]
        builder.Build().CreateDefaultContext()

    def test_missing_meshes_are_told(self, tmp_path):
        path = tmp_path / "r.urdf"
        path.write_text(WELDED.replace("SHAPE", '<mesh filename="package://no/where.obj"/>'))
        (note,) = load_model(path).add_to_builder(DiagramBuilder(), scene_graph=True).notes
        assert note.startswith("meshes that are not shown: package://no/where.obj (")


def test_bodies_that_cannot_be():
    model = load_model(DEMO)
    phi = model.phi.copy()
    phi[2, 4:7] *= -1.0
    with pytest.raises(ModelError, match="inertial parameters"):
        replace(model, phi=phi).add_to_builder(DiagramBuilder())
