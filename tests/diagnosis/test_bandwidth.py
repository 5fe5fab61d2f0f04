"""What the bandwidth of a motion shows, and what it leaves out."""

import numpy as np
from elbow_logs import MODEL
from pendulum_logs import pendulum_log

from geodrake.diagnosis import explain


def test_what_is_above_half_the_bandwidth_is_not_filtered_away():
    """A torque that no effect explains is unexplained, though at half the bandwidth it is gone."""

    def oscillation(q, v, vd, load):
        wave = 0.6 * np.sin(2 * np.pi * 3.5 / 200.0 * np.arange(len(q)))
        return np.stack([wave, 0.5 * wave], 1)

    log = pendulum_log(3, oscillation, seconds=20.0)
    assert explain(MODEL, [log]).verdict == "unexplained"
    assert explain(MODEL, [log], bandwidth=2.5).verdict == "adequate"
