"""One draw of the AMBIDEX study: a prior, stretches of data, and every regularizer on each."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass

import numpy as np

from diagrams.studies.ambidex.arm import Array, perturbed, point_masses
from diagrams.studies.ambidex.measurements import LINKS, Measurements, factor_of
from geodrake.errors import IdentificationError
from geodrake.identification import (
    IdentificationResult,
    PointMassEuclidean,
    PointMassKL,
    Regularizer,
    Riemannian,
    identify,
)
from geodrake.inertia import riemannian_distance
from geodrake.inertia.ellipsoids import ellipsoid_of_quadric
from geodrake.robot import zero_moment_point

NAMES = (
    "euclidean",
    "point_mass_euclidean",
    "point_mass_kl",
    "pullback",
    "entropic",
    "riemannian",
)
"""In the order of the figures."""


@dataclass(frozen=True)
class Plan:
    """What is to be done.

    Attributes:
        draws: Number of draws.
        counts: Numbers of training samples.
        gamma: γ of the entropic divergence, (N·m)²; the other regularizers get its residual.
        delta: Share δ of its mass by which a prior is off, at most.
        hull: Semi-axes of hulls over those of the equivalent uniform ellipsoids.
        seed: Of everything random.
    """

    draws: int
    counts: tuple[int, ...]
    gamma: float
    delta: float
    hull: float
    seed: int


@dataclass(frozen=True)
class Row:
    """One fit.

    Attributes:
        draw: Number of the draw.
        samples: Number of training samples, 0 for the prior.
        regularizer: Its name; "prior" for no fit.
        training: RMS error of the motor torques on the training samples, N·m; None for the prior.
        test: RMS error of the motor torques on the test samples, N·m.
        rigid: RMS difference from the torques of the true bodies on the test motions, N·m.
        distance: Geodesic distance of all links from the true ones.
        zmp: Mean distance of the predicted zero-moment point from the true one, m.
        gamma: γ that belongs to the solution, (N·m)² over the unit of the distance.
        at_boundary: Number of bodies at the boundary of physical consistency.
        seconds: CPU time of the fit, s.
    """

    draw: int
    samples: int
    regularizer: str
    training: float | None
    test: float
    rigid: float
    distance: float
    zmp: float
    gamma: float | None
    at_boundary: int
    seconds: float


def run_draw(draw: int, *, plan: Plan, measured: Measurements) -> list[dict[str, object]]:
    """All fits of one draw as rows of a table; a fit that fails is left out."""
    rng, prior = prior_of(draw, plan, measured)
    points = point_masses(prior, ellipsoid_of_quadric(measured.hulls), rng)
    kinds: dict[str, Regularizer | str] = {
        "euclidean": "euclidean",
        "pullback": "pullback",
        "riemannian": Riemannian(starts=("entropic",)),
        "point_mass_euclidean": PointMassEuclidean(points),
        "point_mass_kl": PointMassKL(points),
    }
    friction = full_friction(prior, plan, measured)
    rows = [row_of(measured, prior, friction, (draw, 0, "prior"))]
    for count in plan.counts:
        data = training_data(draw, count, friction, plan, measured)
        begin = time.process_time()
        entropic = fit(data, prior, "entropic", measured, gamma=plan.gamma)
        name = (draw, count, "entropic")
        rows.append(row_of(measured, entropic, friction, name, time.process_time() - begin))
        for kind, regularizer in kinds.items():
            begin = time.process_time()
            try:
                found = compared(data, points.parameters(), regularizer, measured, entropic)
            except IdentificationError:
                continue
            seconds = time.process_time() - begin
            rows.append(row_of(measured, found, friction, (draw, count, kind), seconds))
    return [asdict(row) for row in rows]


def prior_of(draw: int, plan: Plan, measured: Measurements) -> tuple[np.random.Generator, Array]:
    """Random numbers of a draw, and its prior (17, 10)."""
    rng = np.random.default_rng([plan.seed, 1 + draw])
    return rng, perturbed(measured.truth, rng, plan.delta)


def full_friction(prior: Array, plan: Plan, measured: Measurements) -> Array:
    """Friction parameters (14,) identified from all training samples, as the source fixes them."""
    A, b = measured.full[:, :-1], measured.full[:, -1]
    return identify(
        A,
        b,
        prior,
        regularizer="entropic",
        gamma=plan.gamma,
        ellipsoids=measured.hulls,
        extra_bounds=np.tile([0.0, np.inf], (A.shape[1] - prior.size, 1)),
        solver="newton",
    ).extra


def training_data(
    draw: int, count: int, friction: Array, plan: Plan, measured: Measurements
) -> Array:
    """Triangular factor of [bodies | torque without friction] of consecutive random samples."""
    if count == len(measured.torque):
        bodies, rest = np.split(measured.full, [measured.truth.size], axis=1)
        return np.column_stack([bodies, rest[:, -1] - rest[:, :-1] @ friction])
    rng = np.random.default_rng([plan.seed, 1 + draw, count])
    start = int(rng.integers(0, len(measured.torque) - count + 1))
    part = slice(start, start + count)
    torque = measured.torque[part] - measured.friction[part] @ friction
    return factor_of(measured.bodies[part], torque)


def fit(
    data: Array,
    prior: Array,
    regularizer: str | Regularizer,
    measured: Measurements,
    *,
    gamma: float | None = None,
    residual_bound: float | None = None,
) -> IdentificationResult:
    """A fit to a triangular factor, with all bodies inside their hulls."""
    by_points = isinstance(regularizer, PointMassEuclidean | PointMassKL)
    return identify(
        data[:, :-1],
        data[:, -1],
        prior,
        regularizer=regularizer,
        gamma=gamma,
        residual_bound=residual_bound,
        ellipsoids=None if by_points else measured.hulls,
        solver="newton" if gamma is not None else "clarabel",
    )


def compared(
    data: Array,
    prior: Array,
    regularizer: str | Regularizer,
    measured: Measurements,
    entropic: IdentificationResult,
) -> IdentificationResult:
    """A fit to be compared with the entropic one ([Lee2019] §3.5.1).

    At the same training residual; with the Riemannian distance, which is not convex, with the same
    γ (Eq. (3.5.53)).
    """
    if isinstance(regularizer, Riemannian):
        return fit(data, prior, regularizer, measured, gamma=entropic.gamma)
    try:
        return fit(data, prior, regularizer, measured, residual_bound=entropic.residual)
    except IdentificationError:
        # A solver that got stuck finds its way from a bound that is the same to five digits.
        bound = entropic.residual * (1 + 5e-6)
        return fit(data, prior, regularizer, measured, residual_bound=bound)


def row_of(
    measured: Measurements,
    found: IdentificationResult | Array,
    friction: Array,
    name: tuple[int, int, str],
    seconds: float = 0.0,
) -> Row:
    """The table's row of a fit, or of a prior (17, 10)."""
    fitted = isinstance(found, IdentificationResult)
    phi = found.phi if fitted else found
    draw, samples, regularizer = name
    change = (phi - measured.truth).ravel()
    rigid = np.linalg.norm(measured.test[:, : change.size] @ change) / np.sqrt(measured.test_rows)
    links = LINKS // 10
    truth = measured.truth[:links]
    miss = zmp(measured, phi) - zmp(measured, measured.truth)
    return Row(
        draw=draw,
        samples=samples,
        regularizer=regularizer,
        training=float(np.sqrt(found.residual / (7 * samples))) if fitted else None,
        test=measured.test_rms(phi, friction),
        rigid=float(rigid),
        distance=float(np.linalg.norm(riemannian_distance(phi[:links], truth))),
        zmp=float(np.linalg.norm(miss, axis=1).mean()),
        gamma=found.gamma if fitted else None,
        at_boundary=len(found.active_blocks) if fitted else 0,
        seconds=seconds,
    )


def zmp(measured: Measurements, phi: Array) -> Array:
    """(T, 2) zero-moment points on the ground of every fifth test sample, m."""
    return zero_moment_point(measured.wrenches(phi))
