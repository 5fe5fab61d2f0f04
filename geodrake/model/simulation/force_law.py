"""The force law of effects on a plant: what they depend on, and the acceleration they need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, MultibodyForces

from geodrake.boundary.arguments import instances, one_or_each, real_array
from geodrake.effects import Effect, FittedEffect, JointMotion, RobotMotion, Role
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.column_checks import rows_of
from geodrake.effects.dependencies import dependencies
from geodrake.effects.effect_columns import EffectColumns
from geodrake.effects.robot_motion import smoothed_sign
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, change_frame, inertial_parameters
from geodrake.inertia.bodies import Member, lumped_bodies
from geodrake.model.admissible_effect import check_effect
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import set_inertial_parameters
from geodrake.robot.regressor import inverse_dynamics_regressor
from geodrake.robot.robot_instance import RobotInstance

_LOAD_ITERATIONS = 200
_LOAD_TOLERANCE = 1e-10

_Pairs = list[tuple[Effect, Array]]

EffectWithValues = FittedEffect | tuple[Effect, ArrayLike]
"""An effect with its linear parameters μ, as a model has it or as a pair."""


@dataclass(frozen=True, eq=False)
class Terms:
    """Effects and the values of their parameters, evaluated together.

    Attributes:
        columns: Columns of the effects.
        mu: (k,) their parameters.
    """

    columns: EffectColumns
    mu: Array

    def effort(self, motion: RobotMotion) -> Array:
        """Effort (N, nv) that they need."""
        return self.columns.effort(motion, self.mu)


@dataclass(frozen=True, eq=False)
class SortedEffects:
    """Effects with parameters, by what their effort depends on.

    Attributes:
        direct: Those that depend on neither acceleration nor load.
        accelerated: Those that depend on the acceleration.
        loaded: Those that depend on the load.
        gain: (nv,) measured effort over the one that acts.
    """

    direct: Terms
    accelerated: Terms
    loaded: Terms
    gain: Array

    @cached_property
    def states(self) -> dict[Effect, slice]:
        """Where the hidden states of effects stand among all of them."""
        found, free = {}, 0
        for effect in self.direct.columns.effects:
            if effect.state_count:
                found[effect] = slice(free, free + effect.state_count)
                free += effect.state_count
        return found

    @cached_property
    def timed(self) -> bool:
        """Whether the time must be known."""
        every = (self.direct, self.accelerated, self.loaded)
        return any("time" in terms.columns.depends_on for terms in every)

    @cached_property
    def implicit(self) -> bool:
        """Whether v̇ must be known."""
        return bool(self.accelerated.columns.effects or self.loaded.columns.effects)

    @cached_property
    def coupled(self) -> bool:
        """Whether the applied effort must be known."""
        return self.implicit or bool((self.gain != 1.0).any())


class ForceLaw:
    """What effects need of a plant: its motion in their terms, and its acceleration."""

    def __init__(
        self, plant: MultibodyPlant | RobotInstance, sign_width: ArrayLike, log: int = 0
    ) -> None:
        robot = plant if isinstance(plant, RobotInstance) else RobotInstance(plant)
        self._robot, self._plant = robot, (plant := robot.plant)
        self._log = log  # as in RobotMotion
        self._context = plant.CreateDefaultContext()  # scratch, overwritten by every evaluation
        self._phi = inertial_parameters(plant)
        self._joints = robot.velocity_names
        width = one_or_each(sign_width, "sign_width", len(robot.joints))
        self._sign_width = np.ones(len(self._joints))  # that of other robots does not matter
        self._sign_width[robot.velocities] = width
        self._others = np.delete(np.arange(len(self._joints)), robot.velocities)
        self._direction = smoothed_sign(self._sign_width)
        self._positions = np.full(len(self._joints), -1)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(JointIndex(index))
            if joint.num_velocities() == 1:
                self._positions[joint.velocity_start()] = joint.position_start()
        several = np.flatnonzero(self._positions < 0)
        self._several = several if len(several) else None
        self._bodies: dict[str, tuple[int, Member]] = {
            robot.body_names[member.name]: (i, member)
            for i, body in enumerate(lumped_bodies(plant))
            for member in body.members
        }

    @cached_property
    def _tree(self) -> KinematicTree:
        tree = KinematicTree.from_plant(self._plant)
        return replace(tree, bodies=tuple(self._robot.body_names[name] for name in tree.bodies))

    def sort(
        self, effects: Iterable[EffectWithValues], phi: ArrayLike | None = None
    ) -> SortedEffects:
        """Checks effects, and sorts them by what they depend on.

        Args:
            effects: The effects with their parameters.
            phi: (nb, 10) inertial parameters of the plant instead of its default ones.
        """
        if phi is not None:
            set_inertial_parameters(self._plant, self._context, phi)
            self._phi = real_array(phi, "phi")
        direct, accelerated, loaded = _Pairs(), _Pairs(), _Pairs()
        gain, still = np.ones(len(self._joints)), self._trial(*np.zeros((3, 1, len(self._joints))))
        for effect, values in _pairs(effects):
            if effect.role is Role.DELAY:
                raise ArgumentError(
                    "A delay is not a force.",
                    advice="Use geodrake.control.DelayedEffort, or RobotModel.add_to_builder, "
                    "which does.",
                )
            if effect.role is Role.DEFLECTION:
                raise ArgumentError(
                    f"{effect.name} is no force on a robot whose state is that of its links.",
                    advice="Leave it out, or put a motor's body and a spring into the plant.",
                )
            if effect.role is Role.BODY and phi is not None:
                raise ArgumentError(
                    f"The payload of {effect.place} would count twice, in phi and as an effect.",
                    advice="Leave it out of the effects where phi is model.total_phi, or let "
                    "RobotModel.add_to_builder put the model together.",
                )
            mu = _admissible(effect, values)
            if effect.role is Role.SCALE:
                gain[still.index(effect.where[0])] *= 1.0 + mu[0]
                continue
            rows_of(effect, still)  # does it fit the plant?
            names = dependencies(effect, self._trial, len(self._joints))
            kind = loaded if "load" in names else accelerated if "vd" in names else direct
            kind.append((effect, mu))
        terms = [self._terms(kind) for kind in (direct, accelerated, loaded)]
        return SortedEffects(terms[0], terms[1], terms[2], gain)

    def _terms(self, pairs: _Pairs) -> Terms:
        effects = tuple(effect for effect, _ in pairs)
        mu = np.concatenate([np.zeros(0), *(mu for _, mu in pairs)])
        return Terms(EffectColumns(self._joints, effects, self._trial), mu)

    def _trial(self, v: Array, vd: Array, load: Array) -> RobotMotion:
        """The plant in some configurations, for trials of users' effects."""
        q = np.tile(self._plant.GetPositions(self._context), (len(v), 1))
        single = self._positions[self._positions >= 0]
        q[:, single] = np.random.default_rng(0).normal(size=(len(v), len(single)))
        return self._motion(q, v, vd, load)

    def effort(
        self,
        effects: SortedEffects,
        q: Array,
        v: Array,
        u: Array,
        *,
        time: float = 0.0,
        states: Array | None = None,
    ) -> Array:
        """Effort that the effects need (nv,).

        Args:
            effects: The effects.
            q: (nq,) positions.
            v: (nv,) velocities.
            u: (nv,) efforts of controllers that act on the plant.
            time: Time since the log began, s.
            states: Hidden states of the effects, if they have any.
        """
        direct = self._direct_effort(effects, q, v, time, states)
        if not effects.implicit:
            return direct

        # Sample 0 is at rest in v̇, sample 1 + k has unit v̇ of velocity k.
        batch = (1 + len(v), 1)
        vd = np.vstack([np.zeros_like(v), np.eye(len(v))])
        instants = np.full(len(vd), time) if effects.timed else None
        arrays = np.tile(q, batch), np.tile(v, batch), vd, np.zeros_like(vd)
        motion = self._motion(*arrays, time=instants)
        at_unit = self._own(effects.accelerated.effort(motion))
        M, drift, rigid_drift = self._dynamics(q, v)
        if not effects.loaded.columns.effects:
            f, M_e = direct + at_unit[0], (at_unit[1:] - at_unit[0]).T
            return f + M_e @ np.linalg.solve(M + M_e, u - drift - f)

        load = u - direct
        for _ in range(_LOAD_ITERATIONS):
            motion = replace(motion, load=np.tile(load, batch))
            needed = at_unit + self._own(effects.loaded.effort(motion))
            f, M_e = direct + needed[0], (needed[1:] - needed[0]).T
            acceleration = np.linalg.solve(M + M_e, u - drift - f)
            before, load = load, M @ acceleration + rigid_drift
            if np.abs(load - before).max() <= _LOAD_TOLERANCE * (1.0 + np.abs(load).max()):
                return f + M_e @ acceleration
        raise ModelError(
            f"Load-dependent friction does not settle; the load is {load} N·m after "
            f"{_LOAD_ITERATIONS} iterations.",
            advice="Give it a load factor well below 1; above, a gear locks itself.",
        )

    def _direct_effort(
        self, effects: SortedEffects, q: Array, v: Array, time: float, states: Array | None
    ) -> Array:
        """Effort (nv,) of the effects that depend on neither acceleration nor load."""
        rest = np.zeros(len(v))
        if not effects.direct.columns.effects:
            return rest

        def seen(joints: JointMotion) -> RobotMotion:
            hidden = (
                {} if states is None else {e: states[None, s] for e, s in effects.states.items()}
            )
            instant = np.array([time]) if effects.timed else None
            arrays = q[None], joints.v[None], joints.vd[None], joints.load[None]
            return self._motion(*arrays, time=instant, states=hidden)

        joints = JointMotion(self._of_joints(q), v, rest, rest, self._direction(v))
        return self._own(effects.direct.columns.at(joints, seen) @ effects.direct.mu)

    def _own(self, effort: Array) -> Array:
        """Efforts (..., nv) without those that would act on other robots and on objects."""
        effort[..., self._others] = 0.0
        return effort

    def state_rates(
        self, effects: SortedEffects, q: Array, v: Array, states: Array, *, time: float = 0.0
    ) -> Array:
        """Rates of the hidden states of effects at a state of the plant; `time` as in `effort`.

        Args:
            effects: The effects, sorted.
            q: (nq,) positions of the plant.
            v: (nv,) velocities of the plant.
            states: Hidden states of all effects, in the order of `effects.states`.
            time: Time since the log began, s.
        """
        zero, rates = np.zeros((1, len(v))), np.zeros_like(states)
        seen = self._motion(q[None], v[None], zero, zero, time=np.array([time]))
        for effect, place in effects.states.items():
            rates[place] = effect.state_rates(seen, states[None, place])[0]
        return rates

    def _dynamics(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """M, then C v − τ of all force elements, then C v − τ_g alone, of the plant."""
        plant, context = self._plant, self._context
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        drift = plant.CalcInverseDynamics(context, np.zeros_like(v), forces)
        rigid_drift = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        return plant.CalcMassMatrix(context), drift, rigid_drift

    def _motion(self, q: Array, v: Array, vd: Array, load: Array, **known: Any) -> RobotMotion:
        """A motion as effects see it, from q (N, nq) and (N, nv) arrays, and what else is known."""
        return RobotMotion(
            self._joints,
            self._of_joints(q),
            v,
            vd,
            load,
            self._sign_width,
            _BodyColumns(self._tree, self._bodies, q, v, vd),
            RobotBodies(self._tree, q, self._phi),
            log=self._log,
            **known,
        )

    def _of_joints(self, q: Array) -> Array:
        """Position belonging to each velocity, NaN for joints of several degrees."""
        found = q.take(self._positions, axis=-1)
        if self._several is not None:
            found[..., self._several] = np.nan
        return found


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
        if name not in self.bodies:
            raise ArgumentError(
                f"There is no moving body {name!r}.",
                advice=f"Bodies are: {', '.join(self.bodies)}.",
            )
        i, member = self.bodies[name]
        start = PARAMETERS_PER_BODY * i
        columns = self._regressor[..., start : start + PARAMETERS_PER_BODY]
        R_RB, p_RoBo_R = member.X_RB.rotation().matrix(), member.X_RB.translation()
        return columns @ change_frame(np.eye(PARAMETERS_PER_BODY), R_RB, p_RoBo_R).T


def _admissible(effect: Effect, values: ArrayLike) -> Array:
    """Linear parameters (k,) that the effect can have."""
    fitted = FittedEffect(effect, real_array(values, f"parameters of {effect.name}").copy())
    try:
        check_effect(fitted)
    except ModelError as error:
        raise ArgumentError(error.problem) from error
    return fitted.parameters


def _pairs(effects: Iterable[EffectWithValues]) -> list[tuple[Effect, ArrayLike]]:
    """Effects with their parameters, as pairs."""
    pairs = []
    for given in instances(effects, "effects", (tuple, FittedEffect)):
        pair = (given.effect, given.parameters) if isinstance(given, FittedEffect) else given
        if len(pair) != 2 or not isinstance(pair[0], Effect):
            raise ArgumentError(f"effects must be pairs of an Effect and its μ; got {given!r}.")
        pairs.append(pair)
    return pairs
