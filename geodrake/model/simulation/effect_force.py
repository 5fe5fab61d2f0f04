"""Effects in a Drake simulation: forces on a plant, with elastic joints and backlash.

Motors and links of a plant may be coupled by springs and dead bands. As in Spong's model of a
flexible joint, the rotor spins about its axis only:

    M(q) q̈ + C q̇ − τ_g = τ,    B θ̈ + f(θ, θ̇) = u − τ,    τ = torque(θ − q, θ̇ − q̇)

M. W. Spong, "Modeling and Control of Elastic Joint Robots", ASME J. Dyn. Sys., Meas., Control
109(4), 1987. The sides of a dead band are stiff springs with strong dampers, which only push.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
    ValueProducer,
)

from geodrake.boundary.arguments import instance, instances, number, real_array
from geodrake.compiling import inlined
from geodrake.effects import Effect, FittedEffect, Role
from geodrake.effects.column_checks import rows_of
from geodrake.effects.deflection import SPRING_DAMPING, DeflectionEffect, Give
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.inertia.bodies import check_context
from geodrake.logs.temperatures import Temperatures
from geodrake.model.admissible import check_effect
from geodrake.model.simulation.scalar_system import differenced
from geodrake.model.simulation.terms import Parameters, PlantMotion, PlantState, Terms
from geodrake.robot.robot_instance import RobotInstance, add_generalized_force, selected

LEAST_MOTOR = 0.01
"""Least inertia of a motor, as a share of its link's; without inertia it could not be simulated."""

_SIDE_DAMPING = 0.7  # damping ratio of the sides of a dead band, so that links do not bounce
_SIDE_GIVE = 0.1  # deflection of the sides under the usual load, as a share of half the band
_LEAST_YIELD = 1e-5  # rad or m, least such deflection; stiffer sides only cost time
_USUAL_ACCELERATION = 10.0  # rad/s² or m/s² of the link, for the usual load in addition to weight
_RAMP = 0.1  # share of that deflection over which the sides' damping increases
_POSTURES = 32  # random postures to find the largest weight


@inlined
def calc_coupling(
    held: tuple[float, float, float, float], lag: float, rate: float
) -> tuple[float, float, float]:
    """Return the torque of a `Coupling`, N·m or N, and its derivatives by lag and rate."""
    stiffness, play, damping, ramp = held
    side = 1.0 if lag > 0.0 else -1.0
    over = side * lag - play
    if play > 0.0:
        damping *= min(max(over / ramp, 0.0), 1.0)
    push = stiffness * over + damping * side * rate
    if play > 0.0 and (over <= 0.0 or push <= 0.0):
        return 0.0, 0.0, 0.0
    return side * push, stiffness, damping


@dataclass(frozen=True)
class Coupling:
    """Spring and damper, or dead band, between a motor and its link."""

    stiffness: float  # beyond the dead band, N·m/rad or N/m
    play: float  # half width of the dead band, rad or m; 0 for none
    damping: float  # N·m·s/rad or N·s/m
    ramp: float  # depth beyond the dead band over which the damping increases, rad or m

    def torque(self, lag: float, rate: float) -> float:
        """Return the torque on the link, N·m or N, for a lag of the link and its rate."""
        held = self.stiffness, self.play, self.damping, self.ramp
        return float(calc_coupling(held, lag, rate)[0])

    def lag(self, torque: float) -> float:
        """Return the lag (rad or m) under a steady torque (N·m or N)."""
        return float(torque / self.stiffness + self.play * np.sign(torque))


@dataclass(frozen=True, eq=False)
class SoftJoints:
    """The m elastic joints of a plant, whose links deflect from their motors."""

    names: tuple[str, ...]
    velocities: NDArray[np.intp]  # (m,) indices of their velocities
    positions: NDArray[np.intp]  # (m,) indices of their positions
    # For each joint its deflection effects, and their parameters among those of all effects.
    effects: tuple[tuple[tuple[DeflectionEffect, slice], ...], ...]
    link_inertia: Array  # (m,) 1 / (M⁻¹)_jj in the default posture, kg·m² or kg
    motor_inertia: Array  # (m,) kg·m² or kg
    usual_load: Array  # (m,) efforts that determine the stiffness of dead bands' sides, N·m or N
    damping: float  # default damping ratio of springs

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.names)

    def couplings(self, mu: Array) -> list[Coupling]:
        """Return the couplings of motors and links for the parameters (k,) of all effects.

        Springs have the damping 2 ζ √(k I) with the reduced inertia I of motor and link. Sides of a
        dead band without a spring deflect by a tenth of half the band, but at least 10 µrad (µm),
        under the usual load: the largest weight plus an acceleration of 10 rad/s² (m/s²).
        """
        return self.held_by([_give_of((e, mu[at]) for e, at in each) for each in self.effects])

    def held_by(self, gives: Sequence[Give]) -> list[Coupling]:
        """Return the couplings between motors and links for (m,) deflection laws."""
        against = 1.0 / (1.0 / self.link_inertia + 1.0 / self.motor_inertia)
        couplings = []
        for i, (give, inertia) in enumerate(zip(gives, against.tolist(), strict=True)):
            if not give:
                raise ArgumentError(
                    f"Joint {self.names[i]!r} was made elastic, and cannot become rigid: its "
                    "link would be locked to the motor.",
                    advice="Give it a small compliance, or build the diagram without the effect.",
                )
            yields = max(_SIDE_GIVE * give.play, _LEAST_YIELD)
            if give.compliance > 0.0:
                stiffness = 1.0 / give.compliance
                share = self.damping if give.damping is None else give.damping
            else:
                stiffness, share = self.usual_load[i] / yields, _SIDE_DAMPING
            damping = 2.0 * share * (stiffness * inertia) ** 0.5
            couplings.append(Coupling(stiffness, give.play, damping, _RAMP * yields))
        return couplings

    def torques(self, mu: Array, lag: Array, rate: Array) -> Array:
        """Return (m,) torques on the links, N·m or N."""
        each = zip(self.couplings(mu), lag, rate, strict=True)
        return np.array([coupling.torque(s, ds) for coupling, s, ds in each])


def _give_of(effects: Iterable[tuple[DeflectionEffect, Array]]) -> Give:
    return sum((effect.give(values) for effect, values in effects), start=Give())


def elastic_joints(
    effects: Sequence[Effect], mu: Array, parts: Sequence[slice]
) -> dict[str, list[tuple[DeflectionEffect, slice]]]:
    """Return joint -> its deflection effects and their slices of μ (k,), for elastic joints."""
    found: dict[str, list[tuple[DeflectionEffect, slice]]] = {}
    for effect, place in zip(effects, parts, strict=True):
        if isinstance(effect, DeflectionEffect):
            found.setdefault(effect.joint, []).append((effect, place))
    return {j: each for j, each in found.items() if _give_of((e, mu[at]) for e, at in each)}


def link_loads(motion: PlantMotion, phi: Array) -> tuple[Array, Array]:
    """Return the link inertias 1 / (M⁻¹)_jj (nv,), and the usual loads (nv,), N·m or N.

    A usual load is the largest weight in random postures plus the effort of a usual acceleration.
    """
    plant, rng, still = motion.plant, np.random.default_rng(0), np.zeros(len(motion.joints))
    q = plant.GetPositions(plant.CreateDefaultContext())
    M = motion.dynamics(q, still, phi)[0]
    inertia = np.asarray(1.0 / np.diag(np.linalg.inv(M)))
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    bounded = np.isfinite(lower) & np.isfinite(upper)
    weights = []
    for _ in range(_POSTURES):
        posture = q.copy()
        posture[bounded] = rng.uniform(lower[bounded], upper[bounded])
        weights.append(np.abs(motion.dynamics(posture, still, phi)[2]))
    return inertia, np.max(weights, axis=0) + _USUAL_ACCELERATION * inertia


_LOAD_ITERATIONS, _WHOLE_STEPS, _LOAD_TOLERANCE = 200, 20, 1e-10
_LOAD_CHANGE = 1e-7  # step of loads for finite differences, absolute plus relative, N·m or N
_LAG_ITERATIONS = 100
_LAG_TOLERANCE = 1e-12

EffectWithValues = FittedEffect | tuple[Effect, ArrayLike]
"""An effect with its linear parameters μ, fitted or as a pair."""


class Response(NamedTuple):
    """Response of effects at a state."""

    effort: Array  # (nv,) effort of the effects, subtracted from the plant's, N·m or N
    motor_acceleration: Array  # (m,) accelerations of the motors of elastic joints
    acceleration: Array  # (nv,) accelerations of links; empty if not computed


class ForceLaw:
    """Forces of effects on a plant, and accelerations of motors of elastic joints.

    Without elastic joints all effects depend on the plant's motion. Otherwise effects at motors
    (`Effect.at_motor`) depend on the motion of the motors, and effects at bodies on the links'.

    Attributes:
        phi: (nb, 10) inertial parameters of the plant.
        parts: Slices of the parameters of each effect.
        states: Effect -> slice of its hidden states.
        motors: Effects at motors; all effects if no joint is elastic.
        links: Effects at bodies; none if no joint is elastic.
        soft: Elastic joints.
        soft_unit: (nv, m) matrix from elastic joints to velocities.
        of_motors: (nv, nv + m) matrix from (q̈, θ̈) to accelerations of all motors.
        of_links: (nv, nv + m) matrix from (q̈, θ̈) to accelerations of all links.
        added_inertia: (m,) inertia added to motors below the least inertia, kg·m² or kg.
    """

    def __init__(
        self,
        plant: PlantMotion,
        effects: Iterable[EffectWithValues],
        phi: ArrayLike | None = None,
        *,
        spring_damping: float,
    ) -> None:
        """Check effects, and sort them by their dependencies; see `EffectForce`."""
        self.plant = plant
        self.phi = plant.phi if phi is None else real_array(phi, "phi", plant.phi.shape).copy()
        given = list(map(_fitted, instances(effects, "effects", (tuple, FittedEffect))))
        self.effects = tuple(fitted.effect for fitted in given)
        self.mu = np.concatenate([np.zeros(0), *(fitted.parameters for fitted in given)])
        self.parts = _parts([len(fitted.parameters) for fitted in given])
        self._check(known_phi=phi is not None)
        places = _parts([effect.state_count for effect in self.effects])
        self.states = {e: at for e, at in zip(self.effects, places, strict=True) if e.state_count}
        soft = elastic_joints(self.effects, self.mu, self.parts)
        self.motors = self._terms(lambda effect: not soft or effect.at_motor)
        self.links = self._terms(lambda effect: bool(soft) and not effect.at_motor)
        nv = len(plant.joints)
        at = np.array([plant.joints.index(joint) for joint in soft], int)
        self.soft_unit = np.eye(nv)[:, at]
        rigid = np.diag(1.0 - self.soft_unit.sum(1))
        self.of_motors = np.hstack([rigid, self.soft_unit])
        self.of_links = np.hstack([np.eye(nv), np.zeros((nv, len(at)))])
        damping = number(spring_damping, "spring_damping", lower=0.0)
        none, self.added_inertia, self.notes = np.zeros(0), np.zeros(0), tuple[str, ...]()
        self.soft = SoftJoints((), at, at, (), none, none, none, damping)
        if soft:
            self.soft = self._softened(soft, at, damping)

    def _check(self, *, known_phi: bool) -> None:
        """Raise for effects that are not forces or do not apply to the plant."""
        still = self.plant.trial(*np.zeros((3, 1, len(self.plant.joints))))
        for effect in self.effects:
            if effect.role is Role.DELAY:
                raise ArgumentError(
                    "A delay is not a force.",
                    advice="Use geodrake.control.DelayedEffort, or RobotModel.add_to_builder, "
                    "which includes delays.",
                )
            if effect.role is Role.BODY and known_phi:
                raise ArgumentError(
                    f"The payload of {effect.place} would count twice, in phi and as an effect.",
                    advice="Remove it from the effects if phi is model.total_phi, or use "
                    "RobotModel.add_to_builder.",
                )
            if effect.role in (Role.SCALE, Role.DEFLECTION):
                still.index(effect.where[0])
            else:
                rows_of(effect, still)

    def _terms(self, belongs: Callable[[Effect], bool]) -> Terms:
        """Return the effects that are forces and satisfy a condition."""
        chosen = [
            i
            for i, effect in enumerate(self.effects)
            if effect.role not in (Role.SCALE, Role.DEFLECTION) and belongs(effect)
        ]
        effects = tuple(self.effects[i] for i in chosen)
        places = [np.arange(self.parts[i].start, self.parts[i].stop) for i in chosen]
        hidden = {e: self.states[e] for e in effects if e.state_count}
        return Terms(self.plant, effects, np.concatenate([np.zeros(0, int), *places]), hidden)

    def _softened(
        self,
        soft: Mapping[str, Sequence[tuple[DeflectionEffect, slice]]],
        at: NDArray[np.intp],
        damping: float,
    ) -> SoftJoints:
        """Return the elastic joints, and set the added inertia of their motors and its notes."""
        plant = self.plant
        for joint, place in zip(soft, plant.positions[at], strict=True):
            if place < 0:
                raise ArgumentError(
                    f"{joint} is elastic, but belongs to a joint of several degrees of freedom."
                )
        links, loads = link_loads(plant, self.phi)
        q = plant.plant.GetPositions(plant.plant.CreateDefaultContext())
        still = PlantState(q, np.zeros(len(links)), 0.0, np.zeros(self.state_count))
        rotors = self.motors.added_mass(still, 0.0 * links, (self.mu, self.phi))
        rotor, least = np.diag(rotors)[at], LEAST_MOTOR * links[at]
        self.added_inertia = np.maximum(least - rotor, 0.0)
        self.notes = tuple(
            f"The motor of {joint} is assumed to have {mass:.3g} {plant.inertia_units[k]}, "
            f"{100 * LEAST_MOTOR:g} % of its link's, as the model has a smaller rotor."
            for joint, mass, added, k in zip(soft, least, self.added_inertia, at, strict=True)
            if added
        )
        chosen, places = tuple(map(tuple, soft.values())), plant.positions[at]
        inertias = links[at], rotor + self.added_inertia
        return SoftJoints(tuple(soft), at, places, chosen, *inertias, loads[at], damping)

    @property
    def state_count(self) -> int:
        """Return the number h of hidden states of all effects."""
        return sum(effect.state_count for effect in self.effects)

    @cached_property
    def timed(self) -> bool:
        """Return whether forces depend on time."""
        return "time" in self.motors.needs | self.links.needs

    @cached_property
    def implicit(self) -> bool:
        """Return whether forces require accelerations."""
        turning = "vd" in self.motors.needs | self.links.needs
        return self.plant.driven or bool(self.soft) or self._loaded or turning

    @cached_property
    def _loaded(self) -> bool:
        return "load" in self.motors.needs | self.links.needs

    @cached_property
    def coupled(self) -> bool:
        """Return whether forces depend on the applied effort."""
        return self.implicit or any(effect.role is Role.SCALE for effect in self.effects)

    def applied(self, u: Array, mu: Array) -> Array:
        """Return the acting efforts (nv,) for commanded or measured u (nv,) and parameters μ."""
        acting = u.copy()
        for effect, part in zip(self.effects, self.parts, strict=True):
            if effect.role is Role.SCALE:
                at = self.plant.joints.index(effect.where[0])
                acting[at] /= 1.0 + mu[part.start]
        return acting

    def at_motors(self, state: PlantState) -> PlantState:
        """Return the state with positions and velocities of the motors, as encoders measure."""
        if not self.soft:
            return state
        q, v = state.q.copy(), state.v.copy()
        q[self.soft.positions] += state.lag
        v[self.soft.velocities] = state.speed
        return replace(state, q=q, v=v)

    def response(self, state: PlantState, u: Array, parameters: Parameters) -> Response:
        """Return the efforts of effects, and the accelerations of elastic joints, at u (nv,).

        With x = (q̈, θ̈ of the elastic joints), link accelerations q̈ = L x, and accelerations A x of
        all motors, the equations of motion are linear in x:

            Aᵀ (B A x + f_m − u) + Lᵀ (M L x + h + M_l L x + f_l) = (L − A)ᵀ τ.
        """
        A, L, unit, nv = self.of_motors, self.of_links, self.soft_unit, len(u)
        motor, load = self.at_motors(state), 0.0 * u
        if not self.implicit:
            effort = self.motors.effort(motor, load, parameters)
            return Response(effort, np.zeros(0), np.zeros(0))
        M, drift, rigid_drift = self.plant.dynamics(state.q, state.v, parameters[1])
        B = self.motors.added_mass(motor, load, parameters)
        M_l = self.links.added_mass(state, load, parameters)
        K = A.T @ B @ A + L.T @ (M + M_l) @ L
        K[nv:, nv:] += np.diag(self.added_inertia)
        at_soft = np.zeros(nv)
        if self.soft:
            rate = state.speed - state.v[self.soft.velocities]
            at_soft = unit @ self.soft.torques(parameters[0], state.lag, rate)
        load, inverse, moved = u, np.linalg.inv(K), np.inf
        for round_ in range(_LOAD_ITERATIONS):
            f_m = self.motors.effort(motor, load, parameters)
            f_l = self.links.effort(state, load, parameters)
            x = inverse @ (A.T @ (u - f_m) - L.T @ (drift + f_l) + (L - A).T @ at_soft)
            size = 1.0 + np.abs(load).max()
            if not self._loaded or moved <= _LOAD_TOLERANCE * size:
                rigid = (1.0 - unit.sum(1)) * (f_m + B @ (A @ x))
                effort = f_l + M_l @ x[:nv] + rigid + unit.sum(1) * u - at_soft
                return Response(effort, x[nv:], x[:nv])
            # Newton step for load-dependent friction, damped at last because full steps may
            # oscillate between loads of opposite signs.
            change = _LOAD_CHANGE * (1.0 + np.abs(load))
            by_m = (self.motors.effort(motor, load + change, parameters) - f_m) / change
            by_l = (self.links.effort(state, load + change, parameters) - f_l) / change
            J = np.eye(nv) + M @ inverse[:nv] @ (A.T * by_m + L.T * by_l)
            step = np.linalg.lstsq(J, M @ x[:nv] + rigid_drift - load)[0]
            load = load + (step if round_ < _WHOLE_STEPS else 0.5 * step)
            moved = np.abs(step).max()
        raise ModelError(
            f"Load-dependent friction does not converge; the load is {load} N·m after "
            f"{_LOAD_ITERATIONS} iterations.",
            advice="Use a load factor well below 1; above, a braking gear locks itself.",
        )

    def lags(self, q: Array, v: Array, vd: Array, parameters: Parameters) -> Array:
        """Return the lags (m,) of links behind a motion of the motors.

        The result is exact in the compliance, but neglects rates of the lags.
        """
        lag, couplings = np.zeros(len(self.soft)), self.soft.couplings(parameters[0])
        hidden, zero, links = np.zeros(self.state_count), np.zeros(len(v)), self.links
        for _ in range(_LAG_ITERATIONS):
            place = q.copy()
            place[self.soft.positions] -= lag
            link = PlantState(place, v, 0.0, hidden)
            M, drift, _ = self.plant.dynamics(place, v, parameters[1])
            effort = (M + links.added_mass(link, zero, parameters)) @ vd + drift
            effort += links.effort(link, zero, parameters)
            torques = effort[self.soft.velocities].tolist()
            before = lag
            lag = np.array([c.lag(t) for c, t in zip(couplings, torques, strict=True)])
            if np.abs(lag - before).max(initial=0.0) <= _LAG_TOLERANCE:
                break
        return lag

    def state_rates(self, state: PlantState, parameters: Parameters) -> Array:
        """Return rates (h,) of the hidden states of effects."""
        both = (self.motors, self.at_motors(state)), (self.links, state)
        each = [terms.state_rates(at, parameters) for terms, at in both if terms.hidden]
        return sum(each[1:], start=each[0])


def admissible(effect: Effect, values: ArrayLike) -> Array:
    """Return valid linear parameters (k,) of an effect; raise for others."""
    fitted = FittedEffect(effect, real_array(values, f"parameters of {effect.name}").copy())
    try:
        check_effect(fitted)
    except ModelError as error:
        raise ArgumentError(error.problem) from error
    return fitted.parameters


def _parts(sizes: list[int]) -> tuple[slice, ...]:
    """Return consecutive slices of given sizes."""
    ends = np.cumsum([0, *sizes]).tolist()
    return tuple(map(slice, ends[:-1], ends[1:]))


def _fitted(given: EffectWithValues) -> FittedEffect:
    """Return an effect with valid parameters; raise for others."""
    pair = (given.effect, given.parameters) if isinstance(given, FittedEffect) else given
    if len(pair) != 2 or not isinstance(pair[0], Effect):
        raise ArgumentError(f"effects must be pairs of an Effect and its μ; got {given!r}.")
    return FittedEffect(pair[0], admissible(*pair))


_PARAMETERS, _PHI = 0, 1


@differenced
class EffectForce(LeafSystem):
    """The forces of effects, for simulating a MultibodyPlant with them.

    .. pydrake_system::

        name: EffectForce
        input_ports:
        - state
        - applied_effort
        output_ports:
        - generalized_force
        - motor_state

    An effect adds to the effort of a motion, so its effort is subtracted from the plant's:

        generalized_force = −Σ_e Y_e(q, v, v̇, τ_model) μ_e

    which must be connected to `plant.get_applied_generalized_force_input_port()`; see
    `AddToBuilder`. A wrong gain (`EffortScale`) converts the commanded or measured effort u into
    u / (1 + ε).

    Effects of v̇ (rotor inertia, payload) are f(q, v) + M_e(q, v) v̇, where v̇ solves
    (M + M_e) v̇ = u − C v + τ_g + … − f: the plant moves exactly as if its mass matrix were M + M_e.
    Friction that depends on the load τ_model, the effort of the rigid bodies, is computed
    iteratively. Both depend on u, the `applied_effort` (nv) of controllers at the joints, zero if
    the port is not connected; other forces on the plant, such as contact, are unknown here. The
    port is not evaluated if no effect depends on v̇ or load.

    Hidden states (`Hysteresis`) are continuous states, initially zero (`set_hidden_states`). Joints
    with compliance or play (`DeflectionEffect`) have two bodies. The plant's joint is the link. The
    motor's position relative to the link and its velocity are continuous states, initially zero
    (`set_motors`), coupled by the effect's spring or dead band (see
    `geodrake.model.simulation.effect_force`). Efforts, friction and rotor inertia act at the motor;
    gravity, payloads and contacts at the link. The port `motor_state` (nq + nv) exists only with
    elastic joints. It is the plant's state with motors in place of links, as encoders measure it.
    A motor has at least 1 % of its link's inertia; `notes` lists joints where the model's is less.
    Explicit integrators need steps below about 1.7 / ω, with the frequency ω = √(k (1/B + 1/M)) of
    motor against link; for stiff joints use "radau3" or "implicit_euler"
    (`ResetIntegratorFromFlags`). Plants with time steps apply the spring's torque from the
    beginning of the step, and need steps far below 1 / ω.

    Effects of the time since a log began (`FrictionDrift`, `Contact`) use the Context's time, and
    contacts from a log act only if that log is simulated. Temperature-dependent friction uses
    `temperatures`.

    Numeric parameters of the Context are all μ (`set_effect_parameters`) and the inertial
    parameters of the plant (`set_inertial_parameters`), on which effects of v̇, load and bodies
    depend. A system cannot read another one's Context, so changes of the plant's inertias must be
    repeated here, as `RobotInDiagram.set_parameters` does. All other properties of the plant have
    their defaults. In a plant with more than the robot (`RobotInstance`), state, efforts and forces
    are those of the whole plant, with zeros for everything else.

    The system can be cloned, converted to AutoDiffXd, and linearized. Derivatives with respect to
    state, efforts, time and parameters are central differences, with errors of about 1e-9.

    Dry friction makes a simulation stiff. Its sgn v is tanh(v / sign_width), so friction F acts
    near rest like a damper F / sign_width, and a stuck joint creeps at less than sign_width.
    Explicit integrators and plants with time steps need steps below 2 · sign_width · inertia / F,
    rotor inertia included: 1 ms for 0.1 kg·m² and 2 N·m, but tens of µs for a wrist without rotor
    inertia. In such a case use "implicit_euler", or increase sign_width.

    Args:
        plant: A finalized plant with the joints and bodies of the effects; or one robot in it, so
            that effects act on nothing else; or a plant that moves with a model of other
            coordinates (`RobotModel.driving`), whose efforts and `motor_state` are the model's.
        effects: Effects with their linear parameters μ, SI, such as those of a model; or pairs.
        sign_width: Speed below which dry friction fades, rad/s or m/s (see
            `RobotModel.sign_widths`); one, or (nv,), or (n,) for a robot in a plant.
        phi: (nb, 10) inertial parameters of the simulated plant if they differ from its defaults,
            such as `model.total_phi`; payloads must then not be among the effects.
        log: Name of the simulated log, if any.
        temperatures: Temperatures of the joints over the Context's time; by default the reference
            temperatures of their friction.
        spring_damping: Default damping ratio of elastic joints.

    Raises:
        ArgumentError: An effect does not apply to the plant, parameters are outside the manifold of
            their effect, such as negative friction, or a payload is among the effects although
            `phi` is given.
    """

    def __init__(
        self,
        plant: MultibodyPlant | RobotInstance | PlantMotion,
        effects: Iterable[EffectWithValues],
        *,
        sign_width: ArrayLike = 1e-2,
        phi: ArrayLike | None = None,
        log: str | None = None,
        temperatures: Temperatures | None = None,
        spring_damping: float = SPRING_DAMPING,
    ) -> None:
        """Construct the system."""
        LeafSystem.__init__(self, converter=self._converter)
        number = 0 if log is None else log_number(instance(log, "log", str))
        motion = plant
        if not isinstance(motion, PlantMotion):
            motion = PlantMotion(motion, sign_width, number, temperatures)
        self.law = law = ForceLaw(motion, effects, phi, spring_damping=spring_damping)
        (self._nq, nv), plant = motion.sizes, motion.plant
        in_plant = plant.num_multibody_states(), plant.num_velocities()
        self._state_port = self.DeclareVectorInputPort("state", BasicVector(in_plant[0]))
        self._effort_port = self.DeclareVectorInputPort("applied_effort", BasicVector(nv))
        self.DeclareNumericParameter(BasicVector(law.mu))
        self.DeclareNumericParameter(BasicVector(law.phi.ravel()))
        states = law.state_count + 2 * len(law.soft)
        known = {self._state_port.ticket(), self.all_parameters_ticket()}
        if law.timed:
            known.add(self.time_ticket())
        if states:
            self.DeclareContinuousState(states)
            known.add(self.xc_ticket())
        moved = {*known, self._effort_port.ticket()} if law.coupled else known
        producer = ValueProducer(
            allocate=lambda: AbstractValue.Make(object()), calc=self._calc_response
        )
        # Cached, as both the force and the rates of the motors depend on it.
        self._response = self.DeclareCacheEntry("response", producer, moved)
        self.DeclareVectorOutputPort(
            "generalized_force",
            BasicVector(in_plant[1]),
            self._calc_force,
            {self._response.ticket()},
        )
        if law.soft or motion.driven:
            self.DeclareVectorOutputPort(
                "motor_state", BasicVector(self._nq + nv), self._calc_motor_state, known
            )

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return the effects, in the order of their parameters."""
        return self.law.effects

    @property
    def soft_joints(self) -> tuple[str, ...]:
        """Return the elastic joints, whose motors have their own state."""
        return self.law.soft.names

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on assumptions."""
        return self.law.notes

    def effect_parameters(self, context: Context, effect: Effect) -> Array:
        """Return linear parameters (k,) of an effect in a Context of the system."""
        return self._parameters(context)[self._part(effect)]

    def set_effect_parameters(self, context: Context, values: Mapping[Effect, ArrayLike]) -> None:
        """Set linear parameters μ (k,), SI, of effects in a Context; others keep theirs."""
        check_context(self, context)
        mu = self._parameters(context)
        for effect, given in values.items():
            mu[self._part(effect)] = admissible(effect, given)
        self.law.soft.couplings(mu)  # raises if an elastic joint would become rigid
        context.get_mutable_numeric_parameter(_PARAMETERS).SetFromVector(mu)

    def set_inertial_parameters(self, context: Context, phi: ArrayLike) -> None:
        """Set the plant's inertial parameters (nb, 10) in a Context of this system."""
        check_context(self, context)
        phi = real_array(phi, "phi", self.law.phi.shape)
        context.get_mutable_numeric_parameter(_PHI).SetFromVector(phi.ravel())

    def set_hidden_states(self, context: Context, states: Mapping[Effect, ArrayLike]) -> None:
        """Set hidden states (s,), such as those of `Effect.states_along`; others keep theirs."""
        check_context(self, context)
        state_vector = np.array(context.get_continuous_state_vector().CopyToVector())
        for effect, values in states.items():
            count = effect.state_count if effect in self.law.states else 0
            name = f"the state of {effect.name} of {effect.place}"
            state = real_array(values, name, (count,))
            if not count:
                raise ArgumentError(f"{effect.name} of {effect.place} has no hidden state here.")
            state_vector[self.law.states[effect]] = state
        context.SetContinuousState(state_vector)

    def set_motors(self, context: Context, lag: ArrayLike, speed: ArrayLike) -> None:
        """Set lags and speeds (m,) of the motors of `soft_joints`.

        A lag is the position of a motor less that of its link, rad or m.
        """
        check_context(self, context)
        size = (len(self.law.soft),)
        both = [real_array(lag, "lag", size), real_array(speed, "speed", size)]
        state_vector = np.array(context.get_continuous_state_vector().CopyToVector())
        state_vector[self.law.state_count :] = np.concatenate(both)
        context.SetContinuousState(state_vector)

    def couplings(self, context: Context) -> list[Coupling]:
        """Return spring and damper of each elastic joint in a Context."""
        return self.law.soft.couplings(self._parameters(context))

    def lags(
        self, context: Context, q: ArrayLike, v: ArrayLike, vd: ArrayLike | None = None
    ) -> Array:
        """Return the lags (m,) of links behind a motion of the motors of elastic joints.

        Positions (nq,), velocities (nv,) and accelerations are those of the motors. Parameters are
        those of the Context.
        """
        check_context(self, context)
        size = (self.law.plant.sizes[1],)
        q, v = real_array(q, "q", (self._nq,)), real_array(v, "v", size)
        vd = np.zeros(size) if vd is None else real_array(vd, "vd", size)
        return self.law.lags(q, v, vd, self._values(context))

    def deflect(self, root: Context) -> None:
        """Reinterpret the plant's state as that of the motors, and deflect links accordingly.

        The deflection is that of a steady motion, so links have the velocities of the motors.
        """
        soft, plant = self.law.soft, self.law.plant.plant
        if not soft:
            return
        own_context, context = (s.GetMyMutableContextFromRoot(root) for s in (self, plant))
        q, v = plant.GetPositions(context), plant.GetVelocities(context)
        lag = self.lags(own_context, q, v)
        self.set_motors(own_context, lag, v[soft.velocities])
        q[soft.positions] -= lag
        plant.SetPositions(context, q)

    def state_port(self, builder: DiagramBuilder, joints: Sequence[str]) -> OutputPort:
        """Return an output (2 n) of measured positions, then velocities, of single joints."""
        robot = self.law.plant.robot
        if not self.law.soft:
            return robot.state_port(builder, joints)
        at_v = self._nq + robot.velocities[robot.order(joints)]
        places = np.concatenate([robot.positions(joints), at_v])
        return selected(builder, self.GetOutputPort("motor_state"), places)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Calculate rates of hidden states and of the motors of elastic joints, per second."""
        if not derivatives.size():
            return
        state, law = self._plant_state(context), self.law
        rates = [np.zeros(0)]
        if law.state_count:
            rates.append(law.state_rates(state, self._values(context)))
        if law.soft:
            response: Response = self._response.Eval(context)
            rates += [state.speed - state.v[law.soft.velocities], response.motor_acceleration]
        derivatives.get_mutable_vector().SetFromVector(np.concatenate(rates))

    def _part(self, effect: Effect) -> slice:
        if effect not in self.law.effects:
            raise ArgumentError(
                f"{effect.name} of {effect.place} is not in this system, or has another shape.",
                advice=f"Effects are {', '.join(f'{e.name} of {e.place}' for e in self.effects)}.",
            )
        return self.law.parts[self.law.effects.index(effect)]

    def _parameters(self, context: Context) -> Array:
        return np.array(context.get_numeric_parameter(_PARAMETERS).value())

    def _values(self, context: Context) -> tuple[Array, Array]:
        """Return parameters (k,) of all effects, and (nb, 10) of the bodies."""
        phi = np.array(context.get_numeric_parameter(_PHI).value())
        return self._parameters(context), phi.reshape(-1, PARAMETERS_PER_BODY)

    def _plant_state(self, context: Context) -> PlantState:
        both = self._state_port.Eval(context)
        own = np.asarray(context.get_continuous_state_vector().CopyToVector())
        hidden, m = self.law.state_count, len(self.law.soft)
        lag, speed = own[hidden : hidden + m], own[hidden + m :]
        return PlantState(*self.law.plant.split(both), context.get_time(), own[:hidden], lag, speed)

    def _calc_response(self, context: Context, value: AbstractValue) -> None:
        state, parameters = self._plant_state(context), self._values(context)
        u = np.zeros(len(state.v))
        if self.law.coupled and self._effort_port.HasValue(context):
            u = self._effort_port.Eval(context)
        acting = self.law.applied(u, parameters[0])
        response = self.law.response(state, acting, parameters)
        force = acting - u - response.effort
        if self.law.plant.driven:
            both = self._state_port.Eval(context)
            force = self.law.plant.moving_force(both, response.acceleration)
        value.set_value(response._replace(effort=force))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._response.Eval(context).effort)

    def _calc_motor_state(self, context: Context, output: BasicVector) -> None:
        motor = self.law.at_motors(self._plant_state(context))
        output.SetFromVector(np.concatenate([motor.q, motor.v]))

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        plant: MultibodyPlant | RobotInstance | PlantMotion,
        effects: Iterable[EffectWithValues],
        **options: Any,
    ) -> EffectForce:
        """Add the system and connect it to a plant's state and generalized force ports.

        The plant must be in the builder; options are those of the constructor. Existing generalized
        forces stay connected, and `applied_effort` stays open. With elastic joints, encoders
        measure the port `motor_state`. `RobotModel.add_to_builder` does all this with the model's
        inertias.
        """
        instance(builder, "builder", DiagramBuilder)
        system = builder.AddSystem(EffectForce(plant, effects, **options))
        whole = system.law.plant.plant
        builder.Connect(whole.get_state_output_port(), system.GetInputPort("state"))
        add_generalized_force(builder, whole, system.GetOutputPort("generalized_force"))
        return system
