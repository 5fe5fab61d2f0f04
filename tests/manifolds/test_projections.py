"""Bregman projections onto polyhedra and slabs, against other solvers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions
from random_points import random_inertia, random_point

from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.inertia import Ellipsoid
from geodrake.inertia.ellipsoids import realizability_row
from geodrake.inertia.parameters import pseudo_inertia_basis
from geodrake.manifolds import (
    ConstrainedInertia,
    Free,
    Interval,
    PhysicalInertia,
    Polyhedron,
    Positive,
    Product,
    affine_set,
    bregman_projection,
    halfspace,
    slab,
)
from geodrake.manifolds.slabs import TOLERANCE, slab_projection

SEEDS = st.integers(0, 2**32 - 1)
HULL = Ellipsoid(np.array([0.2, -0.1, 0.0]), np.array([14.0, 15.0, 16.0]), np.eye(3))
CONSTRAINED = ConstrainedInertia(realizability_row(HULL.quadric)[None], np.zeros(1), 0.7)
MANIFOLDS = {
    "interval": Interval((-1.0, 0.0, 0.0), (1.0, 5.0, 2.0)),
    "inertia": PhysicalInertia(),
    "constrained": CONSTRAINED,
    "product": Product((PhysicalInertia(), Positive(2), Free(1)), (2.0, 0.5, 1.0)),
}


def random_set(inside, rng):
    """A polyhedron of any kind around a point, and whether it is flat."""
    k, kind = rng.integers(1, 4), rng.integers(0, 4)
    A = rng.normal(size=(k, len(inside)))
    value, width = A @ inside, rng.uniform(0.01, 0.5, (2, k))
    if kind == 0:
        return affine_set(A[:2], value[:2]), True
    lower, upper = value - width[0], value + width[1]
    if kind == 1:
        return Polyhedron(A, lower, np.full(k, np.inf)), False
    if kind == 2:
        return slab(A[0], lower[0], upper[0]), False
    lower[0] = upper[0] = value[0]
    return Polyhedron(np.concatenate([A, A]), np.tile(lower, 2), np.tile(upper, 2)), False


@pytest.mark.parametrize("manifold", MANIFOLDS.values(), ids=MANIFOLDS)
@settings(max_examples=25)
@given(seed=SEEDS)
def test_pythagorean_inequality(manifold, seed):
    rng = np.random.default_rng(seed)
    x, truth = random_point(manifold, rng, 2)
    constraints, flat = random_set(truth, rng)
    y = bregman_projection(manifold, x, constraints)
    assert manifold.contains(y)
    assert constraints.violation(y).max() < 1e-9
    before, after = manifold.divergence(truth, x), manifold.divergence(truth, y)
    moved = manifold.divergence(y, x)
    assert before >= after + moved - 1e-9 * (1 + before)  # [Lee2019] Eq. (2.2.12)
    if flat:  # there it is an equation
        assert before == pytest.approx(after + moved, rel=1e-8)
    stays = bregman_projection(manifold, truth, constraints)
    np.testing.assert_allclose(stays, truth, atol=1e-12 * np.abs(truth).max())


@settings(max_examples=15)
@given(SEEDS)
def test_half_space_projections_are_those_onto_polyhedra(seed):
    """Of one body, of all bodies, and of parameters of all kinds together."""
    rng = np.random.default_rng(seed)
    factors = (
        PhysicalInertia(),
        Positive(1),
        PhysicalInertia(),
        Interval((-1.0, 0.0), (1.0, 5.0)),
        CONSTRAINED,
    )
    manifold = Product(factors, (1.0, 1.0, 2.0, 0.5, 1.0))
    n, x = manifold.dimension, random_point(manifold, rng)
    mass, total, skewed, everything = np.zeros((4, n))
    mass[0] = total[[0, 11]] = 1.0
    skewed[:10], skewed[11:21] = rng.normal(size=(2, 10))
    everything[:] = rng.normal(size=n)
    for a in (mass, total, skewed, everything):
        limit = a @ x - rng.uniform(0.05, 0.3)
        y = slab_projection(manifold, x, a[None], np.array([-np.inf]), np.array([limit])).point
        assert a @ y == pytest.approx(limit, rel=1e-9, abs=1e-9)
        nearest = bregman_projection(manifold, x, halfspace(-a, -limit))
        assert manifold.divergence(y, nearest) < 1e-12


@pytest.mark.parametrize("seed", range(2))
def test_polyhedra_of_inertias_against_clarabel(seed):
    rng = np.random.default_rng(seed)
    x, inside = random_inertia(rng, 2)
    A = rng.normal(size=(4, 10))
    lower, upper = A @ inside - 0.05, A @ inside + 0.1
    program = MathematicalProgram()
    phi = program.NewContinuousVariables(10)
    basis = pseudo_inertia_basis()
    P = np.array(
        [[sum(c * p for c, p in zip(basis[:, i, j], phi, strict=True) if c) for j in range(4)]
         for i in range(4)]
    )  # fmt: skip
    program.AddMaximizeLogDeterminantCost(P)
    program.AddLinearCost(-PhysicalInertia().gradient(x), 0.0, phi)
    program.AddLinearConstraint(A, lower, upper, phi)
    precise = SolverOptions()
    for tolerance in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
        precise.SetOption(ClarabelSolver.id(), tolerance, 1e-12)
    theirs = ClarabelSolver().Solve(program, None, precise).GetSolution(phi)
    ours = bregman_projection(PhysicalInertia(), x, Polyhedron(A, lower, upper))
    divergence = PhysicalInertia().divergence
    assert divergence(theirs, ours) < 1e-9  # theirs moves by 1e-10 with the last digit of its input
    assert divergence(ours, x) <= divergence(theirs, x) * (1 + 1e-10)


@settings(max_examples=15)
@given(SEEDS, st.floats(-5.0, 5.0))
def test_bodies_may_be_orders_of_magnitude_from_where_they_are_to_be(seed, decades):
    rng = np.random.default_rng(seed)
    x, inside = random_inertia(rng, 2)
    constraints, _ = random_set(10.0**decades * inside, rng)
    y = bregman_projection(PhysicalInertia(), x, constraints)
    size = np.abs(constraints.matrix).max() * np.abs(y).max()
    assert constraints.violation(y).max() <= 1e-9 * size


def test_rows_that_barely_bind():
    """Where an interior-point method alone is only as precise as the root of its gap."""
    rng = np.random.default_rng(5)
    for _ in range(10):
        x, inside = random_inertia(rng, 2)
        a, other = rng.normal(size=(2, 10))
        a *= np.sign(a @ inside - a @ x)
        y = bregman_projection(PhysicalInertia(), x, halfspace(a, a @ inside))
        both = Polyhedron(np.stack([a, other]), [a @ inside, other @ y], [np.inf, np.inf])
        again = bregman_projection(PhysicalInertia(), x, both)
        np.testing.assert_allclose(again, y, atol=1e-9 * np.abs(y).max())


class TestBadInput:
    X = random_inertia(np.random.default_rng(0))

    @pytest.mark.parametrize(
        "constraints",
        [
            halfspace(-np.eye(10)[0], 1.0),  # a mass below −1
            affine_set(np.eye(10)[0], 0.0),  # a mass of zero: on the edge only
            Polyhedron(np.eye(10)[[0, 0]], [2.0, -np.inf], [np.inf, 1.0]),  # an empty polyhedron
        ],
    )
    def test_nothing_to_project_onto(self, constraints):
        with pytest.raises(ConvergenceError, match=r"did not converge.*signs and units") as caught:
            bregman_projection(PhysicalInertia(), self.X, constraints)
        assert caught.value.evidence["violation"].max() > 0

    def test_contradictory_equations(self):
        rows = np.stack([np.eye(10)[0], 2 * np.eye(10)[0]])
        with pytest.raises(ArgumentError, match="inconsistent"):
            bregman_projection(PhysicalInertia(), self.X, affine_set(rows, [1.0, 3.0]))
        y = bregman_projection(PhysicalInertia(), self.X, affine_set(rows, [1.0, 2.0]))
        assert y[0] == pytest.approx(1.0)


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
