"""The study of mistakes in columns: its logs have them."""

import numpy as np
import pytest

from diagrams.benchmarks.column_errors import MISTAKES, WrongLog, make_log


def draw(mistake):
    return WrongLog(mistake, "double_pendulum", "pinocchio", "fast", 0, 5, 3.0)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_logs_have_their_mistake_and_nothing_else(mistake):
    model, log, secrets = make_log(draw(mistake))
    assert secrets
    assert log.joints == model.joints
    _, again, _ = make_log(draw(mistake))
    np.testing.assert_array_equal(log.effort, again.effort)
    v = np.gradient(log.position, log.time, axis=0)[5:-5]
    ratio = np.sum(v * log.velocity[5:-5], axis=0) / np.sum(v**2, axis=0)
    told = mistake in ("wrong time", "wrong velocities")
    assert (np.abs(ratio - 1.0) < 0.02).all() != told
