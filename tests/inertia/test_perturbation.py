"""Random bodies around given ones."""

import numpy as np

from geodrake.inertia import is_physical, pseudo_inertia
from geodrake.inertia.body_distances import riemannian_distance
from geodrake.inertia.ellipsoids import Ellipsoid, equivalent_ellipsoid, is_realizable
from geodrake.inertia.perturbation import perturb


def bodies():
    ellipsoids = Ellipsoid(
        np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0], [0.0, -0.1, 0.05]]),
        np.array([[0.05, 0.06, 0.2], [0.2, 0.05, 0.05], [0.1, 0.1, 0.1]]),
        np.eye(3)[None].repeat(3, 0),
    )
    return ellipsoids.uniform_body([4.0, 2.5, 0.5])


def test_all_are_physical_and_as_far_as_said():
    phi = bodies()
    made = perturb(phi, 100, rng=np.random.default_rng(0))
    assert made.phi.shape == (100, 3, 10)
    assert is_physical(made.phi).all()
    np.testing.assert_allclose(made.distances, riemannian_distance(made.phi, phi))
    assert (made.distances > 0).all()


def test_only_mass_inside_of_the_support_is_added_or_taken():
    phi = bodies()
    support = equivalent_ellipsoid(phi)
    made = perturb(phi, 200, rng=np.random.default_rng(2), mass_uncertainty=0.3)
    change = made.phi - phi
    sign = np.sign(change[..., :1])
    difference = pseudo_inertia(sign * change)
    # Ten point masses of one sign inside of the ellipsoid are a body that fits into it.
    assert (np.linalg.eigvalsh(difference) > -1e-12).all()
    assert is_realizable(sign * change, support.quadric).all()
    smaller = perturb(phi, 5, rng=np.random.default_rng(3), support=support.scaled(0.1))
    assert is_realizable(
        np.sign(smaller.phi[..., :1] - phi[:, :1]) * (smaller.phi - phi),
        support.scaled(0.1).quadric,
    ).all()


def test_the_seed_decides():
    phi = bodies()
    first, again, other = (
        perturb(phi, 3, rng=np.random.default_rng(seed)).phi for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_impossible_draws_are_counted_and_replaced():
    phi = bodies()
    made = perturb(phi, 200, rng=np.random.default_rng(7), mass_uncertainty=0.9, point_masses=3)
    assert made.rejected > 0
    assert is_physical(made.phi).all()
