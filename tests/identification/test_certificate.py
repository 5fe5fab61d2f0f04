"""What the MathematicalProgram of a fit says of it: that it is the minimum, or that it is not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import THREE as PRIOR
from identified_bodies import constrained, cost, entropic_fit, random_data

from geodrake.errors import IdentificationError
from geodrake.identification import REGULARIZERS, BodyConstraints, conic_fit, identify
from geodrake.identification.conic_fit import build_fit, certified
from geodrake.identification.newton import solve_newton


def moved(fit, share):
    """The fit with masses that are off by a share, and the cost that belongs to them."""
    x = fit.x.copy()
    x[0:30:10] *= 1.0 + share
    return replace(fit, x=x)


@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_what_is_reported_is_certified(regularizer):
    A, b = random_data(2, PRIOR, rows=45, extra=2, scale=(0.6, 1.5))
    b -= A[:, 30]  # of a scalar that is 1, and will be at its bound
    options = {"regularizer": regularizer, "extra_bounds": [[0.0, 0.5], [0.0, 9.0]]}
    first = identify(A, b, PRIOR, gamma=0.5, **options)
    bound = identify(A, b, PRIOR, residual_bound=1.2 * first.residual, **options)
    for found in (first, bound):
        told = found.certificate
        assert told.holds and not told.replaced and told.solver == "clarabel"
        assert told.scope == ("local" if regularizer == "riemannian" else "global")
        assert told.gap < 1e-6 * told.cost and "certified by clarabel" in found.notes[-1]
    assert identify(A, b, PRIOR, gamma=0.5, certify=False, **options).certificate is None


def test_a_fit_that_is_no_minimum_gives_way_to_that_of_the_program():
    problem = constrained(entropic_fit(1, gamma=0.5, rows=40))
    fit = solve_newton(problem)
    told = certified(problem, moved(fit, 1e-2))  # the total mass is wrong
    assert told.certificate.replaced and told.certificate.holds and told.solver == "clarabel"
    assert "violating constraints" in told.note
    np.testing.assert_allclose(told.x, fit.x, rtol=1e-5, atol=1e-7)
    free = entropic_fit(1, gamma=0.5, rows=40)
    better = certified(free, moved(solve_newton(free), 1e-2))
    assert better.certificate.replaced and "above the minimum cost" in better.note
    assert cost(free, better.x) < cost(free, moved(solve_newton(free), 1e-2).x)


def test_no_fit_is_certified_without_a_solution_of_the_program(monkeypatch):
    problem = entropic_fit(1, gamma=0.5, rows=40)
    fit = solve_newton(problem)

    def fails(*_):
        raise IdentificationError("No digits are left.")

    monkeypatch.setattr(conic_fit, "solved_apart", fails)
    told = certified(problem, fit)
    assert told.x is fit.x and np.isinf(told.certificate.gap) and not told.certificate.holds
    assert told.certificate.violation < 1e-9 and "could not certify" in told.notes[-1]
    assert "No digits are left" in told.notes[-1]


@settings(max_examples=4)
@given(st.integers(0, 999), st.floats(-4.0, 4.0), st.floats(1e-5, 0.3))
def test_the_gap_bounds_how_far_any_parameters_are_from_the_least_cost(seed, log_gamma, share):
    problem = entropic_fit(seed, gamma=10.0**log_gamma, rows=40)
    fit = solve_newton(problem)
    wrong = moved(fit, share)
    program = build_fit(problem, centre=fit.x)
    here = program.evaluated(wrong.x)[0]
    there = program.evaluated(fit.x)[0]
    assert here - there == pytest.approx(
        cost(problem, wrong.x) - cost(problem, fit.x), rel=1e-6, abs=1e-9 * program.cost_scale
    )
    told = certified(problem, fit)
    assert told.certificate.holds and not told.certificate.replaced


def test_a_minimum_around_which_the_cost_is_not_convex_is_not_certified():
    A = np.vstack([np.eye(30)[1:], np.zeros(30)])  # nothing but a bound holds the first mass
    b = A @ PRIOR.ravel()
    heavier = BodyConstraints(total_mass=30.0)
    found = identify(A, b, PRIOR, regularizer="riemannian", gamma=1e-3, constraints=heavier)
    assert found.phi[:, 0].sum() == pytest.approx(30.0)
    told = found.certificate
    assert told.scope == "local" and not told.holds and "not convex" in told.failure
