"""Guarantees of update laws, in continuous time and step by step."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_loops import CONTROL, MODEL, TRUTH, perturbed, run
from hypothesis import example, given, settings
from hypothesis import strategies as st
from random_points import CONSTRAINED, HULL, PRODUCT, random_inertia, random_point
from scipy.optimize import minimize

from geodrake.control import (
    ControlModel,
    PartialLaw,
    PassivityBasedAdaptiveController,
    euclidean_adaptation,
    natural_adaptation,
    parameter_manifold,
    pullback_adaptation,
)
from geodrake.control.adaptation import (
    AdaptationLaw,
    ConvexSet,
    ProjectedLaw,
    adapted_parameters,
    body_limits,
    center_of_mass_box,
    inside_ellipsoid,
    intersection,
    mass_limits,
    parameter_limits,
)
from geodrake.effects import CoulombFriction, EffortOffset, FittedEffect, Payload, ViscousFriction
from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.inertia import is_physical, pseudo_inertia
from geodrake.manifolds import PhysicalInertia, Positive, Product, bregman_projection

SIZE = PRODUCT.dimension
BODIES = Product((PhysicalInertia(), PhysicalInertia(), Positive(2)))

seeds = st.integers(0, 2**32 - 1)
properties = settings(max_examples=15)
few = settings(max_examples=6)
some = settings(max_examples=10)


def laws(manifold, at):
    return {
        "natural": natural_adaptation(manifold, 2.0),
        "pullback": pullback_adaptation(manifold, at, 2.0),
        "euclidean": euclidean_adaptation(manifold.dimension, 2.0),
    }


# Laws


@properties
@given(seeds, st.floats(-4, 8))
def test_estimates_stay_physical_at_any_step_size(seed, size):
    rng = np.random.default_rng(seed)
    start, law = random_point(BODIES, rng), natural_adaptation(BODIES, 0.5)
    estimate = law.step(start, rng.normal(size=BODIES.dimension), 10.0**size)
    assert np.isfinite(estimate).all()
    assert is_physical(estimate[:20].reshape(2, 10)).all()
    assert (estimate[20:] > 0).all()


@properties
@given(seeds)
def test_steps_follow_the_rate_to_first_order(seed):
    rng = np.random.default_rng(seed)
    estimate, b, h = random_point(PRODUCT, rng), rng.normal(size=SIZE), 1e-7
    for name, law in laws(PRODUCT, estimate).items():
        ahead, back = law.step(estimate, b, h), law.step(estimate, b, -h)
        rate = law.rate(estimate, b)
        np.testing.assert_allclose(
            (ahead - back) / (2 * h), rate, rtol=0, atol=1e-6 * np.abs(rate).max(), err_msg=name
        )
    euler = natural_adaptation(PRODUCT, integrator="euler")
    np.testing.assert_allclose(
        euler.step(estimate, b, h), estimate + h * euler.rate(estimate, b), rtol=1e-15
    )


@properties
@given(seeds)
def test_the_parameter_error_changes_by_what_tracking_loses(seed):
    """d/dt γ D(p‖p̂) = −(p̂ − p)ᵀ b, [Lee2019] Eq. (5.4.50) with (5.4.51)."""
    rng = np.random.default_rng(seed)
    truth, estimate = random_point(PRODUCT, rng), random_point(PRODUCT, rng)
    b, h = rng.normal(size=SIZE), 1e-6
    for name, law in laws(PRODUCT, estimate).items():
        ahead, back = (law.parameter_error(truth, law.step(estimate, b, s)) for s in (h, -h))
        scale = abs(ahead) + np.abs(truth - estimate) @ np.abs(b)
        expected = -(estimate - truth) @ b
        assert (ahead - back) / (2 * h) == pytest.approx(expected, abs=1e-6 * scale), name


# Projections


def limits(rng, estimate):
    """Return a polyhedron of all kinds of limits around a body similar to an estimate."""
    mass = estimate[0]
    com = estimate[11:14] / estimate[10]
    return intersection(
        mass_limits(22, 0, 0.5 * mass, 1.02 * mass),
        center_of_mass_box(22, 1, com - 0.1, com + 0.1),
        parameter_limits(22, [20, 21], 0.0, estimate[20:] * np.array([1.02, 3.0])),
        body_limits(22, 1, np.eye(10)[4:7].sum(0), upper=1.05 * estimate[14:17].sum()),
    )


def near(manifold, x, length, rng):
    """Return a point at some distance from x in a random direction."""
    b = rng.normal(size=manifold.dimension)
    v = manifold.inverse_metric_times(x, b)
    return manifold.retract(x, v * (length / np.sqrt(b @ v)))


@few
@given(seeds)
def test_projected_rates_break_no_limit_and_lose_nothing(seed):
    rng = np.random.default_rng(seed)
    inside = random_point(BODIES, rng)
    C = limits(rng, inside)
    b = rng.normal(size=22)
    law = ProjectedLaw(natural_adaptation(BODIES), C)
    boundary = law.project(near(BODIES, inside, 2.0, rng))
    rate, free = law.rate(boundary, b), law.law.rate(boundary, b)
    values, normals = law.limits(boundary)
    lengths = np.sqrt((normals * BODIES.inverse_metric_times(boundary, normals)).sum(-1))
    binding = values >= -1e-6 * lengths
    speed = np.sqrt(free @ BODIES.metric(boundary) @ free)
    assert (normals[binding] @ rate <= 1e-8 * lengths[binding] * speed).all()
    # V̇ of a truth in C is at most that of the free law, whose is −p̃ᵀ b: Proposition 5.8.
    metric = BODIES.metric(boundary)
    assert (boundary - inside) @ metric @ (rate - free) <= 1e-7 * speed * 10


@some
@given(seeds, st.floats(0.1, 8))
def test_projection_ends_in_the_set_and_nearer_to_all_of_it(seed, distance):
    rng = np.random.default_rng(seed)
    inside = random_point(BODIES, rng)
    C = limits(rng, inside)
    law = ProjectedLaw(natural_adaptation(BODIES), C)
    outside = near(BODIES, inside, distance, rng)
    projected = law.project(outside)
    assert (C.violation(projected) <= 1e-9 * np.abs(C.matrix).max()).all()
    whole = bregman_projection(BODIES, outside, C)  # not part by part
    gap = BODIES.divergence(projected, outside) - BODIES.divergence(whole, outside)
    assert abs(gap) < 1e-8 * (1.0 + BODIES.divergence(projected, outside))
    assert BODIES.divergence(projected, whole) < 1e-10
    truths = [inside, *(law.project(near(BODIES, inside, 1.0, rng)) for _ in range(2))]
    for truth in truths:  # [Lee2019] Eq. (5.4.60)
        before, after = BODIES.divergence(truth, outside), BODIES.divergence(truth, projected)
        assert after + BODIES.divergence(projected, outside) <= before + 1e-7 * (1.0 + before)
    np.testing.assert_allclose(law.project(projected), projected, rtol=1e-9, atol=1e-12)


def test_limits_that_no_body_meets_are_reported():
    negative = ProjectedLaw(natural_adaptation(BODIES), mass_limits(22, 0, -2.0, -1.0))
    with pytest.raises(ConvergenceError):
        negative.project(random_point(BODIES, np.random.default_rng(0)))


def centre_in_ball(radius):
    """Return a curved convex set: ‖h‖ ≤ radius m of the first body."""

    def value(p):
        return np.linalg.norm(p[1:4]) - radius * p[0]

    def gradient(p):
        normal = np.zeros(len(p))
        normal[1:4], normal[0] = p[1:4] / np.linalg.norm(p[1:4]), -radius
        return normal

    return ConvexSet(value, gradient)


@few
@given(seeds)
def test_projection_onto_a_curved_set_against_a_second_solver(seed):
    rng = np.random.default_rng(seed)
    manifold = Product((PhysicalInertia(),))
    x = random_inertia(rng)
    radius = 0.7 * np.linalg.norm(x[1:4]) / x[0]
    law = ProjectedLaw(natural_adaptation(manifold), centre_in_ball(radius))
    y = law.project(x)
    assert np.linalg.norm(y[1:4]) / y[0] <= radius * (1 + 1e-6)
    L = np.linalg.cholesky(manifold.metric(x))

    def position(z):
        return x + np.linalg.solve(L.T, z)

    def distance(z):
        point = position(z)
        return manifold.divergence(point, x) if manifold.contains(point) else 1e3

    constraint = {"type": "ineq", "fun": lambda z: -law.limits(position(z))[0][0]}
    start = L.T @ (y - x) + 0.01 * rng.normal(size=10)
    found = minimize(
        distance, start, method="SLSQP", constraints=[constraint], options={"ftol": 1e-13}
    )
    assert manifold.divergence(y, x) <= found.fun + 1e-6
    # The rate on the curved boundary stays in it, too.
    b = manifold.metric(y) @ rng.normal(size=10)
    edge = ProjectedLaw(law.law, law.constraints, margin=1e-3)
    assert law.limits(y)[1][0] @ edge.rate(y, b) <= 1e-9 * np.abs(b).sum()


@some
@given(seeds, st.floats(0, 8))
@example(49485, 3.0)
def test_a_step_of_any_length_ends_in_the_set(seed, size):
    rng = np.random.default_rng(seed)
    start = random_point(BODIES, rng)
    law = ProjectedLaw(natural_adaptation(BODIES), limits(rng, start))
    estimate = law.step(start, rng.normal(size=22), 10.0**size)
    assert BODIES.contains(estimate)
    values, normals = law.limits(estimate)
    lengths = np.sqrt((normals * BODIES.inverse_metric_times(estimate, normals)).sum(-1))
    assert (values <= 1e-7 * lengths).all()


def test_limits_say_what_they_mean():
    rng = np.random.default_rng(0)
    phi = random_inertia(rng)
    x = np.concatenate([random_inertia(rng), phi, [1.0, 2.0]])
    com = phi[1:4] / phi[0]

    def values(polyhedron):
        return ProjectedLaw(euclidean_adaptation(22), polyhedron).limits(x)[0]

    box = values(center_of_mass_box(22, 1, com - 0.1, com + 0.2))
    np.testing.assert_allclose(np.sort(-box), np.sort(phi[0] * np.repeat([0.1, 0.2], 3)))
    ellipsoid = values(inside_ellipsoid(22, 1, HULL.quadric))
    np.testing.assert_allclose(-ellipsoid, np.trace(pseudo_inertia(phi) @ HULL.quadric))
    mass = values(mass_limits(22, 1, 0.0, phi[0] + 0.5))
    np.testing.assert_allclose(mass, [-0.5, -phi[0]])
    with pytest.raises(ArgumentError, match="22 parameters"):
        mass_limits(22, 2, 0.0, 1.0)
    for index in (22, -1):
        with pytest.raises(ArgumentError, match="from 0 to 21"):
            parameter_limits(22, [index], 0.0, 1.0)
    with pytest.raises(ArgumentError, match="lower must be"):
        parameter_limits(22, [1], [0.0, 1.0], 1.0)
    with pytest.raises(ArgumentError, match="corner"):
        center_of_mass_box(22, 0, [1.0, 0.0, 0.0], [0.0, 1.0, 1.0])


# Robots


def test_the_manifold_of_a_robot():
    effects = [kind(j) for j in MODEL.joints for kind in (CoulombFriction, ViscousFriction)]
    arm = replace(MODEL, effects=tuple(FittedEffect(e, np.array([0.2])) for e in effects))
    manifold = parameter_manifold(arm, effect_weight=0.5, weights={"coulomb_friction": 0.25})
    nb = len(arm.bodies)
    assert manifold.weights == (1.0,) * nb + (0.25, 0.5) * 2
    assert manifold.contains(ControlModel.of(arm).prior)
    hull = parameter_manifold(arm, bodies={arm.bodies[0]: CONSTRAINED})
    assert hull.manifolds[0] is CONSTRAINED
    offset = replace(arm, effects=(FittedEffect(EffortOffset(arm.joints[0]), np.zeros(1)),))
    assert parameter_manifold(offset).dimension == 10 * nb + 1
    with pytest.raises(ArgumentError, match="no nowhere"):
        parameter_manifold(arm, weights={"nowhere": 1.0})
    with pytest.raises(ArgumentError, match="instead of ten"):
        parameter_manifold(arm, bodies={arm.bodies[0]: Positive()})


# Of some of the parameters


LAST = MODEL.bodies[-1]
BODY = adapted_parameters(MODEL, [LAST])
"""The parameters of the last body."""


def partial(gamma=0.5):
    return PartialLaw(natural_adaptation(PhysicalInertia(), gamma), BODY)


@some
@given(st.integers(0, 2**31), st.floats(-6, 4))
def test_it_is_natural_adaptation_on_the_submanifold(seed, size):
    rng, dt = np.random.default_rng(seed), 10.0**size
    p, b = perturbed(0.2, seed), rng.normal(size=len(TRUTH))
    law, own = partial(), natural_adaptation(PhysicalInertia(), 0.5)
    moved = law.step(p, b, dt)
    np.testing.assert_array_equal(moved[~BODY], p[~BODY])
    np.testing.assert_array_equal(moved[BODY], own.step(p[BODY], b[BODY], dt))
    assert is_physical(moved[10:20])
    np.testing.assert_array_equal(law.rate(p, b)[BODY], own.rate(p[BODY], b[BODY]))
    assert law.parameter_error(TRUTH, p) == own.parameter_error(TRUTH[BODY], p[BODY])
    rows = rng.normal(size=(2, len(p)))
    assert law.calc_reach(p, rows) == own.calc_reach(p[BODY], rows[:, BODY])


def test_a_load_is_learned_while_the_rest_stays():
    """By [Lee2019] §5.5.2, V never rises; known parameters do not change at all."""
    start = np.where(BODY, perturbed(0.15), TRUTH)
    controller = PassivityBasedAdaptiveController(
        CONTROL, partial(0.05), parameters=start, truth=TRUTH, time_step=2e-3
    )
    _, logs = run(controller, 1.0)
    V = logs["lyapunov"].ravel()
    assert np.diff(V).max() <= 1e-4 * V[0]
    assert V[-1] < V[0]
    held = logs["parameters"][:, ~BODY]
    np.testing.assert_array_equal(held, np.broadcast_to(TRUTH[~BODY], held.shape))
    assert is_physical(logs["parameters"][:, BODY]).all()
    assert np.abs(logs["parameters"][-1] - start).max() > 1e-3
    with pytest.raises(ArgumentError, match="inside the law's manifold"):
        PassivityBasedAdaptiveController(CONTROL, partial(), parameters=-TRUTH)


def test_parameters_by_the_names_of_bodies_and_effects():
    assert np.flatnonzero(BODY).tolist() == list(range(10, 20))
    friction = adapted_parameters(MODEL, ["viscous_friction"])
    assert np.flatnonzero(friction).tolist() == [20, 21]
    load = FittedEffect(Payload(LAST), TRUTH[10:20])
    loaded = replace(MODEL, effects=(*MODEL.effects, load))
    assert np.flatnonzero(adapted_parameters(loaded, "payload")).tolist() == list(range(22, 32))
    for names, message in (
        ([], "at least one parameter"),
        (["wrist"], "no wrist"),
        (["payload"], "payload"),
    ):
        with pytest.raises(ArgumentError, match=message):
            adapted_parameters(MODEL, names)


def test_laws_that_do_not_fit_are_refused():
    for law, adapted, message in (
        (natural_adaptation(Positive(2)), BODY, "has 2 parameters, but 10 are"),
        (euclidean_adaptation(9), BODY, "has 9 parameters"),
        (natural_adaptation(PhysicalInertia()), np.zeros(22, bool), "at least one of them true"),
        (natural_adaptation(PhysicalInertia()), np.arange(10), "booleans"),
        ("natural", BODY, "law must be"),
    ):
        with pytest.raises(ArgumentError, match=message):
            PartialLaw(law, adapted)
    longer = PartialLaw(
        AdaptationLaw(Product((PhysicalInertia(),))), np.repeat([True, False], [10, 13])
    )
    with pytest.raises(ArgumentError, match="has 23 parameters, but the robot 22"):
        PassivityBasedAdaptiveController(CONTROL, longer)
