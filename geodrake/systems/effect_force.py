"""Effects in a Drake simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, MultibodyForces
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from geodrake.bodies import Member, lumped_bodies
from geodrake.effects import Effect, EffortDelay, RobotMotion
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, change_frame
from geodrake.kinematics import KinematicTree
from geodrake.plant import joint_names, set_inertial_parameters
from geodrake.regressor import inverse_dynamics_regressor
from geodrake.systems.direct_effects import DirectEffects

_LOAD_ITERATIONS = 200
_LOAD_TOLERANCE = 1e-10


class EffectForce(LeafSystem):
    """The force law of effects, for a MultibodyPlant to be simulated with them.

    .. pydrake_system::

        name: EffectForce
        input_ports:
        - state
        - applied_effort
        output_ports:
        - generalized_force

    An effect adds to the effort that a motion needs, so it takes its effort away from the plant:

        generalized_force = −Σ_e Y_e(q, v, v̇, τ_model) μ_e

    which belongs at `plant.get_applied_generalized_force_input_port()`; see `AddToBuilder`.

    Effects of v̇ (rotor inertia, payload) are taken as f(q, v) + M_e(q, v) v̇, and v̇ is the one that
    the plant has with them, (M + M_e) v̇ = u − C v + τ_g + … − f. The plant then moves exactly as if
    its mass matrix were M + M_e. Friction that depends on the load τ_model, the effort that the
    plant's rigid bodies need, is found by fixed-point iteration. Both need u, the `applied_effort`
    (nv): the effort that controllers apply at the joints, zero if the port is not connected. Forces
    that reach the plant otherwise, as by contact, are not known here. Where no effect depends on v̇
    or load, the port is not read and no dynamics are computed.

    The plant's parameters are those of its default context, but for `phi`.

    Dry friction makes a simulation stiff. Its sgn v is tanh(v / sign_width), so F acts near rest
    like a damper F / sign_width, and a joint that it holds creeps at less than sign_width. Explicit
    integrators, and plants with time steps, need steps below 2 · sign_width · inertia / F, rotor
    inertia included: 1 ms for 0.1 kg·m² and 2 N·m, but tens of µs for a wrist of bare links without
    rotors. There, make the plant continuous and its integrator "implicit_euler"
    (`pydrake.systems.analysis.ResetIntegratorFromFlags`), or widen sign_width.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        effects: Sequence[tuple[Effect, ArrayLike]],
        *,
        sign_width: ArrayLike = 1e-2,
        phi: ArrayLike | None = None,
    ) -> None:
        """Constructs the system.

        Args:
            plant: A finalized plant, with the joints and bodies that the effects name.
            effects: Effects and their linear parameters μ, in SI units.
            sign_width: Speed below which dry friction fades, rad/s or m/s; one for all velocities
                or (nv,).
            phi: (nb, 10) inertial parameters of the simulated plant, where its Context has others
                than the default ones; such as `model.total_phi`.

        Raises:
            ArgumentError: An effect does not fit the plant, or parameters do not fit their effect.
        """
        LeafSystem.__init__(self)
        self._law = _ForceLaw(plant, sign_width)
        if phi is not None:
            self._law.set_inertial_parameters(phi)
        self._effects = self._law.sort(effects)
        nq, nv = plant.num_positions(), plant.num_velocities()
        self._nq = nq
        self._state_port = self.DeclareVectorInputPort("state", BasicVector(nq + nv))
        self._effort_port = self.DeclareVectorInputPort("applied_effort", BasicVector(nv))
        prerequisites = {self._state_port.ticket()}
        if self._effects.coupled:
            prerequisites.add(self._effort_port.ticket())
        self.DeclareVectorOutputPort(
            "generalized_force", BasicVector(nv), self._calc_force, prerequisites
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        plant: MultibodyPlant,
        effects: Sequence[tuple[Effect, ArrayLike]],
        *,
        sign_width: ArrayLike = 1e-2,
    ) -> EffectForce:
        """Adds the system and connects it to a plant's state and generalized force ports.

        `applied_effort` is left to be connected. If other generalized forces act on the plant, sum
        them in an Adder and use the constructor instead.

        Returns:
            The system.
        """
        system = builder.AddSystem(EffectForce(plant, effects, sign_width=sign_width))
        builder.Connect(plant.get_state_output_port(), system.GetInputPort("state"))
        builder.Connect(
            system.GetOutputPort("generalized_force"),
            plant.get_applied_generalized_force_input_port(),
        )
        return system

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        state = self._state_port.Eval(context)
        u = np.zeros(output.size())
        if self._effects.coupled and self._effort_port.HasValue(context):
            u = self._effort_port.Eval(context)
        effort = self._law.effort(self._effects, state[: self._nq], state[self._nq :], u)
        output.SetFromVector(-effort)


_Terms = list[tuple[Effect, Array]]


@dataclass(frozen=True)
class _SortedEffects:
    """Effects with parameters, by what their effort depends on beside q and v."""

    direct: _Terms
    accelerated: _Terms
    loaded: _Terms
    at_once: DirectEffects  # the direct ones again

    @property
    def coupled(self) -> bool:
        """Whether v̇ must be known."""
        return bool(self.accelerated or self.loaded)


class _ForceLaw:
    """What effects need of a plant: its motion in their terms, and its acceleration."""

    def __init__(self, plant: MultibodyPlant, sign_width: ArrayLike) -> None:
        self._plant = plant
        self._context = plant.CreateDefaultContext()  # scratch, overwritten by every evaluation
        self._joints = joint_names(plant)
        self._sign_width = np.broadcast_to(np.asarray(sign_width, float), len(self._joints))
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

    @cached_property
    def _tree(self) -> KinematicTree:
        return KinematicTree.from_plant(self._plant)

    def sort(self, effects: Sequence[tuple[Effect, ArrayLike]]) -> _SortedEffects:
        """Checks effects, and finds out by trial what they depend on."""
        direct, accelerated, loaded_terms = _Terms(), _Terms(), _Terms()
        rng, nv = np.random.default_rng(0), len(self._joints)
        q = np.tile(self._plant.GetPositions(self._context), (8, 1))
        single = self._positions[self._positions >= 0]
        q[:, single] = rng.normal(size=(8, len(single)))
        v, vd, load = 10.0 * rng.normal(size=(3, 8, nv))
        for effect, values in effects:
            mu = np.array(values, float)
            if isinstance(effect, EffortDelay):
                raise ArgumentError(
                    "A delay is not a force.", advice="Use geodrake.systems.DelayedEffort."
                )
            if mu.shape != (len(effect.parameters),) or not np.isfinite(mu).all():
                names = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
                raise ArgumentError(f"{effect.name} needs finite {names}; it got {mu}.")
            still = self._motion(q, v, np.zeros_like(v), np.zeros_like(v))
            moved = self._motion(q, v, vd, still.load)
            base = effect.regressor(still)
            loaded = effect.regressor(replace(still, load=load))
            if not np.array_equal(base, loaded, equal_nan=True):
                loaded_terms.append((effect, mu))
            elif not np.array_equal(base, effect.regressor(moved), equal_nan=True):
                accelerated.append((effect, mu))
            else:
                direct.append((effect, mu))
        at_once = DirectEffects.of(direct, self._joints, self._positions, self._sign_width)
        return _SortedEffects(direct, accelerated, loaded_terms, at_once)

    def effort(self, effects: _SortedEffects, q: Array, v: Array, u: Array) -> Array:
        """Effort that the effects need (nv,) at a state and under the efforts u of controllers."""
        zero = np.zeros((1, len(v)))
        still = (q[None], v[None], zero, zero)
        direct = effects.at_once.effort(q, v, lambda body: self._motion(*still).body_columns(body))
        if not effects.coupled:
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

        return RobotMotion(self._joints, q_joint, v, vd, load, self._sign_width, body_columns)


def _sum(terms: _Terms, motion: RobotMotion) -> Array:
    """Summed effort (N, nv) of effects with parameters."""
    total = np.zeros_like(motion.v)
    for effect, mu in terms:
        for joint, columns in effect.rows(motion).items():
            total[:, motion.index(joint)] += columns @ mu
    return total
