"""What exports are compared with: the model as it is simulated here, and every effect there is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_motions import instances
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from geodrake.control.export_proof import export_to
from geodrake.control.export_proof.engines import MujocoEngine
from geodrake.control.export_proof.formats import FORMATS
from geodrake.control.export_proof.held import held_by
from geodrake.control.export_proof.reference import STEP, Start, random_motion, roll_out_all
from geodrake.effects import (
    CoulombFriction,
    FittedEffect,
    JointSpring,
    Payload,
    RotorInertia,
    ViscousFriction,
)
from geodrake.inertia import from_mass_com_inertia
from geodrake.model import load_model

MJCF = """<mujoco><worldbody><body name="one"><joint name="shoulder" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <body name="two"><joint name="elbow" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""
MODEL = Path(__file__).parents[2] / "models" / "double_pendulum.urdf"

CHAIN = """<robot name="chain"><link name="base"/>{links}</robot>"""
LINK = """<link name="{0}"><inertial><origin xyz="0 0.02 0.2"/><mass value="2"/>
  <inertia ixx="0.05" iyy="0.05" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{1}" type="revolute"><parent link="{2}"/><child link="{0}"/><axis xyz="{3}"/>
  <origin xyz="0 0 0.4"/><limit lower="-2" upper="2" effort="90" velocity="1.5"/></joint>"""


@pytest.fixture
def chain(tmp_path):
    """A robot with the joints and the hand that the instances of effects name."""
    names = ("arm", "shoulder", "base", "0 1 0"), ("forearm", "elbow", "arm", "1 0 0")
    links = "".join(LINK.format(*n) for n in (*names, ("hand", "wrist", "forearm", "0 0 1")))
    path = tmp_path / "chain.urdf"
    path.write_text(CHAIN.format(links=links))
    return load_model(path)


def test_rollouts_are_those_of_the_simulated_model():
    """By Drake's integrator at a tight accuracy."""
    model = load_model(MODEL)
    a, b = model.joints
    payload = from_mass_com_inertia(0.3, np.array([0.0, 0.0, -0.1]), 1e-3 * np.eye(3))
    smooth = (
        FittedEffect(ViscousFriction(a), np.array([0.2])),
        FittedEffect(RotorInertia(b), np.array([0.02])),
        FittedEffect(JointSpring(b, center=0.4), np.array([1.5, 0.0])),
        FittedEffect(Payload(model.bodies[-1]), payload),
    )
    dry = FittedEffect(CoulombFriction(a), np.array([0.5]))
    model = replace(model, effects=(*smooth, dry))
    effort = np.array([0.4, -0.2])
    start = Start(np.array([0.3, -0.5]), np.array([0.7, 1.1]), np.tile(effort, (200, 1)))
    (ours,) = roll_out_all(model, [start], STEP)

    builder = DiagramBuilder()
    robot = replace(model, effects=smooth).add_to_builder(builder)
    source = builder.AddSystem(ConstantVectorSource(effort))
    builder.Connect(source.get_output_port(), robot.effort)
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    robot.set_inertias(root)
    robot.set_state(root, start.q, start.v)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 1e-3)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.AdvanceTo(0.2)
    there = robot.plant.GetPositions(robot.plant.GetMyContextFromRoot(root))
    np.testing.assert_allclose(ours[-1], there, atol=1e-8)
    assert np.abs(ours[-1] - ours[0]).min() > 0.05


def with_value(effect):
    values = np.full(len(effect.parameters), 0.1)
    if effect.name == "payload":
        values = from_mass_com_inertia(0.5, np.array([0.1, 0, 0]), 0.01 * np.eye(3))
    return FittedEffect(effect, values)


def test_every_effect_is_held_or_named(chain):
    held = {"viscous_friction", "coulomb_friction", "rotor_inertia", "payload"}
    late, tilted = {"effort_delay"}, {"gravity_tilt"}
    more = {"urdf": set(), "sdf": set(), "isaac": late, "mjcf": late | tilted, "drake": tilted}
    assert FORMATS.keys() - more.keys() == {"python", "cpp", "ros2"}  # which have all of them
    motion = random_motion(chain)[:300]
    for effect in instances():
        model = replace(chain, effects=(with_value(effect),))
        for name, others in more.items():
            found = held_by(model, FORMATS[name].holding(model), [motion])
            assert {lost.effect for lost in found.lost} == {effect.name} - held - others


def test_all_effects_at_once(chain, tmp_path):
    model = replace(chain, effects=tuple(map(with_value, instances())))
    found = export_to("mjcf", model, tmp_path / "out")
    assert len(found.lacks) > 15
    assert len(found.proof.differences) == 2
    assert all(difference.is_rounding for difference in found.proof.differences)


def test_a_function_in_python_is_the_model(chain, tmp_path):
    elbow = chain.joints[1]
    effects = (
        FittedEffect(ViscousFriction(elbow), np.array([0.7])),
        FittedEffect(JointSpring(elbow, 3, 0.2), np.array([4.0, 0.1])),
    )
    proven = export_to("python", replace(chain, effects=effects), tmp_path / "there")
    (difference,) = proven.proof.differences
    assert difference.is_rounding and difference.compared == 1.0
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["chain_effort.py"]


def test_what_mujoco_warns_of_is_no_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "two.xml"
    file.write_text(MJCF, encoding="utf-8")
    engine = MujocoEngine(file, load_model(MODEL))
    engine.roll_out(np.zeros(2), np.zeros(2), np.full((3, 2), 1e30), 1e-3)
    (said,) = engine.messages
    assert "The simulation is unstable" in said
    assert [path.name for path in tmp_path.iterdir()] == ["two.xml"]
    assert capfd.readouterr().err == ""
