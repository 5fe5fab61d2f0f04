"""A robot as a model instance of a larger plant: joints, ports, base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    ForceElementIndex,
    Joint,
    JointActuator,
    ModelInstanceIndex,
    PrismaticSpring,
    RevoluteSpring,
)
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import Adder, MatrixGain

from geodrake.boundary.arguments import instance, instances, real_array, typed
from geodrake.errors import ArgumentError
from geodrake.inertia import Array, inertial_parameters
from geodrake.inertia.bodies import body_names, check_context, check_plant, lumped_bodies
from geodrake.robot.joints import joint_names
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import set_lump_inertias
from geodrake.robot.regressor import body_poses

_SAME_GRAVITY = 1e-6  # m/s²
_SAME_ROTATION = 1e-6
_WELD_ALIKE = (
    "Weld both bases alike: load the model from a Drake directives file that welds the "
    "robot as the plant does."
)


@dataclass(frozen=True, eq=False)
class RobotPorts:
    """Ports of a robot for its controller.

    Attributes:
        joints: Names of the n joints, in the order of all ports.
        state: Output (2 n): positions, then velocities.
        acceleration: Output (n): accelerations, if available.
        effort: Input (n) for efforts, N·m or N.
    """

    joints: tuple[str, ...]
    state: OutputPort
    acceleration: OutputPort | None
    effort: InputPort


@dataclass(frozen=True, eq=False)
class RobotInstance:
    """A robot in a plant: one model instance, or all moving bodies.

        RobotInstance(plant, "arm")

    The plant may also contain tables, free objects and other robots.

    Attributes:
        name: Name of the model instance; None for all joints of the plant.

    Raises:
        ArgumentError: The plant has no such model instance, or it has no moving joint.
        ModelError: The plant is not finalized.
    """

    plant: MultibodyPlant
    name: str | None = None

    def __post_init__(self) -> None:
        check_plant(self.plant)
        if self.name is None:
            return
        if not self.plant.HasModelInstanceNamed(instance(self.name, "name", str)):
            indices = map(ModelInstanceIndex, range(2, self.plant.num_model_instances()))
            names = ", ".join(map(self.plant.GetModelInstanceName, indices))
            raise ArgumentError(
                f"The plant has no model instance {self.name!r}.", advice=f"It has {names}."
            )
        if not self._moving:
            raise ArgumentError(
                f"Model instance {self.name!r} has no moving joint.",
                advice="Use the model instance of the robot.",
            )

    @property
    def _which(self) -> tuple[ModelInstanceIndex, ...]:
        """Return the model instance, if any, as an argument of the plant's methods."""
        return () if self.name is None else (self.plant.GetModelInstanceByName(self.name),)

    @cached_property
    def velocities(self) -> NDArray[np.intp]:
        """Return the indices (n,) of the robot's velocities in the plant's v."""
        starts = [j.velocity_start() + k for j in self._moving for k in range(j.num_velocities())]
        return np.array(starts, int)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the robot's velocities, without its name as a prefix."""
        return tuple(self.velocity_names[k] for k in self.velocities)

    @cached_property
    def velocity_names(self) -> tuple[str, ...]:
        """Return the names of the plant's velocities, the robot's without its name as a prefix."""
        names = joint_names(self.plant)
        if self.name is None:
            return names
        short = self.plant.GetVelocityNames(
            add_model_instance_prefix=False, always_add_suffix=False
        )
        own = set(self.velocities.tolist())
        return tuple(short[k] if k in own else name for k, name in enumerate(names))

    @cached_property
    def body_names(self) -> Mapping[str, str]:
        """Return body name in the plant -> name in the robot."""
        names = body_names(self.plant)
        own = [i for which in self._which for i in self.plant.GetBodyIndices(which)]
        short = {names[int(index)]: self.plant.get_body(index).name() for index in own}
        return {name: short.get(name, name) for name in names}

    def positions(self, joints: Sequence[str] | None = None) -> NDArray[np.intp]:
        """Return indices (n,) in the plant's q of joints, by default all in Drake's order."""
        places = {}
        for joint in self._moving:
            if joint.num_velocities() != 1 or joint.num_positions() != 1:
                raise ArgumentError(
                    f"Joint {joint.name()} of {self._words} has {joint.num_velocities()} "
                    "degrees of freedom; controllers and logs need one.",
                    advice="Weld the robot's base (WeldFrames, add_weld) before Finalize.",
                )
            places[self.velocity_names[joint.velocity_start()]] = int(joint.position_start())
        return np.array([places[joint] for joint in joints or self.joints], int)

    def order(self, joints: Sequence[str]) -> NDArray[np.intp]:
        """Return the indices (n,) of joints in the robot's order."""
        if sorted(joints) != sorted(self.joints):
            more = "" if self.name else ", or name the robot's: RobotInstance(plant, name)"
            raise ArgumentError(
                f"T{self._words[1:]} moves {', '.join(self.joints)}, but the controller "
                f"{', '.join(joints)}.",
                advice="Make both from the same file, and weld the plant's base (WeldFrames) "
                "before Finalize; or use the plant of load_model(file), with following "
                f"joints fixed (lock=…){more}.",
            )
        return np.array([self.joints.index(joint) for joint in joints], int)

    def ports(self, builder: DiagramBuilder, joints: Sequence[str]) -> RobotPorts:
        """Return the robot's ports, with joints in a given order.

        Efforts are connected to the robot's actuators, or to generalized forces if it has none.
        """
        order, plant, which = self.order(joints), self.plant, self._which
        if self._actuators:
            effort = builder.AddSystem(MatrixGain(self._to_actuators(joints)))
            builder.Connect(effort.get_output_port(), plant.get_actuation_input_port(*which))
        else:
            effort = builder.AddSystem(MatrixGain(self.to_plant(joints)))
            add_generalized_force(builder, plant, effort.get_output_port())
        return RobotPorts(
            tuple(joints),
            self.state_port(builder, joints),
            selected(
                builder, plant.get_generalized_acceleration_output_port(), self.velocities[order]
            ),
            effort.get_input_port(),
        )

    def state_port(self, builder: DiagramBuilder, joints: Sequence[str]) -> OutputPort:
        """Return an output (2 n) of positions, then velocities of the robot's joints."""
        at_v = self.plant.num_positions() + self.velocities[self.order(joints)]
        places = np.concatenate([self.positions(joints), at_v])
        return selected(builder, self.plant.get_state_output_port(), places)

    def to_plant(self, joints: Sequence[str]) -> Array:
        """Return the matrix (nv, n) from efforts at joints to the plant's generalized forces."""
        matrix = np.zeros((self.plant.num_velocities(), len(joints)))
        matrix[self.velocities[self.order(joints)], np.arange(len(joints))] = 1.0
        return matrix

    def set_state(self, context: Context, joints: Sequence[str], state: ArrayLike) -> None:
        """Set the robot's positions, then velocities (2 n,) in a Context of its plant."""
        check_context(self.plant, context)
        joints = instances(joints, "joints", str)
        order = self.order(joints)
        state = real_array(state, "state", (2 * len(order),))
        q, v = self.plant.GetPositions(context), self.plant.GetVelocities(context)
        q[self.positions(joints)] = state[: len(order)]
        v[self.velocities[order]] = state[len(order) :]
        self.plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))

    def set_inertial_parameters(self, context: Context, phi: ArrayLike) -> None:
        """Set the inertial parameters (nb, 10) of the robot's bodies in a Context of its plant.

        Their order is that of `lumped_bodies` in a plant of the robot alone. Links of other model
        instances that are welded to a body, such as a gripper, keep their inertias.
        """
        check_context(self.plant, context)
        bodies, lumps = self.plant.get_body, lumped_bodies(self.plant)
        is_whole = not self._which
        groups = (
            [m for m in x.members if is_whole or bodies(m.index).model_instance() in self._which]
            for x in lumps
        )
        set_lump_inertias(self.plant, context, [members for members in groups if members], phi)

    def plant_parameters(self, phi: ArrayLike) -> Array:
        """Return the plant's parameters (nb, 10) with new ones of the robot."""
        context = self.plant.CreateDefaultContext()
        self.set_inertial_parameters(context, phi)
        return inertial_parameters(self.plant, context)

    @property
    def stated_terms(self) -> tuple[str, ...]:
        """Return which of damping and rotor inertia the plant has at the robot's joints."""
        rotors = [actuator.default_reflected_inertia() for actuator in self._actuators]
        damping = [np.any(joint.default_damping_vector()) for joint in self._moving]
        terms = {"Damping": damping, "rotor inertia": rotors}
        return tuple(name for name, values in terms.items() if any(values))

    @property
    def springs(self) -> list[tuple[str, float, float]]:
        """Return joint, stiffness and rest position of springs in the plant at the robot's joints.

        Drake cannot remove them.
        """
        names = {joint.index(): self._name(joint) for joint in self._moving}
        count = self.plant.num_force_elements()
        springs_of_robot = list[tuple[str, float, float]]()
        for spring in map(self.plant.get_force_element, map(ForceElementIndex, range(count))):
            match spring:
                case RevoluteSpring():
                    numbers = spring.default_stiffness(), spring.default_nominal_angle()
                case PrismaticSpring():
                    numbers = spring.stiffness(), spring.nominal_position()
                case _:
                    continue
            if spring.joint().index() in names:
                springs_of_robot.append((names[spring.joint().index()], *numbers))
        return springs_of_robot

    def check_base(
        self, tree: KinematicTree, joints: Sequence[str], *, turned: bool = False
    ) -> None:
        """Raise unless gravity acts on the robot's base as in a model of the robot.

        Efforts do not depend on the base's position and rotation about the vertical. With `turned`,
        the orientation must be the same, for effects in world axes.
        """
        plant = self.plant
        self.order(joints)
        context = plant.CreateDefaultContext()
        q = plant.GetPositions(context)
        q[self.positions()] = 0.0
        plant.SetPositions(context, q)
        poses = body_poses(tree, np.zeros((1, tree.num_positions)))[0]
        standing = {int(body.index()) for body in plant.GetBodiesWeldedTo(plant.world_body())}
        for mobilizer in tree.mobilizers:
            name = joints[mobilizer.velocities.start]
            if mobilizer.parent >= 0:
                continue
            joint = next(j for j in self._moving if self._name(j) == name)
            ends = (joint.parent_body(), joint.child_body())
            outer = [body for body in ends if int(body.index()) not in standing]
            if len(outer) > 1:
                raise ArgumentError(
                    f"The base of {self._words} moves: its joint {name} connects "
                    f"{ends[0].name()} and {ends[1].name()}, and is fixed in the model.",
                    advice="Weld the base, or use a model of all moving bodies.",
                )
            R_WB = outer[0].EvalPoseInWorld(context).rotation().matrix()
            has_gravity = plant.is_gravity_enabled(outer[0].model_instance())
            model_R_WB = poses[mobilizer.body, :3, :3]
            here = R_WB.T @ plant.gravity_field().gravity_vector() * has_gravity
            expected = model_R_WB.T @ tree.gravity * mobilizer.gravity
            if turned and np.abs(R_WB - model_R_WB).max() > _SAME_ROTATION:
                raise ArgumentError(
                    f"The base of {self._words} has another orientation than the model's, and the "
                    "model has an effect in world axes.",
                    advice=_WELD_ALIKE,
                )
            if not np.allclose(here, expected, rtol=0.0, atol=_SAME_GRAVITY):
                raise ArgumentError(
                    f"The base of {self._words} has another inclination than the model's: at "
                    f"zero, gravity on {outer[0].name()} is {np.round(here, 3).tolist()} "
                    f"m/s² in the plant and {np.round(expected, 3).tolist()} m/s² in the model.",
                    advice=_WELD_ALIKE,
                )

    def _name(self, joint: Joint) -> str:
        return self.velocity_names[joint.velocity_start()]

    @property
    def _words(self) -> str:
        return "the plant" if self.name is None else f"the model instance {self.name!r}"

    @cached_property
    def _moving(self) -> list[Joint]:
        """Return the moving joints, in the order of their velocities."""
        joints = map(self.plant.get_joint, self.plant.GetJointIndices(*self._which))
        moving = [joint for joint in joints if joint.num_velocities()]
        return sorted(moving, key=lambda joint: int(joint.velocity_start()))

    @cached_property
    def _actuators(self) -> list[JointActuator]:
        indices = self.plant.GetJointActuatorIndices(*self._which)
        return list(map(self.plant.get_joint_actuator, indices))

    def _to_actuators(self, joints: Sequence[str]) -> Array:
        """Return the matrix (n, n) from efforts at joints to the robot's actuators."""
        at = [joints.index(self._name(actuator.joint())) for actuator in self._actuators]
        without = [joint for k, joint in enumerate(joints) if k not in at]
        if without or len(at) != len(joints):
            raise ArgumentError(
                f"An adaptive loop needs one actuator at every joint, or none; {len(at)} are "
                f"at {len(joints)} joints, none at {', '.join(without) or '-'}.",
                advice="Use AddJointActuator before Finalize.",
            )
        return np.eye(len(joints))[at]


@typed
def take_out_stated(plant: MultibodyPlant, name: str) -> None:
    """Remove damping and rotor inertia of a robot, which are effects of a model.

    Springs at its joints stay; a model added to the plant takes them into account.
    """
    if plant.is_finalized() or not plant.HasModelInstanceNamed(name):
        raise ArgumentError(
            f"The plant is finalized, or has no model instance {name!r}.",
            advice="Call this with the name of a robot in the plant, before plant.Finalize().",
        )
    index = plant.GetModelInstanceByName(name)
    for joint_index in plant.GetJointIndices(index):
        joint = plant.get_mutable_joint(joint_index)
        joint.set_default_damping_vector(np.zeros(joint.num_velocities()))
    for actuator in map(plant.get_mutable_joint_actuator, plant.GetJointActuatorIndices()):
        if actuator.model_instance() == index:
            actuator.set_default_rotor_inertia(0.0)


def add_generalized_force(
    builder: DiagramBuilder, plant: MultibodyPlant, force: OutputPort
) -> None:
    """Add a generalized force (nv), N·m or N, to the forces on a plant."""
    port = plant.get_applied_generalized_force_input_port()
    if builder.IsConnectedOrExported(port):
        place = (plant, port.get_index())
        if place not in builder.connection_map():
            raise ArgumentError(
                "The generalized forces of the plant are exported as an input of the diagram.",
                advice="Add robots before ExportInput, and sum forces in an Adder.",
            )
        system, index = builder.connection_map()[place]
        other = system.get_output_port(index)
        builder.Disconnect(other, port)
        total = builder.AddSystem(Adder(2, plant.num_velocities()))
        builder.Connect(other, total.get_input_port(0))
        builder.Connect(force, total.get_input_port(1))
        force = total.get_output_port()
    builder.Connect(force, port)


def selected(builder: DiagramBuilder, port: OutputPort, places: NDArray[np.intp]) -> OutputPort:
    """Return an output with selected values of a port."""
    if np.array_equal(places, np.arange(port.size())):
        return port
    gain = builder.AddSystem(MatrixGain(np.eye(port.size())[places]))
    builder.Connect(port, gain.get_input_port())
    return gain.get_output_port()
