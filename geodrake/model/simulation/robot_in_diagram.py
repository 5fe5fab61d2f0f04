"""A fitted model in a Drake diagram: plant, effects and delays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    InputPort,
    LeafSystem,
    OutputPort,
    System,
)
from pydrake.systems.primitives import MatrixGain, PassThrough

from geodrake.boundary.arguments import positive, real_array
from geodrake.effects import Effect, FittedEffect, Role
from geodrake.effects.file_terms import Polynomial
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.model.simulation.effect_force import EffectForce
from geodrake.model.simulation.scalar_system import differenced
from geodrake.model.simulation.terms import DrivenPlant, Model
from geodrake.robot.plant import load_plant
from geodrake.robot.robot_instance import RobotInstance, RobotPorts, add_generalized_force
from geodrake.robot.shapes import add_visuals

_MOST_SAMPLES = 1_000_000


@differenced
class DelayedEffort(LeafSystem):
    """Delays efforts, as a drive or a bus does.

    .. pydrake_system::

        name: DelayedEffort
        input_ports:
        - effort
        output_ports:
        - delayed_effort

    delayed_effort(t) = effort(t − δ), with one delay per effort. The input is sampled every
    `period` and interpolated linearly, so the output is continuous. Before t = δ it is the first
    sample.

    The system can be cloned, and converted to AutoDiffXd.

    The state is the time of the last sample, followed by the samples from the oldest to the last.
    """

    def __init__(self, delays: ArrayLike, *, period: float = 1e-3) -> None:
        """Construct the system with delays (n,), s, each zero or at least one sampling period."""
        LeafSystem.__init__(self, converter=self._converter)
        delays = np.atleast_1d(real_array(delays, "delays")).copy()
        positive(period, "period")
        usable = (delays == 0) | (delays >= period * (1 - 1e-9))
        if delays.ndim > 1 or not len(delays) or not usable.all():
            raise ArgumentError(
                f"Delays must be zero or at least the period; they are {delays} s, and the "
                f"period is {period} s.",
                advice="Choose a shorter period.",
            )
        if delays.max() / period > _MOST_SAMPLES:
            raise ArgumentError(
                f"Delays are limited to {_MOST_SAMPLES} periods; got {delays.max():g} s with "
                f"a period of {period:g} s.",
                advice="Choose a longer period.",
            )
        self._delays, self._period = delays, period
        self._samples = 2 + int(np.ceil(delays.max() / period - 1e-9))
        self._size, self._columns = len(delays), np.arange(len(delays))
        self._prompt = np.flatnonzero(delays == 0)
        self._input = self.DeclareVectorInputPort("effort", BasicVector(self._size))
        start = np.zeros(1 + self._samples * self._size)
        start[0] = -np.inf
        state = self.DeclareDiscreteState(start)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)
        prerequisites = {self.discrete_state_ticket(state), self.time_ticket()}
        if (delays == 0).any():
            prerequisites.add(self._input.ticket())
        self.DeclareVectorOutputPort(
            "delayed_effort", BasicVector(self._size), self._calc_delayed, prerequisites
        )

    def _history(self, context: Context) -> tuple[float, np.ndarray]:
        """Return the time of the last sample and the samples, (samples, size)."""
        state = context.get_discrete_state_vector().value()
        return state[0], state[1:].reshape(self._samples, self._size)

    def _sample(self, context: Context, state: DiscreteValues) -> None:
        last, history = self._history(context)
        effort = self._input.Eval(context)
        after = np.empty(1 + history.size)
        after[0] = context.get_time()
        after[1 : -self._size] = history[1:].ravel()
        after[-self._size :] = effort
        if last == -np.inf:  # the first sample
            after[1:] = np.tile(effort, self._samples)
        state.set_value(after)

    def _calc_delayed(self, context: Context, output: BasicVector) -> None:
        last, history = self._history(context)
        age = np.zeros(self._size)  # arbitrary before the first sample
        if last > -np.inf:
            age = (self._delays + last - context.get_time()) / self._period
        place = (self._samples - 1 - age).clip(0, self._samples - 1)
        i = np.minimum(place.astype(int), self._samples - 2)
        early, late = history[i, self._columns], history[i + 1, self._columns]
        delayed = early + (place - i) * (late - early)
        if len(self._prompt):
            delayed[self._prompt] = self._input.Eval(context)[self._prompt]
        output.SetFromVector(delayed)


_PERIOD = 1e-3  # longest sampling period of delayed efforts, s

FORCES = (Role.FORCE, Role.SCALE, Role.EPISODE, Role.DEFLECTION)
"""Roles of effects in `EffectForce`; payloads are part of the plant's inertias."""


@dataclass(frozen=True, eq=False)
class RobotInDiagram:
    """A model that was added to a builder: its systems and its ports.

    Attributes:
        robot: The robot in its plant. The default inertias are the model's, payloads included; in a
            plant with other objects, call `set_inertias`.
        scene_graph: The SceneGraph of the plant, if any.
        effect_force: The system of the model's effects, if any.
        total_phi: (nb, 10) the model's inertial parameters, payloads included.
        effort: Input (nv) for the efforts at the joints, N·m or N, zero if not connected, in the
            scale of the logs that the model was fitted to, wrong gains included.
        state: Output (nq + nv): positions and velocities measured by encoders, which are those of
            the motors of elastic joints; `plant` has those of the links.
        logged_effort: Output (nv): efforts in a log, with the model's delays.
        notes: Assumptions, and elements that cannot be drawn.
        driving: The plant's motion in the model's coordinates, if they differ from its own.
    """

    robot: RobotInstance
    scene_graph: SceneGraph | None
    effect_force: EffectForce | None
    joints: tuple[str, ...]
    total_phi: Array
    effort: InputPort
    state: OutputPort
    logged_effort: OutputPort
    notes: tuple[str, ...] = ()
    driving: DrivenPlant | None = None

    @property
    def plant(self) -> MultibodyPlant:
        """Return the plant of the robot."""
        return self.robot.plant

    def ports(self) -> RobotPorts:
        """Return the robot's ports for `add_adaptive_loop`."""
        return RobotPorts(self.joints, self.state, None, self.effort)

    def set_inertias(self, root: Context) -> None:
        """Set the robot's inertial parameters to the model's, payloads included."""
        if self.driving is None:  # otherwise the plant's default inertias are the model's
            self.set_parameters(root, phi=self.total_phi)

    def set_state(self, root: Context, q: ArrayLike, v: ArrayLike | None = None) -> None:
        """Set the robot's measured initial state in the Context of the whole diagram.

        Positions (nq,) of the robot are in Drake's order; velocities (nv,) are 0 by default. Links
        of elastic joints are deflected by the static load.
        """
        plant, driving, nv = self.plant, self.driving, len(self.joints)
        nq = plant.num_positions() if driving is None else driving.sizes[0]
        nq = nq if self.robot.name is None else nv
        q = real_array(q, "q", (nq,))
        v = real_array(np.zeros(nv) if v is None else v, "v", (nv,))
        context = plant.GetMyMutableContextFromRoot(root)
        if self.robot.name is not None:
            self.robot.set_state(context, self.joints, np.concatenate([q, v]))
        else:
            state = np.concatenate([q, v]) if driving is None else driving.joined(q, v)
            plant.SetPositionsAndVelocities(context, state)
        if self.effect_force is not None:
            self.effect_force.deflect(root)

    def set_parameters(
        self,
        root: Context,
        *,
        phi: ArrayLike | None = None,
        effects: Mapping[Effect, ArrayLike] | None = None,
    ) -> None:
        """Set parameters of plant and effects in a Context.

        Args:
            phi: (nb, 10) inertial parameters, payloads included; unchanged if None.
            effects: Effect of `effect_force` -> its parameters (k,), SI; others keep theirs.
        """
        force = self.effect_force
        if self.driving is not None:
            raise ArgumentError(
                "Parameters cannot be changed in a diagram with following joints or a "
                "transmission.",
                advice="Add the model with the other parameters.",
            )
        if effects and force is None:
            raise ArgumentError("The robot in the diagram has no effects.")
        if force is not None and effects:
            force.set_effect_parameters(force.GetMyMutableContextFromRoot(root), effects)
        if phi is not None:
            context = self.plant.GetMyMutableContextFromRoot(root)
            self.robot.set_inertial_parameters(context, phi)
            if force is not None:
                whole = self.robot.plant_parameters(phi)
                force.set_inertial_parameters(force.GetMyMutableContextFromRoot(root), whole)


def add_robot(
    model: Model,
    builder: DiagramBuilder,
    time_step: float,
    scene_graph: SceneGraph | bool | None,
    *,
    name: str,
    sign_width: Array,
    log: str | None,
) -> RobotInDiagram:
    """Add a model to a builder; see `RobotModel.add_to_builder`."""
    plant = MultibodyPlant(time_step)
    plant.set_name(name)
    scene = scene_graph or None
    if scene is True:
        scene = builder.AddNamedSystem(f"{name}_scene_graph", SceneGraph())
    if scene is not None:
        plant.RegisterAsSourceForSceneGraph(scene)
    load_plant(
        model.path,
        floating=model.floating,
        held=model.held,
        given=model.given,
        phi=model.total_phi,
        into=plant,
    )
    builder.AddSystem(plant)
    notes: tuple[str, ...] = ()
    if scene is not None:
        notes = add_visuals(plant, scene, model.path, model.given)
        source = scene.get_source_pose_port(plant.get_source_id())
        builder.Connect(plant.get_geometry_pose_output_port(), source)
        builder.Connect(scene.get_query_output_port(), plant.get_geometry_query_input_port())
    robot = RobotInstance(plant)
    added = make_act(model, builder, robot, name=name, sign_width=sign_width, log=log)
    return replace(added, scene_graph=scene, notes=(*notes, *added.notes))


def make_act(
    model: Model,
    builder: DiagramBuilder,
    robot: RobotInstance,
    *,
    name: str,
    sign_width: Array,
    log: str | None,
) -> RobotInDiagram:
    """Connect a model's effects and delays with a robot in a plant of the builder."""
    plant, joints, phi = robot.plant, model.joints, model.total_phi
    if stated := robot.stated_terms:
        owner = "the plant" if robot.name is None else repr(robot.name)
        raise ArgumentError(
            f"{', '.join(stated)} of {owner} would count twice, in the plant and as "
            "effects of the model.",
            advice="Call geodrake.robot.take_out_stated(plant, name) before plant.Finalize().",
        )
    source = builder.AddNamedSystem(f"{name}_effort", PassThrough(np.zeros(len(joints))))
    effort, commanded = source.get_input_port(), source.get_output_port()
    logged = late(builder, f"{name}_logged_effort", commanded, model.delays)
    acting = late(builder, f"{name}_acting_effort", commanded, -model.delays)
    state = plant.get_state_output_port()
    if robot.name is not None:
        state = robot.state_port(builder, joints)
        gain = builder.AddNamedSystem(f"{name}_in_plant", MatrixGain(robot.to_plant(joints)))
        builder.Connect(acting, gain.get_input_port())
        acting = gain.get_output_port()
    driving = model.driving(plant, sign_width, log)
    if driving is None:
        add_generalized_force(builder, plant, acting)
    forces = [fitted for fitted in model.effects if fitted.effect.role in FORCES]
    forces += (  # cancel springs of the plant, as they are effects of the model
        FittedEffect(Polynomial(joint, rest), np.array([0.0, -stiffness, 0.0, 0.0]))
        for joint, stiffness, rest in robot.springs
    )
    force, notes = None, tuple[str, ...]()
    if forces or driving is not None:
        plant_phi = None if robot.name is None else robot.plant_parameters(phi)
        force = EffectForce.AddToBuilder(
            builder, driving or robot, forces, sign_width=sign_width, phi=plant_phi, log=log
        )
        force.set_name(f"{name}_effects")
        builder.Connect(acting, force.GetInputPort("applied_effort"))
        notes = force.notes
        if driving is not None:
            state = force.GetOutputPort("motor_state")
        elif force.soft_joints:
            state = force.state_port(builder, joints)
    ports = effort, state, logged
    return RobotInDiagram(robot, None, force, joints, phi, *ports, notes, driving)


def late(builder: DiagramBuilder, name: str, effort: OutputPort, delays: Array) -> OutputPort:
    """Return an effort (nv,), delayed where delays (nv,), s, are positive."""
    delays = np.maximum(delays, 0.0)
    if not delays.any():
        return effort
    period = min(_PERIOD, delays[delays > 0.0].min())
    late: System = builder.AddNamedSystem(name, DelayedEffort(delays, period=period))
    builder.Connect(effort, late.get_input_port())
    return late.get_output_port()
