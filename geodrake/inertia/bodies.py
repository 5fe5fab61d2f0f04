"""Lump welded links into bodies.

No joint effort distinguishes a tool flange from the wrist it is bolted to. Inertial parameters,
regressors and priors have one row for each of the `lumped_bodies`, in their order.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, System

from geodrake.boundary.arguments import instance, shown
from geodrake.errors import ArgumentError, ModelError

BASE_FRAMES = "base_coordinates_of_"
"""Prefix of model instances with massless frames between the joints of a free base."""

HINGE_FRAMES = "hinges_of_"
"""Prefix of model instances with massless frames between the hinges of one joint."""


@dataclass(frozen=True)
class Member:
    """One link of a lumped body."""

    index: BodyIndex  # the link's index in the plant
    name: str
    scoped_name: str  # with the model instance's name
    X_RB: RigidTransform  # pose of the link B in the frame R of the lumped body's representative


@dataclass(frozen=True)
class LumpedBody:
    """Links that are welded together."""

    name: str  # of the representative, the link whose inboard joint moves
    body_index: BodyIndex  # index of the representative; parameters are expressed in its frame
    members: tuple[Member, ...]  # all links of the body, the representative first


def check_plant(plant: MultibodyPlant) -> None:
    """Raise unless this is a finalized plant."""
    if not instance(plant, "plant", MultibodyPlant).is_finalized():
        raise ModelError("The plant is not finalized.", advice="Call plant.Finalize() first.")


def check_context(system: System, context: Context) -> None:
    """Raise unless this is a Context of the system."""
    try:
        system.ValidateContext(context)
    except TypeError as error:
        raise ArgumentError(f"context must be a Context; it is {shown(context)}.") from error
    except RuntimeError as error:
        raise ArgumentError(
            f"The context belongs to another system than this {type(system).__name__}.",
            advice="Use system.CreateDefaultContext(), or system.GetMyContextFromRoot(root).",
        ) from error


def lumped_bodies(plant: MultibodyPlant) -> tuple[LumpedBody, ...]:
    """Return the groups of welded links that move relative to the world.

    They are sorted by their representatives' BodyIndex.
    """
    check_plant(plant)
    context = plant.CreateDefaultContext()
    names = body_names(plant)

    def lump(representative: RigidBody, group: list[RigidBody]) -> LumpedBody:
        frame = representative.body_frame()
        members = tuple(
            Member(
                body.index(),
                names[int(body.index())],
                body.scoped_name().get_full(),
                plant.CalcRelativeTransform(context, frame, body.body_frame()),
            )
            for body in sorted(group, key=lambda body: (body is not representative, body.index()))
        )
        return LumpedBody(members[0].name, representative.index(), members)

    lumps = [lump(body, group) for body, group in _representatives(plant)]
    return tuple(sorted(lumps, key=lambda body: int(body.body_index)))


def is_frame(
    plant: MultibodyPlant,
    body: RigidBody,
    kinds: tuple[str, ...] = (BASE_FRAMES, HINGE_FRAMES),
) -> bool:
    """Return whether a body is a massless frame between joints."""
    return plant.GetModelInstanceName(body.model_instance()).startswith(kinds)


def body_names(plant: MultibodyPlant) -> tuple[str, ...]:
    """Return the name of every body by BodyIndex; `instance::name` if ambiguous."""
    bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
    count = Counter(body.name() for body in bodies)
    return tuple(
        body.name() if count[body.name()] == 1 else body.scoped_name().get_full() for body in bodies
    )


def _representatives(plant: MultibodyPlant) -> list[tuple[RigidBody, list[RigidBody]]]:
    """Return the most inboard link and all links of every moving group, breadth first."""
    neighbours: dict[int, list[RigidBody]] = {i: [] for i in range(plant.num_bodies())}
    for joint_index in plant.GetJointIndices():
        joint = plant.get_joint(joint_index)
        parent, child = joint.parent_body(), joint.child_body()
        neighbours[int(parent.index())].append(child)
        neighbours[int(child.index())].append(parent)

    anchored = list(plant.GetBodiesWeldedTo(plant.world_body()))
    seen = {int(body.index()) for body in anchored}
    queue, groups = deque(anchored), []
    while queue:
        for body in neighbours[int(queue.popleft().index())]:
            if int(body.index()) not in seen:
                group = list(plant.GetBodiesWeldedTo(body))
                if not is_frame(plant, body):
                    groups.append((body, group))
                seen.update(int(member.index()) for member in group)
                queue.extend(group)
    return groups
