"""The SCARA arm of [Lee2019] §4.6.1: two links in a plane, a payload, and frames to see it from.

A payload's ten parameters are about the origin of its link's frame. Moving that frame, with joints
and masses where they are, changes what the parameters mean and nothing else.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    RotationalInertia,
    SpatialInertia,
)

from geodrake.excitation import MotionLimits, Target, make_target
from geodrake.inertia import inertial_parameters
from geodrake.model import RobotModel

Array = NDArray[np.float64]

LINK = 0.5  # m, both
NOISE = 0.03  # N·m
SAMPLES = 50
TRUTH = (4.0, (0.0, 0.0), 0.08165)
PRIOR = (4.58, (0.02e-3, 1.94e-3), 0.08607)
"""Mass, kg; centre of mass in frame {3}, m; radius of gyration about the vertical, m."""
_FLANGE = 0.15  # m, from the end of the second link to the payload's centre

FRAMES = {
    "1": RigidTransform([0.0, -0.3, 0.0]),
    "2": RigidTransform(RotationMatrix.MakeZRotation(0.6), [-0.25, 0.1, 0.0]),
    "3": RigidTransform(),
    "4": RigidTransform(RotationMatrix.MakeZRotation(-0.9), [0.12, 0.2, 0.0]),
}
"""Poses in the frame {3} at the payload's centre; {1} is on its y-axis, where p^x is as small."""


def payload(mass: float, com: tuple[float, float], gyration: float) -> SpatialInertia:
    """A uniform sphere in frame {3}; its moment about z is that about the frame's own origin."""
    p = np.array([*com, 0.0])
    own = mass * (gyration**2 - p @ p)
    return SpatialInertia.MakeFromCentralInertia(mass, p, RotationalInertia(own, own, own))


def scara(frame: str, body: SpatialInertia) -> RobotModel:
    """The arm with a body at its end, described in one of `FRAMES`.

    Its links are known, so that they do not matter; they are light.
    """
    plant, X_3B = MultibodyPlant(0.0), FRAMES[frame]
    rod = SpatialInertia.SolidBoxWithMass(1.0, LINK, 0.05, 0.05).Shift([-LINK / 2, 0.0, 0.0])
    upper = plant.AddRigidBody("upper_arm", rod)
    moved = body.Shift(X_3B.translation()).ReExpress(X_3B.rotation().inverse())
    fore = plant.AddRigidBody("forearm", moved)
    world = plant.world_body().body_frame()
    plant.AddJoint(RevoluteJoint("shoulder", world, upper.body_frame(), [0, 0, 1], -np.pi, np.pi))
    # The payload is beside the forearm's line, so that no frame here is aligned with it.
    X_J3 = RigidTransform(RotationMatrix.MakeZRotation(0.4), [LINK, _FLANGE, 0.0])
    elbow = FixedOffsetFrame("elbow_F", upper.body_frame(), RigidTransform([LINK, 0.0, 0.0]))
    inverse = FixedOffsetFrame("elbow_M", fore.body_frame(), (X_J3 @ X_3B).inverse())
    F, M = plant.AddFrame(elbow), plant.AddFrame(inverse)
    plant.AddJoint(RevoluteJoint("elbow", F, M, [0, 0, 1], -np.pi, np.pi))
    plant.Finalize()
    return RobotModel(plant, Path("scara"), False, inertial_parameters(plant))


def payload_target(frame: str) -> Target:
    """The unknown payload in a frame, with its prior."""
    return make_target(scara(frame, payload(*PRIOR)), noise=NOISE, bodies=["forearm"])


def limits() -> MotionLimits:
    """Our limits of samples; the source does not state its own."""
    return MotionLimits(
        ("shoulder", "elbow"),
        lower=np.full(2, -np.pi),
        upper=np.full(2, np.pi),
        velocity=np.full(2, 2.0),
        acceleration=np.full(2, 5.0),
        effort=np.full(2, np.inf),
    )


def errors_in_frame_3(covariance: Array) -> dict[str, float]:
    """RMS errors of m (kg), p^x, p^y and r^z (mm) from the covariance (10, 10) of φ in {3}.

    To first order in the noise, at the true payload, whose centre is the origin.
    """
    mass, _, gyration = TRUTH
    variance = np.diagonal(covariance)
    by_r = np.zeros(10)
    by_r[0], by_r[6] = -gyration / (2 * mass), 1 / (2 * mass * gyration)
    return {
        "m": float(np.sqrt(variance[0])),
        "px": float(1e3 * np.sqrt(variance[1]) / mass),
        "py": float(1e3 * np.sqrt(variance[2]) / mass),
        "rz": float(1e3 * np.sqrt(by_r @ covariance @ by_r)),
    }
