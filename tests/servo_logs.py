"""Logs of a pendulum behind a position servo, by MuJoCo."""

import numpy as np

from diagrams.benchmarks.simulated.servos import STEP, Servos, simulated
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
    """Return slow swings with small fast ones, at which a servo lags."""
    t = np.asarray(time)
    return 0.9 * np.sin(1.1 * t) + 0.4 * np.sin(2.7 * t + 1.0) + 0.02 * np.sin(23.0 * t)


def servo_log(*, integral=0.0, limit=np.inf, seconds=16.0, feedback=False):
    """Return a log of a position servo with velocity feedback, armature, damping and friction.

    With a limit, damping is the joint's own unless it is asked for as velocity feedback within the
    limit.
    """
    kp, _, damping, coulomb, armature, late = TRUTH.tolist()
    own = damping if np.isfinite(limit) and not feedback else 1.0  # of the joint itself
    values = {"stiffness": kp, "damping": damping - own, "viscous": own, "coulomb": coulomb}
    values |= {"armature": armature, "limit": min(limit, 1e6), "integral": integral, "play": 0.0}
    each = {name: np.array([value]) for name, value in values.items()}
    servos, time = Servos(knows_rate=False, delay=late, **each), np.arange(0.0, seconds, STEP)
    told = command(time)[:, None]
    rows = slice(250, None, round(PERIOD / STEP))
    position = simulated("mujoco", PENDULUM, servos, told)[0][rows]
    position += 1e-5 * np.random.default_rng(0).normal(size=position.shape)
    unknown = np.full(position.shape, np.nan)
    return JointLog("servo", ("hinge",), time[rows], position, unknown, command=told[rows])
