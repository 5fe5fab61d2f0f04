"""Contact of a body that explains the residual in a window of a log, and its evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from geodrake.compiling import compiled, contiguous
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.episode import PointEpisode
from geodrake.identification.logs.evidence import effective_samples
from geodrake.logs.filtering import ZeroPhaseFilter

Array = NDArray[np.float64]

PIECES = 4
"""Number of pieces of a window; alternate pieces predict the others."""

SHORTEST = 0.2
"""Shortest contact, s."""

FEW, ENOUGH = 120, 240
"""Iterations of the search for a contact's times and point: first, and for the final body."""

_NEGLIGIBLE = 1e-4  # norm of a column, over the largest
_SINGULAR = 0.05  # relative singular value at a residual of the noise's size
_LEAST_SINGULAR, _LARGEST_SINGULAR = 2e-3, 0.02
_FARTHEST = 2.0  # m, largest coordinate of the point in the body frame
_SHARPEST = 1e-3  # s
_STEPS = np.array([0.05, 0.05, 0.5, 0.1, 0.1, 0.1])  # initial: s, s, logarithm, m, m, m
_STEPS_IN_TIME = 3  # number of the steps in time, which come first


@dataclass(frozen=True, eq=False)
class ResidualWindow:
    """Window of a log, with the residual and the motion around it."""

    start: float  # initial guess of its start, s since the log began
    end: float  # initial guess of its end
    time: Array  # (N,) instants at the full rate, s since the log began
    bodies: RobotBodies  # the bodies at these instants
    outputs: Array  # (K,) instants of the filtered samples
    residual: Array  # (K, nv) their residuals over `size`; NaN without a row
    size: Array  # (nv,) typical residual of each joint, including model errors of a contact
    filter: ZeroPhaseFilter


def columns(window: ResidualWindow, contact: PointEpisode) -> Array:
    """Return (K, nv, 6) filtered columns of a contact, over the typical residual of each joint."""
    values = contact.columns(window.bodies.motion(contact.body), window.time)
    return np.asarray(window.filter.apply(values) / window.size[:, None])


@dataclass(frozen=True, eq=False)
class WrenchColumns:
    """Columns of a body's contact at the d joints that move it, for a search over contacts."""

    # (N, 5, 3 d) efforts of a constant wrench, over `size`: forces at Bo, their arms along x, y and
    # z, and moments, in body axes if the contact turns with the body.
    parts: Array
    time: Array  # (N,) instants at the full rate
    filter: ZeroPhaseFilter  # the log's filter
    rows: NDArray[np.bool_]  # (K, d) whether a residual is known

    @classmethod
    def of(cls, window: ResidualWindow, contact: PointEpisode) -> WrenchColumns:
        """Return the columns of a contact's body in a window."""
        motion, low_pass = window.bodies.motion(contact.body), window.filter
        dofs, R = list(motion.dofs), motion.rotation.transpose(0, 2, 1)
        angular, linear = (
            J[:, :, dofs].transpose(0, 2, 1) for J in (motion.angular, motion.linear)
        )
        arms = np.cross(angular[:, None], R[:, :, None])  # axis of the body, joint, force
        parts = np.concatenate([linear[:, None], arms, angular[:, None]], 1)
        if contact.turning:
            parts = parts @ motion.rotation[:, None]
        values = contiguous((parts / window.size[dofs, None]).reshape(len(parts), 5, -1))
        rows = np.isfinite(window.residual[:, dofs])
        return cls(values, window.time, low_pass, rows)

    def columns(self, shape: Array) -> Array:
        """Return the known rows of `columns` at the joints that move the body.

        Args:
            shape: (6,) start, end and rise, s, and the point, m.
        """
        after, before = (np.tanh((self.time - edge) / shape[2]) for edge in shape[:2])
        low_pass, out = self.filter, np.zeros((*self.rows.shape, 6))
        weights = 0.5 * (after - before)
        filters = contiguous(low_pass.kernel), low_pass.decimation
        add_wrench_columns(self.parts, weights, filters, contiguous(shape[3:]), out)
        return out[self.rows]


@compiled
def add_wrench_columns(
    parts: Array, weights: Array, filters: tuple[Array, int], point: Array, out: Array
) -> None:
    """Add the filtered columns (K, d, 6) of a force and a moment at a point (3,), m.

    Args:
        parts: (N, 5, 3 d) `WrenchColumns.parts`.
        weights: (N,) factor of the wrench over time.
        filters: (T,) weights of the filter, and its decimation.
    """
    kernel, step = filters
    sums = np.empty_like(parts[0])
    for k in range(len(out)):
        sums[:] = 0.0
        for t in range(len(kernel)):
            weight = weights[k * step + t] * kernel[t]
            if weight != 0.0:
                part = parts[k * step + t]
                for a in range(len(sums)):
                    for i in range(sums.shape[1]):
                        sums[a, i] += weight * part[a, i]
        for j in range(out.shape[1]):
            for i in range(3):
                force = sums[0, 3 * j + i]
                for axis in range(3):
                    force += point[axis] * sums[1 + axis, 3 * j + i]
                out[k, j, i] += force
                out[k, j, 3 + i] += sums[4, 3 * j + i]


def refined(window: ResidualWindow, contact: PointEpisode, *, tries: int = ENOUGH) -> PointEpisode:
    """Return the contact with the times and point that minimize the squared residual."""
    wrench = WrenchColumns.of(window, contact)
    dofs = list(window.bodies.motion(contact.body).dofs)
    b = window.residual[:, dofs][wrench.rows]
    cut = _cut(b)
    # A moment that turns with the force makes the point redundant.
    steps: Array = _STEPS[:_STEPS_IN_TIME] if contact.turning else _STEPS

    names = ("start", "end", "rise", "x", "y", "z")
    origin = np.array([getattr(contact, name) for name in names])

    def moved(step: Array) -> Array | None:
        shape = origin.copy()
        shape[: len(step)] += step
        shape[2] = origin[2] * np.exp(step[2])
        span = shape[1] - shape[0]
        if span < 0.5 * SHORTEST or not _SHARPEST <= shape[2] <= 0.25 * span:
            return None
        return shape if np.abs(shape[3:]).max() <= _FARTHEST else None

    def explained(step: Array) -> float:
        """Return the squares explained by a wrench, without directions of little effect."""
        shape = moved(step)
        if shape is None:
            return 0.0
        A = wrench.columns(shape)
        A /= _sizes(A)
        values, vectors = np.linalg.eigh(A.T @ A)
        clear = values > max(cut**2 * values[-1], np.finfo(float).tiny)
        return float(np.sum(np.square((A.T @ b) @ vectors[:, clear]) / values[clear]))

    best = minimize_step(lambda x: -explained(x), steps, tries, xatol=1e-3, fatol=1e-2)
    shape = moved(best)
    if shape is None:
        return contact
    return replace(contact, **dict(zip(names, shape.tolist(), strict=True)))


def minimize_step(loss: Callable[[Array], float], steps: Array, most: int, **tol: float) -> Array:
    """Return the step from zero to the minimum of a loss, by the Nelder–Mead simplex."""
    simplex = np.vstack([np.zeros(len(steps)), np.diag(steps)])
    options = {"initial_simplex": simplex, "maxiter": most, **tol}
    return np.asarray(minimize(loss, simplex[0], method="Nelder-Mead", options=options).x)


def with_point(window: ResidualWindow, contact: PointEpisode) -> PointEpisode:
    """Return a contact at the point on the line of its force that minimizes its moment.

    The point is first at Bo, and stays there if the wrench turns with the body.
    """
    if contact.turning:
        return contact
    motion, rows = window.bodies.motion(contact.body), np.isfinite(window.residual)
    wrench = _wrench(columns(window, contact)[rows], window.residual[rows])
    force, moment = wrench[:3], wrench[3:]
    middle = int(np.searchsorted(window.time, 0.5 * (contact.start + contact.end)))
    arm = np.cross(force, moment) / max(float(force @ force), np.finfo(float).tiny)
    x, y, z = (motion.rotation[min(middle, len(motion.rotation) - 1)].T @ arm).tolist()
    near = max(abs(x), abs(y), abs(z)) < 0.5 * _FARTHEST
    return replace(contact, x=x, y=y, z=z) if near else contact


def _wrench(A: Array, b: Array) -> Array:
    """Return the (6,) least-squares wrench, without directions of little effect on the joints."""
    sizes = _sizes(A)
    return np.asarray(np.linalg.lstsq(A / sizes, b, rcond=_cut(b))[0] / sizes)


def _sizes(A: Array) -> Array:
    """Return (6,) norms of columns, to scale forces and moments.

    Norms of negligible columns are raised, so that scaling does not amplify them.
    """
    norms = np.linalg.norm(A, axis=0)
    return np.maximum(norms, max(_NEGLIGIBLE * float(norms.max(initial=0.0)), np.finfo(float).tiny))


def _cut(b: Array) -> float:
    """Return the least relative singular value of a useful direction of the wrench.

    It is smaller the larger the residuals (K,) are relative to the noise.
    """
    clearness = float(np.sqrt(np.mean(np.square(b)))) if b.size else 0.0
    return float(np.clip(_SINGULAR / max(clearness, 1.0), _LEAST_SINGULAR, _LARGEST_SINGULAR))


@dataclass(frozen=True, eq=False)
class Predicted:
    """Prediction of each piece of a window by the wrench of the others."""

    before: Array  # (nv,) mean squared residual of each joint, 0 where unknown
    after: Array  # (nv,) the same after the prediction
    share: float  # predicted share of the squared residuals
    fitted: float  # share that a wrench of all pieces explains
    gain: float  # twice the log-likelihood ratio
    rank: int  # number of directions of the wrench that affect the joints


def evidence(window: ResidualWindow, contact: PointEpisode) -> Predicted:
    """Return the prediction of alternate pieces of a window by the wrench of the others."""
    A = columns(window, contact)
    inside = (window.outputs >= contact.start) & (window.outputs <= contact.end)
    since = (window.outputs - contact.start) / (contact.end - contact.start)
    piece = np.floor(PIECES * since).astype(int)
    finite, odd = np.isfinite(window.residual), piece % 2 == 1
    before, after = np.zeros((2, window.residual.shape[1]))
    rest = np.full_like(window.residual, np.nan)
    for test in (odd, ~odd):
        fit, judged = (finite & (inside & part)[:, None] for part in (~test, test))
        wrench = _wrench(A[fit], window.residual[fit])
        error = window.residual - A @ wrench
        rest = np.where(judged, error, rest)
        before += np.where(judged, np.square(window.residual), 0.0).sum(0)
        after += np.where(judged, np.square(error), 0.0).sum(0)
    remainders = [column[np.isfinite(column)] for column in rest.T]
    # Sample sizes are those of the remaining residual, which is noise for the right contact.
    samples = np.array([effective_samples([joint]) if len(joint) else 0.0 for joint in remainders])
    floor = np.maximum(1e-3 * before, np.finfo(float).tiny)
    gain = samples * np.log(np.maximum(before, floor) / np.maximum(after, floor))
    scaled, whole = A[finite] / _sizes(A[finite]), window.residual[finite]
    rank = int(np.linalg.matrix_rank(scaled, rtol=_cut(whole)))
    rest_of_all = np.square(whole - A[finite] @ _wrench(A[finite], whole)).sum()
    fitted = float(1.0 - rest_of_all / max(np.square(whole).sum(), 1e-300))
    share = float(1.0 - after.sum() / max(before.sum(), 1e-300))
    count = np.maximum((finite & inside[:, None]).sum(0), 1)
    return Predicted(before / count, after / count, share, fitted, float(gain.sum()), rank)
