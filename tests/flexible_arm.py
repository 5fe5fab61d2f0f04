"""An arm of seven joints, one of them elastic: its model, and a log by MuJoCo."""

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from two_masses import having

from geodrake import effects, load_model
from geodrake.logs import JointLog

ARM = Path(__file__).parents[1] / "models" / "arm7.urdf"
KP = np.array([3e3, 3e3, 1.5e3, 1.5e3, 400.0, 400.0, 200.0])
KD = 0.05 * KP


@cache
def arm_log(stiffness, seed=1, seconds=14.0, step=4e-4, weight=1.0):
    """Return a log of an arm with servos, whose joint 4 has a spring behind its motor, by MuJoCo.

    Servos follow commands and compensate a share of the weight.
    """
    spec = mujoco.MjSpec.from_file(str(ARM))
    spec.option.timestep = step
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    names = [joint.name for joint in spec.joints]
    motor = spec.joint(names[3])  # the link turns by a second joint about the same axis
    motor.parent.add_joint(name="bend", axis=motor.axis, pos=motor.pos)
    compiled = mujoco.MjModel.from_xml_string(_with_rotors(spec))
    bend = compiled.joint("bend")
    compiled.jnt_stiffness[bend.id], compiled.dof_damping[bend.dofadr[0]] = stiffness, 2.0
    data, rng = mujoco.MjData(compiled), np.random.default_rng(seed)
    at = [compiled.joint(name).dofadr[0] for name in names]
    rates, phases = rng.uniform(1.0, 7.5, (7, 5)), rng.uniform(0.0, 6.28, (7, 5))
    sizes = 0.2 * rng.uniform(0.5, 1.0, (7, 5))
    middle, rows = np.array([0.3, 0.6, 0.1, 1.2, 0.2, 0.5, 0.0]), []

    def told(t):
        angle = rates * t + phases
        position = middle + (sizes * np.sin(angle)).sum(1)
        return position, (sizes * rates * np.cos(angle)).sum(1)

    data.qpos[at], data.qvel[at] = told(0.0)
    for k in range(round(seconds / step)):
        q, v = told(k * step)
        u = weight * data.qfrc_bias[at] + KP * (q - data.qpos[at]) + KD * (v - data.qvel[at])
        if k % 10 == 0:
            rows.append([k * step, *data.qpos[at], *data.qvel[at], *u, *q])
        data.qfrc_applied[at] = u
        mujoco.mj_step(compiled, data)
    t, position, velocity, effort, command = np.split(np.array(rows)[125:], [1, 8, 15, 22], axis=1)
    return JointLog("arm", tuple(names), t[:, 0], position, effort, velocity, command=command)


def _with_rotors(spec):
    for joint in spec.joints:
        if joint.name != "bend":
            joint.armature = 0.3
        joint.limited = 0
    spec.compile()
    return spec.to_xml()


def soft_arm(share):
    model = load_model(ARM)
    joint = model.joints[3]
    return having(model, 0.3, 0.0, (effects.JointElasticity(joint), share / 2000.0))
