"""Drake's scalar types, clones and parameters of Contexts: against differences and closed forms."""

import dataclasses

import numpy as np
import pytest
from pydrake.autodiffutils import (
    AutoDiffXd,
    ExtractGradient,
    ExtractValue,
    InitializeAutoDiff,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import FirstOrderTaylorApproximation

from geodrake import effects
from geodrake.control.systems import EffectForce
from geodrake.effects import JointEffect, Parameter
from geodrake.errors import ArgumentError
from geodrake.inertia import from_spatial_inertia, inertial_parameters
from geodrake.logs.temperatures import Temperatures
from geodrake.model.simulation.scalar_system import scalars
from geodrake.robot.plant import set_inertial_parameters

LINK = SpatialInertia(2.0, [0.02, -0.01, 0.25], UnitInertia.SolidBox(0.2, 0.1, 1.2))
RNG = np.random.default_rng(7)
STATE, EFFORT = RNG.normal(size=6), 5.0 * RNG.normal(size=3)


def arm(*, gravity=True):
    plant, parent = MultibodyPlant(0.0), None
    for i, axis in enumerate(np.eye(3)[[1, 2, 0]]):
        body = plant.AddRigidBody(f"link{i}", LINK)
        X = RigidTransform(RollPitchYaw(0.3 * i, 0.2, 0.0), [0.0, 0.02, 0.3])
        base = plant.world_frame() if parent is None else parent.body_frame()
        mount = plant.AddFrame(FixedOffsetFrame(f"mount{i}", base, X))
        plant.AddJoint(RevoluteJoint(f"joint{i}", mount, body.body_frame(), axis))
        parent = body
    if not gravity:
        plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    return plant


def diagram_with(terms, *, gravity=True):
    """A diagram with the effort as its input, and its EffectForce."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(arm(gravity=gravity))
    force = EffectForce.AddToBuilder(builder, plant, terms, sign_width=0.3)
    force.set_name("effects")
    builder.ExportInput(force.GetInputPort("applied_effort"), "effort")
    return builder.Build(), force


def context_at(diagram, effort=EFFORT):
    context = diagram.CreateDefaultContext()
    count = context.num_continuous_states()
    context.SetContinuousState(np.concatenate([STATE, 0.3 * np.arange(1, count - 5)])[:count])
    context.SetTime(0.7)
    diagram.get_input_port(0).FixValue(context, effort)
    return context


def rates(diagram, context, state):
    context.SetContinuousState(state)
    return diagram.EvalTimeDerivatives(context).CopyToVector()


def slopes(function, x, h=1e-6):
    return np.stack([(function(x + e) - function(x - e)) / (2 * h) for e in h * np.eye(len(x))], 1)


SPRING = [
    (effects.JointElasticity("joint1"), [1e-3]),
    (effects.RotorInertia("joint1"), [0.3]),
    (effects.ViscousFriction("joint1"), [0.8]),
    (effects.LoadDependentFriction("joint1"), [0.1]),
    (effects.Payload("link2"), from_spatial_inertia(LINK)),
]
MANY = [
    (effects.ViscousFriction("joint0"), [0.5]),
    (effects.CoulombFriction("joint1"), [1.0]),
    (effects.StribeckFriction("joint2", 0.4), [1.0]),
    (effects.AsymmetricFriction("joint0"), [0.4, 0.6, 0.1, 0.2]),
    (effects.LoadDependentFriction("joint0"), [0.15]),
    (effects.GearEfficiency("joint1"), [0.2, 0.1]),
    (effects.JointSpring("joint2"), [2.0, 0.3]),
    (effects.TorqueRipple("joint0", 9.5), [0.2, 0.3]),
    (effects.CoupledFriction(("joint1", "joint2")), [0.3, 0.2]),
    (effects.CoupledRotorInertia(("joint1", "joint2")), [0.05]),
    (effects.RotorInertia("joint2"), [0.2]),
    (effects.FrictionDrift("joint1", 3.0), [0.5, 0.2]),
    (effects.ThermalFriction("joint2", 25.0), [-0.02, -0.01]),
    (effects.Hysteresis("joint0", 0.05), [0.7]),
    (effects.GravityTilt(), [0.03, -0.02]),
    (effects.AerodynamicDrag("link2"), [0.4, 0.1, 0.0, 0.05]),
    (effects.EffortScale("joint2"), [0.2]),
    (effects.Payload("link1"), from_spatial_inertia(LINK)),
]
PLAY = [(effects.Backlash("joint0", 0.1), [0.5]), (effects.RotorInertia("joint0"), [0.2])]


@pytest.mark.parametrize("terms", [MANY, SPRING, PLAY], ids=["many", "spring", "play"])
def test_linear_dynamics_are_those_of_differences(terms):
    diagram, _ = diagram_with(terms)
    context = context_at(diagram)
    start = context.get_continuous_state_vector().CopyToVector()
    linear = FirstOrderTaylorApproximation(diagram, context)
    expected = slopes(lambda x: rates(diagram, context, x), start)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(linear.A(), expected, atol=1e-7 * scale, rtol=1e-6)

    def of_effort(u):
        return rates(diagram, context_at(diagram, u), start)

    np.testing.assert_allclose(linear.B(), slopes(of_effort, EFFORT), atol=1e-6 * scale)


@pytest.mark.parametrize("terms", [MANY, SPRING], ids=["many", "spring"])
def test_slopes_with_effect_parameters(terms):
    force = EffectForce(arm(), terms, sign_width=0.3)
    smooth = force.ToAutoDiffXd()
    mu = force.law.mu

    def output(system, values):
        context = system.CreateDefaultContext()
        scalar = float if system is force else AutoDiffXd
        system.GetInputPort("state").FixValue(context, scalars(STATE, scalar))
        system.GetInputPort("applied_effort").FixValue(context, scalars(EFFORT, scalar))
        count = context.num_continuous_states()
        own = 0.02 * np.arange(1, count + 1)
        context.SetContinuousState(scalars(own, scalar))
        context.get_mutable_numeric_parameter(0).SetFromVector(values)
        return system.GetOutputPort("generalized_force").Eval(context)

    found = ExtractGradient(output(smooth, InitializeAutoDiff(mu).ravel()))
    expected = slopes(lambda x: output(force, x), mu)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_effects_that_are_no_formula_have_derivatives():
    @dataclasses.dataclass(frozen=True)
    class Branching(JointEffect):
        name = "branching"
        parameters = (Parameter("size", "N·m"),)
        depends_on = frozenset({"v"})

        def columns(self, joint):
            return [np.array([v if v > 0 else 0.0 for v in joint.v])]

    smooth = EffectForce(arm(), [(Branching("joint0"), [1.0])]).ToAutoDiffXd()
    context = smooth.CreateDefaultContext()
    smooth.GetInputPort("state").FixValue(context, InitializeAutoDiff(np.ones(6)).ravel())
    found = ExtractGradient(smooth.GetOutputPort("generalized_force").Eval(context))
    np.testing.assert_allclose(found, np.diag([-1.0, 0.0, 0.0], 3)[:3], atol=1e-9)


def test_parameters_of_a_context_count():
    """New inertias and effects without a new diagram, as if it had been built with them."""
    rotor, wet = effects.RotorInertia("joint1"), effects.ViscousFriction("joint0")
    diagram, force = diagram_with([(rotor, [0.1]), (wet, [0.5])])
    context = context_at(diagram)
    own, plant = force.GetMyMutableContextFromRoot(context), force.law.plant.plant
    phi = 1.3 * inertial_parameters(plant)
    force.set_effect_parameters(own, {rotor: [0.4], wet: [0.9]})
    force.set_inertial_parameters(own, phi)
    set_inertial_parameters(plant, plant.GetMyMutableContextFromRoot(context), phi)
    np.testing.assert_array_equal(force.effect_parameters(own, rotor), [0.4])
    found = diagram.EvalTimeDerivatives(context).CopyToVector()

    builder = DiagramBuilder()
    built = builder.AddSystem(arm())
    fresh = EffectForce.AddToBuilder(
        builder, built, [(rotor, [0.4]), (wet, [0.9])], sign_width=0.3, phi=phi
    )
    builder.ExportInput(fresh.GetInputPort("applied_effort"), "effort")
    other = builder.Build()
    expected = context_at(other)
    set_inertial_parameters(built, built.GetMyMutableContextFromRoot(expected), phi)
    np.testing.assert_allclose(
        found, other.EvalTimeDerivatives(expected).CopyToVector(), rtol=1e-12
    )


def test_parameters_that_cannot_be_are_refused():
    wet, spring = effects.ViscousFriction("joint0"), effects.JointElasticity("joint1")
    force = EffectForce(arm(), [(wet, [0.5]), (spring, [1e-3])])
    context = force.CreateDefaultContext()
    with pytest.raises(ArgumentError, match="viscous_friction at joint0 have viscous = -1"):
        force.set_effect_parameters(context, {wet: [-1.0]})
    with pytest.raises(ArgumentError, match="no viscous_friction of joint2"):
        force.set_effect_parameters(context, {effects.ViscousFriction("joint2"): [1.0]})
    with pytest.raises(ArgumentError, match="'joint1' was made soft"):
        force.set_effect_parameters(context, {spring: [0.0]})


def test_a_joint_without_a_temperature_is_as_warm_as_its_reference():
    """In floats and in AutoDiff alike; the other joint has a course."""
    times, warmth = np.array([0.0, 10.0]), np.array([40.0, 40.0])
    terms = [(effects.ThermalFriction(f"joint{i}", 25.0), [-0.02, -0.01]) for i in (1, 2)]
    temperatures = Temperatures({"joint2": (times, warmth)})
    force = EffectForce(arm(), terms, sign_width=0.05, temperatures=temperatures)
    found = []
    for system, scalar in ((force, float), (force.ToAutoDiffXd(), AutoDiffXd)):
        context = system.CreateDefaultContext()
        for port, values in ((0, STATE), (1, EFFORT)):
            numbers = values if scalar is float else scalars(values, scalar)
            system.get_input_port(port).FixValue(context, numbers)
        forces = system.get_output_port(0).Eval(context)
        found.append(forces if scalar is float else ExtractValue(forces).ravel())
    assert found[0][1] == 0.0 != found[0][2]
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)
