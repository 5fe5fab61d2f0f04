"""Chains of equal links in Drake's plants, for tests of effects."""

from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    RevoluteSpring,
    SpatialInertia,
    UnitInertia,
    WeldJoint,
)

LINK = SpatialInertia(2.0, [0.02, -0.01, 0.25], UnitInertia.SolidBox(0.2, 0.1, 1.2))
MOTOR = 0.3  # kg·m², of the body of a motor


def arm(*, damping=0.0, spring=None, dofs=3, weld_tool=False, time_step=0.0):
    """Return a chain of revolute joints about y, z and x, whose links hang from each other.

    `spring` are stiffness and damping between the body of the first joint's motor and its link.
    """
    plant = MultibodyPlant(time_step)
    parent = plant.world_frame()
    for i in range(dofs):
        body = plant.AddRigidBody(f"link{i + 1}", LINK)
        X = RigidTransform(RollPitchYaw(0.3 * i, 0.2, 0.0), [0.0, 0.02, 0.3])
        mount, axis = plant.AddFrame(FixedOffsetFrame(f"mount{i}", parent, X)), [0.0, 0.0, 0.0]
        axis[(i + 1) % 3] = 1.0
        own = damping
        if soft := spring is not None and i == 0:
            inertia = SpatialInertia(1.0, [0.0, 0.0, 0.0], UnitInertia(MOTOR, MOTOR, MOTOR))
            motor = plant.AddRigidBody("motor", inertia)
            plant.AddJoint(RevoluteJoint("turn", mount, motor.body_frame(), axis))
            mount, own = motor.body_frame(), spring[1]
        joint = RevoluteJoint(f"joint{i + 1}", mount, body.body_frame(), axis, own)
        joint = plant.AddJoint(joint)
        if soft:
            plant.AddForceElement(RevoluteSpring(joint, 0.0, spring[0]))
        plant.AddJointActuator(f"motor{i + 1}", joint)
        parent = body.body_frame()
    if weld_tool:
        tool = plant.AddRigidBody("tool", SpatialInertia.Zero())
        X = RigidTransform(RollPitchYaw(0.4, -0.3, 0.2), [0.1, -0.05, 0.2])
        plant.AddJoint(WeldJoint("flange", parent, tool.body_frame(), X))
    plant.Finalize()
    return plant
