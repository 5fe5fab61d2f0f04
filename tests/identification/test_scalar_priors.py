"""Priors of positive scalars, elements of P(1): closed forms and other solvers."""

import numpy as np
import pytest
from identified_bodies import THREE as PRIOR
from scipy.optimize import minimize_scalar

from geodrake.identification import REGULARIZERS, identify

FORMS = {
    "euclidean": lambda x, x0: (x - x0) ** 2,
    "pullback": lambda x, x0: 0.5 * (x / x0 - 1.0) ** 2,
    "entropic": lambda x, x0: x / x0 - np.log(x / x0) - 1.0,
    "riemannian": lambda x, x0: 0.5 * np.log(x / x0) ** 2,
}


def data(seed, rows=60, extra=3):
    """(A, b) of three bodies and scalars of very different sizes, and the scalars."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, PRIOR.size + extra))
    A[:, PRIOR.size :] *= [30.0, 1.0, 0.05][:extra]
    scalars = np.array([0.02, 1.0, 40.0])[:extra]
    truth = np.append((PRIOR * rng.uniform(0.7, 1.4, (3, 1))).ravel(), scalars)
    return A, A @ truth + 0.3 * rng.normal(size=rows), scalars


def alone(x0, slope, wanted):
    """(A, b) that leave the bodies at their prior, and ask for slope · x = wanted of one scalar."""
    A = np.zeros((31, 31))
    A[:30, :30] = np.eye(30)
    A[30, 30] = slope
    return A, np.append(PRIOR.ravel(), wanted)


@pytest.mark.parametrize("solver", [None, "newton", "clarabel", "scs"])
@pytest.mark.parametrize("regularizer", REGULARIZERS)
def test_one_scalar_is_at_the_minimum_in_closed_form(regularizer, solver):
    x0, slope, wanted, gamma = 0.3, 2.0, 1.4, 0.7
    A, b = alone(x0, slope, wanted)
    found = identify(A, b, PRIOR, regularizer=regularizer, gamma=gamma, extra_prior=[x0],
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
    np.testing.assert_allclose(found.phi, PRIOR, atol=3e-5)


def test_scalars_without_data_stay_at_their_priors_and_others_are_free():
    A, b, scalars = data(5)
    A[:, 30] = 0.0
    prior = [0.7, np.nan, 60.0]
    for regularizer in REGULARIZERS:
        found = identify(A, b, PRIOR, regularizer=regularizer, gamma=1e-6, extra_prior=prior)
        assert found.extra[0] == pytest.approx(0.7, rel=1e-6)
        assert found.extra[1] == pytest.approx(scalars[1], rel=0.3)
    strong = identify(A, b, PRIOR, regularizer="entropic", gamma=1e7, extra_prior=prior)
    np.testing.assert_allclose(strong.extra[[0, 2]], [0.7, 60.0], rtol=1e-3)
