"""Soft joints near the measured motion, where all but couplings and servos is linear.

A rollout stays within milliradians of what was measured. There the efforts of bodies and effects
are linear in how far links and motors are from it, y (s = n + m, of the n links and then of the m
motors of soft joints), with slopes along the measured motion:

    H(t) ÿ + C(t) ẏ + K(t) y + r(t) = (L − A)ᵀ τ(lag, rate of the lag) + Aᵀ u(y, ẏ, z, t).

r is what the measured motion needs beyond the measured effort of joints without a servo; A and L
lead from accelerations of links and motors to those of all motors and of all links
(`geodrake.model.simulation.effect_force`). Springs and dead bands τ are as they are, and so are
servos u, which act on motors, with their integrals z and limits. Compiled, that is some hundred
times as fast as a diagram, for a fit that needs many simulations. What it finds is judged by the
diagram.
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
    first_lag,
    motion_before,
    thrown,
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
_Held = tuple[NDArray[np.intp], NDArray[np.intp], Array]  # links, motors, what couples them


class _Servos(NamedTuple):
    """The p servos that act near a measured motion."""

    effort: Array  # (N, p) what they give along it without integrals and limits, N·m or N
    behind: Array  # (N, p) commanded less measured position, rad or m
    motors: NDArray[np.intp]  # (p,) where in y their motors are
    gains: Array  # (p, 5) stiffness, damping, integral gain, largest effort, and dead band


_STEP = 2.5e-4  # s, of a simulation at most
_MOVED = 1e-4  # rad or m, by which positions change for slopes of effects
_LAG_ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class LinearizedMotion:
    """A passage, ready to be simulated near its measured motion by similar models.

    They may differ in soft joints, in servos of the same joints, and in effects at motors.
    """

    law: ForceLaw  # the force law of the first model there, with what it carries
    robot: LoggedRobot  # the first model
    passage: Passage
    seen: RobotMotion  # the measured motion
    before: RobotMotion  # that before the passage
    at_links: Array  # (N, nv) efforts of bodies, and of effects at them
    rest: Array  # (N, s) r without effects at motors
    slopes: tuple[Array, Array, Array]  # (N, s, s) H, C and K without them

    @classmethod
    def of(cls, simulation: Simulation, passage: Passage) -> LinearizedMotion:
        """Prepare a passage of a log."""
        robot, law = simulation.robot, simulation.law
        model, temperatures = robot.model, robot.temperatures
        motion = passage.motion(model)
        if temperatures is not None:
            motion = replace(motion, temperature=temperatures.at(passage.time, model.joints))
        seen = model.motion(motion, sign_width=simulation.sign_width)
        seen = replace(seen, log=log_number(passage.log))
        at_links = seen.load + _effort(_forces(model, at_motor=False), seen)
        A, L, m = law.of_motors, law.of_links, len(law.soft)
        effort = law.applied(robot.along(passage)[0].T, law.mu).T
        rest = at_links @ L - np.where(_is_servo(robot), 0.0, effort) @ A
        rest[:, len(L) :] += law.added_inertia * motion.vd[:, law.soft.velocities]
        by = seen.effort_slopes
        inertia, damping, stiffness = (
            L.T @ slope @ L for slope in (by.acceleration, by.velocity, by.position)
        )
        places = len(L) + np.arange(m)
        inertia[:, places, places] += law.added_inertia
        before = motion_before(model, passage, simulation.sign_width)
        slopes = inertia, damping, stiffness
        return cls(law, robot, passage, seen, before, at_links, rest, slopes)

    @property
    def motors(self) -> NDArray[np.intp]:
        """(nv,) where in y the motor of each joint is."""
        return self.law.of_motors.argmax(axis=1)

    def departure(self, robot: LoggedRobot, *, slopes: bool = False) -> tuple[Array, Array]:
        """Return simulated − measured positions (N, nv) of motors, rad or m, and slopes (N, nv, k).

        Args:
            robot: The robot of the log, with another model.
            slopes: Whether those with positions and velocities of all links and motors, and with
                integrals of servos, at the start are asked for; there are none (k = 0) if not.
        """
        effects, soft = robot.model.effects, self.law.soft.velocities
        equations, rotors = self._with_motors(robot.model)
        couplings = self._couplings(effects, rotors)
        lag, rate = self._start(effects, couplings)
        s, (servos, begun) = self.rest.shape[1], self._servos(robot)
        free = servos.gains[:, 2].astype(bool)  # integrals
        units = np.eye(2 * s + len(free))[:, np.append(np.ones(2 * s, bool), free)]
        start = np.zeros((len(units), 1 + (units.shape[1] if slopes else 0)))
        start[soft, 0], start[s + soft, 0] = -lag, -rate
        start[2 * s :, 0] = begun
        start[:, 1:] = units[:, : start.shape[1] - 1]
        held = np.array([[c.stiffness, c.play, c.damping, c.ramp] for c in couplings])
        out = np.empty((len(self.rest), s, start.shape[1]))
        period = self.passage.segment.period
        steps = period, max(1, int(np.ceil(period / _STEP)))
        coupled = soft, self.motors[soft], held
        calc_linearized_motion(equations, steps, (coupled, servos), start, out)
        found = out[:, self.motors]
        return found[..., 0], found[..., 1:]

    def _with_motors(self, model: RobotModel) -> tuple[_Equations, Array]:
        """Return r, H, C and K with effects at motors, and inertias (nv,) that these are."""
        forces = _forces(model, at_motor=True)
        first = _forces(self.robot.model, at_motor=True)
        if all(own is other for own, other in zip(forces, first, strict=True)):
            return self._at_first
        return self._with_forces(forces)

    @cached_property
    def _at_first(self) -> tuple[_Equations, Array]:
        return self._with_forces(_forces(self.robot.model, at_motor=True))

    def _with_forces(self, forces: Sequence[FittedEffect]) -> tuple[_Equations, Array]:
        seen, motors, by = self.seen, self.motors, []
        one = np.ones(len(motors))
        sizes = {"vd": one, "v": seen.sign_width + 1e-9, "q": _MOVED * one}
        for (name, size), rest in zip(sizes.items(), self.slopes, strict=True):
            by.append(rest.copy())
            if felt := [fitted for fitted in forces if name in fitted.effect.depends_on]:
                ahead, behind = (
                    _effort(felt, replace(seen, **{name: getattr(seen, name) + way * size}))
                    for way in (1.0, -1.0)
                )
                by[-1][:, motors, motors] += (ahead - behind) / (2.0 * size)
        rest = self.rest + _effort(forces, seen) @ self.law.of_motors
        inertia, damping, stiffness = map(contiguous, by)
        added = (inertia - self.slopes[0])[:, motors, motors]
        return (contiguous(rest), inertia, damping, stiffness), added.mean(axis=0)

    def _couplings(self, effects: Sequence[FittedEffect], rotors: Array) -> list[Coupling]:
        """Return what couples motors and links, which is damped by the inertias of motors."""
        soft, gives = self.law.soft, dict.fromkeys(self.law.soft.names, Give())
        for fitted in effects:
            if isinstance(effect := fitted.effect, DeflectionEffect):
                gives[effect.joint] += effect.give(fitted.parameters)
        more = (rotors - self._at_first[1])[soft.velocities]
        return replace(soft, motor_inertia=soft.motor_inertia + more).held_by([*gives.values()])

    def _servos(self, robot: LoggedRobot) -> tuple[_Servos, Array]:
        """Return the servos, and their integrals (p,) at first, rad·s or m·s."""
        law, some = self.law, _is_servo(robot)
        effort, behind = robot.along(self.passage)
        *gains, band, _ = robot.gains
        kp, kd, ki, limit = (law.applied(gain, law.mu) for gain in gains)
        servos = _Servos(
            contiguous(law.applied(effort.T, law.mu).T[:, some]),
            contiguous(behind[:, some]),
            self.motors[some],
            contiguous(np.stack([kp, kd, ki, limit, band], axis=1)[some]),
        )
        return servos, robot.begun(self.passage)[some]

    def _start(
        self, effects: Sequence[FittedEffect], couplings: Sequence[Coupling]
    ) -> tuple[Array, Array]:
        """Return lags (m,) when the passage begins, and their rates."""
        soft = self.law.soft.velocities
        load = self.at_links[:AT_START, soft]
        give_way = self.seen.effort_slopes.position[:AT_START, soft, soft]
        stiffness, plays = np.transpose([(each.stiffness, each.play) for each in couplings])
        lags = np.zeros_like(load)
        for _ in range(_LAG_ITERATIONS):
            torques, before = load - give_way * lags, lags
            lags = torques / stiffness + plays * np.sign(torques)
            if np.array_equal(lags, before):
                break
        loose = thrown(effects, self.before, self.law.soft.names)
        return first_lag(lags, plays, self.passage.time[:AT_START], loose)


def _is_servo(robot: LoggedRobot) -> NDArray[np.bool_]:
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


def _effort(forces: Sequence[FittedEffect], seen: RobotMotion) -> Array:
    """Return the efforts (N, nv) of effects along a motion."""
    efforts = (fitted.effect.effort(seen, fitted.parameters) for fitted in forces)
    return sum(efforts, start=np.zeros_like(seen.v))


@compiled
def calc_linearized_motion(
    equations: _Equations,
    steps: tuple[float, int],
    held: tuple[_Held, _Servos],
    start: Array,
    out: Array,
) -> None:
    """Write how far links and motors are from the measured motion, by the midpoint rule.

    Couplings and servos are linear within a step. Beside the motion, changes of it are followed.

    Args:
        equations: (N, s) r, (N, s, s) H, C and K.
        steps: Time between rows, s, and steps between two.
        held: Of soft joints (m,) places of links and of motors in y, and (m, 4) stiffness, play,
            damping and ramp; and the servos.
        start: (2 s + p, 1 + k) y, ẏ and the integrals of servos, and k changes of them.
        out: (N, s, 1 + k) y, and its changes.
    """
    r, H, C, K = equations
    (links, motors, couplings), (along, behind, driven, gains) = held
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
                push, stiffness, damping = calc_coupling(coupling, lag[0], rate[0])
                torque = stiffness * lag + damping * rate
                torque[0] = push
                b[link] += torque
                b[motor] -= torque
                slope = 0.5 * h * damping + 0.25 * h * h * stiffness
                S[link, link] += slope
                S[motor, motor] += slope
                S[link, motor] -= slope
                S[motor, link] -= slope
            for i in range(len(driven)):
                kp, kd, ki, limit, band = gains[i]
                motor = driven[i]
                error, there = calc_error((behind[k, i], behind[k + 1, i]), f, band, middle[motor])
                acts = 1.0 if band == 0.0 or error[0] != 0.0 else 0.0
                effort = ki * (z[i] + 0.5 * h * error) + kp * error - kd * v[motor]
                effort[0] += (1.0 - f) * along[k, i] + f * along[k + 1, i] - kp * there
                if abs(effort[0]) < limit:
                    b[motor] += effort
                    S[motor, motor] += 0.5 * h * kd + 0.25 * h * h * kp * acts
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
def calc_error(
    behind: tuple[float, float], share: float, band: float, y: Array
) -> tuple[Array, float]:
    """Return the error of a servo with its changes (1 + k,), and that along the measured motion.

    Args:
        behind: Commanded less measured position at the rows before and after.
        share: How far it is from the first to the second.
        y: (1 + k,) how far the motor is from the measured motion, and changes of that.
    """
    error, (first, second) = -y, behind
    along = (1.0 - share) * calc_beyond(first, band) + share * calc_beyond(second, band)
    error[0] = calc_beyond((1.0 - share) * first + share * second - y[0], band)
    if band > 0.0 and error[0] == 0.0:
        error[:] = 0.0
    return error, along
