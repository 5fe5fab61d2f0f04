"""The leg: three links and three geared rotors ([Lee2019] §3.6.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant

from diagrams.harness import MODELS
from geodrake.identification import PointMasses
from geodrake.inertia import Ellipsoid, inertial_parameters
from geodrake.inertia.ellipsoids import ellipsoid_of_quadric
from geodrake.logs import Motion
from geodrake.robot import (
    KinematicTree,
    LinearTransmission,
    inverse_dynamics_regressor,
    joint_names,
    load_plant,
)

Array = NDArray[np.float64]

JOINTS = ("hip_roll", "hip_pitch", "knee")
# Hip, thigh and shank about their origins, as identified on the robot.
MEASURED = np.array(
    [
        [1.64528, 1.07120, 0.90194],  # m
        [0, -0.000756, 0.022159],  # h
        [0.105069, -0.031805, 0.003623],
        [-0.007248, -0.104750, -0.044119],
        [0.0068718, 0.0202098, 0.0226955],  # Ixx, Iyy, Izz
        [0.0002715, 0.0185686, 0.0271425],
        [0.0068208, 0.0031154, 0.0055667],
        [0, -0.0004117, 0.0012746],  # Ixy, Iyz, Izx
        [0.0004545, 0.0001295, -0.0003238],
        [0, 0.0012173, -0.0021947],
    ]
).T
CENTERS = ((0, 0.045, 0), (0, 0, -0.171), (0, 0, -0.1725), *((0, 0, 0),) * 3)
SEMI_AXES = ((0.081,) * 3, (0.0594, 0.0594, 0.369), (0.042, 0.042, 0.290), *((0.081,) * 3,) * 3)


@dataclass(frozen=True, eq=False)
class Leg:
    """The leg's bodies: three links and three rotors.

    Attributes:
        plant: Its plant, six joints.
        tree: The plant's kinematics.
        transmission: From the three joints' angles to all six.
        prior: (6, 10) inertial parameters of the model file.
        ellipsoids: (6, 4, 4) quadrics of the regions that the bodies fit into.
    """

    plant: MultibodyPlant
    tree: KinematicTree
    transmission: LinearTransmission
    prior: Array
    ellipsoids: Array

    def regressor(self, motion: Motion) -> Array:
        """(N, 3, 60) regressor of the torques at the joints."""
        moved = self.transmission.joint_motion(motion)
        rows = inverse_dynamics_regressor(self.tree, moved.q, moved.v, moved.vd)
        return self.transmission.regressor(motion.q, rows)

    def point_masses(self, number: int) -> PointMasses:
        """Points all over the bodies' ellipsoids, so many in all, that amount to the prior."""
        counts = [len(part) for part in np.array_split(np.arange(number), len(self.prior))]
        return PointMasses.within(self.prior, ellipsoid_of_quadric(self.ellipsoids), counts)


def load_leg(gears: Sequence[float] = (10.604,) * 3) -> Leg:
    """The leg with the gear ratios of its three rotors."""
    plant = load_plant(MODELS / "cheetah_leg.urdf").plant
    ratios = {joint: {joint: 1.0} for joint in JOINTS}
    ratios |= {f"{j}_rotor": {j: gear} for j, gear in zip(JOINTS, gears, strict=True)}
    transmission = LinearTransmission.from_ratios(joint_names(plant), JOINTS, ratios)
    axes = np.broadcast_to(np.eye(3), (6, 3, 3))
    regions = Ellipsoid(np.array(CENTERS), np.array(SEMI_AXES), axes)
    tree = KinematicTree.from_plant(plant)
    return Leg(plant, tree, transmission, inertial_parameters(plant), regions.quadric)
