"""Newton's method for entropic fits: second solvers, invariance, and extremes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example as with_example
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import BODIES, constrained, cost, entropic_fit
from identified_bodies import THREE as PRIOR

from geodrake.errors import ArgumentError
from geodrake.identification import solve_fit
from geodrake.identification.newton import solve_newton
from geodrake.inertia import is_physical


def information_difference(result, other):
    """Largest difference of an entry, relative to its row's and column's diagonal entries."""
    size = np.sqrt(np.diagonal(other.information))
    return np.abs((result.information - other.information) / np.outer(size, size)).max()


@pytest.mark.parametrize(
    ("seed", "kind"),
    [(0, "constrained"), (1, "plain"), (2, "with prior information"), (3, "constrained")],
)
def test_clarabel_and_scs_find_the_same(seed, kind):
    problem = entropic_fit(seed, gamma=0.05 * 10.0**seed, rows=40)
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
    gamma=st.floats(-12.0, 12.0),
    scale=st.floats(-4.0, 4.0),
    rows=st.sampled_from([2, 24, 60]),
    pull=st.sampled_from([1.0, -5.0, 0.0]),
)
@with_example(seed=167, gamma=6.0, scale=0.0, rows=2, pull=1.0)
@settings(max_examples=25)
def test_bodies_are_physical_at_every_extreme(seed, gamma, scale, rows, pull):
    """No γ, no amount of data and no wish for negative masses is too much."""
    problem = entropic_fit(seed, gamma=10.0**gamma, scale=10.0**scale, rows=rows, pull=pull)
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
    problem = entropic_fit(3, rows=60)
    factor = problem.factor.copy()
    factor[:, 31] = factor[:, 30]
    twins = replace(problem, factor=factor, lower=np.array(-np.inf), upper=np.array(np.inf))
    x = solve_newton(twins).x
    assert x[30] == pytest.approx(x[31], rel=1e-4)
    merged = replace(twins, factor=factor @ np.diag(np.append(np.ones(31), [0.0, 1.0])))
    assert cost(twins, x) == pytest.approx(cost(merged, solve_newton(merged).x), rel=1e-9)


def test_what_newton_refuses():
    problem = entropic_fit(11)
    with pytest.raises(ArgumentError, match=r"entropic or quadratic prior for every.*\[20\]"):
        priors = {start: problem.entropic[start] for start in BODIES[:2]}
        solve_newton(replace(problem, entropic=priors))
