"""A robot model: rigid bodies, effects, and their parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder

from geodrake.boundary.arguments import instance, instances, number, one_or_each, real_array
from geodrake.boundary.showing import Short
from geodrake.effects import Effect, RobotMotion, Role
from geodrake.effects.base import FittedEffect, RobotEffect
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.effect_columns import EffectColumns
from geodrake.effects.sensors import delays_of
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array, inertial_parameters, is_physical
from geodrake.logs.motion import Motion
from geodrake.logs.temperatures import Temperatures
from geodrake.model.effort_signal import EffortSignal, signal_of
from geodrake.model.other_programs import BUG, check_loops, with_mujoco
from geodrake.model.simulation.robot_in_diagram import RobotInDiagram, add_robot, make_act
from geodrake.model.simulation.terms import DrivenPlant
from geodrake.model.stated_terms import stated_effects
from geodrake.robot.arrangement import base_joints, moving_joints
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.files import Given
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.joints import Tie, joint_names
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import LoadedPlant, effort_limits, load_plant, set_inertial_parameters
from geodrake.robot.regressor import body_regressor, inverse_dynamics
from geodrake.robot.repairs import TOLERANCE, Repair
from geodrake.robot.robot_instance import RobotInstance
from geodrake.robot.transmission.loop import LoopTransmission
from geodrake.robot.transmission.schema import Drive, Followers

_STATES, _TOLERANCE = 3, 1e-9  # random states for the comparison of MJCFs; relative tolerance

LARGEST_REGRESSOR = 10_000_000
"""Most entries of a regressor in memory at once."""


@dataclass(frozen=True, eq=False)
class RobotModel(Short):
    """A robot with its effects and parameters: effort needed = Y_rb φ + Σ_e Y_e μ_e.

    Attributes:
        plant: Finalized MultibodyPlant of the rigid bodies alone, inertias as in its file, closed
            loops open; `create_context` has the model's.
        floating: Whether free roots float instead of being welded to the world.
        phi: (nb, 10) inertial parameters, without those of fitted payloads.
        information: (p, p) information matrix (inverse covariance) of the inertial parameters and
            then of all effects' parameters; None if the model was never fitted.
        effort_noise: (nv,) RMS of the held-out effort residual of the fit, N·m or N; None if the
            model was never fitted.
        fitted_to: Fingerprints of the logs that the model was fitted to.
        bandwidths: Fingerprint of a log -> bandwidths of efforts and of the motion, Hz, in the last
            fit to it.
        fading_speed: (nv,) speed below which dry friction fades, rad/s or m/s; 0 where no fading
            was observed, None if at no joint.
        held: Joint of the file that is fixed -> its position, rad or m.
        followers: Joint of the plant that follows another one -> its coupling, by scoped names.
        transmission: Drives of joints, including closed loops; joints without a drive are their own
            actuators. The model's q, v, efforts and effects are at the actuators.
        effort_signals: Conversions to efforts, for joints whose logs have currents, voltages or
            commands instead.
        known_joints: Names of the joints that logs may have: the model's, fixed and following ones.
        motorless: Joints without a motor, according to the logs with which the model was opened.
        repairs: Sentences on elements of the file that were changed or ignored, such as unphysical
            inertias.
        left_out: Sentences on ignored elements of the file that affect efforts.
        thin: Bodies of the file without volume, such as point masses, and their parameters in fits.
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
    followers: Mapping[str, Tie] = field(default_factory=dict)
    known_joints: tuple[str, ...] = ()
    transmission: tuple[Drive, ...] = ()
    effort_signals: tuple[EffortSignal, ...] = ()
    motorless: tuple[str, ...] = ()
    repairs: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    thin: tuple[Repair, ...] = ()

    @cached_property
    def tree(self) -> KinematicTree:
        """Return the plant's kinematics for the model's motion."""
        moves = self.followers or self.transmission
        return self.joint_tree.driven(self.coordinates) if moves else self.joint_tree

    @cached_property
    def joint_tree(self) -> KinematicTree:
        """Return the plant's kinematics for the motion of all its joints."""
        return KinematicTree.from_plant(self.plant)

    @cached_property
    def coordinates(self) -> RobotCoordinates:
        """Return the map to all joints of the plant; raise ModelError for unsuitable drives."""
        return RobotCoordinates.of(self.plant, self.followers, self.transmission)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the nv velocities: joints or their actuators."""
        return self.coordinates.names

    @cached_property
    def joints_behind(self) -> tuple[str, ...]:
        """Return names of joints in loops or behind the transmission, where effects may act."""
        return tuple(self.coordinates.behind)

    def plant_positions(self, q: Array) -> Array:
        """Return the plant's positions for those of the model (N, nq)."""
        return self.coordinates.joint_positions(q)

    def driving(
        self,
        plant: MultibodyPlant,
        sign_width: Array,
        log: str | None = None,
        temperatures: Temperatures | None = None,
    ) -> DrivenPlant | None:
        """Return a plant's motion in the model's coordinates; None if they are the plant's own.

        Args:
            sign_width: (nv,) speeds below which dry friction fades, rad/s or m/s.
            log: Name of the simulated log, in which the model's contacts act.
            temperatures: Temperatures of the joints during that log.

        Raises:
            ModelError: An effect makes a joint elastic.
        """
        if not (self.followers or self.transmission):
            return None
        return DrivenPlant(self, plant, sign_width, log, temperatures)

    @cached_property
    def position_limits(self) -> tuple[Array, Array]:
        """Return lower and upper limits (nq,) of the positions, rad or m."""
        plant = self.plant
        limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        return self.coordinates.positions_between(*limits)

    @cached_property
    def velocity_limits(self) -> Array:
        """Return the largest speeds (nv,), rad/s or m/s; infinite without a limit."""
        lower, upper = self.plant.GetVelocityLowerLimits(), self.plant.GetVelocityUpperLimits()
        return self.coordinates.rates(np.minimum(upper, -lower), self.position_limits)

    @cached_property
    def acceleration_limits(self) -> Array:
        """Return the largest accelerations (nv,), rad/s² or m/s²; infinite without a limit."""
        lower, upper = self.plant.GetAccelerationLowerLimits, self.plant.GetAccelerationUpperLimits
        return self.coordinates.rates(np.minimum(upper(), -lower()), self.position_limits)

    @cached_property
    def effort_limits(self) -> Array:
        """Return the largest efforts (nv,) in the file, N·m or N; infinite without a limit."""
        return self.coordinates.effort_limits(effort_limits(self.plant), self.position_limits)

    @property
    def known_effort_limits(self) -> Array:
        """Return the largest efforts (nv,), N·m or N: of the file, or smaller ones from logs."""
        signals = (signal_of(self.effort_signals, joint) for joint in self.joints)
        of_logs = np.array([signal.limit if signal else np.inf for signal in signals])
        of_file = self.effort_limits
        least = np.minimum(np.where(of_file > 0.0, of_file, np.inf), of_logs)
        return np.where(np.isfinite(of_logs), least, of_file)

    @cached_property
    def bodies(self) -> tuple[str, ...]:
        """Return the names of the nb bodies; bodies welded together count as one."""
        return self.tree.bodies

    @cached_property
    def load_bodies(self) -> tuple[str, ...]:
        """Return names of bodies that may carry loads: last ones, and those where limbs branch."""
        mobilizers = self.joint_tree.mobilizers
        limbs = [0] * len(mobilizers)
        for index in range(len(mobilizers) - 1, -1, -1):  # outboard first
            mobilizer = mobilizers[index]
            if mobilizer.parent >= 0 and (mobilizer.body >= 0 or limbs[index]):
                limbs[mobilizer.parent] += 1
        trunks = {joints[-1].child_body().name() for joints in base_joints(self.plant)}
        bodies = [
            (self.bodies[m.body], count)
            for m, count in zip(mobilizers, limbs, strict=True)
            if m.body >= 0
        ]
        return tuple(name for name, count in bodies if count != 1 or name in trunks)

    @cached_property
    def joint_pairs(self) -> tuple[tuple[str, str], ...]:
        """Return pairs of consecutive single-degree joints of the same type along the tree."""
        mobilizers, pairs = self.joint_tree.mobilizers, []
        leaders = self.coordinates.leaders
        for mobilizer in mobilizers:
            if mobilizer.parent < 0:
                continue
            starts = mobilizers[mobilizer.parent].velocities.start, mobilizer.velocities.start
            indices = (self.coordinates.standing.get(leaders.get(index, index)) for index in starts)
            pair = [index for index in dict.fromkeys(indices) if index in self.single_places]
            if len(pair) == 2 and self._types[pair[0]] == self._types[pair[1]]:
                pairs.append((self.joints[pair[0]], self.joints[pair[1]]))
        return tuple(pairs)

    @property
    def delays(self) -> Array:
        """Return the model's delays (nv,) of measured efforts, s."""
        return delays_of([fitted.effect for fitted in self.effects], self.joints)

    @cached_property
    def total_phi(self) -> Array:
        """Return (nb, 10) inertial parameters, payloads included."""
        phi = self.phi.copy()
        for fitted in self.effects:
            if fitted.effect.role is Role.BODY:
                phi[self.bodies.index(fitted.effect.where[0])] += fitted.parameters
        return phi

    @cached_property
    def with_volume(self) -> RobotModel:
        """Return the model from which fits start, with volume in thin bodies."""
        phi = self.phi.copy()
        for repair in self.thin:
            at = self.bodies.index(repair.body)
            if not is_physical(phi[at], tolerance=TOLERANCE):  # and no fit has changed it
                phi[at] = repair.after
        return replace(self, phi=phi, thin=()) if self.thin else self

    def sign_widths(self, least: ArrayLike) -> Array:
        """Return (nv,) speeds below which dry friction fades, at least `least`, rad/s or m/s."""
        width = one_or_each(least, "a sign width", len(self.joints))
        return np.maximum(width, 0.0 if self.fading_speed is None else self.fading_speed)

    @cached_property
    def base_joints(self) -> tuple[str, ...]:
        """Return the six joints of each free base, in the order of `geodrake.robot.arrangement`."""
        bases = base_joints(self.plant)
        return tuple(joint.name() for joints in bases for joint in joints)

    @property
    def bodies_at_rest(self) -> RobotBodies:
        """Return the bodies, payloads included, without a configuration."""
        return RobotBodies(self.tree, np.zeros((0, self.tree.num_positions)), self.total_phi)

    def motion(
        self, motion: Motion, *, sign_width: ArrayLike = 0.0, load: Array | None = None
    ) -> RobotMotion:
        """Return a motion by joint, as effects use it, with the rigid bodies' effort as load.

        Args:
            load: (N, nv) effort of the rigid bodies; computed if None.
        """
        samples = instance(motion, "motion", Motion).q, motion.v, motion.vd
        if load is not None:
            load = real_array(load, "load", motion.v.shape)
        else:
            load = inverse_dynamics(self.tree, *samples, self.total_phi)
        seen = RobotMotion(
            self.joints,
            self._by_velocity(motion.q),
            motion.v,
            motion.vd,
            load,
            self.sign_widths(sign_width),
            lambda body: body_regressor(self.tree, *samples, self.bodies.index(body)),
            RobotBodies(self.tree, motion.q, self.total_phi),
            motion.time,
        )
        if motion.before is not None:
            seen = replace(seen, before=self._by_velocity(motion.before))
        if motion.temperature is not None:
            seen = replace(seen, temperature=motion.temperature)
        return self.with_effort(seen)

    def with_effort(self, seen: RobotMotion) -> RobotMotion:
        """Return the motion with the model's effort (N, nv), N·m or N, computed on demand."""
        return replace(seen, effort=cache(lambda: self.unscaled_effort(seen)))

    def _by_velocity(self, q: Array) -> Array:
        """Return positions (N, nv) by velocity for q (N, nq); NaN at joints of several degrees."""
        found = np.full((len(q), len(self.joints)), np.nan)
        found[:, self.single_places] = q[:, self.single_places]
        return found

    def effort(self, motion: Motion, *, sign_width: ArrayLike = 0.0) -> Array:
        """Return the effort (N, nv) of N samples in Drake's order, N·m or N, without delays.

        Dry friction fades below the speed `sign_width`, rad/s or m/s, one for all or (nv,).
        """
        size = max(1, LARGEST_REGRESSOR // (len(self.joints) * self.phi.size))
        effort = np.empty(instance(motion, "motion", Motion).v.shape)
        if motion.time is not None and motion.before is None:
            motion = replace(motion, before=motion.q[:0])
        for start in range(0, len(motion), size):
            part = slice(start, start + size)
            seen = self.motion(motion[part], sign_width=sign_width)
            effort[part] = self.unscaled_effort(seen)
            for fitted in self.effects:
                if fitted.effect.role is Role.SCALE:
                    effort[part] += fitted.effect.effort(seen, fitted.parameters)
        return effort

    def unscaled_effort(self, seen: RobotMotion) -> Array:
        """Return the effort (N, nv) of the bodies and all effects but scales."""
        columns, mu = self._unscaled_effects
        return seen.load + columns.effort(seen, mu)

    @cached_property
    def _unscaled_effects(self) -> tuple[EffectColumns, Array]:
        """Return all effects but payloads and scales, and their parameters."""
        some = [f for f in self.effects if f.effect.role not in (Role.BODY, Role.SCALE)]
        columns = EffectColumns(self.joints, tuple(fitted.effect for fitted in some))
        return columns, np.concatenate([np.zeros(0), *(fitted.parameters for fitted in some)])

    def positions(self, by_joint: Array) -> Array:
        """Return positions (N, nq) in Drake's order from those of single-degree joints (N, nv)."""
        by_joint = real_array(by_joint, "by_joint", ("N", len(self.joints)))
        if len(self.single_places) < len(self.joints):
            several = [n for i, n in enumerate(self.joints) if i not in self.single_places]
            raise ArgumentError(
                f"Logs have one position for each joint, but {', '.join(several)} belong to "
                "joints of several degrees of freedom.",
                advice="Weld the base, or use the regressors from Python.",
            )
        return by_joint.copy()

    @cached_property
    def _types(self) -> dict[int, str]:
        """Return velocity index -> Drake's name of the joint's type."""
        standing, every = self.coordinates.standing, moving_joints(self.plant)
        starts = {int(joint.velocity_start()): joint.type_name() for joint in every}
        found = {standing[at]: kind for at, kind in starts.items() if at in standing}
        for place in self.coordinates.places:
            slides = place.drive.slides
            for at, sliding in zip(place.actuators.tolist(), slides or (), strict=False):
                found[at] = "prismatic" if sliding else "revolute"
        return found

    def default_position(self, joint: str) -> float:
        """Return the default position of a joint of one degree of freedom, rad or m."""
        q = self.plant.GetPositions(self.plant.CreateDefaultContext())
        return float(self.coordinates.nearest(q[None])[0, self.joints.index(joint)])

    def limits_of(self, joint: str) -> tuple[float, float]:
        """Return the position limits of a joint of one degree of freedom, rad or m."""
        (lower, upper), at = self.position_limits, self.joints.index(joint)
        return float(lower[at]), float(upper[at])

    @cached_property
    def single_joints(self) -> tuple[str, ...]:
        """Return the names of the joints of one degree of freedom."""
        return tuple(self.joints[i] for i in self.single_places)

    @cached_property
    def sliding_joints(self) -> tuple[str, ...]:
        """Return the names of the prismatic joints, with positions in m and efforts in N."""
        starts = self.single_places
        sliding = tuple(self.joints[i] for i in starts if self._types[i] == "prismatic")
        if not self.joints_behind:
            return sliding
        names, slides = joint_names(self.plant), moving_joints(self.plant)
        at = (int(j.velocity_start()) for j in slides if j.type_name() == "prismatic")
        loops = (d.map for d in self.transmission if isinstance(d.map, LoopTransmission))
        closing = (loop.joints[k] for loop in loops for k in loop.cut if loop.slides[k])
        return (*sliding, *(names[k] for k in at if names[k] in self.joints_behind), *closing)

    @cached_property
    def single_places(self) -> list[int]:
        """Return the indices in q and v of the joints of one degree of freedom."""
        return self.coordinates.single_places

    def create_context(self) -> Context:
        """Return a default Context of the plant with the model's inertias, payloads included.

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
        """Add the model to a Drake diagram: inertias, payloads, effects and delays, each once.

            builder = DiagramBuilder()
            robot = model.add_to_builder(builder)
            builder.Connect(controller.get_output_port(), robot.effort)
            builder.Connect(robot.state, controller.get_input_port())

        Every Context of the diagram has the model's inertias by default. Connect efforts to the
        port `effort`, not to the plant's own ports, which bypass the effects. Delays shift
        `logged_effort`; a negative delay, of efforts logged ahead of time, delays the acting
        efforts instead. Hidden states of effects start at zero (`EffectForce.set_hidden_states`).
        Elastic joints have motors and links, and `state` is that of the motors. Parameters belong
        to the Context (`RobotInDiagram.set_parameters`). The diagram can be cloned, converted to
        AutoDiffXd and linearized; see `EffectForce`.

        With a transmission or following joints, state and efforts are those of actuators and
        leaders, parameters are fixed, and elastic joints are refused.

        Args:
            time_step: Time step of the plant, s; 0 for a continuous one.
            scene_graph: A SceneGraph of the builder for the robot's visual geometry, or True for a
                new one; a MeshcatVisualizer may be added to it.
            name: Name of the plant; several robots in a diagram need different ones.
            sign_width: Lower bound of the speed below which dry friction fades, rad/s or m/s; one
                for all velocities or (nv,). See `EffectForce` for its effect on step sizes.
            log: Name of the simulated log, in which the model's contacts act.
        """
        instance(builder, "builder", DiagramBuilder)
        if scene_graph is not None:
            instance(scene_graph, "scene_graph", (SceneGraph, bool))
        step, name = number(time_step, "time_step", lower=0.0), instance(name, "name", str)
        width = self.sign_widths(sign_width)
        return add_robot(self, builder, step, scene_graph, name=name, sign_width=width, log=log)

    def add_to_scene(
        self,
        builder: DiagramBuilder,
        robot: RobotInstance,
        *,
        sign_width: ArrayLike = 1e-2,
        log: str | None = None,
    ) -> RobotInDiagram:
        """Make a robot in a larger plant move like this model: inertias, effects and delays.

            robot = model.add_to_scene(builder, RobotInstance(plant, "arm"))
            builder.Connect(controller.get_output_port(), robot.effort)
            …
            robot.set_inertias(root_context)

        Unlike with `add_to_builder`, the plant exists already and may contain a table, objects,
        other robots and contact. The model's inertias are set in a Context: call `set_inertias`
        before a simulation. Efforts are generalized forces, so the robot's actuators stay free.

        Args:
            robot: The robot in the plant, with the joint and body names of the model's file.

        Raises:
            ArgumentError: The robot differs from the model's, its base is tilted relative to the
                model's, or its joints have damping or rotor inertia, which are effects.
            ModelError: Joints of the model follow others, or are behind a transmission.
        """
        instance(builder, "builder", DiagramBuilder)
        if self.followers or self.transmission:
            aside = [joint.rpartition("::")[2] for joint in self.followers]
            aside += [name for drive in self.transmission for name in drive.joints]
            raise ModelError(
                "A plant with other robots cannot have joints that follow others or are "
                f"behind a transmission, as {', '.join(aside)} are.",
                advice="Use model.add_to_builder, or fix them: geodrake.model.holding.",
            )
        place = instance(robot, "robot", RobotInstance)
        sees_world = any(isinstance(fitted.effect, RobotEffect) for fitted in self.effects)
        place.check_base(self.joint_tree, self.joints, turned=sees_world)
        name = "plant" if place.name is None else place.name
        width = self.sign_widths(sign_width)
        return make_act(self, builder, place, name=name, sign_width=width, log=log)

    def with_fit(
        self,
        phi: Array,
        effects: Sequence[FittedEffect],
        *,
        information: Array,
        effort_noise: Array,
    ) -> RobotModel:
        """Return the model with fitted parameters."""
        effects = instances(effects, "effects", FittedEffect)
        p = self.phi.size + sum(len(fitted.parameters) for fitted in effects)
        phi = real_array(phi, "phi", self.phi.shape)
        information = real_array(information, "information", (p, p), finite=False)
        if not np.isfinite(information).all():
            raise ArgumentError("information must be finite.")
        noise = real_array(effort_noise, "effort_noise", (len(self.joints),))
        return replace(self, phi=phi, effects=effects, information=information, effort_noise=noise)


def from_loaded_plant(
    loaded: LoadedPlant, *, floating: bool, transmission: Sequence[Drive] = ()
) -> RobotModel:
    """Return the model of a plant, with damping, friction and rotor inertia as effects."""
    drives = tuple(d for d in instances(transmission, "transmission", Drive) if not d.is_loop)
    loops = tuple(Drive.of_loop(loop) for loop in loaded.loops if loop.actuators)
    for loop in loops:
        if both := {joint for drive in drives for joint in drive.joints}.intersection(loop.joints):
            raise ModelError(
                f"The transmission moves {', '.join(sorted(both))}, but so does a closed "
                f"loop of {loaded.path.name}: {', '.join(loop.joints)}.",
                advice="Log the joints of the loop, and remove this part of the transmission.",
            )
    # Older saved models list the file's followers in their transmission.
    tied = {joint.rpartition("::")[2] for joint in loaded.followers}
    of_file = [isinstance(d.statement, Followers) and tied.issuperset(d.joints[1:]) for d in drives]
    drives = tuple(drive for drive, again in zip(drives, of_file, strict=True) if not again)
    notes, left_out = list[str](), loaded.left_out
    bare = RobotModel(
        loaded.plant,
        loaded.path,
        floating,
        inertial_parameters(loaded.plant),
        held=loaded.held,
        given=loaded.given,
        followers=loaded.followers,
        transmission=(*drives, *loops),
        known_joints=loaded.joints,
        thin=loaded.thin,
    )
    stated = stated_effects(loaded, bare.coordinates)
    effects = tuple(stated.fitted())
    notes += stated.notes
    left_out += tuple(stated.left_out)
    if loaded.geared and not transmission:
        notes.append(
            f"The file has transmissions of {', '.join(loaded.geared)}; positions and "
            "efforts in logs are assumed to be at the joints (for motors, --transmission "
            "file)."
        )
    if drives:
        words = "; ".join(f"{', '.join(d.actuators)} for {', '.join(d.joints)}" for d in drives)
        notes.append(f"Logs, efforts and effects are at the actuators: {words}.")
    model = replace(bare, effects=effects)
    if loaded.mjcf is not None:
        _check_against_mujoco(model, loaded.mjcf, loaded)
    return replace(
        model,
        notes=(*loaded.changes, *left_out, *loaded.notes, *notes),
        repairs=(*loaded.changes, *left_out),
        left_out=left_out,
        known_joints=tuple(dict.fromkeys((*loaded.joints, *bare.joints))),
    )


def _check_against_mujoco(model: RobotModel, text: MjcfText, loaded: LoadedPlant) -> None:
    """Raise if efforts in random states differ from MuJoCo's with the same file.

    Ignored elements are excluded, and so are dry friction, limits and contacts, which are soft in
    MuJoCo. Free bodies rest.
    """
    rng, m = np.random.default_rng(0), text.compiled
    held = {joint.rpartition("::")[2]: position for joint, position in loaded.places.items()}
    if not {m.joint(k).name for k in range(m.njnt)}.issuperset(held):
        return  # part of a free base is fixed
    q = model.coordinates.inside(rng.uniform(-1.0, 1.0, (_STATES, len(model.joints))))
    v, vd = rng.uniform(-2.0, 2.0, (2, _STATES, len(model.joints)))
    states = q, v, vd
    check_loops(text, model.plant, held, *model.coordinates.tree_samples(*states)[:2])
    if text.path != model.path or (text.terms.set_aside and loaded.changes):
        return  # a repaired body differs on purpose
    comparison, place, difference = (
        with_mujoco(model, text.reference, held, states),
        "all joints",
        "",
    )
    if not isinstance(comparison, str):
        _, theirs, ours = comparison
        kept = [k for k, joint in enumerate(model.joints) if joint not in model.base_joints]
        errors = np.abs(ours - theirs)[:, kept].max(axis=0, initial=0.0)
        largest = float(np.abs(theirs).max(initial=0.0))
        if errors.max(initial=0.0) <= _TOLERANCE * max(largest, 1e-12):
            return
        joint = model.joints[kept[int(np.argmax(errors))]]
        place = f"joint {joint}, or what it moves,"
        difference = f": efforts differ by up to {errors.max():.3g}, of {largest:.3g}"
    raise ModelError(
        f"{model.path}: geodrake reads {place} differently from MuJoCo{difference}.", advice=BUG
    )


def read_again(model: RobotModel) -> RobotModel:
    """Return the model of the original file, without fits and additions."""
    return load_description(
        model.path,
        floating=model.floating,
        held=model.held,
        given=model.given,
        transmission=model.transmission,
    )


def is_of_file(model: RobotModel) -> bool:
    """Return whether a model has exactly the effects of its file."""

    def stated(model: RobotModel) -> list[tuple[Effect, list[float]]]:
        return [(fitted.effect, fitted.parameters.tolist()) for fitted in model.effects]

    return stated(model) == stated(read_again(model))


def load_description(
    path: str | Path,
    *,
    floating: bool = False,
    held: Mapping[str, float] | None = None,
    given: Given | None = None,
    transmission: Sequence[Drive] = (),
) -> RobotModel:
    """Return the model of a URDF, SDF, MJCF or Drake directives file."""
    loaded = load_plant(path, floating=floating, held=held, given=given)
    return from_loaded_plant(loaded, floating=floating, transmission=transmission)
