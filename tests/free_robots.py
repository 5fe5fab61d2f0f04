"""Robots with a free base by others, with the same six joints as geodrake's base."""

import mujoco
import numpy as np
import pinocchio as pin


class FreeRobot:
    """Dynamics of a URDF, by (n,) numbers of the base's joints and of other joints."""

    def __init__(self, text, joints):
        base = pin.JointModelComposite()
        for kind in ("PX", "PY", "PZ", "RZ", "RY", "RX"):
            base.addJoint(getattr(pin, f"JointModel{kind}")())
        self.model = pin.buildModelFromXML(text, base)
        self.data = self.model.createData()
        self.own = [self.model.joints[self.model.getJointId(name)] for name in joints]
        self.order = [*range(6), *(joint.idx_v for joint in self.own)]

    def efforts(self, q, v, a):
        """Return the efforts of a motion; endless joints have cosine and sine."""
        full = pin.neutral(self.model)
        speed, rate = np.zeros((2, self.model.nv))
        full[:6], speed[self.order], rate[self.order] = q[:6], v, a
        for joint, angle in zip(self.own, q[6:], strict=True):
            turned = [np.cos(angle), np.sin(angle)] if joint.nq == 2 else angle
            full[joint.idx_q : joint.idx_q + joint.nq] = turned
        needed = pin.rnea(self.model, self.data, full, speed, rate)[self.order]
        pin.computeJointJacobians(self.model, self.data, full)
        pin.updateFramePlacements(self.model, self.data)
        return needed

    def jacobian(self, frame):
        """Return the Jacobian (6, n) of a frame's position and rotation in the last state."""
        world, number = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED, self.model.getFrameId(frame)
        return pin.getFrameJacobian(self.model, self.data, number, world)[:, self.order]

    def jacobian_at(self, frame, offset):
        """Return the Jacobian (3, n) of a point with an offset from a frame, along the world."""
        moved, turned = np.split(self.jacobian(frame), 2)
        return moved - pin.skew(np.asarray(offset)) @ turned

    def pose(self, frame):
        """Return the rotation and position of a frame in the last state."""
        pose = self.data.oMf[self.model.getFrameId(frame)]
        return pose.rotation, pose.translation

    def wrench(self):
        """Return the external moment and force (6,) about the origin that the last motion needs."""
        needed = self.data.oMi[1].act(self.data.f[1])
        return np.append(needed.angular, needed.linear)


class MuJoCoRobot:
    """Dynamics of a URDF by MuJoCo's inverse dynamics, with the interface of `FreeRobot`."""

    def __init__(self, text, joints):
        spec = mujoco.MjSpec.from_string(text)
        spec.compiler.fusestatic = False
        root, kinds = spec.worldbody.first_body(), mujoco.mjtJoint
        axes = np.eye(3)[[0, 1, 2, 2, 1, 0]]
        for k, axis in enumerate(axes):
            kind = kinds.mjJNT_SLIDE if k < 3 else kinds.mjJNT_HINGE
            root.add_joint(name=f"base{k}", type=kind, axis=axis)
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        names = [*(f"base{k}" for k in range(6)), *joints]
        self.order = [int(self.model.joint(name).dofadr[0]) for name in names]

    def efforts(self, q, v, a):
        """Return the efforts of a motion."""
        data = self.data
        for values, state in ((q, data.qpos), (v, data.qvel), (a, data.qacc)):
            state[self.order] = values
        mujoco.mj_inverse(self.model, data)
        return data.qfrc_inverse[self.order].copy()

    def jacobian(self, frame):
        """Return the Jacobian (6, n) of a frame's position and rotation in the last state."""
        J = np.zeros((2, 3, self.model.nv))
        mujoco.mj_jacBody(self.model, self.data, *J, self.model.body(frame).id)
        return J.reshape(6, -1)[:, self.order]
