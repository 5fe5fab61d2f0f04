"""Bodies to identify, random data of them, and other frames and units to state them in."""

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from geodrake.inertia import change_frame, from_mass_com_inertia

THREE = from_mass_com_inertia(
    np.array([4.0, 2.5, 0.8]),
    np.array([[0.0, 0.02, 0.2], [0.05, 0.0, 0.15], [0.0, 0.0, 0.04]]),
    np.array([np.diag([0.06, 0.05, 0.02]), np.diag([0.03, 0.028, 0.01]), 0.002 * np.eye(3)]),
)
TWO = THREE[[0, 2]]


def random_data(seed, prior, *, rows, extra=0, noise=0.3, scale=(0.7, 1.4)):
    """Regressor and measurements of bodies whose parameters are scaled, and of extra ones of 2."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, prior.size + extra))
    phi = prior * rng.uniform(*scale, (len(prior), 1))
    return A, A @ np.append(phi.ravel(), np.full(extra, 2.0)) + noise * rng.normal(size=rows)


def frames_and_units(seed, count, length, mass):
    """Random changes of frame of bodies, one a body, to other units: matrices (10, 10) of φ."""
    rng = np.random.default_rng(seed)
    units = mass * np.repeat([1.0, length, length**2], [1, 3, 6])
    turns = ((Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 0.3) for _ in range(count))
    return [(change_frame(np.eye(10), R, p) * units).T for R, p in turns]


def restated(seed, prior, length, mass):
    """T of all bodies in other frames and units, and their prior there."""
    T = block_diag(*frames_and_units(seed, len(prior), length, mass))
    return T, (T @ prior.ravel()).reshape(prior.shape)
