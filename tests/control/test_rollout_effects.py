"""Effects with a time or a memory in rollouts, on logs that scipy made of a pendulum's equation."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from two_masses import INERTIA, WEIGHT

from geodrake import effects
from geodrake.control import EffectForce, roll_out
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError
from geodrake.logs import JointLog

FIRST_STAMP, RATE = 100.0, 250.0
LOSS = (effects.ViscousFriction("hinge"), [0.1])


def drive(t):
    """Effort of the motor, N·m."""
    return 3.0 * np.sin(2.1 * t) + 1.5 * np.sin(5.3 * t + 1.0)


def swung(name, needed, rate=lambda t, v, z: 0.0, *, start=(0.1, 0.0, 0.0), seconds=8.0):
    """A log of I q̈ + m g l sin q + needed(t, q, v, z) = drive(t), with ż = rate(t, v, z).

    The motion starts with (q, v, z), and the log's first time stamp is FIRST_STAMP.
    """

    def slope(t, x):
        q, v, z = x
        effort = drive(t) - WEIGHT * np.sin(q) - needed(t, q, v, z)
        return [v, effort / INERTIA, rate(t, v, z)]

    time = np.arange(0.0, seconds, 1.0 / RATE)
    x = solve_ivp(slope, (0.0, seconds), start, "RK45", time, rtol=1e-8, max_step=5e-3).y
    return JointLog(
        name, ("hinge",), FIRST_STAMP + time, x[0, :, None], drive(time)[:, None], x[1, :, None]
    )


def departure(model, *logs, having=(), most=2):
    """Departure of the pendulum with these effects beside its loss."""
    fitted = (effects.FittedEffect(effect, np.array(values)) for effect, values in (LOSS, *having))
    robot = dataclasses.replace(model, effects=tuple(fitted))
    return roll_out(robot, logs, most=most, bandwidth=8.0).relative


def test_drift_is_that_of_the_logs_time(pendulum):
    def needed(t, q, v, z):
        return 0.1 * v + np.exp(-t / 6.0) * (np.tanh(v / 0.02) + 0.6 * v)

    log, sizes = swung("warming", needed), [1.0, 0.6]
    right = departure(pendulum, log, having=[(effects.FrictionDrift("hinge", 6.0), sizes)])
    always_cold = departure(pendulum, log, having=[(effects.FrictionDrift("hinge", 1e6), sizes)])
    assert right < 1e-3
    assert min(always_cold, departure(pendulum, log)) > 100 * right


def test_friction_of_a_hinge_is_that_of_the_temperatures_in_the_log(pendulum):
    def temperature(t):
        return 30.0 + 15.0 * np.sin(0.2 * t)

    def needed(t, q, v, z):
        change = -0.03 * np.tanh(v / 0.02) - 0.02 * v
        return 0.5 * np.tanh(v / 0.02) + 0.1 * v + (temperature(t) - 30.0) * change

    warm = (effects.ThermalFriction("hinge", 30.0), [-0.03, -0.02])
    having = (effects.CoulombFriction("hinge"), [0.5]), warm
    log = swung("heating", needed, seconds=14.0)
    readings = np.round(temperature(log.time - FIRST_STAMP), 1)[:, None]
    read = dataclasses.replace(log, temperature=readings)
    known, warm = (departure(pendulum, each, having=having, most=3) for each in (read, log))
    assert known < 1e-2
    assert warm > 20 * known  # without readings it stays at 30 °C


def test_contact_acts_in_its_log_and_at_its_time(pendulum):
    """A push of the rod's end along x, in the second of two logs alone."""
    push, start, end = 12.0, 1.5, 6.5

    def pushed(t, q, v, z):
        within = np.tanh((t - start) / 0.02) - np.tanh((t - end) / 0.02)
        # The end is at x = −0.6 sin q, z = −0.6 cos q.
        return 0.1 * v - 0.5 * within * push * 0.6 * np.cos(q)

    logs = swung("first", lambda t, q, v, z: 0.1 * v), swung("second", pushed)

    def departs(log, later=0.0):
        span = start + later, end + later
        contact = effects.Contact("rod", *span, 0.02, log_number(log), 0.0, 0.0, -0.6)
        return departure(pendulum, *logs, having=[(contact, [push, *np.zeros(5)])], most=4)

    right = departs("second")
    assert right < 1e-3
    assert min(departs("first"), departs("second", 3.0)) > 100 * right


@dataclasses.dataclass(frozen=True)
class Unbent(effects.Hysteresis):
    """Bristles that start unbent wherever a simulation does."""

    def states_along(self, motion):
        return np.zeros((len(motion.v), 1))


def test_bristles_start_as_bent_as_the_motion_left_them(pendulum):
    angle, size = 0.4, 2.0
    log = swung(
        "bristles",
        lambda t, q, v, z: 0.1 * v + size * z,
        lambda t, v, z: (v - abs(v) * z) / angle,
        start=(0.1, 1.0, 1.0),  # a joint that moves as its log begins is taken to have slipped
    )
    bent, unbent = (
        departure(pendulum, log, having=[(kind("hinge", angle), [size])])
        for kind in (effects.Hysteresis, Unbent)
    )
    assert bent < 1e-3
    assert unbent > 100 * bent


def test_states_of_bristles_are_those_of_the_system(pendulum):
    bristles = effects.Hysteresis("hinge", 0.4)
    system = EffectForce(pendulum.plant, [(bristles, [2.0])])
    context = system.CreateDefaultContext()
    system.GetInputPort("state").FixValue(context, np.zeros(2))
    port = system.GetOutputPort("generalized_force")
    assert port.Eval(context) == 0.0
    system.set_hidden_states(context, {bristles: [-0.7]})
    np.testing.assert_allclose(port.Eval(context), 0.7 * 2.0)
    other = effects.Hysteresis("hinge", 0.1)
    for states in ({bristles: [0.1, 0.2]}, {bristles: 0.1}, {other: [0.1]}, {LOSS[0]: []}):
        with pytest.raises(ArgumentError, match=r"hidden state here|the state of hysteresis"):
            system.set_hidden_states(context, states)
