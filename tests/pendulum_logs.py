"""Logs of a double pendulum on known motions, with hidden efforts in formulas of this file."""

from functools import cache
from pathlib import Path

import numpy as np
from chain_logs import inverse_dynamics, logged
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from geodrake.logs import JointLog, Motion

PENDULUM = Path(__file__).parents[1] / "models" / "double_pendulum.urdf"
JOINTS = ("shoulder", "elbow")
NOISE = np.array([0.03, 0.015])  # deviation of the effort's noise, N·m


def welded_plant(path=PENDULUM, base="base_link"):
    """Return Drake's own reading of a model file, welded to the world."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(base))
    plant.Finalize()
    return plant


pendulum_plant = cache(welded_plant)


def body_effort(q, v, vd):
    """Return the inverse dynamics (N, 2) of the pendulum."""
    return inverse_dynamics(pendulum_plant(), q, v, vd)


def pendulum_log(seed, hidden=None, *, seconds=40.0, noise=NOISE, **options):
    """Return a log of the pendulum (see `logged`); `noise` is the deviation (2,) of efforts."""
    deviation = np.asarray(noise)
    return logged(
        body_effort, JOINTS, seed, hidden, lambda _: deviation, seconds=seconds, **options
    )


def friction(coulomb, viscous=(0.0, 0.0)):
    """Return dry and viscous friction (N·m, N·m·s/rad) of both joints as a hidden effort."""
    return lambda q, v, vd, load: np.array(coulomb) * np.sign(v) + np.array(viscous) * v


def sines(seconds=20.0, seed=3, size=0.4, period=0.01):
    """Return time (N,) and the motion of both joints, each a sum of three sines."""
    time = np.arange(0.0, seconds, period)
    rates = 2 * np.pi * np.array([[0.31, 0.73, 1.13], [0.42, 0.59, 0.97]])
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, rates.shape)
    angle = rates * time[:, None, None] + phases
    parts = (np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle))
    return time, Motion(*(np.asarray(size) * np.sum(part, axis=-1) for part in parts))


def sine_log(model, *, coulomb=(0.3, 0.2), noise=0.02, **motion):
    """Return a log of the pendulum with dry and viscous friction on the motion of `sines`."""
    time, moved = sines(**motion)
    effort = model.effort(moved) + np.sign(moved.v) * coulomb + 0.1 * moved.v
    effort += noise * np.random.default_rng(100).normal(size=effort.shape)
    return JointLog("log", model.joints, time, moved.q, effort)


FINGER = """<link name="{0}"><inertial><origin xyz="0 0 -0.02"/><mass value="0.2"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{0}" type="prismatic"><parent link="lower_link"/><child link="{0}"/>
<origin xyz="0 0 -0.3"/><axis xyz="{1} 0 0"/><limit lower="0" upper="0.04" effort="9"
velocity="0.2"/>{2}</joint>"""


def with_gripper(path):
    """Write the pendulum with a gripper, whose right finger follows the left; return the path."""
    own = FINGER.format("left", 1, "") + FINGER.format("right", -1, '<mimic joint="left"/>')
    path.write_text(PENDULUM.read_text().replace("</robot>", own + "</robot>"))
    return path


def point_pendulum(path, length):
    """Write a pendulum of two point masses of 2 kg, m below their joints, as a URDF; return it."""
    none = '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    point = f'<inertial><origin xyz="0 0 {-length}"/><mass value="2"/>{none}</inertial>'
    parts = f'<link name="base"/><link name="l0">{point}</link><link name="l1">{point}</link>'
    for k, parent in enumerate(("base", "l0")):
        parts += f'<joint name="j{k}" type="revolute"><parent link="{parent}"/>'
        parts += f'<child link="l{k}"/><origin xyz="0 0 {-length * k}"/><axis xyz="0 1 0"/>'
        parts += '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
    path.write_text(f'<robot name="points">{parts}</robot>')
    return path
