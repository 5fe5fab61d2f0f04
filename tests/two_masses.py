"""Motor and link with a spring or backlash between them: a model, and logs by SciPy."""

import dataclasses
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from geodrake import effects
from geodrake.logs import JointLog

LENGTH, MASS, BODY = 0.4, 1.5, 0.04
INERTIA, WEIGHT, ROTOR, FRICTION = BODY + MASS * LENGTH**2, MASS * LENGTH * 9.81, 0.15, 0.4
STIFFNESS, DAMPING, GAP = 600.0, 1.5, 0.05
URDF = f"""
<robot name="pendulum">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -{LENGTH}"/><mass value="{MASS}"/>
    <inertia ixx="{BODY}" iyy="{BODY}" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute">
    <parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-9" upper="9" effort="99" velocity="99"/>
  </joint>
</robot>
"""


def having(model, rotor, friction, *more):
    """Return a model with rotors and friction at all joints, and further effects."""
    pairs = [(effects.RotorInertia(j), rotor) for j in model.joints]
    pairs += [(effects.ViscousFriction(j), friction) for j in model.joints]
    fitted = (effects.FittedEffect(e, np.array([value])) for e, value in (*pairs, *more))
    return dataclasses.replace(model, effects=tuple(fitted))


def springy(model, share, **shape):
    """Return a pendulum with a spring of a share of the true compliance."""
    spring = effects.JointElasticity("hinge", **shape), share / STIFFNESS
    return having(model, ROTOR, FRICTION, spring)


def loose(model, share):
    return having(model, ROTOR, FRICTION, (effects.Backlash("hinge", share * GAP), 1.0))


@cache
def swung(seed, *, stiffness=STIFFNESS, gap=0.0, noise=0.0, seconds=18.0, effort=None):
    """Return a log of motor position and effort of two masses with a spring and a gap, by SciPy."""
    rng = np.random.default_rng(seed)
    angles = _angles(rng)
    effort = effort or (lambda t: np.sin(angles(t)) @ [2.0, 2.0, 1.0])
    t, position = _moved(lambda t, *_: (effort(t), 0.0), (stiffness, gap), seconds)
    position += noise * rng.standard_normal(position.shape)
    return JointLog(f"swung{seed}", ("hinge",), t, position, effort(t)[:, None])


@cache
def followed(seed, servo, *, coupling=(STIFFNESS, 0.0), noise=0.0, seconds=18.0, period=4e-3):
    """Return a log of motor position and command of two masses under a servo, by SciPy.

    They have a spring and a gap. The servo's integral stops where the servo is at its limit and
    would exceed it.
    """
    rng = np.random.default_rng(seed)
    angles = _angles(rng)

    def command(t):
        return 0.3 + np.sin(angles(t)) @ [0.25, 0.15, 0.1]

    def acting(t, motor, speed, integral):
        behind = command(t - servo.delay) - motor
        rate = (command(t - servo.delay + 1e-5) - command(t - servo.delay - 1e-5)) / 2e-5
        effort = servo.gain * behind + servo.damping * (rate - speed) + servo.integral * integral
        given = np.clip(effort, -servo.limit, servo.limit)
        return given, behind if given == effort or behind * effort < 0.0 else 0.0

    t, position = _moved(acting, coupling, seconds, period)
    position += noise * rng.standard_normal(position.shape)
    unknown = np.full_like(position, np.nan)
    told = command(t)[:, None]
    return JointLog(f"followed{seed}", ("hinge",), t, position, unknown, command=told)


def _angles(rng):
    """Return angles (..., 3) of three sines at instants."""
    rates, phases = rng.uniform(0.9, 1.1, 3) * [2.1, 5.3, 11.0], rng.uniform(0.0, 6.28, 3)
    return lambda t: np.multiply.outer(t, rates) + phases


def _moved(acting, coupling, seconds, period=4e-3):
    """Return instants and motor positions (N, 1) after a transient.

    `acting` returns an effort and the rate of an integral, from time, position and speed of the
    motor and that integral.
    """
    stiffness, gap = coupling

    def slope(t, x):
        motor, speed, link, v, integral = x
        lag = motor - link
        over = lag - np.clip(lag, -gap, gap)
        torque = stiffness * over + (DAMPING * (speed - v) if over or not gap else 0.0)
        effort, rate = acting(t, motor, speed, integral)
        pull = effort - FRICTION * speed - torque
        return [speed, pull / ROTOR, v, (torque - WEIGHT * np.sin(link)) / INERTIA, rate]

    instants = np.arange(0.0, seconds + 3.0, period)
    span, start = instants[[0, -1]], [0.5, 0.0, 0.5 - gap, 0.0, 0.0]
    x = solve_ivp(slope, span, start, "LSODA", instants, rtol=1e-8).y
    later = instants >= 3.0
    return instants[later], x[0, later, None]
