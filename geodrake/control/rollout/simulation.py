"""Simulations of rollouts: Drake diagrams of a model under efforts or commands."""

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
"""Number of samples from which the initial deflection rate of soft joints is estimated."""

LARGEST_STEP = 5e-3  # of the integrator, s
_ACCURACY = 1e-3
_STEPS, _STEP_FACTOR = 60_000, 20  # step limit of a rollout, and multiple of the steps at full size
_STIFF = 4e3  # decay rate above which an implicit integrator is faster, 1/s
_LEAD_TIME = 0.5  # s before a passage, over which links are simulated in their dead bands
_CHANGE = 1e-6  # of velocities, to compute decay rates


def simulations(conditions: Conditions, passages: Sequence[Passage]) -> Callable[[str], Simulation]:
    """Return a function from the name of a log to its simulation, constructed on demand.

    Args:
        passages: All passages to simulate, which share a limit of integration steps. A divergent
            robot, as under efforts in wrong units, needs ever smaller steps. Models without any
            friction took up to 18 times the usual number of steps on public logs (UR10e), and 256
            times in the demo, some 74,000 for its twelve windows.

    Raises:
        LogError: A joint has no efforts.
    """
    for trajectory in conditions.case.trajectories:
        if trajectory.unmeasured:
            raise LogError(
                f"Log {trajectory.name!r} has no efforts of {', '.join(trajectory.unmeasured)}, "
                "without which nothing moves the robot.",
                advice="Log efforts of all joints; or use geodrake compare.",
            )
    usual = sum(max(len(p.time), (p.time[-1] - p.time[0]) / LARGEST_STEP) for p in passages)
    steps = iter(range(_STEPS + round(_STEP_FACTOR * usual)))
    return cache(lambda log: Simulation(conditions, log, steps))


class Simulation:
    """Simulation of a model in a log, by a diagram of efforts, effects and plant.

    Args:
        steps: Iterator with one item per remaining integration step.
    """

    def __init__(self, conditions: Conditions, log: str, steps: Iterator[int]) -> None:
        self.robot = robot = conditions.robots[log]
        self.sign_width, self._peak_speed = conditions.sign_width, conditions.peak_speed
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
        indices = np.concatenate([np.argsort(places), len(places) + np.arange(nv)])
        self._measured = selected(builder, state, indices)
        effort = robot.add(builder, self._measured)
        builder.Connect(effort, force.GetInputPort("applied_effort"))
        if self._driving is None:
            add_generalized_force(builder, plant, effort)
        self._diagram = builder.Build()

    @property
    def model(self) -> RobotModel:
        """The model, with the payloads of the log."""
        return self.robot.model

    @property
    def law(self) -> ForceLaw:
        """The force law of effects and of couplings between motors and links."""
        return self._force.law

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions of the simulation."""
        return self._force.notes

    def positions(self, passage: Passage) -> Array:
        """Return the simulated positions (K, nv), starting at a passage's first state.

        They are NaN after a joint exceeds a million times its measured peak speed, or the
        integration steps are used up.
        """
        time = passage.time
        self.robot.set_inputs(passage)
        simulator = Simulator(self._diagram)
        root = simulator.get_mutable_context()
        root.SetTime(time[0])
        self.robot.set_integrals(passage, root)
        decay = self._start(passage, root)
        scheme = "radau3" if decay > _STIFF else "runge_kutta3"
        ResetIntegratorFromFlags(simulator, scheme, LARGEST_STEP)
        simulator.get_mutable_integrator().set_target_accuracy(_ACCURACY)
        simulator.Initialize()
        simulator.set_monitor(self._limit)
        nv, system = len(self.model.joints), self._measured.get_system()
        positions = np.full((len(time), nv), np.nan)
        for k, t in enumerate(time):
            try:
                status = simulator.AdvanceTo(t)
            except RuntimeError:  # the integrator fails as the simulation diverges
                break
            if status.reason() != SimulatorStatus.ReturnReason.kReachedBoundaryTime:
                break
            positions[k] = self._measured.Eval(system.GetMyContextFromRoot(root))[:nv]
        return positions

    def _start(self, passage: Passage, root: Context) -> float:
        """Set the initial state of a passage, and return the fastest velocity decay rate, 1/s."""
        segment, plant = passage.segment, self._plant
        context = plant.GetMyMutableContextFromRoot(root)
        set_inertial_parameters(plant, context, self.model.total_phi)
        q = np.array(self.model.positions(segment.position[:1])[0])
        v = np.array(segment.velocity[0])
        self._set_hidden_states(passage, root)
        if self._driving is not None:
            plant.SetPositionsAndVelocities(context, self._driving.joined(q, v))
            state = PlantState(q, v, root.get_time(), np.zeros(self.law.state_count))
            inputs = (0.0 * v, (self.law.mu, self.law.phi))
            rates = [
                self.law.response(replace(state, v=change), *inputs).acceleration
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
        """Set links to their deflected states, and motors to their measured ones.

        Args:
            root: Context of the diagram; that of the effects is changed.
            start: (nq,) positions and (nv,) velocities of the motors, converted to those of links.
        """
        first, soft, force = passage.segment[:AT_START], self.law.soft, self._force
        context = force.GetMyMutableContextFromRoot(root)
        motion = self.model.positions(first.position), first.velocity, first.acceleration
        lags = np.array([force.lags(context, *sample) for sample in zip(*motion, strict=True)])
        plays = np.array([coupling.play for coupling in force.couplings(context)])
        preceding = preceding_motion(self.model, passage, self.sign_width)
        backlash = backlash_lag(self.model.effects, preceding, force.soft_joints)
        lag, rate = initial_lag(lags, plays, first.time, backlash)
        q, v = start
        force.set_motors(context, lag, v[soft.velocities])
        q[soft.positions] -= lag
        v[soft.velocities] -= rate

    def _limit(self, root: Context) -> EventStatus:
        """Terminate a simulation that diverges, or has no steps left."""
        context = self._plant.GetMyContextFromRoot(root)
        _, velocity = self.law.plant.split(self._plant.GetPositionsAndVelocities(context))
        is_bounded = bool((np.abs(velocity) < FASTEST * self._peak_speed).all())
        if is_bounded and next(self._steps, None) is not None:
            return EventStatus.DidNothing()
        return EventStatus.ReachedTermination(self._diagram, "the simulation diverges")

    def _set_hidden_states(self, passage: Passage, root: Context) -> None:
        """Set the hidden states of effects to those after the motion before a passage."""
        states = hidden_states(self.model, passage, self.sign_width)
        self._force.set_hidden_states(self._force.GetMyMutableContextFromRoot(root), states)

    def _decay(self, root: Context) -> float:
        """Return the fastest decay rate, 1/s, of velocities near rest due to friction."""
        nv, m = len(self.model.joints), len(self._force.soft_joints)
        context = self._plant.GetMyMutableContextFromRoot(root)
        motors = self._force.GetMyMutableContextFromRoot(root)
        port = self._plant.get_generalized_acceleration_output_port()
        state = motors.get_continuous_state_vector().CopyToVector()
        first = len(state) - m
        accelerations = []
        for change in _CHANGE * np.vstack([np.zeros(nv + m), np.eye(nv + m)]):
            self._plant.SetVelocities(context, change[:nv])
            motors.SetContinuousState(np.concatenate([state[:first], change[nv:]]))
            rates = self._force.EvalTimeDerivatives(motors).CopyToVector()[first:]
            accelerations.append(np.concatenate([port.Eval(context), rates]))
        motors.SetContinuousState(state)
        return _fastest_decay(accelerations)


def _fastest_decay(rates: Sequence[Array]) -> float:
    """Return the fastest decay rate, 1/s, given accelerations (n,) at rest and at unit changes."""
    slope = (np.array(rates[1:]) - rates[0]).T / _CHANGE
    return float(np.abs(np.linalg.eigvals(slope)).max())


def hidden_states(model: RobotModel, passage: Passage, sign_width: Array) -> dict[Effect, Array]:
    """Return the hidden states (s,) of effects after the measured motion before a passage."""
    effects = [fitted.effect for fitted in model.effects if fitted.effect.state_count]
    if not effects:
        return {}
    # Two samples, as the initial direction of a log is a difference.
    motion = model.motion(passage.motion(model, 2), sign_width=sign_width)
    return {effect: effect.states_along(motion)[0] for effect in effects}


# Initial states of the links of soft joints: springs are deflected by their load, and positions in
# dead bands result from the preceding motion.


def initial_lag(
    lags: Array, plays: Array, time: Array, backlash: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return lags (m,) of links behind their motors, and their rates, at the start of a passage.

    Args:
        lags: (K, m) static lags due to loads at the first samples, rad or m.
        plays: (m,) half widths of dead bands, rad or m.
        backlash: Lags in dead bands, and their rates; see `backlash_lag`.
    """
    spring_lags = lags - np.clip(lags, -plays, plays)
    degree = min(2, len(lags) - 1)
    coefficients = np.polyfit(time - time[0], spring_lags, degree)
    rate = coefficients[-2] if degree else np.zeros(len(plays))
    lag_in_band, rate_in_band = backlash
    lag = np.where(plays, spring_lags[0] + lag_in_band, lags[0])
    return lag, np.where(plays, rate_in_band, rate)


def preceding_motion(model: RobotModel, passage: Passage, sign_width: Array) -> RobotMotion:
    """Return the measured motion before a passage, up to its second sample."""
    first = max(0, passage.start - round(_LEAD_TIME / passage.stretch.period))
    segment = passage.stretch[first : passage.start + 2]
    positions, time = model.positions(segment.position), segment.time - passage.began
    motion = Motion(positions, segment.velocity, segment.acceleration, time)
    return model.motion(motion, sign_width=sign_width)


def backlash_lag(
    effects: Sequence[FittedEffect], motion: RobotMotion, joints: Sequence[str]
) -> tuple[Array, Array]:
    """Return lags (m,) in dead bands, and their rates, at the last but one sample of a motion."""
    lag, rate = np.zeros((2, len(joints)))
    for fitted in effects:
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect) and effect.give(fitted.parameters).play:
            deflection, share = effect.deflection(motion), float(fitted.parameters[0])
            lag[joints.index(effect.joint)] += share * deflection.lag[-2]
            rate[joints.index(effect.joint)] += share * deflection.rate[-2]
    return lag, rate
