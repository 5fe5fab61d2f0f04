"""Filtered regressors, least-divergence steps and slab projections, against other solvers."""

import numpy as np
import pytest
from adaptive_loops import CONTROL, MANIFOLD, TRUTH, pendulum_plant, perturbed, states_along
from chain_logs import inverse_dynamics
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from geodrake.control import SampleUpdate
from geodrake.control.adaptation import LinearSet, mass_limits
from geodrake.control.online_estimation import FilteredRegressor, slab_step
from geodrake.manifolds import (
    ConstrainedInertia,
    Free,
    Interval,
    PhysicalInertia,
    Positive,
    Product,
)

STEP = 1e-3
MIXED = Product(
    (
        PhysicalInertia(),
        Positive(2),
        Interval((-1.0, -np.inf, 0.0), (2.0, 1.0, np.inf)),
        Free(2),
        PhysicalInertia(),
    ),
    (1.0, 0.5, 2.0, 1.0, 3.0),
)


def inside(rng, size=0.3):
    """A point of MIXED."""
    bodies = [perturbed(size, int(rng.integers(1 << 30)))[:10] for _ in range(2)]
    others = [np.exp(rng.normal(size=2)), [rng.uniform(-0.9, 1.9), rng.uniform(-3, 0.9)]]
    return np.concatenate(
        [bodies[0], *others, np.exp(rng.normal(size=1)), rng.normal(size=2), bodies[1]]
    )


def samples(count=1500):
    """Positions, velocities and Drake's own efforts (with damping) along a motion, (N, 2) each."""
    q, v, a = states_along(STEP * np.arange(count))
    return q, v, inverse_dynamics(pendulum_plant(), q, v, a)


# Filtered regressors


@pytest.mark.parametrize("order", [1, 3])
def test_filtered_rows_are_the_filtered_efforts(order):
    """Against scipy's filter of Drake's efforts, without any acceleration."""
    q, v, effort = samples()
    filtered = FilteredRegressor(CONTROL, STEP, 15.0, order)
    memory, rows = filtered.start(), []
    for now in zip(q, v, effort, strict=True):
        memory = filtered.advanced(memory, *now)
        rows.append(filtered.rows(memory))
    Y, found = (np.array(part) for part in zip(*rows, strict=True))
    share = -np.expm1(-15.0 * STEP)
    expected = np.vstack([np.zeros(2), 0.5 * (effort[1:] + effort[:-1])])
    for _ in range(order):
        expected = lfilter([share], [1.0, share - 1.0], expected, axis=0)
    np.testing.assert_allclose(found, expected, atol=1e-10)
    # The trapezoidal rule is of second order.
    np.testing.assert_allclose(Y @ TRUTH, expected, atol=2e-5)


def test_what_is_missing_is_left_out_of_both_sides():
    q, v, effort = samples(1500)
    filtered = FilteredRegressor(CONTROL, STEP, 20.0)
    memory = filtered.start()
    for i, now in enumerate(zip(q, v, effort, strict=True)):
        if 300 <= i < 400:
            memory = filtered.skipped(memory)
        elif i in (500, 600):
            broken = [x.copy() for x in now]
            broken[(i // 100) % 3][0] = np.nan if i == 500 else np.inf
            memory = filtered.advanced(memory, *broken)
        else:
            memory = filtered.advanced(memory, *now)
        Y, u = filtered.rows(memory)
        assert np.isfinite(memory).all()
        np.testing.assert_allclose(Y @ TRUTH, u, atol=5e-5)


@pytest.mark.parametrize("held", [True, False])
def test_intervals_go_on_while_the_state_only_repeats(held):
    q, v, effort = samples(1500)
    filtered = FilteredRegressor(CONTROL, STEP, held_effort=held)
    every, slow = filtered.start(), filtered.start()
    for i in range(len(q)):
        # An effort that was held since the last instant is, for smooth ones, that of half way.
        u = 0.5 * (effort[i] + effort[i - 1]) if held and i else effort[i]
        every = filtered.advanced(every, q[i], v[i], u)
        seen = i - i % 3
        slow = filtered.advanced(slow, q[seen], v[seen], u, repeated=seen != i)
        if i % 3 == 0:
            Y, known = filtered.rows(slow)
            np.testing.assert_allclose(Y @ TRUTH, known, atol=5e-3)
    for one, other in zip(filtered.rows(slow), filtered.rows(every), strict=True):
        assert np.abs(one - other).max() < 0.02 * np.abs(other).max()


# Slabs


def slabs(rng, rows=3, size=0.3):
    """An estimate, rows and their values, tolerances, and a truth inside of the slabs."""
    x, truth = inside(rng, size), inside(rng, size)
    Y = rng.normal(size=(rows, MIXED.dimension))
    tolerance = rng.uniform(0.01, 0.5, rows)
    return x, Y, Y @ truth + rng.uniform(-1, 1, rows) * tolerance, tolerance, truth


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.integers(1, 6), st.sampled_from([0.3, 0.5, 1.0]))
def test_no_step_leads_away_from_the_truth(seed, rows, relaxation):
    """D(p‖y) ≤ D(p‖x) if p is in the slabs, whatever share is carried out."""
    x, Y, effort, tolerance, truth = slabs(np.random.default_rng(seed), rows)
    y = slab_step(MIXED, x, Y, effort, tolerance, relaxation=relaxation)
    before = MIXED.divergence(truth, x)
    assert MIXED.divergence(truth, y) <= before * (1 + 1e-9) + 1e-9


# Samples


def update(tolerance=2e-3, **options):
    return SampleUpdate(MANIFOLD, np.full(2, tolerance), **options)


def test_a_sample_is_explained_at_once():
    """The estimate is in the slabs of a sample after it; a nudge leaves much of its error."""
    rng, p = np.random.default_rng(0), perturbed(0.3)
    q, v, a = rng.normal(size=(3, 2))
    Y = CONTROL.at(q, v, v, a).regressor
    u, left = Y @ TRUTH, {}
    for method in ("projection", "nudge"):
        found = update(method=method).updated(p, Y, u, STEP)
        left[method] = np.abs(Y @ found.point - u).max()
        assert (found.error <= 1e-8) == (method == "projection")
        assert MANIFOLD.divergence(TRUTH, found.point) <= MANIFOLD.divergence(TRUTH, p)
    assert left["projection"] < 2e-3 * (1 + 1e-6)
    assert left["nudge"] > 0.3 * np.abs(Y @ p - u).max() > 10 * left["projection"]


def test_an_earlier_sample_holds_too_if_it_agrees():
    rng, p = np.random.default_rng(0), perturbed(0.3)
    (Y, other), made = rng.normal(size=(2, 2, len(p))), update()
    earlier = other, other @ TRUTH
    found = made.updated(p, Y, Y @ TRUTH, STEP, earlier=earlier)
    assert found.error <= 1e-8
    for rows in (Y, other):
        assert np.abs(rows @ (found.point - TRUTH)).max() < 2e-3 * (1 + 1e-6)
    # One that contradicts this sample is left out.
    alone = made.updated(p, Y, Y @ TRUTH, STEP).point
    against = made.updated(p, Y, Y @ TRUTH, STEP, earlier=(Y, Y @ TRUTH + 1.0))
    np.testing.assert_array_equal(against.point, alone)


def test_bodies_with_constraints_are_estimated_too():
    rng = np.random.default_rng(2)
    bounded = ConstrainedInertia(-np.eye(10)[:1], np.array([-2.0]))  # lighter than 2 kg
    manifold, truth, p = Product((bounded,)), perturbed(0.1)[:10], perturbed(0.3)[:10]
    made = SampleUpdate(manifold, 1e-5)
    before = manifold.divergence(truth, p)
    for _ in range(60):
        Y = rng.normal(size=(2, 10))
        p = made.updated(p, Y, Y @ truth, STEP).point
        assert manifold.contains(p)
    assert manifold.divergence(truth, p) < 0.2 * before


def test_a_nudge_goes_a_little_toward_efforts_that_no_body_has():
    p = perturbed(0.2)
    Y = np.zeros((2, len(p)))
    Y[:, 0] = 1.0
    moved = update(method="nudge").updated(p, Y, np.full(2, -3.0), STEP).point
    assert 0 < moved[0] < p[0]
    assert MANIFOLD.contains(moved)
    # No certificate, no step of a projection: there is no mass of −3 kg.
    for effort in ([-3.0, -3.0], [0.0, np.nan], [0.0, np.inf]):
        found = update().updated(p, Y, np.array(effort), STEP)
        assert found.point is p
        assert found.error == np.inf


def test_constraints_hold_after_every_sample():
    limits = mass_limits(len(TRUTH), 1, 0.9 * TRUTH[10], 1.1 * TRUTH[10])
    rng, made = np.random.default_rng(0), update(constraints=limits)
    p = TRUTH.copy()
    for _ in range(50):
        Y = rng.normal(size=(2, len(p)))
        p = made.updated(p, Y, rng.normal(size=2), STEP).point
        assert (LinearSet(limits).values(p) <= 1e-9).all()


def test_forgetting_goes_back_where_no_sample_holds():
    p = perturbed(0.2)
    made = update(forgetting=2.0, prior=TRUTH)
    nothing = (np.zeros((2, len(p))), np.zeros(2))
    gap = MANIFOLD.gradient(p) - MANIFOLD.gradient(TRUTH)
    for _ in range(1000):
        p = made.updated(p, *nothing, STEP).point
    left = MANIFOLD.gradient(p) - MANIFOLD.gradient(TRUTH)
    np.testing.assert_allclose(left, np.exp(-2.0) * gap, rtol=1e-5, atol=1e-7 * np.abs(gap).max())
