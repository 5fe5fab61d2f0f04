"""The simulations behind rollouts: Drake diagrams of a model under efforts or commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator, SimulatorStatus
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus

from geodrake.control.rollout.passages import FASTEST, Conditions, Passage
from geodrake.effects import Effect, FittedEffect, RobotMotion
from geodrake.effects.deflection import DeflectionEffect
from geodrake.errors import LogError
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.model.simulation.effect_force import EffectForce, ForceLaw
from geodrake.model.simulation.robot_in_diagram import FORCES
from geodrake.model.simulation.terms import PlantState
from geodrake.robot.plant import load_plant, set_inertial_parameters
from geodrake.robot.robot_instance import add_generalized_force, selected

AT_START = 9
"""Samples of the rate at which soft joints bend when a passage begins."""

LARGEST_STEP = 5e-3  # of the integrator, s
_ACCURACY = 1e-3
_STEPS, _TIMES = 60_000, 20  # that a rollout may take in all, and times those without a care
_STIFF = 4e3  # rate of decay from which on an implicit integrator is the faster one, 1/s
_BEFORE = 0.5  # s before a passage, from which on links are followed through dead bands
_CHANGE = 1e-6  # of velocities, for rates of decay


def simulations(conditions: Conditions, passages: Sequence[Passage]) -> Callable[[str], Simulation]:
    """Return what gives the simulation of a model in a log, made when first asked for.

    Raises:
        LogError: A joint has no efforts.

    Args:
        passages: What is to be simulated, which may take so many steps all together. A robot that
            flies apart, as under efforts in other units, takes ever smaller ones. Models that
            lacked all friction took up to 18 times the steps of calm ones on public logs (UR10e),
            and 256 times in the demo, some 74,000 for its twelve windows.
    """
    for trajectory in conditions.case.trajectories:
        if trajectory.unmeasured:
            raise LogError(
                f"Log {trajectory.name!r} has no efforts of {', '.join(trajectory.unmeasured)}, "
                "without which nothing moves the robot.",
                advice="Log efforts of all joints; or use geodrake compare.",
            )
    calm = sum(max(len(p.time), (p.time[-1] - p.time[0]) / LARGEST_STEP) for p in passages)
    steps = iter(range(_STEPS + round(_TIMES * calm)))
    return cache(lambda log: Simulation(conditions, log, steps))


class Simulation:
    """The diagram: efforts, effects, and the plant, in the time of a log.

    Args:
        steps: One item for each step of the integrator that is left.
    """

    def __init__(self, conditions: Conditions, log: str, steps: Iterator[int]) -> None:
        self.robot = robot = conditions.robots[log]
        self.sign_width, self._fastest = conditions.sign_width, conditions.fastest
        self._steps, model = steps, robot.model
        builder, phi, nv = DiagramBuilder(), model.total_phi, len(model.joints)
        loaded = load_plant(model.path, floating=model.floating, held=model.held, given=model.given)
        self._plant = plant = builder.AddSystem(loaded.plant)
        self._driving = model.driving(plant, self.sign_width, log, robot.temperatures)
        effects = [fitted for fitted in model.effects if fitted.effect.role in FORCES]
        self._force = force = EffectForce.AddToBuilder(
            builder,
            self._driving or plant,
            effects,
            sign_width=self.sign_width,
            phi=phi,
            log=log,
            temperatures=robot.temperatures,
        )
        state = plant.get_state_output_port()
        if force.soft_joints or self._driving is not None:
            state = force.GetOutputPort("motor_state")
        places = model.positions(np.arange(nv, dtype=float)[None])[0]
        own = np.concatenate([np.argsort(places), len(places) + np.arange(nv)])
        self._measured = selected(builder, state, own)
        effort = robot.add(builder, self._measured)
        builder.Connect(effort, force.GetInputPort("applied_effort"))
        if self._driving is None:
            add_generalized_force(builder, plant, effort)
        self._diagram = builder.Build()

    @property
    def model(self) -> RobotModel:
        """The model, with what it carries in the log."""
        return self.robot.model

    @property
    def law(self) -> ForceLaw:
        """Forces of effects, and those that hold motors and links together."""
        return self._force.law

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions of the simulation."""
        return self._force.notes

    def positions(self, passage: Passage) -> Array:
        """Return positions (K, nv) from a passage's first state on, under what acts in it.

        From where a joint is a million times as fast as it was measured, or no steps of the
        integrator are left, they are NaN.
        """
        time = passage.time
        self.robot.begin(passage)
        simulator = Simulator(self._diagram)
        root = simulator.get_mutable_context()
        root.SetTime(time[0])
        self.robot.remember(passage, root)
        decay = self._start(passage, root)
        scheme = "radau3" if decay > _STIFF else "runge_kutta3"
        ResetIntegratorFromFlags(simulator, scheme, LARGEST_STEP)
        simulator.get_mutable_integrator().set_target_accuracy(_ACCURACY)
        simulator.Initialize()
        simulator.set_monitor(self._limit)
        nv, system = len(self.model.joints), self._measured.get_system()
        found = np.full((len(time), nv), np.nan)
        for k, instant in enumerate(time):
            try:
                status = simulator.AdvanceTo(instant)
            except RuntimeError:  # the integrator gives up: the robot flies apart
                break
            if status.reason() != SimulatorStatus.ReturnReason.kReachedBoundaryTime:
                break
            found[k] = self._measured.Eval(system.GetMyContextFromRoot(root))[:nv]
        return found

    def _start(self, passage: Passage, root: Context) -> float:
        """Put the robot where a passage begins, and return how fast velocities decay there, 1/s."""
        segment, plant = passage.segment, self._plant
        context = plant.GetMyMutableContextFromRoot(root)
        set_inertial_parameters(plant, context, self.model.total_phi)
        q = np.array(self.model.positions(segment.position[:1])[0])
        v = np.array(segment.velocity[0])
        self._remember(passage, root)
        if self._driving is not None:
            plant.SetPositionsAndVelocities(context, self._driving.joined(q, v))
            still = PlantState(q, v, root.get_time(), np.zeros(self.law.state_count))
            own = (0.0 * v, (self.law.mu, self.law.phi))
            rates = [
                self.law.response(replace(still, v=change), *own).acceleration
                for change in _CHANGE * np.vstack([0.0 * v, np.eye(len(v))])
            ]
            return _fastest_decay(rates)
        if self._force.soft_joints:
            self._deflect(passage, root, (q, v))
        plant.SetPositions(context, q)
        decay = self._decay(root)
        plant.SetVelocities(context, v)
        return decay

    def _deflect(self, passage: Passage, root: Context, start: tuple[Array, Array]) -> None:
        """Put links where their load has them, and have their motors move as was measured.

        Args:
            root: Context of the diagram; that of the effects is changed.
            start: (nq,) positions and (nv,) velocities of the motors, which become those of links.
        """
        first, soft, force = passage.segment[:AT_START], self.law.soft, self._force
        context = force.GetMyMutableContextFromRoot(root)
        motion = self.model.positions(first.position), first.velocity, first.acceleration
        lags = np.array([force.lags(context, *each) for each in zip(*motion, strict=True)])
        plays = np.array([each.play for each in force.couplings(context)])
        before = motion_before(self.model, passage, self.sign_width)
        loose = thrown(self.model.effects, before, force.soft_joints)
        lag, rate = first_lag(lags, plays, first.time, loose)
        q, v = start
        force.set_motors(context, lag, v[soft.velocities])
        q[soft.positions] -= lag
        v[soft.velocities] -= rate

    def _limit(self, root: Context) -> EventStatus:
        """End a simulation that has no steps left, or whose robot is too fast for any."""
        context = self._plant.GetMyContextFromRoot(root)
        _, velocity = self.law.plant.split(self._plant.GetPositionsAndVelocities(context))
        inside = bool((np.abs(velocity) < FASTEST * self._fastest).all())
        if inside and next(self._steps, None) is not None:
            return EventStatus.DidNothing()
        return EventStatus.ReachedTermination(self._diagram, "beyond all reason")

    def _remember(self, passage: Passage, root: Context) -> None:
        """Leave the hidden states of effects as the measured motion before a passage does."""
        states = hidden_states(self.model, passage, self.sign_width)
        self._force.set_hidden_states(self._force.GetMyMutableContextFromRoot(root), states)

    def _decay(self, root: Context) -> float:
        """Return the fastest rate, 1/s, at which velocities near rest decay by friction."""
        nv, m = len(self.model.joints), len(self._force.soft_joints)
        context = self._plant.GetMyMutableContextFromRoot(root)
        motors = self._force.GetMyMutableContextFromRoot(root)
        port = self._plant.get_generalized_acceleration_output_port()
        own = motors.get_continuous_state_vector().CopyToVector()
        slopes = []
        for change in _CHANGE * np.vstack([np.zeros(nv + m), np.eye(nv + m)]):
            self._plant.SetVelocities(context, change[:nv])
            motors.SetContinuousState(np.concatenate([own[: len(own) - m], change[nv:]]))
            rates = self._force.EvalTimeDerivatives(motors).CopyToVector()[len(own) - m :]
            slopes.append(np.concatenate([port.Eval(context), rates]))
        motors.SetContinuousState(own)
        return _fastest_decay(slopes)


def _fastest_decay(rates: Sequence[Array]) -> float:
    """Return the fastest decay, 1/s, by accelerations (n,) at rest and at each small velocity."""
    slope = (np.array(rates[1:]) - rates[0]).T / _CHANGE
    return float(np.abs(np.linalg.eigvals(slope)).max())


def hidden_states(model: RobotModel, passage: Passage, sign_width: Array) -> dict[Effect, Array]:
    """Return hidden states (s,) of effects as the measured motion before a passage leaves them."""
    effects = [fitted.effect for fitted in model.effects if fitted.effect.state_count]
    if not effects:
        return {}
    # The direction in which a log begins takes two samples.
    seen = model.motion(passage.motion(model, 2), sign_width=sign_width)
    return {effect: effect.states_along(seen)[0] for effect in effects}


# Where links of soft joints are when a passage begins, and how they move: springs bend as their
# load has them, and in dead bands links are as the motion before leaves them.


def first_lag(
    lags: Array, plays: Array, time: Array, loose: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return lags (m,) of links behind their motors, and their rates, when a passage begins.

    Args:
        lags: (K, m) those that loads make at the first samples, rad or m.
        plays: (m,) half widths of dead bands, rad or m.
        loose: Lags in dead bands, and their rates; see `thrown`.
    """
    bends = lags - np.clip(lags, -plays, plays)
    degree = min(2, len(lags) - 1)
    slope = np.polyfit(time - time[0], bends, degree)
    lag, rate = lags[0], slope[-2] if degree else np.zeros(len(plays))
    inside, rates = loose
    return np.where(plays, bends[0] + inside, lag), np.where(plays, rates, rate)


def motion_before(model: RobotModel, passage: Passage, sign_width: Array) -> RobotMotion:
    """Return the measured motion before a passage, up to its second sample, as effects see it."""
    first = max(0, passage.start - round(_BEFORE / passage.stretch.period))
    known = passage.stretch[first : passage.start + 2]
    positions, time = model.positions(known.position), known.time - passage.began
    motion = Motion(positions, known.velocity, known.acceleration, time)
    return model.motion(motion, sign_width=sign_width)


def thrown(
    effects: Sequence[FittedEffect], seen: RobotMotion, joints: Sequence[str]
) -> tuple[Array, Array]:
    """Return lags (m,) in dead bands, and their rates, at the last sample but one of a motion."""
    lag, rate = np.zeros((2, len(joints)))
    for fitted in effects:
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect) and effect.give(fitted.parameters).play:
            found, share = effect.deflection(seen), float(fitted.parameters[0])
            lag[joints.index(effect.joint)] += share * found.lag[-2]
            rate[joints.index(effect.joint)] += share * found.rate[-2]
    return lag, rate
