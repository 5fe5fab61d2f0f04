"""The human study: its errors and its blocks."""

import numpy as np

from diagrams.studies.human_identification import Human, blocks


def test_errors_are_those_of_forces_and_points():
    """A body of 10 kg at (0.3, 0.1) m, seen as 12 kg at (0.2, 0.1) m."""
    rows = np.zeros((3, 10))
    rows[0, 2] = rows[1, 1] = rows[2, 0] = 9.81
    seen = np.array([12.0, 2.4, 1.2, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    human = Human(rows, rows @ seen, np.ones(3), *(np.zeros((1, 4, 4)),) * 3)
    phi = np.array([[10.0, 3.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(human.errors(phi), [[-2 * 9.81, 10.0, 0.0]], atol=1e-12)


def test_blocks_hold_every_step_once_and_training_keeps_away():
    found = list(blocks(33, 3, 2))
    np.testing.assert_array_equal(np.concatenate([test for _, test in found]), np.arange(33))
    for training, test in found:
        apart = np.abs(training[:, None] - test).min()
        assert apart == 3
        assert len(training) + len(test) in (29, 31)
