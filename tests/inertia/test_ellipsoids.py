"""Ellipsoids: what fits into them, what is like them, what they enclose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry.optimization import Hyperellipsoid
from pydrake.multibody.tree import SpatialInertia

from geodrake.errors import ArgumentError
from geodrake.inertia import (
    change_frame,
    from_mass_com_inertia,
    from_point_masses,
    from_spatial_inertia,
)
from geodrake.inertia.ellipsoids import (
    Ellipsoid,
    bounding_ellipsoid,
    ellipsoid_of_quadric,
    equivalent_ellipsoid,
    is_realizable,
    realizability_row,
)

SEEDS = st.integers(0, 2**32 - 1)
EXAMPLES = settings(max_examples=40)


def random_rotation(rng):
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return axes * np.sign(np.linalg.det(axes))


def random_ellipsoid(rng):
    return Ellipsoid(rng.normal(0, 0.3, 3), rng.uniform(0.05, 0.5, 3), random_rotation(rng))


@EXAMPLES
@given(SEEDS)
def test_quadric_is_positive_inside(seed):
    rng = np.random.default_rng(seed)
    ellipsoid = random_ellipsoid(rng)
    points = ellipsoid.center + rng.normal(0, 0.3, (200, 3))
    lifted = np.column_stack([points, np.ones(200)])
    level = np.einsum("ki,ij,kj->k", lifted, ellipsoid.quadric, lifted)
    np.testing.assert_array_equal(level >= 0, ellipsoid.contains(points))
    again = ellipsoid_of_quadric(7.0 * ellipsoid.quadric)
    np.testing.assert_allclose(again.center, ellipsoid.center, atol=1e-9)
    np.testing.assert_allclose(np.sort(again.semi_axes), np.sort(ellipsoid.semi_axes), rtol=1e-9)
    np.testing.assert_allclose(again.quadric, ellipsoid.quadric, atol=1e-9 * np.abs(level).max())


@EXAMPLES
@given(SEEDS)
def test_contains_and_volume_are_drakes(seed):
    rng = np.random.default_rng(seed)
    ellipsoid = random_ellipsoid(rng)
    A = np.diag(1 / ellipsoid.semi_axes) @ ellipsoid.rotation.T
    theirs = Hyperellipsoid(A, ellipsoid.center)
    np.testing.assert_allclose(ellipsoid.volume, theirs.CalcVolume(), rtol=1e-12)
    points = ellipsoid.center + rng.normal(0, 0.3, (50, 3))
    expected = [theirs.PointInSet(point) for point in points]
    np.testing.assert_array_equal(ellipsoid.contains(points), expected)


@EXAMPLES
@given(SEEDS)
def test_uniform_body_is_drakes_and_its_own_equivalent(seed):
    rng = np.random.default_rng(seed)
    ellipsoid, mass = random_ellipsoid(rng), rng.uniform(0.1, 10.0)
    phi = ellipsoid.uniform_body(mass)
    a, b, c = ellipsoid.semi_axes
    theirs = SpatialInertia.SolidEllipsoidWithMass(mass, a, b, c)
    own_frame = from_spatial_inertia(theirs)
    expected = change_frame(own_frame, ellipsoid.rotation, ellipsoid.center)
    np.testing.assert_allclose(phi, expected, rtol=1e-12, atol=1e-13)
    again = equivalent_ellipsoid(phi)
    np.testing.assert_allclose(again.quadric, ellipsoid.quadric, rtol=1e-7, atol=1e-7)
    assert np.linalg.det(again.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(realizability_row(ellipsoid.quadric) @ phi, 0.4 * phi[0], rtol=1e-9)


@EXAMPLES
@given(SEEDS)
def test_mass_inside_is_realizable(seed):
    rng = np.random.default_rng(seed)
    ellipsoid = random_ellipsoid(rng)
    points = ellipsoid.random_points(rng, (12,))
    assert ellipsoid.contains(points).all()
    phi = from_point_masses(rng.uniform(0.1, 1.0, 12), points)
    assert is_realizable(phi, ellipsoid.quadric)
    # [Lee2019] Eq. (3.5.46): the average of the quadric over the mass, so not all of it inside
    # an ellipsoid on whose outside it is on the average.
    assert not is_realizable(phi, ellipsoid.scaled(0.01).quadric)
    assert not is_realizable(-phi, ellipsoid.quadric)


def test_several_at_once():
    rng = np.random.default_rng(1)
    one, two = random_ellipsoid(rng), random_ellipsoid(rng)
    both = Ellipsoid(
        np.stack([one.center, two.center]),
        np.stack([one.semi_axes, two.semi_axes]),
        np.stack([one.rotation, two.rotation]),
    )
    np.testing.assert_allclose(both.quadric[1], two.quadric)
    np.testing.assert_allclose(both.uniform_body([1.0, 2.0])[1], two.uniform_body(2.0))
    assert both.random_points(rng, (5, 2)).shape == (5, 2, 3)
    assert both.contains(both.random_points(rng, (5, 2))).all()
    like = equivalent_ellipsoid(both.uniform_body([1.0, 2.0]))
    np.testing.assert_allclose(like.quadric[0], one.quadric, rtol=1e-7, atol=1e-7)
    assert is_realizable(both.uniform_body([1.0, 2.0]), both.quadric).all()
    np.testing.assert_allclose(ellipsoid_of_quadric(both.quadric).center, both.center)
    # One shape at two places, and one ellipsoid of two masses.
    places = Ellipsoid(both.center, one.semi_axes, one.rotation)
    assert places.rotation.shape == (2, 3, 3)
    assert places.uniform_body(1.0).shape == one.uniform_body([1.0, 2.0]).shape == (2, 10)


class TestBounding:
    @EXAMPLES
    @given(SEEDS, st.integers(4, 60))
    def test_contains_all_and_is_tight(self, seed, count):
        rng = np.random.default_rng(seed)
        points = rng.normal(0, [0.5, 0.1, 0.02], (count, 3)) @ random_rotation(rng) + 1.0
        ellipsoid = bounding_ellipsoid(points)
        assert ellipsoid.contains(points).all()
        theirs = Hyperellipsoid.MinimumVolumeCircumscribedEllipsoid(points.T)
        np.testing.assert_allclose(ellipsoid.volume, theirs.CalcVolume(), rtol=1e-3)

    def test_of_a_box(self):
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)])
        ellipsoid = bounding_ellipsoid(corners)
        np.testing.assert_allclose(
            np.sort(ellipsoid.semi_axes), np.sqrt(3) * np.array([1, 2, 3]), rtol=1e-6
        )


class TestBadInput:
    def test_impossible_body(self):
        flat = from_mass_com_inertia(1.0, np.ones(3), np.diag([1.0, 0.3, 0.3]))
        with pytest.raises(ArgumentError, match="No body"):
            equivalent_ellipsoid(flat)
        drawn = equivalent_ellipsoid(flat, least_semi_axis=0.01)
        assert drawn.semi_axes[0] == pytest.approx(0.01)
        with pytest.raises(ArgumentError, match="No body"):
            equivalent_ellipsoid(-flat, least_semi_axis=0.01)
        with pytest.raises(ArgumentError, match="nan"):
            equivalent_ellipsoid(np.full(10, np.nan), least_semi_axis=0.01)
        with pytest.raises(ArgumentError, match="at least 0"):
            equivalent_ellipsoid(drawn.uniform_body(1.0), least_semi_axis=-1.0)

    def test_wrong_sign_of_quadric(self):
        Q = Ellipsoid(np.zeros(3), np.ones(3), np.eye(3)).quadric
        with pytest.raises(ArgumentError, match="turn its sign"):
            ellipsoid_of_quadric(-Q)
        Q[3, 3] = -1.0
        with pytest.raises(ArgumentError, match="nowhere"):
            ellipsoid_of_quadric(Q)
        with pytest.raises(ArgumentError, match="symmetric"):
            ellipsoid_of_quadric(Q + np.eye(4, k=1))
        with pytest.raises(ArgumentError, match="finite"):
            ellipsoid_of_quadric(np.nan * Q)
        with pytest.raises(ArgumentError, match=r"\(3, 3\)"):
            is_realizable(np.ones(10), np.eye(3))
