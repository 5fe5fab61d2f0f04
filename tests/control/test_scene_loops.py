"""Loops of one robot among tables and other robots, and motors that follow a motion."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_loops import MODEL, computed, fixed, motion, natural, passive, pendulum_plant
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import RevoluteSpring
from pydrake.systems.framework import DiagramBuilder
from scenes import PENDULUM, alone, plant_of, scene

from geodrake import effects
from geodrake.control import (
    ControlModel,
    EffectForce,
    PassivityBasedAdaptiveController,
    Safeguards,
    add_adaptive_loop,
)
from geodrake.effects import FittedEffect
from geodrake.errors import ArgumentError
from geodrake.logs.motion import Motion
from geodrake.model import load_model
from geodrake.report import AdaptationView
from geodrake.robot import RobotInstance, RobotPorts, gears, take_out_stated
from geodrake.robot.transmission.schema import Drive

ACTING = [
    (effects.ViscousFriction("shoulder"), [0.4]),
    (effects.CoulombFriction("elbow"), [0.2]),
    (effects.RotorInertia("elbow"), [0.1]),
    (effects.LoadDependentFriction("shoulder"), [0.1]),
    (effects.GravityTilt(), [0.1, -0.05]),
    (effects.Payload("lower_link"), [0.5, 0.01, 0.02, -0.1, 0.05, 0.05, 0.02, 0.0, 0.0, 0.0]),
    (effects.AerodynamicDrag("lower_link"), [0.3, 0.1, 0.0, -0.2]),
]


class TestTracking:
    """A crate that falls onto the table and another robot do not change the arm's loop."""

    @pytest.mark.parametrize(
        ("make", "actuated"), [(passive, ()), (computed, ("elbow", "shoulder"))]
    )
    def test_it_is_that_of_the_robot_alone(self, make, actuated):
        found = []
        for build in (alone, scene):
            builder = DiagramBuilder()
            options = {"actuated": actuated} if build is scene else {}
            plant = build(builder, **options)
            robot = RobotInstance(plant, "arm") if build is scene else plant
            controller, acting = make(natural(0.5)), ACTING[:3]
            loop = add_adaptive_loop(
                builder, robot, controller, motion(), effects=acting, log_period=0.01
            )
            found.append(loop.simulated(builder.Build(), 0.15)[1])
        there, here = found
        assert np.abs(there["state"] - there["desired_state"]).max() > 1e-3
        for name, values in there.items():
            # (Drake's solver of contacts has a tolerance.)
            np.testing.assert_allclose(here[name], values, rtol=1e-6, atol=1e-6)

    def test_a_leaning_base_is_refused_unless_the_model_may_know_of_it(self):
        leaning = RigidTransform(RotationMatrix.MakeXRotation(0.1), [0.0, 0.0, 1.0])
        tilt = FittedEffect(effects.GravityTilt(), np.array([0.1, 0.0]))
        knowing = ControlModel.of(replace(MODEL, effects=(*MODEL.effects, tilt)))
        builder = DiagramBuilder()
        robot = RobotInstance(scene(builder, X_TB=leaning), "arm")
        with pytest.raises(ArgumentError, match="another inclination"):
            add_adaptive_loop(builder, robot, passive(), motion())
        add_adaptive_loop(builder, robot, PassivityBasedAdaptiveController(knowing, None), motion())

    def test_views_of_adaptation_are_for_plants_of_one_robot(self):
        builder = DiagramBuilder()
        robot = RobotInstance(scene(builder), "arm")
        loop = add_adaptive_loop(builder, robot, passive(), motion())
        with pytest.raises(ArgumentError, match="with a single robot"):
            AdaptationView.AddToBuilder(builder, loop, None)

    def test_ports_alone_have_no_effects_and_their_own_joints(self):
        builder = DiagramBuilder()
        ports = RobotInstance(scene(builder), "arm").ports(builder, ("shoulder", "elbow"))
        with pytest.raises(ArgumentError, match="Effects need a plant"):
            add_adaptive_loop(builder, ports, passive(), motion(), effects=ACTING[:1])
        swapped = RobotPorts(ports.joints[::-1], ports.state, None, ports.effort)
        with pytest.raises(ArgumentError, match="The ports have joints elbow, shoulder"):
            add_adaptive_loop(builder, swapped, passive(), motion())


class TestEffectForce:
    """Compare effects of one robot in a plant with a plant of that robot alone."""

    def force(self, plant, robot, q, v, u):
        """Return generalized forces (nv,) at random states of everything else."""
        system = EffectForce(robot, ACTING, sign_width=[0.1, 0.2])
        context = fixed(system, state=[*q, *v], applied_effort=u)
        return system.GetOutputPort("generalized_force").Eval(context)

    def test_it_acts_on_its_robot_as_if_alone_and_on_nothing_else(self):
        rng = np.random.default_rng(5)
        single, plant = alone(DiagramBuilder()), plant_of()
        robot = RobotInstance(plant, "arm")
        q, v, u = rng.normal(size=(3, 2))
        context = plant.CreateDefaultContext()
        velocities = rng.normal(size=plant.num_velocities())
        plant.SetVelocities(context, velocities)
        robot.set_state(context, ("shoulder", "elbow"), [*q, *v])
        efforts = rng.normal(size=plant.num_velocities())
        efforts[robot.velocities] = u
        expected = self.force(single, single, q, v, u)
        there = plant.GetPositions(context), plant.GetVelocities(context), efforts
        found = self.force(plant, robot, *there)
        np.testing.assert_allclose(found[robot.velocities], expected, rtol=1e-8)
        assert not np.delete(found, robot.velocities).any()

    def test_names_are_those_of_the_robot(self):
        plant = plant_of()
        with pytest.raises(ArgumentError, match="elbow"):  # which two robots have
            EffectForce(plant, [(effects.ViscousFriction("elbow"), [0.1])])
        EffectForce(RobotInstance(plant, "other"), [(effects.ViscousFriction("elbow"), [0.1])])
        EffectForce(plant, [(effects.ViscousFriction("arm_elbow"), [0.1])])


class TestFittedModel:
    """Compare `RobotModel.add_to_scene` with `add_to_builder`."""

    def model(self):
        model = load_model(PENDULUM)
        fitted = tuple(
            FittedEffect(effect, np.array(mu)) for effect, mu in ACTING[:3] + ACTING[5:6]
        )
        return replace(model, phi=1.1 * model.phi, effects=fitted)

    def test_it_moves_as_in_a_diagram_of_its_own(self):
        rng = np.random.default_rng(1)
        q, v, u = rng.normal(size=(3, 2))
        accelerations = []
        for within in (False, True):
            builder = DiagramBuilder()
            if within:
                plant = scene(builder, time_step=0.0)
                robot = self.model().add_to_scene(builder, RobotInstance(plant, "arm"))
            else:
                robot = self.model().add_to_builder(builder)
            builder.ExportInput(robot.effort, "effort")
            diagram = builder.Build()
            root = diagram.CreateDefaultContext()
            robot.set_inertias(root)
            robot.set_state(root, q, v)
            diagram.get_input_port(0).FixValue(root, u)
            port = robot.plant.get_generalized_acceleration_output_port()
            found = port.Eval(robot.plant.GetMyContextFromRoot(root))
            accelerations.append(found[robot.robot.velocities])
        np.testing.assert_allclose(accelerations[1], accelerations[0], rtol=1e-8)

    def test_what_other_models_weld_to_it_stays(self):
        """A crate on its last link keeps its mass, which is not in the model."""
        plant = plant_of(finalize=False)
        crate, arm = (plant.GetModelInstanceByName(name) for name in ("crate", "arm"))
        tip = plant.GetBodyByName("lower_link", arm)
        plant.WeldFrames(tip.body_frame(), plant.GetFrameByName("crate", crate))
        plant.Finalize()
        context = plant.CreateDefaultContext()
        phi = self.model().total_phi
        RobotInstance(plant, "arm").set_inertial_parameters(context, phi)
        masses = tip.get_mass(context), plant.CalcTotalMass(context, [crate])
        np.testing.assert_allclose(masses, [phi[-1, 0], 1.2])

    def test_damping_and_rotors_are_taken_out(self):
        plant = plant_of(finalize=False, actuated=("elbow",))
        arm = plant.GetModelInstanceByName("arm")
        for name in ("arm", "other"):
            instance = plant.GetModelInstanceByName(name)
            plant.GetJointByName("elbow", instance).set_default_damping_vector([0.3])
        plant.GetJointActuatorByName("motor_elbow").set_default_rotor_inertia(0.1)
        take_out_stated(plant, "arm")
        plant.Finalize()
        assert RobotInstance(plant, "arm").stated_terms == ()
        assert plant.GetJointByName("elbow", arm).default_damping_vector() == [0.0]
        with pytest.raises(ArgumentError, match=r"Damping of 'other' would .*take_out_stated"):
            self.model().add_to_scene(DiagramBuilder(), RobotInstance(plant, "other"))

    @pytest.mark.parametrize("in_plant", [False, True])
    def test_springs_that_the_plant_keeps_count_once(self, in_plant):
        """Drake cannot remove them; the fitted ones of the model differ."""
        spring = FittedEffect(effects.JointSpring("elbow", center=0.2), np.array([4.0, 0.3]))
        model, q, u = replace(self.model(), effects=(spring,)), [0.4, -0.7], [0.0, 1.0]
        builder = DiagramBuilder()
        plant = scene(builder, time_step=0.0, finalize=False)
        arm = plant.GetModelInstanceByName("arm")
        if in_plant:
            plant.AddForceElement(RevoluteSpring(plant.GetJointByName("elbow", arm), 0.1, 3.0))
        take_out_stated(plant, "arm")
        plant.Finalize()
        robot = model.add_to_scene(builder, RobotInstance(plant, "arm"))
        builder.ExportInput(robot.effort, "effort")
        diagram = builder.Build()
        root = diagram.CreateDefaultContext()
        robot.set_inertias(root)
        robot.set_state(root, q)
        diagram.GetInputPort("effort").FixValue(root, u)
        port = plant.get_generalized_acceleration_output_port()
        found = port.Eval(plant.GetMyContextFromRoot(root))[robot.robot.velocities]
        still = np.zeros((1, 2))
        needed = model.effort(Motion(np.array([q]), still, found[None]))
        np.testing.assert_allclose(needed[0], u, atol=1e-9)

    def test_effects_in_world_axes_want_the_base_as_it_was(self):
        turned = RigidTransform(RotationMatrix.MakeZRotation(0.5), [0.0, 0.0, 1.0])
        model = self.model()
        tilt = FittedEffect(effects.GravityTilt(), np.array([0.1, 0.0]))
        robot = RobotInstance(plant_of(X_TB=turned), "arm")
        with pytest.raises(ArgumentError, match="world axes"):
            replace(model, effects=(tilt,)).add_to_scene(DiagramBuilder(), robot)


def test_a_controller_of_motors_wants_ports_of_motors():
    """Its efforts would act at joints, as motors may have the names of joints."""
    geared = Drive(("shoulder",), ("shoulder",), gears([8.0]))
    model = load_model(PENDULUM, transmission=(geared,))
    controller = PassivityBasedAdaptiveController(ControlModel.of(model), None)
    builder = DiagramBuilder()
    with pytest.raises(ArgumentError, match=r"has a transmission.*add_to_builder"):
        add_adaptive_loop(builder, RobotInstance(scene(builder), "arm"), controller, motion())


def test_effort_limits_of_a_plant_are_by_joint():
    assert np.isinf(Safeguards.of_plant(pendulum_plant()).limits(2)).all()
    plant = pendulum_plant(limits={"shoulder": 5.0, "elbow": 2.0}, reverse=True)
    guards = Safeguards.of_plant(plant, stale_time=0.1)
    assert guards.limits(2).tolist() == [5.0, 2.0]
    assert guards.stale_time == 0.1
