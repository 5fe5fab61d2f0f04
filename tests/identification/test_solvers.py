"""Solvers of fits against each other, invariance, extremes, certificates, and their processes."""

import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example as with_example
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import BODIES, THREE, TWO, constrained, cost, entropic_fit, random_data
from scipy.linalg import block_diag, expm
from scipy.optimize import minimize

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification import (
    REGULARIZERS,
    BodyConstraints,
    Riemannian,
    conic_fit,
    identify,
    solve_fit,
)
from geodrake.identification.conic_fit import build_fit, certified
from geodrake.identification.coordinates import SYMMETRIC_BASIS
from geodrake.identification.newton import solve_newton
from geodrake.identification.riemannian import half_squared_logs, log_derivatives
from geodrake.identification.solvers import LostProcessError, in_subprocess, solve_in_subprocess
from geodrake.inertia import from_mass_com_inertia, is_physical, pseudo_inertia, pullback_metric


def information_difference(result, other):
    """Return the largest difference of an entry, relative to the diagonal entries."""
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
    prior = np.append(THREE.ravel(), np.clip(0.0, problem.lower[30:], problem.upper[30:]))
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


PRIOR_AND_FRICTION = np.append(TWO.ravel(), 0.0)


def data(seed, *, rows=12, **options):
    """Return fewer rows than parameters."""
    return random_data(seed, TWO, rows=rows, **options)


def squared_distance(phi):
    """Return ½ Σ log² λ by generalized eigenvalues, one body at a time."""
    total = 0.0
    for body, prior in zip(phi, TWO, strict=True):
        ratios = np.linalg.eigvals(np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(body)))
        if ratios.real.min() <= 0:
            return np.inf
        total += 0.5 * np.sum(np.log(ratios.real) ** 2)
    return total


def own_cost(x, A, b, gamma):
    """Return the cost as in the source, without any of the package's coordinates."""
    if not is_physical(x[:20].reshape(2, 10)).all():
        return 1e12
    return np.sum((A @ x - b) ** 2) + gamma * squared_distance(x[:20].reshape(2, 10))


@given(seed=st.integers(0, 10_000), spread=st.floats(1e-3, 1.5))
@settings(max_examples=6)
def test_derivatives_are_those_of_finite_differences(seed, spread):
    V = np.random.default_rng(seed).normal(size=(5, 4, 4)) * spread
    S, h = np.array([expm(0.5 * (v + v.T)) for v in V]), 1e-5
    gradient, hessian = log_derivatives(S)
    for k, basis in enumerate(SYMMETRIC_BASIS):
        size = h * np.linalg.eigvalsh(S)[:, 0, None]
        step = size[..., None] * basis
        slope = (half_squared_logs(S + step) - half_squared_logs(S - step)) / (2 * size[:, 0])
        np.testing.assert_allclose(
            gradient[:, k], slope, rtol=1e-6, atol=1e-6 * np.abs(gradient).max()
        )
        change = (log_derivatives(S + step)[0] - log_derivatives(S - step)[0]) / (2 * size)
        np.testing.assert_allclose(hessian[:, k], change, atol=1e-6 * np.abs(hessian).max())


def test_another_optimizer_finds_the_same():
    """BFGS minimizes the source's own cost over the parameters themselves."""
    A, b = data(0, extra=1)
    result = identify(A, b, TWO, regularizer="riemannian", gamma=0.3)
    x = np.append(result.phi.ravel(), result.extra)
    found = result.residual + 0.3 * result.divergence
    assert found == pytest.approx(own_cost(x, A, b, 0.3), rel=1e-9)
    root = block_diag(*np.linalg.inv(np.linalg.cholesky(pullback_metric(TWO))), [[1.0]])
    other = minimize(
        lambda y: own_cost(PRIOR_AND_FRICTION + root.T @ y, A, b, 0.3), np.zeros(21), method="BFGS"
    )
    assert found <= other.fun * (1 + 1e-9)
    assert found == pytest.approx(other.fun, rel=1e-6)
    assert is_physical(result.phi).all() and result.minima.strict


def test_several_minima_are_found_and_reported():
    """A mass measured weakly and far away: light near the prior, or heavy near the data.

    Where the mass alone is measured, the nearest bodies differ in nothing else, and the cost is
    one of the mass m alone.
    """
    prior = from_mass_com_inertia(1.0, np.zeros(3), 0.01 * np.eye(3))[None]
    measured, sigma = 24.6, np.sqrt(120.0)
    masses = np.exp(np.linspace(-3, 5, 200_001))
    costs = ((masses - measured) / sigma) ** 2 + 0.5 * np.log(masses) ** 2
    lowest = np.flatnonzero((costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:])) + 1
    assert len(lowest) == 2
    arguments = (np.eye(10)[:1], [measured], prior)
    options = {"gamma": 1.0, "sigma": sigma}
    result = identify(*arguments, regularizer=Riemannian(), **options)
    best = lowest[np.argmin(costs[lowest])]
    assert result.phi[0, 0] == pytest.approx(masses[best], rel=1e-3)
    assert not result.minima.agree and result.minima.distinct == 2
    np.testing.assert_allclose(
        np.unique(result.minima.costs.round(6)), np.sort(costs[lowest]), rtol=1e-4
    )
    assert len(result.minima.starts) == 4


def moved(fit, share):
    """The fit with masses that are off by a share, and the cost that belongs to them."""
    x = fit.x.copy()
    x[0:30:10] *= 1.0 + share
    return replace(fit, x=x)


@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_what_is_reported_is_certified(regularizer):
    A, b = random_data(2, THREE, rows=45, extra=2, scale=(0.6, 1.5))
    b -= A[:, 30]  # of a scalar that is 1, and will be at its bound
    options = {"regularizer": regularizer, "extra_bounds": [[0.0, 0.5], [0.0, 9.0]]}
    first = identify(A, b, THREE, gamma=0.5, **options)
    bound = identify(A, b, THREE, residual_bound=1.2 * first.residual, **options)
    for found in (first, bound):
        told = found.certificate
        assert told.holds and not told.replaced and told.solver == "clarabel"
        assert told.scope == ("local" if regularizer == "riemannian" else "global")
        assert told.gap < 1e-6 * told.cost and "certified by clarabel" in found.notes[-1]
    assert identify(A, b, THREE, gamma=0.5, certify=False, **options).certificate is None


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

    monkeypatch.setattr(conic_fit, "solve_in_subprocess", fails)
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
    b = A @ THREE.ravel()
    heavier = BodyConstraints(total_mass=30.0)
    found = identify(A, b, THREE, regularizer="riemannian", gamma=1e-3, constraints=heavier)
    assert found.phi[:, 0].sum() == pytest.approx(30.0)
    told = found.certificate
    assert told.scope == "local" and not told.holds and "not convex" in told.failure


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (os.abort, "ended with signal SIGABRT"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), "ended with signal SIGSEGV"),
        (lambda: os._exit(10), "ended with exit code 10"),
        (lambda: os._exit(0), "ended with exit code 0"),
        (lambda: time.sleep(10), "did not finish in 0.2 s"),
        (lambda: 1 / 0, "raised ZeroDivisionError: division by zero"),
        (lambda: (_ for _ in ()).throw(SystemExit("assertion")), "raised SystemExit: assertion"),
    ],
    ids=["abort", "segfault", "exit", "silent exit", "hang", "error", "SystemExit"],
)
def test_a_lost_process_is_told(work, words, monkeypatch):
    fork, children = os.fork, []

    def counted():
        child = fork()
        children.append(child)
        return child

    monkeypatch.setattr(os, "fork", counted)
    with pytest.raises(LostProcessError, match=words):
        in_subprocess(work, seconds=0.2 if "did not finish" in words else 20.0)
    (child,) = children
    with pytest.raises(ChildProcessError):  # it is gone, and waited for
        os.waitpid(child, os.WNOHANG)


def test_answers_of_another_process_are_whole(capfd):
    assert in_subprocess(lambda: None, seconds=20.0) is None
    values = np.arange(1e5)
    np.testing.assert_array_equal(in_subprocess(lambda: 2.0 * values, seconds=20.0), 2.0 * values)

    def refuse():
        os.write(1, b"what a solver prints")
        raise ArgumentError("No.", advice="Take another.", minimum=np.ones(2))

    with pytest.raises(ArgumentError, match=r"^No\. Take another\.$") as caught:
        in_subprocess(refuse, seconds=20.0)
    np.testing.assert_array_equal(caught.value.evidence["minimum"], np.ones(2))
    assert capfd.readouterr() == ("", "")


def test_a_solver_that_dies_is_asked_for_less_once():
    def die_first(accuracies):
        if len(accuracies) > 1:
            os.abort()
        return len(accuracies)

    assert solve_in_subprocess(die_first, "clarabel") == 1
    with pytest.raises(IdentificationError, match="its process ended with signal SIGABRT"):
        solve_in_subprocess(lambda _: os.abort(), "clarabel")


def test_an_answer_comes_whatever_handlers_the_caller_has():
    """Children may be reaped elsewhere; signals that the caller blocks stay as they were."""
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        assert in_subprocess(lambda: 42, seconds=30.0) == 42
    finally:
        signal.signal(signal.SIGCHLD, before)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == blocked
