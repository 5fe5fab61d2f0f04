"""MuJoCo's own inverse dynamics of joints with one degree of freedom."""

import mujoco
import numpy as np

_OFF = "LIMIT", "FRICTIONLOSS", "CONTACT"


def mujoco_efforts(theirs, joints, q, v, vd, closed=True):
    """Return efforts (N, n) at joints without constraint forces; check that equalities hold."""
    off = [int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{each}")) for each in _OFF]
    theirs.opt.disableflags |= sum(off)
    data, at = mujoco.MjData(theirs), [theirs.joint(name).id for name in joints]
    in_q, in_v, found = theirs.jnt_qposadr[at], theirs.jnt_dofadr[at], []
    for data.qpos[in_q], data.qvel[in_v], data.qacc[in_v] in zip(q, v, vd, strict=True):
        mujoco.mj_inverse(theirs, data)
        assert not closed or np.abs(data.efc_pos).max(initial=0.0) < 1e-9
        found.append((data.qfrc_inverse + data.qfrc_constraint)[in_v])
    return np.array(found)
