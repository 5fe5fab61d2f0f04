"""The kinematic tree of a plant, as plain numbers for batched computations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, Joint, WeldJoint

from geodrake.boundary.showing import Short
from geodrake.compiling import contiguous
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.inertia.bodies import LumpedBody, is_frame, lumped_bodies
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.joints import joint_motions, joints_of
from geodrake.robot.recursion import Mobilizer, Samples, TreeRecords, records_of

_WORLD, _MASSLESS = -1, -2


@dataclass(frozen=True)
class KinematicTree(Short):
    """A plant's mobilizers, each after its parent, with sizes and gravity.

    Bodies are those of `lumped_bodies`, each in the frame of its representative. With a
    transmission, computations map their inputs by `joint_samples` and their results by
    `actuator_rows`:

        θ = T(q), θ̇ = J q̇, θ̈ = J q̈ + J̇ q̇, τ_q = Jᵀ τ_θ, Y_q = Jᵀ Y_θ    [Lee2019] Eq. (3.6.57)

    Attributes:
        num_positions: nq of the robot, or of the plant without `actuation`.
        num_velocities: nv, likewise.
        gravity: (3,) gravity in the world frame, m/s².
        actuation: Map from the robot's coordinates to the joints'; None for the identity.
    """

    mobilizers: tuple[Mobilizer, ...]
    bodies: tuple[str, ...]
    num_positions: int
    num_velocities: int
    gravity: Array
    actuation: RobotCoordinates | None = field(default=None, compare=False)

    @classmethod
    def from_plant(cls, plant: MultibodyPlant) -> KinematicTree:
        """Read the tree of a finalized plant, with its default parameters."""
        bodies = lumped_bodies(plant)
        gravity = [_has_gravity(plant, body) for body in bodies]
        last = {_WORLD: -1}  # every body reached so far: its mobilizer
        mobilizers: list[Mobilizer] = []
        for joint, inboard, outboard, X_PF, X_MB, sign in _edges(plant, bodies):
            is_frame = outboard <= _MASSLESS
            if inboard >= 0 and gravity[inboard] != gravity[outboard]:
                raise _partial_gravity(bodies[outboard].name)
            q, v = int(joint.position_start()), int(joint.velocity_start())
            motions = joint_motions(joint, sign)
            for step, motion in enumerate(motions, start=1):
                parent = last[inboard] if step == 1 else len(mobilizers) - 1
                is_last = step == len(motions)
                nq, nv = motion.translation.shape[1], motion.angular.shape[1]
                X_PM = X_PF if step == 1 else RigidTransform()
                X = X_MB if is_last else RigidTransform()
                R = X.rotation().matrix()
                mobilizers.append(
                    Mobilizer(
                        parent=parent,
                        body=outboard if is_last and not is_frame else _MASSLESS,
                        positions=slice(q, q + nq),
                        velocities=slice(v, v + nv),
                        dofs=(*(mobilizers[parent].dofs if parent >= 0 else ()), *range(v, v + nv)),
                        motion=motion.between(X_PM, R),
                        p_MoBo_B=R.T @ X.translation(),
                        gravity=is_frame or gravity[outboard],
                    )
                )
                q, v = q + nq, v + nv
            last[outboard] = len(mobilizers) - 1
        return cls(
            mobilizers=tuple(mobilizers),
            bodies=tuple(body.name for body in bodies),
            num_positions=plant.num_positions(),
            num_velocities=plant.num_velocities(),
            gravity=np.array(plant.gravity_field().gravity_vector()),
        )

    def driven(self, actuation: RobotCoordinates) -> KinematicTree:
        """Return the tree with a transmission."""
        size = len(actuation.names)
        return replace(self, actuation=actuation, num_positions=size, num_velocities=size)

    @cached_property
    def joints(self) -> KinematicTree:
        """Return the tree without a transmission."""
        if self.actuation is None:
            return self
        size = self.actuation.size
        return replace(self, actuation=None, num_positions=size, num_velocities=size)

    def joint_samples(
        self, q: Array, v: Array, vd: Array
    ) -> tuple[KinematicTree, Samples, Array | None]:
        """Return the tree of the joints, their samples, and J (N, joints, nv) of a transmission."""
        J = None
        if self.actuation is not None:
            q, v, vd, J = self.actuation.tree_samples(q, v, vd)
        q, v, vd = contiguous(q), contiguous(v), contiguous(vd)
        return self.joints, (q, v, v, vd), J

    def joint_positions(self, q: Array) -> Array:
        """Return positions (N, ·) of the tree's joints for the robot's positions (N, nq)."""
        return q if self.actuation is None else self.actuation.joint_positions(q)

    def inside(self, q: Array) -> Array:
        """Return positions (N, nq), with actuators moved into the domains of their maps."""
        return q if self.actuation is None else self.actuation.inside(q)

    def moving_velocities(self, velocities: Sequence[int]) -> tuple[int, ...]:
        """Return the robot's velocities that affect any of some joint velocities."""
        if self.actuation is None:
            return tuple(dict.fromkeys(velocities))  # a leader moves a body and its follower
        return self.actuation.moved_by(velocities)

    def through(self, q: Array, jacobian: Array) -> Array:
        """Map Jacobians (N, m, ·) with respect to joint velocities to the robot's (N, m, nv)."""
        return jacobian if self.actuation is None else jacobian @ self.actuation.jacobian(q)

    def branch(self, body: int) -> KinematicTree:
        """Return the tree with only the mobilizers between the world and a body."""
        index = next(i for i, mobilizer in enumerate(self.mobilizers) if mobilizer.body == body)
        path: list[Mobilizer] = []
        while index >= 0:
            path.append(self.mobilizers[index])
            index = path[-1].parent
        path = [replace(mobilizer, parent=i - 1) for i, mobilizer in enumerate(reversed(path))]
        return replace(self, mobilizers=tuple(path))

    @cached_property
    def records(self) -> TreeRecords:
        """Return the tree for compiled code."""
        return records_of(self.mobilizers, self.gravity)


def actuator_rows(J: Array | None, rows: Array) -> Array:
    """Return Jᵀ Y (N, nv, p) for rows Y (N, joints, p); Y itself if J is None."""
    return rows if J is None else np.asarray(np.swapaxes(J, 1, 2) @ rows)


_Edge = tuple[Joint, int, int, RigidTransform, RigidTransform, float]
"""A joint, its inboard and outboard bodies, X_PF, X_MB, and a sign, −1 if the child is inboard.

Frames between the joints of a free base have indices from −2 down.
"""


def _edges(plant: MultibodyPlant, bodies: tuple[LumpedBody, ...]) -> Iterator[_Edge]:
    """Yield the moving joints, inboard before outboard."""
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    places = {
        body.index(): (_WORLD, body.body_frame().CalcPose(context, world))
        for body in plant.GetBodiesWeldedTo(plant.world_body())
    }
    all_bodies = (plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies()))
    frames = [body.index() for body in all_bodies if is_frame(plant, body)]
    places |= {body: (_MASSLESS - at, RigidTransform()) for at, body in enumerate(frames)}
    for index, lump in enumerate(bodies):
        places.update({member.index: (index, member.X_RB) for member in lump.members})

    def place(frame: Frame) -> tuple[int, RigidTransform]:
        body, X_RB = places[frame.body().index()]
        return body, X_RB.multiply(frame.GetFixedPoseInBodyFrame())

    waiting = [
        (joint, place(joint.frame_on_parent()), place(joint.frame_on_child()))
        for joint in joints_of(plant)
        if not isinstance(joint, WeldJoint)
    ]
    reached = {_WORLD}
    while waiting:
        joint, parent, child = next(
            edge for edge in waiting if edge[1][0] in reached or edge[2][0] in reached
        )
        waiting = [edge for edge in waiting if edge[0] is not joint]
        if parent[0] in reached and child[0] in reached:
            raise ModelError(
                f"Joint {joint.name()!r} closes a kinematic loop.",
                advice="Open the loop: remove the joint from the model.",
            )
        sign = 1.0 if parent[0] in reached else -1.0
        (inboard, X_PF), (outboard, X_BM) = (parent, child) if sign > 0 else (child, parent)
        reached.add(outboard)
        yield joint, inboard, outboard, X_PF, X_BM.inverse(), sign


def _has_gravity(plant: MultibodyPlant, body: LumpedBody) -> bool:
    """Return whether gravity acts on a body's members, which must agree."""
    instances = {plant.get_body(member.index).model_instance() for member in body.members}
    enabled = {plant.is_gravity_enabled(instance) for instance in instances}
    if len(enabled) > 1:
        raise _partial_gravity(body.name)
    return enabled.pop()


def _partial_gravity(name: str) -> ModelError:
    return ModelError(
        f"Gravity acts on one part of a connected robot but not on another, at body {name!r}.",
        advice="Enable or disable gravity for all connected model instances.",
    )
