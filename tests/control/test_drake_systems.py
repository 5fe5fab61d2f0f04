"""Servos against closed forms, MuJoCo and SciPy; clones, gradients and gains of all systems."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from adaptive_loops import (
    CONTROL,
    START,
    closed_loop,
    computed,
    fixed,
    natural,
    passive,
    pendulum_plant,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.integrate import solve_ivp
from two_masses import FRICTION, INERTIA, ROTOR, WEIGHT, having

from geodrake import effects
from geodrake.control import (
    DelayedEffort,
    EffectForce,
    FixedGains,
    LogSource,
    ModelResidual,
    PositionServo,
    VaryingGains,
)
from geodrake.errors import ArgumentError, ModelError
from geodrake.logs import JointLog
from geodrake.model import EffortSignal
from geodrake.model.simulation.scalar_system import scalars

GAINS = {
    "kp": [20.0, 8.0],
    "kd": [1.5, 0.4],
    "ki": [3.0, 0.7],
    "limit": [5.0, np.inf],
    "dead_band": [0.02, 0.0],
}
SEEN = {
    "commanded_position": [0.3, -0.2],
    "commanded_velocity": [0.5, 0.1],
    "estimated_state": [0.1, 0.4, -0.3, 1.1],
    "feedforward": [0.2, -0.6],
}


def seen(system, **inputs):
    every = {**SEEN, **inputs}.items()
    context = fixed(system, **{k: x for k, x in every if system.HasInputPort(k)})
    if context.num_continuous_states():
        context.SetContinuousState(0.3 * np.arange(1, context.num_continuous_states() + 1))
    return context


def everything(system, context):
    """Return all outputs and time derivatives."""
    ports = (system.get_output_port(i) for i in range(system.num_output_ports()))
    parts = [np.atleast_1d(port.Eval(context)) for port in ports]
    return np.concatenate([*parts, system.EvalTimeDerivatives(context).CopyToVector()])


def test_a_servo_by_hand():
    servo = PositionServo(**GAINS)
    first = 20.0 * (0.2 - 0.02) + 1.5 * 0.8 + 3.0 * 0.3 + 0.2  # 5.9, which is beyond the limit
    second = 8.0 * -0.6 + 0.4 * -1.0 + 0.7 * 0.6 - 0.6
    found = everything(servo, seen(servo))
    np.testing.assert_allclose(found, [5.0, second, 0.0, -0.6])
    context = seen(servo)
    servo.set_gains(context, limit=np.inf)
    np.testing.assert_allclose(everything(servo, context), [first, second, 0.18, -0.6])
    gains = servo.gains(context)
    np.testing.assert_array_equal([gains.kp, gains.limit], [[20.0, 8.0], [np.inf, np.inf]])


def test_an_integral_does_not_wind_up():
    servo = PositionServo([20.0, 20.0], ki=1.0, limit=2.0)
    still = {"feedforward": [0.0, 0.0], "commanded_velocity": [0.0, 0.0]}
    context = seen(servo, commanded_position=[0.9, 0.2], **still)  # errors 0.8, −0.2
    context.SetContinuousState([0.0, 9.0])
    rates = servo.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_allclose(rates, [0.0, -0.2])  # the second effort is at +2 and falls


@settings(max_examples=15)
@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 4),
    st.floats(0.1, 200.0),
    st.floats(0.0, 10.0),
    st.floats(0.5, 50.0),
)
def test_mujoco_s_position_actuators(values, kp, kv, limit):
    """Without a commanded velocity, kd damps the motion as kv does."""
    q, v, c, _ = values
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><body>
      <joint name="a" axis="0 1 0"/><geom size="0.1"/></body></worldbody>
      <actuator><position joint="a" kp="{kp}" kv="{kv}" forcerange="{-limit} {limit}"/></actuator>
      </mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.ctrl[0] = q, v, c
    mujoco.mj_forward(model, data)
    servo = PositionServo([kp], kd=kv, limit=limit)
    context = fixed(servo, commanded_position=[c], estimated_state=[q, v])
    found = servo.get_output_port().Eval(context)
    np.testing.assert_allclose(found, data.actuator_force, rtol=1e-12, atol=1e-12)


def test_a_servo_moves_a_plant_as_the_differential_equation_says(arm):
    """SciPy integrates a ramp, a servo with an integral, friction and rotor."""
    kp, kd, ki = 60.0, 4.0, 30.0
    builder = DiagramBuilder()
    robot = arm.add_to_builder(builder)
    servo = builder.AddSystem(PositionServo([kp], kd=kd, ki=ki))
    ramp = PiecewisePolynomial.FirstOrderHold([0.0, 0.1, 1.0], [[0.1, 0.8, 0.8]])
    for name, trajectory in (
        ("commanded_position", ramp),
        ("commanded_velocity", ramp.derivative()),
    ):
        source = builder.AddSystem(TrajectorySource(trajectory))
        builder.Connect(source.get_output_port(), servo.GetInputPort(name))
    builder.Connect(robot.state, servo.GetInputPort("estimated_state"))
    builder.Connect(servo.get_output_port(), robot.effort)
    simulator = Simulator(builder.Build())
    robot.set_state(simulator.get_mutable_context(), [0.1])
    simulator.get_mutable_integrator().set_target_accuracy(1e-6)
    simulator.AdvanceTo(0.1)
    simulator.AdvanceTo(0.2)

    def rates(t, x):
        q, v, z = x
        e, rate = ramp.value(t).item() - q, (7.0 if t < 0.1 else 0.0) - v
        effort = kp * e + kd * rate + ki * z
        return [v, (effort - FRICTION * v - WEIGHT * np.sin(q)) / (INERTIA + ROTOR), e]

    found = [0.1, 0.0, 0.0]
    for start, end in ((0.0, 0.1), (0.1, 0.2)):
        found = solve_ivp(rates, (start, end), found, rtol=1e-11, atol=1e-12).y[:, -1]
    context = simulator.get_context()
    state = robot.state.Eval(robot.plant.GetMyContextFromRoot(context))
    np.testing.assert_allclose(state, found[:2], atol=1e-5)


@pytest.fixture
def arm(pendulum):
    return having(pendulum, ROTOR, FRICTION)


def test_servos_of_a_model_take_late_commands(arm):
    signal = EffortSignal("hinge", "command", 60.0, damping=4.0, delay=0.013, limit=9.0)
    model = replace(arm, effort_signals=(signal,))
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder)
    ramp = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], [[0.1, 2.1]])
    command, rate = (
        builder.AddSystem(TrajectorySource(each)) for each in (ramp, ramp.derivative())
    )
    servo = PositionServo.AddToBuilder(
        builder, model, robot, command.get_output_port(), rate.get_output_port()
    )
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    gains = servo.gains(servo.GetMyContextFromRoot(root))
    assert [gains.kp, gains.kd, gains.limit] == [60.0, 4.0, 9.0]
    robot.set_state(root, [0.1], [2.0])
    simulator.AdvanceTo(0.06)
    own = servo.GetMyContextFromRoot(simulator.get_context())
    told = servo.GetInputPort("commanded_position").Eval(own)
    assert told == pytest.approx(0.1 + 2.0 * (0.06 - 0.013), abs=1e-12)
    q, v = servo.GetInputPort("estimated_state").Eval(own)
    effort = servo.get_output_port().Eval(own)
    assert effort == pytest.approx(np.clip(60.0 * (told - q) + 4.0 * (2.0 - v), -9.0, 9.0))


def test_models_without_servos_have_none(arm):
    for signals in ((), (EffortSignal("hinge", "current", 0.7),)):
        with pytest.raises(ModelError, match="no servos"):
            PositionServo.of(replace(arm, effort_signals=signals))


def test_numbers_of_the_context():
    servo = PositionServo([1.0, 2.0])
    with pytest.raises(ArgumentError, match="without integral gain"):
        servo.set_gains(seen(servo), ki=1.0)
    with pytest.raises(ArgumentError, match="no stiffness"):
        servo.set_gains(seen(servo), stiffness=1.0)


SPRING = [(effects.JointElasticity("elbow"), [1e-3]), (effects.RotorInertia("elbow"), [0.3])]
SERVO = PositionServo([20.0, 8.0], kd=[1.5, 0.4], ki=3.0, limit=[5.0, np.inf])
SYSTEMS = {
    "passivity": passive(time_step=0.0),
    "fixed gains": passive(gains=FixedGains(8.0, 6.0), time_step=0.0),
    "computed torque": computed(time_step=0.0),
    "residual": ModelResidual(CONTROL),
    "effects": EffectForce(pendulum_plant(), SPRING, sign_width=0.3),
    "servo": SERVO,
    "delays": DelayedEffort([0.0, 2e-3]),
}
RNG = np.random.default_rng(3)
INPUTS = {"estimated_state": RNG.normal(size=4), "desired_state": RNG.normal(size=4)}
OTHER = {4: INPUTS["estimated_state"], 2: RNG.normal(size=2), 22: START}  # by size


def filled(system, changed="", values=None):
    """Return a Context with all inputs, of which some may have other values."""
    context, smooth = system.CreateDefaultContext(), values is not None and values.dtype == object
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        given = INPUTS.get(port.get_name(), OTHER[port.size()])
        if port.get_name() == changed:
            given = values
        elif smooth:
            given = scalars(given, AutoDiffXd)
        port.FixValue(context, given)
    return context


@pytest.mark.parametrize("name", SYSTEMS)
def test_clones_and_slopes(name):
    """Clones have the same outputs, and gradients equal differences."""
    system = SYSTEMS[name]
    clone, smooth = system.Clone(), system.ToAutoDiffXd()
    assert type(clone) is type(system)
    np.testing.assert_array_equal(
        everything(clone, filled(clone)), everything(system, filled(system))
    )
    largest = 0.0
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        x = np.asarray(INPUTS.get(port.get_name(), OTHER[port.size()]))
        context = filled(smooth, port.get_name(), InitializeAutoDiff(x).ravel())
        slopes = [value.derivatives() for value in everything(smooth, context)]
        found = np.array([slope if slope.size else 0.0 * x for slope in slopes])
        ends = [
            [everything(system, filled(system, port.get_name(), x + h * e)) for e in np.eye(len(x))]
            for h in (1e-6, -1e-6)
        ]
        expected = np.transpose(np.subtract(*ends)) / 2e-6
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found, expected, atol=1e-6 * scale, err_msg=port.get_name())
        largest = max(largest, np.abs(expected).max())
    assert largest > 0.1
    with pytest.raises(RuntimeError, match="does not support scalar conversion"):
        system.ToSymbolic()


@pytest.mark.parametrize("make", [passive, computed])
@pytest.mark.parametrize("time_step", [0.0, 2e-3])
def test_a_loop_goes_on_alike_in_a_clone_and_in_a_copy_of_its_context(make, time_step):
    builder, loop = closed_loop(make(time_step=time_step))
    diagram = builder.Build()
    clone, first = diagram.Clone(), loop.context(diagram)
    Simulator(diagram, first).AdvanceTo(0.01)
    there = clone.CreateDefaultContext()
    there.SetTimeStateAndParametersFrom(first)
    ends = []
    for each, context in ((diagram, first.Clone()), (clone, there), (diagram, first)):
        Simulator(each, context).AdvanceTo(0.02)
        rates = each.EvalTimeDerivatives(context).CopyToVector()
        states = context.get_discrete_state(0).value() if time_step else rates
        ends.append((rates, states))
    for end in ends[1:]:
        np.testing.assert_equal(end, ends[0])
    controller = loop.controller
    fresh = controller.GetMyContextFromRoot(diagram.CreateDefaultContext())
    np.testing.assert_array_equal(controller.parameters(fresh), START)


def with_gains(gains, gamma=1.0):
    if isinstance(gains, list):
        return computed(natural(gamma), rate=gains, time_step=0.0)
    return passive(natural(gamma), gains=gains, time_step=0.0)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (VaryingGains(8.0), VaryingGains(5.0)),
        (FixedGains([8.0, 4.0], 6.0), FixedGains([3.0, 2.0], [5.0, 7.0])),
        ([8.0, 8.0], [4.0, 6.0]),
    ],
)
def test_gains_and_speed_of_a_context_count(before, after):
    system, fresh = with_gains(before), with_gains(after, 0.2)
    context = filled(system)
    system.set_gains(context, after)
    system.set_gamma(context, 0.2)
    expected = everything(fresh, filled(fresh))
    np.testing.assert_allclose(everything(system, context), expected, rtol=1e-12)


def test_gains_that_cannot_be_are_refused():
    system = passive(time_step=0.0)
    context = filled(system)
    with pytest.raises(ArgumentError, match="has varying gains"):
        system.set_gains(context, FixedGains(1.0, 1.0))
    with pytest.raises(ArgumentError, match="gamma"):
        system.set_gamma(context, 0.0)
    with pytest.raises(ArgumentError, match="does not adapt"):
        passive(None, time_step=0.0).set_gamma(context, 1.0)


def test_logs_are_cloned():
    time = np.arange(4.0)[:, None]
    log = JointLog("log", ("hinge",), time[:, 0], time**2, time)
    copy = LogSource(log).Clone()
    context = copy.CreateDefaultContext()
    context.SetTime(2.0)
    assert copy.GetOutputPort("position").Eval(context) == [4.0]
