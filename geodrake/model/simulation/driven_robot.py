"""A Drake plant that is moved by actuators, and whose joints follow others.

A plant knows its joints alone. Its model's coordinates are those of actuators, or lack joints that
follow others. Effects see the model's motion; with the acceleration q̈ that the model has then, what
the plant needs at θ̈ = J q̈ + J̇ q̇ is its inverse dynamics. Where there are more joints than
actuators, what drifts from θ = T(q) is drawn back to it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from geodrake.effects import RobotMotion, Role
from geodrake.effects.robot_motion import log_number, smoothed_sign
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.logs.temperatures import Temperatures
from geodrake.model.simulation.terms import PlantMotion
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import inverse_dynamics
from geodrake.robot.robot_instance import RobotInstance

Model = Any
"""A `RobotModel`, which imports this module."""

_RETURN = 50.0  # rate at which joints come back to where their actuators have them, 1/s


class DrivenPlant(PlantMotion):
    """A plant that moves with a model of other coordinates.

    Attributes:
        model: The model, whose q, v, efforts and effects are meant.
    """

    driven = True

    def __init__(
        self,
        model: Model,
        plant: MultibodyPlant,
        sign_width: Array,
        log: str | None,
        temperatures: Temperatures | None,
    ) -> None:
        """Refuse effects that give way; see `RobotModel.driving`."""
        for effect in (fitted.effect for fitted in model.effects):
            if effect.role is Role.DEFLECTION:
                raise ModelError(
                    f"{effect.name} of {effect.place} cannot be simulated where joints follow "
                    "others or are behind a transmission.",
                    advice="Leave it out of the model there.",
                )
        self.model, self.plant, self.robot = model, plant, RobotInstance(plant)
        self.joints, self.phi, self.temperatures = model.joints, model.total_phi, temperatures
        self._sign_width, self.direction = sign_width, smoothed_sign(sign_width)
        self._log = 0 if log is None else log_number(log)
        self._find_places(*model.single_places)
        self._others = np.zeros(0, int)

    @property
    def sizes(self) -> tuple[int, int]:
        """Return how many positions and velocities the model has."""
        return self.model.tree.num_positions, len(self.joints)

    def split(self, state: Array) -> tuple[Array, Array]:
        """Return q and v of the model, of a state of the plant."""
        nq, own, actuation = self.plant.num_positions(), self.model.own, self.model.tree.actuation
        theta, rate = state[:nq][own.positions], state[nq:][own.velocities]
        if actuation is None:
            return theta, rate
        q = actuation.nearest(theta[None])
        return q[0], np.asarray(np.linalg.pinv(actuation.jacobian(q)[0]) @ rate)

    def joined(self, q: Array, v: Array) -> Array:
        """Return the state of the plant of q and v of the model."""
        ways = self.model.coordinates
        return np.concatenate([ways.tree_positions(q[None])[0], ways.jacobian(q[None])[0] @ v])

    def moving_force(self, state: Array, acceleration: Array) -> Array:
        """Return what (nv of the plant,) the plant needs to move as its model, accelerated so."""
        q, v = self.split(state)
        ways, nq = self.model.coordinates, self.plant.num_positions()
        J, rate = ways.jacobian(q[None])[0], ways.jacobian_rate(q[None], v[None])[0]
        wanted = J @ acceleration + rate @ v
        if len(v) < len(wanted):
            apart = state - self.joined(q, v)
            off = self.plant.MapQDotToVelocity(self._context, apart[:nq])
            wanted -= 2.0 * _RETURN * apart[nq:] + _RETURN**2 * off
        sample = state[None, :nq], state[None, nq:], wanted[None]
        return inverse_dynamics(self._plant_tree, *sample, self.phi)[0]

    def dynamics(self, q: Array, v: Array, phi: Array) -> tuple[Array, Array, Array]:
        """Return M, and C v − τ_g twice, at q (nq,) and v (nv,)."""
        count = len(v)
        places, rates = (np.repeat(x[None], count + 1, axis=0) for x in (q, v))
        *units, drift = inverse_dynamics(
            self.model.tree, places, rates, np.eye(count + 1, count), phi
        )
        return (np.array(units) - drift).T, drift, drift

    def trial(self, v: Array, vd: Array, load: Array) -> RobotMotion:
        """Return the model in some configurations, of v, v̇ and loads (N, nv), to try effects."""
        q = np.random.default_rng(0).normal(size=(len(v), self.sizes[0]))
        return self.seen(self.model.tree.inside(q), (v, vd, load), self.phi)

    def seen(
        self, q: Array, rates: tuple[Array, Array, Array], phi: Array, **known: Any
    ) -> RobotMotion:
        """Return a motion as effects see it."""
        *motion, load = q, *rates
        seen = self.model.motion(Motion(*motion), sign_width=self._sign_width, load=load)
        return replace(seen, log=self._log, **known)

    @cached_property
    def _plant_tree(self) -> KinematicTree:
        return KinematicTree.from_plant(self.plant)

    @cached_property
    def _context(self) -> Context:
        return self.plant.CreateDefaultContext()
