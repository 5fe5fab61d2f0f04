"""An arm whose wrist two motors move together: a model file and transmissions."""

import numpy as np
from chain_logs import logged

from geodrake import load_model
from geodrake.logs import Motion

ARM = """<robot name="coupled"><link name="base"/>{links}{joints}</robot>"""
LINK = (
    '<link name="{0}"><inertial><origin xyz="{1}"/><mass value="{2}"/><inertia ixx="{3}" iyy="{4}"'
    ' izz="{5}" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="{3}"><parent link="{1}"/><child link="{2}"/><origin xyz="{4}" '
    'rpy="0.1 0 0.2"/><axis xyz="{5}"/><limit lower="-2" upper="2" effort="40" velocity="3"/>'
    "{6}</joint>"
)

WRIST = """
gears:
- {actuator: m1, joint: shoulder, ratio: -8}
coupled:
- joints:
    pitch: {m2: 0.5, m3: 0.5}
    roll: {m2: 0.4, m3: -0.4}
  offsets: {roll: 0.1}
"""
"""A gear, and a differential with unequal ratios."""

CURVED = """
four_bars:
- {actuator: crank, joint: shoulder, ground: 0.1, crank: 0.04, coupler: 0.09, rocker: 0.06,
   crank_angle: 1.2, rocker_angle: 1.5}
polynomials:
- {actuator: knob, joint: pitch, coefficients: [0.1, 0.9, 0.2, -0.1]}
linear_actuators:
- {actuator: screw, joint: roll, base: 0.5, lever: 0.4, length: 0.5, angle: 1.16, reversed: true}
"""
"""Ratios that change with the position."""


def text(extra=""):
    """Return the model file; `extra` goes into the joint `roll`."""
    links = (
        LINK.format("upper", "0.2 0.02 0.01", 3.0, 0.03, 0.05, 0.04),
        LINK.format("hand", "0.1 -0.02 0.03", 1.2, 0.01, 0.02, 0.015),
        LINK.format("tool", "0.02 0.05 0.1", 0.8, 0.008, 0.01, 0.006),
    )
    joints = (
        JOINT.format("shoulder", "base", "upper", "revolute", "0 0 0.3", "0 1 0", ""),
        JOINT.format("pitch", "upper", "hand", "revolute", "0.4 0 0", "0 1 0", ""),
        JOINT.format("roll", "hand", "tool", "revolute", "0.1 0 0", "1 0 0", extra),
    )
    return ARM.format(links="".join(links), joints="".join(joints))


def arm(folder, beside=WRIST, *, extra="", **options):
    """Return the arm with a transmission file beside it, or none if it is empty."""
    folder.joinpath("arm.urdf").write_text(text(extra))
    if beside:
        folder.joinpath("arm.transmission.yaml").write_text(beside)
    return load_model(folder / "arm.urdf", **options)


def motion_of(model, count=6, seed=0, reach=0.05):
    """Return random samples that are small enough for every linkage."""
    rng, nv = np.random.default_rng(seed), len(model.joints)
    q = rng.uniform(-reach, reach, (count, nv))
    return Motion(q, *rng.uniform(-1.0, 1.0, (2, count, nv)))


def log_of(model, seed, hidden=None, *, seconds=20.0):
    """Return a log of the model's actuators on a multisine, with noise and hidden efforts of v."""

    def dynamics(q, v, vd):
        return model.motion(Motion(q, v, vd)).load

    more = hidden and (lambda q, v, vd, load: hidden(v))
    return logged(
        dynamics, model.joints, seed, more, lambda load: 0.02 * load.std(0), seconds=seconds
    )
