"""Logs of a pendulum behind a position servo, by MuJoCo."""

import mujoco
import numpy as np

from geodrake.logs import JointLog

PENDULUM = """
<robot name="pendulum">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.4"/><mass value="2.0"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.002" ixy="0" iyz="0" ixz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="10"/></joint>
</robot>
"""
PERIOD, LATE = 0.004, 0.009
TRUTH = np.array([60.0, 0.0, 4.0, 0.9, 0.08, LATE])


def command(time):
    """Slow swings, and small fast ones at which a servo lags."""
    t = np.asarray(time)
    return 0.9 * np.sin(1.1 * t) + 0.4 * np.sin(2.7 * t + 1.0) + 0.02 * np.sin(23.0 * t)


def servo_log(*, integral=0.0, limit=np.inf, seconds=16.0, feedback=False):
    """A position actuator with velocity feedback, armature, damping, friction.

    The integral, which holds still where the torque is at its limit, is summed up by hand. It
    begins at 0, a second before the log. Where there is a limit, damping is the joint's own unless
    it is asked for as velocity feedback, within the limit.
    """
    spec = mujoco.MjSpec.from_string(PENDULUM)
    spec.option.timestep = 2.5e-4
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    joint = spec.joints[0]
    joint.limited = 0
    kp, _, damping, coulomb, armature, late = TRUTH.tolist()
    own = damping if np.isfinite(limit) and not feedback else 1.0  # of the joint itself
    size = np.zeros(np.shape(joint.damping))
    if size.ndim:
        size[0] = own
    joint.damping = size if size.ndim else own
    joint.armature, joint.frictionloss = armature, coulomb
    actuator = spec.add_actuator(name="servo", target="hinge")
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[0], actuator.biasprm[1], actuator.biasprm[2] = kp, -kp, own - damping
    if np.isfinite(limit):
        actuator.forcelimited, actuator.forcerange = 1, [-limit, limit]
    engine = spec.compile()
    step, summed = engine.opt.timestep, 0.0
    data, count = mujoco.MjData(engine), round(seconds / step)
    data.qpos[0] = command(-late)
    position = np.empty(count)
    for k in range(count):
        position[k] = data.qpos[0]
        told = command(k * step - late)
        error, torque = told - data.qpos[0], integral * summed
        raw = kp * error + torque - (damping - own) * data.qvel[0]
        if abs(raw) < limit or raw * error < 0.0:
            summed += step * error
        data.ctrl[0] = told + torque / kp
        mujoco.mj_step(engine, data)
    rows = slice(1000, None, round(PERIOD / step))
    time = np.arange(count)[rows] * step
    noise = 1e-5 * np.random.default_rng(0).normal(size=len(time))
    return JointLog(
        "servo",
        ("hinge",),
        time,
        (position[rows] + noise)[:, None],
        np.full((len(time), 1), np.nan),
        command=command(time)[:, None],
    )
