"""Newton's method for entropic fits: second solvers, invariance, extremes, the two forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example as with_example
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import THREE as PRIOR
from identified_bodies import random_data, restated
from scipy.linalg import block_diag, eigh

from geodrake.errors import ArgumentError
from geodrake.identification import FitProblem, solve_fit
from geodrake.identification.identify import identify
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import LinearConstraints, whitened_factor
from geodrake.inertia import (
    Ellipsoid,
    from_dual,
    is_physical,
    pseudo_inertia,
)

BODIES = tuple(range(0, PRIOR.size, 10))


def example(seed, *, gamma=0.5, rows=24, extra=2, scale=1.0, pull=1.0, **changes):
    """Fewer rows than parameters, and two bounded scalars; pull < 0 asks for negative masses."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, PRIOR.size + extra))
    truth = np.append((PRIOR * rng.uniform(0.7, 1.4, (3, 1))).ravel(), np.full(extra, 2.0))
    b = pull * (A @ truth) + 0.3 * rng.normal(size=rows)
    p = len(truth)
    free = np.full(PRIOR.size, np.inf)
    problem = FitProblem(
        factor=whitened_factor(scale * A, scale * b),
        inertia_blocks=BODIES,
        prior_mean=np.append(PRIOR.ravel(), np.zeros(extra)),
        prior_information=np.zeros((p, p)),
        lower=np.append(-free, [0.0, -np.inf][:extra]),
        upper=np.append(free, [1.5, 4.0][:extra]),
        entropic={start: (phi, gamma) for start, phi in zip(BODIES, PRIOR, strict=True)},
    )
    return replace(problem, **changes)


def constrained(problem):
    """A total mass, and ellipsoids of which some are active."""
    rows = np.zeros((4, problem.size))
    regions = Ellipsoid(PRIOR[:, 1:4] / PRIOR[:, :1], [0.25] * 3, np.eye(3))
    rows[:3, : PRIOR.size] = block_diag(*from_dual(regions.quadric))
    rows[3, list(BODIES)] = 1.0
    lower, upper = np.array([0.0, 0.0, 0.0, 8.0]), np.array([np.inf, np.inf, np.inf, 8.0])
    return replace(problem, constraints=LinearConstraints(matrix=rows, lower=lower, upper=upper))


def divergence(problem, x):
    """Σ γ Σ (c − log(1 + c)) over the eigenvalues c of P₀⁻¹ (P − P₀), exact where P is near P₀."""
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


def relative_difference(phi, other):
    """Largest eigenvalue of P(φ)⁻¹ (P(φ′) − P(φ)), which depends on no frame and no unit."""
    ratio = np.linalg.solve(pseudo_inertia(phi), pseudo_inertia(other))
    return np.abs(np.linalg.eigvals(ratio) - 1.0).max()


def information_difference(result, other):
    """Largest difference of an entry, relative to its row's and column's diagonal entries."""
    size = np.sqrt(np.diagonal(other.information))
    return np.abs((result.information - other.information) / np.outer(size, size)).max()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["plain", "constrained", "with prior information"])
def test_clarabel_and_scs_find_the_same(seed, kind):
    problem = example(seed, gamma=0.05 * 10.0**seed, rows=40)
    if kind == "constrained":
        problem = constrained(problem)
    if kind == "with prior information":
        root = np.random.default_rng(seed).normal(size=(5, problem.size))
        problem = replace(problem, prior_information=root.T @ root)
    newton, conic = solve_newton(problem), solve_fit(problem)
    assert (newton.solver, conic.solver) == ("newton", "clarabel")
    assert cost(problem, newton.x) == pytest.approx(cost(problem, conic.x), rel=1e-8)
    assert newton.active_bounds == conic.active_bounds
    assert newton.active_blocks == conic.active_blocks == ()
    assert information_difference(newton, conic) < 1e-3
    scs = solve_fit(problem, solver="scs")
    assert cost(problem, newton.x) == pytest.approx(cost(problem, scs.x), rel=1e-5)


@given(
    seed=st.integers(0, 10_000),
    length=st.floats(0.05, 20.0),
    mass=st.floats(0.05, 20.0),
    power=st.floats(-4.0, 6.0),
)
@settings(max_examples=25)
def test_invariance_under_frames_and_units(seed, length, mass, power):
    """The same bodies, whatever frame and units their parameters are stated in."""
    T, prior = restated(seed, PRIOR, length, mass)
    A, b = random_data(seed, PRIOR, rows=24)
    options = {"regularizer": "entropic", "gamma": 10.0**power, "solver": "newton"}
    first = identify(A, b, PRIOR, **options)
    other = identify(A @ np.linalg.inv(T), b, prior, **options)
    back = np.linalg.solve(T, other.phi.ravel()).reshape(3, 10)
    assert relative_difference(first.phi, back) < 1e-6
    assert is_physical(first.phi).all() and is_physical(other.phi).all()


@given(
    seed=st.integers(0, 10_000),
    gamma=st.floats(-12.0, 12.0),
    scale=st.floats(-4.0, 4.0),
    rows=st.sampled_from([2, 24, 60]),
    pull=st.sampled_from([1.0, -5.0, 0.0]),
)
@with_example(seed=167, gamma=6.0, scale=0.0, rows=2, pull=1.0)
@settings(max_examples=60)
def test_bodies_are_physical_at_every_extreme(seed, gamma, scale, rows, pull):
    """No γ, no amount of data and no wish for negative masses is too much."""
    problem = example(seed, gamma=10.0**gamma, scale=10.0**scale, rows=rows, pull=pull)
    x = solve_newton(problem).x
    assert is_physical(x[:30].reshape(3, 10)).all()
    assert (x >= problem.lower).all() and (x <= problem.upper).all()
    prior = np.append(PRIOR.ravel(), np.clip(0.0, problem.lower[30:], problem.upper[30:]))
    least = cost(problem, x)
    left = 1e-7 * least + 1e-12 * 10.0**gamma  # what solve_newton says of its minimum
    assert np.isfinite(least) and cost(problem, prior) >= least - left
    rng = np.random.default_rng(seed)
    for size in np.logspace(-8, -1, 8):
        other = x + size * (prior - x) * rng.uniform(0.0, 1.0, len(x))
        if is_physical(other[:30].reshape(3, 10)).all():
            assert cost(problem, other) >= least - left


def test_rank_deficient_scalars_stay_where_they_do_nothing():
    problem = example(3, rows=60)
    factor = problem.factor.copy()
    factor[:, 31] = factor[:, 30]
    twins = replace(problem, factor=factor, lower=np.array(-np.inf), upper=np.array(np.inf))
    x = solve_newton(twins).x
    assert x[30] == pytest.approx(x[31], rel=1e-4)
    merged = replace(twins, factor=factor @ np.diag(np.append(np.ones(31), [0.0, 1.0])))
    assert cost(twins, x) == pytest.approx(cost(merged, solve_newton(merged).x), rel=1e-9)


def test_what_newton_refuses():
    problem = example(11)
    with pytest.raises(ArgumentError, match=r"entropic or quadratic prior for every.*\[20\]"):
        priors = {start: problem.entropic[start] for start in BODIES[:2]}
        solve_newton(replace(problem, entropic=priors))
