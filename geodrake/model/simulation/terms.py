"""Motion of a plant as the input of effects, and the efforts of effects."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.framework import Context

from geodrake.boundary.arguments import one_or_each
from geodrake.effects import Effect, JointMotion, RobotMotion, Role
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.effect_columns import EffectColumns
from geodrake.effects.robot_motion import log_number, smoothed_sign
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, change_frame, inertial_parameters
from geodrake.inertia.bodies import Member, lumped_bodies
from geodrake.logs.temperatures import Temperatures
from geodrake.robot.joints import joints_of
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import set_inertial_parameters
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor
from geodrake.robot.robot_instance import RobotInstance


class PlantMotion:
    """Constants and dynamics of a plant, and the motion for effects.

    Attributes:
        robot: The robot in the plant; effects act on nothing else.
        positions: (nv,) index in q of each velocity's position; −1 for joints of several degrees of
            freedom.
        direction: The smoothed sign of velocities (nv,).
        phi: (nb, 10) inertial parameters of the plant's default Context.
        inertia_units: (nv,) units of inertia.
        temperatures: Temperatures of the joints, if known.
        driven: The effects use a model's coordinates, which differ from the plant's.
    """

    driven = False

    def __init__(
        self,
        plant: MultibodyPlant | RobotInstance,
        sign_width: ArrayLike,
        log: int = 0,
        temperatures: Temperatures | None = None,
    ) -> None:
        """Read a plant; see `EffectForce`, and `RobotMotion` for the log's number."""
        robot = plant if isinstance(plant, RobotInstance) else RobotInstance(plant)
        self.robot, self.plant, self._log = robot, (plant := robot.plant), log
        self.phi, self.temperatures = inertial_parameters(plant), temperatures
        self._phi = np.zeros(0)
        self.joints = robot.velocity_names
        width = one_or_each(sign_width, "sign_width", len(robot.joints))
        self._sign_width = np.ones(len(self.joints))  # arbitrary at other robots
        self._sign_width[robot.velocities] = width
        self._others = np.delete(np.arange(len(self.joints)), robot.velocities)
        self.direction = smoothed_sign(self._sign_width)
        single = [joint for joint in joints_of(plant) if joint.num_velocities() == 1]
        starts = [int(joint.velocity_start()) for joint in single]
        self._find_places(starts, [int(joint.position_start()) for joint in single])
        self.inertia_units = ["kg·m²"] * len(self.joints)
        for joint, index in zip(single, starts, strict=True):
            if joint.type_name() == "prismatic":
                self.inertia_units[index] = "kg"

    @cached_property
    def _context(self) -> Context:
        return self.plant.CreateDefaultContext()

    @cached_property
    def _bodies(self) -> dict[str, tuple[int, Member]]:
        """Return link name -> index of its lumped body, and the member."""
        return {
            self.robot.body_names[member.name]: (i, member)
            for i, body in enumerate(lumped_bodies(self.plant))
            for member in body.members
        }

    def _find_places(self, velocities: list[int], positions: list[int]) -> None:
        """Set the position indices of joints of one degree of freedom."""
        self.positions = np.full(len(self.joints), -1)
        self.positions[velocities] = positions
        several = np.flatnonzero(self.positions < 0)
        self._several = several if len(several) else None

    @property
    def sizes(self) -> tuple[int, int]:
        """Return the numbers of positions and velocities of effects."""
        return self.plant.num_positions(), len(self.joints)

    def split(self, state: Array) -> tuple[Array, Array]:
        """Return q and v of effects for a state of the plant."""
        nq = self.plant.num_positions()
        return state[:nq], state[nq:]

    @cached_property
    def tree(self) -> KinematicTree:
        """Return the plant's kinematics."""
        tree = KinematicTree.from_plant(self.plant)
        return replace(tree, bodies=tuple(self.robot.body_names[name] for name in tree.bodies))

    def own(self, effort: Any) -> Any:
        """Set efforts (..., nv) on other robots and objects to zero, and return them."""
        effort[..., self._others] = 0.0
        return effort

    def trial(self, v: Array, vd: Array, load: Array) -> RobotMotion:
        """Return a motion in random configurations with v, v̇ and loads (N, nv), for probing."""
        still = self.plant.GetPositionsAndVelocities(self.plant.CreateDefaultContext())
        q, single = np.tile(self.split(still)[0], (len(v), 1)), self.positions[self.positions >= 0]
        q[:, single] = np.random.default_rng(0).normal(size=(len(v), len(single)))
        return self.seen(self.tree.inside(q), (v, vd, load), self.phi)

    def seen(
        self, q: Array, rates: tuple[Array, Array, Array], phi: Array, **known: Any
    ) -> RobotMotion:
        """Return the motion of effects."""
        regressor = cache(lambda: inverse_dynamics_regressor(self.tree, q, *rates[:2]))

        def columns(name: str) -> Array:
            index, to_lump = self._in_lump(name)
            start = PARAMETERS_PER_BODY * index
            return regressor()[..., start : start + PARAMETERS_PER_BODY] @ to_lump

        own = self.of_joints(q), *rates, self._sign_width, columns, RobotBodies(self.tree, q, phi)
        return RobotMotion(self.joints, *own, log=self._log, **known)

    def of_joints(self, q: Array) -> Array:
        """Return the position of each velocity, NaN for joints of several degrees of freedom."""
        positions = q.take(self.positions, axis=-1)
        if self._several is not None:
            positions[..., self._several] = np.nan
        return positions

    def moving_force(self, state: Array, acceleration: Array) -> Array:
        """Return the additional force that makes a driven plant move like its model."""
        raise NotImplementedError

    def dynamics(self, q: Array, v: Array, phi: Array) -> tuple[Array, Array, Array]:
        """Return M, C v − τ with all force elements, and C v − τ_g, at q (nq,) and v (nv,)."""
        plant, context = self.plant, self._context
        if not np.array_equal(self._phi, phi):
            set_inertial_parameters(plant, context, phi)
            self._phi = phi.copy()
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        drift = plant.CalcInverseDynamics(context, np.zeros(len(v)), forces)
        rigid_drift = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        return plant.CalcMassMatrix(context), drift, rigid_drift

    def _in_lump(self, name: str) -> tuple[int, Array]:
        """Return the lumped body of a link, and the matrix (10, 10) from the link's parameters."""
        if name not in self._bodies:
            raise ArgumentError(
                f"There is no moving body {name!r}.",
                advice=f"Bodies are: {', '.join(self._bodies)}.",
            )
        index, member = self._bodies[name]
        R_RB, p_RoBo_R = member.X_RB.rotation().matrix(), member.X_RB.translation()
        return index, change_frame(np.eye(PARAMETERS_PER_BODY), R_RB, p_RoBo_R).T


Parameters = tuple[Array, Array]
"""(k,) linear parameters of all effects, and (nb, 10) inertial parameters of the bodies."""


@dataclass(frozen=True, eq=False)
class PlantState:
    """State of a plant and of its motors."""

    q: Array  # (nq,) positions of the links
    v: Array  # (nv,) their velocities
    time: float  # time since the log began, s
    hidden: Array  # (h,) hidden states of effects
    # (m,) positions of the motors of elastic joints less those of their links, rad or m.
    lag: Array = field(default_factory=lambda: np.zeros(0))
    speed: Array = field(default_factory=lambda: np.zeros(0))  # (m,) velocities of these motors


@dataclass(frozen=True, eq=False)
class Terms:
    """Effects of a plant that are evaluated together."""

    plant: PlantMotion
    effects: tuple[Effect, ...]
    places: NDArray[np.intp]  # (k,) indices of their parameters among those of all effects
    hidden: dict[Effect, slice]  # effect -> its hidden states among those of all effects

    @cached_property
    def columns(self) -> EffectColumns:
        """Return the columns of the effects."""
        return EffectColumns(self.plant.joints, self.effects, self.plant.trial)

    @cached_property
    def needs(self) -> frozenset[str]:
        """Return the dependencies of the effects, with time if temperatures are used."""
        return self.columns.depends_on | ({"time"} if self._warmth is not None else set())

    @cached_property
    def _warmth(self) -> Temperatures | None:
        """Return the temperatures of the joints, if known and used by an effect."""
        return self.plant.temperatures if "temperature" in self.columns.depends_on else None

    def effort(self, at: PlantState, load: Array, parameters: Parameters) -> Array:
        """Return the effort (nv,) at zero acceleration, under a load (nv,)."""
        if not self.effects:
            return np.zeros(len(at.v))
        columns = self.columns.at(self._motion(at, load), partial(self._seen, at, parameters))
        return self.plant.own(columns @ parameters[0][self.places])

    def added_mass(self, at: PlantState, load: Array, parameters: Parameters) -> Array:
        """Return the contribution (nv, nv) to the mass matrix, under a load (nv,)."""
        if "vd" not in self.needs:
            return np.zeros((len(at.v), len(at.v)))
        own = self._motion(at, load), parameters[0][self.places]
        return self.plant.own(
            self.columns.added_mass(*own, partial(self._seen, at, parameters)).T
        ).T

    def state_rates(self, at: PlantState, parameters: Parameters) -> Array:
        """Return rates of all hidden states (h,), zero for those of other effects."""
        rates, rest = np.zeros(len(at.hidden)), np.zeros(len(at.v))
        motion = self._seen(at, parameters, self._motion(at, rest))
        for effect, place in self.hidden.items():
            rates[place] = effect.state_rates(motion, at.hidden[None, place])[0]
        return rates

    def _motion(self, at: PlantState, load: Array) -> JointMotion:
        q, sign_v = self.plant.of_joints(at.q), self.plant.direction(at.v)
        return JointMotion(q, at.v, np.zeros(len(at.v)), load, sign_v)

    def _seen(self, at: PlantState, parameters: Parameters, motion: JointMotion) -> RobotMotion:
        """Return one sample of the robot for each acceleration, with its bodies."""
        vd = np.atleast_2d(motion.vd)
        rates = np.broadcast_to(motion.v, vd.shape), vd, np.broadcast_to(motion.load, vd.shape)
        known: dict[str, Any] = {"states": {e: at.hidden[None, s] for e, s in self.hidden.items()}}
        if "time" in self.needs:
            known["time"] = np.full(len(vd), at.time)
        if self._warmth is not None:
            known["temperature"] = self._warmth.at(known["time"], self.plant.joints)
        q = np.broadcast_to(at.q, (len(vd), len(at.q)))
        return self.plant.seen(q, rates, parameters[1], **known)


Model = Any
"""A `RobotModel`, whose module imports this one."""

_RETURN = 50.0  # rate at which joints return to the positions of their actuators, 1/s


class DrivenPlant(PlantMotion):
    """A plant that moves like a model with other coordinates; effects use the model's."""

    driven = True

    def __init__(
        self,
        model: Model,
        plant: MultibodyPlant,
        sign_width: Array,
        log: str | None,
        temperatures: Temperatures | None,
    ) -> None:
        """Read a plant, and raise for elastic effects; see `RobotModel.driving`."""
        for effect in (fitted.effect for fitted in model.effects):
            if effect.role is Role.DEFLECTION:
                raise ModelError(
                    f"{effect.name} of {effect.place} cannot be simulated with following "
                    "joints or a transmission.",
                    advice="Remove it from the model.",
                )
        self.model, self.plant, self.robot = model, plant, RobotInstance(plant)
        self.joints, self.phi, self.temperatures = model.joints, model.total_phi, temperatures
        self._sign_width, self.direction = sign_width, smoothed_sign(sign_width)
        self._log = 0 if log is None else log_number(log)
        self._find_places(model.single_places, model.single_places)
        self._others = np.zeros(0, int)

    @property
    def sizes(self) -> tuple[int, int]:
        """Return the model's numbers of positions and velocities."""
        return self.model.tree.num_positions, len(self.joints)

    def split(self, state: Array) -> tuple[Array, Array]:
        """Return the model's q and v for a state of the plant."""
        nq, coordinates = self.plant.num_positions(), self.model.coordinates
        (q,) = coordinates.nearest(state[None, :nq])
        return q, coordinates.rates_of(q, state[nq:])

    def joined(self, q: Array, v: Array) -> Array:
        """Return the state of the plant for the model's q and v."""
        coordinates = self.model.coordinates
        theta, J = coordinates.joint_positions(q[None])[0], coordinates.jacobian(q[None])[0]
        return np.concatenate([theta, J @ v])

    def moving_force(self, state: Array, acceleration: Array) -> Array:
        """Return the plant's force for the model's motion with given accelerations."""
        q, v = self.split(state)
        coordinates, nq = self.model.coordinates, self.plant.num_positions()
        J, rate = coordinates.jacobian(q[None])[0], coordinates.jacobian_rate(q[None], v[None])[0]
        wanted = J @ acceleration + rate @ v
        if len(v) < len(wanted):
            deviation = state - self.joined(q, v)
            offset = self.plant.MapQDotToVelocity(self._context, deviation[:nq])
            wanted -= 2.0 * _RETURN * deviation[nq:] + _RETURN**2 * offset
        sample = state[None, :nq], state[None, nq:], wanted[None]
        return inverse_dynamics(self.model.joint_tree, *sample, self.phi)[0]

    def dynamics(self, q: Array, v: Array, phi: Array) -> tuple[Array, Array, Array]:
        """Return M, and C v − τ_g twice, at q (nq,) and v (nv,)."""
        count = len(v)
        places, rates = (np.repeat(x[None], count + 1, axis=0) for x in (q, v))
        *units, drift = inverse_dynamics(
            self.model.tree, places, rates, np.eye(count + 1, count), phi
        )
        return (np.array(units) - drift).T, drift, drift

    @cached_property
    def tree(self) -> KinematicTree:
        """Return the model's kinematics."""
        found: KinematicTree = self.model.tree
        return found
