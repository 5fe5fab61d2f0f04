"""Effects in a Drake simulation: their force law on a plant, and accelerations.

Between the motors and the links of a plant there may be springs and dead bands. The rotor of a
geared joint spins about its axis only, as in Spong's model of a flexible joint:

    M(q) q̈ + C q̇ − τ_g = τ,    B θ̈ + f(θ, θ̇) = u − τ,    τ = torque(θ − q, θ̇ − q̇)

M. W. Spong, "Modeling and Control of Elastic Joint Robots", ASME J. Dyn. Sys., Meas., Control
109(4), 1987. A dead band has sides that are stiff springs with strong dampers, which only push.
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
"""Share of the link's inertia that a motor has at least, as without one it could not be moved."""

_SIDE_DAMPING = 0.7  # of the sides of a dead band, at which links stay rather than bounce
_SIDE_GIVE = 0.1  # of half a dead band: by how much its sides yield to the usual load
_LEAST_YIELD = 1e-5  # rad or m, of which little is seen; stiffer sides only cost time
_USUAL_ACCELERATION = 10.0  # rad/s² or m/s², of the link, whose effort beside the weight that is
_RAMP = 0.1  # of that yield, over which the sides' damping comes on
_POSTURES = 32  # in which the weight of a link is looked for


@inlined
def calc_coupling(
    held: tuple[float, float, float, float], lag: float, rate: float
) -> tuple[float, float, float]:
    """Return the torque of a `Coupling`, N·m or N, and by how much lag and rate change it."""
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
    """Spring and damper, or gap, between a motor and its link."""

    stiffness: float  # beyond the dead band, N·m/rad or N/m
    play: float  # half width of the dead band, rad or m; 0 for none
    damping: float  # N·m·s/rad or N·s/m
    ramp: float  # way beyond the dead band over which the damping comes on, rad or m

    def torque(self, lag: float, rate: float) -> float:
        """Return the torque on the link, N·m or N, of the motor's position less its, and a rate."""
        held = self.stiffness, self.play, self.damping, self.ramp
        return float(calc_coupling(held, lag, rate)[0])

    def lag(self, torque: float) -> float:
        """Return the lag (rad or m) under a steady torque (N·m or N)."""
        return float(torque / self.stiffness + self.play * np.sign(torque))


@dataclass(frozen=True, eq=False)
class SoftJoints:
    """The m joints of a plant whose links are not where their motors are."""

    names: tuple[str, ...]
    velocities: NDArray[np.intp]  # (m,) their velocities
    positions: NDArray[np.intp]  # (m,) their positions
    # Of each, what gives way, and where its parameters are among those of all effects.
    effects: tuple[tuple[tuple[DeflectionEffect, slice], ...], ...]
    link_inertia: Array  # (m,) 1 / (M⁻¹)_jj in the default posture, kg·m² or kg
    motor_inertia: Array  # (m,) that of the motors, kg·m² or kg
    usual_load: Array  # (m,) efforts that sides of dead bands are made for, N·m or N
    damping: float  # of springs that do not say it, as a share of the critical one

    def __len__(self) -> int:
        """Return their number."""
        return len(self.names)

    def couplings(self, mu: Array) -> list[Coupling]:
        """Return the couplings of motors and links for the parameters (k,) of all effects.

        Springs have the damping 2 ζ √(k I), with I the inertia of motor and link against each
        other. Sides of a dead band without a spring yield by a tenth of half the band, and at least
        by 10 µrad (µm), to the usual load: the largest weight, and what moves the link at
        10 rad/s² (m/s²).
        """
        return self.held_by([_give_of((e, mu[at]) for e, at in each) for each in self.effects])

    def held_by(self, gives: Sequence[Give]) -> list[Coupling]:
        """Return the couplings of one kind between motors and links, for (m,) joints."""
        against = 1.0 / (1.0 / self.link_inertia + 1.0 / self.motor_inertia)
        found = []
        for i, (give, inertia) in enumerate(zip(gives, against.tolist(), strict=True)):
            if not give:
                raise ArgumentError(
                    f"Joint {self.names[i]!r} was made elastic, and cannot become rigid: its "
                    "link would be one with the motor.",
                    advice="Give it a small compliance, or build the diagram without the effect.",
                )
            yields = max(_SIDE_GIVE * give.play, _LEAST_YIELD)
            if give.compliance > 0.0:
                stiffness = 1.0 / give.compliance
                share = self.damping if give.damping is None else give.damping
            else:
                stiffness, share = self.usual_load[i] / yields, _SIDE_DAMPING
            damping = 2.0 * share * (stiffness * inertia) ** 0.5
            found.append(Coupling(stiffness, give.play, damping, _RAMP * yields))
        return found

    def torques(self, mu: Array, lag: Array, rate: Array) -> Array:
        """Return (m,) torques on the links, N·m or N."""
        each = zip(self.couplings(mu), lag, rate, strict=True)
        return np.array([coupling.torque(s, ds) for coupling, s, ds in each])


def _give_of(effects: Iterable[tuple[DeflectionEffect, Array]]) -> Give:
    return sum((effect.give(values) for effect, values in effects), start=Give())


def giving(
    effects: Sequence[Effect], mu: Array, parts: Sequence[slice]
) -> dict[str, list[tuple[DeflectionEffect, slice]]]:
    """Return joint -> elastic effect, and the indices of its parameters in μ (k,)."""
    found: dict[str, list[tuple[DeflectionEffect, slice]]] = {}
    for effect, place in zip(effects, parts, strict=True):
        if isinstance(effect, DeflectionEffect):
            found.setdefault(effect.joint, []).append((effect, place))
    return {j: each for j, each in found.items() if _give_of((e, mu[at]) for e, at in each)}


def links_of(motion: PlantMotion, phi: Array) -> tuple[Array, Array]:
    """Return the link inertias 1 / (M⁻¹)_jj (nv,) at single joints, and usual loads.

    Those are the largest weights that are found, and what moves links as usual (nv,), N·m or N.
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
_LOAD_CHANGE = 1e-7  # of loads, N·m or N, and of 1, for slopes
_LAG_ITERATIONS = 100
_LAG_TOLERANCE = 1e-12

EffectWithValues = FittedEffect | tuple[Effect, ArrayLike]
"""An effect with its linear parameters μ, as a model has it or as a pair."""


class Response(NamedTuple):
    """Response of effects at a state."""

    effort: Array  # (nv,) effort that they need: taken away from the plant, N·m or N
    motor_acceleration: Array  # (m,) accelerations of the motors of soft joints
    acceleration: Array  # (nv,) those of links, where they are known


class ForceLaw:
    """Forces of effects on a plant, and accelerations of motors with elastic joints.

    Without soft joints all effects see the plant's motion. With them, what acts at motors
    (`Effect.at_motor`) sees the motion of the motors, and what acts at bodies that of the links.

    Attributes:
        phi: (nb, 10) inertial parameters of the plant.
        parts: Where the parameters of each effect are.
        states: Effect -> where its hidden states are among all of them.
        motors: Effects at motors, or all where no joint is soft.
        links: Effects at bodies, where joints are soft.
        soft: Joints whose links are not where their motors are.
        soft_unit: (nv, m) from soft joints to velocities.
        of_motors: (nv, nv + m) from (q̈, θ̈) to accelerations of all motors.
        of_links: (nv, nv + m) to those of all links.
        added_inertia: (m,) what motors of soft joints get to have the least inertia, kg·m² or kg.
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
        soft = giving(self.effects, self.mu, self.parts)
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
        """Raise for effects that are not forces, or do not fit the plant."""
        still = self.plant.trial(*np.zeros((3, 1, len(self.plant.joints))))
        for effect in self.effects:
            if effect.role is Role.DELAY:
                raise ArgumentError(
                    "A delay is not a force.",
                    advice="Use geodrake.control.DelayedEffort, or RobotModel.add_to_builder, "
                    "which does.",
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
        """Return the effects that are forces."""
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
        """Return the elastic joints at some velocities; their motors may need more inertia."""
        plant = self.plant
        for joint, place in zip(soft, plant.positions[at], strict=True):
            if place < 0:
                raise ArgumentError(
                    f"{joint} is elastic, but belongs to a joint of several degrees of freedom."
                )
        links, loads = links_of(plant, self.phi)
        q = plant.plant.GetPositions(plant.plant.CreateDefaultContext())
        still = PlantState(q, np.zeros(len(links)), 0.0, np.zeros(self.state_count))
        rotors = self.motors.added_mass(still, 0.0 * links, (self.mu, self.phi))
        own, least = np.diag(rotors)[at], LEAST_MOTOR * links[at]
        self.added_inertia = np.maximum(least - own, 0.0)
        self.notes = tuple(
            f"The motor of {joint} is assumed to have {mass:.3g} {plant.inertia_units[k]}, "
            f"{100 * LEAST_MOTOR:g} % of its link's, as the model has a smaller rotor."
            for joint, mass, added, k in zip(soft, least, self.added_inertia, at, strict=True)
            if added
        )
        chosen, places = tuple(map(tuple, soft.values())), plant.positions[at]
        inertias = links[at], own + self.added_inertia
        return SoftJoints(tuple(soft), at, places, chosen, *inertias, loads[at], damping)

    @property
    def state_count(self) -> int:
        """Number h of hidden states of all effects."""
        return sum(effect.state_count for effect in self.effects)

    @cached_property
    def timed(self) -> bool:
        """Return whether the time must be known."""
        return "time" in self.motors.needs | self.links.needs

    @cached_property
    def implicit(self) -> bool:
        """Return whether accelerations must be known."""
        turning = "vd" in self.motors.needs | self.links.needs
        return self.plant.driven or bool(self.soft) or self._loaded or turning

    @cached_property
    def _loaded(self) -> bool:
        return "load" in self.motors.needs | self.links.needs

    @cached_property
    def coupled(self) -> bool:
        """Return whether the applied effort must be known."""
        return self.implicit or any(effect.role is Role.SCALE for effect in self.effects)

    def applied(self, u: Array, mu: Array) -> Array:
        """Return efforts (nv,) that act where u (nv,) are commanded or measured, by μ (k,)."""
        acting = u.copy()
        for effect, part in zip(self.effects, self.parts, strict=True):
            if effect.role is Role.SCALE:
                at = self.plant.joints.index(effect.where[0])
                acting[at] /= 1.0 + mu[part.start]
        return acting

    def at_motors(self, state: PlantState) -> PlantState:
        """Return a state as measured, with positions and velocities of motors."""
        if not self.soft:
            return state
        q, v = state.q.copy(), state.v.copy()
        q[self.soft.positions] += state.lag
        v[self.soft.velocities] = state.speed
        return replace(state, q=q, v=v)

    def response(self, state: PlantState, u: Array, parameters: Parameters) -> Response:
        """Return the efforts of effects, and accelerations of elastic joints' motors, at u (nv,).

        With x = (q̈, θ̈ of the soft joints), q̈ = L x of the links, and A x the accelerations of all
        motors, rigid or soft, the equations of motion are linear in x:

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
            # Newton's step, as friction of a joint depends on the load there; shorter ones at last,
            # where whole ones go to and fro between loads of either sign.
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
        """Return positions (m,) of motors less those of links that follow a motion of the motors.

        To all orders in the compliance, but as if the lags had no rates.
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
    """Return linear parameters (k,) that the effect can have."""
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
    """Return an effect with parameters that it can have."""
    pair = (given.effect, given.parameters) if isinstance(given, FittedEffect) else given
    if len(pair) != 2 or not isinstance(pair[0], Effect):
        raise ArgumentError(f"effects must be pairs of an Effect and its μ; got {given!r}.")
    return FittedEffect(pair[0], admissible(*pair))


_PARAMETERS, _PHI = 0, 1


@differenced
class EffectForce(LeafSystem):
    """The force law of effects, for a MultibodyPlant to be simulated with them.

    .. pydrake_system::

        name: EffectForce
        input_ports:
        - state
        - applied_effort
        output_ports:
        - generalized_force
        - motor_state

    An effect adds to the effort that a motion needs, so it takes its effort away from the plant:

        generalized_force = −Σ_e Y_e(q, v, v̇, τ_model) μ_e

    which belongs at `plant.get_applied_generalized_force_input_port()`; see `AddToBuilder`. A wrong
    gain (`EffortScale`) turns the effort u that is commanded, or measured, into u / (1 + ε).

    Effects of v̇ (rotor inertia, payload) are f(q, v) + M_e(q, v) v̇ with the v̇ that the plant has
    with them, (M + M_e) v̇ = u − C v + τ_g + … − f: the plant moves exactly as if its mass matrix
    were M + M_e. Friction that depends on the load τ_model, the effort that the rigid bodies need,
    is found by fixed-point iteration. Both need u, the `applied_effort` (nv) of controllers at the
    joints, zero if the port is not connected; forces that reach the plant otherwise, as by contact,
    are not known here. Where no effect depends on v̇ or load, the port is not read.

    Hidden states (`Hysteresis`) are continuous states, zero at first (`set_hidden_states`). Joints
    that are elastic or have play (`DeflectionEffect`) are two bodies: the plant's joint is the
    link; the motor's position, less that of the link, and its velocity are continuous states, zero
    at first (`set_motors`), with the spring of the effect between them, or its dead band (see
    `geodrake.model.simulation.effect_force`). Efforts, friction and rotor inertia act at the motor;
    gravity, payloads and contacts at the link. `motor_state` (nq + nv), which encoders measure, is
    the plant's state with the motors in the place of the links; it is there with soft joints alone.
    A motor has at least 1 % of its link's inertia; `notes` says where that is more than the
    model's. Explicit integrators need steps below some 1.7 / ω, with ω = √(k (1/B + 1/M)) the
    frequency at which motor and link swing against each other; stiff ones are for "radau3" or
    "implicit_euler" (`ResetIntegratorFromFlags`). Plants with time steps take the torque of the
    spring as it was when the step began, and need steps far below 1 / ω.

    Effects of the time since a log began (`FrictionDrift`, `Contact`) take the Context's, and
    contacts that were found in a log act only where that log is simulated. Friction that varies
    with the temperature takes that of `temperatures`.

    Numeric parameters of the Context are all μ (`set_effect_parameters`), and the inertial
    parameters that the plant is taken to have (`set_inertial_parameters`), which matter to effects
    of v̇, load and bodies. No system sees another one's Context: who changes the plant's inertias
    there must change them here, too, as `RobotInDiagram.set_parameters` does. All else of the plant
    is as by default. In a plant that holds more than the robot (`RobotInstance`), state, efforts
    and forces are those of the whole plant, with zeros where the robot has no part in them.

    The system can be cloned, and converted to AutoDiffXd: derivatives with state, efforts, time and
    parameters are central differences, exact to some 1e-9, and a diagram may be linearized.

    Dry friction makes a simulation stiff. Its sgn v is tanh(v / sign_width), so F acts near rest
    like a damper F / sign_width, and a joint that it holds creeps at less than sign_width. Explicit
    integrators, and plants with time steps, need steps below 2 · sign_width · inertia / F, rotor
    inertia included: 1 ms for 0.1 kg·m² and 2 N·m, but tens of µs for a wrist of bare links without
    rotors. There, use "implicit_euler", or widen sign_width.

    Args:
        plant: A finalized plant, with the joints and bodies that the effects name; or one robot in
            it: then nothing else feels them; or one that moves with a model of other coordinates
            (`RobotModel.driving`): efforts and `motor_state` are the model's then.
        effects: Effects with their linear parameters μ, SI, such as those of a model; or pairs.
        sign_width: Speed below which dry friction fades, rad/s or m/s (`RobotModel.sign_widths`
            has those of a fitted model); one, or (nv,), of a robot in a plant (n,).
        phi: (nb, 10) inertial parameters of the simulated plant, where its Context has others
            than the default ones; such as `model.total_phi`, whose payloads then are no effects.
        log: Name of the log that is simulated; None for none.
        temperatures: Those of the joints, in the time of the Context; without, each joint has that
            to which its friction belongs.
        spring_damping: Damping of elastic joints that have none of their own, as a share of the
            critical one.

    Raises:
        ArgumentError: An effect does not fit the plant, parameters are not on the manifold
            of their effect, as negative friction is not, or a payload is among the effects
            although `phi` is given.
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
        # Both force and rates of the motors need it.
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
        """Return the joints whose motors have their own state."""
        return self.law.soft.names

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the assumptions."""
        return self.law.notes

    def effect_parameters(self, context: Context, effect: Effect) -> Array:
        """Return linear parameters (k,) of an effect in a Context of the system."""
        return self._parameters(context)[self._part(effect)]

    def set_effect_parameters(self, context: Context, values: Mapping[Effect, ArrayLike]) -> None:
        """Changes linear parameters μ (k,), SI, of effects in a Context; others keep theirs."""
        check_context(self, context)
        mu = self._parameters(context)
        for effect, given in values.items():
            mu[self._part(effect)] = admissible(effect, given)
        self.law.soft.couplings(mu)  # do all of them still give way?
        context.get_mutable_numeric_parameter(_PARAMETERS).SetFromVector(mu)

    def set_inertial_parameters(self, context: Context, phi: ArrayLike) -> None:
        """Set the plant's inertial parameters (nb, 10) in a Context.

        They are those that `set_inertial_parameters` writes into the plant's.
        """
        check_context(self, context)
        phi = real_array(phi, "phi", self.law.phi.shape)
        context.get_mutable_numeric_parameter(_PHI).SetFromVector(phi.ravel())

    def set_hidden_states(self, context: Context, states: Mapping[Effect, ArrayLike]) -> None:
        """Set hidden states (s,), such as `Effect.states_along` leaves; others keep theirs."""
        check_context(self, context)
        whole = np.array(context.get_continuous_state_vector().CopyToVector())
        for effect, values in states.items():
            count = effect.state_count if effect in self.law.states else 0
            name = f"the state of {effect.name} of {effect.place}"
            state = real_array(values, name, (count,))
            if not count:
                raise ArgumentError(f"{effect.name} of {effect.place} has no hidden state here.")
            whole[self.law.states[effect]] = state
        context.SetContinuousState(whole)

    def set_motors(self, context: Context, lag: ArrayLike, speed: ArrayLike) -> None:
        """Set where the motors of `soft_joints` are, by lags and speeds (m,).

        A lag is the position of a motor less that of its link, rad or m.
        """
        check_context(self, context)
        size = (len(self.law.soft),)
        both = [real_array(lag, "lag", size), real_array(speed, "speed", size)]
        whole = np.array(context.get_continuous_state_vector().CopyToVector())
        whole[self.law.state_count :] = np.concatenate(both)
        context.SetContinuousState(whole)

    def couplings(self, context: Context) -> list[Coupling]:
        """Return spring and damper of each soft joint, by the parameters of a Context."""
        return self.law.soft.couplings(self._parameters(context))

    def lags(
        self, context: Context, q: ArrayLike, v: ArrayLike, vd: ArrayLike | None = None
    ) -> Array:
        """Return positions (m,) of the motors of soft joints less those of links that follow them.

        Positions (nq,), velocities (nv,) and accelerations are those of the motors; parameters
        those of the Context.
        """
        check_context(self, context)
        size = (self.law.plant.sizes[1],)
        q, v = real_array(q, "q", (self._nq,)), real_array(v, "v", size)
        vd = np.zeros(size) if vd is None else real_array(vd, "vd", size)
        return self.law.lags(q, v, vd, self._values(context))

    def deflect(self, root: Context) -> None:
        """Take the plant's state for that of the motors, and put links where a load has them.

        That is the load of a steady motion; their velocities are those of the motors. Without soft
        joints nothing changes.
        """
        soft, plant = self.law.soft, self.law.plant.plant
        if not soft:
            return
        own, context = (s.GetMyMutableContextFromRoot(root) for s in (self, plant))
        q, v = plant.GetPositions(context), plant.GetVelocities(context)
        lag = self.lags(own, q, v)
        self.set_motors(own, lag, v[soft.velocities])
        q[soft.positions] -= lag
        plant.SetPositions(context, q)

    def state_port(self, builder: DiagramBuilder, joints: Sequence[str]) -> OutputPort:
        """Return an output (2 n) of measured positions and then velocities of all joints in order.

        Each has one degree of freedom.
        """
        robot = self.law.plant.robot
        if not self.law.soft:
            return robot.state_port(builder, joints)
        at_v = self._nq + robot.velocities[robot.order(joints)]
        places = np.concatenate([robot.positions(joints), at_v])
        return selected(builder, self.GetOutputPort("motor_state"), places)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Rates of hidden states, and of the motors of soft joints, per second."""
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

        `RobotModel.add_to_builder` does this with a plant that has the model's inertias.

        `applied_effort` is left to be connected. Generalized forces that act on the plant already
        stay. Where joints are soft, what is measured is the port `motor_state`. The plant was added
        to the builder; options are those of the constructor.
        """
        instance(builder, "builder", DiagramBuilder)
        system = builder.AddSystem(EffectForce(plant, effects, **options))
        whole = system.law.plant.plant
        builder.Connect(whole.get_state_output_port(), system.GetInputPort("state"))
        add_generalized_force(builder, whole, system.GetOutputPort("generalized_force"))
        return system
