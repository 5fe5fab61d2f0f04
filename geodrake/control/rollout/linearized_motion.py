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

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.control.rollout.passages import Acting, Passage
from geodrake.control.rollout.simulation import (
    AT_START,
    Simulation,
    first_lag,
    motion_before,
    thrown,
)
from geodrake.effects import FittedEffect, RobotMotion, Role
from geodrake.effects.robot_motion import log_number
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import calc_beyond
from geodrake.model.simulation.effect_force import (
    Coupling,
    ForceLaw,
    SoftJoints,
    calc_coupling,
)

_Held = tuple[NDArray[np.intp], NDArray[np.intp], Array]  # links, motors, what couples them
_Driven = tuple[Array, Array, NDArray[np.intp], Array]  # efforts, behind, motors, gains

_STEP = 2.5e-4  # s, of a simulation at most
_MOVED = 1e-4  # rad or m, by which positions change for slopes of effects
_LAG_ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class LinearizedServos:
    """The p servos that act near a measured motion."""

    effort: Array  # (N, p) what they give along it without integrals and limits, N·m or N
    behind: Array  # (N, p) commanded less measured position, rad or m
    motors: NDArray[np.intp]  # (p,) where in y their motors are
    gains: Array  # (p, 5) stiffness, damping, integral gain, largest effort, and dead band
    begun: Array  # (p,) integrals at first, rad·s or m·s

    @classmethod
    def of(
        cls, law: ForceLaw, acting: Acting, passage: Passage, motors: NDArray[np.intp]
    ) -> tuple[LinearizedServos, Array]:
        """Return the servos, and efforts (N, nv) at joints without any."""
        kp, kd, ki, limit, band, _ = acting.gains
        effort, behind = acting.along(passage)
        effort = law.applied(effort.T, law.mu).T
        columns = [law.applied(gain, law.mu) for gain in (kp, kd, ki, limit)]
        gains = np.stack([*columns, band], axis=1)
        some = gains[:, :3].any(axis=1)
        servos = cls(
            contiguous(effort[:, some]),
            contiguous(behind[:, some]),
            motors[some],
            contiguous(gains[some]),
            acting.begun(passage)[some],
        )
        return servos, np.where(some, 0.0, effort)


@dataclass(frozen=True, eq=False)
class MotorForce:
    """What one parameter of an effect at a motor makes of its effort along a measured motion."""

    at: int  # which of the model's effects it is of
    index: int  # which of that one's parameters it is
    parameter: float
    place: int  # where in y the motor is
    effort: Array  # (N,) effort of a parameter of 1, N·m or N
    slopes: Array  # (3, N) its slopes with the motor's position, velocity and acceleration

    def change(self, effects: Sequence[FittedEffect]) -> float:
        """Return by how much it is another one."""
        return float(effects[self.at].parameters[self.index]) - self.parameter


@dataclass(frozen=True, eq=False)
class LinearizedMotion:
    """A passage, ready to be simulated near its measured motion with other soft joints."""

    law: ForceLaw  # the force law of the model there, with what it carries
    passage: Passage
    rest: Array  # (N, s) r
    inertia: Array  # (N, s, s) H
    damping: Array  # (N, s, s) C
    stiffness: Array  # (N, s, s) K
    motors: NDArray[np.intp]  # (nv,) where in y the motor of each joint is
    servos: LinearizedServos
    load: Array  # (k, m) efforts of their links at the first samples, N·m or N
    give_way: Array  # (k, m) by how much these change when a link moves on, N·m/rad or N/m
    before: RobotMotion  # the motion before the passage
    # What single parameters of effects at motors make, of those that may change.
    forces: tuple[MotorForce, ...] = ()

    @classmethod
    def of(
        cls,
        simulation: Simulation,
        passage: Passage,
        free: Sequence[tuple[int, int]] = (),
    ) -> LinearizedMotion:
        """Prepare a passage of a log.

        Args:
            free: Effects of the model at motors of one joint, and which of their parameters are to
                change.
        """
        model, law, segment = simulation.model, simulation.law, passage.segment
        seen = _seen(simulation, passage)
        slopes, A, L = seen.effort_slopes, law.of_motors, law.of_links
        at_motors, own = _at_motors(model, seen)
        at_links = seen.load + _effort(model, seen, at_motor=False)
        soft, added = law.soft.velocities, law.added_inertia
        motors = A.argmax(axis=1)
        servos, beside = LinearizedServos.of(law, simulation.acting, passage, motors)
        rest = (at_motors - beside) @ A + at_links @ L
        rest[:, len(L) :] += added * segment.acceleration[:, soft]
        position, velocity, acceleration = (
            A.T @ (f[:, :, None] * A) + L.T @ D @ L
            for f, D in zip(
                own, (slopes.position, slopes.velocity, slopes.acceleration), strict=True
            )
        )
        places = len(L) + np.arange(len(soft))
        acceleration[:, places, places] += added
        return cls(
            law,
            passage,
            contiguous(rest),
            contiguous(acceleration),
            contiguous(velocity),
            contiguous(position),
            motors,
            servos,
            at_links[:AT_START, soft],
            slopes.position[:AT_START, soft, soft],
            motion_before(model, passage, simulation.sign_width),
            tuple(_motor_force(model, seen, motors, *each) for each in free),
        )

    def under(self, acting: Acting, effects: Sequence[FittedEffect]) -> LinearizedMotion:
        """Return the passage under other servos of the same joints, and other forces at motors."""
        servos, _ = LinearizedServos.of(self.law, acting, self.passage, self.motors)
        rest = self.rest.copy()
        stiffness, damping, inertia = (
            whole.copy() for whole in (self.stiffness, self.damping, self.inertia)
        )
        for force in self.forces:
            change = force.change(effects)
            rest[:, force.place] += change * force.effort
            for whole, slope in zip((stiffness, damping, inertia), force.slopes, strict=True):
                whole[:, force.place, force.place] += change * slope
        return replace(
            self, rest=rest, stiffness=stiffness, damping=damping, inertia=inertia, servos=servos
        )

    def soft_joints(self, effects: Sequence[FittedEffect]) -> SoftJoints:
        """Return the soft joints with other inertias of their motors, which damp springs."""
        soft = self.law.soft
        inertia, places = soft.motor_inertia.copy(), self.motors[soft.velocities]
        for force in self.forces:
            inertia[places == force.place] += force.change(effects) * force.slopes[2].mean()
        return replace(soft, motor_inertia=inertia)

    def departure(
        self,
        effects: Sequence[FittedEffect],
        couplings: Sequence[Coupling],
        *,
        slopes: bool = False,
    ) -> tuple[Array, Array]:
        """Return simulated − measured positions (N, nv) of motors, rad or m, and slopes (N, nv, k).

        Args:
            effects: All effects, for where links in dead bands begin.
            slopes: Whether those with positions and velocities of all links and motors, and with
                integrals of servos, at the start are asked for; there are none (k = 0) if not.
        """
        lag, rate = self._start(effects, couplings)
        s = self.rest.shape[1]
        free = self.servos.gains[:, 2].astype(bool)  # integrals
        units = np.eye(2 * s + len(free))[:, np.append(np.ones(2 * s, bool), free)]
        start = np.zeros((len(units), 1 + (units.shape[1] if slopes else 0)))
        soft, period = self.law.soft.velocities, self.passage.segment.period
        start[soft, 0], start[s + soft, 0] = -lag, -rate
        start[2 * s :, 0] = self.servos.begun
        start[:, 1:] = units[:, : start.shape[1] - 1]
        held = np.array([[c.stiffness, c.play, c.damping, c.ramp] for c in couplings])
        out = np.empty((len(self.rest), s, start.shape[1]))
        steps = max(1, int(np.ceil(period / _STEP)))
        equations, servos = (self.rest, self.inertia, self.damping, self.stiffness), self.servos
        coupled = soft, self.motors[soft], held
        driven = servos.effort, servos.behind, servos.motors, servos.gains
        calc_linearized_motion(equations, (period, steps), (coupled, driven), start, out)
        found = out[:, self.motors]
        return found[..., 0], found[..., 1:]

    def _start(
        self, effects: Sequence[FittedEffect], couplings: Sequence[Coupling]
    ) -> tuple[Array, Array]:
        """Return lags (m,) when the passage begins, and their rates."""
        lags = np.zeros_like(self.load)
        for _ in range(_LAG_ITERATIONS):
            torques = self.load - self.give_way * lags
            for i, coupling in enumerate(couplings):
                lags[:, i] = torques[:, i] / coupling.stiffness
                lags[:, i] += coupling.play * np.sign(torques[:, i])
        plays = np.array([coupling.play for coupling in couplings])
        time, names = self.passage.time[:AT_START], self.law.soft.names
        return first_lag(lags, plays, time, lambda: thrown(effects, self.before, names))


def _seen(simulation: Simulation, passage: Passage) -> RobotMotion:
    """Return the measured motion as the effects of a model see it."""
    model = simulation.model
    motion = passage.motion(model)
    if simulation.temperatures is not None:
        warmth = simulation.temperatures.at(passage.time, model.joints)
        motion = replace(motion, temperature=warmth)
    seen = model.motion(motion, sign_width=simulation.sign_width)
    return replace(seen, log=log_number(passage.log))


def _effort(model: RobotModel, seen: RobotMotion, *, at_motor: bool) -> Array:
    """Return efforts (N, nv) of effects at motors, or at bodies; without scales and springs."""
    effort = np.zeros_like(seen.v)
    for fitted in model.effects:
        effect = fitted.effect
        if effect.role in (Role.FORCE, Role.EPISODE) and effect.at_motor == at_motor:
            effort += effect.effort(seen, fitted.parameters)
    return effort


def _motor_force(
    model: RobotModel, seen: RobotMotion, motors: NDArray[np.intp], at: int, index: int
) -> MotorForce:
    """Return what a parameter makes; see `LinearizedMotion.of`."""
    fitted = model.effects[at]
    j = model.joints.index(fitted.effect.where[0])
    one = replace(fitted, parameters=np.eye(len(fitted.parameters))[index])
    effort, slopes = _at_motors(replace(model, effects=(one,)), seen)
    return MotorForce(
        at,
        index,
        float(fitted.parameters[index]),
        int(motors[j]),
        effort[:, j],
        np.array([slope[:, j] for slope in slopes]),
    )


def _at_motors(model: RobotModel, seen: RobotMotion) -> tuple[Array, tuple[Array, Array, Array]]:
    """Return efforts (N, nv) of effects at motors, and slopes with each joint's q, v and v̇."""
    sizes = {"q": np.full(len(model.joints), _MOVED), "v": seen.sign_width + 1e-9}
    sizes["vd"] = np.ones(len(model.joints))
    slopes = []
    for name, size in sizes.items():
        ahead, behind = (
            _effort(model, replace(seen, **{name: getattr(seen, name) + way * size}), at_motor=True)
            for way in (1.0, -1.0)
        )
        slopes.append((ahead - behind) / (2.0 * size))
    return _effort(model, seen, at_motor=True), (slopes[0], slopes[1], slopes[2])


@compiled
def calc_linearized_motion(
    equations: tuple[Array, Array, Array, Array],
    steps: tuple[float, int],
    held: tuple[_Held, _Driven],
    start: Array,
    out: Array,
) -> None:
    """Write how far links and motors are from the measured motion, by the midpoint rule.

    Couplings and servos are linear within a step. Beside the motion, changes of it are followed.

    Args:
        equations: (N, s) r, (N, s, s) H, C and K.
        steps: Time between rows, s, and steps between two.
        held: Of soft joints (m,) places of links and of motors in y, and (m, 4) stiffness, play,
            damping and ramp; of servos (N, p) efforts and what they are behind, along the motion,
            (p,) places of their motors, and (p, 5) stiffness, damping, integral gain, limit and
            dead band.
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
