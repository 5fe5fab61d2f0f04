"""A gallop-like motion of the whole robot: trunk and four legs ([Lee2019] §3.6.2.2).

The motion is ours: surge, heave and pitch of the trunk and swings of the legs at the stride's
frequency and its double, each leg with its own phase in the stride as in a transverse gallop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from diagrams.studies.cheetah.leg import JOINTS, MODELS, Array
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs import Motion
from geodrake.robot import (
    KinematicTree,
    LinearTransmission,
    base_wrench_regressor,
    body_poses,
    inverse_dynamics_regressor,
    joint_names,
    load_plant,
)

LEGS = ("front_left", "front_right", "rear_left", "rear_right")
PHASES = {"front_left": 0.0, "front_right": 0.15, "rear_left": 0.55, "rear_right": 0.7}
GEARS = (7.667, 7.667, 8.846)
STRIDE = 2.5  # Hz


@dataclass(frozen=True, eq=False)
class Quantity:
    """A part of the inverse dynamics as a function of one leg's parameters, all legs being equal.

    Attributes:
        rows: (m, 60) regressor, over samples and components.
        components: Number of components that a sample has.
    """

    rows: Array
    components: int

    def rms(self, error: Array) -> float:
        """RMS over samples of the size of the error that errors (6, 10) of the parameters make."""
        values = (self.rows @ error.ravel()).reshape(-1, self.components)
        return float(np.sqrt(np.mean(np.square(values).sum(1))))


def leg_motion(time: Array, phase: float) -> Motion:
    """Angles of a leg's joints, with their derivatives."""
    first = 2 * np.pi * STRIDE * time[:, None] + 2 * np.pi * phase
    middle = np.array([0.05, 0.75, -1.5])
    waves = (
        (1, np.array([0.08, 0.55, 0.35]), np.array([0.4, 0.0, 1.9])),
        (2, np.array([0.04, 0.12, 0.25]), np.array([1.3, 0.8, 0.5])),
    )
    return _sum_of_waves(first, middle, waves)


def trunk_motion(time: Array) -> Motion:
    """Surge, heave and pitch of the trunk, with their derivatives; 3 m/s forward."""
    first = 2 * np.pi * STRIDE * time[:, None]
    waves = (
        (1, np.array([0.02, 0.05, 0.18]), np.array([0.3, 1.1, 0.2])),
        (2, np.array([0.01, 0.02, 0.05]), np.array([2.0, 0.4, 1.5])),
    )
    motion = _sum_of_waves(first, np.array([0.0, 0.55, 0.0]), waves)
    forward = np.array([3.0, 0.0, 0.0])
    return Motion(motion.q + time[:, None] * forward, motion.v + forward, motion.vd)


def _sum_of_waves(
    first: Array, middle: Array, waves: tuple[tuple[int, Array, Array], ...]
) -> Motion:
    q, v, vd = middle + 0.0 * first, 0.0 * first + 0.0 * middle, 0.0 * first + 0.0 * middle
    for order, size, phase in waves:
        angle, rate = order * first + phase, 2 * np.pi * STRIDE * order
        q = q + size * np.sin(angle)
        v = v + size * rate * np.cos(angle)
        vd = vd - size * rate**2 * np.sin(angle)
    return Motion(q, v, vd)


def whole_robot() -> MultibodyPlant:
    """The trunk, floating, with four legs."""
    return load_plant(MODELS / "cheetah.dmd.yaml", floating=True).plant


def gallop(plant: MultibodyPlant, time: Array) -> Motion:
    """Motion of the whole robot in Drake's order, rotors included."""
    names = joint_names(plant)
    actuators = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
    legs = [leg_motion(time, PHASES[leg]) for leg in LEGS]
    driven = Motion(*(np.hstack([getattr(leg, part) for leg in legs]) for part in ("q", "v", "vd")))
    joints = gearing(names[6:], actuators).joint_motion(driven)
    trunk, zero = trunk_motion(time), np.zeros(len(time))
    (x, z, pitch), (xd, zd, w), (xdd, zdd, wd) = (part.T for part in (trunk.q, trunk.v, trunk.vd))
    base_q = np.stack([np.cos(pitch / 2), zero, np.sin(pitch / 2), zero, x, zero, z], -1)
    base_v = np.stack([zero, w, zero, xd, zero, zd], -1)
    base_vd = np.stack([zero, wd, zero, xdd, zero, zdd], -1)
    return Motion(
        np.hstack([base_q, joints.q]),
        np.hstack([base_v, joints.v]),
        np.hstack([base_vd, joints.vd]),
        time,
    )


def gearing(joints: tuple[str, ...], actuators: tuple[str, ...]) -> LinearTransmission:
    """Joints turn with their actuators, rotors by the gear ratio."""
    ratios = {name: {name: 1.0} for name in actuators}
    gears = GEARS * (len(actuators) // len(GEARS))
    ratios |= {f"{n}_rotor": {n: gear} for n, gear in zip(actuators, gears, strict=True)}
    return LinearTransmission.from_ratios(joints, actuators, ratios)


def quantities(plant: MultibodyPlant, motion: Motion) -> dict[str, Quantity]:
    """Joint torques, and force and moment on the trunk, in its frame."""
    tree = KinematicTree.from_plant(plant)
    state = motion.q, motion.v, motion.vd
    trunk = body_poses(tree, motion.q)[:, tree.bodies.index("trunk")]
    wrench = base_wrench_regressor(tree, *state, X_WP=trunk)
    actuators = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
    transmission = gearing(joint_names(plant)[6:], actuators)
    torque = transmission.regressor(
        np.zeros((len(motion), 12)), inverse_dynamics_regressor(tree, *state)[:, 6:]
    )

    def of_a_leg(regressor: Array) -> Quantity:
        blocks = regressor.reshape(*regressor.shape[:2], len(tree.bodies), PARAMETERS_PER_BODY)
        places = [[k for k, b in enumerate(tree.bodies) if b.startswith(leg)] for leg in LEGS]
        rows = sum(blocks[:, :, place] for place in places)
        return Quantity(rows.reshape(-1, 6 * PARAMETERS_PER_BODY), regressor.shape[1])

    return {
        "joint torque": of_a_leg(torque),
        "body force": of_a_leg(wrench[:, 3:]),
        "body moment": of_a_leg(wrench[:, :3]),
    }
