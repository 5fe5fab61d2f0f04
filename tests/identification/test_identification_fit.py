"""Fits of physical and scalar parameters: exact shortcuts, a second solver, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from identified_bodies import TWO as PRIOR
from scipy.linalg import block_diag

from geodrake.errors import ArgumentError
from geodrake.identification import FitProblem, solve_fit
from geodrake.identification.problem import whitened_factor
from geodrake.inertia import from_mass_com_inertia, is_physical, pullback_metric


def example(seed, *, gamma=5.0, noise=1.0, rows=40, friction=2.0):
    """A fit of bodies and scalars; a smaller γ or larger noise drives it to the boundary."""
    rng = np.random.default_rng(seed)
    truth = np.append((PRIOR * rng.uniform(0.8, 1.2, PRIOR.shape)).ravel(), np.full(3, friction))
    A = rng.normal(size=(rows, 23)) * 10.0
    b = A @ truth + noise * rng.normal(size=rows)
    return FitProblem(
        factor=whitened_factor(A, b, sigma=noise),
        inertia_blocks=(0, 10),
        prior_mean=np.append(PRIOR.ravel(), np.zeros(3)),
        prior_information=block_diag(*(gamma * pullback_metric(PRIOR)), np.zeros((3, 3))),
        lower=np.append(np.full(20, -np.inf), np.zeros(3)),
    )


def entropic(problem, gamma):
    priors = {s: (problem.prior_mean[s : s + 10], gamma) for s in problem.inertia_blocks}
    return replace(
        problem, entropic=priors, prior_information=np.zeros_like(problem.prior_information)
    )


def in_deviations(result, other):
    return np.abs(result.x - other.x).max(initial=0.0) / result.standard_deviations().min()


WELL_INSIDE = {"gamma": 2000.0, "noise": 5.0}


@pytest.mark.parametrize("friction", [20.0, -1.0])
def test_shortcuts_agree_with_the_conic_program(friction):
    problem = example(2, friction=friction, **WELL_INSIDE)
    quick, conic = solve_fit(problem), solve_fit(problem, shortcuts=False)
    name = "closed form" if friction > 0 else "bounded least squares"
    assert (quick.solver, conic.solver) == (name, "clarabel")
    assert in_deviations(quick, conic) < 1e-6
    assert quick.active_bounds == conic.active_bounds
    assert (len(quick.active_bounds) > 0) == (friction < 0)
    assert quick.residual == pytest.approx(conic.residual, rel=1e-8)
    if not quick.active_bounds:
        R = problem.factor[:, :-1]
        normal = R.T @ R + problem.prior_information
        np.testing.assert_allclose(quick.information, normal, rtol=1e-10, atol=1e-8)
        deviations = np.sqrt(np.diag(np.linalg.inv(normal)))
        np.testing.assert_allclose(quick.standard_deviations(), deviations, rtol=1e-6)


def test_no_data_gives_the_prior_back():
    problem = example(5)
    empty = replace(problem, factor=np.zeros((1, problem.size + 1)))
    for problem in (empty, entropic(empty, 1.0)):
        result = solve_fit(problem)
        np.testing.assert_allclose(result.x[:20], problem.prior_mean[:20], rtol=1e-4, atol=1e-5)
        assert np.isinf(result.standard_deviations()[20:]).all()


def test_reference_stands_in_for_a_prior_without_mass():
    problem = example(6, rows=60)
    payload = np.append(np.zeros(10), problem.prior_mean[10:])
    with pytest.raises(ArgumentError, match=r"columns \[0\] have no physical reference"):
        replace(problem, prior_mean=payload, reference={})
    size = from_mass_com_inertia(1.0, np.zeros(3), 0.01 * np.eye(3))
    result = solve_fit(replace(problem, prior_mean=payload, reference={0: size, 10: PRIOR[1]}))
    assert is_physical(result.x[:10])
