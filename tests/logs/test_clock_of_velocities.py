"""What a second of a log takes, by velocities that it has beside its positions."""

import numpy as np
import pytest

from geodrake import load_model
from geodrake.diagnosis import check_columns
from geodrake.logs.motion import JointLog
from geodrake.logs.uniform_log import make_uniform

TIME = np.arange(0.0, 8.0, 0.01)
RATES = np.array([1.0, 1.7, 2.9])


def second(factors, *, clock=1.0):
    """By velocities that are off by factors, of a log whose time is off."""
    q, v = np.sin(RATES * TIME[:, None]), RATES * np.cos(RATES * TIME[:, None])
    log = JointLog("log", ("a", "b", "c"), TIME / clock, q, q, velocity=v * factors)
    return make_uniform(log).time_scale


@pytest.mark.parametrize("clock", [0.1, 1.0, 20.0])
def test_velocities_tell_the_clock(clock):
    assert second([1.0, 1.0, 1.0], clock=clock) == pytest.approx(clock, rel=1e-2)
    assert second([1.0, -30.0, 1.0], clock=clock) == pytest.approx(clock, rel=1e-2)


@pytest.mark.parametrize("factors", [0.0, -1.0, 1e-3, 1e4, [1.0, -1.0, 0.0], [1.0, 20.0, 90.0]])
def test_what_no_clock_does_tells_none(factors):
    assert np.isnan(second(factors))


def test_velocities_that_are_far_too_small_cost_nothing(tmp_path):
    file = tmp_path / "arm.urdf"
    link = (
        '<inertial><mass value="1"/><origin xyz="0.1 0 0"/><inertia ixx="0.01" iyy="0.01" '
        'izz="0.01" ixy="0" iyz="0" ixz="0"/></inertial>'
    )
    file.write_text(
        f'<robot name="arm"><link name="base"/><link name="arm">{link}</link><joint name="a" '
        'type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>'
        "</robot>"
    )
    q, v = np.sin(2.0 * TIME)[:, None], np.cos(2.0 * TIME)[:, None]
    log = JointLog("log", ("a",), TIME, q, 5.0 * q, velocity=2e-3 * v)
    assert all(found.kind for found in check_columns(load_model(file), [log]))
