"""Simulation of rigid robots, in all passages at once, by implicit steps.

Dry friction and small rotors are stiff: an error-controlled integrator needs tens of thousands of
evaluations for half a second. Here the accelerations a solve

    M a + h + Σ efforts of effects = u,   v = V + γ h a,   q = Q + γ h v,

in both stages of a second-order, L-stable SDIRK step (γ = 1 − √½). Newton's method uses the
derivatives of effects and servos at each joint. All passages are solved together, as a call takes
as long for one sample as for fifty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from geodrake.control.rollout.passages import FASTEST, Conditions, LoggedRobot, Passage
from geodrake.control.rollout.simulation import hidden_states
from geodrake.effects import RobotMotion, Role
from geodrake.effects.effect_columns import EffectColumns
from geodrake.effects.robot_motion import log_number
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import ServoError, ServoGains
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics

_SHORTEST_STEP, _LONGEST_STEP = 1e-3, 5e-3  # s
_PHASE = 0.3  # rad per step of the fastest oscillation
_ROUGH = 0.5  # rad or m per step, above which a passage is simulated again by shorter steps
_FINER, _FINEST = 4, 16  # refinement factor, and its largest product
_LOST = 30.0  # rad or m per step, above which a simulation has diverged
_GAMMA = 1.0 - np.sqrt(0.5)
_TOLERANCE = 3e-3  # of velocities, relative to the speeds below which dry friction fades
_MOST_ROUNDS, _CROSSING_ROUNDS = 40, 10  # of Newton, and in which friction is taken at rest
_DIFFERENCE = 1e-6  # rad or m, and shares of efforts and of speeds, for slopes


class State(NamedTuple):
    """State of N robots."""

    position: Array  # (N, n)
    velocity: Array  # (N, n)
    integral: Array  # (N, n) of servos
    hidden: Array  # (N, h) states of effects


def can_step(model: RobotModel) -> bool:
    """Return whether `Stepping` supports a model: rigid, with independent single joints."""
    roles = {fitted.effect.role for fitted in model.effects}
    is_independent = not (model.floating or model.followers or model.transmission)
    is_rigid = Role.DEFLECTION not in roles
    return is_independent and model.single_joints == model.joints and is_rigid


@dataclass(frozen=True, eq=False)
class Stepping:
    """Joint simulation of N passages, in whose logs the robot has the same payloads."""

    conditions: Conditions
    passages: Sequence[Passage]
    finer: int = 1  # factor by which steps are shortened
    followed: Array | float = 0.0  # (N,) time until longer steps diverged, s

    @cached_property
    def robots(self) -> list[LoggedRobot]:
        """The robot of each passage."""
        return [self.conditions.robots[passage.log] for passage in self.passages]

    @property
    def model(self) -> RobotModel:
        """The model of all of them."""
        return self.robots[0].model

    def positions(self) -> list[Array]:
        """Return positions (K, n) of each passage; NaN after divergence."""
        times, q, v, lost = self._nodes()
        positions = []
        for passage, time, *node, valid in zip(self.passages, times, q, v, ~lost, strict=True):
            positions.append(np.full((len(passage.time), q.shape[2]), np.nan))
            if valid.sum() > 1:
                values = (x[valid] for x in node)
                curve = CubicHermiteSpline(time[valid], *values, extrapolate=False)
                # Due to rounding, the last node may be slightly before the last sample.
                end = time[-1] if valid.all() else passage.time[-1]
                positions[-1] = curve(np.minimum(passage.time, end))
        h = times[:, 1] - times[:, 0]
        rough = ~((np.abs(v) * h[:, None, None]).max(axis=(1, 2)) < _ROUGH)
        followed = np.where(lost[:, -1], np.argmax(lost, axis=1) * h, np.inf)
        rough &= followed > self.followed  # give up if shorter steps diverge as early
        if rough.any() and self.finer < _FINEST:
            indices = np.flatnonzero(rough).tolist()
            part = [self.passages[i] for i in indices]
            finer = Stepping(self.conditions, part, _FINER * self.finer, followed[indices])
            for i, refined in zip(indices, finer.positions(), strict=True):
                positions[i] = refined
        return positions

    def _nodes(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Return times (N, K), positions and velocities (N, K, n) at the ends of steps.

        The fourth result is whether each robot has diverged (N, K). Steps end once all have.
        """
        first = np.array([[passage.time[0]] for passage in self.passages])
        spans = np.array([[passage.time[-1]] for passage in self.passages]) - first
        state = self._initial_state()
        count = max(1, int(np.ceil(self.finer * spans.max() / self._step(state) - 1e-9)))
        h = spans / count
        times = first + h * np.add.outer(np.arange(count), [_GAMMA, 1.0]).ravel()  # ends of stages
        rows = zip(self.robots, self.passages, times, strict=True)
        inputs = np.stack([robot.inputs(passage, time) for robot, passage, time in rows], axis=2)
        nodes, a = [state], np.zeros_like(state.velocity)
        lost = [np.zeros(len(h), bool)]
        for k in range(count):
            if lost[-1].all():
                break
            base, mass = state, self._mass(state)
            for stage in (2 * k, 2 * k + 1):
                end = StageEnd(times[:, stage], _GAMMA * h, mass, inputs[:, stage])
                state, a = self._stage(base, end, a, ~lost[-1])
                rates = (x - y for x, y in zip(state, base, strict=True))
                shift = (1.0 - _GAMMA) / _GAMMA
                base = State(*(x + shift * r for x, r in zip(base, rates, strict=True)))
            nodes.append(state)
            speed = np.abs(state.velocity)
            fast = (speed >= self._speed_limit) | (speed * h >= _LOST)
            lost.append(lost[-1] | fast.any(axis=1))
        q, v = (np.stack([node[i] for node in nodes], axis=1) for i in range(2))
        return first + h * np.arange(len(nodes)), q, v, np.stack(lost, axis=1)

    def _step(self, state: State) -> float:
        """Return a step, s, that resolves underdamped oscillations."""
        zero = np.zeros_like(state.velocity)
        inputs = np.broadcast_to(zero, (3, *zero.shape))
        end = StageEnd(np.zeros(len(zero)), zero[:, :1], self._mass(state), inputs)
        motion = state.position, zero + self.conditions.peak_speed, zero
        by_q, by_v, by_a, _ = self._needed_effort(state, motion, end)[1]
        kp, kd = self._applied_effort(state, motion[:2], end)[2]
        inertia = np.diagonal(end.mass, axis1=1, axis2=2) + by_a
        stiffness, damping = by_q + kp, by_v + kd
        oscillates = damping**2 < 4.0 * inertia * stiffness
        frequency = np.sqrt(np.where(oscillates, stiffness / inertia, 0.0).max())
        return float(np.clip(_PHASE / max(frequency, _DIFFERENCE), _SHORTEST_STEP, _LONGEST_STEP))

    @property
    def _speed_limit(self) -> Array:
        """(n,) speeds at which a simulation has diverged."""
        return FASTEST * self.conditions.peak_speed

    @cached_property
    def _gains(self) -> ServoGains:
        """Gains (N, n) of the servos."""
        rows = zip(*(robot.gains for robot in self.robots), strict=True)
        return ServoGains(*map(np.array, rows))

    @cached_property
    def _forces(self) -> tuple[EffectColumns, Array]:
        """Columns of the effects that are forces, and their parameters."""
        forces = [f for f in self.model.effects if f.effect.role in (Role.FORCE, Role.EPISODE)]
        columns = EffectColumns(self.model.joints, tuple(fitted.effect for fitted in forces))
        return columns, np.concatenate([np.zeros(0), *(fitted.parameters for fitted in forces)])

    def _initial_state(self) -> State:
        """Return the state at the start of the passages, after the measured motion before them."""
        width, rows = self.conditions.sign_width, []
        for robot, passage in zip(self.robots, self.passages, strict=True):
            hidden = np.concatenate([[], *hidden_states(self.model, passage, width).values()])
            position, velocity = passage.segment.position[0], passage.segment.velocity[0]
            rows.append((position, velocity, robot.initial_integrals(passage), hidden))
        return State(*map(np.array, zip(*rows, strict=True)))

    def _mass(self, state: State) -> Array:
        """Return mass matrices (N, n, n) of the bodies."""
        q, zero = self.model.positions(state.position), np.zeros_like(state.velocity)
        return effort_slopes(self.model.tree, q, zero, zero, self.model.total_phi).acceleration

    def _jacobian(self, q: Array, v: Array, a: Array, step: Array) -> Array:
        """Return derivatives (N, n, n) of the bodies' effort by the accelerations of a stage."""
        model, h = self.model, step[:, :, None]
        by = effort_slopes(model.tree, model.positions(q), v, a, model.total_phi)
        return np.asarray(by.acceleration + h * (by.velocity + h * by.position))

    def _stage(
        self, base: State, end: StageEnd, a: Array, active: NDArray[np.bool_]
    ) -> tuple[State, Array]:
        """Return the state after an implicit stage, and its accelerations (N, n).

        Newton's method ends when the active robots (N,) have converged.
        """
        width, limit, step = self.conditions.sign_width, self._speed_limit, end.step
        for round_ in range(_MOST_ROUNDS):
            v = base.velocity + step * a
            q = base.position + step * v
            needed, (by_q, by_v, by_a, by_load), hidden = self._needed_effort(base, (q, v, a), end)
            applied, integral, (kp, kd) = self._applied_effort(base, (q, v), end)
            bodies = end.mass if round_ < _CROSSING_ROUNDS else self._jacobian(q, v, a, step)
            J = bodies * (1.0 + by_load[:, :, None])
            diagonal = by_a + step * (by_v + kd) + step**2 * (by_q + kp)
            J[:, range(len(width)), range(len(width))] += diagonal
            next_v = v + step * np.linalg.solve(J, (applied - needed)[:, :, None])[:, :, 0]
            next_v = np.clip(np.nan_to_num(next_v, nan=np.inf), -limit, limit)
            if round_ < _CROSSING_ROUNDS:  # stop at reversals, as friction changes sign there
                next_v[(v * next_v < 0.0) & (np.abs(v) > _TOLERANCE * width)] = 0.0
            a = (next_v - base.velocity) / step
            if (np.abs(next_v - v) < _TOLERANCE * width)[active].all():
                break
        return State(base.position + step * next_v, next_v, integral, hidden), a

    def _applied_effort(
        self, base: State, motion: tuple[Array, Array], end: StageEnd
    ) -> tuple[Array, Array, tuple[Array, Array]]:
        """Return the applied efforts (N, n), the servos' integrals, stiffness and damping.

        The latter are the negative derivatives of efforts by positions and velocities (N, n).
        """
        (command, rate, feedforward), gains = end.inputs, self._gains
        has_servo = gains.kp + gains.ki + gains.kd > 0.0
        position_error = np.where(has_servo, command - motion[0], 0.0)
        error = ServoError(position_error, rate - motion[1], base.integral, feedforward)
        integral = base.integral + end.step * gains.integral_rate(error)
        effort = gains.effort(error._replace(integral=integral))
        unlimited = np.abs(effort) < gains.limit
        outside_band = unlimited & (np.abs(position_error) > gains.dead_band)
        stiffness = outside_band * (gains.kp + end.step * gains.ki)
        damping = unlimited * gains.kd
        scale = np.ones(len(self.conditions.peak_speed))
        for fitted in self.model.effects:
            if fitted.effect.role is Role.SCALE:
                scale[self.model.joints.index(fitted.effect.where[0])] += fitted.parameters[0]
        return effort / scale, integral, (stiffness / scale, damping / scale)

    def _needed_effort(
        self, base: State, motion: tuple[Array, Array, Array], end: StageEnd
    ) -> tuple[Array, tuple[Array, ...], Array]:
        """Return the needed efforts (N, n), derivatives of effects, and hidden states (N, h).

        Derivatives (N, n) are those by positions, velocities, accelerations and loads.
        """
        q, v, a = motion
        model, count, width = self.model, len(q), self.conditions.sign_width
        load = inverse_dynamics(model.tree, model.positions(q), v, a, model.total_phi)
        sizes = [_DIFFERENCE + 0.0 * q, _DIFFERENCE * width + 0.0 * v, 1.0 + 0.0 * a]
        sizes.append(_DIFFERENCE * (1.0 + np.abs(load)))
        # The motion itself, then with a change of each of the four.
        tiled = [np.tile(x, (5, 1)) for x in (q, v, a, load)]
        for k, size in enumerate(sizes):
            tiled[k][(k + 1) * count : (k + 2) * count] += size
        temperature = None
        if any(robot.temperatures is not None for robot in self.robots):
            rows = zip((r.temperatures for r in self.robots), end.time.tolist(), strict=True)
            unknown = np.full((1, len(width)), np.nan)
            values = [unknown if x is None else x.at(t, model.joints) for x, t in rows]
            temperature = np.tile(np.concatenate(values), (5, 1))
        time = np.tile(end.time, 5)
        q_drake = model.positions(tiled[0])
        series = Motion(q_drake, tiled[1], tiled[2], time, temperature=temperature)
        robot_motion = model.motion(series, sign_width=width, load=tiled[3])
        robot_motion = replace(robot_motion, log=log_number(self.passages[0].log))
        robot_motion, hidden = self._with_states(robot_motion, base.hidden, end.step)
        columns, parameters = self._forces
        nominal, *changed = np.split(columns.effort(robot_motion, parameters), 5)
        pairs = zip(changed, sizes, strict=True)
        slopes = tuple((other - nominal) / size for other, size in pairs)
        return load + nominal, slopes, hidden[:count]

    def _with_states(
        self, motion: RobotMotion, hidden: Array, step: Array
    ) -> tuple[RobotMotion, Array]:
        """Return a motion (5 N) with hidden states after an implicit step, and these (5 N, h)."""
        initial, steps, start = np.tile(hidden, (5, 1)), np.tile(step, (5, 1)), 0
        final, states = initial.copy(), {}
        for effect in (fitted.effect for fitted in self.model.effects):
            if effect.state_count:
                part = slice(start, start := start + effect.state_count)
                rate = effect.state_rates(motion, initial[:, part])
                decay = rate - effect.state_rates(motion, initial[:, part] + 1.0)
                final[:, part] += steps * rate / (1.0 + steps * decay)
                states[effect] = final[:, part]
        return replace(motion, states=states), final


class StageEnd(NamedTuple):
    """Data at the end of a stage."""

    time: Array  # (N,) since logs began, s
    step: Array  # (N, 1) duration of the stage, s
    mass: Array  # (N, n, n) of the bodies
    inputs: Array  # (3, N, n) commands, their rates, and efforts of joints without a servo
