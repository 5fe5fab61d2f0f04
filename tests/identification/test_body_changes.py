"""What became of bodies, with what is known of them, and bodies that all become heavier."""

import numpy as np
import pytest
from identified_bodies import TWO

from geodrake.identification import FitProblem, solve_fit
from geodrake.identification.models.identify import body_changes, common_factor_notes
from geodrake.identification.models.results import BodyChange
from geodrake.inertia import pullback_metric


def fit_of(information):
    """A fit of two bodies with a prior information (20, 20) and no data."""
    problem = FitProblem(
        factor=np.zeros((1, 21)),
        inertia_blocks=(0, 10),
        prior_mean=TWO.ravel(),
        prior_information=information,
    )
    return solve_fit(problem)


def known(gammas):
    information = np.zeros((20, 20))
    for k, (gamma, metric) in enumerate(zip(gammas, pullback_metric(TWO), strict=True)):
        information[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = gamma * metric
    return information


def test_deviations_of_centres_of_mass_are_those_of_samples():
    fit = fit_of(known([1e4, 1e6]))
    changes = body_changes(("arm", "hand"), TWO, TWO, fit)
    samples = np.random.default_rng(0).multivariate_normal(fit.x, fit.covariance(), 4000)
    for k, change in enumerate(changes):
        mass, moment = samples[:, 10 * k], samples[:, 10 * k + 1 : 10 * k + 4]
        assert change.mass_deviation == pytest.approx(mass.std(), rel=0.05)
        spread = (moment / mass[:, None]).std(0)
        np.testing.assert_allclose(change.com_deviation, spread, rtol=0.05)
        assert change.distance == 0.0 and not change.at_boundary


def test_what_is_not_known_is_infinite_and_the_rest_is_not():
    information = known([1e4, 1e4])
    information[10:] = information[:, 10:] = 0.0
    information[12, 12] = 1e4  # of the hand, only the moment along y
    arm, hand = body_changes(("arm", "hand"), TWO, TWO, fit_of(information))
    assert np.isfinite(arm.mass_deviation) and np.isfinite(arm.com_deviation).all()
    assert np.isinf(hand.mass_deviation) and np.isinf(hand.com_deviation).all()


def test_what_rounding_leaves_of_a_deviation_is_unknown():
    """A mass and a moment that are known together alone, by information beyond all digits."""
    information = 1e-290 * known([1.0, 1.0])
    along = np.array([1.0, 0.3, -0.2, 0.1])
    information[:4, :4] += np.outer(along, along)
    for body in body_changes(("arm", "hand"), TWO, TWO, fit_of(information)):
        assert not np.isnan(body.com_deviation).any() and not np.isnan(body.mass_deviation)


def change(name, before, after):
    return BodyChange(name, (before, after), np.zeros((2, 3)), 0.1, np.zeros(3), False, 0.5)


@pytest.mark.parametrize("factor", [2.2, 1 / 2.2])
def test_the_factor_of_the_efforts_is_said(factor):
    bodies = [change("arm", 10.0, 10.0 * factor), change("hand", 3.3, 3.3 * factor)]
    (note,) = common_factor_notes(bodies)
    assert f"{13.3 * factor:.3g} kg instead of 13.3 kg" in note
    assert f"{1 / factor:.3g} times as large" in note
