"""Representations of inertial parameters, and what a body's moments must obey, against Drake."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import SpatialInertia, UnitInertia

from geodrake import inertia

SEEDS = st.integers(0, 2**32 - 1)
EXAMPLES = settings(max_examples=40)


def random_bodies(rng, *shape):
    """Bodies of a few kilograms and decimetres with their centre of mass off the origin."""
    masses, positions = rng.uniform(0.05, 1.0, (*shape, 8)), rng.normal(0, 0.1, (*shape, 8, 3))
    offset = rng.normal(0, 0.2, (*shape, 1, 3))
    return inertia.from_point_masses(masses, positions + offset)


def random_rotation(rng):
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return axes * np.sign(np.linalg.det(axes))


def drake_inertia(phi):
    mass, com, central = inertia.to_mass_com_inertia(phi)
    unit = central / mass
    moments = [unit[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    about_com = UnitInertia(*moments)
    return SpatialInertia(mass, com, about_com.ShiftFromCenterOfMass(-com))


@EXAMPLES
@given(SEEDS)
def test_spatial_inertia_is_drakes(seed):
    phi = random_bodies(np.random.default_rng(seed))
    ours = inertia.spatial_inertia_matrix(phi)
    theirs = drake_inertia(phi).CopyToFullMatrix6()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13 * np.abs(theirs).max())
    np.testing.assert_array_equal(inertia.from_spatial_inertia_matrix(ours), phi)
    np.testing.assert_allclose(inertia.from_spatial_inertia(drake_inertia(phi)), phi, atol=1e-13)


@EXAMPLES
@given(SEEDS)
def test_change_of_frame_is_drakes(seed):
    rng = np.random.default_rng(seed)
    phi, R_AB, p_AoBo = random_bodies(rng), random_rotation(rng), rng.normal(size=3)
    M_BBo_A = drake_inertia(phi).ReExpress(RotationMatrix(R_AB))
    M_BAo_A = M_BBo_A.Shift(-p_AoBo)
    ours = inertia.spatial_inertia_matrix(inertia.change_frame(phi, R_AB, p_AoBo))
    np.testing.assert_allclose(ours, M_BAo_A.CopyToFullMatrix6(), atol=1e-12)
    X_BA = RigidTransform(RotationMatrix(R_AB), p_AoBo).inverse()
    back = inertia.change_frame(
        inertia.change_frame(phi, R_AB, p_AoBo), X_BA.rotation().matrix(), X_BA.translation()
    )
    np.testing.assert_allclose(back, phi, atol=1e-12)


@EXAMPLES
@given(SEEDS)
def test_dual_matrix(seed):
    rng = np.random.default_rng(seed)
    a, phi = rng.normal(size=(2, 3, 10))
    X = inertia.dual(a)
    trace = np.einsum("...ij,...ji->...", inertia.pseudo_inertia(phi), X)
    np.testing.assert_allclose(trace, (a * phi).sum(-1), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(inertia.from_dual(X), a, atol=1e-13)
    a1, a2, a3, a4, a5, a6, a7, a8, a9, a10 = a[0]
    book = np.array(  # [Lee2019] Eq. (B.1.9)
        [
            [a6 + a7, -a8 / 2, -a10 / 2, a2 / 2],
            [-a8 / 2, a7 + a5, -a9 / 2, a3 / 2],
            [-a10 / 2, -a9 / 2, a5 + a6, a4 / 2],
            [a2 / 2, a3 / 2, a4 / 2, a1],
        ]
    )
    np.testing.assert_allclose(X[0], book, atol=1e-14)


@EXAMPLES
@given(SEEDS, st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_change_of_units_is_that_of_point_masses(seed, metre, kilogram):
    rng = np.random.default_rng(seed)
    masses, positions = rng.uniform(0.1, 1.0, 5), rng.normal(size=(5, 3))
    seen = inertia.from_point_masses(kilogram * masses, metre * positions)
    phi = inertia.from_point_masses(masses, positions)
    changed = inertia.change_units(phi, metre=metre, kilogram=kilogram)
    np.testing.assert_allclose(changed, seen, rtol=1e-9, atol=1e-12 * np.abs(seen).max())


@EXAMPLES
@given(SEEDS)
def test_point_masses_add_up(seed):
    rng = np.random.default_rng(seed)
    masses, positions = rng.uniform(0.1, 1.0, (2, 4)), rng.normal(size=(2, 4, 3))
    phi = inertia.from_point_masses(masses, positions)
    mass, com, central = inertia.to_mass_com_inertia(phi)
    np.testing.assert_allclose(mass, masses.sum(1), rtol=1e-12)
    np.testing.assert_allclose(com, np.einsum("bk,bki->bi", masses, positions) / mass[:, None])
    apart = positions - com[:, None]
    for b in range(2):
        expected = sum(
            m * (x @ x * np.eye(3) - np.outer(x, x))
            for m, x in zip(masses[b], apart[b], strict=True)
        )
        np.testing.assert_allclose(central[b], expected, atol=1e-12)
    together = inertia.from_point_masses(masses.ravel(), positions.reshape(-1, 3))
    np.testing.assert_allclose(phi.sum(0), together, atol=1e-12)


class TestPrincipalAxes:
    @EXAMPLES
    @given(SEEDS)
    def test_moments_and_axes_are_drakes(self, seed):
        phi = random_bodies(np.random.default_rng(seed))
        principal = inertia.principal_axes(phi)
        com = drake_inertia(phi).Shift(drake_inertia(phi).get_com())
        moments, _ = com.CalcRotationalInertia().CalcPrincipalMomentsAndAxesOfInertia()
        np.testing.assert_allclose(np.sort(principal.moments), moments, rtol=1e-9)
        _, _, central = inertia.to_mass_com_inertia(phi)
        R = principal.rotation
        np.testing.assert_allclose(R @ np.diag(principal.moments) @ R.T, central, atol=1e-13)
        assert np.linalg.det(R) == pytest.approx(1.0)

    @EXAMPLES
    @given(SEEDS)
    def test_triangle_margins(self, seed):
        phi = random_bodies(np.random.default_rng(seed))
        low, middle, high = np.sort(inertia.principal_axes(phi).moments)
        total = low + middle + high
        # [Lee2019] Eqs. (3.2.8)–(3.2.10)
        expected = np.array([low + middle - high, low + high - middle, middle + high - low])
        margins = inertia.triangle_margins(phi)
        np.testing.assert_allclose(margins, expected / total, atol=1e-12)
        assert (margins > 0).all()

    def test_the_example_of_the_book(self):
        phi = inertia.from_mass_com_inertia(1.0, np.zeros(3), np.diag([1.0, 0.3, 0.3]))
        np.testing.assert_allclose(inertia.central_second_moment(phi), np.diag([-0.2, 0.5, 0.5]))
        np.testing.assert_allclose(inertia.triangle_margins(phi), [-0.25, 0.625, 0.625])
        # Drake's rule is the same one.
        assert not drake_inertia_is_valid([1.0, 0.3, 0.3])
        assert drake_inertia_is_valid([0.55, 0.3, 0.3])


def drake_inertia_is_valid(moments):
    return UnitInertia(*moments).CouldBePhysicallyValid()
