"""The motion of a plant as effects see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex

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
from geodrake.robot.regressor import inverse_dynamics_regressor
from geodrake.robot.robot_instance import RobotInstance


class PlantMotion:
    """What is constant about a plant, for the motion that effects see.

    Attributes:
        robot: The robot in the plant.
        plant: The plant, finalized.
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
            plant: A finalized plant, or one robot in it: then effects act on nothing else.
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
        sliding = set[int]()
        for index in plant.GetJointIndices():
            joint = plant.get_joint(JointIndex(index))
            if joint.num_velocities() == 1:
                self.positions[joint.velocity_start()] = joint.position_start()
                if joint.type_name() == "prismatic":
                    sliding.add(joint.velocity_start())
        self.inertia_units = ["kg" if k in sliding else "kg·m²" for k in range(len(self.joints))]
        several = np.flatnonzero(self.positions < 0)
        self._several = several if len(several) else None
        self._bodies: dict[str, tuple[int, Member]] = {
            robot.body_names[member.name]: (i, member)
            for i, body in enumerate(lumped_bodies(plant))
            for member in body.members
        }

    @cached_property
    def tree(self) -> KinematicTree:
        """The plant's kinematics."""
        tree = KinematicTree.from_plant(self.plant)
        return replace(tree, bodies=tuple(self.robot.body_names[name] for name in tree.bodies))

    def own(self, effort: Any) -> Any:
        """Efforts (..., nv) without those that would act on other robots and on objects."""
        effort[..., self._others] = 0.0
        return effort

    def trial(self, v: Array, vd: Array, load: Array) -> RobotMotion:
        """The plant in some configurations, for trials of users' effects.

        Args:
            v: (N, nv) velocities.
            vd: (N, nv) accelerations.
            load: (N, nv) loads.
        """
        q = np.tile(self.plant.GetPositions(self.plant.CreateDefaultContext()), (len(v), 1))
        single = self.positions[self.positions >= 0]
        q[:, single] = np.random.default_rng(0).normal(size=(len(v), len(single)))
        return self.seen(q, (v, vd, load), self.phi)

    def seen(
        self, q: Array, rates: tuple[Array, Array, Array], phi: Array, **known: Any
    ) -> RobotMotion:
        """A motion as effects see it.

        Args:
            q: (N, nq) positions.
            rates: (N, nv) velocities, accelerations and loads.
            phi: (nb, 10) inertial parameters of the bodies.
            known: What else `RobotMotion` is to know.
        """
        v, vd, _ = rates
        columns = _BodyColumns(self.tree, self._bodies, q, v, vd)
        bodies = RobotBodies(self.tree, q, phi)
        return self._motion(self.of_joints(q), rates, columns, bodies, **known)

    def formulas(
        self, q: Formulas, rates: tuple[Formulas, Formulas, Formulas], phi: Array, **known: Any
    ) -> RobotMotion:
        """One sample in symbols as effects see it; see `seen`."""
        v, vd, _ = rates
        at_joints = Symbols.of(np.full((1, len(self.joints)), np.nan))
        single = self.positions >= 0
        at_joints[:, single] = q[:, self.positions[single]]

        def columns(name: str) -> Formulas:
            index, member = self._member(name)
            unit = np.zeros((PARAMETERS_PER_BODY, *phi.shape))
            unit[:, index] = np.eye(PARAMETERS_PER_BODY)
            efforts = [inverse_dynamics_formula(self.tree, q[0], v[0], vd[0], x) for x in unit]
            return Symbols.of(np.stack(efforts, -1) @ _to_lump(member))[None]

        return self._motion(at_joints, rates, columns, BodyFormulas(self.tree, q, phi), **known)

    def _motion(
        self, q: Array, rates: tuple[Array, Array, Array], columns: Any, bodies: Any, **known: Any
    ) -> RobotMotion:
        width = self._sign_width
        return RobotMotion(self.joints, q, *rates, width, columns, bodies, log=self._log, **known)

    def of_joints(self, q: Array) -> Array:
        """Position belonging to each velocity, NaN for joints of several degrees."""
        found = q.take(self.positions, axis=-1)
        if self._several is not None:
            found[..., self._several] = np.nan
        return found

    def _member(self, name: str) -> tuple[int, Member]:
        return member_of(self._bodies, name)


def member_of(bodies: Mapping[str, tuple[int, Member]], name: str) -> tuple[int, Member]:
    """Index of the lump of a body, and its place in it.

    Args:
        bodies: Name -> index and place of every moving body.
        name: Name of the body.

    Raises:
        ArgumentError: There is no such body.
    """
    if name not in bodies:
        raise ArgumentError(
            f"There is no moving body {name!r}.", advice=f"Bodies are: {', '.join(bodies)}."
        )
    return bodies[name]


def _to_lump(member: Member) -> Array:
    """(10, 10) from parameters of a body to those of the lump that it belongs to."""
    R_RB, p_RoBo_R = member.X_RB.rotation().matrix(), member.X_RB.translation()
    return change_frame(np.eye(PARAMETERS_PER_BODY), R_RB, p_RoBo_R).T


@dataclass(frozen=True, eq=False)
class _BodyColumns:
    """Inertial regressors (N, nv, 10) of bodies along a motion, computed once somebody asks.

    Attributes:
        tree: The plant's tree.
        bodies: Name -> index and place of every moving body.
        q: (N, nq) positions.
        v: (N, nv) velocities.
        vd: (N, nv) accelerations.
    """

    tree: KinematicTree
    bodies: Mapping[str, tuple[int, Member]]
    q: Array
    v: Array
    vd: Array

    @cached_property
    def _regressor(self) -> Array:
        return inverse_dynamics_regressor(self.tree, self.q, self.v, self.vd)

    def __call__(self, name: str) -> Array:
        """The regressor of one body."""
        i, member = member_of(self.bodies, name)
        start = PARAMETERS_PER_BODY * i
        columns = self._regressor[..., start : start + PARAMETERS_PER_BODY]
        return columns @ _to_lump(member)
