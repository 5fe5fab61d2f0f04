"""Bodies to identify, fits of random data, and other frames and units."""

from dataclasses import replace

import numpy as np
from random_points import other_view
from scipy.linalg import block_diag, eigh

from geodrake.identification import FitProblem
from geodrake.identification.problem import LinearConstraints, whitened_factor
from geodrake.inertia import Ellipsoid, from_mass_com_inertia, pseudo_inertia
from geodrake.inertia.parameters import from_dual

THREE = from_mass_com_inertia(
    np.array([4.0, 2.5, 0.8]),
    np.array([[0.0, 0.02, 0.2], [0.05, 0.0, 0.15], [0.0, 0.0, 0.04]]),
    np.array([np.diag([0.06, 0.05, 0.02]), np.diag([0.03, 0.028, 0.01]), 0.002 * np.eye(3)]),
)
TWO = THREE[[0, 2]]


def random_data(seed, prior, *, rows, extra=0, noise=0.3, scale=(0.7, 1.4)):
    """Return regressor and measurements of scaled bodies, and of extra parameters of 2."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, prior.size + extra))
    phi = prior * rng.uniform(*scale, (len(prior), 1))
    return A, A @ np.append(phi.ravel(), np.full(extra, 2.0)) + noise * rng.normal(size=rows)


def restated(seed, prior, length, mass):
    """Return T of all bodies in other frames and units, one frame a body, and their prior."""
    rng = np.random.default_rng(seed)
    T = block_diag(*(other_view(rng, length, mass) for _ in prior))
    return T, (T @ prior.ravel()).reshape(prior.shape)


BODIES = tuple(range(0, THREE.size, 10))


def entropic_fit(seed, *, gamma=0.5, rows=24, scale=1.0, pull=1.0):
    """Return few rows and two bounded scalars; pull < 0 asks for negative masses."""
    A, b = random_data(seed, THREE, rows=rows, extra=2)
    free = np.full(THREE.size, np.inf)
    return FitProblem(
        factor=whitened_factor(scale * A, scale * pull * b),
        inertia_blocks=BODIES,
        prior_mean=np.append(THREE.ravel(), np.zeros(2)),
        prior_information=np.zeros((32, 32)),
        lower=np.append(-free, [0.0, -np.inf]),
        upper=np.append(free, [1.5, 4.0]),
        entropic={start: (phi, gamma) for start, phi in zip(BODIES, THREE, strict=True)},
    )


def constrained(problem):
    """Return a total mass, and ellipsoids of which some are active."""
    rows = np.zeros((4, problem.size))
    regions = Ellipsoid(THREE[:, 1:4] / THREE[:, :1], [0.25] * 3, np.eye(3))
    rows[:3, : THREE.size] = block_diag(*from_dual(regions.quadric))
    rows[3, list(BODIES)] = 1.0
    lower, upper = np.array([0.0, 0.0, 0.0, 8.0]), np.array([np.inf, np.inf, np.inf, 8.0])
    return replace(problem, constraints=LinearConstraints(matrix=rows, lower=lower, upper=upper))


def divergence(problem, x):
    """Return Σ γ Σ (c − log(1 + c)) over the eigenvalues c of P₀⁻¹ (P − P₀), exact near P₀."""
    value = 0.0
    for start, (phi, gamma) in problem.entropic.items():
        change = pseudo_inertia(x[start : start + 10] - phi)
        c = eigh(change, pseudo_inertia(phi), eigvals_only=True)
        value += gamma * (c - np.log1p(c)).sum()
    return value


def cost(problem, x):
    change = x - problem.prior_mean
    return (
        problem.residual(x) + change @ problem.prior_information @ change + divergence(problem, x)
    )
