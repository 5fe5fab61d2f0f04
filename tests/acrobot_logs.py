"""An acrobot of MuJoCo, whose shoulder has neither motor nor sensor of effort, and logs of it."""

from functools import cache

import mujoco
import numpy as np

ACROBOT = """<mujoco><option timestep="0.0005"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping="{shoulder}"/>
    <inertial pos="0 0 -0.25" mass="1.2" diaginertia="0.02 0.02 0.002"/>
    <body name="lower" pos="0 0 -0.5">
      <joint name="elbow" axis="0 1 0" frictionloss="{friction}"/>
      <inertial pos="0 0 -0.2" mass="{mass}" diaginertia="0.01 0.01 0.001"/></body></body>
  </worldbody><actuator><motor joint="elbow"/></actuator></mujoco>"""
HEADER = "time,shoulder.position,elbow.position,elbow.effort"


def text(shoulder=0.0, friction=0.0, mass=0.8):
    return ACROBOT.format(shoulder=shoulder, friction=friction, mass=mass)


@cache
def simulated(xml, seed, seconds=16.0):
    """Return (N, 4) time, positions and the elbow's noisy effort while a servo swings the elbow."""
    model, rng = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(seed)
    data, rows = mujoco.MjData(model), []
    phase, rate, size = (rng.uniform(*ends, 4) for ends in ((0, 6.3), (0.2, 1.1), (0.3, 0.7)))
    data.qpos[:] = rng.normal(0.0, 0.3, 2)
    for k in range(int(seconds / model.opt.timestep)):
        time = k * model.opt.timestep
        wanted = size @ np.sin(2 * np.pi * rate * time + phase)
        data.ctrl[0] = 12.0 * (wanted - data.qpos[1]) - 0.8 * data.qvel[1]
        if k % 8 == 0:
            rows.append([time, *data.qpos, data.ctrl[0]])
        mujoco.mj_step(model, data)
    table = np.array(rows)
    return table + rng.normal(0.0, 1.0, table.shape) * [0.0, 2e-5, 2e-5, 0.02]
