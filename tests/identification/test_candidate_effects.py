"""What a diagnosis tries: delays that the data can resolve."""

import numpy as np
import pytest

from geodrake.identification.logs.candidate_effects import LONGEST_DELAY, candidate_delays


@pytest.mark.parametrize(("period", "bandwidth"), [(0.002, 10.0), (0.01, 2.0), (0.04, 12.0)])
def test_delays_are_those_that_can_be_told_apart(period, bandwidth):
    delays = candidate_delays(period, bandwidth)
    assert delays[0] == 0.0
    assert len(set(delays)) == len(delays)
    assert max(np.abs(delays)) <= LONGEST_DELAY + 1e-12
    assert np.diff(sorted(delays)).min() >= period - 1e-12
