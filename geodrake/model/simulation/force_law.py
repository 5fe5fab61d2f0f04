"""The force law of effects on a plant: what they depend on, and the acceleration they need."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instances, number, real_array
from geodrake.effects import Effect, FittedEffect, Role
from geodrake.effects.column_checks import rows_of
from geodrake.effects.deflection import DeflectionEffect
from geodrake.effects.dependencies import dependencies
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array
from geodrake.model.admissible_effect import check_effect
from geodrake.model.simulation.plant_dynamics import PlantDynamics
from geodrake.model.simulation.plant_motion import PlantMotion
from geodrake.model.simulation.scalars import settled, solve
from geodrake.model.simulation.soft_joints import (
    LEAST_MOTOR,
    SoftJoints,
    giving,
    link_inertias,
    usual_loads,
)
from geodrake.model.simulation.terms import Parameters, Sample, Terms

_LOAD_ITERATIONS = 200
_LAG_ITERATIONS = 100
_LAG_TOLERANCE = 1e-12

EffectWithValues = FittedEffect | tuple[Effect, ArrayLike]
"""An effect with its linear parameters μ, as a model has it or as a pair."""


@dataclass(frozen=True, eq=False)
class PlantState:
    """State of a plant and of its motors, in floats or in one of Drake's other scalar types.

    Attributes:
        q: (nq,) positions of the links.
        v: (nv,) their velocities.
        time: Time since the log began, s.
        hidden: (h,) hidden states of effects.
        lag: (m,) positions of the motors of soft joints less those of their links, rad or m.
        speed: (m,) velocities of these motors.
    """

    q: Any
    v: Any
    time: Any
    hidden: Any
    lag: Any
    speed: Any


@dataclass(frozen=True, eq=False)
class Response:
    """What effects do at a state.

    Attributes:
        effort: (nv,) effort that they need: taken away from the plant, N·m or N.
        motor_acceleration: (m,) accelerations of the motors of soft joints.
    """

    effort: Any
    motor_acceleration: Any


@dataclass(frozen=True, eq=False)
class Side:
    """Effects that see the same motion, by what their effort depends on.

    Attributes:
        direct: Those that depend on neither acceleration nor load.
        accelerated: Those that depend on the acceleration.
        loaded: Those that depend on the load.
    """

    direct: Terms
    accelerated: Terms
    loaded: Terms

    @property
    def all(self) -> tuple[Terms, ...]:
        """Return the three of them."""
        return self.direct, self.accelerated, self.loaded

    def inertial(self, at: Sample, accelerations: Array, parameters: Parameters) -> tuple[Any, Any]:
        """Effort (nv,) that depends on v̇ without any, and its change (nv, n) with n of them.

        Args:
            at: The state.
            accelerations: (n, nv) accelerations.
            parameters: Of effects and bodies.
        """
        return _split(self.accelerated, at, accelerations, np.zeros(len(at.v)), parameters)

    def under_load(
        self, at: Sample, accelerations: Array, load: Any, parameters: Parameters
    ) -> tuple[Any, Any]:
        """Return the same of the effort that depends on the load.

        Args:
            at: The state.
            accelerations: (n, nv) accelerations.
            load: (nv,) load.
            parameters: Of effects and bodies.
        """
        return _split(self.loaded, at, accelerations, load, parameters)


def _split(
    terms: Terms, at: Sample, accelerations: Array, load: Any, parameters: Parameters
) -> tuple[Any, Any]:
    vd = np.vstack([np.zeros_like(accelerations[:1]), accelerations])
    efforts = terms.effort(at, vd, load, parameters)
    return efforts[0], (efforts[1:] - efforts[0]).T


class ForceLaw:
    """What effects need of a plant, and how motors move that are not where their links are.

    Without soft joints all effects see the plant's motion. With them, what acts at motors
    (`Effect.at_motor`) sees the motion of the motors, and what acts at bodies that of the links.

    Attributes:
        plant: The plant's motion.
        effects: The effects, in the order of their parameters.
        mu: (k,) their parameters.
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
        dynamics: Those of the plant's bodies.
        notes: What was assumed.
    """

    def __init__(
        self,
        plant: PlantMotion,
        effects: Iterable[EffectWithValues],
        phi: ArrayLike | None = None,
        *,
        spring_damping: float,
    ) -> None:
        """Checks effects, and sorts them by what they depend on.

        Args:
            plant: The plant.
            effects: The effects with their parameters.
            phi: (nb, 10) inertial parameters of the plant instead of its default ones.
            spring_damping: Of soft joints, as a share of the critical one.
        """
        self.plant = plant
        self.phi = plant.phi if phi is None else real_array(phi, "phi", plant.phi.shape).copy()
        pairs = [(effect, admissible(effect, values)) for effect, values in _pairs(effects)]
        self.effects = tuple(effect for effect, _ in pairs)
        self.mu = np.concatenate([np.zeros(0), *(mu for _, mu in pairs)])
        ends = np.cumsum([0, *(len(mu) for _, mu in pairs)]).tolist()
        self.parts = tuple(slice(*ends[i : i + 2]) for i in range(len(pairs)))
        self._check(known_phi=phi is not None)
        self.dynamics = PlantDynamics(plant.plant, self.phi)
        self.states, free = dict[Effect, slice](), 0
        for effect in self.effects:
            if effect.state_count:
                self.states[effect] = slice(free, free + effect.state_count)
                free += effect.state_count
        soft = giving(pairs)
        self.motors = self._side(lambda effect: not soft or effect.at_motor)
        self.links = self._side(lambda effect: bool(soft) and not effect.at_motor)
        nv = len(plant.joints)
        at = np.array([plant.joints.index(joint) for joint in soft], int)
        self.soft_unit = np.eye(nv)[:, at]  # (nv, m)
        rigid = np.diag(1.0 - self.soft_unit.sum(1))
        self.of_motors = np.hstack([rigid, self.soft_unit])  # from (q̈, θ̈) to those of motors
        self.of_links = np.hstack([np.eye(nv), np.zeros((nv, len(at)))])
        self.notes: tuple[str, ...] = ()
        self.added_inertia = np.zeros(len(at))
        self.soft = self._soft_joints(soft, at, number(spring_damping, "spring_damping", lower=0.0))

    def _check(self, *, known_phi: bool) -> None:
        """Refuses effects that are no forces here, and those that do not fit the plant."""
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
                    advice="Leave it out of the effects where phi is model.total_phi, or let "
                    "RobotModel.add_to_builder put the model together.",
                )
            if effect.role in (Role.SCALE, Role.DEFLECTION):
                still.index(effect.where[0])
            else:
                rows_of(effect, still)

    def _side(self, belongs: Callable[[Effect], bool]) -> Side:
        """Those of some effects that are forces, by what they depend on."""
        kinds: tuple[list[int], ...] = ([], [], [])
        for i, effect in enumerate(self.effects):
            if effect.role in (Role.SCALE, Role.DEFLECTION) or not belongs(effect):
                continue
            names = dependencies(effect, self.plant.trial, len(self.plant.joints))
            kinds[2 if "load" in names else 1 if "vd" in names else 0].append(i)
        return Side(*(self._terms(kind) for kind in kinds))

    def _terms(self, chosen: list[int]) -> Terms:
        effects = tuple(self.effects[i] for i in chosen)
        places = [np.arange(self.parts[i].start, self.parts[i].stop) for i in chosen]
        whole = np.concatenate([np.zeros(0, int), *places])
        hidden = {e: self.states[e] for e in effects if e.state_count}
        return Terms(self.plant, effects, whole, hidden)

    def _soft_joints(
        self,
        soft: Mapping[str, list[tuple[DeflectionEffect, slice]]],
        at: NDArray[np.intp],
        damping: float,
    ) -> SoftJoints:
        """Return the soft joints, whose motors may need some inertia."""
        if not soft:
            none = np.zeros(0)
            return SoftJoints((), at, at, (), none, none, none, damping)
        plant = self.plant
        for joint, place in zip(soft, plant.positions[at], strict=True):
            if place < 0:
                raise ArgumentError(f"{joint} is one of several degrees of one joint, and soft.")
        context = self.dynamics.context(self.phi)
        links = link_inertias(plant.plant, context)
        q = plant.plant.GetPositions(context)
        still = Sample(q, np.zeros(len(links)), 0.0, np.zeros(self.state_count))
        _, moved = self.motors.inertial(still, np.eye(len(links)), (self.mu, self.phi))
        own = np.diag(moved)[at]
        least = LEAST_MOTOR * links[at]
        self.added_inertia = np.maximum(least - own, 0.0)
        self.notes = tuple(
            f"The motor of {joint} is taken to have {mass:.3g} {unit}, {100 * LEAST_MOTOR:g} % of "
            "what its link has: the model has less of a rotor there."
            for joint, mass, added, unit in zip(
                soft, least, self.added_inertia, [plant.inertia_units[k] for k in at], strict=True
            )
            if added
        )
        return SoftJoints(
            tuple(soft),
            at,
            plant.positions[at],
            tuple(map(tuple, soft.values())),
            links[at],
            own + self.added_inertia,
            usual_loads(plant.plant, context, links)[at],
            damping,
        )

    @property
    def state_count(self) -> int:
        """Number h of hidden states of all effects."""
        return sum(effect.state_count for effect in self.effects)

    @cached_property
    def timed(self) -> bool:
        """Return whether the time must be known."""
        return any(terms.timed for side in (self.motors, self.links) for terms in side.all)

    @cached_property
    def implicit(self) -> bool:
        """Return whether accelerations must be known."""
        sides = (self.motors, self.links)
        return bool(self.soft) or any(bool(s.accelerated or s.loaded) for s in sides)

    @cached_property
    def coupled(self) -> bool:
        """Return whether the applied effort must be known."""
        return self.implicit or any(effect.role is Role.SCALE for effect in self.effects)

    def applied(self, u: Any, mu: Any) -> Any:
        """Efforts (nv, …) that act where efforts u (nv, …) are commanded or measured.

        Args:
            u: The efforts.
            mu: (k,) parameters of all effects.
        """
        scales = [
            (effect, part)
            for effect, part in zip(self.effects, self.parts, strict=True)
            if effect.role is Role.SCALE
        ]
        if not scales:
            return u
        acting = np.array(u)
        for effect, part in scales:
            at = self.plant.joints.index(effect.where[0])
            acting[at] = acting[at] / (1.0 + mu[part.start])
        return acting

    def motor_motion(self, state: PlantState) -> tuple[Any, Any]:
        """Positions (nq,) and velocities (nv,) that are measured: those of the motors."""
        if not self.soft:
            return state.q, state.v
        q, v = np.array(state.q), np.array(state.v)
        q[self.soft.positions] = q[self.soft.positions] + state.lag
        v[self.soft.velocities] = state.speed
        return q, v

    def response(self, state: PlantState, u: Any, parameters: Parameters) -> Response:
        """Return what effects need, and how motors of soft joints accelerate.

        Args:
            state: Of plant, motors and effects.
            u: (nv,) efforts that act on motors.
            parameters: (k,) of all effects, and (nb, 10) of the bodies.

        Raises:
            ModelError: Friction in proportion to the load holds its own load.
        """
        motor = Sample(*self.motor_motion(state), state.time, state.hidden)
        f_motor = self.motors.direct.direct(motor, parameters)
        if not self.implicit:
            return Response(f_motor, np.zeros(0))
        link = Sample(state.q, state.v, state.time, state.hidden)
        equations = _Equations.at(self, (motor, link), parameters)
        torque = np.zeros(0)
        if self.soft:
            rate = state.speed - np.asarray(state.v)[self.soft.velocities]
            torque = self.soft.torques(parameters[0], state.lag, rate)
        f_link = self.links.direct.direct(link, parameters)
        return equations.response(u, torque, (f_motor, f_link))

    def lags(self, q: Array, v: Array, vd: Array, parameters: Parameters) -> Array:
        """Positions (m,) of motors less those of links that follow a motion of the motors.

        To all orders in the compliance, but as if the lags had no rates.

        Args:
            q: (nq,) positions of the motors.
            v: (nv,) their velocities.
            vd: (nv,) their accelerations.
            parameters: (k,) of all effects, and (nb, 10) of the bodies.
        """
        lag, couplings = np.zeros(len(self.soft)), self.soft.couplings(parameters[0])
        hidden = np.zeros(self.state_count)
        for _ in range(_LAG_ITERATIONS):
            place = q.copy()
            place[self.soft.positions] -= lag
            link = Sample(place, v, 0.0, hidden)
            M, drift, _ = self.dynamics.at(place, v, parameters[1])
            rest, moved = self.links.inertial(link, np.eye(len(v)), parameters)
            effort = M @ vd + drift + rest + moved @ vd + self.links.direct.direct(link, parameters)
            torques = effort[self.soft.velocities].tolist()
            before = lag
            lag = np.array([c.lag(t) for c, t in zip(couplings, torques, strict=True)])
            if np.abs(lag - before).max(initial=0.0) <= _LAG_TOLERANCE:
                break
        return lag

    def record(self) -> None:
        """Makes formulas of the effects that depend on neither acceleration nor load.

        Raises:
            ModelError: One of them is none.
        """
        q, v = np.zeros(self.plant.plant.num_positions()), np.zeros(len(self.plant.joints))
        at = Sample(q, v, 0.0, np.zeros(self.state_count))
        for side in (self.motors, self.links):
            side.direct.record(at, (self.mu, self.phi))

    def state_rates(self, state: PlantState, parameters: Parameters) -> Any:
        """Rates (h,) of the hidden states of effects.

        Args:
            state: Of plant, motors and effects.
            parameters: (k,) of all effects, and (nb, 10) of the bodies.
        """
        motor = Sample(*self.motor_motion(state), state.time, state.hidden)
        link = Sample(state.q, state.v, state.time, state.hidden)
        sides = (self.motors, motor), (self.links, link)
        rates = [
            terms.state_rates(at, parameters)
            for side, at in sides
            for terms in side.all
            if terms.hidden
        ]
        return sum(rates[1:], start=rates[0])


@dataclass(frozen=True, eq=False)
class _Equations:
    """Equations of motion of links and motors, linear in x = (q̈, θ̈ of the soft joints).

    With q̈ = L x of the links, and A x the accelerations of all motors, rigid or soft,

        Aᵀ (B A x + f_m − u) + Lᵀ (M L x + h + M_l L x + f_l) = (L − A)ᵀ τ.

    Attributes:
        law: The force law.
        seen: What effects at motors and at bodies see.
        parameters: Of effects and bodies.
        motors: Effort (nv,) at motors that depends on accelerations, without any, and B A.
        links: The same at bodies, and M_l L.
        dynamics: M, C v − τ of all force elements, and C v − τ_g alone.
    """

    law: ForceLaw
    seen: tuple[Sample, Sample]
    parameters: Parameters
    motors: tuple[Any, Any]
    links: tuple[Any, Any]
    dynamics: tuple[Any, Any, Any]

    @classmethod
    def at(cls, law: ForceLaw, seen: tuple[Sample, Sample], parameters: Parameters) -> _Equations:
        """At what effects see."""
        motor, link = seen
        return cls(
            law,
            seen,
            parameters,
            law.motors.inertial(motor, law.of_motors.T, parameters),
            law.links.inertial(link, law.of_links.T, parameters),
            law.dynamics.at(link.q, link.v, parameters[1]),
        )

    def response(self, u: Any, torque: Any, direct: tuple[Any, Any]) -> Response:
        """Return what effects need.

        Args:
            u: (nv,) efforts that act on motors.
            torque: (m,) torques on the links of soft joints.
            direct: Effort (nv,) at motors and at bodies without accelerations and loads.
        """
        law, (M, _, rigid_drift) = self.law, self.dynamics
        nv, unit = len(u), law.soft_unit
        f_motor, f_link = direct[0] + self.motors[0], direct[1] + self.links[0]
        at_soft = unit @ torque

        def result(x: Any, f_m: Any, BA: Any, f_l: Any, M_l: Any) -> Response:
            rigid = (1.0 - unit.sum(1)) * (f_m + BA @ x)
            effort = f_l + M_l @ x + rigid + unit.sum(1) * u - at_soft
            return Response(effort, x[nv:])

        if not (law.motors.loaded or law.links.loaded):
            forces = f_motor, self.motors[1], f_link, self.links[1]
            return result(self._solved(u, at_soft, forces), *forces)
        load = u - direct[0]
        for _ in range(_LOAD_ITERATIONS):
            forces = self._under(load, f_motor, f_link)
            x = self._solved(u, at_soft, forces)
            before, load = load, M @ x[:nv] + rigid_drift
            if settled(np.asarray(before), np.asarray(load)):
                return result(x, *forces)
        raise ModelError(
            f"Load-dependent friction does not settle; the load is {load} N·m after "
            f"{_LOAD_ITERATIONS} iterations.",
            advice="Give it a load factor well below 1; above, a gear locks itself.",
        )

    def _under(self, load: Any, f_motor: Any, f_link: Any) -> tuple[Any, Any, Any, Any]:
        """Efforts at motors and bodies, and their changes with accelerations, under a load."""
        law, (motor, link), p = self.law, self.seen, self.parameters
        at_motors = law.motors.under_load(motor, law.of_motors.T, load, p)
        at_links = law.links.under_load(link, law.of_links.T, load, p)
        return (
            f_motor + at_motors[0],
            self.motors[1] + at_motors[1],
            f_link + at_links[0],
            self.links[1] + at_links[1],
        )

    def _solved(self, u: Any, at_soft: Any, forces: tuple[Any, Any, Any, Any]) -> Any:
        """Return the accelerations x, for efforts at motors and bodies and their changes with x."""
        f_m, BA, f_l, M_l = forces
        law, (M, drift, _) = self.law, self.dynamics
        A, L = law.of_motors, law.of_links
        K = A.T @ BA + L.T @ (M @ L + M_l)
        K[len(u) :, len(u) :] += np.diag(law.added_inertia)
        return solve(K, A.T @ (u - f_m) - L.T @ (drift + f_l) + (L - A).T @ at_soft)


def admissible(effect: Effect, values: ArrayLike) -> Array:
    """Linear parameters (k,) that the effect can have.

    Args:
        effect: The effect.
        values: Its parameters.

    Raises:
        ArgumentError: They are beyond its manifold, or not as many.
    """
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
