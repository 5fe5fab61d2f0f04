"""Mass matrix and drift of a plant, with numbers of any of Drake's scalar types."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces_

from geodrake.inertia import Array
from geodrake.robot.plant import set_inertial_parameters


class PlantDynamics:
    """Dynamics of a plant in Contexts of its own, overwritten by every evaluation."""

    def __init__(self, plant: MultibodyPlant, phi: Array) -> None:
        """Makes the Context.

        Args:
            plant: The plant.
            phi: (nb, 10) inertial parameters.
        """
        self._plant, self._context = plant, plant.CreateDefaultContext()
        self._phi = np.zeros(0)
        self._others: dict[type, tuple[Any, Any]] = {}
        self._carry(phi)

    def _carry(self, phi: Array) -> None:
        """Gives the bodies inertial parameters (nb, 10)."""
        if not np.array_equal(self._phi, phi):
            set_inertial_parameters(self._plant, self._context, phi)
            self._phi = phi.copy()
            self._others = {}

    def context(self, phi: Array) -> Any:
        """The Context of floats, with inertial parameters (nb, 10)."""
        self._carry(phi)
        return self._context

    def at(self, q: Any, v: Any, phi: Array) -> tuple[Any, Any, Any]:
        """M, then C v − τ of all force elements, then C v − τ_g alone, of the plant.

        Args:
            q: (nq,) positions.
            v: (nv,) velocities.
            phi: (nb, 10) inertial parameters.
        """
        self._carry(phi)
        scalar = AutoDiffXd if np.asarray(q).dtype == object else float
        plant, context = self._of(scalar)
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        forces = MultibodyForces_[scalar](plant)
        plant.CalcForceElementsContribution(context, forces)
        drift = plant.CalcInverseDynamics(context, 0.0 * v, forces)
        rigid_drift = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        return plant.CalcMassMatrix(context), drift, rigid_drift

    def _of(self, scalar: type) -> tuple[Any, Any]:
        if scalar is float:
            return self._plant, self._context
        if scalar not in self._others:
            plant = self._plant.ToScalarType[scalar]()
            context = plant.CreateDefaultContext()
            context.SetTimeStateAndParametersFrom(self._context)
            self._others[scalar] = plant, context
        return self._others[scalar]
