"""Laws of some of the parameters: the law of a submanifold, and what is held stays as it was."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_loops import CONTROL, MANIFOLD, MODEL, TRUTH, perturbed, run
from hypothesis import given, settings
from hypothesis import strategies as st

from geodrake.control.adaptation import (
    AdaptationLaw,
    PartialLaw,
    ProjectedLaw,
    adapted_parameters,
    euclidean_adaptation,
    natural_adaptation,
)
from geodrake.control.systems import PassivityBasedAdaptiveController
from geodrake.effects import FittedEffect, Payload
from geodrake.errors import ArgumentError
from geodrake.inertia import is_physical
from geodrake.manifolds import PhysicalInertia, Polyhedron, Positive, Product

LAST = MODEL.bodies[-1]
BODY = adapted_parameters(MODEL, [LAST])
"""The parameters of the last body."""
some = settings(max_examples=20)


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
    assert law.reach(p, rows) == own.reach(p[BODY], rows[:, BODY])


@some
@given(st.integers(0, 2**31))
def test_it_is_the_whole_law_projected_onto_what_may_vary(seed):
    """[Lee2019] Eq. (5.4.57) with every held parameter as a limit, of half a body here as well.

    The metric of the submanifold is that of its part of the Hessian.
    """
    rng = np.random.default_rng(seed)
    p, b = perturbed(0.2, seed), rng.normal(size=len(TRUTH))
    whole = natural_adaptation(MANIFOLD, 0.5)
    held = np.eye(len(p))[~BODY]
    limits = Polyhedron(held, held @ p, held @ p)
    projected = ProjectedLaw(whole, limits).rate(p, b)
    np.testing.assert_allclose(partial().rate(p, b), projected, rtol=1e-7, atol=1e-9)
    # By Lagrange's conditions, for any choice of what is held.
    held = rng.random(len(p)) < 0.5
    g = MANIFOLD.metric(p)
    free = ~held
    expected = np.zeros(len(p))
    expected[free] = -np.linalg.solve(g[np.ix_(free, free)], b[free]) / 0.5
    held_rows = np.eye(len(p))[held]
    limits = Polyhedron(held_rows, p[held], p[held])
    found = ProjectedLaw(whole, limits).rate(p, b)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


def test_a_load_is_learned_while_the_rest_stays():
    """[Lee2019] §5.5.2: V never rises, and no bit of what is known changes."""
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
    with pytest.raises(ArgumentError, match="inside of the law's manifold"):
        PassivityBasedAdaptiveController(CONTROL, partial(), parameters=-TRUTH)


def test_parameters_by_the_names_of_bodies_and_effects():
    assert np.flatnonzero(BODY).tolist() == list(range(10, 20))
    friction = adapted_parameters(MODEL, ["viscous_friction"])
    assert np.flatnonzero(friction).tolist() == [20, 21]
    load = FittedEffect(Payload(LAST), TRUTH[10:20])
    loaded = replace(MODEL, effects=(*MODEL.effects, load))
    assert np.flatnonzero(adapted_parameters(loaded, "payload")).tolist() == list(range(22, 32))
    for names, message in (
        ([], "there is none"),
        (["wrist"], "no wrist"),
        (["payload"], "payload"),
    ):
        with pytest.raises(ArgumentError, match=message):
            adapted_parameters(MODEL, names)


def test_laws_that_do_not_fit_are_refused():
    for law, adapted, message in (
        (natural_adaptation(Positive(2)), BODY, "moves 2 parameters; 10 are"),
        (euclidean_adaptation(9), BODY, "moves 9 parameters"),
        (natural_adaptation(PhysicalInertia()), np.zeros(22, bool), "some of them true"),
        (natural_adaptation(PhysicalInertia()), np.arange(10), "booleans"),
        ("natural", BODY, "law must be"),
    ):
        with pytest.raises(ArgumentError, match=message):
            PartialLaw(law, adapted)
    longer = PartialLaw(
        AdaptationLaw(Product((PhysicalInertia(),))), np.repeat([True, False], [10, 13])
    )
    with pytest.raises(ArgumentError, match="moves 23 parameters; the robot has 22"):
        PassivityBasedAdaptiveController(CONTROL, longer)
