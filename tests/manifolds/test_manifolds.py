"""The axioms of barrier-Hessian manifolds, on every manifold and on their product."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_points import (
    CONSTRAINED,
    PRODUCT,
    other_view,
    random_inertia,
    random_point,
    round_inertia,
)

from geodrake.inertia import pseudo_inertia
from geodrake.manifolds import (
    ConstrainedInertia,
    Free,
    Interval,
    PhysicalInertia,
    Positive,
    Product,
)

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
    """Of constant speed, and shorter than the straight line between their ends."""
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
