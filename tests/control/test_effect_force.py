"""Effects in Drake simulations, against closed forms, SciPy and Drake's own inertias."""

import numpy as np
import pytest
from adaptive_loops import fixed
from link_chains import LINK, arm
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.math import RollPitchYaw
from pydrake.multibody.tree import SpatialInertia, UnitInertia, default_model_instance
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import FirstOrderTaylorApproximation, LogVectorOutput, Sine
from scipy.integrate import solve_ivp

from geodrake import effects
from geodrake.control import DelayedEffort, EffectForce
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import from_spatial_inertia, inertial_parameters
from geodrake.logs.temperatures import Temperatures
from geodrake.model.simulation.scalar_system import scalars
from geodrake.robot import KinematicTree, inverse_dynamics_regressor
from geodrake.robot.plant import set_inertial_parameters

TOOL = SpatialInertia(0.7, [0.01, 0.02, 0.05], UnitInertia.SolidBox(0.2, 0.3, 0.4))


def acceleration(plant, q, v, u, terms=(), **options):
    """Return v̇ of a plant that carries effects, by the plant's own dynamics."""
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    if terms:
        force = EffectForce.AddToBuilder(builder, plant, terms, **options)
        builder.ExportInput(force.GetInputPort("applied_effort"), "effort")
        builder.ConnectInput("effort", plant.get_actuation_input_port())
    else:
        builder.ExportInput(plant.get_actuation_input_port(), "effort")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.get_input_port(0).FixValue(context, u)
    plant_context = plant.GetMyContextFromRoot(context)
    plant.SetPositionsAndVelocities(plant_context, np.concatenate([q, v]))
    port = plant.get_generalized_acceleration_output_port(default_model_instance())
    return port.Eval(plant_context)


STATES = [np.random.default_rng(seed).normal(size=(3, 3)) for seed in range(2)]


class TestExactDynamics:
    def test_payload_on_a_welded_tool(self):
        loaded, payload = arm(weld_tool=True), effects.Payload("tool")
        for q, v, u in STATES:
            terms = [(payload, from_spatial_inertia(TOOL))]
            with_effect = acceleration(arm(weld_tool=True), q, v, u, terms)
            context = loaded.CreateDefaultContext()
            loaded.SetPositionsAndVelocities(context, np.concatenate([q, v]))
            loaded.GetBodyByName("tool").SetSpatialInertiaInBodyFrame(context, TOOL)
            loaded.get_actuation_input_port().FixValue(context, u)
            expected = loaded.get_generalized_acceleration_output_port(default_model_instance())
            np.testing.assert_allclose(with_effect, expected.Eval(context), rtol=1e-9)

    def test_effort_of_all_effects_is_what_their_regressors_say(self):
        terms = [
            (effects.ViscousFriction("joint1"), [0.5]),
            (effects.CoulombFriction("joint2"), [1.0]),
            (effects.LoadDependentFriction("joint1"), [0.15]),
            (effects.LoadDependentFriction("joint3"), [0.1]),
            (effects.JointSpring("joint3"), [2.0, 0.3]),
            (effects.GravityCompensator("joint2"), [1.5, -0.4]),
            (effects.TorqueRipple("joint1", 9.5), [0.2, 0.3]),
            (effects.CoupledFriction(("joint2", "joint3")), [0.3, 0.2]),
            (effects.CoupledRotorInertia(("joint2", "joint3")), [0.05]),
            (effects.RotorInertia("joint3"), [0.2]),
            (effects.Payload("link3"), from_spatial_inertia(TOOL)),
            (effects.GravityTilt(), [0.03, -0.02]),
            (effects.AerodynamicDrag("link3"), [0.4, 0.1, 0.0, 0.05]),
        ]
        plant = arm(damping=0.3)
        for q, v, u in STATES:
            vd = acceleration(arm(damping=0.3), q, v, u, terms, sign_width=0.05)
            context = plant.CreateDefaultContext()
            plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
            M = plant.CalcMassMatrix(context)
            drift = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
            load = M @ vd + drift
            tree, states = KinematicTree.from_plant(plant), [x[None] for x in (q, v, vd)]
            motion = effects.RobotMotion(
                ("joint1", "joint2", "joint3"),
                *states,
                load[None],
                np.full(3, 0.05),
                {"link3": inverse_dynamics_regressor(tree, *states)[:, :, 20:]}.__getitem__,
                RobotBodies(tree, q[None], inertial_parameters(plant)),
            )
            effort = sum(effect.effort(motion, mu)[0] for effect, mu in terms)
            np.testing.assert_allclose(load + 0.3 * v + effort, u, rtol=1e-7, atol=1e-7)


class TestSimulation:
    @pytest.mark.parametrize(("time_step", "tolerance"), [(0.0, 1e-4), (1e-3, 2e-2)])
    def test_pendulum_swings_down_as_scipy_says(self, time_step, tolerance):
        c, F, width = 0.05, 0.3, 1e-2
        plant = arm(dofs=1, time_step=time_step)
        builder = DiagramBuilder()
        builder.AddSystem(plant)
        wet, dry = effects.ViscousFriction("joint1"), effects.CoulombFriction("joint1")
        terms = [(wet, [c]), (dry, [F])]
        EffectForce.AddToBuilder(builder, plant, terms, sign_width=width)
        logger = LogVectorOutput(plant.get_state_output_port(), builder, 0.02)
        simulator = Simulator(builder.Build())
        context = simulator.get_mutable_context()
        plant.SetPositions(plant.GetMyContextFromRoot(context), [2.0])
        simulator.get_mutable_integrator().set_target_accuracy(1e-7)
        simulator.AdvanceTo(4.0)
        log = logger.FindLog(context)

        phi = from_spatial_inertia(LINK)
        g = plant.gravity_field().gravity_vector()[2]
        tilt = RollPitchYaw(0.0, 0.2, 0.0).ToRotationMatrix().matrix()

        def derivative(_, x):
            c_q, s_q = np.cos(x[0]), np.sin(x[0])
            turn = tilt @ np.array([[c_q, 0, s_q], [0, 1, 0], [-s_q, 0, c_q]])
            gravity = np.cross(turn @ phi[1:4], [0, 0, g]) @ tilt[:, 1]
            friction = c * x[1] + F * np.tanh(x[1] / width)
            return [x[1], (gravity - friction) / phi[5]]

        expected = solve_ivp(
            derivative, (0, 4), [2.0, 0.0], "LSODA", log.sample_times(), rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(log.data(), expected.y, atol=tolerance)
        assert np.abs(np.diff(log.data()[0])).sum() > 2.0


class TestSystem:
    def test_users_effect_that_says_nothing_of_time(self):
        """It gets the time as do effects of the catalogue that declare it."""

        class Fading(effects.JointEffect):
            name = "fading"
            parameters = (effects.Parameter("size", "N·m"),)

            def columns(self, joint):
                raise NotImplementedError

            def rows(self, motion):
                joint = motion.joint("joint2")
                left = 0.0 if motion.time is None else np.exp(-motion.time / 2.0)
                column = left * joint.v + 1e-12 * (joint.vd + joint.load)
                return {"joint2": column[:, None]}

        system = EffectForce(arm(), [(Fading("joint2"), [0.5])])
        state = [0.1, 0.2, 0.3, 0.4, -0.5, 0.6]
        context = fixed(system, state=state, applied_effort=np.zeros(3))
        for time in (0.0, 1.0, 7.0):
            context.SetTime(time)
            np.testing.assert_allclose(
                system.get_output_port().Eval(context),
                [0.0, 0.25 * np.exp(-time / 2.0), 0.0],
                atol=1e-9,
            )

    @pytest.mark.parametrize(
        ("effect", "mu", "message"),
        [
            (effects.CoulombFriction("knee"), [1.0], "no joint 'knee'"),
            (effects.Payload("hand"), [1.0, 0, 0, 0, 1, 1, 1, 0, 0, 0], "no moving body 'hand'"),
            (effects.CoulombFriction("joint1"), [1.0, 2.0], r"friction of joint1 must be \(1,\)"),
            (effects.CoulombFriction("joint1"), [np.nan], "has nan"),
            (effects.EffortDelay(0.01), [], "DelayedEffort"),
        ],
    )
    def test_bad_effects(self, effect, mu, message):
        with pytest.raises(ArgumentError, match=message):
            EffectForce(arm(), [(effect, mu)])

    def test_self_locking_gear(self):
        q, v, u = STATES[1]
        terms = [(effects.LoadDependentFriction("joint1"), [5.0])]
        with pytest.raises(ModelError, match="does not converge"):
            acceleration(arm(), q, v, -u, terms)
        acceleration(arm(), q, v, u, terms)  # it drives


def test_every_effort_has_its_delay():
    delays = np.array([0.0, 0.001, 0.0123, 0.02])
    builder = DiagramBuilder()
    source = builder.AddSystem(Sine(2.0, 10.0, 0.5, len(delays)))
    system = builder.AddSystem(DelayedEffort(delays, period=1e-3))
    builder.Connect(source.get_output_port(0), system.get_input_port())
    simulator = Simulator(builder.Build())
    context = system.GetMyContextFromRoot(simulator.get_mutable_context())
    for t in (0.0, 0.01, 0.03, 0.1234567, 0.2000003, 0.3):
        simulator.AdvanceTo(t)
        expected = 2.0 * np.sin(10.0 * np.maximum(t - delays, 0.0) + 0.5)
        np.testing.assert_allclose(system.get_output_port().Eval(context), expected, atol=3e-5)


# Slopes, and parameters of Contexts


RNG = np.random.default_rng(7)
STATE, EFFORT = RNG.normal(size=6), 5.0 * RNG.normal(size=3)


def diagram_with(terms):
    """Return a diagram with the effort as its input, and its EffectForce."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(arm())
    force = EffectForce.AddToBuilder(builder, plant, terms, sign_width=0.3)
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
    (effects.JointElasticity("joint2"), [1e-3]),
    (effects.RotorInertia("joint2"), [0.3]),
    (effects.ViscousFriction("joint2"), [0.8]),
    (effects.LoadDependentFriction("joint2"), [0.1]),
    (effects.Payload("link3"), from_spatial_inertia(LINK)),
]
MANY = [
    (effects.ViscousFriction("joint1"), [0.5]),
    (effects.CoulombFriction("joint2"), [1.0]),
    (effects.StribeckFriction("joint3", 0.4), [1.0]),
    (effects.AsymmetricFriction("joint1"), [0.4, 0.6, 0.1, 0.2]),
    (effects.LoadDependentFriction("joint1"), [0.15]),
    (effects.GearEfficiency("joint2"), [0.2, 0.1]),
    (effects.JointSpring("joint3"), [2.0, 0.3]),
    (effects.TorqueRipple("joint1", 9.5), [0.2, 0.3]),
    (effects.CoupledFriction(("joint2", "joint3")), [0.3, 0.2]),
    (effects.CoupledRotorInertia(("joint2", "joint3")), [0.05]),
    (effects.RotorInertia("joint3"), [0.2]),
    (effects.FrictionDrift("joint2", 3.0), [0.5, 0.2]),
    (effects.ThermalFriction("joint3", 25.0), [-0.02, -0.01]),
    (effects.Hysteresis("joint1", 0.05), [0.7]),
    (effects.GravityTilt(), [0.03, -0.02]),
    (effects.AerodynamicDrag("link3"), [0.4, 0.1, 0.0, 0.05]),
    (effects.EffortScale("joint3"), [0.2]),
    (effects.Payload("link2"), from_spatial_inertia(LINK)),
]
PLAY = [(effects.Backlash("joint1", 0.1), [0.5]), (effects.RotorInertia("joint1"), [0.2])]


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
        scalar = float if system is force else AutoDiffXd
        state, effort = (scalars(x, scalar) for x in (STATE, EFFORT))
        context = fixed(system, state=state, applied_effort=effort)
        count = context.num_continuous_states()
        own = 0.02 * np.arange(1, count + 1)
        context.SetContinuousState(scalars(own, scalar))
        context.get_mutable_numeric_parameter(0).SetFromVector(values)
        return system.GetOutputPort("generalized_force").Eval(context)

    found = ExtractGradient(output(smooth, InitializeAutoDiff(mu).ravel()))
    expected = slopes(lambda x: output(force, x), mu)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_parameters_of_a_context_count():
    """New inertias and effects in a Context equal a new diagram with them."""
    rotor, wet = effects.RotorInertia("joint2"), effects.ViscousFriction("joint1")
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
    wet, spring = effects.ViscousFriction("joint1"), effects.JointElasticity("joint2")
    force = EffectForce(arm(), [(wet, [0.5]), (spring, [1e-3])])
    context = force.CreateDefaultContext()
    with pytest.raises(ArgumentError, match="viscous_friction at joint1 have viscous = -1"):
        force.set_effect_parameters(context, {wet: [-1.0]})
    with pytest.raises(ArgumentError, match="viscous_friction of joint3 is not in this system"):
        force.set_effect_parameters(context, {effects.ViscousFriction("joint3"): [1.0]})
    with pytest.raises(ArgumentError, match="'joint2' was made elastic"):
        force.set_effect_parameters(context, {spring: [0.0]})


def test_a_joint_without_a_temperature_is_as_warm_as_its_reference():
    """Compare floats and AutoDiff; the other joint has a temperature."""
    times, warmth = np.array([0.0, 10.0]), np.array([40.0, 40.0])
    terms = [(effects.ThermalFriction(f"joint{i}", 25.0), [-0.02, -0.01]) for i in (2, 3)]
    temperatures = Temperatures({"joint3": (times, warmth)})
    force = EffectForce(arm(), terms, sign_width=0.05, temperatures=temperatures)
    found = []
    for system, scalar in ((force, float), (force.ToAutoDiffXd(), AutoDiffXd)):
        state, effort = (x if scalar is float else scalars(x, scalar) for x in (STATE, EFFORT))
        context = fixed(system, state=state, applied_effort=effort)
        forces = system.get_output_port(0).Eval(context)
        found.append(forces if scalar is float else ExtractValue(forces).ravel())
    assert found[0][1] == 0.0 != found[0][2]
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)
