"""Dynamics of soft joints, linearized about the measured motion except for couplings and servos.

A rollout stays within milliradians of the measured motion. There, the efforts of bodies and effects
are linear in the deviation y of links and motors (s = n + m: n links, then m motors of soft
joints), with derivatives along the measured motion:

    H(t) ÿ + C(t) ẏ + K(t) y + r(t) = (L − A)ᵀ τ(lag, rate of the lag) + Aᵀ u(y, ẏ, z, t).

r is the effort of the measured motion minus the measured effort of joints without a servo. A and L
map accelerations of links and motors to those of all motors and all links
(`geodrake.model.simulation.effect_force`). Springs and dead bands τ, and servos u with integrals z
and limits, are not linearized. Compiled, this is about a hundred times as fast as a diagram, for a
fit that needs many simulations. The result is validated by the diagram.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.control.rollout.passages import LoggedRobot, Passage
from geodrake.control.rollout.simulation import (
    AT_START,
    Simulation,
    backlash_lag,
    initial_lag,
    preceding_motion,
)
from geodrake.effects import FittedEffect, RobotMotion, Role
from geodrake.effects.deflection import DeflectionEffect, Give
from geodrake.effects.robot_motion import log_number
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import calc_beyond
from geodrake.model.simulation.effect_force import (
    Coupling,
    ForceLaw,
    calc_coupling,
)

_Equations = tuple[Array, Array, Array, Array]  # (N, s) r, and (N, s, s) H, C and K
_Couplings = tuple[NDArray[np.intp], NDArray[np.intp], Array]  # links, motors, and (m, 4) values


class _Servos(NamedTuple):
    """p servos near a measured motion."""

    effort: Array  # (N, p) effort along it without integrals and limits, N·m or N
    error: Array  # (N, p) commanded minus measured position, rad or m
    motors: NDArray[np.intp]  # (p,) indices of their motors in y
    gains: Array  # (p, 5) stiffness, damping, integral gain, effort limit, and dead band


_STEP = 2.5e-4  # s, largest step of a simulation
_DIFFERENCE = 1e-4  # rad or m, for derivatives of effects
_LAG_ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class LinearizedMotion:
    """A passage linearized about its measured motion, for simulation with similar models.

    Models may differ in soft joints, in servos of the same joints, and in effects at motors.
    """

    law: ForceLaw  # force law of the reference model, with payloads
    robot: LoggedRobot  # robot with the reference model
    passage: Passage
    motion: RobotMotion  # the measured motion
    preceding: RobotMotion  # the measured motion before the passage
    link_effort: Array  # (N, nv) efforts of bodies, and of effects at bodies
    residual: Array  # (N, s) r without effects at motors
    slopes: tuple[Array, Array, Array]  # (N, s, s) H, C and K without effects at motors

    @classmethod
    def of(cls, simulation: Simulation, passage: Passage) -> LinearizedMotion:
        """Linearize a passage of a log."""
        robot, law = simulation.robot, simulation.law
        model, temperatures = robot.model, robot.temperatures
        series = passage.motion(model)
        if temperatures is not None:
            series = replace(series, temperature=temperatures.at(passage.time, model.joints))
        motion = model.motion(series, sign_width=simulation.sign_width)
        motion = replace(motion, log=log_number(passage.log))
        link_effort = motion.load + _effort(_forces(model, at_motor=False), motion)
        A, L, m = law.of_motors, law.of_links, len(law.soft)
        effort = law.applied(robot.measured_inputs(passage)[0].T, law.mu).T
        residual = link_effort @ L - np.where(_has_servo(robot), 0.0, effort) @ A
        residual[:, len(L) :] += law.added_inertia * series.vd[:, law.soft.velocities]
        by = motion.effort_slopes
        inertia, damping, stiffness = (
            L.T @ slope @ L for slope in (by.acceleration, by.velocity, by.position)
        )
        motors = len(L) + np.arange(m)
        inertia[:, motors, motors] += law.added_inertia
        preceding = preceding_motion(model, passage, simulation.sign_width)
        slopes = inertia, damping, stiffness
        return cls(law, robot, passage, motion, preceding, link_effort, residual, slopes)

    @property
    def motors(self) -> NDArray[np.intp]:
        """(nv,) index of each joint's motor in y."""
        return self.law.of_motors.argmax(axis=1)

    def departure(self, robot: LoggedRobot, *, slopes: bool = False) -> tuple[Array, Array]:
        """Return simulated − measured positions (N, nv) of motors, and derivatives (N, nv, k).

        Args:
            robot: The robot of the log, with another model.
            slopes: Whether to return derivatives by the k initial positions and velocities of all
                links and motors and integrals of servos; otherwise k = 0.
        """
        effects, soft = robot.model.effects, self.law.soft.velocities
        equations, motor_inertia = self._equations(robot.model)
        couplings = self._couplings(effects, motor_inertia)
        lag, rate = self._initial_lag(effects, couplings)
        s, (servos, integrals) = self.residual.shape[1], self._servos(robot)
        has_integral = servos.gains[:, 2].astype(bool)
        is_state = np.append(np.ones(2 * s, bool), has_integral)
        units = np.eye(2 * s + len(has_integral))[:, is_state]
        start = np.zeros((len(units), 1 + (units.shape[1] if slopes else 0)))
        start[soft, 0], start[s + soft, 0] = -lag, -rate
        start[2 * s :, 0] = integrals
        start[:, 1:] = units[:, : start.shape[1] - 1]
        values = np.array([[c.stiffness, c.play, c.damping, c.ramp] for c in couplings])
        out = np.empty((len(self.residual), s, start.shape[1]))
        period = self.passage.segment.period
        steps = period, max(1, int(np.ceil(period / _STEP)))
        coupled = soft, self.motors[soft], values
        calc_linearized_motion(equations, steps, (coupled, servos), start, out)
        departure = out[:, self.motors]
        return departure[..., 0], departure[..., 1:]

    def _equations(self, model: RobotModel) -> tuple[_Equations, Array]:
        """Return r, H, C and K with effects at motors, and the inertias (nv,) of these effects."""
        forces = _forces(model, at_motor=True)
        reference = _forces(self.robot.model, at_motor=True)
        if all(fitted is other for fitted, other in zip(forces, reference, strict=True)):
            return self._reference_equations
        return self._equations_with(forces)

    @cached_property
    def _reference_equations(self) -> tuple[_Equations, Array]:
        return self._equations_with(_forces(self.robot.model, at_motor=True))

    def _equations_with(self, forces: Sequence[FittedEffect]) -> tuple[_Equations, Array]:
        motion, motors, totals = self.motion, self.motors, []
        one = np.ones(len(motors))
        sizes = {"vd": one, "v": motion.sign_width + 1e-9, "q": _DIFFERENCE * one}
        for (name, size), slope in zip(sizes.items(), self.slopes, strict=True):
            totals.append(slope.copy())
            if dependent := [fitted for fitted in forces if name in fitted.effect.depends_on]:
                values = getattr(motion, name)
                forward, backward = (
                    _effort(dependent, replace(motion, **{name: values + sign * size}))
                    for sign in (1.0, -1.0)
                )
                totals[-1][:, motors, motors] += (forward - backward) / (2.0 * size)
        residual = self.residual + _effort(forces, motion) @ self.law.of_motors
        inertia, damping, stiffness = map(contiguous, totals)
        added = (inertia - self.slopes[0])[:, motors, motors]
        return (contiguous(residual), inertia, damping, stiffness), added.mean(axis=0)

    def _couplings(self, effects: Sequence[FittedEffect], motor_inertia: Array) -> list[Coupling]:
        """Return the couplings of motors and links, whose damping depends on motor inertias."""
        soft, gives = self.law.soft, dict.fromkeys(self.law.soft.names, Give())
        for fitted in effects:
            if isinstance(effect := fitted.effect, DeflectionEffect):
                gives[effect.joint] += effect.give(fitted.parameters)
        change = (motor_inertia - self._reference_equations[1])[soft.velocities]
        return replace(soft, motor_inertia=soft.motor_inertia + change).held_by([*gives.values()])

    def _servos(self, robot: LoggedRobot) -> tuple[_Servos, Array]:
        """Return the servos, and their initial integrals (p,), rad·s or m·s."""
        law, has_servo = self.law, _has_servo(robot)
        effort, error = robot.measured_inputs(self.passage)
        *gains, band, _ = robot.gains
        kp, kd, ki, limit = (law.applied(gain, law.mu) for gain in gains)
        servos = _Servos(
            contiguous(law.applied(effort.T, law.mu).T[:, has_servo]),
            contiguous(error[:, has_servo]),
            self.motors[has_servo],
            contiguous(np.stack([kp, kd, ki, limit, band], axis=1)[has_servo]),
        )
        return servos, robot.initial_integrals(self.passage)[has_servo]

    def _initial_lag(
        self, effects: Sequence[FittedEffect], couplings: Sequence[Coupling]
    ) -> tuple[Array, Array]:
        """Return lags (m,) at the start of the passage, and their rates."""
        soft = self.law.soft.velocities
        load = self.link_effort[:AT_START, soft]
        load_stiffness = self.motion.effort_slopes.position[:AT_START, soft, soft]
        stiffness, plays = np.transpose([(c.stiffness, c.play) for c in couplings])
        lags = np.zeros_like(load)
        for _ in range(_LAG_ITERATIONS):
            torques, previous = load - load_stiffness * lags, lags
            lags = torques / stiffness + plays * np.sign(torques)
            if np.array_equal(lags, previous):
                break
        backlash = backlash_lag(effects, self.preceding, self.law.soft.names)
        return initial_lag(lags, plays, self.passage.time[:AT_START], backlash)


def _has_servo(robot: LoggedRobot) -> NDArray[np.bool_]:
    """Return (nv,) whether each joint has a servo."""
    kp, kd, ki, *_ = robot.gains
    return (kp != 0.0) | (kd != 0.0) | (ki != 0.0)


def _forces(model: RobotModel, *, at_motor: bool) -> list[FittedEffect]:
    """Return the effects at motors, or at bodies, that are neither scales nor springs."""
    return [
        fitted
        for fitted in model.effects
        if fitted.effect.role in (Role.FORCE, Role.EPISODE) and fitted.effect.at_motor == at_motor
    ]


def _effort(forces: Sequence[FittedEffect], motion: RobotMotion) -> Array:
    """Return the total effort (N, nv) of effects along a motion."""
    efforts = (fitted.effect.effort(motion, fitted.parameters) for fitted in forces)
    return sum(efforts, start=np.zeros_like(motion.v))


@compiled
def calc_linearized_motion(
    equations: _Equations,
    steps: tuple[float, int],
    devices: tuple[_Couplings, _Servos],
    start: Array,
    out: Array,
) -> None:
    """Write the deviation of links and motors from the measured motion, by the midpoint rule.

    Couplings and servos are linearized within a step. Tangents of the deviation are integrated
    along with it.

    Args:
        equations: (N, s) r, (N, s, s) H, C and K.
        steps: Sampling period, s, and steps per period.
        devices: Couplings: (m,) indices of links and of motors in y, and (m, 4) stiffness, play,
            damping and ramp; and the servos.
        start: (2 s + p, 1 + k) y, ẏ and the integrals of servos, with k tangents.
        out: (N, s, 1 + k) y, with its tangents.
    """
    r, H, C, K = equations
    (links, motors, couplings), (measured_effort, position_error, servo_motors, gains) = devices
    h, s = steps[0] / steps[1], r.shape[1]
    y, v, z = start[:s].copy(), start[s : 2 * s].copy(), start[2 * s :].copy()
    out[0] = y
    for k in range(len(r) - 1):
        for step in range(steps[1]):
            f = (step + 0.5) / steps[1]
            middle = y + 0.5 * h * v
            C_now = (1.0 - f) * C[k] + f * C[k + 1]
            K_now = (1.0 - f) * K[k] + f * K[k + 1]
            S = (1.0 - f) * H[k] + f * H[k + 1] + 0.5 * h * C_now + 0.25 * h * h * K_now
            b = -(C_now @ v) - K_now @ middle
            b[:, 0] -= (1.0 - f) * r[k] + f * r[k + 1]
            for i in range(len(links)):
                link, motor = links[i], motors[i]
                lag, rate = middle[motor] - middle[link], v[motor] - v[link]
                stiffness, play, damping, ramp = couplings[i]
                coupling = stiffness, play, damping, ramp
                force, stiffness, damping = calc_coupling(coupling, lag[0], rate[0])
                torque = stiffness * lag + damping * rate
                torque[0] = force
                b[link] += torque
                b[motor] -= torque
                slope = 0.5 * h * damping + 0.25 * h * h * stiffness
                S[link, link] += slope
                S[motor, motor] += slope
                S[link, motor] -= slope
                S[motor, link] -= slope
            for i in range(len(servo_motors)):
                kp, kd, ki, limit, band = gains[i]
                motor = servo_motors[i]
                ends = position_error[k, i], position_error[k + 1, i]
                error, measured_error = calc_error(ends, f, band, middle[motor])
                is_active = 1.0 if band == 0.0 or error[0] != 0.0 else 0.0
                effort = ki * (z[i] + 0.5 * h * error) + kp * error - kd * v[motor]
                effort[0] += (1.0 - f) * measured_effort[k, i] + f * measured_effort[k + 1, i]
                effort[0] -= kp * measured_error
                if abs(effort[0]) < limit:
                    b[motor] += effort
                    S[motor, motor] += 0.5 * h * kd + 0.25 * h * h * kp * is_active
                else:
                    b[motor, 0] += limit if effort[0] > 0.0 else -limit
                    if effort[0] * error[0] > 0.0:
                        continue
                z[i] += h * error
            a = np.linalg.solve(S, b)
            y = middle + 0.5 * h * v + 0.5 * h * h * a
            v = v + h * a
        out[k + 1] = y


@compiled
def calc_error(ends: tuple[float, float], f: float, band: float, y: Array) -> tuple[Array, float]:
    """Return a servo's error with tangents (1 + k,), and its error for the measured motion.

    Args:
        ends: Commanded minus measured position at the samples before and after.
        f: Fraction of the interval between them.
        y: (1 + k,) deviation of the motor from the measured motion, with tangents.
    """
    error, (first, second) = -y, ends
    measured_error = (1.0 - f) * calc_beyond(first, band) + f * calc_beyond(second, band)
    error[0] = calc_beyond((1.0 - f) * first + f * second - y[0], band)
    if band > 0.0 and error[0] == 0.0:
        error[:] = 0.0
    return error, measured_error
