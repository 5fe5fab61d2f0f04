"""Effects with a time or a memory in rollouts, on logs that scipy made of a pendulum's equation."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from two_masses import INERTIA, WEIGHT

from geodrake.control.rollout import roll_out
from geodrake.control.systems import EffectForce
from geodrake.effects import (
    Contact,
    CoulombFriction,
    FittedEffect,
    FrictionDrift,
    Hysteresis,
    ThermalFriction,
    ViscousFriction,
)
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError
from geodrake.logs.motion import JointLog

FIRST_STAMP, RATE, SECONDS = 100.0, 250.0, 14.0


def drive(t):
    """Effort of the motor, N·m."""
    return 3.0 * np.sin(2.1 * t) + 1.5 * np.sin(5.3 * t + 1.0)


def swung(name, needed, rate=lambda t, v, z: 0.0, *, start=(0.1, 0.0, 0.0), begins=0.0):
    """A log of I q̈ + m g l sin q + needed(t, q, v, z) = drive(t), with ż = rate(t, v, z).

    The motion starts with (q, v, z); the log holds what happens from `begins` on, s, and its first
    time stamp is FIRST_STAMP.
    """

    def slope(t, x):
        q, v, z = x
        effort = drive(t) - WEIGHT * np.sin(q) - needed(t, q, v, z)
        return [v, effort / INERTIA, rate(t, v, z)]

    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    x = solve_ivp(slope, (0.0, SECONDS), start, "RK45", time, rtol=1e-8, max_step=5e-3).y
    kept = time >= begins
    return JointLog(
        name,
        ("hinge",),
        FIRST_STAMP + time[kept] - begins,
        x[0, kept, None],
        drive(time[kept])[:, None],
        x[1, kept, None],
    )


def with_effects(model, *effects):
    fitted = tuple(FittedEffect(effect, np.array(values)) for effect, values in effects)
    return dataclasses.replace(model, effects=fitted)


def departure(model, *logs, most=4):
    return roll_out(model, logs, most=most, bandwidth=8.0).relative


LOSS = (ViscousFriction("hinge"), [0.1])


class TestDrift:
    drift = (FrictionDrift("hinge", 6.0), [1.0, 0.6])

    @staticmethod
    def log(begins=0.0):
        def needed(t, q, v, z):
            return 0.1 * v + np.exp(-t / 6.0) * (np.tanh(v / 0.02) + 0.6 * v)

        return swung("warming", needed, begins=begins)

    @pytest.mark.thorough
    def test_is_that_of_the_logs_time(self, pendulum):
        log = self.log()
        right = departure(with_effects(pendulum, LOSS, self.drift), log)
        always_cold = (dataclasses.replace(self.drift[0], time_constant=1e6), self.drift[1])
        wrong = departure(with_effects(pendulum, LOSS, always_cold), log)
        never = departure(with_effects(pendulum, LOSS), log)
        assert right < 1e-3
        assert min(wrong, never) > 100 * right


class TestTemperature:
    """Friction of a hinge that heats up and cools down, as its log says."""

    warm = (ThermalFriction("hinge", 30.0), [-0.03, -0.02])

    def test_is_that_of_the_log(self, pendulum):
        def temperature(t):
            return 30.0 + 15.0 * np.sin(0.2 * t)

        def needed(t, q, v, z):
            change = -0.03 * np.tanh(v / 0.02) - 0.02 * v
            return 0.5 * np.tanh(v / 0.02) + 0.4 * v + (temperature(t) - 30.0) * change

        log = swung("heating", needed)
        friction = ((CoulombFriction("hinge"), [0.5]), (ViscousFriction("hinge"), [0.4]))
        model = with_effects(pendulum, *friction, self.warm)
        readings = np.round(temperature(log.time - FIRST_STAMP), 1)[:, None]
        known = departure(model, dataclasses.replace(log, temperature=readings), most=3)
        assert known < 1e-2
        assert departure(model, log, most=3) > 20 * known  # without readings it stays at 30 °C


class TestContact:
    """A push of the rod's end along x, in the second of two logs alone."""

    push, start, end = 12.0, 6.0, 11.0

    def logs(self):
        def pushed(t, q, v, z):
            within = np.tanh((t - self.start) / 0.02) - np.tanh((t - self.end) / 0.02)
            # The end is at x = −0.6 sin q, z = −0.6 cos q.
            return 0.1 * v - 0.5 * within * self.push * 0.6 * np.cos(q)

        return swung("first", lambda t, q, v, z: 0.1 * v), swung("second", pushed)

    def contact(self, log, later=0.0):
        start, end = self.start + later, self.end + later
        at_end = Contact("rod", start, end, 0.02, log_number(log), 0.0, 0.0, -0.6)
        return at_end, [self.push, 0.0, 0.0, 0.0, 0.0, 0.0]

    @pytest.mark.thorough
    def test_acts_in_its_log_and_at_its_time(self, pendulum):
        logs = self.logs()

        def departs(*effects):
            return departure(with_effects(pendulum, LOSS, *effects), *logs, most=6)

        right = departs(self.contact("second"))
        assert right < 1e-3
        for wrong in (self.contact("first"), self.contact("second", 3.0)):
            assert departs(wrong) > 100 * right
        assert departs() > 100 * right


@dataclasses.dataclass(frozen=True)
class Unbent(Hysteresis):
    """Bristles that start unbent wherever a simulation does."""

    def states_along(self, motion):
        return np.zeros((len(motion.v), 1))


class TestHysteresis:
    angle, size = 0.4, 2.0

    @pytest.mark.thorough
    def test_starts_as_bent_as_the_motion_left_it(self, pendulum):
        log = swung(
            "bristles",
            lambda t, q, v, z: 0.1 * v + self.size * z,
            lambda t, v, z: (v - abs(v) * z) / self.angle,
            start=(0.1, 1.0, 1.0),  # a joint that moves as its log begins is taken to have slipped
        )
        bent, unbent = (
            departure(with_effects(pendulum, LOSS, (kind("hinge", self.angle), [self.size])), log)
            for kind in (Hysteresis, Unbent)
        )
        assert bent < 1e-3
        assert unbent > 100 * bent

    def test_states_are_those_of_the_system(self, pendulum):
        bristles = Hysteresis("hinge", self.angle)
        system = EffectForce(pendulum.plant, [(bristles, [self.size])])
        context = system.CreateDefaultContext()
        system.GetInputPort("state").FixValue(context, np.zeros(2))
        port = system.GetOutputPort("generalized_force")
        assert port.Eval(context) == 0.0
        system.set_hidden_states(context, {bristles: [-0.7]})
        np.testing.assert_allclose(port.Eval(context), 0.7 * self.size)
        other = Hysteresis("hinge", 0.1)
        for states in ({bristles: [0.1, 0.2]}, {bristles: 0.1}, {other: [0.1]}, {LOSS[0]: []}):
            with pytest.raises(ArgumentError, match=r"hidden state here|the state of hysteresis"):
                system.set_hidden_states(context, states)
