"""A first look at many assignments: errors with the model's own bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnModel

Array = NDArray[np.float64]

_ROWS = 300  # samples that are looked at, evenly over the logs
_AGREEMENT = 0.1  # of an effort's deviation: bodies of a model file are no nearer than that


class FirstLook:
    """Errors of all joints with the model's bodies, beside what is linear in each joint alone."""

    def __init__(self, model: ColumnModel) -> None:
        self._model, samples = model, model.samples
        self._rows = np.arange(0, len(samples), max(1, len(samples) // _ROWS))
        self._moments: dict[tuple[object, ...], tuple[Array, Array, Array]] = {}

    def score(self, assignment: Assignment) -> float:
        """Return twice the log-likelihood of an assignment."""
        needed, product, power = self.moments(assignment)
        errors = np.maximum(power - 2.0 * product + needed, 0.0) + _AGREEMENT**2 * power
        errors = (errors + 1e-300) / assignment.gain**2
        score = -float(self._model.hopeful()[assignment.effort] @ np.log(errors))
        return score + self._model.score_of_motion(assignment)

    def moments(self, assignment: Assignment) -> tuple[Array, Array, Array]:
        """Return mean squares (n,) of needed efforts, products with those of the log, and theirs.

        All are without what is linear in an offset, friction and rotor of the joint.
        """
        key = (*assignment.motion_key, *sorted(assignment.signs))
        if key not in self._moments:
            self._moments[key] = self._moments_at(assignment)
        needed, products, powers = self._moments[key]
        at, gain = (np.arange(len(needed)), assignment.effort), assignment.gain
        return needed, gain * products[at], gain**2 * powers[at]

    def _moments_at(self, assignment: Assignment) -> tuple[Array, Array, Array]:
        """Return mean squares (n,), and products and mean squares (n, n) of columns of efforts."""
        samples, rows = self._model.samples, self._rows
        _, v, vd = samples.motion(assignment, rows)
        load, efforts = self._model.needed_by_model(assignment, rows), samples.effort[rows]
        for source, signs in assignment.signs.items():
            efforts[:, source] *= signs[rows]
        found = []
        for j, position in enumerate(assignment.position.tolist()):
            used = samples.used[rows, position]
            v_j = v[used, j]
            beside = np.column_stack([np.ones(len(v_j)), v_j, np.sign(v_j), vd[used, j]])
            Q, _ = np.linalg.qr(beside)
            both = np.column_stack([load[used, j], efforts[used]])
            both -= Q @ (Q.T @ both)
            own = both[:, 0]
            found.append((own @ own, own @ both[:, 1:], np.square(both[:, 1:]).sum(axis=0)))
        needed, products, powers = (np.array(part) for part in zip(*found, strict=True))
        counts = np.maximum(samples.used[rows][:, assignment.position].sum(axis=0), 1)
        return needed / counts, products / counts[:, None], powers / counts[:, None]
