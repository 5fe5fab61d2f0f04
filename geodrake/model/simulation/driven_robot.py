"""A Drake plant that is moved by actuators, and whose joints follow others.

A plant knows its joints alone. A system here stands between it and a model whose coordinates are
those of actuators, or lack joints that follow others: it makes the model's state of the plant's,
and the plant's generalized forces of the efforts τ at the actuators. There the robot accelerates so
that it needs just these efforts, M q̈ + h = τ with all effects in M and h, and what the plant needs
for that at θ̈ = J q̈ + J̇ q̇ is its inverse dynamics. Where there are more joints than actuators, what
drifts from θ = T(q) is drawn back to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from geodrake.effects import Role
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.logs.temperatures import Temperatures
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.followers import OwnPlaces
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import inverse_dynamics

Model = Any
"""A `RobotModel`, which imports this module."""

_RETURN = 50.0  # rate at which joints come back to where their actuators have them, 1/s
_MOST_ITERATIONS = 100
_TOLERANCE = 1e-10

Needed = Callable[[Array, Array, Array, float], Array]
"""Effort (N, nv) that a motion q, v, v̇ (N, ·) needs at a time, effects included."""


@dataclass(frozen=True, eq=False)
class Driving:
    """How a plant moves with a model.

    Attributes:
        coordinates: How all joints of the plant move.
        own: Which positions and velocities of the plant are those of the tree's joints.
        phi: (nb, 10) inertial parameters, payloads included.
        names: Names of the model's velocities.
        needed: What effort a motion needs.
        gain: (nv,) measured effort over the one that acts.
    """

    plant: MultibodyPlant
    tree: KinematicTree
    coordinates: RobotCoordinates
    own: OwnPlaces
    phi: Array
    names: tuple[str, ...]
    needed: Needed
    gain: Array

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Return nq and nv of the plant, then of the model."""
        plant, tree = self.plant, self.tree
        own = tree.num_positions, tree.num_velocities
        return plant.num_positions(), plant.num_velocities(), *own

    def in_plant(self, plant: MultibodyPlant) -> Driving:
        """Return the same with another plant of the same robot."""
        return replace(self, plant=plant)

    def model_state(self, state: Array) -> tuple[Array, Array]:
        """Return q (nq,) and v (nv,) of the model, of a state of the plant."""
        nq, own = self.sizes[0], self.own
        theta, rate = state[:nq][own.positions], state[nq:][own.velocities]
        if self.tree.actuation is None:
            return theta, rate
        q = self.tree.actuation.nearest(theta[None])
        J = self.tree.actuation.jacobian(q)[0]
        return q[0], np.asarray(np.linalg.pinv(J) @ rate)

    def plant_state(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return positions and velocities of the plant, of those (nq,), (nv,) of the model."""
        J = self.coordinates.jacobian(q[None])[0]
        return self.coordinates.tree_positions(q[None])[0], np.asarray(J @ v)

    def plant_force(self, state: Array, effort: Array, time: float) -> Array:
        """Return generalized forces (nv of the plant,) of the actuators' efforts and all effects.

        Args:
            effort: (nv,) efforts of the model, N·m or N.
            time: Time since the log began, s.
        """
        q, v = self.model_state(state)
        ways = self.coordinates
        J, rate = ways.jacobian(q[None])[0], ways.jacobian_rate(q[None], v[None])[0]
        whole, rates = ways.tree_positions(q[None])[0], J @ v
        acceleration = J @ self.acceleration(q, v, effort / self.gain, time) + rate @ v
        nq, nv, _, own = self.sizes
        if own < nv:
            off = self.plant.MapQDotToVelocity(self._context, state[:nq] - whole)
            acceleration -= 2.0 * _RETURN * (state[nq:] - rates) + _RETURN**2 * off
        sample = state[None, :nq], state[None, nq:], acceleration[None]
        return inverse_dynamics(self._plant_tree, *sample, self.phi)[0]

    def acceleration(self, q: Array, v: Array, effort: Array, time: float) -> Array:
        """Return q̈ (nv,) at q (nq,) and v (nv,) under efforts (nv,) that act at the actuators.

        What is needed is affine in q̈, but for friction that depends on the load.
        """
        M, needed = self.mass_and_drift(q, v, time)
        size = 1.0 + np.abs(effort).max()
        found: Array = np.asarray(np.linalg.solve(M, effort - needed), float)
        for _ in range(_MOST_ITERATIONS):
            rest = effort - self.needed(q[None], v[None], found[None], time)[0]
            if np.abs(rest).max() <= _TOLERANCE * size:
                return found
            found = found + np.asarray(np.linalg.solve(M, rest), float)
        raise ModelError(
            f"Load-dependent friction does not settle; {np.abs(rest).max():.3g} N·m are left.",
            advice="Give it a load factor well below 1; above, a gear locks itself.",
        )

    def mass_and_drift(self, q: Array, v: Array, time: float) -> tuple[Array, Array]:
        """Return M (nv, nv), and the effort (nv,) that is needed without acceleration."""
        count = len(v)
        places, rates = (np.repeat(x[None], count + 1, axis=0) for x in (q, v))
        efforts = self.needed(places, rates, np.eye(count + 1, count), time)
        return (efforts[:count] - efforts[count]).T, efforts[count]

    @cached_property
    def _plant_tree(self) -> KinematicTree:
        return KinematicTree.from_plant(self.plant)

    @cached_property
    def _context(self) -> Context:
        return self.plant.CreateDefaultContext()


def driving_of(
    model: Model, sign_width: Array, log: str | None, temperatures: Temperatures | None
) -> Driving:
    """Return how a plant of a model moves; see `RobotModel.driving`."""
    gain = np.ones(len(model.joints))
    for fitted in model.effects:
        effect = fitted.effect
        if effect.role is Role.DEFLECTION or effect.state_count:
            raise ModelError(
                f"{effect.name} of {effect.place} cannot be simulated where joints follow "
                "others or are behind a transmission.",
                advice="Leave it out of the model there.",
            )
        if effect.role is Role.SCALE:
            gain[model.joints.index(effect.where[0])] *= 1.0 + fitted.parameters[0]
    number = 0 if log is None else log_number(log)

    def needed(q: Array, v: Array, vd: Array, time: float) -> Array:
        instants = np.full(len(q), time)
        warmth = None if temperatures is None else temperatures.at(instants, model.joints)
        seen = model.motion(Motion(q, v, vd, temperature=warmth), sign_width=sign_width)
        return model.unscaled_effort(replace(seen, time=instants, log=number))

    ways = model.plant, model.tree, model.coordinates, model.own
    return Driving(*ways, model.total_phi, model.joints, needed, gain)


class DrivenPlant(LeafSystem):
    """What stands between a plant and a model of other coordinates.

    .. pydrake_system::

        name: DrivenPlant
        input_ports:
        - plant_state
        - effort
        output_ports:
        - state
        - generalized_force

    `state` is that of the model, `generalized_force` that of the plant by the model's efforts,
    effects included.
    """

    def __init__(self, driving: Driving) -> None:
        """Constructs the system for a plant and how it moves."""
        LeafSystem.__init__(self)
        self._driving = driving
        nq, nv, own_nq, own_nv = driving.sizes
        self._state_port = self.DeclareVectorInputPort("plant_state", BasicVector(nq + nv))
        self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(own_nv))
        known, size = {self._state_port.ticket()}, BasicVector(own_nq + own_nv)
        self.DeclareVectorOutputPort("state", size, self._calc_state, known)
        known = {*known, self._effort_port.ticket(), self.time_ticket()}
        self.DeclareVectorOutputPort("generalized_force", BasicVector(nv), self._calc_force, known)

    def close_loop(self, builder: DiagramBuilder) -> None:
        """Connects it with its plant; both are in the builder."""
        plant = self._driving.plant
        builder.Connect(plant.get_state_output_port(), self._state_port)
        port = plant.get_applied_generalized_force_input_port()
        builder.Connect(self.GetOutputPort("generalized_force"), port)

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        state = self._state_port.Eval(context)
        output.SetFromVector(np.concatenate(self._driving.model_state(state)))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        state, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        output.SetFromVector(self._driving.plant_force(state, effort, context.get_time()))
