"""The axioms of barrier-Hessian manifolds, on every manifold and on their product."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geodrake.errors import ArgumentError
from geodrake.inertia import from_pseudo_inertia, pseudo_inertia
from geodrake.manifolds import Free, Interval, PhysicalInertia, Positive, Product

MIXED = Interval((0.0, -1.0, -np.inf, -np.inf), (np.inf, 2.0, 3.0, np.inf))
PRODUCT = Product((PhysicalInertia(), MIXED, Positive()), (2.0, 0.5, 1.0))
MANIFOLDS = [Positive(3), Interval((-1.0, 0.0), (1.0, 5.0)), Free(2), MIXED, PhysicalInertia()]
MANIFOLDS = [*MANIFOLDS, PRODUCT]


def random_inertia(rng, size=()):
    root = rng.normal(size=(*size, 4, 4))
    return from_pseudo_inertia(root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(4))


def random_point(manifold, rng, size=()):
    if isinstance(manifold, Product):
        return np.concatenate([random_point(m, rng, size) for m in manifold.manifolds], -1)
    if isinstance(manifold, PhysicalInertia):
        return random_inertia(rng, size)
    lower = np.maximum(manifold.lower, np.minimum(np.subtract(manifold.upper, 5.0), -5.0))
    upper = np.minimum(manifold.upper, lower + 5.0)
    return rng.uniform(lower + 0.1, upper - 0.1, (*size, manifold.dimension))


def numerical_gradient(function, x, step=1e-5):
    return np.stack(
        [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(len(x))], -1
    )


@pytest.mark.parametrize("manifold", MANIFOLDS, ids=repr)
class TestAxioms:
    def test_gradient_and_metric_are_derivatives(self, manifold):
        x = random_point(manifold, np.random.default_rng(1))
        assert manifold.contains(x)
        gradient, metric = manifold.gradient(x), manifold.metric(x)
        np.testing.assert_allclose(
            gradient, numerical_gradient(manifold.barrier, x), rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(
            metric, numerical_gradient(manifold.gradient, x), rtol=1e-5, atol=1e-6
        )

    def test_inverse_metric(self, manifold):
        rng = np.random.default_rng(2)
        x, b = random_point(manifold, rng, (5,)), rng.normal(size=(5, manifold.dimension))
        solved = np.linalg.solve(manifold.metric(x), b[..., None])[..., 0]
        np.testing.assert_allclose(manifold.inverse_metric_times(x, b), solved, rtol=1e-7)

    def test_divergence_is_the_bregman_divergence(self, manifold):
        rng = np.random.default_rng(3)
        x, y = random_point(manifold, rng, (2, 50))
        expected = manifold.barrier(x) - manifold.barrier(y)
        expected = expected - (manifold.gradient(y) * (x - y)).sum(-1)
        np.testing.assert_allclose(manifold.divergence(x, y), expected, rtol=1e-9, atol=1e-9)
        assert (manifold.divergence(x, y) > 0).all()
        np.testing.assert_allclose(manifold.divergence(x, x), 0.0, atol=1e-12)

    def test_divergence_is_half_the_metric_nearby(self, manifold):
        rng = np.random.default_rng(4)
        x, step = random_point(manifold, rng), 1e-5 * rng.normal(size=manifold.dimension)
        half = 0.5 * step @ manifold.metric(x) @ step  # [Lee2019] Eq. (5.3.18)
        np.testing.assert_allclose(manifold.divergence(x + step, x), half, rtol=5e-3)

    def test_leading_axes(self, manifold):
        x = random_point(manifold, np.random.default_rng(5), (2, 3))
        n = manifold.dimension
        assert manifold.contains(x).shape == manifold.barrier(x).shape == (2, 3)
        assert manifold.gradient(x).shape == (2, 3, n)
        assert manifold.metric(x).shape == (2, 3, n, n)
        assert manifold.inverse_metric_times(x, np.ones(n)).shape == (2, 3, n)
        assert manifold.divergence(x, x[0, 0]).shape == (2, 3)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_inertia_divergence_knows_no_frame_and_no_units(seed, metre, kilogram):
    rng = np.random.default_rng(seed)
    x, y = random_inertia(rng, (2,))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    change = np.eye(4)
    change[:3, :3], change[:3, 3] = metre * rotation, metre * rng.normal(size=3)

    def seen(phi):
        return from_pseudo_inertia(kilogram * change @ pseudo_inertia(phi) @ change.T)

    before = PhysicalInertia().divergence(x, y)
    np.testing.assert_allclose(PhysicalInertia().divergence(seen(x), seen(y)), before, rtol=1e-6)


@given(st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=3))
def test_friction_divergence_knows_no_units(scale):
    x, y = np.array([1.0, 2.0, 3.0]), np.array([0.5, 2.5, 9.0])
    before = Positive(3).divergence(x, y)
    np.testing.assert_allclose(Positive(3).divergence(x * scale, y * scale), before, rtol=1e-9)


def test_contains():
    assert not Positive(2).contains([1.0, 0.0])
    assert not Free(1).contains([np.nan])
    assert not MIXED.contains([1.0, 2.0, 0.0, 0.0])
    assert not PhysicalInertia().contains(np.zeros(10))
    assert Product((Free(), Positive())).contains([-1.0, 1.0])


def test_values_of_the_book():
    # [Lee2019] Eq. (5.3.33)
    assert Positive().divergence([2.0], [1.0]) == pytest.approx(np.log(0.5) + 2.0 - 1.0)
    # [Lee2019] Eq. (B.4.22) without its sum
    np.testing.assert_allclose(Positive(2).inverse_metric_times([2.0, 3.0], [1.0, 1.0]), [4, 9])


def test_bad_arguments():
    with pytest.raises(ArgumentError, match="upper bound"):
        Interval((1.0,), (1.0,))
    with pytest.raises(ArgumentError, match="positive weight"):
        Product((Free(), Free()), (1.0, -1.0))
