"""Elastic joints, backlash and gears in simulations, against closed forms and SciPy."""

import dataclasses
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from link_chains import LINK, MOTOR, arm
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import FirstOrderTaylorApproximation, LogVectorOutput, Sine
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from servo_logs import PENDULUM, command
from two_masses import FRICTION, INERTIA, ROTOR, WEIGHT, having, swung

from geodrake import effects, load_model
from geodrake.control import EffectForce, roll_out
from geodrake.control.rollout.passages import Conditions, chosen_passages
from geodrake.control.rollout.simulation import simulations
from geodrake.control.rollout.stepping import Stepping
from geodrake.effects import CoulombFriction, FittedEffect, RotorInertia, ViscousFriction
from geodrake.effects.deflection import Deflection, DeflectionEffect
from geodrake.effects.of_files import SquaredLoadFriction
from geodrake.errors import ArgumentError, ModelError
from geodrake.identification.logs.case import prepare_case
from geodrake.logs import JointLog, Motion
from geodrake.model import EffortSignal
from geodrake.model.admissible import check_effect
from geodrake.model.simulation.effect_force import ForceLaw
from geodrake.model.simulation.terms import PlantMotion, PlantState
from geodrake.robot.robot_instance import add_generalized_force


def soft(stiffness):
    spring = effects.JointElasticity("joint1"), [1.0 / stiffness]
    return [spring, (effects.RotorInertia("joint1"), [MOTOR])]


def driven(plant, terms=None):
    """Return logged states under a sine at both joints, of motors where there are terms."""
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    size = plant.num_velocities()
    efforts = builder.AddSystem(
        Sine([4.0] + [0.0] * (size - 2) + [3.0], [9.0] * size, [0.3] * size)
    )
    port = plant.get_state_output_port()
    if terms is None:
        builder.Connect(
            efforts.get_output_port(0), plant.get_applied_generalized_force_input_port()
        )
    else:
        force = EffectForce.AddToBuilder(builder, plant, terms)
        builder.Connect(efforts.get_output_port(0), force.GetInputPort("applied_effort"))
        add_generalized_force(builder, plant, efforts.get_output_port(0))
        port = force.GetOutputPort("motor_state")
    log = LogVectorOutput(port, builder, 0.02)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    ResetIntegratorFromFlags(simulator, "runge_kutta5", 1e-2)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    simulator.AdvanceTo(0.3)
    return log.FindLog(simulator.get_context()).data().T


def test_is_a_motors_body_and_a_spring():
    """Compare encoders of both motors with Drake's own two bodies."""
    terms = soft(2000.0)
    damping = EffectForce(arm(dofs=2), terms).law.soft.couplings(np.array([5e-4, MOTOR]))[0].damping
    ours, theirs = driven(arm(dofs=2), terms), driven(arm(dofs=2, spring=(2000.0, damping)))
    np.testing.assert_allclose(ours[:, :2], theirs[:, [0, 2]], atol=1e-6)
    assert np.abs(theirs[:, 1]).max() > 3e-3  # it bends


@pytest.mark.parametrize("share", [0.0, 0.05, 0.4])
def test_two_masses_swing_at_their_frequency(share):
    """A link without weight swings by s² + 2 ζ ω s + ω² = 0 with ω² = k (1/B + 1/M)."""
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("link", LINK)
    plant.AddJoint(RevoluteJoint("joint1", plant.world_frame(), body.body_frame(), [0, 0, 1]))
    plant.Finalize()
    M = float(plant.CalcMassMatrix(plant.CreateDefaultContext())[0, 0])
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    force = builder.AddSystem(EffectForce(plant, soft(500.0), spring_damping=share))
    builder.Connect(plant.get_state_output_port(), force.GetInputPort("state"))
    builder.Connect(
        force.GetOutputPort("generalized_force"), plant.get_applied_generalized_force_input_port()
    )
    diagram = builder.Build()
    A = FirstOrderTaylorApproximation(diagram, diagram.CreateDefaultContext()).A()
    fast = max(np.linalg.eigvals(A), key=lambda s: s.imag)
    omega = np.sqrt(500.0 * (1.0 / MOTOR + 1.0 / M))
    assert abs(fast) == pytest.approx(omega, rel=1e-9)
    assert -fast.real == pytest.approx(share * omega, rel=1e-6, abs=1e-6)


def test_starts_where_its_load_has_it(pendulum):
    """Nothing moves under the holding effort, and encoders show the given positions."""
    model = having(pendulum, ROTOR, FRICTION, (effects.JointElasticity("hinge"), 0.02))
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder)
    builder.ExportInput(robot.effort, "effort")
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    robot.set_state(root, [0.7])
    link = robot.plant.GetPositions(robot.plant.GetMyContextFromRoot(root))[0]
    load = WEIGHT * np.sin(link)
    assert link == pytest.approx(0.7 - 0.02 * load, abs=1e-10)
    diagram.get_input_port(0).FixValue(root, [load])
    force = robot.effect_force
    np.testing.assert_allclose(robot.state.Eval(force.GetMyContextFromRoot(root)), [0.7, 0.0])
    np.testing.assert_allclose(diagram.EvalTimeDerivatives(root).CopyToVector(), 0.0, atol=1e-8)


def test_a_motor_without_inertia_gets_some_and_says_so(pendulum):
    spring = effects.FittedEffect(effects.JointElasticity("hinge"), np.array([1e-3]))
    model = dataclasses.replace(pendulum, effects=(spring,))
    robot = model.add_to_builder(DiagramBuilder())
    assert robot.effect_force.law.soft.motor_inertia == pytest.approx([0.01 * INERTIA])
    (note,) = robot.notes
    assert "motor of hinge" in note
    assert "0.0028 kg·m²" in note
    assert roll_out(model, [swung(0, stiffness=120.0)], most=1).notes[-1] == note


def test_deflections_have_rates_at_any_times():
    """Also at those of a designed motion, whose last step is shorter."""
    time = 0.01 * np.arange(400.0)
    jitter = 0.002 * np.random.default_rng(0).random(400)
    for times in (time, time + jitter, np.append(time, time[-1] + 0.002)):
        found = Deflection.along(np.sin(3.0 * times), times)
        np.testing.assert_allclose(found.rate, 3.0 * np.cos(3.0 * times), atol=1e-4)
        np.testing.assert_allclose(found.acceleration, -9.0 * found.lag, atol=0.02)


def test_an_effect_that_does_not_say_how_is_refused(pendulum):
    @dataclasses.dataclass(frozen=True)
    class Sagging(DeflectionEffect):
        name = "sagging"
        parameters = (effects.Parameter("sag", "rad"),)

        def deflection(self, motion):
            return Deflection.along(np.ones(len(motion.v)), motion.time)

    with pytest.raises(ArgumentError, match="sagging can be fitted only"):
        EffectForce(pendulum.plant, [(Sagging("hinge"), [1e-3])])


KP, DAMPING, DRY, ARMATURE, FACTOR = 60.0, 2.0, 0.3, 0.01, 0.25
MASS, PULL = 0.05 + 2.0 * 0.4**2, 2.0 * 0.4 * 9.81  # of the pendulum, kg·m² and N·m
WIDTH = 2e-3  # rad/s
GEAR = SquaredLoadFriction.fitted("hinge", FACTOR, 0.0)
BOUND = GEAR.effect.braking_load


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A pendulum whose weight alone would lock the gear without a bound: 2 k l > 1."""
    path = tmp_path_factory.mktemp("gear") / "pendulum.urdf"
    path.write_text(PENDULUM)
    assert 2.0 * FACTOR * PULL > 3.0
    values = ((ViscousFriction, DAMPING), (CoulombFriction, DRY), (RotorInertia, ARMATURE))
    plain = tuple(FittedEffect(kind("hinge"), np.array([value])) for kind, value in values)
    servo = EffortSignal("hinge", "command", KP)
    return replace(load_model(path), effects=(*plain, GEAR), effort_signals=(servo,))


def acceleration(q, v, push):
    """Of the pendulum, by a search: what pushes is what bodies, rotor and friction need."""
    sign = np.tanh(v / WIDTH)

    def missing(a):
        load = MASS * a + PULL * np.sin(q)
        along = load if load * v >= 0.0 else np.clip(load, -BOUND, BOUND)
        dry = (DRY + FACTOR * along**2) * sign
        return load + ARMATURE * a + DAMPING * v + dry - push

    return brentq(missing, -1e5, 1e5, xtol=1e-10)


@pytest.fixture(scope="module")
def log():
    """Its motion under commands, exactly."""

    def rates(t, state):
        q, v = state
        return [v, acceleration(q, v, KP * (command(t) - q))]

    time = 0.004 * np.arange(2000)
    start = [command(0.0), 0.0]
    moved = solve_ivp(rates, (0.0, time[-1]), start, "LSODA", time, rtol=1e-8, atol=1e-9).y
    q, v = moved
    a = np.array([acceleration(*each) for each in zip(q, v, KP * (command(time) - q), strict=True)])
    brakes = -(MASS * a + PULL * np.sin(q)) * np.sign(v)
    assert 0.1 < np.mean(brakes > BOUND) < 0.9  # it brakes at its bound much of the time
    none = np.full((len(time), 1), np.nan)
    return JointLog("gear", ("hinge",), time, q[:, None], none, command=command(time)[:, None])


def test_steps_and_drake_move_it_as_it_does(model, log):
    case = prepare_case(model, [log], candidates=False)
    passages = chosen_passages(case, 0.5, 2)
    found = Stepping(Conditions(case, True), passages).positions()
    drake = simulations(Conditions(case, True), passages)(log.name)
    for passage, steps in zip(passages, found, strict=True):
        assert np.ptp(passage.logged) > 0.2
        exact = drake.positions(passage)
        assert np.abs(exact - passage.logged).max() < 5e-3  # which begins with smoothed velocities
        assert np.abs(steps - exact).max() < 1e-3


def test_an_arm_has_one_acceleration():
    """However strongly it brakes: where the effort that it needs is what acts."""
    arm, rng = load_model(files("geodrake.demo") / "demo.urdf"), np.random.default_rng(4)
    count = len(arm.joints)
    for _ in range(40):
        factors = 10.0 ** rng.uniform(-2.0, 1.0, count)
        gears = [
            SquaredLoadFriction.fitted(joint, factor, 0.0)
            for joint, factor in zip(arm.joints, factors.tolist(), strict=True)
        ]
        law = ForceLaw(PlantMotion(arm.plant, WIDTH), gears, spring_damping=0.0)
        q, v = rng.uniform(-3.0, 3.0, count), rng.normal(size=count)
        push = 10.0 ** rng.uniform(0.0, 2.5) * rng.normal(size=count)
        found = law.response(PlantState(q, v, 0.0, np.zeros(0)), push, (law.mu, law.phi))
        motion = Motion(*(x[None] for x in (arm.positions(q[None])[0], v, found.acceleration)))
        whole = replace(arm, effects=tuple(gears))
        np.testing.assert_allclose(
            whole.effort(motion, sign_width=WIDTH)[0], push, atol=1e-4 * np.abs(push).max()
        )


def test_a_gear_that_locks_is_refused():
    with pytest.raises(ModelError, match=r"squared_load_factor = 0\.2, outside"):
        check_effect(FittedEffect(SquaredLoadFriction("hinge", 3.0), np.array([0.2])))
    with pytest.raises(ArgumentError, match="braking_load"):
        SquaredLoadFriction("hinge", 0.0)
