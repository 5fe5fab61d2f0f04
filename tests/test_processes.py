"""Limits of time in tests of commands count what the processor works."""

import time

import pytest
from processes import HangError, time_limit


def test_limits_of_time_count_the_processor():
    with pytest.raises(HangError, match="spin has not ended: SIGPROF"), time_limit("spin", 0.1):
        while True:
            pass
    with time_limit("a wait", 0.1):
        time.sleep(0.3)
