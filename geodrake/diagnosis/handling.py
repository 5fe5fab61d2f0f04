"""Payloads that are picked up or put down in a log, and when.

A fit of one model to all of a log is wrong before an instant or after it, in the way in which a
body of other inertia is. So the columns of a body are cut in time: what those of a window add to
the evidence of a fit is a small Schur complement, whose parts are sums over the rows in it. All
windows between the instants of a grid are tried at once. The instants are then moved to where the
columns, filtered as the efforts are, add most.
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

from geodrake.diagnosis.contact_window import least_step
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
from geodrake.robot.regressor import body_regressor

Array = NDArray[np.float64]

_RIDGE = 1e-11  # of a normal matrix that has ones on its diagonal
_INSTANTS = 48  # of the grid between which windows are tried
_FEWEST = 20  # rows of a joint, with fewer of which nothing is tried
_LEAST = 0.03  # share of a log's rows before and after an instant
_MOST = 3  # windows of a log and body that are tried
_QUIETER = 0.25  # share of a joint's squared error that sensors make, below which it is much
_RISE = 0.02  # s, at first
_SHARPEST, _SLOWEST = 2e-3, 1.0  # s
_STEP, _STEP_OF_RISE = 0.02, 0.7  # first: s of an instant, logarithm of the rise
_TRIES = 80
_ALIKE = 0.3  # s, between instants that are not tried twice
_MOVED = 5e-4  # s, below which an instant stays


def handled(case: Case, model: LogModel, fit: Fit) -> list[Episode]:
    """Return bodies that carry a payload during part of a log.

    Friction and offsets may be beside the explanation so far. Where that leaves much more than the
    noise of sensors at a joint, the joint counts for little; so what is picked up or put down if
    only that noise were left is tried, too. Between two instants, such weights would let a payload
    imitate anything.
    """
    kinds = [kind for kind in case.effect_classes if kind.proposer is Proposer.HANDLING]
    if not kinds:
        return []
    beside = _beside(model, fit)
    quiet = model.quieted(beside)
    fits = [beside, quiet] if np.any(quiet.noise < _QUIETER * beside.noise) else [beside]
    tried = [term.effect for term in model.terms if isinstance(term.effect, Episode)]
    known = [term.effect for term in fit.terms if isinstance(term.effect, Episode)]
    found = list[Episode]()
    for one in fits:
        around = _Around.of(case, model, one, without=None)
        for held in _held(around, kinds, once=one is quiet):
            if any(_is_alike(held, other) for other in (*tried, *found)):
                continue
            if not any(_shares_an_edge(held, other) for other in known):
                found.append(held)
    return found


def _held(around: _Around, kinds: Sequence[type[Effect]], *, once: bool) -> Iterator[Episode]:
    """Yield bodies that carry a payload in windows of each log; if `once`, of one edge at most."""
    for log, trajectory in enumerate(around.case.trajectories):
        number = log_number(trajectory.name)
        for body in around.case.model.load_bodies:
            sums = _Sums.of(around, log, body)
            windows = sums.best_windows() if sums is not None else []
            if once:
                windows = [each for each in windows if None in each][:1]
            for start, end in windows:
                for kind in kinds:
                    make: Callable[..., Any] = kind
                    held = make(body, start=start, end=end, rise=_RISE, log=number)
                    yield _timed(around, held)


def instants(case: Case, model: LogModel, fit: Fit) -> dict[Effect, Effect]:
    """Return temporary effects of a fit, at their most probable instants."""
    moved = dict[Effect, Effect]()
    for term in fit.terms:
        effect = term.effect
        if isinstance(effect, Episode) and effect.proposer is Proposer.HANDLING:
            timed = _timed(_Around.of(case, model, fit, without=term), effect)
            if _distance(effect, timed) > _MOVED:
                moved[effect] = timed
    return moved


def is_short(case: Case, effect: Effect | None) -> bool:
    """Return whether an effect is so short that it may be a contact."""
    if not isinstance(effect, Episode) or effect.proposer is not Proposer.HANDLING:
        return False
    start, end, _, number = effect.window
    logs = [log for log in case.trajectories if number in (0, log_number(log.name))]
    if not logs:
        return False
    last = max(float(log.segments[-1][-1:].time[0] - log.began) for log in logs)
    there = (last if end is None else end) - (0.0 if start is None else start)
    return there <= MOST_TIME * last


def _is_alike(one: Episode, other: Episode) -> bool:
    """Return whether two episodes are of one body, and nearly of one window."""
    pairs = list(zip(one.window, other.window, strict=True))
    open_alike = all((a is None) == (b is None) for a, b in pairs)
    return _is_of_same(one, other) and open_alike and _distance(one, other) < _ALIKE


def _shares_an_edge(one: Episode, other: Episode) -> bool:
    """Return whether two episodes of one body share an edge, so that either explains the other."""
    pairs = product(one.window[:2], other.window[:2])
    near = any(abs(a - b) < _ALIKE for a, b in pairs if a is not None and b is not None)
    return _is_of_same(one, other) and near


def _is_of_same(one: Episode, other: Episode) -> bool:
    return type(one) is type(other) and one.where == other.where and one.is_of(other.window[3])


def _distance(one: Episode, other: Episode) -> float:
    """Return the largest difference of an edge or of the rise, s."""
    pairs = zip(one.window[:3], other.window[:3], strict=True)
    return max(abs(a - b) for a, b in pairs if a is not None and b is not None)


def _beside(model: LogModel, fit: Fit) -> Fit:
    """Fit what any joint may have beside an explanation, bodies as free as they may be."""
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
    known: Array  # (K, n) columns of the fit, each through its root: Σ wᵀ is a part of a complement
    left: Array  # (K,) what the fit leaves
    weight: float  # weight of a squared residual

    def part(self, rows: NDArray[np.generic] | slice) -> _Rows:
        """Return some of the rows."""
        kept = {name: getattr(self, name)[rows] for name in ("time", "body", "known", "left")}
        return replace(self, **kept)

    @property
    def columns(self) -> Array:
        """(K, n + 11) known columns, what they leave of the effort, and columns of the body."""
        return np.hstack([self.known, self.left[:, None], self.body])

    def products(self, body: Array) -> Array:
        """Return (10, n + 11) weighted products of columns (K, 10) of the body with all."""
        return np.asarray(self.weight * body.T @ replace(self, body=body).columns)


@dataclass(frozen=True, eq=False)
class _Around:
    """A fit, perhaps less one of its terms, in the form that rows of further columns need."""

    case: Case
    model: LogModel
    fit: Fit  # the fit, whose noise counts
    kept: NDArray[np.bool_]  # which of its parameters are left
    root: Array  # (n, n) lower triangle L with L Lᵀ = H, of those
    x: Array  # (n,) their values without the term
    prior: Array  # (10, 10) prior information of a payload

    @classmethod
    def of(cls, case: Case, model: LogModel, fit: Fit, *, without: Term | None) -> _Around:
        """Return a fit less a term, at its noise where joints do not reverse.

        An instant that is not exact leaves errors at few rows, in which a joint may reverse.
        """
        hessian, kept = model.even_hessian(fit), np.ones(len(fit.x), bool)
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
        own = slice(start, start + PARAMETERS_PER_BODY)
        reach = np.asarray(self.model.dataset.reach[:, own].any(axis=1))
        return [replace(e, body=e.body[:, own]) for e in self._logs[log] if reach[e.joint]]

    @cached_property
    def _logs(self) -> list[list[_Rows]]:
        """Rows of each log as `rows`, over the columns of all bodies."""
        found: list[list[_Rows]] = [[] for _ in self.case.trajectories]
        for j, data in enumerate(self.model.dataset.data):
            parts: list[list[JointRows]] = [[] for _ in found]
            for fold, kept in zip(self.case.folds, data.rows, strict=True):
                for block, rows in zip(fold.blocks, kept, strict=False):
                    parts[block.trajectory] += [rows] if len(rows.b) else []
            for log, own in enumerate(parts):
                if own:
                    found[log].append(self._of_joint(j, self.case.trajectories[log].began, own))
        return found

    def _of_joint(self, joint: int, began: float, parts: Sequence[JointRows]) -> _Rows:
        time = np.concatenate([part.time for part in parts])
        order = np.argsort(time, kind="stable")
        A, b = np.concatenate([p.A for p in parts])[order], np.concatenate([p.b for p in parts])
        known, effort = self.model.row_columns(self.fit, joint, A, b[order])
        known = known[:, self.kept]
        turned = solve_triangular(self.root, known.T, lower=True).T
        columns = self.model.dataset.data[joint].columns
        columns = columns[columns < self.case.model.phi.size]
        bodies = np.zeros((len(A), self.case.model.phi.size))
        bodies[:, columns] = A[:, : len(columns)]
        weight = float(self.fit.weights[joint])
        return _Rows(joint, time[order] - began, bodies, turned, effort - known @ self.x, weight)


def _gains(sums: Array, known: Array) -> tuple[Array, Array]:
    """Return evidence (m,) that bodies add by their sums (m, 10, n + 11), and their masses (m,)."""
    k = sums.shape[1]
    half, pull, own = sums[..., : -k - 1], sums[..., -k - 1], sums[..., -k:]
    schur = own - half @ np.swapaxes(half, -1, -2) + known
    x = np.linalg.solve(schur, pull[..., None])[..., 0]
    logarithm = np.linalg.slogdet(known)[1] - np.linalg.slogdet(schur)[1]
    return np.asarray((pull * x).sum(-1) + logarithm), np.asarray(x[..., 0])


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums of products over the time of a log."""

    edges: Array  # (B + 1,) instants between which rows are summed, s since the log began
    total: Array  # (B + 1, 10, n + 11) sums up to each
    share: Array  # (B + 1,) share of the rows up to each
    known: Array  # (10, 10) prior information of what is held
    price: float  # evidence that an instant must be worth
    is_only: bool  # whether there is no other log

    @classmethod
    def of(cls, around: _Around, log: int, body: str) -> _Sums | None:
        """Return the sums of a body's columns; None if there is no row."""
        rows = around.rows(log, body)
        if not rows:
            return None
        period = around.case.trajectories[log].filter.output_period
        every = np.unique(np.rint(np.concatenate([each.time for each in rows]) / period))
        if len(every) < _FEWEST:
            return None
        step = max(1, len(every) // (16 * _INSTANTS))
        first = every[::step]  # outputs at which bins begin
        size = np.sqrt(np.concatenate([np.full(len(each.time), each.weight) for each in rows]))
        wide = np.concatenate([each.columns for each in rows]) * size[:, None]
        output = np.rint(np.concatenate([each.time for each in rows]) / period)
        at = np.searchsorted(first, output, side="right") - 1
        order, counts = np.argsort(at, kind="stable"), np.bincount(at, minlength=len(first))
        number = np.arange(len(at)) - np.repeat(np.cumsum(counts) - counts, counts)
        binned = np.zeros((len(first), counts.max(), wide.shape[1]))
        binned[at[order], number] = wide[order]
        sums = np.swapaxes(binned[:, :, -PARAMETERS_PER_BODY:], 1, 2) @ binned
        edges = np.append((first - 0.5) * period, (every[-1] + 0.5) * period)
        total = np.concatenate([np.zeros((1, *sums.shape[1:])), np.cumsum(sums, axis=0)])
        counts = np.append(0, np.cumsum(counts))
        price = 2.0 * float(np.log(around.model.beliefs.order))  # it is one of many
        is_only = len(around.case.trajectories) == 1
        return cls(edges, total, counts / counts[-1], around.prior, price, is_only)

    def best_windows(self) -> list[tuple[float | None, float | None]]:
        """Return the windows whose columns add most.

        They are from an instant on, until one, between two, and all of one log of several.
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
        found = []
        for windows in filter(None, kinds):
            best = self._finer(self._best(windows), inside)
            edges = (best[0] > 0) + (best[1] < last)
            gain = float(self._gain([best])[0]) - edges * self.price
            if gain > 0.0:
                start = None if best[0] == 0 else float(self.edges[best[0]])
                end = None if best[1] == last else float(self.edges[best[1]])
                found.append((gain, (start, end)))
        return [window for _, window in sorted(found, key=lambda each: -each[0])[:_MOST]]

    def _gain(self, windows: Sequence[tuple[int, int]]) -> Array:
        """Evidence (m,) of windows by the indices of their edges; −∞ where the mass is negative."""
        first, end = np.array(windows).T
        gain, mass = _gains(self.total[end] - self.total[first], self.known)
        return np.where(mass > 0.0, gain, -np.inf)

    def _is_long(self, window: tuple[int, int]) -> bool:
        return bool(self.share[window[1]] - self.share[window[0]] >= _LEAST)

    def _best(self, windows: Sequence[tuple[int, int]]) -> tuple[int, int]:
        return windows[int(np.argmax(self._gain(windows)))]

    def _finer(self, window: tuple[int, int], inside: NDArray[np.intp]) -> tuple[int, int]:
        """Move edges that are inside the log to the best one of all, one after the other."""
        reach = 2 * len(inside) // _INSTANTS + 1
        for _ in range(2):
            for side in (0, 1):
                if window[side] in (0, len(self.edges) - 1):
                    continue
                near = inside[np.abs(inside - window[side]) <= reach].tolist()
                tried = [(k, window[1]) if side == 0 else (window[0], k) for k in near]
                window = self._best([*filter(self._is_long, tried)])
        return window


# Instants between rows.


def _timed(around: _Around, held: Episode) -> Episode:
    """Return an episode with edges, and a rise, with which its columns add most."""
    numbers = [log_number(trajectory.name) for trajectory in around.case.trajectories]
    if held.window[3] not in numbers or held.window[:2] == (None, None):
        return held
    log, body = numbers.index(held.window[3]), held.where[0]
    inside = dict(zip(("start", "end"), held.window[:2], strict=True))
    edges = {name: edge for name, edge in inside.items() if edge is not None}
    near = [_Near.of(around.case, body, log, edge) for edge in edges.values()]
    known = [each for each in near if each is not None]
    if len(known) < len(edges):  # the log has a gap there
        return held
    far, cut = np.zeros(()), list[tuple[int, _Rows, NDArray[np.intp]]]()
    every = around.rows(log, body)
    first, last = np.quantile(np.concatenate([e.time for e in every]), [_LEAST, 1.0 - _LEAST])
    for rows in every:
        rest = np.ones(len(rows.time), bool)
        for k, each in enumerate(known):
            close = rest & (rows.time >= each.outputs[0]) & (rows.time <= each.outputs[-1])
            rest &= ~close
            at = np.rint((rows.time[close] - each.outputs[0]) / each.period).astype(np.intp)
            cut.append((k, rows.part(close), np.clip(at, 0, len(each.outputs) - 1)))
        away = rows.part(rest)
        far = far + away.products(away.body * held.weight(away.time)[:, None])
    values = np.array([*edges.values()])
    make: Callable[..., Any] = replace

    def moved(step: Array) -> Episode | None:
        rise = held.window[2] * float(np.exp(step[-1]))
        times = dict(zip(edges, (values + step[:-1]).tolist(), strict=True))
        if not _SHARPEST <= rise <= _SLOWEST or np.abs(step[:-1]).max() > _SLOWEST:
            return None
        if not first <= min(times.values()) <= max(times.values()) <= last:
            return None
        if len(times) == 2 and times["end"] - times["start"] <= rise:
            return None
        found: Episode = make(held, rise=rise, **times)
        return found

    def lost(step: Array) -> float:
        other = moved(step)
        if other is None:
            return 0.0
        columns = [each.columns(other) for each in known]
        sums = far + sum(rows.products(columns[k][at, rows.joint]) for k, rows, at in cut)
        gain, mass = _gains(np.asarray(sums)[None], around.prior)
        return -float(gain[0]) if mass[0] > 0.0 else 0.0

    steps = np.array([*(_STEP for _ in edges), _STEP_OF_RISE])
    return moved(least_step(lost, steps, _TRIES, xatol=1e-4, fatol=1e-3)) or held


@dataclass(frozen=True, eq=False)
class _Near:
    """The columns of a body near an instant, at the full rate."""

    time: Array  # (N,) instants since the log began, s
    body: Array  # (N, nv, 10) columns of the body
    outputs: Array  # (K,) instants of the filtered samples
    period: float  # time from one of them to the next, s
    apply: Callable[[Array], Array]

    @classmethod
    def of(cls, case: Case, body: str, log: int, edge: float) -> _Near | None:
        """Return the columns near an edge; None where the log has a gap."""
        trajectory, model = case.trajectories[log], case.load_model
        low_pass = trajectory.filter
        reach = 3.0 * low_pass.halfwidth * low_pass.period + 2.0 * _SLOWEST
        cut = cut_out(trajectory, trajectory.segments, (edge, edge), reach)
        if cut is None or low_pass.output_count(len(cut[0])) < 2:
            return None
        near, time, outputs = cut
        q, index = model.positions(near.position), model.bodies.index(body)
        columns = body_regressor(model.tree, q, near.velocity, near.acceleration, index)
        return cls(time, columns, outputs, low_pass.output_period, low_pass.apply)

    def columns(self, held: Episode) -> Array:
        """Return (K, nv, 10) filtered columns of the body while it is held."""
        return np.asarray(self.apply(held.weight(self.time)[:, None, None] * self.body))
