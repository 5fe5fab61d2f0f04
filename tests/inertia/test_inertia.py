"""Inertial parameters and ellipsoids are those of Drake, distances those of SciPy."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry.optimization import Hyperellipsoid
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from random_points import (
    other_view,
    random_inertia,
    random_matrices,
    random_rotation,
    round_inertia,
)

from geodrake import inertia
from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.inertia import (
    Ellipsoid,
    change_frame,
    entropic_divergence,
    equivalent_ellipsoid,
    from_mass_com_inertia,
    from_pseudo_inertia,
    from_spatial_inertia,
    is_physical,
    is_realizable,
    parameters,
    perturb,
    pseudo_inertia,
    pullback_distance,
    pullback_metric,
    riemannian_distance,
)
from geodrake.inertia import positive_definite as pd
from geodrake.inertia.ellipsoids import ellipsoid_of_quadric, realizability_row
from geodrake.inertia.parameters import from_point_masses

SEEDS = st.integers(0, 2**32 - 1)
EXAMPLES = settings(max_examples=20)


def random_body(rng):
    """Return a body of some kilograms and decimetres, with its centre of mass off the origin."""
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


def test_moments_of_no_body():
    phi = inertia.from_mass_com_inertia(1.0, np.zeros(3), np.diag([1.0, 0.3, 0.3]))
    np.testing.assert_allclose(parameters.central_second_moment(phi), np.diag([-0.2, 0.5, 0.5]))
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
    np.testing.assert_allclose(central, inertia.to_mass_com_inertia(apart)[2], atol=1e-12)
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


def random_ellipsoid(rng):
    return Ellipsoid(rng.normal(0, 0.3, 3), rng.uniform(0.05, 0.5, 3), random_rotation(rng))


@EXAMPLES
@given(SEEDS)
def test_ellipsoids_are_drakes(seed):
    rng = np.random.default_rng(seed)
    ellipsoid, mass = random_ellipsoid(rng), rng.uniform(0.1, 10.0)
    A = np.diag(1 / ellipsoid.semi_axes) @ ellipsoid.rotation.T
    theirs = Hyperellipsoid(A, ellipsoid.center)
    np.testing.assert_allclose(ellipsoid.volume, theirs.CalcVolume(), rtol=1e-12)
    points = ellipsoid.center + rng.normal(0, 0.3, (50, 3))
    inside = ellipsoid.contains(points)
    np.testing.assert_array_equal(inside, [theirs.PointInSet(point) for point in points])
    lifted = np.column_stack([points, np.ones(50)])
    level = np.einsum("ki,ij,kj->k", lifted, ellipsoid.quadric, lifted)
    np.testing.assert_array_equal(level >= 0, inside)
    solid = SpatialInertia.SolidEllipsoidWithMass(mass, *ellipsoid.semi_axes)
    expected = change_frame(from_spatial_inertia(solid), ellipsoid.rotation, ellipsoid.center)
    np.testing.assert_allclose(ellipsoid.uniform_body(mass), expected, rtol=1e-12, atol=1e-13)


@EXAMPLES
@given(SEEDS)
def test_ellipsoids_come_back_from_their_quadrics_and_bodies(seed):
    rng = np.random.default_rng(seed)
    one, two = random_ellipsoid(rng), random_ellipsoid(rng)
    both = Ellipsoid(
        np.stack([one.center, two.center]),
        np.stack([one.semi_axes, two.semi_axes]),
        np.stack([one.rotation, two.rotation]),
    )
    bodies = both.uniform_body([1.0, 2.0])
    for again in (ellipsoid_of_quadric(7.0 * both.quadric), equivalent_ellipsoid(bodies)):
        np.testing.assert_allclose(again.quadric[0], one.quadric, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(again.quadric[1], two.quadric, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(again.center, both.center, atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(again.rotation), 1.0)
    rows = realizability_row(both.quadric)
    np.testing.assert_allclose((rows * bodies).sum(-1), [0.4, 0.8], rtol=1e-9)
    assert is_realizable(bodies, both.quadric).all()
    # One shape at two places, and one ellipsoid of two masses.
    places = Ellipsoid(both.center, one.semi_axes, one.rotation)
    assert places.rotation.shape == (2, 3, 3)
    assert places.uniform_body(1.0).shape == one.uniform_body([1.0, 2.0]).shape == (2, 10)


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


def test_impossible_bodies():
    flat = from_mass_com_inertia(1.0, np.ones(3), np.diag([1.0, 0.3, 0.3]))
    with pytest.raises(ArgumentError, match="are not physical"):
        equivalent_ellipsoid(flat)
    drawn = equivalent_ellipsoid(flat, least_semi_axis=0.01)
    assert drawn.semi_axes[0] == pytest.approx(0.01)
    for phi, least, message in (
        (-flat, 0.01, "are not physical"),
        (np.full(10, np.nan), 0.01, "nan"),
        (drawn.uniform_body(1.0), -1.0, "at least 0"),
    ):
        with pytest.raises(ArgumentError, match=message):
            equivalent_ellipsoid(phi, least_semi_axis=least)


def test_wrong_quadrics():
    Q = Ellipsoid(np.zeros(3), np.ones(3), np.eye(3)).quadric
    for wrong, message in (
        (-Q, "use −Q"),
        (Q - 2.0 * np.diag([0, 0, 0, Q[3, 3]]), "is empty"),
        (Q + np.eye(4, k=1), "symmetric"),
        (np.nan * Q, "finite"),
    ):
        with pytest.raises(ArgumentError, match=message):
            ellipsoid_of_quadric(wrong)
    with pytest.raises(ArgumentError, match=r"\(3, 3\)"):
        is_realizable(np.ones(10), np.eye(3))


class TestPerturbedBodies:
    PHI = Ellipsoid(
        np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0], [0.0, -0.1, 0.05]]),
        np.array([[0.05, 0.06, 0.2], [0.2, 0.05, 0.05], [0.1, 0.1, 0.1]]),
        np.eye(3)[None].repeat(3, 0),
    ).uniform_body([4.0, 2.5, 0.5])

    def drawn(self, count, seed=0, **options):
        return perturb(self.PHI, count, rng=np.random.default_rng(seed), **options)

    def test_all_are_physical_and_as_far_as_said(self):
        made = self.drawn(100)
        assert made.phi.shape == (100, 3, 10)
        assert is_physical(made.phi).all()
        np.testing.assert_allclose(made.distances, riemannian_distance(made.phi, self.PHI))
        assert (made.distances > 0).all()
        np.testing.assert_array_equal(self.drawn(100).phi, made.phi)

    def test_only_mass_inside_of_the_support_is_added_or_taken(self):
        own = equivalent_ellipsoid(self.PHI)
        for support, asked in ((own, None), (own.scaled(0.1), own.scaled(0.1))):
            change = self.drawn(100, mass_uncertainty=0.3, support=asked).phi - self.PHI
            # Ten point masses of one sign inside of the ellipsoid are a body that fits into it.
            body = np.sign(change[..., :1]) * change
            assert (np.linalg.eigvalsh(pseudo_inertia(body)) > -1e-12).all()
            assert is_realizable(body, support.quadric).all()

    def test_impossible_draws_are_counted_and_replaced(self):
        made = self.drawn(200, mass_uncertainty=0.9, point_masses=3)
        assert made.rejected > 0
        assert is_physical(made.phi).all()


SIZES = st.integers(1, 6)
UNITS = st.floats(1e-3, 1e3)


def random_symmetric(rng, *shape, n=4):
    half = rng.normal(size=(*shape, n, n))
    return half + np.swapaxes(half, -1, -2)


def close(actual, expected, precision=1e-9):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, atol=precision * scale, rtol=0)


@EXAMPLES
@given(SEEDS, SIZES)
def test_formulas_of_the_source_with_scipy(seed, n):
    A, B = random_matrices(np.random.default_rng(seed), 2, n=n)
    logarithms = np.log(scipy.linalg.eigvalsh(B, A))  # [Lee2019] Eqs. (2.2.10), (2.2.14)
    np.testing.assert_allclose(pd.relative_logarithms(A, B), logarithms, atol=1e-9)
    np.testing.assert_allclose(pd.distance(A, B), np.linalg.norm(logarithms), rtol=1e-9)
    ratio = np.linalg.solve(A, B)
    expected = -np.linalg.slogdet(ratio)[1] + np.trace(ratio) - n
    np.testing.assert_allclose(pd.log_det_divergence(B, A), expected, rtol=1e-8)


@EXAMPLES
@given(SEEDS, SIZES)
def test_geodesics_are_minimal_and_of_even_speed(seed, n):
    rng = np.random.default_rng(seed)
    A, B = random_matrices(rng, 2, n=n)
    t = np.append(rng.uniform(0, 1, 5), 3.0)
    points, whole = pd.geodesic(A, B, t), pd.distance(A, B)
    np.testing.assert_allclose(pd.distance(A, points), t * whole, rtol=1e-8)
    np.testing.assert_allclose(pd.distance(points, B), np.abs(1 - t) * whole, rtol=1e-8)


@EXAMPLES
@given(SEEDS, UNITS, UNITS)
def test_no_distance_or_mean_knows_frame_or_units(seed, metre, kilogram):
    rng = np.random.default_rng(seed)
    bodies, view = round_inertia(rng, 3), other_view(rng, metre, kilogram)
    seen = bodies @ view.T
    for distance in (
        lambda a, b, _: riemannian_distance(a, b),
        lambda a, b, _: entropic_divergence(a, b),
        pullback_distance,
    ):
        np.testing.assert_allclose(distance(*seen), distance(*bodies), rtol=1e-9, atol=1e-9)
    mean, there = (from_pseudo_inertia(pd.karcher_mean(pseudo_inertia(b))) for b in (bodies, seen))
    assert riemannian_distance(view @ mean, there) < 1e-8


@EXAMPLES
@given(SEEDS)
def test_distances_agree_nearby(seed):
    rng = np.random.default_rng(seed)
    phi, step = random_inertia(rng), rng.normal(size=10)
    step /= np.sqrt(step @ pullback_metric(phi) @ step)
    for length in (1e-2, 1e-5, 1e-7):
        near = phi + length * step
        # [Lee2019] Eqs. (2.2.5), (2.2.16), and (2.2.10) which is √2 longer
        for squared in (
            pullback_distance(near, phi, phi) ** 2,
            entropic_divergence(near, phi),
            entropic_divergence(phi, near),
            0.5 * riemannian_distance(phi, near) ** 2,
        ):
            np.testing.assert_allclose(squared, length**2, rtol=5 * length + 1e-6)


def test_only_the_pullback_distance_is_finite_at_the_edge():
    body = random_inertia(np.random.default_rng(1))
    values, axes = np.linalg.eigh(pseudo_inertia(body))
    shares = 10.0 ** -np.arange(2, 12)
    thinner = np.array([[share, 1, 1, 1] for share in shares])[:, None]
    thin = from_pseudo_inertia((axes * thinner * values) @ axes.T)
    np.testing.assert_allclose(riemannian_distance(thin, body), -np.log(shares), rtol=1e-4)
    assert (np.diff(entropic_divergence(thin, body)) > 2.0).all()
    np.testing.assert_allclose(pullback_distance(thin, body, body), np.sqrt(0.5), rtol=2e-2)


class TestKarcherMean:
    @EXAMPLES
    @given(SEEDS, SIZES, st.integers(1, 12))
    def test_logarithms_balance(self, seed, n, k):
        rng = np.random.default_rng(seed)
        P, w = random_matrices(rng, k, n=n), rng.uniform(0, 1, k)
        root = np.linalg.inv(np.linalg.cholesky(pd.karcher_mean(P, w)))
        logarithms = [scipy.linalg.logm(root @ each @ root.T) for each in P]
        assert np.linalg.norm(np.tensordot(w / w.sum(), logarithms, 1)) < 1e-9

    def test_far_apart(self):
        P = random_matrices(np.random.default_rng(1), 5)
        scales = np.array([1e-6, 1.0, 1e6, 1e3, 1e-3])
        expected = pd.karcher_mean(P)  # scales multiply to one
        assert pd.distance(pd.karcher_mean(scales[:, None, None] * P), expected) < 1e-9

    def test_leading_axes(self):
        rng = np.random.default_rng(2)
        P, w = random_matrices(rng, 3, 2, 5), rng.uniform(0, 1, (3, 2, 5))
        means = pd.karcher_mean(P, w)
        assert means.shape == pd.karcher_mean(P, np.ones(5)).shape == (3, 2, 4, 4)
        close(means[1, 0], pd.karcher_mean(P[1, 0], w[1, 0]))

    def test_failure_is_an_error(self):
        P = random_matrices(np.random.default_rng(3), 4)
        with pytest.raises(ConvergenceError, match=r"in 1 steps.*larger tolerance") as caught:
            pd.karcher_mean(P, max_iterations=1)
        assert caught.value.evidence["distance"] > 1e-10

    @pytest.mark.parametrize("spread", [1.0, 1e-5, 1e-9])
    def test_a_mean_is_found_to_rounding_and_no_further(self, spread):
        rng = np.random.default_rng(3)
        P = np.eye(4) + 0.05 * spread * random_symmetric(rng, 20, 5)
        mean = pd.karcher_mean(P, tolerance=1e-300)
        assert pd.distance(pd.karcher_mean(P, tolerance=1e-12), mean).max() < 1e-12
