"""Identification: results, bounds, priors, and comparison of regularizers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import THREE, TWO, random_data, restated
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification import (
    REGULARIZERS,
    BodyConstraints,
    FitProblem,
    PointMasses,
    PointMassEuclidean,
    PointMassKL,
    Riemannian,
    compare_regularizers,
    identify,
    least_squares,
    solve_fit,
)
from geodrake.identification.problem import whitened_factor
from geodrake.inertia import (
    Ellipsoid,
    from_mass_com_inertia,
    is_physical,
    pseudo_inertia,
    pullback_metric,
)

KINDS = ("euclidean", "pullback", "entropic", "riemannian")


def data(seed, *, rows=24, **options):
    """Return fewer rows than parameters."""
    return random_data(seed, THREE, rows=rows, **options)


def balls(radius, away=0.0):
    """Return Q (3, 4, 4) of balls around the centres of mass, or away from them."""
    return Ellipsoid(THREE[:, 1:4] / THREE[:, :1] + away, [radius] * 3, np.eye(3)).quadric


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
    T, prior = restated(seed, THREE, length, mass)
    A, b = data(seed, noise=1.0, extra=2)
    gamma, in_unit = 10.0**log_gamma, np.array([10.0**log_unit, 1.0])
    T = block_diag(T, np.diag(in_unit))
    scalars, bounds = np.array([1.5, 3.0]), np.array([[0.0, 1.8], [-np.inf, np.inf]])
    options = {"regularizer": regularizer, "gamma": gamma}
    first = identify(A, b, THREE, extra_prior=scalars, extra_bounds=bounds, **options)
    turned = {"extra_prior": in_unit * scalars, "extra_bounds": in_unit[:, None] * bounds}
    other = identify(A @ np.linalg.inv(T), b, prior, **turned, **options)
    back = np.linalg.solve(T, np.append(other.phi, other.extra))
    np.testing.assert_allclose(back[-2:], first.extra, rtol=1e-5)
    root = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(THREE)))
    bodies = (first.phi, back[:-2].reshape(THREE.shape))
    one, two = (root @ pseudo_inertia(phi) @ root.mT for phi in bodies)
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-6 * np.abs(one).max())
    cost, again = (fit.residual + gamma * fit.divergence for fit in (first, other))
    assert again == pytest.approx(cost, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("regularizer", KINDS)
def test_point_to_set_is_the_regularized_form_of_its_gamma(regularizer):
    A, b = data(4, rows=60, extra=1)
    options = {"regularizer": regularizer, "extra_prior": [3.0]}
    first = identify(A, b, THREE, gamma=3.0, **options)
    bound = identify(A, b, THREE, residual_bound=first.residual, **options)
    assert bound.residual == pytest.approx(first.residual, rel=1e-6)
    assert bound.divergence == pytest.approx(first.divergence, rel=1e-5)
    assert bound.gamma == pytest.approx(3.0, rel=1e-3)
    np.testing.assert_allclose(bound.phi, first.phi, atol=1e-4)
    np.testing.assert_allclose(bound.extra, first.extra, rtol=1e-5)
    assert first.certificate.holds and bound.certificate.holds
    assert not first.certificate.replaced and not bound.certificate.replaced


@pytest.mark.parametrize("regularizer", KINDS)
def test_a_generous_residual_bound_or_exact_data_give_the_prior(regularizer):
    """Of exact data, the cost is rounding, which is nothing beside γ."""
    A, b = data(5)
    generous = 2.0 * np.sum((A @ THREE.ravel() - b) ** 2)
    result = identify(A, b, THREE, regularizer=regularizer, residual_bound=generous)
    np.testing.assert_allclose(result.phi, THREE, atol=1e-7)
    assert np.isinf(result.gamma) and result.divergence < 1e-6
    exact = identify(A, A @ THREE.ravel(), THREE, regularizer=regularizer, gamma=1.0)
    np.testing.assert_allclose(exact.phi, THREE, atol=1e-9)
    assert exact.certificate.holds


def test_total_mass_and_ellipsoids_hold():
    A, b = data(6)
    Q = balls(0.25)
    for regularizer in KINDS:
        result = identify(
            A, b, THREE, regularizer=regularizer, gamma=0.1, ellipsoids=Q, total_mass=8.0
        )
        assert result.phi[:, 0].sum() == pytest.approx(8.0, rel=1e-7)
        inside = np.einsum("bij,bji->b", pseudo_inertia(result.phi), Q)
        assert (inside > -1e-7).all()
    with pytest.raises(ArgumentError, match=r"bodies \[0, 1, 2\].*use −Q"):
        identify(A, b, THREE, regularizer="pullback", gamma=1.0, ellipsoids=-Q)


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
        {"prior": THREE * np.array([[1], [-1], [1]])},
        r"not physical for bodies \[1\].*eigenvalues -",
    ),
    "bodies": ({"prior": np.vstack([THREE, THREE])}, "30 columns, but 6 bodies of the prior need"),
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
    arguments = {"A": A, "b": b, "prior": THREE, "regularizer": "pullback", "gamma": 1.0}
    arguments |= change
    with pytest.raises(ArgumentError, match=message):
        identify(arguments.pop("A"), arguments.pop("b"), arguments.pop("prior"), **arguments)


def test_a_residual_bound_that_no_physical_body_reaches():
    A = np.eye(10)[[0, 4, 5, 6]]
    b = np.array([-1.0, 0.1, 0.1, 0.1])  # a negative mass
    for regularizer in KINDS:
        options = {"regularizer": regularizer, "certify": False}
        with pytest.raises(ArgumentError, match="physical bodies inside all") as caught:
            identify(A, b, THREE[:1], residual_bound=0.01, **options)
        assert caught.value.evidence["minimum"] == pytest.approx(1.0, rel=1e-4)
        reached = identify(A, b, THREE[:1], residual_bound=1.01, **options)
        assert reached.residual == pytest.approx(1.01, rel=1e-6)


def test_the_conic_solver_stands_in_where_newtons_method_gives_up(monkeypatch):
    A, b = data(12, rows=40, extra=1, noise=2.0)
    options = {"regularizer": "pullback", "total_mass": 7.0, "extra_bounds": [[0.0, 1.5]]}
    first = identify(A, b, THREE, gamma=0.05, **options)
    bound = identify(A, b, THREE, residual_bound=first.residual, **options)
    assert first.solver == bound.solver == "newton"
    assert bound.residual == pytest.approx(first.residual, rel=1e-9)
    assert bound.gamma == pytest.approx(0.05, rel=1e-3)
    np.testing.assert_allclose(bound.phi, first.phi, atol=1e-6)

    def failing(*_arguments, **_settings):
        raise IdentificationError("Newton's method found nothing.")

    monkeypatch.setattr("geodrake.identification.conic_fit.solve_newton", failing)
    alone = identify(A, b, THREE, gamma=0.05, **options)
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
        identify(A, b, THREE, total_mass=1.0, constraints=heavy, **options)


@pytest.mark.parametrize("regularizer", KINDS)
def test_bounds_on_mass_and_centre_of_mass_hold(regularizer):
    A, b = data(9, noise=2.0)
    com = THREE[:, 1:4] / THREE[:, :1]
    free = identify(A, b, THREE, regularizer=regularizer, gamma=0.05)
    outside = np.abs(free.phi[:, 1:4] / free.phi[:, :1] - com) > 0.01
    assert outside.any(), "the bounds do nothing: a weak test"
    bounds = BodyConstraints(
        mass_bounds=[[3.9, 4.1], [-np.inf, np.inf], [0.5, np.inf]],
        com_bounds=np.stack([com - 0.01, com + 0.01], -1),
    )
    options = {"regularizer": regularizer, "gamma": 0.05, "constraints": bounds}
    result = identify(A, b, THREE, total_mass=7.0, **options)
    mass = result.phi[:, 0]
    assert 3.9 - 1e-7 <= mass[0] <= 4.1 + 1e-7 and mass[2] >= 0.5 - 1e-7
    assert mass.sum() == pytest.approx(7.0, rel=1e-7)
    assert (np.abs(result.phi[:, 1:4] / mass[:, None] - com) < 0.01 + 1e-6).all()
    assert result.certificate.holds and not result.certificate.replaced
    with pytest.raises(ArgumentError, match="total_mass is given twice"):
        both = BodyConstraints(total_mass=7.0)
        identify(A, b, THREE, regularizer=regularizer, gamma=1.0, total_mass=7.0, constraints=both)


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
        BodyConstraints(**change).rows(THREE, 32)


def test_an_impossible_prior_comes_with_the_nearest_possible_one():
    A, b = data(11)
    bad = THREE.copy()
    bad[1, 4] = 1.0  # Ixx > Iyy + Izz
    bad[2] = 0.0
    with pytest.raises(ArgumentError, match=r"not physical for bodies \[1, 2\]") as caught:
        identify(A, b, bad, regularizer="entropic", gamma=1.0)
    nearest = caught.value.evidence["nearest"]
    assert is_physical(nearest).all()
    np.testing.assert_array_equal(nearest[0], THREE[0])
    np.testing.assert_allclose(nearest[1, :4], THREE[1, :4])
    assert identify(A, b, nearest, regularizer="entropic", gamma=1.0).residual > 0


def data_of_two(seed, *, rows=15, **options):
    return random_data(seed, TWO, rows=rows, **options)


def test_a_regularizer_has_its_own_prior_of_scalars():
    A, b = data_of_two(1, rows=40, extra=1)
    A[:, -1] = 0.0
    kinds = {"regularizers": ("pullback", "entropic"), "gamma": 20.0, "certify": False}
    own = {"pullback": [3.0]}
    found = compare_regularizers(A, b, TWO, extra_prior=[2.0], extra_priors=own, **kinds)
    extra = [found.results[name].extra[0] for name in kinds["regularizers"]]
    np.testing.assert_allclose(extra, [3.0, 2.0], rtol=1e-5)
    with pytest.raises(ArgumentError, match="pulback"):
        compare_regularizers(A, b, TWO, extra_priors={"pulback": [3.0]}, **kinds)


@pytest.mark.parametrize(("reference", "gamma"), [("euclidean", 2000.0), ("riemannian", 20.0)])
def test_all_residuals_are_equal(reference, gamma):
    A, b = data_of_two(0, rows=40, extra=1, noise=0.1)
    points = PointMasses.of_bodies(TWO, 30)
    kinds = ["euclidean", "pullback", "entropic", "riemannian"]
    regularizers = [*kinds, PointMassEuclidean(points), PointMassKL(points)]
    options = {"gamma": gamma, "sigma": 0.3, "extra_bounds": [[0.0, np.inf]], "certify": False}
    found = compare_regularizers(
        A, b, TWO, reference=reference, regularizers=regularizers, **options
    )
    assert list(found.results) == [*kinds, "point_mass_euclidean", "point_mass_kl"]
    alone = identify(A, b, TWO, regularizer=reference, **options)
    assert found.residual == pytest.approx(alone.residual, rel=1e-9)
    for name, result in found.results.items():
        x = np.append(result.phi.ravel(), result.extra)
        assert np.sum(((A @ x - b) / 0.3) ** 2) == pytest.approx(found.residual, rel=1e-5), name
        assert is_physical(result.phi).all() and result.regularizer == name
    assert (found.reference, found.gamma) == (reference, gamma)


def test_open_directions_are_named():
    A, b = data_of_two(4, rows=60)
    free = least_squares(A, b, bodies=2)
    np.testing.assert_allclose(free.x, np.linalg.lstsq(A, b)[0], rtol=1e-9)
    assert free.rank == 20 and free.directions.shape == (0, 20)
    A[:, 4] = 0.0  # Ixx of body 0
    A[:, 12] = 3.0 * A[:, 1]  # hy of body 1 like hx of body 0
    with pytest.raises(IdentificationError, match="do not identify 2 of 20 directions") as caught:
        least_squares(A, b, bodies=2)
    directions = caught.value.evidence["directions"]
    np.testing.assert_allclose(A @ directions.T, 0.0, atol=1e-9)
    assert "+1 Ixx[0]" in str(caught.value)
    assert "hy[1]" in str(caught.value) and "hx[0]" in str(caught.value)
    least = least_squares(A, b, minimum_norm=True)
    np.testing.assert_allclose(least.x, np.linalg.lstsq(A, b)[0], atol=1e-9)
    assert least.rank == 18


def test_a_regularizer_without_a_solution_is_told_beside_the_others(monkeypatch):
    A, b = data_of_two(2)
    solve, options = Riemannian.solve, {"gamma": 1.0, "certify": False}

    def failing(self, problem, *rest):
        if problem.residual_bound is not None:
            raise IdentificationError("It jumps from one minimum to another.", advice="Lower it.")
        return solve(self, problem, *rest)

    expected = compare_regularizers(A, b, TWO, **options)
    monkeypatch.setattr(Riemannian, "solve", failing)
    found = compare_regularizers(A, b, TWO, **options)
    assert dict(found.failures) == {"riemannian": "It jumps from one minimum to another. Lower it."}
    assert list(found.results) == ["euclidean", "pullback", "entropic"] and not expected.failures
    for name, result in found.results.items():
        np.testing.assert_allclose(result.phi, expected.results[name].phi, rtol=1e-9)
    other = compare_regularizers(A, b, TWO, reference="riemannian", **options)
    assert not other.failures and list(other.results) == list(expected.results)


def test_a_prior_that_fits_better_than_the_reference_leaves_nothing_to_compare():
    A, b = data_of_two(9, rows=40, extra=1)
    kinds = {"regularizers": ("pullback", "entropic"), "gamma": 1e7, "certify": False}
    own = {"entropic": [0.1], "pullback": [2.0]}  # the true one is 2
    found = compare_regularizers(A, b, TWO, extra_priors=own, **kinds)
    assert list(found.results) == ["entropic"]
    assert "already fit better" in found.failures["pullback"]


def test_a_mistake_of_arguments_is_no_failure_of_a_regularizer():
    A, b = data_of_two(2, extra=1)
    kinds = ["entropic", PointMassKL(PointMasses.of_bodies(TWO, 30))]
    own = {"point_mass_kl": [1.0]}
    with pytest.raises(ArgumentError, match="has no divergence for extra parameters"):
        compare_regularizers(A, b, TWO, gamma=1.0, regularizers=kinds, extra_priors=own)


FORMS = {
    "euclidean": lambda x, x0: (x - x0) ** 2,
    "pullback": lambda x, x0: 0.5 * (x / x0 - 1.0) ** 2,
    "entropic": lambda x, x0: x / x0 - np.log(x / x0) - 1.0,
    "riemannian": lambda x, x0: 0.5 * np.log(x / x0) ** 2,
}


def data_with_scalars(seed, rows=60, extra=3):
    """Return (A, b) of three bodies and scalars of very different sizes, and the scalars."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, THREE.size + extra))
    A[:, THREE.size :] *= [30.0, 1.0, 0.05][:extra]
    scalars = np.array([0.02, 1.0, 40.0])[:extra]
    truth = np.append((THREE * rng.uniform(0.7, 1.4, (3, 1))).ravel(), scalars)
    return A, A @ truth + 0.3 * rng.normal(size=rows), scalars


def alone(x0, slope, wanted):
    """(A, b) that leave the bodies at their prior, and ask for slope · x = wanted of one scalar."""
    A = np.zeros((31, 31))
    A[:30, :30] = np.eye(30)
    A[30, 30] = slope
    return A, np.append(THREE.ravel(), wanted)


@pytest.mark.parametrize("solver", [None, "newton", "clarabel", "scs"])
@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_one_scalar_is_at_the_minimum_in_closed_form(regularizer, solver):
    x0, slope, wanted, gamma = 0.3, 2.0, 1.4, 0.7
    A, b = alone(x0, slope, wanted)
    found = identify(A, b, THREE, regularizer=regularizer, gamma=gamma, extra_prior=[x0],
                     solver=solver)  # fmt: skip
    by_formula = {
        "euclidean": (slope * wanted + gamma * x0) / (slope**2 + gamma),
        "pullback": (slope * wanted + 0.5 * gamma / x0) / (slope**2 + 0.5 * gamma / x0**2),
        "entropic": max(np.roots([2 * slope**2, gamma / x0 - 2 * slope * wanted, -gamma]).real),
        "riemannian": minimize_scalar(
            lambda x: (slope * x - wanted) ** 2 + gamma * FORMS["riemannian"](x, x0),
            bounds=(1e-3, 3.0), method="bounded", options={"xatol": 1e-12},
        ).x,
    }  # fmt: skip
    tolerance = 1e-6 if solver != "scs" else 1e-4
    assert found.extra[0] == pytest.approx(by_formula[regularizer], rel=tolerance)
    assert found.divergence == pytest.approx(
        FORMS[regularizer](found.extra[0], x0), rel=1e-3, abs=1e-9
    )
    np.testing.assert_allclose(found.phi, THREE, atol=3e-5)


def test_scalars_without_data_stay_at_their_priors_and_others_are_free():
    A, b, scalars = data_with_scalars(5)
    A[:, 30] = 0.0
    prior = [0.7, np.nan, 60.0]
    for regularizer in REGULARIZERS:
        found = identify(A, b, THREE, regularizer=regularizer, gamma=1e-6, extra_prior=prior)
        assert found.extra[0] == pytest.approx(0.7, rel=1e-6)
        assert found.extra[1] == pytest.approx(scalars[1], rel=0.3)
    strong = identify(A, b, THREE, regularizer="entropic", gamma=1e7, extra_prior=prior)
    np.testing.assert_allclose(strong.extra[[0, 2]], [0.7, 60.0], rtol=1e-3)


def example(seed, *, gamma=5.0, noise=1.0, rows=40, friction=2.0):
    """Return a fit of bodies and scalars; smaller γ or larger noise drives it to the boundary."""
    rng = np.random.default_rng(seed)
    truth = np.append((TWO * rng.uniform(0.8, 1.2, TWO.shape)).ravel(), np.full(3, friction))
    A = rng.normal(size=(rows, 23)) * 10.0
    b = A @ truth + noise * rng.normal(size=rows)
    return FitProblem(
        factor=whitened_factor(A, b, sigma=noise),
        inertia_blocks=(0, 10),
        prior_mean=np.append(TWO.ravel(), np.zeros(3)),
        prior_information=block_diag(*(gamma * pullback_metric(TWO)), np.zeros((3, 3))),
        lower=np.append(np.full(20, -np.inf), np.zeros(3)),
    )


def entropic(problem, gamma):
    priors = {s: (problem.prior_mean[s : s + 10], gamma) for s in problem.inertia_blocks}
    return replace(
        problem, entropic=priors, prior_information=np.zeros_like(problem.prior_information)
    )


def in_deviations(result, other):
    return np.abs(result.x - other.x).max(initial=0.0) / result.standard_deviations().min()


WELL_INSIDE = {"gamma": 2000.0, "noise": 5.0}


@pytest.mark.parametrize("friction", [20.0, -1.0])
def test_shortcuts_agree_with_the_conic_program(friction):
    problem = example(2, friction=friction, **WELL_INSIDE)
    quick, conic = solve_fit(problem), solve_fit(problem, shortcuts=False)
    name = "closed form" if friction > 0 else "bounded least squares"
    assert (quick.solver, conic.solver) == (name, "clarabel")
    assert in_deviations(quick, conic) < 1e-6
    assert quick.active_bounds == conic.active_bounds
    assert (len(quick.active_bounds) > 0) == (friction < 0)
    assert quick.residual == pytest.approx(conic.residual, rel=1e-8)
    if not quick.active_bounds:
        R = problem.factor[:, :-1]
        normal = R.T @ R + problem.prior_information
        np.testing.assert_allclose(quick.information, normal, rtol=1e-10, atol=1e-8)
        deviations = np.sqrt(np.diag(np.linalg.inv(normal)))
        np.testing.assert_allclose(quick.standard_deviations(), deviations, rtol=1e-6)


def test_no_data_gives_the_prior_back():
    problem = example(5)
    empty = replace(problem, factor=np.zeros((1, problem.size + 1)))
    for problem in (empty, entropic(empty, 1.0)):
        result = solve_fit(problem)
        np.testing.assert_allclose(result.x[:20], problem.prior_mean[:20], rtol=1e-4, atol=1e-5)
        assert np.isinf(result.standard_deviations()[20:]).all()


def test_reference_stands_in_for_a_prior_without_mass():
    problem = example(6, rows=60)
    payload = np.append(np.zeros(10), problem.prior_mean[10:])
    with pytest.raises(ArgumentError, match=r"columns \[0\] have no physical reference"):
        replace(problem, prior_mean=payload, reference={})
    size = from_mass_com_inertia(1.0, np.zeros(3), 0.01 * np.eye(3))
    result = solve_fit(replace(problem, prior_mean=payload, reference={0: size, 10: TWO[1]}))
    assert is_physical(result.x[:10])
