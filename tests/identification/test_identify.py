"""`identify`: invariance, the two forms, constraints, a human's data, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import THREE as PRIOR
from identified_bodies import random_data, restated
from scipy.linalg import block_diag

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification import BodyConstraints, identify
from geodrake.inertia import Ellipsoid, is_physical, pseudo_inertia

REGULARIZERS = ("euclidean", "pullback", "entropic", "riemannian")


def data(seed, *, rows=24, **options):
    """Fewer rows than parameters."""
    return random_data(seed, PRIOR, rows=rows, **options)


def balls(radius, away=0.0):
    """Q (3, 4, 4) of balls around the centres of mass, or away from them."""
    return Ellipsoid(PRIOR[:, 1:4] / PRIOR[:, :1] + away, [radius] * 3, np.eye(3)).quadric


@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_results_say_what_was_found(regularizer):
    A, b = data(0, extra=2)
    sigma = np.random.default_rng(0).uniform(0.2, 0.4, len(b))
    bounds = [[0.0, 1.5], [-np.inf, np.inf]]
    result = identify(
        A, b, PRIOR, regularizer=regularizer, gamma=0.7, sigma=sigma, extra_bounds=bounds
    )
    errors = (A @ np.append(result.phi.ravel(), result.extra) - b) / sigma
    assert result.phi.shape == (3, 10) and result.extra.shape == (2,)
    assert result.residual == pytest.approx(errors @ errors, rel=1e-9)
    assert is_physical(result.phi).all() and 0 <= result.extra[0] <= 1.5
    assert (result.regularizer, result.gamma) == (regularizer, 0.7)
    assert result.solver and result.solve_time > 0


@pytest.mark.parametrize("regularizer", ["pullback", "entropic", "riemannian"])
@given(
    seed=st.integers(0, 10_000),
    length=st.floats(0.05, 20.0),
    mass=st.floats(0.05, 20.0),
    log_unit=st.floats(-6.0, 6.0),
    log_gamma=st.floats(-3.0, 3.0),
)
@settings(max_examples=4)
def test_invariance_under_frames_and_units(regularizer, seed, length, mass, log_unit, log_gamma):
    """The same bodies and scalars, whatever frame and units they are stated in."""
    T, prior = restated(seed, PRIOR, length, mass)
    A, b = data(seed, noise=1.0, extra=2)
    gamma, in_unit = 10.0**log_gamma, np.array([10.0**log_unit, 1.0])
    T = block_diag(T, np.diag(in_unit))
    scalars, bounds = np.array([1.5, 3.0]), np.array([[0.0, 1.8], [-np.inf, np.inf]])
    options = {"regularizer": regularizer, "gamma": gamma}
    first = identify(A, b, PRIOR, extra_prior=scalars, extra_bounds=bounds, **options)
    turned = {"extra_prior": in_unit * scalars, "extra_bounds": in_unit[:, None] * bounds}
    other = identify(A @ np.linalg.inv(T), b, prior, **turned, **options)
    back = np.linalg.solve(T, np.append(other.phi, other.extra))
    np.testing.assert_allclose(back[-2:], first.extra, rtol=1e-5)
    root = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(PRIOR)))
    bodies = (first.phi, back[:-2].reshape(PRIOR.shape))
    one, two = (root @ pseudo_inertia(phi) @ root.mT for phi in bodies)
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-6 * np.abs(one).max())
    cost, again = (fit.residual + gamma * fit.divergence for fit in (first, other))
    assert again == pytest.approx(cost, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_point_to_set_is_the_regularized_form_of_its_gamma(regularizer):
    A, b = data(4, rows=60, extra=1)
    options = {"regularizer": regularizer, "extra_prior": [3.0]}
    first = identify(A, b, PRIOR, gamma=3.0, **options)
    bound = identify(A, b, PRIOR, residual_bound=first.residual, **options)
    assert bound.residual == pytest.approx(first.residual, rel=1e-6)
    assert bound.divergence == pytest.approx(first.divergence, rel=1e-5)
    assert bound.gamma == pytest.approx(3.0, rel=1e-3)
    np.testing.assert_allclose(bound.phi, first.phi, atol=1e-4)
    np.testing.assert_allclose(bound.extra, first.extra, rtol=1e-5)
    assert first.certificate.holds and bound.certificate.holds
    assert not first.certificate.replaced and not bound.certificate.replaced


@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_a_generous_residual_bound_or_exact_data_give_the_prior(regularizer):
    """Of exact data, the cost is rounding, which is nothing beside γ."""
    A, b = data(5)
    generous = 2.0 * np.sum((A @ PRIOR.ravel() - b) ** 2)
    result = identify(A, b, PRIOR, regularizer=regularizer, residual_bound=generous)
    np.testing.assert_allclose(result.phi, PRIOR, atol=1e-7)
    assert np.isinf(result.gamma) and result.divergence < 1e-6
    exact = identify(A, A @ PRIOR.ravel(), PRIOR, regularizer=regularizer, gamma=1.0)
    np.testing.assert_allclose(exact.phi, PRIOR, atol=1e-9)
    assert exact.certificate.holds


def test_total_mass_and_ellipsoids_hold():
    A, b = data(6)
    Q = balls(0.25)
    for regularizer in REGULARIZERS:
        result = identify(
            A, b, PRIOR, regularizer=regularizer, gamma=0.1, ellipsoids=Q, total_mass=8.0
        )
        assert result.phi[:, 0].sum() == pytest.approx(8.0, rel=1e-7)
        inside = np.einsum("bij,bji->b", pseudo_inertia(result.phi), Q)
        assert (inside > -1e-7).all()
    with pytest.raises(ArgumentError, match=r"bodies \[0, 1, 2\].*use −Q"):
        identify(A, b, PRIOR, regularizer="pullback", gamma=1.0, ellipsoids=-Q)


BAD = {
    "regularizer": ({"regularizer": "ridge"}, 'one of "euclidean", "pullback", .* is .ridge'),
    "neither": ({"gamma": None}, "Exactly one of gamma and residual_bound"),
    "both": ({"residual_bound": 1.0}, "Exactly one of gamma and residual_bound"),
    "gamma": ({"gamma": 0.0}, "gamma must be .* above 0; it is 0"),
    "b": ({"b": np.ones(3)}, r"b must be \(24,\) .* \(3,\)"),
    "words": ({"b": ["1", "two"]}, r"b must be \(24,\) finite real numbers; it is \['1', 'two'\]"),
    "ragged": ({"A": [[1.0, 2.0], [3.0]]}, "A must be .* it is"),
    "solver": (
        {"solver": "simplex"},
        "Conic solver 'simplex' is unknown or not installed; available: clarabel",
    ),
    "no bodies": ({"prior": np.zeros((0, 10))}, "The prior has no bodies"),
    "nan": ({"b": np.full(24, np.nan)}, r"b must be .* has nan at \[0\]"),
    "prior": (
        {"prior": PRIOR * np.array([[1], [-1], [1]])},
        r"not physical for bodies \[1\].*eigenvalues -",
    ),
    "bodies": ({"prior": np.vstack([PRIOR, PRIOR])}, "30 columns, but 6 bodies of the prior need"),
    "sigma": ({"sigma": -1.0}, "sigma has values that are not positive"),
    "sigma shape": ({"sigma": np.ones(3)}, r"sigma must be \(24,\)"),
    "ellipsoids": ({"ellipsoids": np.eye(4)}, r"ellipsoids must be \(3, 4, 4\)"),
    "mass": ({"total_mass": -1.0}, "total_mass must be a finite number"),
    "extra": ({"extra_bounds": [[0, 1]]}, r"extra_bounds must be \(0, 2\)"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused(name):
    A, b = data(7)
    change, message = BAD[name]
    arguments = {"A": A, "b": b, "prior": PRIOR, "regularizer": "pullback", "gamma": 1.0}
    arguments |= change
    with pytest.raises(ArgumentError, match=message):
        identify(arguments.pop("A"), arguments.pop("b"), arguments.pop("prior"), **arguments)


def test_a_residual_bound_that_no_physical_body_reaches():
    A = np.eye(10)[[0, 4, 5, 6]]
    b = np.array([-1.0, 0.1, 0.1, 0.1])  # a negative mass
    for regularizer in REGULARIZERS:
        options = {"regularizer": regularizer, "certify": False}
        with pytest.raises(ArgumentError, match="physical bodies inside all") as caught:
            identify(A, b, PRIOR[:1], residual_bound=0.01, **options)
        assert caught.value.evidence["minimum"] == pytest.approx(1.0, rel=1e-4)
        reached = identify(A, b, PRIOR[:1], residual_bound=1.01, **options)
        assert reached.residual == pytest.approx(1.01, rel=1e-6)


def test_the_conic_solver_stands_in_where_newtons_method_gives_up(monkeypatch):
    A, b = data(12, rows=40, extra=1, noise=2.0)
    options = {"regularizer": "pullback", "total_mass": 7.0, "extra_bounds": [[0.0, 1.5]]}
    first = identify(A, b, PRIOR, gamma=0.05, **options)
    bound = identify(A, b, PRIOR, residual_bound=first.residual, **options)
    assert first.solver == bound.solver == "newton"
    assert bound.residual == pytest.approx(first.residual, rel=1e-9)
    assert bound.gamma == pytest.approx(0.05, rel=1e-3)
    np.testing.assert_allclose(bound.phi, first.phi, atol=1e-6)

    def failing(*_arguments, **_settings):
        raise IdentificationError("Newton's method found nothing.")

    monkeypatch.setattr("geodrake.identification.conic_fit.solve_newton", failing)
    alone = identify(A, b, PRIOR, gamma=0.05, **options)
    assert alone.solver == "clarabel" and "found nothing" in alone.note
    np.testing.assert_allclose(alone.phi, first.phi, atol=1e-5)


@pytest.mark.parametrize(
    ("regularizer", "solver"),
    [("euclidean", "newton"), ("pullback", None), ("entropic", "clarabel"), ("riemannian", None)],
)
def test_contradictory_constraints_are_named(regularizer, solver):
    A, b = data(7)
    heavy = BodyConstraints(mass_bounds=[[4, 5], [0, 1], [0, 1]])
    options = {"regularizer": regularizer, "gamma": 1.0, "solver": solver}
    with pytest.raises(IdentificationError, match="infeasible"):
        identify(A, b, PRIOR, total_mass=1.0, constraints=heavy, **options)


@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_bounds_on_mass_and_centre_of_mass_hold(regularizer):
    A, b = data(9, noise=2.0)
    com = PRIOR[:, 1:4] / PRIOR[:, :1]
    free = identify(A, b, PRIOR, regularizer=regularizer, gamma=0.05)
    outside = np.abs(free.phi[:, 1:4] / free.phi[:, :1] - com) > 0.01
    assert outside.any(), "the bounds do nothing: a weak test"
    bounds = BodyConstraints(
        mass_bounds=[[3.9, 4.1], [-np.inf, np.inf], [0.5, np.inf]],
        com_bounds=np.stack([com - 0.01, com + 0.01], -1),
    )
    options = {"regularizer": regularizer, "gamma": 0.05, "constraints": bounds}
    result = identify(A, b, PRIOR, total_mass=7.0, **options)
    mass = result.phi[:, 0]
    assert 3.9 - 1e-7 <= mass[0] <= 4.1 + 1e-7 and mass[2] >= 0.5 - 1e-7
    assert mass.sum() == pytest.approx(7.0, rel=1e-7)
    assert (np.abs(result.phi[:, 1:4] / mass[:, None] - com) < 0.01 + 1e-6).all()
    assert result.certificate.holds and not result.certificate.replaced
    with pytest.raises(ArgumentError, match="total_mass is given twice"):
        both = BodyConstraints(total_mass=7.0)
        identify(A, b, PRIOR, regularizer=regularizer, gamma=1.0, total_mass=7.0, constraints=both)


CONSTRAINTS = {
    "mass shape": ({"mass_bounds": [[0, 1]]}, r"mass_bounds must be \(3, 2\) .* \(1, 2\)"),
    "mass order": (
        {"mass_bounds": [[2, 1]] * 3},
        r"mass_bounds has lower values above .* at \[\[0\]",
    ),
    "no mass": ({"mass_bounds": [[-2, -1]] * 3}, r"no positive mass of bodies \[0, 1, 2\]"),
    "com shape": ({"com_bounds": np.zeros((3, 2))}, r"com_bounds must be \(3, 3, 2\)"),
    "nan": ({"com_bounds": np.full((3, 3, 2), np.nan)}, "com_bounds has lower values above"),
    "mass": ({"total_mass": np.inf}, "total_mass must be a finite number"),
}


@pytest.mark.parametrize("name", CONSTRAINTS)
def test_bad_constraints_are_refused(name):
    change, message = CONSTRAINTS[name]
    with pytest.raises(ArgumentError, match=message):
        BodyConstraints(**change).rows(PRIOR, 32)


def test_an_impossible_prior_comes_with_the_nearest_possible_one():
    A, b = data(11)
    bad = PRIOR.copy()
    bad[1, 4] = 1.0  # Ixx > Iyy + Izz
    bad[2] = 0.0
    with pytest.raises(ArgumentError, match=r"not physical for bodies \[1, 2\]") as caught:
        identify(A, b, bad, regularizer="entropic", gamma=1.0)
    nearest = caught.value.evidence["nearest"]
    assert is_physical(nearest).all()
    np.testing.assert_array_equal(nearest[0], PRIOR[0])
    np.testing.assert_allclose(nearest[1, :4], PRIOR[1, :4])
    assert identify(A, b, nearest, regularizer="entropic", gamma=1.0).residual > 0
