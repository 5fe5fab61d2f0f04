"""A first look at many assignments: errors with the model's own bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.design import joint_motion
from geodrake.diagnosis.columns.evidence import ColumnModel

Array = NDArray[np.float64]

_ROWS = 300  # samples that are looked at, evenly over the logs
_AGREEMENT = 0.1  # of an effort's deviation: bodies of a model file are no nearer than that


class FirstLook:
    """Errors of all joints with the model's bodies, beside what is linear in each joint alone."""

    def __init__(self, model: ColumnModel) -> None:
        self._model, samples = model, model.samples
        step = max(1, len(samples) // _ROWS)
        self._rows = np.arange(0, len(samples), step)
        self._moments: dict[tuple[object, ...], tuple[Array, Array, Array]] = {}

    def score(self, assignment: Assignment, worth: Array) -> float:
        """Return twice the log-likelihood of an assignment.

        Args:
            assignment: The assignment.
            worth: (n,) independent samples of each column of efforts.
        """
        needed, products, powers = self._moments_of(assignment)
        at, gain = np.arange(len(assignment.effort)), assignment.gain
        power, product = powers[at, assignment.effort], products[at, assignment.effort]
        errors = power - 2.0 * product / gain + needed / gain**2
        errors = np.maximum(errors, 0.0) + _AGREEMENT**2 * power + 1e-300
        score = -float(worth[assignment.effort] @ np.log(errors))
        return score + self._model.rate_score(assignment)

    def _moments_of(self, assignment: Assignment) -> tuple[Array, Array, Array]:
        """Mean squares (n,) of needed efforts, and products and mean squares (n, n) of columns."""
        key = (*assignment.motion_key, *sorted(assignment.signs))
        if key not in self._moments:
            self._moments[key] = self._moments_at(assignment)
        return self._moments[key]

    def _moments_at(self, assignment: Assignment) -> tuple[Array, Array, Array]:
        samples, rows = self._model.samples, self._rows
        q, v, vd = (part[rows] for part in joint_motion(samples, assignment))
        load = self._model.needed_by_model(assignment, rows)
        n, efforts = q.shape[1], samples.effort[rows]
        for source, signs in assignment.signs.items():
            efforts[:, source] *= signs[rows]
        needed, products, powers = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
        for j in range(n):
            used = samples.used[rows, assignment.position[j]]
            beside = [np.ones(used.sum()), v[used, j], np.sign(v[used, j]), vd[used, j]]
            Q, _ = np.linalg.qr(np.column_stack(beside))
            both = np.column_stack([load[used, j], efforts[used]])
            both -= Q @ (Q.T @ both)
            needed[j] = np.mean(both[:, 0] ** 2)
            products[j], powers[j] = (
                both[:, 0] @ both[:, 1:] / len(both),
                np.mean(both[:, 1:] ** 2, 0),
            )
        return needed, products, powers
