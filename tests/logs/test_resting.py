"""Which joints rest: what an encoder and its noise do at rest is no motion."""

import numpy as np
import pytest

from geodrake.logs.resting import logged_ranges, resting

TIME = np.arange(0.0, 20.0, 0.01)
SWING = np.sin(TIME)


def rests(*positions, sliding=None, more=()):
    """Whether each of some joints rests in one log, or in it and further ones."""
    logs = [np.column_stack(positions), *(np.column_stack(each) for each in more)]
    low, high, noise = logged_ranges(logs)
    return resting(low, high, np.zeros(len(low)) if sliding is None else sliding, noise).tolist()


@pytest.mark.parametrize("step", [1e-5, 1.5e-3])
def test_an_encoder_that_flickers_rests(step):
    flicker = step * np.random.default_rng(0).integers(-1, 2, len(TIME))
    assert rests(np.round(SWING / step) * step, 0.7 + flicker) == [False, True]


@pytest.mark.parametrize("noise", [1e-4, 5e-3])
def test_noise_of_a_potentiometer_is_no_motion(noise):
    rng = np.random.default_rng(1)
    measured = noise * rng.normal(size=(3, len(TIME)))
    assert rests(SWING + measured[0], measured[1], 0.2 * SWING + measured[2]) == [
        False,
        True,
        False,
    ]


def test_a_joint_that_gives_way_rests_and_one_that_is_moved_a_little_does_not():
    """A held joint yields by mrad to the others' loads; a small motion is still one."""
    assert rests(SWING, 2e-3 * SWING, 0.02 * SWING) == [False, True, False]
    assert rests(0.03 * SWING, 2e-3 * SWING) == [False, False]  # that is a fifteenth of the other


def test_a_fast_motion_sampled_rarely_is_no_noise():
    assert rests(SWING, 0.1 * np.sin(2 * np.pi * 8.0 * TIME)) == [False, False]  # 8 of 100 Hz


def test_a_wheel_and_a_slide_make_no_joint_rest():
    wheel, slide = 3.0 * TIME, 0.02 * SWING
    assert rests(wheel, 0.1 * SWING, slide, sliding=[False, False, True]) == [False] * 3


def test_all_logs_count_together():
    elsewhere = [(SWING, np.full_like(SWING, 0.4))]
    still = np.full_like(SWING, 0.1)
    assert rests(SWING, still) == [False, True]
    assert rests(SWING, still, more=elsewhere) == [False, False]


def test_what_was_not_measured_does_not_rest():
    assert rests(SWING, np.full_like(SWING, np.nan)) == [False, False]


def test_readings_that_no_robot_has_are_no_motion():
    """They are told of where the log is read; here their differences must not overflow."""
    wild = SWING.copy()
    wild[[100, 101]] = 1e308, -1e308
    still = np.full_like(SWING, 0.4)
    still[7] = -1e308
    assert rests(wild, still) == [False, True]
