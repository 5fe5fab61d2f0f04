"""Measurements of the arm's random point-to-point motions, and what fits need of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from diagrams.studies.ambidex.arm import (
    COULOMB,
    REACH,
    REDUCTION,
    VISCOUS,
    Arm,
    Array,
    friction_regressor,
)
from geodrake.inertia import equivalent_ellipsoid
from geodrake.logs import Motion
from geodrake.robot.reduction import triangular_factor

MOTIONS, DURATION, PERIOD = 47, 1.3, 0.01  # s
TRAINING, TESTING = 4100, 2000  # samples
TORQUE_NOISE = 0.005  # N·m, of a motor
UNEVEN = 0.5  # share of Coulomb friction, RMS, that depends on the position
WAVES = 4.0  # of that friction in a turn of the arm
ENCODER_NOISE = 1e-3  # rad, of a motor
WINDOW, ORDER = 35, 5  # of the Savitzky-Golay filter
LINKS = 100  # columns of the links


@dataclass(frozen=True, eq=False)
class Measurements:
    """Arrays that fits and their tests need, nothing of Drake.

    Attributes:
        bodies: (N, 7, 170) regressor of links and rotors, of the training samples.
        friction: (N, 7, 14) regressor of friction.
        torque: (N, 7) motor torques as measured, N·m.
        full: Triangular factor of [bodies | friction | torque].
        test: Triangular factor of the same of the test samples, whose torque is filtered.
        test_rows: Number of its rows before.
        wrench: (T, 6, 100) regressor of the wrench on the ground, of every fifth test sample.
        truth: (17, 10) the parameters behind the measurements.
        hulls: (17, 4, 4) matrices Q of ellipsoids that hold all mass of a body.
    """

    bodies: Array
    friction: Array
    torque: Array
    full: Array
    test: Array
    test_rows: int
    wrench: Array
    truth: Array
    hulls: Array

    def test_rms(self, phi: Array, friction: Array) -> float:
        """RMS error of the motor torques of the test samples, N·m."""
        x = np.concatenate([phi.ravel(), friction, [-1.0]])
        return float(np.linalg.norm(self.test @ x) / np.sqrt(self.test_rows))

    def wrenches(self, phi: Array) -> Array:
        """(T, 6) wrenches on the ground."""
        return self.wrench @ phi.ravel()[:LINKS]


def point_to_point(arm: Arm, rng: np.random.Generator) -> Motion:
    """47 motor motions of 1.3 s at 100 Hz of least jerk, one after another."""
    ends = arm.motors(rng.uniform(-REACH, REACH, (MOTIONS + 1, 7)))
    count = round(DURATION / PERIOD)
    s = np.arange(count) / count
    share = np.stack([10 * s**3 - 15 * s**4 + 6 * s**5, 30 * (s - s * s) ** 2])
    curve = 60 * s * (1 - s) * (1 - 2 * s)
    way = np.diff(ends, axis=0)[:, None]
    q = ends[:-1, None] + share[0][:, None] * way
    v = share[1][:, None] * way / DURATION
    vd = curve[:, None] * way / DURATION**2
    return Motion(*(x.reshape(-1, 7) for x in (q, v, vd)))


def uneven_friction(motion: Motion, rng: np.random.Generator) -> Array:
    """Friction (N, 7) that no parameter explains: it depends on the position, as the source found.

    At full data it makes up most of the test error of 0.012 N·m there, and of ours.
    """
    turn = WAVES * motion.q / REDUCTION + rng.uniform(0.0, 2.0 * np.pi, 7)
    return np.sqrt(2.0) * UNEVEN * COULOMB * np.sin(turn) * np.sign(motion.v)


def smoothed(position: Array) -> Motion:
    """Motion of measured motor positions, as in the source: filtered, then differentiated."""
    q = savgol_filter(position, WINDOW, ORDER, axis=0)
    v = savgol_filter(position, WINDOW, ORDER, deriv=1, delta=PERIOD, axis=0)
    return Motion(q, v, np.gradient(v, PERIOD, axis=0))


def measure(arm: Arm, *, seed: int, hull: float) -> Measurements:
    """Simulated measurements: exact motions, with noise of torques and encoders.

    Args:
        arm: The arm.
        seed: Of motions and noise.
        hull: Semi-axes of the hulls over those of the bodies' equivalent uniform ellipsoids.
    """
    rng = np.random.default_rng([seed, 0])
    motion = point_to_point(arm, rng)
    friction = friction_regressor(motion.v) @ np.concatenate([COULOMB, VISCOUS])
    torque = arm.regressor(motion) @ arm.phi.ravel() + friction
    torque = torque + uneven_friction(motion, rng) + rng.normal(0.0, TORQUE_NOISE, torque.shape)
    seen = smoothed(motion.q + rng.normal(0.0, ENCODER_NOISE, motion.q.shape))
    bodies, friction = arm.regressor(seen), friction_regressor(seen.v)
    first, last = slice(0, TRAINING), slice(-TESTING, None)
    quiet = savgol_filter(torque[last], WINDOW, ORDER, axis=0)
    every = Motion(*(x[last][::5] for x in (seen.q, seen.v, seen.vd)))
    return Measurements(
        bodies=bodies[first],
        friction=friction[first],
        torque=torque[first],
        full=factor_of(bodies[first], friction[first], torque[first]),
        test=factor_of(bodies[last], friction[last], quiet),
        test_rows=quiet.size,
        wrench=arm.wrench_regressor(every),
        truth=arm.phi,
        hulls=equivalent_ellipsoid(arm.phi).scaled(hull).quadric,
    )


def factor_of(*columns: Array) -> Array:
    """Triangular factor of rows with several blocks of columns (N, 7, n), the last ones (N, 7).

    Columns of zeros, which no motion excites, stay out of the factorization.
    """
    rows = np.concatenate([*columns[:-1], columns[-1][..., None]], axis=2)
    rows = rows.reshape(-1, rows.shape[2])
    seen = np.flatnonzero(rows.any(axis=0))
    factor = np.zeros((len(seen), rows.shape[1]))
    factor[:, seen] = triangular_factor([rows[:, seen]])
    return factor
