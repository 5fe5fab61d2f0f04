"""Payloads that are picked up or put down in a log, and when.

The error of a fit of one model to such a log is that of a body with other inertia before or after
an instant. The columns of a body are therefore restricted to time windows: the gain in evidence of
a window is a small Schur complement, whose parts are sums over its rows. All windows between the
instants of a grid are tried at once; the instants are then refined with columns that are filtered
as the efforts are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from geodrake.compiling import contiguous
from geodrake.diagnosis.episodes import MOST_TIME
from geodrake.diagnosis.log_model import Fit, LogModel
from geodrake.diagnosis.residuals import cut_out
from geodrake.diagnosis.terms import Term
from geodrake.effects.base import Effect, Proposer
from geodrake.effects.episode import Episode
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.dataset import JointRows
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.identification.normal_equations import scaled_cholesky
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs.filtering import ZeroPhaseFilter
from geodrake.robot.regressor import body_regressor

Array = NDArray[np.float64]

_RIDGE = 1e-11  # of a normal matrix with a unit diagonal
_INSTANTS = 48  # of the grid
_FEWEST = 20  # least number of instants with rows
_LEAST = 0.03  # least share of a log's rows before and after an instant
_MOST = 3  # windows of a log and body
_QUIETER = 0.25  # largest ratio of sensor noise to squared error, to fit with sensor noise, too
_RISE = 0.02  # s, initial value
_SHARPEST, _SLOWEST = 2e-3, 1.0  # s
_STEP, _STEP_OF_RISE = 0.02, 0.7  # initial: s of an instant, logarithm of the rise
_TRIES = 80
_ALIKE = 0.3  # s, largest difference of equal instants
_MOVED = 5e-4  # s, least change of an instant


def handled_payloads(case: Case, model: LogModel, fit: Fit) -> list[Episode]:
    """Return bodies that carry a payload during part of a log.

    The explanation is extended by friction and offsets. A joint with much more error than sensor
    noise has little weight, so that payloads are also searched with sensor noise only; they then
    have one edge at most, as between two edges such weights would let a payload imitate anything.
    """
    kinds = [kind for kind in case.effect_classes if kind.proposer is Proposer.HANDLING]
    if not kinds:
        return []
    whole = _extended(model, fit)
    quiet = model.with_sensor_noise(whole)
    fits = [whole, quiet] if np.any(quiet.noise < _QUIETER * whole.noise) else [whole]
    candidates = [term.effect for term in model.terms if isinstance(term.effect, Episode)]
    known = [term.effect for term in fit.terms if isinstance(term.effect, Episode)]
    payloads = list[Episode]()
    for base in fits:
        around = _Base.of(case, model, base, without=None)
        for payload in _payloads(around, kinds, once=base is quiet):
            if any(_is_alike(payload, other) for other in (*candidates, *payloads)):
                continue
            if not any(_shares_an_edge(payload, other) for other in known):
                payloads.append(payload)
    return payloads


def _payloads(around: _Base, kinds: Sequence[type[Effect]], *, once: bool) -> Iterator[Episode]:
    """Yield bodies with a payload in windows of each log; if `once`, with at most one edge."""
    for log, trajectory in enumerate(around.case.trajectories):
        number = log_number(trajectory.name)
        for body in around.case.model.load_bodies:
            sums = _Sums.of(around, log, body)
            windows = sums.best_windows() if sums is not None else []
            if once:
                windows = [window for window in windows if None in window][:1]
            for start, end in windows:
                for kind in kinds:
                    make: Callable[..., Any] = kind
                    payload = make(body, start=start, end=end, rise=_RISE, log=number)
                    yield _timed(around, payload)


def refined_instants(case: Case, model: LogModel, fit: Fit) -> dict[Effect, Effect]:
    """Return temporary effects of a fit -> the same at their most probable instants."""
    moved = dict[Effect, Effect]()
    for term in fit.terms:
        effect = term.effect
        if isinstance(effect, Episode) and effect.proposer is Proposer.HANDLING:
            timed = _timed(_Base.of(case, model, fit, without=term), effect)
            if _distance(effect, timed) > _MOVED:
                moved[effect] = timed
    return moved


def is_short(case: Case, effect: Effect | None) -> bool:
    """Return whether an effect is short enough to be a contact."""
    if not isinstance(effect, Episode) or effect.proposer is not Proposer.HANDLING:
        return False
    start, end, _, number = effect.window
    logs = [log for log in case.trajectories if number in (0, log_number(log.name))]
    if not logs:
        return False
    last = max(float(log.segments[-1][-1:].time[0] - log.began) for log in logs)
    duration = (last if end is None else end) - (0.0 if start is None else start)
    return duration <= MOST_TIME * last


def _is_alike(episode: Episode, other: Episode) -> bool:
    """Return whether two episodes of one body have almost the same window."""
    pairs = list(zip(episode.window, other.window, strict=True))
    same_ends = all((a is None) == (b is None) for a, b in pairs)
    return _is_of_same(episode, other) and same_ends and _distance(episode, other) < _ALIKE


def _shares_an_edge(episode: Episode, other: Episode) -> bool:
    """Return whether two episodes of one body share an edge, so that either explains the other."""
    pairs = product(episode.window[:2], other.window[:2])
    near = any(abs(a - b) < _ALIKE for a, b in pairs if a is not None and b is not None)
    return _is_of_same(episode, other) and near


def _is_of_same(one: Episode, other: Episode) -> bool:
    return type(one) is type(other) and one.where == other.where and one.is_of(other.window[3])


def _distance(episode: Episode, other: Episode) -> float:
    """Return the largest difference of an edge or of the rise, s."""
    pairs = zip(episode.window[:3], other.window[:3], strict=True)
    return max(abs(a - b) for a, b in pairs if a is not None and b is not None)


def _extended(model: LogModel, fit: Fit) -> Fit:
    """Return the fit with all common effects, and with bodies as free as possible."""
    terms = fit.terms
    for term in model.terms:
        likely = term.effect is not None and term.effect.complexity == 0
        if likely and model.are_compatible((*terms, term)):
            terms = (*terms, term)
    choice = model.choice(fit.choice, terms, width=model.widths[-1])
    return model.unbounded(choice, model.shares(fit))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of one joint in one log, over columns of a body and those of a fit."""

    joint: int
    time: Array  # (K,) instants since the log began, s
    body: Array  # (K, 10) columns of the body
    known: Array  # (K, n) columns of the fit times L⁻ᵀ
    residual: Array  # (K,) residual of the fit
    weight: float  # weight of a squared residual

    def part(self, rows: NDArray[np.generic] | slice) -> _Rows:
        """Return some of the rows."""
        kept = {name: getattr(self, name)[rows] for name in ("time", "body", "known", "residual")}
        return replace(self, **kept)

    @property
    def columns(self) -> Array:
        """(K, n + 11) columns of the fit, its residual, and columns of the body."""
        return np.hstack([self.known, self.residual[:, None], self.body])

    def products(self, body: Array) -> Array:
        """Return (10, n + 11) weighted products of columns (K, 10) of the body with all."""
        return np.asarray(self.weight * body.T @ replace(self, body=body).columns)


@dataclass(frozen=True, eq=False)
class _Base:
    """Fit without one of its terms, in the form needed to add columns."""

    case: Case
    model: LogModel
    fit: Fit  # the fit, with its noise
    kept: NDArray[np.bool_]  # whether each parameter is kept
    root: Array  # (n, n) Cholesky factor L of their Hessian
    x: Array  # (n,) their values without the term
    prior: Array  # (10, 10) prior information of a payload

    @classmethod
    def of(cls, case: Case, model: LogModel, fit: Fit, *, without: Term | None) -> _Base:
        """Return a fit without a term, with the noise outside of reversals.

        An inexact instant leaves errors at few rows, in which a joint may reverse.
        """
        hessian = model.hessian(fit, uniform_noise=True)
        kept = np.ones(len(fit.x), bool)
        if without is not None:
            kept[model.spans(fit.terms)[without]] = False
        H, x = hessian[np.ix_(kept, kept)], fit.x[kept]
        factor, scale = scaled_cholesky(H, _RIDGE)
        root = factor / scale[:, None]
        if without is not None:
            pull = hessian[np.ix_(kept, ~kept)] @ fit.x[~kept]
            half = solve_triangular(root, pull, lower=True)
            x = x + solve_triangular(root.T, half, lower=False)
        prior = pullback_information(model.dataset.payload[None], max(model.beliefs.payloads))
        return cls(case, model, fit, kept, root, x, prior)

    def rows(self, log: int, body: str) -> list[_Rows]:
        """Return the rows of a log over columns of a body, joint by joint, in order of time."""
        start = PARAMETERS_PER_BODY * self.case.model.bodies.index(body)
        columns = slice(start, start + PARAMETERS_PER_BODY)
        reach = np.asarray(self.model.dataset.reach[:, columns].any(axis=1))
        return [replace(e, body=e.body[:, columns]) for e in self._logs[log] if reach[e.joint]]

    @cached_property
    def _logs(self) -> list[list[_Rows]]:
        """Rows of each log, over the columns of all bodies."""
        logs: list[list[_Rows]] = [[] for _ in self.case.trajectories]
        for j, data in enumerate(self.model.dataset.data):
            parts: list[list[JointRows]] = [[] for _ in logs]
            for log, rows in data.logged_rows(self.case.folds):
                parts[log] += [rows] if len(rows.b) else []
            for log, pieces in enumerate(parts):
                if pieces:
                    logs[log].append(self._of_joint(j, self.case.trajectories[log].began, pieces))
        return logs

    def _of_joint(self, joint: int, began: float, parts: Sequence[JointRows]) -> _Rows:
        time = np.concatenate([part.time for part in parts])
        order = np.argsort(time, kind="stable")
        A, b = np.concatenate([p.A for p in parts])[order], np.concatenate([p.b for p in parts])
        known, effort = self.model.row_columns(self.fit, joint, A, b[order])
        known = known[:, self.kept]
        projected = solve_triangular(self.root, known.T, lower=True).T
        columns = self.model.dataset.data[joint].columns
        columns = columns[columns < self.case.model.phi.size]
        bodies = np.zeros((len(A), self.case.model.phi.size))
        bodies[:, columns] = A[:, : len(columns)]
        weight = float(self.fit.weights[joint])
        return _Rows(joint, time[order] - began, bodies, projected, effort - known @ self.x, weight)


def _gains(sums: Array, known: Array) -> tuple[Array, Array]:
    """Return the gains in evidence (m,) of bodies by sums (m, 10, n + 11), and masses (m,)."""
    k = sums.shape[1]
    cross, pull, gram = sums[..., : -k - 1], sums[..., -k - 1], sums[..., -k:]
    schur = gram - cross @ np.swapaxes(cross, -1, -2) + known
    x = np.linalg.solve(schur, pull[..., None])[..., 0]
    logarithm = np.linalg.slogdet(known)[1] - np.linalg.slogdet(schur)[1]
    return np.asarray((pull * x).sum(-1) + logarithm), np.asarray(x[..., 0])


@dataclass(frozen=True, eq=False)
class _Sums:
    """Cumulative sums of products over the time of a log."""

    edges: Array  # (B + 1,) edges of bins, s since the log began
    total: Array  # (B + 1, 10, n + 11) sums up to each edge
    share: Array  # (B + 1,) share of the rows up to each edge
    known: Array  # (10, 10) prior information of the payload
    price: float  # least evidence of an instant
    is_only: bool  # whether this is the only log

    @classmethod
    def of(cls, around: _Base, log: int, body: str) -> _Sums | None:
        """Return the sums of a body's columns; None if there are too few rows."""
        rows = around.rows(log, body)
        if not rows:
            return None
        period = around.case.trajectories[log].filter.output_period
        outputs = np.unique(np.rint(np.concatenate([part.time for part in rows]) / period))
        if len(outputs) < _FEWEST:
            return None
        step = max(1, len(outputs) // (16 * _INSTANTS))
        first = outputs[::step]  # outputs at which bins begin
        size = np.sqrt(np.concatenate([np.full(len(part.time), part.weight) for part in rows]))
        weighted = np.concatenate([part.columns for part in rows]) * size[:, None]
        output = np.rint(np.concatenate([part.time for part in rows]) / period)
        bins = np.searchsorted(first, output, side="right") - 1
        order, counts = np.argsort(bins, kind="stable"), np.bincount(bins, minlength=len(first))
        position = np.arange(len(bins)) - np.repeat(np.cumsum(counts) - counts, counts)
        binned = np.zeros((len(first), counts.max(), weighted.shape[1]))
        binned[bins[order], position] = weighted[order]
        sums = np.swapaxes(binned[:, :, -PARAMETERS_PER_BODY:], 1, 2) @ binned
        edges = np.append((first - 0.5) * period, (outputs[-1] + 0.5) * period)
        total = np.concatenate([np.zeros((1, *sums.shape[1:])), np.cumsum(sums, axis=0)])
        counts = np.append(0, np.cumsum(counts))
        price = 2.0 * float(np.log(around.model.beliefs.order))  # one of many instants
        is_only = len(around.case.trajectories) == 1
        return cls(edges, total, counts / counts[-1], around.prior, price, is_only)

    def best_windows(self) -> list[tuple[float | None, float | None]]:
        """Return the windows with the largest gains, one of each kind.

        The kinds are from an instant on, until an instant, between two, and one log of several.
        """
        last, share = len(self.edges) - 1, self.share
        inside = np.flatnonzero((share >= _LEAST) & (share <= 1.0 - _LEAST))
        if not len(inside):
            return []
        grid = np.unique(inside[np.linspace(0, len(inside) - 1, _INSTANTS).astype(int)]).tolist()
        kinds = [
            [(k, last) for k in grid],
            [(0, k) for k in grid],
            [pair for pair in combinations(grid, 2) if self._is_long(pair)],
            [] if self.is_only else [(0, last)],
        ]
        ranked = []
        for windows in filter(None, kinds):
            best = self._finer(self._best(windows), inside)
            edges = (best[0] > 0) + (best[1] < last)
            gain = float(self._gain([best])[0]) - edges * self.price
            if gain > 0.0:
                start = None if best[0] == 0 else float(self.edges[best[0]])
                end = None if best[1] == last else float(self.edges[best[1]])
                ranked.append((gain, (start, end)))
        return [window for _, window in sorted(ranked, key=lambda each: -each[0])[:_MOST]]

    def _gain(self, windows: Sequence[tuple[int, int]]) -> Array:
        """Return the gains (m,) of windows of edge indices; −∞ if the mass is negative."""
        first, end = np.array(windows).T
        gain, mass = _gains(self.total[end] - self.total[first], self.known)
        return np.where(mass > 0.0, gain, -np.inf)

    def _is_long(self, window: tuple[int, int]) -> bool:
        return bool(self.share[window[1]] - self.share[window[0]] >= _LEAST)

    def _best(self, windows: Sequence[tuple[int, int]]) -> tuple[int, int]:
        return windows[int(np.argmax(self._gain(windows)))]

    def _finer(self, window: tuple[int, int], inside: NDArray[np.intp]) -> tuple[int, int]:
        """Return the window with its inner edges moved to the best places, one after the other."""
        reach = 2 * len(inside) // _INSTANTS + 1
        for _ in range(2):
            for side in (0, 1):
                if window[side] in (0, len(self.edges) - 1):
                    continue
                near = inside[np.abs(inside - window[side]) <= reach].tolist()
                tried = [(k, window[1]) if side == 0 else (window[0], k) for k in near]
                window = self._best([*filter(self._is_long, tried)])
        return window


# Refined instants.


def _timed(around: _Base, payload: Episode) -> Episode:
    """Return an episode with the edges and rise of largest gain."""
    numbers = [log_number(trajectory.name) for trajectory in around.case.trajectories]
    if payload.window[3] not in numbers or payload.window[:2] == (None, None):
        return payload
    log, body = numbers.index(payload.window[3]), payload.where[0]
    inside = dict(zip(("start", "end"), payload.window[:2], strict=True))
    edges = {name: edge for name, edge in inside.items() if edge is not None}
    joints = around.rows(log, body)
    felt = [rows.joint for rows in joints]
    nearby = [_Edge.of(around.case, body, felt, (log, edge)) for edge in edges.values()]
    windows = [window for window in nearby if window is not None]
    if len(windows) < len(edges):  # the log has a gap there
        return payload
    distant, cut = np.zeros(()), list[tuple[int, int, _Rows, NDArray[np.intp]]]()
    first, last = np.quantile(np.concatenate([e.time for e in joints]), [_LEAST, 1.0 - _LEAST])
    for column, rows in enumerate(joints):
        rest = np.ones(len(rows.time), bool)
        for k, window in enumerate(windows):
            close = rest & (rows.time >= window.outputs[0]) & (rows.time <= window.outputs[-1])
            rest &= ~close
            at = np.rint((rows.time[close] - window.outputs[0]) / window.period).astype(np.intp)
            cut.append((k, column, rows.part(close), np.clip(at, 0, len(window.outputs) - 1)))
        others = rows.part(rest)
        distant = distant + others.products(others.body * payload.weight(others.time)[:, None])
    values = np.array([*edges.values()])
    make: Callable[..., Any] = replace

    def moved(step: Array) -> Episode | None:
        rise = payload.window[2] * float(np.exp(step[-1]))
        times = dict(zip(edges, (values + step[:-1]).tolist(), strict=True))
        if not _SHARPEST <= rise <= _SLOWEST or np.abs(step[:-1]).max() > _SLOWEST:
            return None
        if not first <= min(times.values()) <= max(times.values()) <= last:
            return None
        if len(times) == 2 and times["end"] - times["start"] <= rise:
            return None
        found: Episode = make(payload, rise=rise, **times)
        return found

    def lost(step: Array) -> float:
        other = moved(step)
        if other is None:
            return 0.0
        columns = [window.columns(other) for window in windows]
        near = (rows.products(columns[k][at, j]) for k, j, rows, at in cut)
        sums = distant + sum(near)
        gain, mass = _gains(np.asarray(sums)[None], around.prior)
        return -float(gain[0]) if mass[0] > 0.0 else 0.0

    steps = np.diag([*(_STEP for _ in edges), _STEP_OF_RISE])
    simplex = np.vstack([np.zeros(len(steps)), steps])
    options = {"initial_simplex": simplex, "maxiter": _TRIES, "xatol": 1e-4, "fatol": 1e-3}
    best = minimize(lost, simplex[0], method="Nelder-Mead", options=options).x
    return moved(np.asarray(best)) or payload


@dataclass(frozen=True, eq=False)
class _Edge:
    """Columns of a body around an instant, at the full rate."""

    time: Array  # (N,) instants since the log began, s
    body: Array  # (N, j, 10) columns of the body, at the joints that feel it
    outputs: Array  # (K,) instants of the filtered samples
    low_pass: ZeroPhaseFilter

    @property
    def period(self) -> float:
        """Return the period of the filtered samples, s."""
        return self.low_pass.output_period

    @classmethod
    def of(
        cls, case: Case, body: str, joints: list[int], instant: tuple[int, float]
    ) -> _Edge | None:
        """Return the columns of a body at some joints around an instant of a log.

        The result is None if the log has a gap there.
        """
        log, edge = instant
        trajectory, model = case.trajectories[log], case.load_model
        low_pass = trajectory.filter
        reach = 3.0 * low_pass.halfwidth * low_pass.period + 2.0 * _SLOWEST
        cut = cut_out(trajectory, trajectory.segments, (edge, edge), reach)
        if cut is None or low_pass.output_count(len(cut[0])) < 2:
            return None
        segment, time, outputs = cut
        q, index = model.positions(segment.position), model.bodies.index(body)
        columns = body_regressor(model.tree, q, segment.velocity, segment.acceleration, index)
        return cls(time, contiguous(columns[:, joints]), outputs, low_pass)

    def columns(self, payload: Episode) -> Array:
        """Return (K, j, 10) filtered columns of the body during an episode."""
        return self.low_pass.apply_weighted(self.body, contiguous(payload.weight(self.time)))
