"""Representations of inertial parameters, and what a body's moments must obey, against Drake."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from random_points import random_rotation

from geodrake import inertia
from geodrake.inertia import parameters

SEEDS = st.integers(0, 2**32 - 1)
EXAMPLES = settings(max_examples=20)


def random_body(rng):
    """A body of a few kilograms and decimetres with its centre of mass off the origin."""
    offset = rng.normal(0, 0.2, (1, 3))
    return parameters.from_point_masses(
        rng.uniform(0.05, 1.0, 8), rng.normal(0, 0.1, (8, 3)) + offset
    )


def drake_inertia(phi):
    mass, com, central = inertia.to_mass_com_inertia(phi)
    unit = central / mass
    moments = [unit[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    about_com = UnitInertia(*moments)
    return SpatialInertia(mass, com, about_com.ShiftFromCenterOfMass(-com))


@EXAMPLES
@given(SEEDS)
def test_bodies_are_drakes_in_any_frame(seed):
    rng = np.random.default_rng(seed)
    phi = random_body(rng)
    body = drake_inertia(phi)
    np.testing.assert_allclose(inertia.from_spatial_inertia(body), phi, atol=1e-13)
    ours, theirs = inertia.to_spatial_inertia(phi).CopyToFullMatrix6(), body.CopyToFullMatrix6()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13 * np.abs(theirs).max())
    R_AB, p_AoBo = random_rotation(rng), rng.normal(size=3)
    seen = inertia.change_frame(phi, R_AB, p_AoBo)
    M_BAo_A = body.ReExpress(RotationMatrix(R_AB)).Shift(-p_AoBo)
    np.testing.assert_allclose(seen, inertia.from_spatial_inertia(M_BAo_A), atol=1e-12)
    X_BA = RigidTransform(RotationMatrix(R_AB), p_AoBo).inverse()
    back = inertia.change_frame(seen, X_BA.rotation().matrix(), X_BA.translation())
    np.testing.assert_allclose(back, phi, atol=1e-12)


@EXAMPLES
@given(SEEDS)
def test_principal_axes_are_drakes(seed):
    phi = random_body(np.random.default_rng(seed))
    principal = parameters.principal_axes(phi)
    com = drake_inertia(phi).Shift(drake_inertia(phi).get_com())
    moments, _ = com.CalcRotationalInertia().CalcPrincipalMomentsAndAxesOfInertia()
    np.testing.assert_allclose(np.sort(principal.moments), moments, rtol=1e-9)
    _, _, central = inertia.to_mass_com_inertia(phi)
    R = principal.rotation
    np.testing.assert_allclose(R @ np.diag(principal.moments) @ R.T, central, atol=1e-13)
    assert np.linalg.det(R) == pytest.approx(1.0)
    low, middle, high = moments
    # [Lee2019] Eqs. (3.2.8)–(3.2.10)
    expected = np.array([low + middle - high, low + high - middle, middle + high - low])
    margins = parameters.triangle_margins(phi)
    np.testing.assert_allclose(margins, expected / moments.sum(), atol=1e-12)


def test_moments_of_no_body():
    phi = inertia.from_mass_com_inertia(1.0, np.zeros(3), np.diag([1.0, 0.3, 0.3]))
    np.testing.assert_allclose(parameters.central_second_moment(phi), np.diag([-0.2, 0.5, 0.5]))
    np.testing.assert_allclose(parameters.triangle_margins(phi), [-0.25, 0.625, 0.625])
    assert not UnitInertia(1.0, 0.3, 0.3).CouldBePhysicallyValid()


@EXAMPLES
@given(SEEDS, st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
def test_bodies_are_sums_of_point_masses(seed, metre, kilogram):
    rng = np.random.default_rng(seed)
    masses, positions = rng.uniform(0.1, 1.0, (2, 4)), rng.normal(size=(2, 4, 3))
    phi = parameters.from_point_masses(masses, positions)
    lifted = np.concatenate([positions, np.ones((2, 4, 1))], -1)
    expected = np.einsum("bk,bki,bkj->bij", masses, lifted, lifted)
    np.testing.assert_allclose(inertia.pseudo_inertia(phi), expected, atol=1e-12)
    mass, com, central = inertia.to_mass_com_inertia(phi)
    np.testing.assert_allclose(mass, masses.sum(1), rtol=1e-12)
    np.testing.assert_allclose(com, np.einsum("bk,bki->bi", masses, positions) / mass[:, None])
    apart = parameters.from_point_masses(masses, positions - com[:, None])
    np.testing.assert_allclose(central, parameters.rotational_inertia(apart), atol=1e-12)
    seen = parameters.from_point_masses(kilogram * masses, metre * positions)
    changed = inertia.change_units(phi, metre=metre, kilogram=kilogram)
    np.testing.assert_allclose(changed, seen, rtol=1e-9, atol=1e-12 * np.abs(seen).max())


def test_dual_matrix():
    rng = np.random.default_rng(0)
    a, phi = rng.normal(size=(2, 3, 10))
    X = parameters.dual(a)
    np.testing.assert_array_equal(X, np.swapaxes(X, -1, -2))
    trace = np.einsum("...ij,...ji->...", inertia.pseudo_inertia(phi), X)
    np.testing.assert_allclose(trace, (a * phi).sum(-1), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(parameters.from_dual(X), a, atol=1e-13)
