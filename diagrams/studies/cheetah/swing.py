"""Measurements of the leg while it swings in the air, its base held fixed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from diagrams.studies.cheetah.leg import MEASURED, Array, Leg
from geodrake.logs import Motion

VISCOUS, COULOMB = 0.1, 1.0  # N·m·s/rad and N·m, every joint
TORQUE_NOISE, ENCODER_NOISE = 0.5, 2e-4  # N·m and rad, standard deviations
PERIOD, DURATION = 1e-3, 20.0  # s
SLOWEST = np.deg2rad(5.0)  # rad/s; friction is not known below


@dataclass(frozen=True, eq=False)
class Samples:
    """Filtered samples in which all joints move.

    Attributes:
        regressor: (N, 3, 60) of the inertial parameters.
        friction: (N, 3, 6) of the viscous and the Coulomb coefficients.
        torque: (N, 3) as measured for training, filtered for the test, N·m.
    """

    regressor: Array
    friction: Array
    torque: Array

    def rms(self, phi: Array, friction: Array) -> float:
        """RMS error of predicted torques, N·m."""
        predicted = self.regressor @ phi.ravel() + self.friction @ friction
        return float(np.sqrt(np.mean((predicted - self.torque) ** 2)))


def swing(time: Array, rng: np.random.Generator) -> Motion:
    """A leg swinging in the air: six random sines for each joint."""
    middle, reach = np.array([0.0, 0.5, -1.2]), np.array([0.35, 0.7, 0.7])
    rate, phase = 2 * np.pi * rng.uniform(0.2, 2.2, (6, 3)), rng.uniform(0, 2 * np.pi, (6, 3))
    size = reach * rng.uniform(0.2, 0.6, (6, 3)) / (1 + 0.075 * rate)
    angle = rate * time[:, None, None] + phase
    q = middle + (size * np.sin(angle)).sum(1)
    v, vd = (size * rate * np.cos(angle)).sum(1), -(size * rate**2 * np.sin(angle)).sum(1)
    return Motion(q, v, vd, time)


def measure(leg: Leg, rng: np.random.Generator) -> tuple[Samples, Samples]:
    """Training and test samples of the measured leg."""
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
