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
        return needed[at], gain * products[at], gain**2 * powers[at]

    def _moments_at(self, assignment: Assignment) -> tuple[Array, Array, Array]:
        """Return mean squares, products and mean squares of columns of efforts, each (n, n).

        They are of each joint with each column, in the samples of that (see `MotionDesigns`).
        """
        samples, rows = self._model.samples, self._rows
        _, v, vd = samples.motion(assignment, rows)
        load, efforts = self._model.needed_by_model(assignment, rows), samples.effort[rows]
        for source, signs in assignment.signs.items():
            efforts[:, source] *= signs[rows]
        n = len(assignment.effort)
        found = np.zeros((3, n, n))
        for source in range(n):
            used = samples.used[rows, source]
            v_u, effort = v[used], np.broadcast_to(efforts[used, source, None], (used.sum(), n))
            beside = np.stack([np.ones_like(v_u), v_u, np.sign(v_u), vd[used]], -1).swapaxes(0, 1)
            both = np.stack([load[used], effort], -1).swapaxes(0, 1)
            Q, _ = np.linalg.qr(beside)  # (n, K, 4)
            both = both - Q @ (Q.swapaxes(1, 2) @ both)
            products = both.swapaxes(1, 2) @ both / max(len(v_u), 1)
            found[:, :, source] = products[:, 0, 0], products[:, 0, 1], products[:, 1, 1]
        return found[0], found[1], found[2]
