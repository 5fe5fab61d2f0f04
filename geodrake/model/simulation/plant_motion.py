"""The motion of a plant as effects see it, and the dynamics of its bodies."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.autodiffutils import AutoDiffXd
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, MultibodyForces_

from geodrake.boundary.arguments import one_or_each
from geodrake.effects import RobotMotion
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.robot_motion import smoothed_sign
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, change_frame, inertial_parameters
from geodrake.inertia.bodies import Member, lumped_bodies
from geodrake.logs.temperatures import Temperatures
from geodrake.model.formulas.rigid_bodies import BodyFormulas, inverse_dynamics_formula
from geodrake.model.formulas.symbols import Formulas, Symbols
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import set_inertial_parameters
from geodrake.robot.regressor import inverse_dynamics_regressor
from geodrake.robot.robot_instance import RobotInstance


class PlantMotion:
    """What is constant about a plant, for the motion that effects see.

    Attributes:
        robot: The robot in the plant; effects act on nothing else.
        joints: Names of the nv velocities.
        positions: (nv,) where the position of each velocity is in q; −1 for joints of several
            degrees of freedom.
        direction: The smoothed sign of velocities (nv,).
        phi: (nb, 10) inertial parameters of the plant's default Context.
        inertia_units: (nv,) units of what resists the acceleration of each velocity.
        temperatures: Those of the joints, if any are known.
    """

    def __init__(
        self,
        plant: MultibodyPlant | RobotInstance,
        sign_width: ArrayLike,
        log: int = 0,
        temperatures: Temperatures | None = None,
    ) -> None:
        """Reads a plant.

        Args:
            sign_width: Speed below which dry friction fades, rad/s or m/s; one or (nv,), of a robot
                in a plant (n,).
            log: Number of the log that is simulated, as in `RobotMotion`.
            temperatures: Those of the joints in the time of that log, if any are known.
        """
        robot = plant if isinstance(plant, RobotInstance) else RobotInstance(plant)
        self.robot, self.plant, self._log = robot, (plant := robot.plant), log
        self.phi, self.temperatures = inertial_parameters(plant), temperatures
        self.joints = robot.velocity_names
        width = one_or_each(sign_width, "sign_width", len(robot.joints))
        self._sign_width = np.ones(len(self.joints))  # that of other robots does not matter
        self._sign_width[robot.velocities] = width
        self._others = np.delete(np.arange(len(self.joints)), robot.velocities)
        self.direction = smoothed_sign(self._sign_width)
        self.positions = np.full(len(self.joints), -1)
        self.inertia_units = ["kg·m²"] * len(self.joints)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(JointIndex(index))
            if joint.num_velocities() == 1:
                self.positions[joint.velocity_start()] = joint.position_start()
                if joint.type_name() == "prismatic":
                    self.inertia_units[joint.velocity_start()] = "kg"
        several = np.flatnonzero(self.positions < 0)
        self._several = several if len(several) else None
        self._bodies: dict[str, tuple[int, Member]] = {
            robot.body_names[member.name]: (i, member)
            for i, body in enumerate(lumped_bodies(plant))
            for member in body.members
        }

    @cached_property
    def tree(self) -> KinematicTree:
        """Return the plant's kinematics."""
        tree = KinematicTree.from_plant(self.plant)
        return replace(tree, bodies=tuple(self.robot.body_names[name] for name in tree.bodies))

    def own(self, effort: Any) -> Any:
        """Return efforts (..., nv) without those that would act on other robots and on objects."""
        effort[..., self._others] = 0.0
        return effort

    def trial(self, v: Array, vd: Array, load: Array) -> RobotMotion:
        """Return the plant in some configurations, of v, v̇ and loads (N, nv), to try effects."""
        q = np.tile(self.plant.GetPositions(self.plant.CreateDefaultContext()), (len(v), 1))
        single = self.positions[self.positions >= 0]
        q[:, single] = np.random.default_rng(0).normal(size=(len(v), len(single)))
        return self.seen(q, (v, vd, load), self.phi)

    def seen(
        self, q: Array, rates: tuple[Array, Array, Array], phi: Array, **known: Any
    ) -> RobotMotion:
        """Return a motion as effects see it.

        Args:
            q: (N, nq) positions.
            rates: (N, nv) velocities, accelerations and loads.
            phi: (nb, 10) inertial parameters of the bodies.
        """
        regressor = cache(lambda: inverse_dynamics_regressor(self.tree, q, *rates[:2]))

        def columns(name: str) -> Array:
            index, to_lump = self._in_lump(name)
            start = PARAMETERS_PER_BODY * index
            return regressor()[..., start : start + PARAMETERS_PER_BODY] @ to_lump

        bodies = RobotBodies(self.tree, q, phi)
        return self._motion(self.of_joints(q), rates, columns, bodies, **known)

    def formulas(
        self, q: Formulas, rates: tuple[Formulas, Formulas, Formulas], phi: Array, **known: Any
    ) -> RobotMotion:
        """Return one sample in symbols as effects see it; see `seen`."""
        v, vd, _ = rates
        at_joints = Symbols.of(np.full((1, len(self.joints)), np.nan))
        single = self.positions >= 0
        at_joints[:, single] = q[:, self.positions[single]]

        def columns(name: str) -> Formulas:
            index, to_lump = self._in_lump(name)
            unit = np.zeros((PARAMETERS_PER_BODY, *phi.shape))
            unit[:, index] = np.eye(PARAMETERS_PER_BODY)
            efforts = [inverse_dynamics_formula(self.tree, q[0], v[0], vd[0], x) for x in unit]
            return Symbols.of(np.stack(efforts, -1) @ to_lump)[None]

        return self._motion(at_joints, rates, columns, BodyFormulas(self.tree, q, phi), **known)

    def _motion(
        self, q: Array, rates: tuple[Array, Array, Array], columns: Any, bodies: Any, **known: Any
    ) -> RobotMotion:
        width = self._sign_width
        return RobotMotion(self.joints, q, *rates, width, columns, bodies, log=self._log, **known)

    def of_joints(self, q: Array) -> Array:
        """Return the position belonging to each velocity, NaN for joints of several degrees."""
        found = q.take(self.positions, axis=-1)
        if self._several is not None:
            found[..., self._several] = np.nan
        return found

    def _in_lump(self, name: str) -> tuple[int, Array]:
        """Return the lump of a body, and (10, 10) from the body's parameters to the lump's."""
        if name not in self._bodies:
            raise ArgumentError(
                f"There is no moving body {name!r}.",
                advice=f"Bodies are: {', '.join(self._bodies)}.",
            )
        index, member = self._bodies[name]
        R_RB, p_RoBo_R = member.X_RB.rotation().matrix(), member.X_RB.translation()
        return index, change_frame(np.eye(PARAMETERS_PER_BODY), R_RB, p_RoBo_R).T


class PlantDynamics:
    """Dynamics of a plant in Contexts of its own, overwritten by every evaluation."""

    def __init__(self, plant: MultibodyPlant) -> None:
        """Makes the Context."""
        self._plant, self._context = plant, plant.CreateDefaultContext()
        self._phi = np.zeros(0)
        self._autodiff: tuple[Any, Any] | None = None

    def context(self, phi: Array) -> Any:
        """Return the Context of floats, with inertial parameters (nb, 10)."""
        if not np.array_equal(self._phi, phi):
            set_inertial_parameters(self._plant, self._context, phi)
            self._phi, self._autodiff = phi.copy(), None
        return self._context

    def at(self, q: Any, v: Any, phi: Array) -> tuple[Any, Any, Any]:
        """Return M, C v − τ of all force elements, and C v − τ_g alone, of the plant.

        Args:
            q: (nq,) positions, of floats or AutoDiffXd.
            v: (nv,) velocities.
            phi: (nb, 10) inertial parameters.
        """
        plant, context, scalar = self._plant, self.context(phi), float
        if np.asarray(q).dtype == object:
            if self._autodiff is None:
                other = plant.ToAutoDiffXd()
                self._autodiff = other, other.CreateDefaultContext()
                self._autodiff[1].SetTimeStateAndParametersFrom(context)
            (plant, context), scalar = self._autodiff, AutoDiffXd
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        forces = MultibodyForces_[scalar](plant)
        plant.CalcForceElementsContribution(context, forces)
        drift = plant.CalcInverseDynamics(context, 0.0 * v, forces)
        rigid_drift = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        return plant.CalcMassMatrix(context), drift, rigid_drift
