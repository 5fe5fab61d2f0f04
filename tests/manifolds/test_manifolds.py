"""Manifolds: axioms, steps, mirrors, and Bregman projections against other solvers."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions
from random_points import (
    CONSTRAINED,
    PRODUCT,
    other_view,
    random_inertia,
    random_point,
    round_inertia,
)

from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.inertia import Ellipsoid, pseudo_inertia
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

MIXED = Interval((0.0, -1.0, -np.inf, -np.inf), (np.inf, 2.0, 3.0, np.inf))
ROBOT = Product((PhysicalInertia(), Positive(2), PhysicalInertia()), (1.0, 0.5, 2.0))
MANIFOLDS = {
    "positive": Positive(3),
    "mixed": MIXED,
    "inertia": PhysicalInertia(),
    "constrained": CONSTRAINED,
    "product": PRODUCT,
    "robot": ROBOT,
}
on_every_manifold = pytest.mark.parametrize("manifold", MANIFOLDS.values(), ids=MANIFOLDS)


def numerical_gradient(function, x, step=1e-5):
    return np.stack(
        [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(x.size)], -1
    )


@on_every_manifold
class TestAxioms:
    def test_gradient_and_metric_are_derivatives(self, manifold):
        points = random_point(manifold, np.random.default_rng(1), 2)
        assert manifold.contains(points).all()
        together = zip(
            points, manifold.barrier(points), manifold.gradient(points), manifold.metric(points),
            strict=True,
        )  # fmt: skip
        for x, barrier, gradient, metric in together:
            assert manifold.barrier(x) == pytest.approx(barrier)
            expected = numerical_gradient(manifold.barrier, x)
            np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-6)
            expected = numerical_gradient(manifold.gradient, x)
            np.testing.assert_allclose(metric, expected, rtol=1e-5, atol=1e-6)

    def test_inverse_metric(self, manifold):
        rng = np.random.default_rng(2)
        x, b = random_point(manifold, rng, 5), rng.normal(size=(5, manifold.dimension))
        solved = np.linalg.solve(manifold.metric(x), b[..., None])[..., 0]
        np.testing.assert_allclose(manifold.inverse_metric_times(x, b), solved, rtol=1e-7)

    def test_divergence_is_the_bregman_divergence(self, manifold):
        rng = np.random.default_rng(3)
        x, y = random_point(manifold, rng, 2, 50)
        expected = manifold.barrier(x) - manifold.barrier(y)
        expected = expected - (manifold.gradient(y) * (x - y)).sum(-1)
        np.testing.assert_allclose(manifold.divergence(x, y), expected, rtol=1e-9, atol=1e-9)
        assert (manifold.divergence(x, y[0]) > 0).all()
        np.testing.assert_allclose(manifold.divergence(x, x), 0.0, atol=1e-12)

    def test_barrier_and_divergence_grow_without_limit_at_the_edge(self, manifold):
        rng = np.random.default_rng(7)
        x, v = random_point(manifold, rng), rng.normal(size=manifold.dimension)
        time = manifold.longest_step(x, v)
        near = x + (time * (1 - 10.0 ** -np.arange(3, 10)))[:, None] * v
        weight = 0.5  # least weight of a logarithm of these manifolds, times log 10
        assert (np.diff(manifold.barrier(near)) > weight).all()
        assert (np.diff(manifold.divergence(near, x)) > weight).all()
        assert (np.diff(manifold.divergence(x, near)) > 1e2).all()
        norms = np.linalg.norm(manifold.gradient(near), axis=-1)
        np.testing.assert_allclose(norms[1:] / norms[:-1], 10.0, rtol=0.2)


@on_every_manifold
class TestSteps:
    def test_longest_step_ends_at_the_edge(self, manifold):
        rng = np.random.default_rng(6)
        x, v = random_point(manifold, rng, 30), rng.normal(size=(30, manifold.dimension))
        time = manifold.longest_step(x, v)
        ends = np.isfinite(time)
        assert ends.any()
        before, after = np.where(ends, time, 1e9) * [[1 - 1e-6], [1 + 1e-6]]
        assert manifold.contains(x + before[:, None] * v).all()
        assert not manifold.contains(x + after[:, None] * v)[ends].any()

    def test_retraction_stays_inside_however_long_the_step(self, manifold):
        rng = np.random.default_rng(8)
        x, v = random_point(manifold, rng, 20), rng.normal(size=(20, manifold.dimension))
        for length in (1e-6, 1.0, 1e3, 1e6, 1e12):
            assert manifold.contains(manifold.retract(x, length * v)).all()
        for _ in range(12):  # again and again in one direction, which ends close to the edge
            x = manifold.retract(x, v)
            assert manifold.contains(x).all()
            assert np.isfinite(manifold.barrier(x)).all()

    def test_retraction_is_the_step_to_first_order(self, manifold):
        rng = np.random.default_rng(9)
        x, v = random_point(manifold, rng), rng.normal(size=manifold.dimension)
        np.testing.assert_allclose(manifold.retract(x, 0 * v), x, rtol=1e-13)
        errors = [
            np.abs(manifold.retract(x, s * v) - x - s * v).max() / s for s in (1e-2, 1e-3, 1e-4)
        ]
        assert all(later <= 0.2 * earlier + 1e-9 for earlier, later in itertools.pairwise(errors))

    @settings(max_examples=15)
    @given(seed=st.integers(0, 2**31), size=st.floats(-12, 3))
    def test_a_natural_step_is_the_retraction_along_the_gradient(self, manifold, seed, size):
        rng = np.random.default_rng(seed)
        x, b = random_point(manifold, rng), rng.normal(size=manifold.dimension)
        time = 10.0**size
        expected = manifold.retract(x, -time * manifold.inverse_metric_times(x, b))
        step = manifold.natural_step(x, b, time)
        assert manifold.contains(step)
        if time < 0.1:
            moved = np.abs(expected - x) + np.abs(x)
            np.testing.assert_allclose(step, expected, rtol=0, atol=1e-9 * moved.max())
        np.testing.assert_array_equal(manifold.natural_step([x, x], [0 * b] * 2, 0.3), [x, x])


@on_every_manifold
class TestMirrors:
    @settings(max_examples=15)
    @given(seed=st.integers(0, 2**31), size=st.floats(-3, 0.5))
    def test_a_span_adds_covectors_to_gradients(self, manifold, seed, size):
        """∇h(y) = ∇h(x) + Aᵀ λ, [Lee2019] Eq. (2.2.11); where there is no y, none is given."""
        rng = np.random.default_rng(seed)
        x, rows = random_point(manifold, rng), rng.normal(size=(2, manifold.dimension))
        span, multipliers = manifold.calc_mirror_span(x, rows), rng.normal(size=2)
        expected = rows @ np.linalg.solve(manifold.metric(x), rows.T)
        np.testing.assert_allclose(span.products, expected, rtol=1e-8, atol=1e-9)
        multipliers *= 10.0**size / np.sqrt(multipliers @ span.products @ multipliers)
        y = span.point(multipliers)
        if not manifold.contains(y):
            assert 10.0**size > 0.7  # root of the least weight of a logarithm: no edge is nearer
            return
        wanted = manifold.gradient(x) + multipliers @ rows
        terms = np.abs(manifold.gradient(y)) + np.abs(manifold.gradient(x)) + np.abs(wanted)
        assert np.abs(manifold.gradient(y) - wanted).max() < 1e-7 * terms.max()

    def test_a_point_comes_back_from_its_gradient(self, manifold):
        x, near = random_point(manifold, np.random.default_rng(15), 2)
        y = manifold.calc_point_of_gradient(manifold.gradient(x), near)
        np.testing.assert_allclose(y, x, rtol=1e-7, atol=1e-9)


def test_a_product_is_its_factors():
    """In its barrier, which the axioms derive the rest from, and in the steps."""
    rng = np.random.default_rng(0)
    x, b = random_point(PRODUCT, rng), rng.normal(size=PRODUCT.dimension)
    ends = np.cumsum([factor.dimension for factor in PRODUCT.manifolds])[:-1]
    parts = list(zip(PRODUCT.manifolds, np.split(x, ends), np.split(b, ends), strict=True))
    barriers = [factor.barrier(x) for factor, x, _ in parts]
    assert PRODUCT.barrier(x) == pytest.approx(np.dot(PRODUCT.weights, barriers), rel=1e-9)
    retracted = np.concatenate([factor.retract(x, b) for factor, x, b in parts])
    np.testing.assert_allclose(PRODUCT.retract(x, b), retracted, rtol=1e-8, atol=1e-12)
    x[3] = 1e3
    assert not PRODUCT.contains(x)


@settings(max_examples=60)
@given(st.integers(0, 2**31), st.floats(-16, 2))
def test_bodies_that_count_as_physical_at_sight_are(seed, size):
    """`contains` looks at eigenvalues only where Cholesky's decomposition leaves a doubt."""
    rng = np.random.default_rng(seed)
    x = random_inertia(rng) + 10.0**size * rng.normal(size=10)
    least = np.linalg.eigvalsh(pseudo_inertia(x))[0]
    assert PhysicalInertia().contains(x) == (least > 0) or abs(least) < 1e-13
    x[rng.integers(10)] = rng.choice([np.nan, np.inf, -np.inf])
    assert not PhysicalInertia().contains(x)


@pytest.mark.parametrize("name", ["positive", "inertia"])
def test_retraction_follows_geodesics(name):
    """They have constant speed, and are shorter than the straight line between their ends."""
    manifold, rng = MANIFOLDS[name], np.random.default_rng(11)
    x, v = random_point(manifold, rng), 0.3 * rng.normal(size=manifold.dimension)
    times = np.linspace(0, 1, 201)[:, None]

    def speeds(path):
        steps, middles = np.diff(path, axis=0), 0.5 * (path[1:] + path[:-1])
        return np.sqrt(np.einsum("ki,kij,kj->k", steps, manifold.metric(middles), steps))

    path = manifold.retract(x, times * v)
    along = speeds(path)
    np.testing.assert_allclose(along, along.mean(), rtol=1e-3)
    assert along.sum() < speeds(x + times * (path[-1] - x)).sum()


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_nothing_about_inertias_knows_frame_or_units(seed, metre, kilogram):
    rng = np.random.default_rng(seed)
    view = other_view(rng, metre, kilogram)
    x, y, z = round_inertia(rng, 3)
    v, b = y - z, rng.normal(size=10)
    covector = np.linalg.solve(view.T, b)
    normals = 7.0 * CONSTRAINED.normals @ np.linalg.inv(view)
    seen = ConstrainedInertia(normals, 7.0 * CONSTRAINED.offsets, CONSTRAINED.weight)
    for before, after in ((PhysicalInertia(), PhysicalInertia()), (CONSTRAINED, seen)):
        assert after.divergence(view @ x, view @ y) == pytest.approx(before.divergence(x, y), 1e-8)
        assert after.longest_step(view @ x, view @ v) == pytest.approx(
            before.longest_step(x, v), 1e-8
        )
        for then, now in (
            (before.retract(x, v), after.retract(view @ x, view @ v)),
            (before.inverse_metric_times(x, b), after.inverse_metric_times(view @ x, covector)),
        ):
            back = np.linalg.solve(view, now)
            np.testing.assert_allclose(back, then, rtol=0, atol=1e-8 * np.abs(then).max())


@pytest.mark.parametrize(
    ("manifold", "outside"),
    [
        (Positive(2), [1.0, 0.0]),
        (Free(1), [np.nan]),
        (MIXED, [1.0, 2.0, 0.0, 0.0]),
        (PhysicalInertia(), np.zeros(10)),
    ],
)
def test_edges_are_outside(manifold, outside):
    assert not manifold.contains(outside)


@pytest.mark.parametrize("step", [1e-15, -1e-12, 3e-8, 1e-5, 9.9e-4, -1.01e-3])
def test_divergence_of_close_points_is_not_lost_in_rounding(step):
    x = 1.0 + step
    exact, ratio = 0.0, x - 1.0
    for k in range(12, 1, -1):  # r − log(1 + r) = Σ (−r)ᵏ / k
        exact += (-ratio) ** k / k
    assert Positive().divergence([x], [1.0]) == pytest.approx(exact, rel=1e-9)


SEEDS = st.integers(0, 2**32 - 1)
HULL = Ellipsoid(np.array([0.2, -0.1, 0.0]), np.array([14.0, 15.0, 16.0]), np.eye(3))
LIMITED = ConstrainedInertia(realizability_row(HULL.quadric)[None], np.zeros(1), 0.7)
PROJECTING = {
    "interval": Interval((-1.0, 0.0, 0.0), (1.0, 5.0, 2.0)),
    "inertia": PhysicalInertia(),
    "constrained": LIMITED,
    "product": Product((PhysicalInertia(), Positive(2), Free(1)), (2.0, 0.5, 1.0)),
}


def random_set(inside, rng):
    """Return a polyhedron of any kind around a point, and whether it is flat."""
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


@pytest.mark.parametrize("manifold", PROJECTING.values(), ids=PROJECTING)
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
        LIMITED,
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


MIXED = Product(
    (PhysicalInertia(), Positive(2), PhysicalInertia(), Interval((-1.0,), (np.inf,))),
    (1.0, 0.5, 2.0, 3.0),
)


def slabs(rng, rows, scale=1.0):
    """Return a point outside, rows with values and tolerances, and a truth inside the slabs."""
    x, truth = random_point(MIXED, rng, 2)
    truth[:-1] *= scale
    A = rng.normal(size=(rows, MIXED.dimension))
    tolerance = rng.uniform(0.01, 0.5, rows)
    return x, A, A @ truth + rng.uniform(-0.9, 0.9, rows) * tolerance, tolerance, truth


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.integers(1, 14), st.floats(-1.5, 1.5))
def test_it_is_the_projection_and_says_so(seed, rows, decades):
    """Checked with the manifold's own gradient, and by the Pythagorean inequality (2.2.12)."""
    x, A, b, epsilon, truth = slabs(np.random.default_rng(seed), rows, 10.0**decades)
    found = slab_projection(MIXED, x, A, b - epsilon, b + epsilon)
    y = found.point
    if not found.certified:  # after 40 steps, of one in ten that are far from x
        assert decades > 0.3 and found.steps == 40
        return
    assert 0 <= found.steps <= 40
    assert MIXED.contains(y)
    lengths = np.sqrt(((A @ MIXED.calc_frame(y)) ** 2).sum(1))
    off = (A @ y - b) / lengths
    assert (np.abs(off) <= epsilon / lengths + 2 * TOLERANCE).all()
    # ∇h(y) − ∇h(x) = Aᵀ λ, with λ from least squares, of the rows at an edge alone.
    moved = MIXED.gradient(y) - MIXED.gradient(x)
    binding = np.abs(np.abs(off) - epsilon / lengths) < 1e-6
    held, *_ = np.linalg.lstsq(
        (A[binding] @ MIXED.calc_frame(y)).T, MIXED.calc_frame(y).T @ moved, rcond=None
    )
    rest = MIXED.calc_frame(y).T @ (moved - A[binding].T @ held)
    assert np.linalg.norm(rest) < 1e-6 * (1.0 + np.linalg.norm(MIXED.calc_frame(y).T @ moved))
    if binding.sum() <= 5:  # each pushes inward
        assert (held * off[binding] <= 1e-6 * np.abs(held).max(initial=0.0)).all()
    before = MIXED.divergence(truth, x)
    after = MIXED.divergence(truth, y) + MIXED.divergence(y, x)
    assert after <= before * (1 + 1e-7) + 1e-9


def test_rows_that_repeat_or_say_nothing_change_no_projection():
    x, A, b, epsilon, _ = slabs(np.random.default_rng(1), 4)
    low, high = b - epsilon, b + epsilon
    rows, none = np.vstack([A, A, 0 * A]), np.ones(4)
    twice = slab_projection(MIXED, x, rows, np.r_[low, low, -none], np.r_[high, high, none])
    once = slab_projection(MIXED, x, A, b - epsilon, b + epsilon)
    assert once.certified
    assert twice.certified
    assert MIXED.divergence(twice.point, once.point) < 1e-12
    slow = bregman_projection(MIXED, x, Polyhedron(A, b - epsilon, b + epsilon))
    assert MIXED.divergence(once.point, slow) < 1e-12


def test_slabs_that_no_point_is_in_are_told():
    x, A, b, epsilon, _ = slabs(np.random.default_rng(2), 2)
    mass = np.zeros((1, MIXED.dimension))
    mass[0, 0] = 1.0
    for rows, values, width in (
        (mass, [-3.0], [0.1]),
        (np.vstack([A, A]), np.r_[b, b + 10.0], np.r_[epsilon, epsilon]),
    ):
        found = slab_projection(MIXED, x, rows, np.subtract(values, width), np.add(values, width))
        assert not found.certified
        assert found.error == np.inf


def test_a_share_of_the_way_is_on_the_mirror_line():
    x, A, b, epsilon, truth = slabs(np.random.default_rng(3), 3)
    slabs_of = (MIXED, x, A, b - epsilon, b + epsilon)
    whole, half = (slab_projection(*slabs_of, share=s).point for s in (1.0, 0.5))
    start, end = MIXED.gradient(x), MIXED.gradient(whole)
    np.testing.assert_allclose(MIXED.gradient(half), 0.5 * (start + end), rtol=1e-7, atol=1e-7)
    assert MIXED.divergence(truth, half) <= MIXED.divergence(truth, x)
