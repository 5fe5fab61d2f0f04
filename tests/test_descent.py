"""Steps are as long as the cost allows, and searches end where rounding hides further progress."""

import numpy as np
import pytest

from geodrake.descent import PRECISION, is_within_rounding, rounding_of_squares, step_length


@pytest.mark.parametrize("curvature", [0.5, 1.0, 5.0, 1e4])
def test_the_longest_step_that_lowers_the_cost_is_taken(curvature):
    share = float(step_length(lambda t: t - 0.5 * curvature * t**2, 1.0, 0.0))
    assert share == 1.0 or 2.0 * share >= 2.0 * (1.0 - 1e-4) / curvature
    assert 0.0 < share < 2.0 / curvature


def test_steps_of_many_costs_are_found_together():
    curvature = np.array([1.0, 5.0, 1e4])
    shares = step_length(lambda t: t - 0.5 * curvature * t**2, np.ones(3), 0.0, longest=0.8)
    alone = [
        step_length(lambda t, k=k: t - 0.5 * k * t**2, 1.0, 0.0, longest=0.8) for k in curvature
    ]
    np.testing.assert_array_equal(shares, alone)


def test_no_step_lowers_a_cost_that_rises():
    assert step_length(lambda t: -t, 1.0, 1e-16) == 0.0
    assert step_length(lambda t: -np.inf, 1.0, 1.0) == 0.0


def test_a_step_whose_gain_is_lost_in_rounding_is_taken_whole():
    assert step_length(lambda t: -1e-13, 1e-20, 2e-13) == 1.0


def test_a_search_goes_on_while_its_promise_shrinks():
    assert not is_within_rounding(1e-20, 1e-16, 1e-13)  # Newton's method still converges
    assert not is_within_rounding(1e-10, 1e-10, 1e-13)  # it is stuck, but not by rounding
    assert is_within_rounding(1e-20, 1e-20, 1e-13)
    assert not is_within_rounding(1e-20, np.inf, 1e-13)  # nothing is known of a first step


@pytest.mark.parametrize("size", [1e-9, 1e-5, 1.0, 10.0])
def test_small_residuals_are_known_no_better_than_others(size):
    rng = np.random.default_rng(0)
    w, r = rng.uniform(0.0, 1e5, 30), size * rng.normal(size=30)
    exact, moved = (0.5 * w @ np.square(each) for each in (r, r + PRECISION * rng.normal(size=30)))
    assert abs(moved - exact) < rounding_of_squares(exact, w.sum())
    assert rounding_of_squares(exact, w.sum()) < 1e3 * PRECISION * max(exact, w.sum() * size)
