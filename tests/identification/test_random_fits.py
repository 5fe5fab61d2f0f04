"""Random fits that are as ill-conditioned as can be, each in a process of its own: none may die.

    RANDOM_FITS=2000 pytest tests/identification/test_random_fits.py

Every fit ends in a physical answer or in a `GeodrakeError`, in time.
"""

import os
import resource
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

import numpy as np
import pytest
from measurements import DATA

from geodrake.errors import GeodrakeError, IdentificationError
from geodrake.identification import PointMasses, PointMassEuclidean, PointMassKL, identify
from geodrake.inertia import from_mass_com_inertia, is_physical, pseudo_inertia

FITS = int(os.environ.get("RANDOM_FITS", "6"))
SECONDS = 90  # of the processor, for a fit: four calls of a conic solver with 20 s each
SOLVERS = {None: 0.4, "newton": 0.18, "clarabel": 0.3, "scs": 0.12}
REGULARIZERS = {"euclidean": 0.2, "pullback": 0.3, "entropic": 0.2, "riemannian": 0.15}
REGULARIZERS |= {PointMassEuclidean: 0.075, PointMassKL: 0.075}
REGRESSORS = ("plain", "rank-deficient", "columns 1e±12", "zero columns", "near-copies", "few rows")
REGIONS = {"none": 0.4, "around": 0.2, "touching": 0.15, "tiny": 0.1, "huge": 0.05, "flat": 0.05}
REGIONS |= {"far": 0.05}


def pick(random, chances):
    return list(chances)[random.choice(len(chances), p=list(chances.values()))]


def power(random, low, high):
    return 10.0 ** random.uniform(low, high)


def random_bodies(random, count):
    """Return (count, 10) physical bodies, from milligrams to kilotonnes, some nearly flat."""
    masses = 10.0 ** random.uniform(-6.0, 6.0, count)
    if random.random() < 0.5:  # of one size, as in a robot
        masses = masses[0] * 10.0 ** random.uniform(-1.0, 1.0, count)
    bodies = []
    for mass in masses:
        size = power(random, -3.0, 1.0)
        axes = size * 10.0 ** (-random.uniform(0.0, 5.0, 3) * (random.random(3) < 0.3))
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        spread = (turn * axes**2) @ turn.T / 5.0
        inertia = mass * (np.trace(spread) * np.eye(3) - spread)
        bodies.append(from_mass_com_inertia(mass, size * random.normal(size=3), inertia))
    return np.array(bodies)


def random_regressor(random, p):
    """Return an (m, p) regressor of one of the kinds."""
    kind = random.choice(REGRESSORS)
    rows = int(random.integers(1, 8)) if kind == "few rows" else int(random.integers(p // 2, 3 * p))
    A = random.normal(size=(rows, p))
    if kind == "rank-deficient":
        rank = int(random.integers(1, max(2, min(A.shape))))
        A = A[:, :rank] @ random.normal(size=(rank, p))
    elif kind == "columns 1e±12":
        A *= 10.0 ** random.uniform(-12.0, 12.0, p)
    elif kind == "zero columns":
        A[:, random.random(p) < 0.5] = 0.0
    elif kind == "near-copies":
        A[:, 1:] = A[:, :1] + power(random, -15.0, -5.0) * A[:, 1:]
    return A * 10.0 ** random.choice([0.0, random.uniform(-9.0, 9.0)])


def random_regions(random, prior):
    """Return (n, 4, 4) ellipsoids of one of the kinds for a prior, or none."""
    kind = pick(random, REGIONS)
    if kind == "none":
        return None
    regions = []
    for P in pseudo_inertia(prior):
        mean = P[:3, 3] / P[3, 3]
        spread = P[:3, :3] / P[3, 3] - np.outer(mean, mean)
        scale = {"around": 5.0 * power(random, 0.0, 2.0), "touching": 3.0 + 1e-12}
        scale |= {"tiny": 3.0 * power(random, -8.0, 0.0), "huge": 3e10, "flat": 6.0}
        shape = np.linalg.inv(spread) / scale.get(kind, 5.0)
        if kind == "flat":
            turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
            shape += np.outer(turn[0], turn[0]) * np.trace(shape) * power(random, -3.0, 8.0)
        center = mean + (1e3 * random.normal(size=3) if kind == "far" else 0.0)
        side = shape @ center
        region = np.block([[-shape, side[:, None]], [side, 1.0 - center @ side]])
        regions.append(region * 10.0 ** random.choice([0.0, random.uniform(-8.0, 8.0)]))
    return np.array(regions)


def random_fit(seed, number):
    """Return arguments and options of `identify` for a seed and a number."""
    random = np.random.default_rng([seed, number])
    count, extra = int(random.integers(1, 6)), int(random.integers(0, 4) * random.integers(0, 2))
    prior = random_bodies(random, count)
    A = random_regressor(random, 10 * count + extra)
    truth = prior * random.uniform(0.3, 3.0, (count, 1))
    if random.random() < 0.2:
        truth = random_bodies(random, count)
    b = A @ np.append(truth.ravel(), random.normal(size=extra))
    noise = power(random, -12.0, 1.0) * (np.abs(b).max() + 1e-300)
    b = b + noise * random.normal(size=len(b))
    options = {"ellipsoids": random_regions(random, prior), "solver": pick(random, SOLVERS)}
    if random.random() < 0.3:
        options["total_mass"] = prior[:, 0].sum() * random.choice([1.0, 1.1, 1e-6, 1e6])
    if random.random() < 0.25:
        best = np.linalg.lstsq(A, b)[0], np.append(prior.ravel(), np.zeros(extra))
        floor, top = (float(np.square(A @ x - b).sum()) for x in best)
        options["residual_bound"] = floor + power(random, -9.0, 1.0) * (top - floor) or 1.0
    else:
        options["gamma"] = power(random, -12.0, 12.0)
    regularizer = options["regularizer"] = pick(random, REGULARIZERS)
    if not isinstance(regularizer, str):
        points = PointMasses.of_bodies(prior, 12)
        options["regularizer"], prior = regularizer(points), points.parameters()
        options["solver"] = None if options["solver"] == "newton" else options["solver"]
    return (A, b, prior), options


def solve(seed, number):
    """Return how a fit ends in this process."""
    arguments, options = random_fit(seed, number)
    try:
        found = identify(*arguments, **options)
    except GeodrakeError:
        return "refused"
    except BaseException as error:  # whatever it is, it is counted
        return f"raised {error!r}"
    numbers = np.concatenate([found.phi.ravel(), found.extra, [found.residual]])
    whole = np.isfinite(numbers).all() and np.all(is_physical(found.phi))
    return "solved" if whole else "unphysical"


def limit_this_process():
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))


def end_of(seed, number):
    """Return how a fit ends in a process of its own."""
    with ProcessPoolExecutor(1, get_context("fork"), limit_this_process) as apart:
        try:
            return apart.submit(solve, seed, number).result()
        except BrokenProcessPool:
            return "died or hung"


@pytest.mark.parametrize("number", range(FITS))
def test_random_fit(number):
    assert end_of(1, number) in ("solved", "refused")


@pytest.mark.measurements("data/solver_abort.npz")
@pytest.mark.parametrize("solver", [None, "newton", "clarabel"])
def test_what_once_ended_the_process(solver):
    data = np.load(DATA / "solver_abort.npz")
    options = {"gamma": float(data["gamma"]), "ellipsoids": data["ellipsoids"], "solver": solver}
    found = identify(data["A"], data["b"], data["prior"], regularizer="pullback", **options)
    assert np.all(is_physical(found.phi))
    cost = found.residual + found.gamma * found.divergence
    assert cost == pytest.approx(0.0039647747, rel=1e-3)  # at the boundary


def test_bodies_too_flat_to_measure_are_rounding_and_no_mistake_of_arguments():
    arguments, options = random_fit(58, 1430)
    try:
        found = identify(*arguments, **options, certify=False)
    except IdentificationError as error:
        assert "Rounding errors leave no solution" in str(error)
    else:
        assert np.all(is_physical(found.phi)) and np.isfinite(found.divergence)
