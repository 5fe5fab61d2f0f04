"""Servos: against closed forms, MuJoCo's actuators, and exact integration by SciPy."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.integrate import solve_ivp
from two_masses import FRICTION, INERTIA, ROTOR, WEIGHT, having

from geodrake.control import PositionServo
from geodrake.errors import ArgumentError, ModelError
from geodrake.model import EffortSignal

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
    context = system.CreateDefaultContext()
    for name, values in {**SEEN, **inputs}.items():
        if system.HasInputPort(name):
            system.GetInputPort(name).FixValue(context, values)
    if context.num_continuous_states():
        context.SetContinuousState(0.3 * np.arange(1, context.num_continuous_states() + 1))
    return context


def everything(system, context):
    """All outputs, and rates."""
    ports = (system.get_output_port(i) for i in range(system.num_output_ports()))
    parts = [port.Eval(context) for port in ports]
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
    context = servo.CreateDefaultContext()
    servo.GetInputPort("commanded_position").FixValue(context, [c])
    servo.GetInputPort("estimated_state").FixValue(context, [q, v])
    found = servo.get_output_port().Eval(context)
    np.testing.assert_allclose(found, data.actuator_force, rtol=1e-12, atol=1e-12)


def test_a_servo_moves_a_plant_as_the_differential_equation_says(arm):
    """Command along a ramp, servo with an integral; friction and rotor in the model, by SciPy."""
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
