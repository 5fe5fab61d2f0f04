"""The simulation behind rollouts: a Drake diagram of a model under efforts or commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator, SimulatorStatus
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, OutputPort
from pydrake.systems.primitives import Adder, MatrixGain

from geodrake.control.rollout.acting import Acting, picked
from geodrake.control.rollout.following import FollowingEffort
from geodrake.control.rollout.loose_links import AT_START, first_lag, motion_before, thrown
from geodrake.control.rollout.passages import Passage
from geodrake.control.systems import EffectForce
from geodrake.errors import ModelError
from geodrake.logs.motion import Motion
from geodrake.logs.temperatures import Temperatures
from geodrake.model.robot_model import RobotModel
from geodrake.model.simulation.force_law import ForceLaw
from geodrake.model.simulation.robot_in_diagram import FORCES
from geodrake.robot.plant import load_plant, set_inertial_parameters

Array = NDArray[np.float64]

LARGEST_STEP = 5e-3  # of the integrator, s
_ACCURACY = 1e-3
_STEPS, _TIMES = 60_000, 20  # that a rollout may take in all, and times those without a care
FASTEST = 1e6  # peak speeds of the log, beyond which no robot is simulated any more
_STIFF = 4e3  # rate of decay from which on an implicit integrator is the faster one, 1/s


def allowed_steps(passages: Sequence[Passage]) -> Iterator[int]:
    """One item for each step that the simulation of passages may take, all of them together.

    A robot that flies apart, as under efforts in other units, takes ever smaller steps. Models
    that lacked all friction took up to 18 times the steps of calm ones on public logs (UR10e), and
    256 times in the demo, some 74,000 for its twelve windows.
    """
    calm = sum(
        max(len(passage.time), (passage.time[-1] - passage.time[0]) / LARGEST_STEP)
        for passage in passages
    )
    return iter(range(_STEPS + round(_TIMES * calm)))


def positions_along(
    simulator: Simulator,
    time: Array,
    positions: Callable[[], Array],
    *,
    decay: float,
    limit: Callable[[Context], EventStatus],
) -> Array:
    """(K, nv) positions of a simulation at times; NaN from where it ends or cannot go on.

    Args:
        time: (K,) s.
        positions: Those (nv,) that the simulation has just now.
        decay: The fastest rate, 1/s, at which velocities decay; it decides on the integrator.
    """
    ResetIntegratorFromFlags(
        simulator, "radau3" if decay > _STIFF else "runge_kutta3", LARGEST_STEP
    )
    simulator.get_mutable_integrator().set_target_accuracy(_ACCURACY)
    simulator.Initialize()
    simulator.set_monitor(limit)
    found = np.full((len(time), len(positions())), np.nan)
    for k, instant in enumerate(time):
        try:
            status = simulator.AdvanceTo(instant)
        except RuntimeError:  # the integrator gives up: the robot flies apart
            break
        if status.reason() != SimulatorStatus.ReturnReason.kReachedBoundaryTime:
            break
        found[k] = positions()
    return found


class Simulation:
    """The diagram: efforts, effects, and the plant, in the time of a log.

    Args:
        sign_width: (nv,) speeds below which dry friction fades, rad/s or m/s.
        fastest: (nv,) peak speeds of the measured motion, rad/s or m/s.
        steps: One item for each step of the integrator that is left.
    """

    def __init__(
        self,
        model: RobotModel,
        sign_width: Array,
        log: str,
        temperatures: Temperatures | None,
        *,
        acting: Acting,
        fastest: Array,
        steps: Iterator[int],
    ) -> None:
        self.model, self.sign_width, self.temperatures = model, sign_width, temperatures
        self.acting = acting
        self._fastest, self._steps = fastest, steps
        builder = DiagramBuilder()
        loaded = load_plant(model.path, floating=model.floating, held=model.held, given=model.given)
        self._plant = builder.AddSystem(loaded.plant)
        effects = [fitted for fitted in model.effects if fitted.effect.role in FORCES]
        self._force = builder.AddSystem(
            EffectForce(
                self._plant,
                effects,
                sign_width=self._whole(sign_width, 1.0),
                phi=model.total_phi,
                log=log,
                temperatures=temperatures,
            )
        )
        _check_followers(model, implicit=self._force.implicit)
        # Where the position of each velocity stands.
        places = model.positions(np.arange(len(model.joints), dtype=float)[None])[0]
        self._order = model.coordinates.own_positions[np.argsort(places)]
        nv = self._plant.num_velocities()
        effort = self._whole_effort(builder, acting.add(builder, self._measured_state(builder)))
        total = builder.AddSystem(Adder(2, nv))
        builder.Connect(self._plant.get_state_output_port(), self._force.GetInputPort("state"))
        builder.Connect(effort, self._force.GetInputPort("applied_effort"))
        builder.Connect(effort, total.get_input_port(0))
        builder.Connect(self._force.GetOutputPort("generalized_force"), total.get_input_port(1))
        moving = total.get_output_port()
        if model.followers:
            following = builder.AddSystem(FollowingEffort(model))
            builder.Connect(self._plant.get_state_output_port(), following.GetInputPort("state"))
            builder.Connect(moving, following.GetInputPort("effort"))
            moving = following.get_output_port()
        builder.Connect(moving, self._plant.get_applied_generalized_force_input_port())
        self._diagram = builder.Build()

    def _measured_state(self, builder: DiagramBuilder) -> OutputPort:
        """Positions and velocities (2 nv) of the motors, in the model's order."""
        soft = self._force.soft_joints
        port = (
            self._force.GetOutputPort("motor_state")
            if soft
            else self._plant.get_state_output_port()
        )
        own = self._plant.num_positions() + self.model.coordinates.own_velocities
        return picked(builder, port, np.concatenate([self._order, own]))

    def _whole_effort(self, builder: DiagramBuilder, effort: OutputPort) -> OutputPort:
        """Efforts (nv of the plant), of those of the model."""
        to_plant = self._whole(np.eye(effort.size())).T
        if np.array_equal(to_plant, np.eye(effort.size())):
            return effort
        gain = builder.AddSystem(MatrixGain(to_plant))
        builder.Connect(effort, gain.get_input_port())
        return gain.get_output_port()

    @property
    def law(self) -> ForceLaw:
        """What effects need, and what holds motors and links together."""
        return self._force.law

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed."""
        return self._force.notes

    def positions(self, passage: Passage) -> Array:
        """(K, nv) positions from a passage's first state on, under what acts in it.

        From where a joint is a million times as fast as it was measured, or no steps of the
        integrator are left, they are NaN.
        """
        segment, time = passage.segment, passage.time
        self.acting.begin(passage)
        simulator = Simulator(self._diagram)
        root = simulator.get_mutable_context()
        root.SetTime(time[0])
        self.acting.remember(passage, root)
        self._remember(passage, root)
        context = self._plant.GetMyMutableContextFromRoot(root)
        set_inertial_parameters(self._plant, context, self.model.total_phi)
        ways = self.model.coordinates
        q = ways.plant_positions(self.model.positions(segment.position[:1]))[0]
        v = ways.plant_velocities(segment.velocity[:1])[0]
        if self._force.soft_joints:
            self._deflect(passage, root, (q, v))
        self._plant.SetPositions(context, q)
        decay = self._decay(root)
        self._plant.SetVelocities(context, v)
        return positions_along(
            simulator,
            time,
            lambda: self._measured(root)[self._order],
            decay=decay,
            limit=self._limit,
        )

    def _measured(self, root: Context) -> Array:
        """Positions (nq,) of the motors."""
        if not self._force.soft_joints:
            return self._plant.GetPositions(self._plant.GetMyContextFromRoot(root))
        state = self._force.GetOutputPort("motor_state").Eval(
            self._force.GetMyContextFromRoot(root)
        )
        return state[: self._plant.num_positions()]

    def _deflect(self, passage: Passage, root: Context, start: tuple[Array, Array]) -> None:
        """Puts links where their load has them, and has their motors move as was measured.

        Args:
            root: Context of the diagram; that of the effects is changed.
            start: (nq,) positions and (nv,) velocities of the motors, which become those of links.
        """
        first, ways, soft = (
            passage.segment[:AT_START],
            self.model.coordinates,
            self._force.law.soft,
        )
        context = self._force.GetMyMutableContextFromRoot(root)
        motion = (
            ways.plant_positions(self.model.positions(first.position)),
            ways.plant_velocities(first.velocity),
            ways.plant_velocities(first.acceleration),
        )
        lags = np.array([self._force.lags(context, *each) for each in zip(*motion, strict=True)])
        plays = np.array([each.play for each in self._force.couplings(context)])
        lag, rate = first_lag(lags, plays, first.time, lambda: self._thrown(passage))
        q, v = start
        self._force.set_motors(context, lag, v[soft.velocities])
        q[soft.positions] -= lag
        v[soft.velocities] -= rate

    def _thrown(self, passage: Passage) -> tuple[Array, Array]:
        seen = motion_before(self.model, passage, self.sign_width)
        return thrown(self.model.effects, seen, self._force.soft_joints)

    def _whole(self, values: Array, at_followers: float = 0.0) -> Array:
        """Values (..., nv of the plant), of those (..., nv) of the model."""
        shape = *values.shape[:-1], self.model.plant.num_velocities()
        whole = np.full(shape, at_followers)
        whole[..., self.model.coordinates.own_velocities] = values
        return whole

    def _limit(self, root: Context) -> EventStatus:
        """Ends a simulation that has no steps left, or whose robot is too fast for any."""
        velocity = self._plant.GetVelocities(self._plant.GetMyContextFromRoot(root))
        velocity = velocity[self.model.coordinates.own_velocities]
        inside = bool((np.abs(velocity) < FASTEST * self._fastest).all())
        if inside and next(self._steps, None) is not None:
            return EventStatus.DidNothing()
        return EventStatus.ReachedTermination(self._diagram, "beyond all reason")

    def _remember(self, passage: Passage, root: Context) -> None:
        """Leaves the hidden states of effects as the measured motion before a passage does."""
        effects = [effect for effect in self._force.effects if effect.state_count]
        if not effects:
            return
        first = passage.segment[:2]  # the direction in which a log begins takes two samples
        positions = self.model.positions
        seen = self.model.motion(
            Motion(
                positions(first.position),
                first.velocity,
                first.acceleration,
                passage.time[:2],
                positions(passage.before),
            ),
            sign_width=self.sign_width,
        )
        states = {effect: effect.states_along(seen)[0] for effect in effects}
        self._force.set_hidden_states(self._force.GetMyMutableContextFromRoot(root), states)

    def _decay(self, root: Context) -> float:
        """The fastest rate, 1/s, at which velocities near rest decay by friction."""
        ways, nv, m = self.model.coordinates, len(self.model.joints), len(self._force.soft_joints)
        context = self._plant.GetMyMutableContextFromRoot(root)
        motors = self._force.GetMyMutableContextFromRoot(root)
        port = self._plant.get_generalized_acceleration_output_port()
        own = motors.get_continuous_state_vector().CopyToVector()
        slopes = []
        for change in 1e-6 * np.vstack([np.zeros(nv + m), np.eye(nv + m)]):
            self._plant.SetVelocities(context, ways.plant_velocities(change[None, :nv])[0])
            motors.SetContinuousState(np.concatenate([own[: len(own) - m], change[nv:]]))
            rates = self._force.EvalTimeDerivatives(motors).CopyToVector()[len(own) - m :]
            slopes.append(np.concatenate([port.Eval(context)[ways.own_velocities], rates]))
        motors.SetContinuousState(own)
        slope = (np.array(slopes[1:]) - slopes[0]).T / 1e-6
        return float(np.abs(np.linalg.eigvals(slope)).max())


def _check_followers(model: RobotModel, *, implicit: bool) -> None:
    """Refuses effects that ask for accelerations, which a plant knows without followers only."""
    for joint, (leader, _) in model.led.items() if implicit else ():
        raise ModelError(
            f"Joint {joint!r} follows {leader!r}, and the model has effects of accelerations or "
            "loads, or soft joints: they cannot be simulated together.",
            advice=f"Hold {leader!r} where it stands: --lock {leader}=VALUE, or "
            "geodrake.model.holding.",
            joint=joint,
        )
