"""The contact of a body that explains the residual in a window of a log, and its evidence."""

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
"""A window is cut into so many pieces; every other one predicts the rest."""

SHORTEST = 0.2
"""No contact shorter than this is looked for, s."""

FEW, ENOUGH = 120, 240
"""Steps of the search for a contact's times and point: on one of many bodies, and on the last."""

_UNFELT = 1e-4  # of the column that is felt most
_SINGULAR = 0.05  # over the residuals' RMS in noise, of the direction that is felt most
_LEAST_SINGULAR, _LARGEST_SINGULAR = 2e-3, 0.02
_FARTHEST = 2.0  # m, of the point from the body's origin
_SHARPEST = 1e-3  # s
_STEPS = np.array([0.05, 0.05, 0.5, 0.1, 0.1, 0.1])  # first: s, s, logarithm, m, m, m
_STEPS_IN_TIME = 3  # of them, the first


@dataclass(frozen=True, eq=False)
class ResidualWindow:
    """A window of a log, with the residual and the motion around it."""

    start: float  # first guess of when it starts, s since the log began
    end: float  # the same of when it ends
    time: Array  # (N,) instants at the full rate, s since the log began
    bodies: RobotBodies  # the bodies at these instants
    outputs: Array  # (K,) instants of the filtered samples
    residual: Array  # (K, nv) their residuals over `size`; NaN where left out
    size: Array  # (nv,) what is typical of each joint, and of what a contact leaves unexplained
    filter: ZeroPhaseFilter


def columns(window: ResidualWindow, contact: PointEpisode) -> Array:
    """Return (K, nv, 6) filtered columns of a contact, over what is typical of each joint."""
    values = contact.columns(window.bodies.motion(contact.body), window.time)
    return np.asarray(window.filter.apply(values) / window.size[:, None])


@dataclass(frozen=True, eq=False)
class WrenchColumns:
    """Columns of a body's contact at the d joints that move it, for a search over contacts."""

    # (N, 5, 3 d) what a constant wrench takes, over `size`: forces at Bo, their arms along x, y and
    # z, and moments, along the axes of the body where the contact turns with it.
    parts: Array
    time: Array  # (N,) instants at the full rate
    filter: ZeroPhaseFilter  # the log's filter
    rows: NDArray[np.bool_]  # (K, d) which residuals are known

    @classmethod
    def of(cls, window: ResidualWindow, contact: PointEpisode) -> WrenchColumns:
        """Return those of a contact's body in a window."""
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
        low_pass, found = self.filter, np.zeros((*self.rows.shape, 6))
        weights = 0.5 * (after - before)
        filters = contiguous(low_pass.kernel), low_pass.decimation
        add_wrench_columns(self.parts, weights, filters, contiguous(shape[3:]), found)
        return found[self.rows]


@compiled
def add_wrench_columns(
    parts: Array, weights: Array, filters: tuple[Array, int], point: Array, out: Array
) -> None:
    """Add the filtered columns (K, d, 6) of a force and a moment at a point (3,), m.

    Args:
        parts: (N, 5, 3 d) as those of `WrenchColumns`.
        weights: (N,) how much of the wrench is there.
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
    """Return the contact with the times and point that leave least of the squared residual."""
    felt = WrenchColumns.of(window, contact)
    dofs = list(window.bodies.motion(contact.body).dofs)
    b = window.residual[:, dofs][felt.rows]
    cut = _cut(b)
    # A moment makes up for any point where it turns with the force.
    steps: Array = _STEPS[:_STEPS_IN_TIME] if contact.turning else _STEPS

    names = ("start", "end", "rise", "x", "y", "z")
    begin = np.array([getattr(contact, name) for name in names])

    def moved(step: Array) -> Array | None:
        shape = begin.copy()
        shape[: len(step)] += step
        shape[2] = begin[2] * np.exp(step[2])
        span = shape[1] - shape[0]
        if span < 0.5 * SHORTEST or not _SHARPEST <= shape[2] <= 0.25 * span:
            return None
        return shape if np.abs(shape[3:]).max() <= _FARTHEST else None

    def explained(step: Array) -> float:
        """By the least-squares wrench, without the directions that hardly act on the joints."""
        shape = moved(step)
        if shape is None:
            return 0.0
        A = felt.columns(shape)
        A /= _sizes(A)
        values, vectors = np.linalg.eigh(A.T @ A)
        clear = values > max(cut**2 * values[-1], np.finfo(float).tiny)
        return float(np.sum(np.square((A.T @ b) @ vectors[:, clear]) / values[clear]))

    best = least_step(lambda x: -explained(x), steps, tries, xatol=1e-3, fatol=1e-2)
    shape = moved(best)
    if shape is None:
        return contact
    return replace(contact, **dict(zip(names, shape.tolist(), strict=True)))


def least_step(loss: Callable[[Array], float], steps: Array, tries: int, **close: float) -> Array:
    """Return the step from zero to the minimum of a loss, by the Nelder–Mead simplex."""
    simplex = np.vstack([np.zeros(len(steps)), np.diag(steps)])
    options = {"initial_simplex": simplex, "maxiter": tries, **close}
    return np.asarray(minimize(loss, simplex[0], method="Nelder-Mead", options=options).x)


def with_point(window: ResidualWindow, contact: PointEpisode) -> PointEpisode:
    """Return a contact at the point, on the line of its force, that makes its moment smallest.

    Its point is at Bo at first, and stays there if the wrench turns with it.
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
    """Return the (6,) least-squares wrench, without directions that hardly act on the joints."""
    sizes = _sizes(A)
    return np.asarray(np.linalg.lstsq(A / sizes, b, rcond=_cut(b))[0] / sizes)


def _sizes(A: Array) -> Array:
    """Return (6,) norms of columns, with which forces and moments are made comparable.

    Each counts alike, but one that is hardly felt: a quiet joint that feels one moment alone would
    make that column larger than all others by far.
    """
    norms = np.linalg.norm(A, axis=0)
    return np.maximum(norms, max(_UNFELT * float(norms.max(initial=0.0)), np.finfo(float).tiny))


def _cut(b: Array) -> float:
    """Return how much less than the clearest a direction of the wrench may be felt to be of use.

    The more residuals (K,) stand out of the noise, the less a direction has to be felt.
    """
    clearness = float(np.sqrt(np.mean(np.square(b)))) if b.size else 0.0
    return float(np.clip(_SINGULAR / max(clearness, 1.0), _LEAST_SINGULAR, _LARGEST_SINGULAR))


@dataclass(frozen=True, eq=False)
class Predicted:
    """Prediction of the other pieces of a window by the wrench of every second one."""

    before: Array  # (nv,) mean squared residual of each joint, 0 where it is not known
    after: Array  # (nv,) what is left of it
    share: float  # share of the squared residuals that is predicted
    fitted: float  # the same share by a wrench of all pieces
    gain: float  # twice the log-likelihood ratio
    felt: int  # how many directions of the wrench the joints feel


def evidence(window: ResidualWindow, contact: PointEpisode) -> Predicted:
    """Return the prediction of the rest by the wrench of every other piece of a window."""
    A = columns(window, contact)
    inside = (window.outputs >= contact.start) & (window.outputs <= contact.end)
    since = (window.outputs - contact.start) / (contact.end - contact.start)
    piece = np.floor(PIECES * since).astype(int)
    known, odd = np.isfinite(window.residual), piece % 2 == 1
    before, after = np.zeros((2, window.residual.shape[1]))
    rest = np.full_like(window.residual, np.nan)
    for held in (odd, ~odd):
        fit, seen = (known & (inside & part)[:, None] for part in (~held, held))
        wrench = _wrench(A[fit], window.residual[fit])
        error = window.residual - A @ wrench
        rest = np.where(seen, error, rest)
        before += np.where(seen, np.square(window.residual), 0.0).sum(0)
        after += np.where(seen, np.square(error), 0.0).sum(0)
    left = [column[np.isfinite(column)] for column in rest.T]
    # The right contact leaves noise, whatever the residual is like where it was not known.
    samples = np.array([effective_samples([joint]) if len(joint) else 0.0 for joint in left])
    floor = np.maximum(1e-3 * before, np.finfo(float).tiny)
    gain = samples * np.log(np.maximum(before, floor) / np.maximum(after, floor))
    scaled, whole = A[known] / _sizes(A[known]), window.residual[known]
    felt = int(np.linalg.matrix_rank(scaled, rtol=_cut(whole)))
    rest_of_all = np.square(whole - A[known] @ _wrench(A[known], whole)).sum()
    fitted = float(1.0 - rest_of_all / max(np.square(whole).sum(), 1e-300))
    share = float(1.0 - after.sum() / max(before.sum(), 1e-300))
    count = np.maximum((known & inside[:, None]).sum(0), 1)
    return Predicted(before / count, after / count, share, fitted, float(gain.sum()), felt)
