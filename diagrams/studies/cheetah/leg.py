"""The leg: three links and three geared rotors ([Lee2019] §3.6.2), its swing and its fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from diagrams.harness import MODELS, sines
from geodrake.errors import ArgumentError
from geodrake.identification import (
    IdentificationResult,
    PointMasses,
    PointMassEuclidean,
    Regularizer,
    Riemannian,
    identify,
)
from geodrake.inertia import Array, Ellipsoid
from geodrake.inertia.ellipsoids import ellipsoid_of_quadric
from geodrake.logs import Motion
from geodrake.model import RobotModel, load_model
from geodrake.robot import LinearTransmission, inverse_dynamics_regressor
from geodrake.robot.reduction import triangular_factor
from geodrake.robot.transmission.schema import Drive

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
    """The leg's bodies: three links and three rotors."""

    model: RobotModel
    ellipsoids: Array  # (6, 4, 4) quadrics of the regions that the bodies fit into

    @property
    def prior(self) -> Array:
        """(6, 10) inertial parameters of the model file."""
        return self.model.phi

    def regressor(self, motion: Motion) -> Array:
        """Return (N, 3, 60) regressor of the torques at the joints."""
        return inverse_dynamics_regressor(self.model.tree, motion.q, motion.v, motion.vd)

    def point_masses(self, number: int) -> PointMasses:
        """Return `number` points all over the bodies' ellipsoids, as heavy as the prior."""
        counts = [len(part) for part in np.array_split(np.arange(number), len(self.prior))]
        return PointMasses.within(self.prior, ellipsoid_of_quadric(self.ellipsoids), counts)


def load_leg(gears: Sequence[float] = (10.604,) * 3) -> Leg:
    """Return the leg with the gear ratios of its three rotors."""
    model = load_model(MODELS / "cheetah_leg.urdf", transmission=[geared(JOINTS, gears)])
    axes = np.broadcast_to(np.eye(3), (6, 3, 3))
    regions = Ellipsoid(np.array(CENTERS), np.array(SEMI_AXES), axes)
    return Leg(model, regions.quadric)


def geared(joints: Sequence[str], gears: Sequence[float]) -> Drive:
    """Return gears: joints turn with their actuators, and their rotors by the ratios."""
    every = tuple(name for joint in joints for name in (joint, f"{joint}_rotor"))
    ratios = {joint: {joint: 1.0} for joint in joints}
    ratios |= {f"{joint}_rotor": {joint: gear} for joint, gear in zip(joints, gears, strict=True)}
    return Drive(tuple(joints), every, LinearTransmission.from_ratios(every, joints, ratios))


VISCOUS, COULOMB = 0.1, 1.0  # N·m·s/rad and N·m, every joint
TORQUE_NOISE, ENCODER_NOISE = 0.5, 2e-4  # N·m and rad, standard deviations
PERIOD, DURATION = 1e-3, 20.0  # s
SLOWEST = np.deg2rad(5.0)  # rad/s; friction is not known below


@dataclass(frozen=True, eq=False)
class Samples:
    """Filtered samples in which all joints move."""

    regressor: Array  # (N, 3, 60) of the inertial parameters
    friction: Array  # (N, 3, 6) of the viscous and the Coulomb coefficients
    torque: Array  # (N, 3) as measured for training, filtered for the test, N·m

    def rms(self, phi: Array, friction: Array) -> float:
        """Return RMS error of predicted torques, N·m."""
        predicted = self.regressor @ phi.ravel() + self.friction @ friction
        return float(np.sqrt(np.mean((predicted - self.torque) ** 2)))


def swing(time: Array, rng: np.random.Generator) -> Motion:
    """Return a swing of the leg in the air, six random sines for each joint."""
    middle, reach = np.array([0.0, 0.5, -1.2]), np.array([0.35, 0.7, 0.7])
    rate, phase = 2 * np.pi * rng.uniform(0.2, 2.2, (6, 3)), rng.uniform(0, 2 * np.pi, (6, 3))
    size = reach * rng.uniform(0.2, 0.6, (6, 3)) / (1 + 0.075 * rate)
    q, v, vd = sines(time, size, rate, phase)
    return Motion(middle + q, v, vd, time)


def measure(leg: Leg, rng: np.random.Generator) -> tuple[Samples, Samples]:
    """Return training and test samples of the measured leg."""
    time = np.arange(0.0, DURATION, PERIOD)
    motion, truth = swing(time, rng), leg.prior.copy()
    truth[:3] = MEASURED
    torque = leg.regressor(motion) @ truth.ravel()
    torque += VISCOUS * motion.v + COULOMB * np.sign(motion.v)
    torque += rng.normal(0.0, TORQUE_NOISE, torque.shape)
    position = motion.q + rng.normal(0.0, ENCODER_NOISE, motion.q.shape)

    def smooth(values: Array, derivative: int = 0) -> Array:
        return savgol_filter(values, 101, 4, deriv=derivative, delta=PERIOD, axis=0)

    seen = Motion(*(smooth(position, k) for k in range(3)))
    moving = (np.abs(seen.v) > SLOWEST).all(axis=1)
    moving[:100] = moving[-100:] = False
    early = time < 0.5 * DURATION
    regressor = leg.regressor(seen)
    each = np.eye(3)
    friction = np.concatenate([seen.v[:, :, None] * each, np.sign(seen.v)[:, :, None] * each], -1)

    def samples(chosen: Array, torques: Array) -> Samples:
        return Samples(regressor[chosen], friction[chosen], torques[chosen])

    return samples(moving & early, torque), samples(moving & ~early, smooth(torque))


REGULARIZERS = ("euclidean", "point_mass_euclidean", "pullback", "entropic", "riemannian")
GAMMA = 0.2
"""Weight of the entropic and the Riemannian regularizer, [Lee2019] §3.6.2.1."""
NEAR = 1.001
"""How far above the least residual of point masses their fit stays, if that is what they reach."""


@dataclass(frozen=True, eq=False)
class Condensed:
    """A x ≈ b, reduced to its triangular factor."""

    A: Array  # (r, p) rows
    b: Array  # (r,) measurements
    rest: float  # squared residual that no parameters remove
    count: int  # number of measurements before

    @classmethod
    def of(cls, A: Array, b: Array) -> Condensed:
        """Condense (m, p) rows and (m,) measurements."""
        factor = triangular_factor([np.column_stack([A, b])])
        U, size, Vt = np.linalg.svd(factor[:, :-1], full_matrices=False)
        rank = np.count_nonzero(size > 1e-11 * size[0])
        reduced = U[:, :rank].T @ factor[:, -1]
        rest = float(np.square(factor[:, -1] - U[:, :rank] @ reduced).sum())
        return cls(size[:rank, None] * Vt[:rank], reduced, rest, len(b))

    def rms(self, found: IdentificationResult) -> float:
        """Return RMS training error of what was found."""
        return float(np.sqrt((found.residual + self.rest) / self.count))


def fit(data: Condensed, leg: Leg, kind: str | Regularizer, **more: Any) -> IdentificationResult:
    """Return the fit with a regularizer by `gamma` or `residual_bound`, bodies in ellipsoids."""
    ellipsoids = None if isinstance(kind, PointMassEuclidean) else leg.ellipsoids
    return identify(data.A, data.b, leg.prior, regularizer=kind, ellipsoids=ellipsoids, **more)


def fit_points(
    data: Condensed, leg: Leg, points: PointMasses, residual: float, **more: Any
) -> IdentificationResult:
    """Return point masses of a residual or, if none have it, of slightly more than the least."""
    kind = PointMassEuclidean(points)
    try:
        return fit(data, leg, kind, residual_bound=residual, **more)
    except ArgumentError as error:
        if "minimum" not in error.evidence:
            raise
        bound = NEAR * error.evidence["minimum"]
        return fit(data, leg, kind, residual_bound=bound, **more)


def compare(
    data: Condensed, leg: Leg, points: PointMasses, **more: Any
) -> dict[str, IdentificationResult]:
    """Return entropic and Riemannian fits by γ, and the others at the residual of the first."""
    entropic = fit(data, leg, "entropic", gamma=GAMMA, **more)
    bound = entropic.residual
    return {
        "euclidean": fit(data, leg, "euclidean", residual_bound=bound, **more),
        "point_mass_euclidean": fit_points(data, leg, points, bound, **more),
        "pullback": fit(data, leg, "pullback", residual_bound=bound, **more),
        "entropic": entropic,
        "riemannian": fit(data, leg, Riemannian(starts=("entropic",)), gamma=GAMMA, **more),
    }
