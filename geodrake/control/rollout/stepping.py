"""Simulations of rigid robots, all passages at a time, by implicit steps.

Dry friction and small rotors are stiff: an integrator that looks at its error takes tens of
thousands of evaluations for half a second. Here accelerations a are those at which

    M a + h + Σ efforts of effects = u,   v = V + γ h a,   q = Q + γ h v,

in two stages a step, by the singly diagonally implicit method of second order and L-stable
(γ = 1 − √½). Newton's method finds them, with slopes of effects and servos joint by joint, and of
all passages together, as calls take as long for one sample as for fifty.
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
from geodrake.effects.robot_motion import log_number
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import ServoError, ServoGains
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics

_SHORTEST_STEP, _LONGEST_STEP = 1e-3, 5e-3  # s
_TURNS = 0.3  # rad that the fastest swing takes in a step
_TURNED = 0.5  # rad or m, by which a joint that is thrown about moves in a step
_FINER, _FINEST = 4, 16  # times shorter steps follow it, by turns and at last
_LOST = 30.0  # rad or m, by which a joint that is lost moves in a step
_GAMMA = 1.0 - np.sqrt(0.5)
_SETTLED = 3e-3  # of the speeds below which dry friction fades, by which velocities change at last
_MOST_ROUNDS, _CROSSING_ROUNDS = 40, 10  # of Newton, and in which friction is taken at rest
_MOVED = 1e-6  # rad or m, and shares of efforts and of speeds, for slopes


class State(NamedTuple):
    """State of N robots."""

    position: Array  # (N, n)
    velocity: Array  # (N, n)
    integral: Array  # (N, n) of servos
    hidden: Array  # (N, h) states of effects


def steps_alone(model: RobotModel) -> bool:
    """Return whether a model can be simulated like that: rigid, each joint a coordinate."""
    roles = {fitted.effect.role for fitted in model.effects}
    plain = not (model.floating or model.followers or model.transmission)
    return plain and model.single_joints == model.joints and Role.DEFLECTION not in roles


@dataclass(frozen=True, eq=False)
class Stepping:
    """The N passages that are simulated together, in whose logs the robot carries the same."""

    conditions: Conditions
    passages: Sequence[Passage]
    finer: int = 1  # how many steps take the place of a usual one
    followed: Array | float = 0.0  # (N,) time for which longer steps followed each, s

    @cached_property
    def robots(self) -> list[LoggedRobot]:
        """The robot of each passage."""
        return [self.conditions.robots[passage.log] for passage in self.passages]

    @property
    def model(self) -> RobotModel:
        """The model of all of them."""
        return self.robots[0].model

    def positions(self) -> list[Array]:
        """Return positions (K, n) of each passage; NaN from where a robot flies apart."""
        times, q, v, lost = self._nodes()
        found = []
        for passage, own, *node, kept in zip(self.passages, times, q, v, ~lost, strict=True):
            found.append(np.full((len(passage.time), q.shape[2]), np.nan))
            if kept.sum() > 1:
                curve = CubicHermiteSpline(own[kept], *(x[kept] for x in node), extrapolate=False)
                # The last node may be less than the last instant by rounding.
                end = own[-1] if kept.all() else passage.time[-1]
                found[-1] = curve(np.minimum(passage.time, end))
        h = times[:, 1] - times[:, 0]
        rough = ~((np.abs(v) * h[:, None, None]).max(axis=(1, 2)) < _TURNED)
        followed = np.where(lost[:, -1], np.argmax(lost, axis=1) * h, np.inf)
        rough &= followed > self.followed  # what shorter steps lose as early is given up
        if rough.any() and self.finer < _FINEST:
            few = np.flatnonzero(rough).tolist()
            part = [self.passages[i] for i in few]
            shorter = Stepping(self.conditions, part, _FINER * self.finer, followed[few])
            for i, own in zip(few, shorter.positions(), strict=True):
                found[i] = own
        return found

    def _nodes(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Return times (N, K), positions and velocities (N, K, n) at the ends of steps.

        With them comes whether a robot has become too fast (N, K). The rest is left out once all
        have.
        """
        first = np.array([[passage.time[0]] for passage in self.passages])
        spans = np.array([[passage.time[-1]] for passage in self.passages]) - first
        state = self._begin()
        count = max(1, int(np.ceil(self.finer * spans.max() / self._step(state) - 1e-9)))
        h = spans / count
        times = first + h * np.add.outer(np.arange(count), [_GAMMA, 1.0]).ravel()  # ends of stages
        rows = zip(self.robots, self.passages, times, strict=True)
        acts = np.stack([robot.told(passage, own) for robot, passage, own in rows], axis=2)
        nodes, a = [state], np.zeros_like(state.velocity)
        lost = [np.zeros(len(h), bool)]
        for k in range(count):
            if lost[-1].all():
                break
            base, mass = state, self._mass(state)
            for stage in (2 * k, 2 * k + 1):
                now = Instant(times[:, stage], _GAMMA * h, mass, acts[:, stage])
                state, a = self._stage(base, now, a, ~lost[-1])
                rates = (x - y for x, y in zip(state, base, strict=True))
                shift = (1.0 - _GAMMA) / _GAMMA
                base = State(*(x + shift * r for x, r in zip(base, rates, strict=True)))
            nodes.append(state)
            speed = np.abs(state.velocity)
            fast = (speed >= self._most) | (speed * h >= _LOST)
            lost.append(lost[-1] | fast.any(axis=1))
        q, v = (np.stack([node[i] for node in nodes], axis=1) for i in range(2))
        return first + h * np.arange(len(nodes)), q, v, np.stack(lost, axis=1)

    def _step(self, state: State) -> float:
        """Return how long steps may be, s: what swings freely is followed."""
        still = np.zeros_like(state.velocity)
        acts = np.broadcast_to(still, (3, *still.shape))
        now = Instant(np.zeros(len(still)), still[:, :1], self._mass(state), acts)
        moving = state.position, still + self.conditions.fastest, still
        (by_q, by_v, by_a, _), (kp, kd) = (
            self._needed(state, moving, now)[1],
            self._given(state, moving[:2], now)[2],
        )
        inertia = np.diagonal(now.mass, axis1=1, axis2=2) + by_a
        stiffness, damping = by_q + kp, by_v + kd
        swings = damping**2 < 4.0 * inertia * stiffness
        fastest = np.sqrt(np.where(swings, stiffness / inertia, 0.0).max())
        return float(np.clip(_TURNS / max(fastest, _MOVED), _SHORTEST_STEP, _LONGEST_STEP))

    @property
    def _most(self) -> Array:
        """Speeds (n,) that no robot has."""
        return FASTEST * self.conditions.fastest

    @cached_property
    def _gains(self) -> ServoGains:
        """Gains (N, n) of the servos."""
        rows = zip(*(robot.gains for robot in self.robots), strict=True)
        return ServoGains(*map(np.array, rows))

    def _begin(self) -> State:
        """Return how the passages begin, by the measured motion before them."""
        width, rows = self.conditions.sign_width, []
        for robot, passage in zip(self.robots, self.passages, strict=True):
            hidden = hidden_states(self.model, passage, width).values()
            first = passage.segment.position[0], passage.segment.velocity[0]
            rows.append((*first, robot.begun(passage), np.concatenate([np.zeros(0), *hidden])))
        return State(*map(np.array, zip(*rows, strict=True)))

    def _mass(self, state: State) -> Array:
        """Return mass matrices (N, n, n) of the bodies."""
        q, rest = self.model.positions(state.position), np.zeros_like(state.velocity)
        return effort_slopes(self.model.tree, q, rest, rest, self.model.total_phi).acceleration

    def _slopes(self, q: Array, v: Array, a: Array, step: Array) -> Array:
        """Return slopes (N, n, n) of what bodies need with the accelerations of a step."""
        model, h = self.model, step[:, :, None]
        by = effort_slopes(model.tree, model.positions(q), v, a, model.total_phi)
        return np.asarray(by.acceleration + h * (by.velocity + h * by.position))

    def _stage(
        self, base: State, now: Instant, a: Array, counted: NDArray[np.bool_]
    ) -> tuple[State, Array]:
        """Return the state after an implicit step, and the accelerations (N, n) that lead there.

        Newton's steps end when the robots that are counted (N,) have settled.
        """
        width, step = self.conditions.sign_width, now.step
        for round_ in range(_MOST_ROUNDS):
            v = base.velocity + step * a
            q = base.position + step * v
            needed, slopes, hidden = self._needed(base, (q, v, a), now)
            given, integral, servo = self._given(base, (q, v), now)
            by_q, by_v, by_a, by_load = slopes
            bodies = now.mass if round_ < _CROSSING_ROUNDS else self._slopes(q, v, a, step)
            J = bodies * (1.0 + by_load[:, :, None])
            diagonal = by_a + step * (by_v + servo[1]) + step**2 * (by_q + servo[0])
            J[:, range(len(width)), range(len(width))] += diagonal
            ahead = v + step * np.linalg.solve(J, (given - needed)[:, :, None])[:, :, 0]
            ahead = np.clip(np.nan_to_num(ahead, nan=np.inf), -self._most, self._most)
            if round_ < _CROSSING_ROUNDS:  # from rest on, Newton's steps reach no other side
                ahead[(v * ahead < 0.0) & (np.abs(v) > _SETTLED * width)] = 0.0
            a = (ahead - base.velocity) / step
            if (np.abs(ahead - v) < _SETTLED * width)[counted].all():
                break
        return State(base.position + step * ahead, ahead, integral, hidden), a

    def _given(
        self, base: State, at: tuple[Array, Array], now: Instant
    ) -> tuple[Array, Array, tuple[Array, Array]]:
        """Return efforts (N, n) that act, integrals afterwards, and slopes of what servos give.

        These are with positions and velocities, less than zero.
        """
        (command, rate, beside), gains = now.acts, self._gains
        told = gains.kp + gains.ki + gains.kd > 0.0
        behind = np.where(told, command - at[0], 0.0)
        error = ServoError(behind, rate - at[1], base.integral, beside)
        integral = base.integral + now.step * gains.integral_rate(error)
        effort = gains.effort(error._replace(integral=integral))
        free = np.abs(effort) < gains.limit
        acts = free & (np.abs(behind) > gains.dead_band)
        slopes = acts * (gains.kp + now.step * gains.ki), free * gains.kd
        share = np.ones(len(self.conditions.fastest))
        for fitted in self.model.effects:
            if fitted.effect.role is Role.SCALE:
                share[self.model.joints.index(fitted.effect.where[0])] += fitted.parameters[0]
        return effort / share, integral, (slopes[0] / share, slopes[1] / share)

    def _needed(
        self, base: State, at: tuple[Array, Array, Array], now: Instant
    ) -> tuple[Array, tuple[Array, ...], Array]:
        """Return efforts (N, n) that a motion needs, their slopes, and hidden states afterwards.

        Slopes (N, n) are those of effects with positions, velocities, accelerations and loads.
        """
        q, v, a = at
        model, count = self.model, len(q)
        load = inverse_dynamics(model.tree, model.positions(q), v, a, model.total_phi)
        sizes = [_MOVED + 0.0 * q, _MOVED * self.conditions.sign_width + 0.0 * v, 1.0 + 0.0 * a]
        sizes.append(_MOVED * (1.0 + np.abs(load)))
        seen = [np.tile(x, (5, 1)) for x in (q, v, a, load)]
        for k, size in enumerate(sizes):
            seen[k][(k + 1) * count : (k + 2) * count] += size
        warmth = None
        if any(robot.temperatures is not None for robot in self.robots):
            rows = zip((r.temperatures for r in self.robots), now.time.tolist(), strict=True)
            none = np.full((1, len(self.conditions.fastest)), np.nan)
            each = [none if w is None else w.at(t, model.joints) for w, t in rows]
            warmth = np.tile(np.concatenate(each), (5, 1))
        time = np.tile(now.time, 5)
        motion = Motion(model.positions(seen[0]), seen[1], seen[2], time, temperature=warmth)
        whole = model.motion(motion, sign_width=self.conditions.sign_width, load=seen[3])
        whole = replace(whole, log=log_number(self.passages[0].log))
        whole, hidden = self._with_states(whole, base.hidden, now.step)
        effort = np.zeros_like(seen[3])
        for fitted in model.effects:
            if fitted.effect.role in (Role.FORCE, Role.EPISODE):
                effort += fitted.effect.effort(whole, fitted.parameters)
        here, *others = np.split(effort, 5)
        pairs = zip(others, sizes, strict=True)
        return load + here, tuple((other - here) / size for other, size in pairs), hidden[:count]

    def _with_states(
        self, seen: RobotMotion, hidden: Array, step: Array
    ) -> tuple[RobotMotion, Array]:
        """Return a motion (5 N) with hidden states after an implicit step, and these (5 N, h)."""
        before, steps, start = np.tile(hidden, (5, 1)), np.tile(step, (5, 1)), 0
        after, states = before.copy(), {}
        for effect in (fitted.effect for fitted in self.model.effects):
            if effect.state_count:
                own = slice(start, start := start + effect.state_count)
                rate = effect.state_rates(seen, before[:, own])
                decay = rate - effect.state_rates(seen, before[:, own] + 1.0)
                after[:, own] += steps * rate / (1.0 + steps * decay)
                states[effect] = after[:, own]
        return replace(seen, states=states), after


class Instant(NamedTuple):
    """An end of a stage."""

    time: Array  # (N,) since logs began, s
    step: Array  # (N, 1) from where the stage begins, s
    mass: Array  # (N, n, n) of the bodies
    acts: Array  # (3, N, n) commands, their rates, and efforts of joints without a servo
