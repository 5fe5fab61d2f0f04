"""Distances between bodies: what they are made of, and what they do not depend on."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from geodrake.inertia import (
    body_distances,
    change_frame,
    change_units,
    from_pseudo_inertia,
    pseudo_inertia,
    pullback_metric,
    to_mass_com_inertia,
)

SEEDS = st.integers(0, 2**32 - 1)
UNITS = st.floats(1e-3, 1e3)
EXAMPLES = settings(max_examples=50)


def random_bodies(rng, *shape):
    root = rng.normal(size=(*shape, 4, 4)) * [0.1, 0.1, 0.1, 1.5]
    return from_pseudo_inertia(np.swapaxes(root, -1, -2) @ root)


@EXAMPLES
@given(SEEDS, UNITS, UNITS)
def test_no_distance_knows_frame_or_units(seed, metre, kilogram):
    rng = np.random.default_rng(seed)
    # Within 10 of each other and of a ball, so that rounding of φ itself stays below 1e-9.
    P = np.eye(4) + 0.2 * pseudo_inertia(random_bodies(rng, 3))
    bodies = from_pseudo_inertia(P)
    R, p = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(-1, 1, 3)
    seen = change_units(change_frame(bodies, R, p), metre=metre, kilogram=kilogram)
    for distance in (
        lambda a, b, _: body_distances.riemannian_distance(a, b),
        lambda a, b, _: body_distances.entropic_divergence(a, b),
        body_distances.pullback_distance,
    ):
        np.testing.assert_allclose(distance(*seen), distance(*bodies), rtol=1e-9, atol=1e-9)


@EXAMPLES
@given(SEEDS)
def test_entropic_divergence_of_unit_masses_is_twice_that_of_gaussians(seed):
    a, b = (x / x[0] for x in random_bodies(np.random.default_rng(seed), 2))

    def gaussian(phi):
        _, com, central = to_mass_com_inertia(phi)
        return com, 0.5 * np.trace(central) * np.eye(3) - central

    (p, S), (q, T) = gaussian(a), gaussian(b)
    apart = p - q
    inverse = np.linalg.inv(T)
    logs = np.linalg.slogdet(T)[1] - np.linalg.slogdet(S)[1]
    # [Lee2019] Eq. (A.1.5)
    kullback_leibler = 0.5 * (logs + np.trace(inverse @ S) - 3 + apart @ inverse @ apart)
    ours = body_distances.entropic_divergence(a, b)
    np.testing.assert_allclose(ours, 2 * kullback_leibler, rtol=1e-6)


@EXAMPLES
@given(SEEDS)
def test_pullback_distance_is_that_of_the_metric(seed):
    rng = np.random.default_rng(seed)
    phi, step = random_bodies(rng), rng.normal(size=10) * np.repeat([1.0, 0.1, 0.01], [1, 3, 6])
    whole = step @ pullback_metric(phi) @ step
    distance = body_distances.pullback_distance(phi + step, phi, phi)
    np.testing.assert_allclose(distance**2, whole, rtol=1e-7)


@EXAMPLES
@given(SEEDS)
def test_distances_agree_nearby(seed):
    rng = np.random.default_rng(seed)
    phi = random_bodies(rng)
    step = random_bodies(rng) - random_bodies(rng)
    step *= 1e-4 / body_distances.pullback_distance(phi + step, phi, phi)
    near = phi + step
    pullback = body_distances.pullback_distance(near, phi, phi) ** 2
    entropic = body_distances.entropic_divergence(near, phi)
    riemannian = body_distances.riemannian_distance(near, phi) ** 2
    np.testing.assert_allclose(entropic, pullback, rtol=1e-3)
    np.testing.assert_allclose(0.5 * riemannian, pullback, rtol=1e-3)


def test_only_the_pullback_distance_is_finite_at_the_edge():
    body = random_bodies(np.random.default_rng(1))
    P = pseudo_inertia(body)
    values, axes = np.linalg.eigh(P)
    values = np.array([[s * values[0], *values[1:]] for s in (1e-2, 1e-4, 1e-6)])
    thin = from_pseudo_inertia((axes * values[:, None]) @ axes.T)
    riemannian = body_distances.riemannian_distance(thin, body)
    np.testing.assert_allclose(riemannian, -np.log([1e-2, 1e-4, 1e-6]), rtol=1e-4)
    assert (np.diff(body_distances.entropic_divergence(thin, body)) > 4.0).all()
    pullback = body_distances.pullback_distance(thin, body, body)
    np.testing.assert_allclose(pullback, np.sqrt(0.5), rtol=2e-2)
