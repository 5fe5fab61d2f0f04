"""Projections onto slabs for every sample, by optimality and against the slow projection."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from random_points import random_point

from geodrake.manifolds import (
    Interval,
    PhysicalInertia,
    Polyhedron,
    Positive,
    Product,
    bregman_projection,
)
from geodrake.manifolds.slabs import TOLERANCE, slab_projection

ROBOT = Product(
    (PhysicalInertia(), Positive(2), PhysicalInertia(), Interval((-1.0,), (np.inf,))),
    (1.0, 0.5, 2.0, 3.0),
)


def slabs(rng, rows, scale=1.0):
    """A point outside, rows, values and tolerances, and a truth inside of the slabs."""
    x, truth = random_point(ROBOT, rng, 2)
    truth[:-1] *= scale
    A = rng.normal(size=(rows, ROBOT.dimension))
    tolerance = rng.uniform(0.01, 0.5, rows)
    return x, A, A @ truth + rng.uniform(-0.9, 0.9, rows) * tolerance, tolerance, truth


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.integers(1, 14), st.floats(-1.5, 1.5))
def test_it_is_the_projection_and_says_so(seed, rows, decades):
    """Checked with the manifold's own gradient, and by the Pythagorean inequality (2.2.12)."""
    x, A, b, epsilon, truth = slabs(np.random.default_rng(seed), rows, 10.0**decades)
    found = slab_projection(ROBOT, x, A, b - epsilon, b + epsilon)
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


def test_rows_that_repeat_or_say_nothing_change_no_projection():
    x, A, b, epsilon, _ = slabs(np.random.default_rng(1), 4)
    low, high = b - epsilon, b + epsilon
    rows, none = np.vstack([A, A, 0 * A]), np.ones(4)
    twice = slab_projection(ROBOT, x, rows, np.r_[low, low, -none], np.r_[high, high, none])
    once = slab_projection(ROBOT, x, A, b - epsilon, b + epsilon)
    assert once.certified
    assert twice.certified
    assert ROBOT.divergence(twice.point, once.point) < 1e-12
    slow = bregman_projection(ROBOT, x, Polyhedron(A, b - epsilon, b + epsilon))
    assert ROBOT.divergence(once.point, slow) < 1e-12


def test_slabs_that_no_point_is_in_are_told():
    x, A, b, epsilon, _ = slabs(np.random.default_rng(2), 2)
    mass = np.zeros((1, ROBOT.dimension))
    mass[0, 0] = 1.0
    for rows, values, width in (
        (mass, [-3.0], [0.1]),
        (np.vstack([A, A]), np.r_[b, b + 10.0], np.r_[epsilon, epsilon]),
    ):
        found = slab_projection(ROBOT, x, rows, np.subtract(values, width), np.add(values, width))
        assert not found.certified
        assert found.error == np.inf


def test_a_share_of_the_way_is_on_the_mirror_line():
    x, A, b, epsilon, truth = slabs(np.random.default_rng(3), 3)
    slabs_of = (ROBOT, x, A, b - epsilon, b + epsilon)
    whole, half = (slab_projection(*slabs_of, share=s).point for s in (1.0, 0.5))
    start, end = ROBOT.gradient(x), ROBOT.gradient(whole)
    np.testing.assert_allclose(ROBOT.gradient(half), 0.5 * (start + end), rtol=1e-7, atol=1e-7)
    assert ROBOT.divergence(truth, half) <= ROBOT.divergence(truth, x)
