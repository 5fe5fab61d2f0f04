"""Play of a pendulum's link, which strikes the stiff, damped sides of its gap, by scipy."""

import numpy as np
import pytest
from elbow_logs import MODEL, loose_log, motor, played

from geodrake.diagnosis import explain
from geodrake.effects import Backlash
from geodrake.logs.motion import Motion


def smooth(values, width=400):
    """Means over a fifth of a second."""
    return np.convolve(values, np.hanning(width) / np.hanning(width).sum(), "valid")


def test_effort(half_width=2e-3):
    """The blows and pauses that scipy finds are those of the column, seen through a filter."""
    time, _, torque = played(half_width)
    q, v, vd = motor(time)
    zero = np.zeros_like(q)
    motion = Motion(*(np.stack([zero, x], 1) for x in (q, v, vd)), time)
    missing = torque - MODEL.effort(motion)[:, 1]
    column = Backlash("elbow", half_width).regressor(MODEL.motion(motion))[:, 1, 0]
    seen, explained = smooth(missing), smooth(column)
    share = explained @ seen / (explained @ explained)
    assert share == pytest.approx(1.0, abs=0.12)
    assert np.square(seen - share * explained).sum() < 0.15 * np.square(seen).sum()


def test_lag_falls_freely():
    """Under a load that changes its sign steadily: 2 h = r t³ / 6 after it did."""
    time = np.arange(-0.5, 0.5, 1e-3)
    lag = Backlash("elbow", 1e-3).lag(30.0 * time, time)
    apart = (time > 0.0) & (lag < 1e-3)
    np.testing.assert_allclose(lag[time < 0.0], -1e-3)
    np.testing.assert_allclose(lag[apart], 30.0 * time[apart] ** 3 / 6 - 1e-3, atol=2e-5)
    assert time[apart][-1] == pytest.approx((12.0 * 1e-3 / 30.0) ** (1 / 3), abs=2e-3)


@pytest.mark.thorough
def test_found():
    """Low-passed as suits the motion, the blows are gone, or look like ripple."""
    found = explain(MODEL, [loose_log(8e-3, noise=0.01)])
    (step,) = found.steps
    assert (step.effect, step.where) == ("backlash", ("elbow",))
    values = step.parameters["elbow"]
    assert values["gap_share"] * values["half_width"] == pytest.approx(8e-3, rel=0.15)
