"""Contact of a body that explains the residual in a window of a log, and its evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.episode import PointEpisode
from geodrake.identification.bounded_descent import bounded_least_squares
from geodrake.identification.logs.evidence import effective_samples
from geodrake.logs.filtering import ZeroPhaseFilter

Array = NDArray[np.float64]

PIECES = 4
"""Number of pieces of a window; alternate pieces predict the others."""

SHORTEST = 0.2
"""Shortest contact, s."""

FEW, ENOUGH = 10, 40
"""Steps of the search for a contact's times and point: first, and for the final body."""

_NEGLIGIBLE = 1e-4  # norm of a column, over the largest
_SINGULAR = 0.05  # relative singular value at a residual of the noise's size
_LEAST_SINGULAR, _LARGEST_SINGULAR = 2e-3, 0.02
_FARTHEST = 2.0  # m, largest coordinate of the point in the body frame
_SHARPEST = 1e-3  # s
# Deviations of a guess: start and end, s, logarithm of the rise, and point, m.
_UNSURE = np.array([0.5, 0.5, 2.0, 0.5, 0.5, 0.5])


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
class _Contacts:
    """Contacts of a body in a window, at the d joints that move it."""

    # (N, 5, 3 d) efforts of a constant wrench, over `size`: forces at Bo, their arms along x, y and
    # z, and moments, in body axes if the contact turns with the body.
    parts: Array
    time: Array  # (N,) instants at the full rate
    filter: ZeroPhaseFilter  # the log's filter
    rows: NDArray[np.bool_]  # (K, d) whether a residual is known
    residual: Array  # (M,) known residuals over `size`

    @classmethod
    def of(cls, window: ResidualWindow, contact: PointEpisode) -> _Contacts:
        """Return the contacts of a contact's body in a window."""
        motion = window.bodies.motion(contact.body)
        dofs, R = list(motion.dofs), motion.rotation.transpose(0, 2, 1)
        angular, linear = (
            J[:, :, dofs].transpose(0, 2, 1) for J in (motion.angular, motion.linear)
        )
        arms = np.cross(angular[:, None], R[:, :, None])  # axis of the body, joint, force
        parts = np.concatenate([linear[:, None], arms, angular[:, None]], 1)
        if contact.turning:
            parts = parts @ motion.rotation[:, None]
        values = contiguous((parts / window.size[dofs, None]).reshape(len(parts), 5, -1))
        residual = window.residual[:, dofs]
        rows = np.isfinite(residual)
        return cls(values, window.time, window.filter, rows, residual[rows])

    def unexplained(self, shape: Array, free: int) -> tuple[Array, Array]:
        """Return the residual (M,) that the best wrench leaves, and its slopes (M, `free`).

        Slopes neglect the change of the explained part, as Kaufman does. Wrenches have no
        directions of little effect.

        Args:
            shape: (6,) start, end, logarithm of the rise, and the point, m.
            free: Number of leading elements of `shape` that vary.
        """
        sums = self._filtered(shape)
        force = sums[:, :, 0] + np.tensordot(sums[:, :, 1:4], shape[3:], (2, 0))
        columns = np.concatenate([force, sums[:, :, 4]], -1)
        A, sizes = columns[:, 0], _sizes(columns[:, 0])
        U, values, Vt = np.linalg.svd(A / sizes, full_matrices=False)
        useful = values > max(_cut(self.residual) * values[0], np.finfo(float).tiny)
        U, explained = U[:, useful], U[:, useful].T @ self.residual
        wrench = (explained / values[useful]) @ Vt[useful] / sizes
        J = np.hstack([columns[:, 1:] @ wrench, sums[:, 0, 1:4] @ wrench[:3]])[:, :free]
        return self.residual - U @ explained, U @ (U.T @ J) - J

    def _filtered(self, shape: Array) -> Array:
        """Return `parts` (M, 4, 5, 3) of a contact, and their slopes by start, end and rise."""
        rise = float(np.exp(shape[2]))
        since = (self.time - shape[:2, None]) / rise
        after, before = np.tanh(since)
        begins, ends = 0.5 * (1.0 - np.square([after, before]))
        weights = [
            0.5 * (after - before),
            -begins / rise,
            ends / rise,
            since[1] * ends - since[0] * begins,
        ]
        sums = np.empty((len(self.rows), len(weights), *self.parts.shape[1:]))
        filters = contiguous(self.filter.kernel), self.filter.decimation
        calc_weighted(self.parts, np.stack(weights), filters, sums)
        return np.moveaxis(sums.reshape(*sums.shape[:3], -1, 3), 3, 1)[self.rows]


@compiled
def calc_weighted(parts: Array, weights: Array, filters: tuple[Array, int], out: Array) -> None:
    """Write the filtered products (K, W, 5, 3 d) of `_Contacts.parts` with weights (W, N).

    Args:
        parts: (N, 5, 3 d).
        weights: (W, N) factors of a wrench over time.
        filters: (T,) weights of the filter, and its decimation.
    """
    kernel, step = filters
    out[:] = 0.0
    for k in range(len(out)):
        for w in range(len(weights)):
            sums = out[k, w]
            for t in range(len(kernel)):
                weight = weights[w, k * step + t] * kernel[t]
                if weight != 0.0:
                    part = parts[k * step + t]
                    for a in range(len(sums)):
                        for i in range(sums.shape[1]):
                            sums[a, i] += weight * part[a, i]


def refined(window: ResidualWindow, contact: PointEpisode, *, steps: int = ENOUGH) -> PointEpisode:
    """Return the contact at the most probable times and point near those of a guess.

    A moment that turns with the force makes the point redundant. Each edge stays on its side of
    the window's middle.
    """
    contacts, free = _Contacts.of(window, contact), contact.free_shapes
    names = ("start", "end", "rise", "x", "y", "z")
    guess = np.array([getattr(contact, name) for name in names])
    guess[2] = np.log(guess[2])
    middle, span = 0.5 * (contact.start + contact.end), contact.end - contact.start
    lower, upper = np.array([-_FARTHEST, _FARTHEST])[:, None] * np.ones(len(names))
    lower[:3] = -np.inf, middle + 0.25 * SHORTEST, np.log(_SHARPEST)
    upper[:3] = middle - 0.25 * SHORTEST, np.inf, np.log(0.25 * span)
    bounds, weights = (lower[:free], upper[:free]), np.diag(1.0 / _UNSURE[:free])

    def with_slopes(x: Array) -> tuple[Array, Array]:
        residual, J = contacts.unexplained(np.concatenate([x, guess[free:]]), free)
        return np.hstack([residual, weights @ (x - guess[:free])]), np.vstack([J, weights])

    x, _ = bounded_least_squares(
        (lambda x: with_slopes(x)[0], with_slopes), np.clip(guess[:free], *bounds), bounds, steps
    )
    shape = np.concatenate([x, guess[free:]])
    shape[2] = np.exp(shape[2])
    return replace(contact, **dict(zip(names, shape.tolist(), strict=True)))


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
