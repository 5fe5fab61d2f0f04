"""Quick score of many assignments, from the errors of the model's own bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnModel

Array = NDArray[np.float64]

_ROWS = 300  # samples, evenly over the logs
_AGREEMENT = 0.1  # relative error of efforts by the bodies of a model file, at least


class QuickScores:
    """Quick scores of assignments by the model's own bodies."""

    def __init__(self, model: ColumnModel) -> None:
        self._model, samples = model, model.samples
        self._rows = np.arange(0, len(samples), max(1, len(samples) // _ROWS))
        self._moments: dict[tuple[object, ...], tuple[Array, Array, Array]] = {}

    def score(self, assignment: Assignment) -> float:
        """Return twice the log-likelihood of an assignment."""
        needed, product, power = self.moments(assignment)
        errors = np.maximum(power - 2.0 * product + needed, 0.0) + _AGREEMENT**2 * power
        errors = (errors + 1e-300) / assignment.gain**2
        score = -float(self._model.full_counts()[assignment.effort] @ np.log(errors))
        return score + self._model.score_of_motion(assignment)

    def moments(self, assignment: Assignment) -> tuple[Array, Array, Array]:
        """Return (n,) moments of efforts: mean predicted², predicted·logged, logged².

        An offset, friction and rotor of each joint are projected out.
        """
        key = (*assignment.motion_key, *sorted(assignment.signs))
        if key not in self._moments:
            self._moments[key] = self._moments_at(assignment)
        needed, products, powers = self._moments[key]
        at, gain = (np.arange(len(needed)), assignment.effort), assignment.gain
        return needed[at], gain * products[at], gain**2 * powers[at]

    def _moments_at(self, assignment: Assignment) -> tuple[Array, Array, Array]:
        """Return the moments (n, n) of joints and effort columns, on the samples of the column."""
        samples, rows = self._model.samples, self._rows
        _, v, vd = samples.motion(assignment, rows)
        load, efforts = self._model.needed_by_model(assignment, rows), samples.effort[rows]
        for source, signs in assignment.signs.items():
            efforts[:, source] *= signs[rows]
        n = len(assignment.effort)
        moments = np.zeros((3, n, n))
        for source in range(n):
            used = samples.used[rows, source]
            v_u, effort = v[used], np.broadcast_to(efforts[used, source, None], (used.sum(), n))
            base = np.stack([np.ones_like(v_u), v_u, np.sign(v_u), vd[used]], -1).swapaxes(0, 1)
            signals = np.stack([load[used], effort], -1).swapaxes(0, 1)
            Q, _ = np.linalg.qr(base)  # (n, K, 4)
            signals = signals - Q @ (Q.swapaxes(1, 2) @ signals)
            products = signals.swapaxes(1, 2) @ signals / max(len(v_u), 1)
            moments[:, :, source] = products[:, 0, 0], products[:, 0, 1], products[:, 1, 1]
        return moments[0], moments[1], moments[2]
