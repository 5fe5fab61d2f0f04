"""Projections onto slabs for every sample, against other solvers and by optimality."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geodrake.inertia import from_pseudo_inertia
from geodrake.inertia.kernels import BASIS
from geodrake.manifolds import (
    Interval,
    PhysicalInertia,
    Positive,
    Product,
)
from geodrake.manifolds.slabs import TOLERANCE, slab_projection

ROBOT = Product(
    (PhysicalInertia(), Positive(2), PhysicalInertia(), Interval((-1.0,), (np.inf,))),
    (1.0, 0.5, 2.0, 3.0),
)
"""What a robot has: bodies and lower bounds."""
some = settings(max_examples=15)


def point(rng, scale=1.0):
    """A point of ROBOT."""
    roots = rng.normal(size=(2, 4, 4))
    phi = scale * from_pseudo_inertia(roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(4))
    return np.concatenate(
        [phi[0], scale * np.exp(rng.normal(size=2)), phi[1], [-1.0 + np.exp(rng.normal())]]
    )


def slabs(rng, rows, scale=1.0):
    """A point outside, rows, values and tolerances, and a truth inside of the slabs."""
    x, truth = point(rng), point(rng, scale)
    A = rng.normal(size=(rows, ROBOT.dimension))
    tolerance = rng.uniform(0.01, 0.5, rows)
    return x, A, A @ truth + rng.uniform(-0.9, 0.9, rows) * tolerance, tolerance, truth


@some
@given(st.integers(0, 2**31), st.integers(1, 14), st.floats(-1.5, 1.5))
def test_it_is_the_projection_and_says_so(seed, rows, decades):
    """Checked with the manifold's own gradient, and by the Pythagorean inequality (2.2.12)."""
    x, A, b, epsilon, truth = slabs(np.random.default_rng(seed), rows, 10.0**decades)
    found = slab_projection(ROBOT, x, A, b, epsilon)
    y = found.point
    if not found.certified:  # after 40 steps, of one in ten that are far from x
        assert decades > 0.3 and found.steps == 40
        return
    assert 0 <= found.steps <= 40
    assert ROBOT.contains(y)
    lengths = np.sqrt(((A @ ROBOT.calc_frame(y)) ** 2).sum(1))
    off = (A @ y - b) / lengths
    assert (np.abs(off) <= epsilon / lengths + 2 * TOLERANCE).all()
    # ∇h(y) − ∇h(x) = Aᵀ λ, with λ from least squares, of the rows at an edge alone.
    moved = ROBOT.gradient(y) - ROBOT.gradient(x)
    binding = np.abs(np.abs(off) - epsilon / lengths) < 1e-6
    held, *_ = np.linalg.lstsq(
        (A[binding] @ ROBOT.calc_frame(y)).T, ROBOT.calc_frame(y).T @ moved, rcond=None
    )
    rest = ROBOT.calc_frame(y).T @ (moved - A[binding].T @ held)
    assert np.linalg.norm(rest) < 1e-6 * (1.0 + np.linalg.norm(ROBOT.calc_frame(y).T @ moved))
    if binding.sum() <= 5:  # each pushes inward
        assert (held * off[binding] <= 1e-6 * np.abs(held).max(initial=0.0)).all()
    before = ROBOT.divergence(truth, x)
    after = ROBOT.divergence(truth, y) + ROBOT.divergence(y, x)
    assert after <= before * (1 + 1e-7) + 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_it_agrees_with_cvxpy(seed):
    """min −log det P(y) + tr(P(x)⁻¹ P(y)) over the slabs, and Σ (r − log r) of the bounded ones."""
    cp = pytest.importorskip("cvxpy")
    x, A, b, epsilon, _ = slabs(np.random.default_rng(seed), 4)
    z, cost, constraints = cp.Variable(ROBOT.dimension), 0.0, []
    for first, weight in ((0, 1.0), (12, 2.0)):
        inverse = np.linalg.inv(np.tensordot(x[first : first + 10], BASIS, 1))
        P = cp.Variable((4, 4), symmetric=True)
        constraints.append(sum(z[first + k] * BASIS[k] for k in range(10)) == P)
        cost += weight * (cp.trace(inverse @ P) - cp.log_det(P))
    for at, lower, weight in ((10, 0.0, 0.5), (11, 0.0, 0.5), (22, -1.0, 3.0)):
        ratio = (z[at] - lower) / (x[at] - lower)
        cost += weight * (ratio - cp.log(ratio))
    problem = cp.Problem(cp.Minimize(cost), [*constraints, cp.abs(A @ z - b) <= epsilon])
    problem.solve(solver=cp.CLARABEL)
    y = slab_projection(ROBOT, x, A, b, epsilon).point
    assert ROBOT.divergence(y, x) <= ROBOT.divergence(z.value, x) + 1e-6
    assert ROBOT.divergence(y, z.value) < 1e-6


def test_rows_that_repeat_or_say_nothing():
    x, A, b, epsilon, _ = slabs(np.random.default_rng(1), 2)
    twice = slab_projection(
        ROBOT, x, np.vstack([A, A, 0 * A]), np.r_[b, b, 0 * b], np.r_[epsilon, epsilon, epsilon]
    )
    once = slab_projection(ROBOT, x, A, b, epsilon)
    assert twice.certified
    assert ROBOT.divergence(twice.point, once.point) < 1e-12


def test_slabs_that_no_point_is_in_are_told():
    x, A, b, epsilon, _ = slabs(np.random.default_rng(2), 2)
    mass = np.zeros((1, ROBOT.dimension))
    mass[0, 0] = 1.0
    for rows, values, width in (
        (mass, [-3.0], [0.1]),
        (np.vstack([A, A]), np.r_[b, b + 10.0], np.r_[epsilon, epsilon]),
    ):
        found = slab_projection(ROBOT, x, rows, np.asarray(values), np.asarray(width))
        assert not found.certified
        assert found.error == np.inf


def test_a_share_of_the_way_is_on_the_mirror_line():
    x, A, b, epsilon, truth = slabs(np.random.default_rng(3), 3)
    whole, half = (slab_projection(ROBOT, x, A, b, epsilon, share=s).point for s in (1.0, 0.5))
    start, end = ROBOT.gradient(x), ROBOT.gradient(whole)
    np.testing.assert_allclose(ROBOT.gradient(half), 0.5 * (start + end), rtol=1e-7, atol=1e-7)
    assert ROBOT.divergence(truth, half) <= ROBOT.divergence(truth, x)
