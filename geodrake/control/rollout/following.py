"""Efforts that make some joints of a Drake plant follow others, in a simulation.

A plant knows nothing of followers. Where the efforts τ act on all its joints, the robot accelerates
at q̈ = M⁻¹(Jᵀ τ − h), with M and h of its own coordinates q; what the plant needs for that, at
θ̈ = J q̈, is its inverse dynamics there. So a state θ = J q + θ₀ stays one.
"""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import inverse_dynamics


class FollowingEffort(LeafSystem):
    """Generalized forces under which followers follow, in the place of others.

    .. pydrake_system::

        name: FollowingEffort
        input_ports:
        - state
        - effort
        output_ports:
        - generalized_force
    """

    def __init__(self, model: RobotModel) -> None:
        """Constructs the system for the plant of a model and its inertias, payloads included."""
        LeafSystem.__init__(self)
        self._model, self._phi = model, model.total_phi
        self._tree, self._ways = KinematicTree.from_plant(model.plant), model.coordinates
        self._nq, self._nv = model.plant.num_positions(), model.plant.num_velocities()
        self._J = self._ways.plant_velocities(np.eye(len(model.joints))).T
        self._state_port = self.DeclareVectorInputPort("state", BasicVector(self._nq + self._nv))
        self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(self._nv))
        self.DeclareVectorOutputPort(
            "generalized_force",
            BasicVector(self._nv),
            self._calc_force,
            {self._state_port.ticket(), self._effort_port.ticket()},
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        state, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        q, v = state[: self._nq], state[self._nq :]
        acceleration = self._J @ self._acceleration(q, v, effort)
        needed = inverse_dynamics(self._tree, q[None], v[None], acceleration[None], self._phi)
        output.SetFromVector(needed[0])

    def _acceleration(self, q: Array, v: Array, effort: Array) -> Array:
        """q̈ (nv of the robot) under efforts on all joints of the plant."""
        own, count = self._ways.own_velocities, len(self._model.joints)
        still = np.vstack([np.zeros((count, count)), v[own]])
        places = np.repeat(q[self._ways.own_positions][None], count + 1, axis=0)
        rates = np.eye(count + 1, count)
        efforts = inverse_dynamics(self._model.tree, places, still, rates, self._phi)
        resting = inverse_dynamics(self._model.tree, places[:1], still[:1], still[:1], self._phi)
        M = efforts[:-1] - resting
        return np.asarray(np.linalg.solve(0.5 * (M + M.T), self._J.T @ effort - efforts[-1]))
