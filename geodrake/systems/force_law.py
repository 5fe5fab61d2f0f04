"""The force law of effects on a plant: what they depend on, and the acceleration they need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, MultibodyForces

from geodrake.admissible import check_effect
from geodrake.arguments import instances, one_or_each, real_array
from geodrake.bodies import Member, check_plant, lumped_bodies
from geodrake.effects import Effect, EffortDelay, EffortScale, RobotMotion
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.columns import rows_of
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, change_frame, inertial_parameters
from geodrake.kinematics import KinematicTree
from geodrake.model import FittedEffect
from geodrake.plant import joint_names, set_inertial_parameters
from geodrake.regressor import inverse_dynamics_regressor
from geodrake.systems.direct_effects import DirectEffects

_LOAD_ITERATIONS = 200
_LOAD_TOLERANCE = 1e-10

_Terms = list[tuple[Effect, Array]]


@dataclass(frozen=True)
class SortedEffects:
    """Effects with parameters, by what their effort depends on beside q and v."""

    direct: _Terms
    accelerated: _Terms
    loaded: _Terms
    apart: _Terms  # direct ones that depend on bodies, on time, or on states of their own
    at_once: DirectEffects  # the other direct ones again
    gain: Array  # (nv,) measured effort over the one that acts

    @cached_property
    def states(self) -> dict[Effect, slice]:
        """Where the hidden states of effects stand among all of them."""
        found, free = {}, 0
        for effect, _ in self.apart:
            if effect.state_count:
                found[effect] = slice(free, free + effect.state_count)
                free += effect.state_count
        return found

    @cached_property
    def timed(self) -> bool:
        """Whether the time must be known."""
        return any(effect.sees_time for effect, _ in self.apart)

    @cached_property
    def implicit(self) -> bool:
        """Whether v̇ must be known."""
        return bool(self.accelerated or self.loaded)

    @cached_property
    def coupled(self) -> bool:
        """Whether the applied effort must be known."""
        return self.implicit or bool((self.gain != 1.0).any())


class ForceLaw:
    """What effects need of a plant: its motion in their terms, and its acceleration."""

    def __init__(self, plant: MultibodyPlant, sign_width: ArrayLike, log: int = 0) -> None:
        check_plant(plant)
        self._plant = plant
        self._log = log  # as in RobotMotion
        self._context = plant.CreateDefaultContext()  # scratch, overwritten by every evaluation
        self._phi = inertial_parameters(plant)
        self._joints = joint_names(plant)
        self._sign_width = one_or_each(sign_width, "sign_width", len(self._joints))
        self._positions = np.full(len(self._joints), -1)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(JointIndex(index))
            if joint.num_velocities() == 1:
                self._positions[joint.velocity_start()] = joint.position_start()
        self._bodies: dict[str, tuple[int, Member]] = {
            member.name: (i, member)
            for i, body in enumerate(lumped_bodies(plant))
            for member in body.members
        }

    def set_inertial_parameters(self, phi: ArrayLike) -> None:
        """Inertial parameters (nb, 10) instead of the default ones."""
        set_inertial_parameters(self._plant, self._context, phi)
        self._phi = real_array(phi, "phi")

    @cached_property
    def _tree(self) -> KinematicTree:
        return KinematicTree.from_plant(self._plant)

    def sort(self, effects: Sequence[tuple[Effect, ArrayLike]]) -> SortedEffects:
        """Checks effects, and finds out by trial what they depend on."""
        direct, accelerated, loaded_terms, apart = _Terms(), _Terms(), _Terms(), _Terms()
        rng, nv = np.random.default_rng(0), len(self._joints)
        gain = np.ones(nv)
        q = np.tile(self._plant.GetPositions(self._context), (8, 1))
        single = self._positions[self._positions >= 0]
        q[:, single] = rng.normal(size=(8, len(single)))
        v, vd, load = 10.0 * rng.normal(size=(3, 8, nv))
        for effect, values in _pairs(effects):
            if isinstance(effect, EffortDelay):
                raise ArgumentError(
                    "A delay is not a force.", advice="Use geodrake.systems.DelayedEffort."
                )
            if not effect.is_force:
                raise ArgumentError(
                    f"{effect.name} is no force on a robot whose state is that of its links.",
                    advice="Leave it out, or put a motor's body and a spring into the plant.",
                )
            mu = _admissible(effect, values)
            if isinstance(effect, EffortScale):
                gain[self._motion(q, v, vd, load).index(effect.joint)] *= 1.0 + mu[0]
                continue
            still = self._motion(q, v, np.zeros_like(v), np.zeros_like(v))
            moved = self._motion(q, v, vd, still.load)
            base = effect.regressor(still)
            loaded = effect.regressor(replace(still, load=load))
            if not np.array_equal(base, loaded, equal_nan=True):
                loaded_terms.append((effect, mu))
            elif not np.array_equal(base, effect.regressor(moved), equal_nan=True):
                accelerated.append((effect, mu))
            elif effect.sees_bodies or effect.sees_time or effect.state_count:
                apart.append((effect, mu))
            else:
                direct.append((effect, mu))
        at_once = DirectEffects.of(direct, self._joints, self._positions, self._sign_width)
        return SortedEffects(direct, accelerated, loaded_terms, apart, at_once, gain)

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
        zero = np.zeros((1, len(v)))
        still = (q[None], v[None], zero, zero)
        direct = effects.at_once.effort(q, v, lambda body: self._motion(*still).body_columns(body))
        if effects.apart:
            hidden = (
                {} if states is None else {e: states[None, s] for e, s in effects.states.items()}
            )
            seen = replace(self._motion(*still), time=np.array([time]), states=hidden)
            direct = direct + _sum(effects.apart, seen)[0]
        if not effects.implicit:
            return direct

        # Sample 0 is at rest in v̇, sample 1 + k has unit v̇ of velocity k.
        batch = (1 + len(v), 1)
        vd = np.vstack([zero, np.eye(len(v))])
        motion = self._motion(np.tile(q, batch), np.tile(v, batch), vd, np.zeros_like(vd))
        at_unit = _sum(effects.accelerated, motion)
        M, drift, rigid_drift = self._dynamics(q, v)
        if not effects.loaded:
            f, M_e = direct + at_unit[0], (at_unit[1:] - at_unit[0]).T
            return f + M_e @ np.linalg.solve(M + M_e, u - drift - f)

        load = u - direct
        for _ in range(_LOAD_ITERATIONS):
            motion = replace(motion, load=np.tile(load, batch))
            needed = at_unit + _sum(effects.loaded, motion)
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

    def state_rates(
        self, effects: SortedEffects, q: Array, v: Array, states: Array, *, time: float = 0.0
    ) -> Array:
        """Rates of the hidden states of effects at a state of the plant; `time` as in `effort`."""
        zero, rates = np.zeros((1, len(v))), np.zeros_like(states)
        seen = replace(self._motion(q[None], v[None], zero, zero), time=np.array([time]))
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

    def _motion(self, q: Array, v: Array, vd: Array, load: Array) -> RobotMotion:
        """A motion as effects see it, from q (N, nq) and (N, nv) arrays."""
        q_joint = np.where(self._positions >= 0, q[:, self._positions], np.nan)

        @cache
        def regressor() -> Array:
            return inverse_dynamics_regressor(self._tree, q, v, vd)

        def body_columns(name: str) -> Array:
            if name not in self._bodies:
                raise ArgumentError(
                    f"There is no moving body {name!r}.",
                    advice=f"Bodies are: {', '.join(self._bodies)}.",
                )
            i, member = self._bodies[name]
            start = PARAMETERS_PER_BODY * i
            columns = regressor()[..., start : start + PARAMETERS_PER_BODY]
            R_RB, p_RoBo_R = member.X_RB.rotation().matrix(), member.X_RB.translation()
            return columns @ change_frame(np.eye(PARAMETERS_PER_BODY), R_RB, p_RoBo_R).T

        bodies = RobotBodies(self._tree, q, self._phi)
        return RobotMotion(
            self._joints,
            q_joint,
            v,
            vd,
            load,
            self._sign_width,
            body_columns,
            bodies,
            log=self._log,
        )


def _admissible(effect: Effect, values: ArrayLike) -> Array:
    """Linear parameters (k,) that the effect can have."""
    fitted = FittedEffect(effect, real_array(values, f"parameters of {effect.name}").copy())
    try:
        check_effect(fitted)
    except ModelError as error:
        raise ArgumentError(error.problem) from error
    return fitted.parameters


def _pairs(effects: Sequence[tuple[Effect, ArrayLike]]) -> tuple[tuple[Effect, ArrayLike], ...]:
    """Effects with what belongs to them, as pairs."""
    for pair in (given := instances(effects, "effects", tuple)):
        if len(pair) != 2 or not isinstance(pair[0], Effect):
            raise ArgumentError(f"effects must be pairs of an Effect and its μ; got {pair!r}.")
    return given


def _sum(terms: _Terms, motion: RobotMotion) -> Array:
    """Summed effort (N, nv) of effects with parameters."""
    total = np.zeros_like(motion.v)
    for effect, mu in terms:
        for joint, columns in rows_of(effect, motion).items():
            total[:, motion.index(joint)] += columns @ mu
    return total
