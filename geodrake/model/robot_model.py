"""A robot model: rigid bodies, effects, their parameters, and what is known about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder

from geodrake.boundary.arguments import (
    instance,
    instances,
    number,
    one_or_each,
    real_array,
)
from geodrake.boundary.showing import Short
from geodrake.effects import RobotMotion, Role, catalogue
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.delays import delays_of
from geodrake.effects.effect_columns import EffectColumns
from geodrake.effects.fitted_effect import FittedEffect
from geodrake.effects.robot_effect import RobotEffect
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import inertial_parameters
from geodrake.logs.motion import Motion
from geodrake.model.file_terms import Spring
from geodrake.model.simulation.robot_in_diagram import (
    DiagramOptions,
    FittedRobot,
    RobotInDiagram,
    add_robot,
    add_robot_to_scene,
)
from geodrake.robot.files import Given
from geodrake.robot.followers import Follower, OwnCoordinates
from geodrake.robot.holding import moving_joints
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import (
    LoadedPlant,
    effort_limits,
    joint_names,
    load_plant,
    scoped_joint_names,
    set_inertial_parameters,
    velocity_limits,
)
from geodrake.robot.regressor import body_regressor, inverse_dynamics
from geodrake.robot.robot_instance import RobotInstance
from geodrake.robot.several_robots import scoped

Array = NDArray[np.float64]

LARGEST_REGRESSOR = 10_000_000
"""Numbers of a regressor in memory at once: fewer samples for robots of many joints."""


@dataclass(frozen=True, eq=False)
class RobotModel(Short):
    """What is known about a robot: effort needed = Y_rb φ + Σ_e Y_e μ_e.

    Attributes:
        plant: Finalized MultibodyPlant of the rigid bodies alone, inertias as in its file;
            `create_context` has the model's.
        path: The model file that the plant came from.
        floating: Whether free roots float instead of being welded to the world.
        phi: (nb, 10) inertial parameters, those of fitted payloads left out.
        effects: Effects with their parameters.
        information: (p, p) information matrix (inverse covariance) of the inertial parameters and
            then of all effects' parameters; None if the model was never fitted.
        effort_noise: (nv,) RMS of the efforts that the fit left unexplained on held-out data, N·m
            or N; None if the model was never fitted.
        fitted_to: Fingerprints of the logs that the model was fitted to.
        bandwidths: Fingerprint of each of them -> bandwidths of efforts and of the motion, Hz, in
            the last fit to it.
        fading_speed: (nv,) speed below which dry friction fades, rad/s or m/s; 0, or None for all,
            where it was not seen to.
        notes: What was noticed while loading: repairs, things left out.
        held: Joint of the file that is held, and none of the model -> where, rad or m.
        given: How the file was to be read.
        followers: Joints of the plant that follow others, and are none of the model.
        known_joints: Names of the joints that logs may have: the model's, those that are held, and
            those that follow others.
    """

    plant: MultibodyPlant
    path: Path
    floating: bool
    phi: Array
    effects: tuple[FittedEffect, ...] = ()
    information: Array | None = None
    effort_noise: Array | None = None
    fitted_to: tuple[str, ...] = ()
    fading_speed: Array | None = None
    notes: tuple[str, ...] = ()
    bandwidths: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)
    given: Given = field(default_factory=Given)
    followers: tuple[Follower, ...] = ()
    known_joints: tuple[str, ...] = ()

    @cached_property
    def tree(self) -> KinematicTree:
        """The plant's kinematics, read once."""
        return KinematicTree.from_plant(self.plant, self.followers)

    @cached_property
    def coordinates(self) -> OwnCoordinates:
        """Which positions and velocities of the plant are the model's."""
        return OwnCoordinates(self.plant, self.followers)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the nv velocities."""
        names = joint_names(self.plant)
        return tuple(names[k] for k in self.coordinates.own_velocities)

    @cached_property
    def led(self) -> Mapping[str, tuple[str, float]]:
        """Joint that follows another one -> its name, and how far it moves when that moves by 1."""
        names = joint_names(self.plant)
        return {names[to]: (names[of], ratio) for to, of, ratio in self.coordinates.followed}

    @cached_property
    def position_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (nq,) of the positions, rad or m."""
        return self.coordinates.position_limits()

    @cached_property
    def velocity_limits(self) -> Array:
        """Largest speeds (nv,), rad/s or m/s; infinite where there is no limit."""
        return self.coordinates.rate_limits(velocity_limits(self.plant))

    @cached_property
    def acceleration_limits(self) -> Array:
        """Largest accelerations (nv,), rad/s² or m/s²; infinite where there is no limit."""
        plant = self.plant
        return self.coordinates.rate_limits(
            np.minimum(plant.GetAccelerationUpperLimits(), -plant.GetAccelerationLowerLimits())
        )

    @cached_property
    def effort_limits(self) -> Array:
        """Largest efforts (nv,), N·m or N; infinite where there is no limit."""
        return effort_limits(self.plant)[self.coordinates.own_velocities]

    @cached_property
    def bodies(self) -> tuple[str, ...]:
        """Names of the nb bodies, bodies welded together counting as one."""
        return self.tree.bodies

    @cached_property
    def last_bodies(self) -> tuple[str, ...]:
        """Names of the bodies that carry no other one: hands, feet."""
        mobilizers, carrying = self.tree.mobilizers, set[int]()
        for index in range(len(mobilizers) - 1, -1, -1):  # outboard first
            mobilizer = mobilizers[index]
            if mobilizer.parent >= 0 and (mobilizer.body >= 0 or index in carrying):
                carrying.add(mobilizer.parent)
        return tuple(
            self.bodies[mobilizer.body]
            for index, mobilizer in enumerate(mobilizers)
            if index not in carrying and mobilizer.body >= 0
        )

    @cached_property
    def joint_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of single-degree joints of one type that follow each other along the tree."""
        single = set(self.single_places[0])
        pairs = []
        for mobilizer in self.tree.mobilizers:
            if mobilizer.parent >= 0:
                parent = self.tree.mobilizers[mobilizer.parent]
                pair = (parent.velocities.start, mobilizer.velocities.start)
                alike = single.issuperset(pair) and len({self._types[at] for at in pair}) == 1
                if alike and pair[0] != pair[1]:
                    pairs.append((self.joints[pair[0]], self.joints[pair[1]]))
        return tuple(pairs)

    @property
    def delays(self) -> Array:
        """(nv,) seconds by which measured efforts lag, as far as the model knows."""
        return delays_of([fitted.effect for fitted in self.effects], self.joints)

    @cached_property
    def total_phi(self) -> Array:
        """(nb, 10) inertial parameters, payloads included."""
        phi = self.phi.copy()
        for fitted in self.effects:
            if fitted.effect.role is Role.BODY:
                phi[self.bodies.index(fitted.effect.where[0])] += fitted.parameters
        return phi

    def sign_widths(self, least: ArrayLike) -> Array:
        """(nv,) speeds below which dry friction fades, at least those given, rad/s or m/s."""
        width = one_or_each(least, "a sign width", len(self.joints))
        return np.maximum(width, 0.0 if self.fading_speed is None else self.fading_speed)

    def motion(
        self, motion: Motion, *, sign_width: ArrayLike = 0.0, load: Array | None = None
    ) -> RobotMotion:
        """A motion as effects see it: by joint, with the rigid bodies' effort as load.

        Args:
            motion: (N, ·) positions, velocities and accelerations in Drake's order.
            sign_width: As in `sign_widths`.
            load: (N, nv) effort of the rigid bodies, if it is known already.
        """
        samples = instance(motion, "motion", Motion).q, motion.v, motion.vd
        if load is not None:
            load = real_array(load, "load", motion.v.shape, finite=False)
        else:
            load = inverse_dynamics(self.tree, *samples, self.total_phi)
        q = np.full(motion.v.shape, np.nan)
        at_velocity, at_position = self.single_places
        q[:, at_velocity] = motion.q[:, at_position]
        width = self.sign_widths(sign_width)
        seen = RobotMotion(
            self.joints,
            q,
            motion.v,
            motion.vd,
            load,
            width,
            lambda body: body_regressor(self.tree, *samples, self.bodies.index(body)),
            RobotBodies(self.tree, motion.q, self.total_phi),
            motion.time,
        )
        if motion.before is not None:
            before = np.full((len(motion.before), len(self.joints)), np.nan)
            before[:, at_velocity] = motion.before[:, at_position]
            seen = replace(seen, before=before)
        return replace(seen, effort=cache(lambda: self._unscaled_effort(seen)))

    def effort(self, motion: Motion, *, sign_width: ArrayLike = 0.0) -> Array:
        """Effort that a motion needs, (N, nv), N·m or N; delays are not applied.

        Args:
            motion: N samples in Drake's order.
            sign_width: Speed below which dry friction fades, rad/s or m/s; one for all velocities
                or (nv,).
        """
        size = max(1, LARGEST_REGRESSOR // (len(self.joints) * self.phi.size))
        effort = np.empty(instance(motion, "motion", Motion).v.shape)
        if motion.time is not None and motion.before is None:
            motion = replace(motion, before=motion.q[:0])
        for start in range(0, len(motion), size):
            part = slice(start, start + size)
            seen = self.motion(motion[part], sign_width=sign_width)
            effort[part] = self._unscaled_effort(seen)
            for fitted in self.effects:
                if fitted.effect.role is Role.SCALE:
                    effort[part] += fitted.effect.effort(seen, fitted.parameters)
        return effort

    def _unscaled_effort(self, seen: RobotMotion) -> Array:
        """Effort (N, nv) of the bodies and all effects but scales."""
        columns, mu = self._unscaled_effects
        return seen.load + columns.effort(seen, mu)

    @cached_property
    def _unscaled_effects(self) -> tuple[EffectColumns, Array]:
        """All effects but payloads and scales, and their parameters."""
        some = [f for f in self.effects if f.effect.role not in (Role.BODY, Role.SCALE)]
        columns = EffectColumns(self.joints, tuple(fitted.effect for fitted in some))
        return columns, np.concatenate([np.zeros(0), *(fitted.parameters for fitted in some)])

    def positions(self, by_joint: Array) -> Array:
        """(N, nq) positions in Drake's order from (N, nv) positions of single-degree joints.

        Raises:
            ArgumentError: The robot has joints of several degrees, whose positions are not those.
        """
        by_joint = real_array(by_joint, "by_joint", ("N", len(self.joints)), finite=False)
        at_velocity, at_position = self.single_places
        if len(at_velocity) < len(self.joints):
            several = [n for i, n in enumerate(self.joints) if i not in at_velocity]
            raise ArgumentError(
                f"Logs hold one position for each joint; {', '.join(several)} belong to joints of "
                "several degrees of freedom.",
                advice="Weld the base, or use the regressors from Python.",
            )
        q = np.zeros((len(by_joint), self.tree.num_positions))
        q[:, at_position] = by_joint[:, at_velocity]
        return q

    @cached_property
    def _types(self) -> dict[int, str]:
        """Drake's names for the types of the joints, by where their velocities begin."""
        coordinates = self.coordinates
        return {
            coordinates.velocity_of(joint): joint.type_name()
            for joint in moving_joints(self.plant)
            if scoped(joint) not in coordinates.leaders
        }

    def default_position(self, joint: str) -> float:
        """Where the model file puts a joint of one degree of freedom, rad or m."""
        q = self.plant.GetPositions(self.plant.CreateDefaultContext())
        return float(q[self.coordinates.own_positions][self._at(joint)])

    def limits_of(self, joint: str) -> tuple[float, float]:
        """The positions between which a joint of one degree of freedom stays, rad or m."""
        lower, upper = self.position_limits
        return float(lower[self._at(joint)]), float(upper[self._at(joint)])

    def _at(self, joint: str) -> int:
        """Where the position of a joint of one degree of freedom is in q."""
        at_velocity, at_position = self.single_places
        return at_position[at_velocity.index(self.joints.index(joint))]

    @cached_property
    def single_joints(self) -> tuple[str, ...]:
        """Names of the joints of one degree of freedom."""
        return tuple(self.joints[i] for i in self.single_places[0])

    @cached_property
    def sliding_joints(self) -> tuple[str, ...]:
        """Names of the prismatic joints, whose positions are in m and efforts in N."""
        starts = self.single_places[0]
        return tuple(self.joints[i] for i in starts if self._types[i] == "prismatic")

    @property
    def scoped_joints(self) -> tuple[str, ...]:
        """Names of the joints as `robot::joint`."""
        scoped_names = scoped_joint_names(self.plant)
        return tuple(scoped_names[k] for k in self.coordinates.own_velocities)

    @property
    def position_places(self) -> dict[int, int]:
        """Where in q the position of each velocity is that belongs to a single-degree joint."""
        return dict(zip(*self.single_places, strict=True))

    @cached_property
    def single_places(self) -> tuple[list[int], list[int]]:
        """Where the joints of one degree of freedom are in v and in q."""
        coordinates = self.coordinates
        single = [
            (coordinates.velocity_of(j), coordinates.position_of(j))
            for j in moving_joints(self.plant)
            if j.num_velocities() == j.num_positions() == 1 and scoped(j) not in coordinates.leaders
        ]
        return [at for at, _ in single], [at for _, at in single]

    def create_context(self) -> Context:
        """A default Context of the plant with the model's inertial parameters, payloads included.

        The plant itself keeps the inertias of its file; effects are for `add_to_builder`.
        """
        context = self.plant.CreateDefaultContext()
        set_inertial_parameters(self.plant, context, self.total_phi)
        return context

    def add_to_builder(
        self,
        builder: DiagramBuilder,
        *,
        time_step: float = 0.0,
        scene_graph: SceneGraph | bool | None = None,
        name: str = "plant",
        sign_width: ArrayLike = 1e-2,
        log: str | None = None,
    ) -> RobotInDiagram:
        """Adds the model to a Drake diagram: inertias, payloads, effects and delays, each once.

            builder = DiagramBuilder()
            robot = model.add_to_builder(builder)
            builder.Connect(controller.get_output_port(), robot.effort)
            builder.Connect(robot.state, controller.get_input_port())

        The plant has the model's inertias by default, so any Context of the diagram does. Efforts
        belong at the port `effort`, where effects see them, and not at the plant's own ports.
        Delays shift `logged_effort`; a negative one, of efforts that are logged ahead, delays
        those that act. Hidden states of effects start at zero
        (`EffectForce.set_hidden_states`). Soft joints have motors and links: `state` is that of the
        motors. Parameters are those of the Context (`RobotInDiagram.set_parameters`), and the
        diagram can be cloned, converted to AutoDiffXd and linearized; see `EffectForce`.

        Args:
            builder: The diagram's builder.
            time_step: That of the plant, s; 0 for a continuous one.
            scene_graph: A SceneGraph of the builder that is to know the robot's visual geometry,
                or True for a new one; a MeshcatVisualizer may be added to it.
            name: Name of the plant; several robots in a diagram need different ones.
            sign_width: Speed below which dry friction fades, rad/s or m/s, at least; one for all
                velocities or (nv,). See `EffectForce` for what it means for steps.
            log: Name of the log that is simulated, in which the model's contacts act.

        Raises:
            ArgumentError: An argument is none of these.
            ModelError: The model's file is gone, Drake refuses its inertial parameters, or joints
                follow others.
        """
        instance(builder, "builder", DiagramBuilder)
        if scene_graph is not None:
            instance(scene_graph, "scene_graph", (SceneGraph, bool))
        options = DiagramOptions(
            number(time_step, "time_step", lower=0.0),
            scene_graph,
            instance(name, "name", str),
            self.sign_widths(sign_width),
            log,
        )
        return add_robot(builder, self._as_fitted(), options)

    def add_to_scene(
        self,
        builder: DiagramBuilder,
        robot: RobotInstance,
        *,
        sign_width: ArrayLike = 1e-2,
        log: str | None = None,
    ) -> RobotInDiagram:
        """Makes a robot in a larger plant move as this model: inertias, effects and delays.

            robot = model.add_to_scene(builder, RobotInstance(plant, "arm"))
            builder.Connect(controller.get_output_port(), robot.effort)
            …
            robot.set_inertias(root_context)

        As with `add_to_builder`, but the plant is there, with a table, objects and other robots,
        and bodies that touch. Its inertias are parameters of a Context, so `set_inertias` belongs
        before a simulation. Efforts are generalized forces: actuators of the robot stay free.

        Args:
            builder: The diagram's builder, which has the plant.
            robot: The robot in the plant, its joints and bodies named as in the model's file.
            sign_width: As for `add_to_builder`.
            log: As for `add_to_builder`.

        Raises:
            ArgumentError: The robot is another one, its base leans otherwise than the model's, or
                the plant has damping or rotor inertia at its joints, which are effects.
            ModelError: Joints of the model follow others.
        """
        instance(builder, "builder", DiagramBuilder)
        place = instance(robot, "robot", RobotInstance)
        place.check_base(self.tree, self.joints, turned=self._sees_world)
        name = "plant" if place.name is None else place.name
        options = DiagramOptions(0.0, None, name, self.sign_widths(sign_width), log)
        return add_robot_to_scene(builder, self._as_fitted(), place, options)

    @property
    def _sees_world(self) -> bool:
        """Whether an effect depends on how the base is turned about the vertical."""
        return any(isinstance(fitted.effect, RobotEffect) for fitted in self.effects)

    def _as_fitted(self) -> FittedRobot:
        """What a diagram needs to know.

        Raises:
            ModelError: Joints follow others.
        """
        if self.followers:
            names = ", ".join(follower.joint.rpartition("::")[2] for follower in self.followers)
            raise ModelError(
                f"A diagram cannot have joints that follow others, as {names} do: the plant has no "
                "constraint for them.",
                advice="Hold their leaders: geodrake.model.holding(model, {joint: position}).",
            )
        return FittedRobot(
            self.path,
            self.floating,
            self.total_phi,
            self.effects,
            self.held,
            self.given,
            self.joints,
        )

    def with_fit(
        self,
        phi: Array,
        effects: Sequence[FittedEffect],
        *,
        information: Array,
        effort_noise: Array,
    ) -> RobotModel:
        """The model with fitted parameters in place of its own.

        Args:
            phi: (nb, 10) inertial parameters without payloads.
            effects: Effects and their parameters.
            information: (p, p) information matrix of all of them.
            effort_noise: (nv,) held-out RMS that the fit leaves.

        Raises:
            ArgumentError: A value is not finite, or a shape does not fit the model.
        """
        effects = instances(effects, "effects", FittedEffect)
        p = self.phi.size + sum(len(fitted.parameters) for fitted in effects)
        phi = real_array(phi, "phi", self.phi.shape)
        information = real_array(information, "information", (p, p), finite=False)
        if not np.isfinite(information).all():
            raise ArgumentError("information must be finite.")
        effort_noise = real_array(effort_noise, "effort_noise", (len(self.joints),))
        return replace(
            self,
            phi=phi,
            effects=effects,
            information=information,
            effort_noise=effort_noise,
        )


def from_loaded_plant(loaded: LoadedPlant, *, floating: bool) -> RobotModel:
    """The model of a plant: damping, friction and rotor inertia of the file become effects.

    Args:
        loaded: The plant of a model file, and what the file says of friction, damping and rotors.
        floating: Whether free roots float instead of being welded to the world.
    """
    coordinates = OwnCoordinates(loaded.plant, loaded.followers)
    names = joint_names(loaded.plant)
    joints = [names[k] for k in coordinates.own_velocities]
    effects: list[FittedEffect] = []
    notes = [*map(str, loaded.repairs), *loaded.notes]
    for kind in catalogue():
        values = loaded.stated.get(kind.stated_as, np.zeros(len(joints)))
        stated = [(joint, value) for joint, value in zip(joints, values, strict=True) if value]
        for joint, value in stated:
            effects += [FittedEffect(each, np.array([value])) for each in kind.shaped(joint)]
        if stated:
            listed = ", ".join(f"{joint} {value:g}" for joint, value in stated)
            notes.append(f"The {kind.stated_as} in the file ({listed}) is kept as {kind.name}.")
    for joint, stiffness, rest in zip(joints, *loaded.file_springs, strict=True):
        if stiffness:
            spring = Spring(joint, center=float(rest))
            effects.append(FittedEffect(spring, np.array([stiffness, 0.0])))
            notes.append(
                f"The spring in the file ({joint} {stiffness:g}) is kept as {spring.name}."
            )
    phi = inertial_parameters(loaded.plant)
    return RobotModel(
        loaded.plant,
        loaded.path,
        floating,
        phi,
        tuple(effects),
        notes=tuple(notes),
        held=loaded.held,
        given=loaded.given,
        followers=loaded.followers,
        known_joints=loaded.joints,
    )


def load_description(
    path: str | Path,
    *,
    floating: bool = False,
    held: Mapping[str, float] | None = None,
    given: Given | None = None,
) -> RobotModel:
    """The model of a URDF, SDF, MJCF or Drake directives file; see `geodrake.robot.load_plant`."""
    loaded = load_plant(path, floating=floating, held=held, given=given)
    return from_loaded_plant(loaded, floating=floating)
