"""Linear Gaussian model of logs: the evidence of any set of terms in closed form.

    b_j = A_j x + noise of joint j,   x ~ N(m, Λ⁻¹)

The rows of A are those of all logs; x contains the parameters of bodies, effects and nuisances. At
the most probable noise, twice the log-evidence of a set of terms is

    −Σ_k n_k log σ_k² − (x − m)ᵀ Λ (x − m) − log |Λ + Σ_k w_k A_kᵀA_k| + log |Λ|,

where w_k = n_k / (N_k σ_k²), N_k is the number of rows and n_k their effective sample size. A block
k has the rows of a joint, or those in which it reverses: samples resolve a jump of dry friction
only partly, so that these rows have a noise variance of their own. Normal matrices of all columns
are formed once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtrs

from geodrake.compiling import contiguous
from geodrake.diagnosis.base_unknowns import BaseUnknowns
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.block_solution import Prior, prior_distance, prior_matrix
from geodrake.diagnosis.normal_kernels import (
    RIDGE,
    Normal,
    add_normal,
    calc_distance,
    calc_most_probable,
    calc_noise_changes,
    calc_packed,
    calc_physical_share,
    calc_squares,
    empty_packed,
)
from geodrake.diagnosis.terms import (
    Compatibility,
    Term,
    Terms,
    is_expandable,
    key_of,
    odds_against,
    terms_of,
)
from geodrake.diagnosis.unknown_efforts import UnresolvedReversal
from geodrake.effects.base import Effect
from geodrake.effects.episode import Episode
from geodrake.identification.logs.criteria import LEAST_NOISE, SPREAD
from geodrake.identification.logs.dataset import (
    Dataset,
    JointData,
    JointRows,
    inertias_of,
    is_payload,
)
from geodrake.identification.logs.hypothesis import (
    CrossValidation,
    HeldOut,
    Hypothesis,
    effective_of_rows,
    hold_out,
)
from geodrake.identification.logs.model_fit import model_unknowns
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.identification.normal_equations import scaled_cholesky, singular_error, solved
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.inertia.parameters import pseudo_inertia_basis
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Delay = tuple[int, ...]

_LEAST_SHARE = 1e-4  # of effective samples per row
_SIMPLER = 0.5
_LEAST_WIDTH, _WIDTHS = 0.01, 15  # least prior width of inertias, and number of widths averaged
_USUAL_SHARE = 0.3
_ON_TIME = 1e-9  # s
_UNSURE_DELAY = 0.01  # deviation of a fitted delay, over the least difference of candidates
_ASYNCHRONOUS = 0.5  # deviation of the file's delays, over the least difference of candidates
_NOTABLE = 0.5  # largest ratio of squared errors with and without the error of a gain
_MOST_PINNED, _PINNED = 4, 1e15
_STATED = 1e-4  # relative deviation of effects that the file states
_PSEUDO = pseudo_inertia_basis()
_REVERSING = 0.03, 0.1  # bounds of the share of a row with unknown direction, to be a reversal
_FEWEST_OTHERS = 0.25  # least share of rows without a reversal
_FARTHEST = 1e4  # largest squared distance that an unphysical body is penalized by
_DRAWS = np.random.default_rng(0).normal(size=(200, PARAMETERS_PER_BODY))


@dataclass(frozen=True, eq=False)
class Choice:
    """An explanation: terms, the prior width of bodies, and delays."""

    terms: Terms  # the terms, in the order of their columns
    width: float  # width of the prior of all bodies, as a geometric distance
    delay: Delay  # (nv,) index of the delay of each joint

    @property
    def key(self) -> tuple[frozenset[Term], float, Delay]:
        """Return its identity among explanations."""
        return frozenset(self.terms), self.width, self.delay


@dataclass(frozen=True, eq=False)
class Fit:
    """Most probable parameters and noise of an explanation."""

    choice: Choice
    columns: Indices  # (n,) indices of its columns in the model
    x: Array  # (n,) parameters
    noise: Array  # (B,) mean squared residuals of blocks of rows, (N·m)² or N²
    weights: Array  # (B,) w_k
    prior: Prior  # Λ and Λm
    score: float  # twice the log of evidence times prior odds, up to a constant

    @property
    def terms(self) -> Terms:
        """Return the terms of the explanation."""
        return self.choice.terms

    @property
    def variance(self) -> Array:
        """(nv,) mean squared residuals of each joint outside of reversals, (N·m)² or N²."""
        return self.noise[: len(self.choice.delay)]


class LogModel:
    """Gaussian model of reduced logs.

    `effects` are candidates, and `on_time` (nv,) is the index of the dataset's delay that equals
    the model's own. `loads` (nb, 10) are bodies with payloads, whose efforts scale with gains.
    `file_delays` (nv,) are delays that the file states, s; by default those of the model.
    """

    def __init__(
        self,
        model: RobotModel,
        dataset: Dataset,
        effects: Sequence[Effect],
        beliefs: Beliefs,
        on_time: Delay,
        *,
        loads: Array | None = None,
        file_delays: Array | None = None,
    ) -> None:
        self.model, self.dataset, self.beliefs, self.on_time = model, dataset, beliefs, on_time
        self.loads = loads
        self._found_delays = model.delays - (model.delays if file_delays is None else file_delays)
        self.unknowns = model_unknowns(dataset, model, stated=_STATED)
        keys = frozenset(
            key_of(effect, kind)
            for effect in self.unknowns.effects
            if not is_payload(effect)  # the payload may have changed
            for kind in (type(effect), *effect.contains)
        )
        known = {e for e in self.unknowns.effects if is_expandable(e) or isinstance(e, Episode)}
        self.terms = terms_of(model, dataset, [e for e in effects if e not in known], beliefs)
        self.compatibility = Compatibility(self.terms, keys)
        # All shapes of an effect at a joint have the same odds in any set.
        prices = dict[object, int]()
        self._prices = {
            term: prices.setdefault((term.price, term.parts), len(prices)) for term in self.terms
        }
        self._odds = dict[tuple[int, ...], float]()
        self._base_priors = dict[float, tuple[Array, Array]]()
        self._other_odds = dict[tuple[float, Delay], float]()
        self.widths = beliefs.widths if model.information is None else (1.0, 3.0)
        self.rows = dataset.rows.astype(float)
        self.floor = np.square(LEAST_NOISE * np.maximum(dataset.effort_std, 1e-12))
        self._bodies = len(dataset.bodies) * PARAMETERS_PER_BODY
        self._assemble()
        self._shares = dict[object, Array]()

    # Assembly.

    def _assemble(self) -> None:
        """Form the normal matrices over all columns: model, gains, reversals, terms."""
        data, nv = self.dataset, len(self.dataset.joints)
        self._reversals = [e for e in data.effects if isinstance(e, UnresolvedReversal)]
        self._unsure = {effect.joint: self._unsure_column(effect) for effect in self._reversals}
        blocks = self._blocks()
        self._base = BaseUnknowns.of(self.unknowns, self._gram_of_bodies(blocks))
        sources = [self.unknowns.columns[self._base.kept], np.full(2 * nv + 1, -1)]
        sources += [data.effect_columns(effect) for effect in self._reversals]
        self.first_term = sum(map(len, sources))
        self._first_columns = np.arange(self.first_term)
        self._first_reversal = len(sources[0]) + len(sources[1])
        spans = self.spans(self.terms).items()
        self.at = {term: np.arange(span.start, span.stop) for term, span in spans}
        self.order = {term: k for k, term in enumerate(self.terms)}
        columns = np.concatenate([*sources, *(term.columns for term in self.terms)])
        self.mean = np.zeros(len(columns))
        self._inertias = data.passive_shares(columns)
        # Terms may share columns and differ in their priors, such as the payloads of a body.
        distinct = np.where(columns >= 0, columns, -1 - np.arange(len(columns)))
        _, first, which = np.unique(distinct, return_index=True, return_inverse=True)
        self.distinct, self.same_as = np.sort(first), np.argsort(np.argsort(first))[which]
        # Priors of the terms: rows of Λ from a term's first column on, rows of Λm, and
        # log |Λ| − mᵀΛm at a term's first column.
        widest = max((len(at) for at in self.at.values()), default=1)
        self.information, self.pull = np.zeros((len(columns), widest)), np.zeros(len(columns))
        self.prior_scores = np.zeros(len(columns))
        self._offsets = np.zeros(len(columns), np.intp)  # from a term's first column
        self.positive = np.zeros(len(columns), bool)
        for term, at in self.at.items():
            self.information[at, : len(at)] = term.information
            self.mean[at], self.pull[at] = term.mean, term.information @ term.mean
            self.prior_scores[at[0]] = term.log_information - term.prior_distance
            self._offsets[at] = np.arange(len(at))
            self.positive[at[term.positive]] = True
        rates, unsure_delay = self._rates()
        places = self._places(columns, rates)  # in the rows of each joint
        self.joint_of = np.array([j for j, _, _ in blocks])
        self._reversing = {j: nv + k for k, j in enumerate(self.joint_of[nv:].tolist())}
        self.block_rows = np.array([max(rows, 1) for _, rows, _ in blocks], float)
        self._store(blocks)
        self.only_joint = {
            term: self._only_joint(term, places[:, at]) for term, at in self.at.items()
        }
        self._groups = self._groups_of(places)
        self.places, self._inertias = places[self.joint_of], self._inertias[self.joint_of]
        self._ends = np.array([len(joint.columns) for joint in data.data])
        lags = self._ends[self.joint_of, None] + np.arange(len(data.delays))
        self._powers = self._entries(lags.T, lags.T).T  # bᵀb by delay
        # The columns before those of terms, which all fits share.
        first = self.places[:, : self.first_term].copy()
        self._common = calc_packed(self.grams, first, empty_packed(len(blocks)))
        self.mean[: len(self._base.mean)] = self._base.mean
        gains = np.maximum(data.gain_uncertainty, 1e-6) ** -2.0
        unsure = [
            (self.beliefs.reversal * data.effort_std[data.joints.index(effect.joint)]) ** -2.0
            for effect in self._reversals
            for _ in effect.parameters
        ]
        nuisances = np.concatenate([gains, np.full(nv + 1, unsure_delay**-2.0), unsure])
        self.information[len(self._base.mean) : self.first_term, 0] = nuisances

    def _store(self, blocks: Sequence[tuple[int, int, Array]]) -> None:
        """Store the normal matrices of blocks one after another.

        Behind the columns and efforts of a joint they have its load, the rate of its effort, and
        a column of zeros, which places of −1 mean.
        """
        widths = np.array([len(self._mixed[j]) + 3 for j in self.joint_of.tolist()])
        ends = np.cumsum(widths**2)
        self.grams = np.zeros(ends[-1]), ends - widths**2, widths
        self._matrices = [
            self.grams[0][end - width**2 : end].reshape(width, width)
            for end, width in zip(ends.tolist(), widths.tolist(), strict=True)
        ]
        for block, (j, _, gram) in zip(self._matrices, blocks, strict=True):
            n, mixed = len(gram), self._mixed[j]
            block[:n, :n] = gram
            block[:n, n : n + 2] = gram @ mixed
            block[n : n + 2, :n] = block[:n, n : n + 2].T
            block[n : n + 2, n : n + 2] = mixed.T @ block[:n, n : n + 2]

    def _gram_of_bodies(self, blocks: Sequence[tuple[int, int, Array]]) -> Array:
        """Return the normal matrix of the columns of bodies, relative to the efforts."""
        data, columns = self.dataset, np.arange(self._bodies)
        gram = np.zeros((self._bodies,) * 2)
        for j, _, own_gram in blocks:
            own = columns[data.data[j].local(columns) >= 0]
            weight = 1.0 / (self.rows[j] * max(data.effort_std[j], 1e-12) ** 2)
            gram[np.ix_(own, own)] += weight * own_gram[: len(own), : len(own)]
        inertias = data.passive_shares(columns)  # depend on the same combinations
        return np.asarray(gram + inertias.T @ inertias)

    @staticmethod
    def _only_joint(term: Term, places: Indices) -> int:
        """Return the only joint that a term affects; −1 for bodies, or if it affects several.

        `places` (nv, k) are the indices of its columns in those of each joint, −1 if absent.
        """
        felt = np.flatnonzero((places >= 0).any(axis=1))
        is_single = len(felt) == 1 and term.effect is not None and not term.is_body
        return int(felt[0]) if is_single else -1

    def _groups_of(self, places: Indices) -> Indices:
        """Return the only joint each column (n,) affects; −1 for model and shared columns.

        Columns of a free base's joint count as shared, as they have products with all bodies; so do
        columns of payloads.
        """
        felt = places >= 0
        groups = np.where(felt.sum(axis=0) == 1, felt.argmax(axis=0), -1)
        groups[: len(self._base.kept)] = -1
        for term, at in self.at.items():
            groups[at] = -1 if term.is_whole else self.only_joint[term]
        base = [self.model.joints.index(joint) for joint in self.model.base_joints]
        return np.where(np.isin(groups, base), -1, groups)

    def _places(self, columns: Indices, rates: Array) -> Indices:
        """Return the indices (nv, n) of columns (n,) in those of each joint, −1 if absent.

        Columns for errors of gains (by the loads) and of delays (by effort `rates` (K, nv)) follow
        a joint's own columns and efforts.
        """
        p, nv, first = len(self._base.kept), len(self.dataset.joints), self._bodies
        loads = self.unknowns.mean[:first] if self.loads is None else self.loads.ravel()
        values = np.concatenate([loads, self.unknowns.mean[first:]])
        places, self._mixed, real = np.full((nv, len(columns)), -1), list[Array](), columns >= 0
        for j, joint in enumerate(self.dataset.data):
            local, n = joint.local(self.unknowns.columns), joint.factors.shape[2]
            mixed = np.zeros((n, 2))
            mixed[local[local >= 0], 0] = values[local >= 0]
            mixed[len(joint.columns) :, 1] = rates[:, j]
            self._mixed.append(mixed)
            places[j, real] = joint.local(columns[real])
            places[j, p + np.array([j, nv, nv + 1 + j])] = n, n + 1, n + 1
        return places

    def _blocks(self) -> list[tuple[int, int, Array]]:
        """Return joint, row count and normal matrix of each block: joints, then reversals."""
        data = self.dataset
        blocks = [(j, int(self.rows[j]), joint.gram) for j, joint in enumerate(data.data)]
        for j, (name, joint) in enumerate(zip(data.joints, data.data, strict=True)):
            rows = _rows(joint)
            kept = sum(len(each.b) for each in rows)
            if name not in self._unsure or data.is_mixed or kept != joint.samples.sum():
                continue  # long logs keep only some rows
            turns = self._turns[j]
            count = int(sum(map(np.sum, turns)))
            if not count or kept - count < _FEWEST_OTHERS * kept:
                continue
            pairs = zip(rows, turns, strict=True)
            both = np.concatenate([np.hstack([each.A[own], each.b[own]]) for each, own in pairs])
            gram = both.T @ both
            blocks[j] = j, kept - count, blocks[j][2] - gram
            blocks.append((j, count, gram))
        return blocks

    def _unsure_column(self, effect: UnresolvedReversal) -> int:
        """Return the column of a joint's rows with the share of time of unknown direction."""
        joint = self.dataset.data[self.dataset.joints.index(effect.joint)]
        return int(joint.local(self.dataset.effect_columns(effect))[effect.unsure])

    def reverses(self, joint: int, rows: JointRows) -> NDArray[np.bool_]:
        """Return (K,) whether a joint's direction is unknown for a significant part of each row.

        The part is significant if dry friction as large as the efforts would differ by more than
        the noise.
        """
        at, data = self._unsure.get(self.dataset.joints[joint]), self.dataset
        if at is None:
            return np.zeros(len(rows.b), bool)
        noise, scale = data.noise_floor[joint], data.effort_std[joint]
        share = np.clip(noise / scale, *_REVERSING) if 0.0 < noise < scale else _REVERSING[1]
        return np.asarray(np.abs(rows.A[:, at]) > share)  # negative where the filter rings

    @cached_property
    def _turns(self) -> list[list[NDArray[np.bool_]]]:
        """Return for each joint and stretch of its rows in which rows it reverses."""
        joints = enumerate(self.dataset.data)
        return [[self.reverses(j, rows) for rows in _rows(own)] for j, own in joints]

    def row_weights(self, fit: Fit, joint: int) -> list[Array]:
        """Return the weights (K_i,) of a joint's squared residuals in each stretch of rows."""
        turning = fit.weights[self._reversing.get(joint, joint)]
        return [np.where(turns, turning, fit.weights[joint]) for turns in self._turns[joint]]

    def hessian(self, fit: Fit, *, uniform_noise: bool = False) -> Array:
        """Return Λ + Σ_k w_k A_kᵀA_k (n, n) of a fit.

        If `uniform_noise`, reversals have the same noise as other rows.
        """
        weights = fit.weights[self.joint_of] if uniform_noise else fit.weights
        packed = calc_packed(self.grams, self.places.take(fit.columns, axis=1), self._common)
        hessian = prior_matrix(fit.prior)
        add_normal(packed, weights, hessian)
        return hessian

    def with_sensor_noise(self, fit: Fit) -> Fit:
        """Return an explanation refitted with no more than sensor noise at each joint."""
        floor = np.maximum(np.square(self.dataset.noise_floor), self.floor)[self.joint_of]
        noise = np.minimum(fit.noise, floor)
        weights, (prior, _) = fit.weights * fit.noise / noise, self.prior(fit.choice)
        fit = replace(fit, noise=noise, weights=weights, prior=prior)
        factor, scale = scaled_cholesky(self.hessian(fit), RIDGE)
        right = prior[-1] + weights @ self.moments(fit.columns, fit.choice.delay)[0]
        return replace(fit, x=scale * solved(factor, scale * right))

    def sum_by_joint(self, values: Array) -> Array:
        """Return the sums (nv,) of block values (B,) over the blocks of each joint."""
        return np.bincount(self.joint_of, values, len(self.rows)).astype(float)

    def noise_without_reversals(self, fit: Fit) -> Array:
        """Return the residual variances (nv,) without terms of unresolved reversals.

        Residuals exclude the errors of effort gains.
        """
        x = fit.x.copy()
        x[self._first_reversal : self.first_term] = 0.0
        squares = calc_squares(self.normal(fit.columns, fit.choice.delay), x)
        return self.sum_by_joint(squares) / np.maximum(self.sum_by_joint(self.block_rows), 1.0)

    def _rates(self) -> tuple[Array, float]:
        """Return weights (K, nv), 1/s, that turn efforts at all delays into rates; a deviation.

        The deviation, s, is that of a fitted delay, or of one too short to be tried. The errors of
        inexact delays would otherwise look like effects.
        """
        delays = self.dataset.delays  # relative to the efforts as advanced
        weights, differences = np.zeros(delays.shape), np.abs(delays[np.abs(delays) > _ON_TIME])
        if not len(differences):
            return weights, _ON_TIME
        for j, lags in enumerate(delays.T):
            after, before = lags > _ON_TIME, lags < -_ON_TIME
            if after.any() and before.any():
                ends = [
                    np.argmin(np.where(after, lags, np.inf)),
                    np.argmax(np.where(before, lags, -np.inf)),
                ]
                weights[ends, j] = np.array([1.0, -1.0]) / (lags[ends[0]] - lags[ends[1]])
        share = _UNSURE_DELAY if any(self.on_time) else _ASYNCHRONOUS
        return weights, share * float(differences.min())

    @property
    def delay_errors(self) -> Indices:
        """Return the indices (nv + 1,) of delay errors in a fit: common, then each joint's."""
        first, nv = len(self._base.kept), len(self.dataset.joints)
        return np.arange(first + nv, first + 2 * nv + 1)

    def spans(self, terms: Terms) -> dict[Term, slice]:
        """Return the slices of the terms' parameters in a fit with these terms in this order."""
        ends = np.cumsum([self.first_term, *(len(term.columns) for term in terms)]).tolist()
        return {t: slice(*ends) for t, ends in zip(terms, pairwise(ends), strict=True)}

    @cached_property
    def term_spans(self) -> tuple[Indices, Indices, Indices]:
        """Return the first columns (T,) of all terms, their ends (T,), and their only joints (T,).

        A joint is −1 if a term affects several.
        """
        spans = self.spans(self.terms).values()
        first, ends = (np.array([getattr(s, name) for s in spans]) for name in ("start", "stop"))
        return first, ends, np.array([self.only_joint[term] for term in self.terms], np.intp)

    def prior(self, choice: Choice) -> tuple[Prior, float]:
        """Return the prior of an explanation, and log |Λ| up to a constant."""
        columns, base, width = self.columns(choice), self._base, choice.width
        if width not in self._base_priors:
            scale = base.scales(width / self._spread)
            information = base.information / scale[:, None] / scale
            self._base_priors[width] = information, information @ base.mean
        information, base_pull = self._base_priors[width]
        first, pull = np.arange(len(columns)) - self._offsets[columns], self.pull[columns]
        pull[: len(base_pull)] = base_pull
        logarithm = base.log_volume - 2.0 * base.bodies * np.log(width)
        logarithm += sum(term.log_information for term in choice.terms)
        return (information, self.information[columns], first, pull), float(logarithm)

    def columns(self, choice: Choice) -> Indices:
        """Return the columns (n,) of an explanation."""
        return np.concatenate([self._first_columns, *(self.at[term] for term in choice.terms)])

    @property
    def _spread(self) -> float:
        """Return the prior width of the model's bodies in `unknowns`."""
        return SPREAD if self.model.information is None else 1.0

    def odds_against(self, choice: Choice) -> float:
        """Return twice the log prior odds against an explanation."""
        key = choice.width, choice.delay
        if key not in self._other_odds:
            self._other_odds[key] = self._odds_of_coordinates(choice)
        prices = tuple(sorted([self._prices[term] for term in choice.terms]))
        if prices not in self._odds:
            self._odds[prices] = odds_against(choice.terms)
        return self._odds[prices] + self._other_odds[key]

    def _odds_of_coordinates(self, choice: Choice) -> float:
        """Return twice the log prior odds against the width and delays of an explanation."""
        beliefs, total = self.beliefs, 0.0
        delays = self._found_delays + self._seconds(choice.delay)
        differs = np.abs(delays) > _ON_TIME
        if differs.any():
            total += 2.0 * np.log(beliefs.delays)
            if np.ptp(delays) > _ON_TIME:
                total += 2.0 * int(differs.sum()) * np.log(beliefs.again * beliefs.shape)
        # Prefer the narrower of widths that explain the data equally well.
        total += 2.0 * np.log1p(_SIMPLER * np.searchsorted(self.widths, choice.width))
        if choice.width > self.wrong_beyond:
            total += 6.0 * np.log(beliefs.rarer)
        return float(total)

    @property
    def wrong_beyond(self) -> float:
        """Return the largest width at which the model's bodies do not count as wrong."""
        return self.beliefs.wrong if self.model.information is None else 1.0

    def lateness(self, choice: Choice) -> Array:
        """Return the delays (nv,) of an explanation relative to the model's, s."""
        return self._seconds(choice.delay) - self._seconds(self.on_time)

    def delays_differ(self, delay: Delay, other: Delay) -> bool:
        """Return whether two tuples of delay indices mean different delays."""
        return bool(np.any(np.abs(self._seconds(delay) - self._seconds(other)) > _ON_TIME))

    def _seconds(self, delay: Delay) -> Array:
        """Return the delays (nv,) at some indices, relative to the dataset's model, s."""
        return np.asarray(self.dataset.delays[list(delay), np.arange(len(delay))])

    def are_compatible(self, terms: Terms) -> bool:
        """Return whether terms can be in one explanation, given the effects of the model."""
        return self.compatibility.holds(terms)

    # Fits.

    def choice(self, was: Choice, terms: Iterable[Term], **changed: Any) -> Choice:
        """Return an explanation with other terms, in the order of their columns."""
        terms = tuple(sorted(terms, key=self.order.__getitem__))
        return replace(was, terms=terms, **changed)

    def matching(self, terms: Terms, moved: Mapping[Effect, Effect] | None = None) -> list[Term]:
        """Return the terms that match those of another model, with effects replaced by `moved`.

        A payload matches the term of its effect with the closest prior.
        """
        candidates, matches, replaced = dict[object, list[Term]](), list[Term](), moved or {}
        for term in self.terms:
            candidates.setdefault(term.effect or term.where, []).append(term)
        for other in terms:
            effect = replaced.get(other.effect, other.effect) if other.effect else other.where
            same = candidates.get(effect, [])
            size = other.log_information
            matches += sorted(same, key=lambda t: abs(t.log_information - size))[:1]
        return matches

    def fit(
        self, choice: Choice, shares: Array, noise: Array | None = None, *, is_timed: bool = False
    ) -> Fit | None:
        """Fit the most probable parameters and noise of an explanation.

        `shares` (nv,) are effective samples per row, and `noise` (B,) or (nv,) is the initial
        variance. If `is_timed`, delays are exact. Return None if parameters would violate their
        bounds.
        """
        prior, logarithm = self.prior(choice)
        if is_timed:
            prior[1][self.delay_errors, 0] = _ON_TIME**-2.0
        spans = self.spans(choice.terms).items()
        bounded = [(s.start + t.positive, t.least) for t, s in spans if len(t.positive)]
        free = np.ones(len(prior[-1]), bool)
        for _ in range(_MOST_PINNED):
            solution = self._solved(choice, shares, noise, (prior, logarithm))
            violated = [at[free[at] & (solution.x[at] <= least)] for at, least in bounded]
            below = np.concatenate([np.zeros(0, np.intp), *violated])
            if not len(below):
                return solution
            free[below] = False
            if any(not free[at].any() for at, _ in bounded):
                return None  # a term has no free parameter left
            noise = solution.noise
            # Pin parameters of a term at zero, and compensate the evidence.
            columns = self.columns(choice)[below]
            own = below, self._offsets[columns]
            logarithm += float(np.log1p(_PINNED / prior[1][own]).sum())
            prior[1][own] += _PINNED
            prior[-1][below] += _PINNED * self.mean[columns]
        return None

    def lead(self, other: Fit, fit: Fit, shares: Array) -> float:
        """Return the score of another fit relative to `fit`, at the same `shares` (nv,).

        Delay errors average noise away, which favours small delays. A delay must therefore also be
        more probable if it is exact.
        """
        gain, delays = other.score - fit.score, (other.choice.delay, fit.choice.delay)
        if not self.delays_differ(*delays):
            return gain
        ahead, behind = (self.fit(f.choice, shares, f.noise, is_timed=True) for f in (other, fit))
        if behind is None or ahead is None:
            return gain
        exact = ahead.score - behind.score
        is_late, was_late = (self.delays_differ(delay, self.on_time) for delay in delays)
        if not was_late:
            return min(gain, exact)
        return exact if is_late else max(gain, exact)

    def ranked(self, choices: Iterable[Choice], shares: Array, variance: Array) -> list[Fit]:
        """Return fits of explanations that satisfy their bounds, the most probable first."""
        fits = [self.fit(choice, shares, variance) for choice in choices]
        return sorted((fit for fit in fits if fit is not None), key=lambda fit: -fit.score)

    def unbounded(self, choice: Choice, shares: Array, noise: Array | None = None) -> Fit:
        """Fit an explanation without bounds."""
        return self._solved(choice, shares, noise, self.prior(choice))

    def without_terms(self, shares: Array) -> Fit:
        """Return the fit without terms, with the most probable prior width of bodies."""
        fits = [self.unbounded(Choice((), w, self.on_time), shares) for w in self.widths]
        return max(fits, key=lambda fit: fit.score)

    def _solved(
        self, choice: Choice, shares: Array, noise: Array | None, known: tuple[Prior, float]
    ) -> Fit:
        """Return the fit with a known prior and log |Λ|, without bounds."""
        (prior, logarithm), columns, joint_of = known, self.columns(choice), self.joint_of
        mean, inertias = self.mean[columns], self._inertias.take(columns, axis=1)
        blocks, samples = self.normal(columns, choice.delay), shares[joint_of] * self.block_rows
        if noise is None:
            passive, scale = inertias.any(axis=1), self.dataset.effort_std[joint_of]
            noise = np.where(passive, scale**2, blocks[-1] / self.block_rows)
        elif len(noise) != len(joint_of):  # the noise of another model
            noise = noise[: len(shares)][joint_of]
        noise_args = samples, self.block_rows, self.floor[joint_of]
        joints = inertias, joint_of, self._groups[columns]
        try:
            x, noise, rest = calc_most_probable(blocks, prior, noise_args, joints, noise)
        except np.linalg.LinAlgError as error:
            raise singular_error() from error
        weights, inertia, factor, determinant = rest
        if not np.isfinite(determinant):
            raise singular_error()
        score = (
            -float(samples @ np.log(noise / inertia**2))
            - prior_distance(prior, x - mean)
            - determinant
            + logarithm
            + self._physical(choice, x, factor, joints[-1])
            - self.odds_against(choice)
        )
        return Fit(choice, columns, x, noise, weights, prior, score)

    def likely_priors(self, fit: Fit) -> tuple[float, dict[Effect, tuple[Array, Array]]]:
        """Return the width of the prior of bodies, and the prior of each payload.

        The prior of a payload is a mean (10,) and an information (10, 10). Priors are averaged over
        widths and payload masses by probability. The least width is 1 %, or that of an earlier fit
        of the model.
        """
        least = _LEAST_WIDTH if self.model.information is None else self.widths[0]
        shares, widths = self.shares(fit), np.geomspace(least, self.widths[-1], _WIDTHS)
        loads = [term.effect for term in fit.terms if term.effect is not None and term.is_whole]
        rest = [term for term in fit.terms if not term.is_whole]
        masses = [[term for term in self.terms if term.effect == load] for load in loads]
        grid = list(product(widths.tolist(), *masses))
        choices = [self.choice(fit.choice, [*rest, *held], width=w) for w, *held in grid]
        fits = [self.unbounded(choice, shares, fit.noise) for choice in choices]
        coordinates = [replace(fit.choice, terms=(), width=w) for w, *_ in grid]
        scores = np.array([f.score for f in fits])
        scores += [self.odds_against(each) for each in coordinates]  # equal odds for all widths
        weights = np.exp(0.5 * (scores - scores.max()))
        weights /= weights.sum()
        priors = dict[Effect, tuple[Array, Array]]()
        for k, load in enumerate(loads):
            means = np.array([held[k].mean for _, *held in grid])
            covariances = np.array([np.linalg.inv(held[k].information) for _, *held in grid])
            spread = means - weights @ means
            covariance = np.tensordot(weights, covariances, 1) + (weights * spread.T) @ spread
            priors[load] = weights @ means, np.linalg.inv(covariance)
        return float(np.sqrt(weights @ [w**2 for w, *_ in grid])), priors

    def refitted(self, fit: Fit, moved: Mapping[Effect, Effect] | None = None) -> Fit:
        """Return another model's explanation fitted with this model's terms, without bounds.

        `moved` maps replaced effects to new ones.
        """
        choice = self.choice(fit.choice, self.matching(fit.terms, moved))
        return self.unbounded(choice, np.full(len(self.rows), _USUAL_SHARE), fit.noise)

    def _physical(self, choice: Choice, x: Array, factor: Array, groups: Indices) -> float:
        """Return twice the log probability that payloads and wrong bodies are physical.

        `factor` is the Cholesky factor (S, S) of the Hessian of shared parameters, those without
        `groups` (n,), after the others are eliminated.
        """
        total, width = 0.0, choice.width / self._spread
        base, place = self._base, np.cumsum(groups < 0) - 1
        for term, at in self.spans(choice.terms).items():
            if not (term.is_whole or term.effect is None):
                continue
            # L⁻¹ is lower triangular, so that the last columns cost little.
            first, mean, usual = place[at.start], x[at], term.mean
            body, rest = 0, np.zeros((0, len(mean)))
            if term.effect is None:
                body = self.dataset.bodies.index(term.where[0])
                span = slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1))
                own = base.all_of(x[: len(base.kept)], width)[span]
                first, mean, usual = 0, mean + own, self.unknowns.mean[span]
                rest = base.rest_root(body, width)
            columns = np.zeros((len(factor) - first, len(mean)))
            columns[place[at] - first] = np.eye(len(mean))
            if term.effect is None:
                slopes = base.slopes_of_body(body, width)
                columns[: len(base.kept)] += slopes.T
            root, _ = dtrtrs(factor[first:, first:], columns, lower=1)
            root = np.concatenate([root, rest])
            scale = np.sqrt(np.square(root).sum(axis=0))
            correlations = (root / scale).T @ (root / scale) + 1e-9 * np.eye(len(scale))
            draws = _DRAWS @ np.linalg.cholesky(correlations).T
            share = calc_physical_share(mean + scale * draws, _PSEUDO)
            if share > 0.0:
                total += 2.0 * np.log(share)
            else:  # use the distance to the nearest physical body
                basis = scale[:, None, None] * _PSEUDO
                bodies = mean / scale, usual / scale
                distance = calc_distance(*bodies, np.linalg.inv(correlations), basis)
                total -= np.clip(distance, 2.0 * np.log(2.0 * len(_DRAWS)), _FARTHEST)
        return total

    def efforts(self, delay: Delay) -> Indices:
        """Return the indices (B,) of the efforts, shifted by a delay, in each block's matrix."""
        return np.asarray(self._ends + np.array(delay))[self.joint_of]

    def normal(self, columns: Indices, delay: Delay) -> Normal:
        """Return the blocks' normal matrices over columns (n,), efforts shifted by a delay.

        The first columns must be those before the terms'.
        """
        packed = calc_packed(self.grams, self.places.take(columns, axis=1), self._common)
        return packed, *self.moments(columns, delay)

    def moments(self, columns: Indices, delay: Delay) -> tuple[Array, Array]:
        """Return Aᵀb (B, n) and bᵀb (B,), with efforts shifted by a delay."""
        efforts = self.efforts(delay)
        own = self._entries(efforts, self.places.take(columns, axis=1).T)  # −1 is the column of 0
        return np.ascontiguousarray(own.T), self._entries(efforts, efforts)

    def _entries(self, rows: Indices, columns: Indices) -> Array:
        """Return entries (…, B) of the blocks' normal matrices."""
        entries, starts, widths = self.grams
        return np.asarray(entries.take(starts + widths * rows + columns % widths))

    def shares(self, fit: Fit) -> Array:
        """Return the effective samples per row (nv,) of a fit's residuals."""
        key = fit.choice.key
        if key not in self._shares:
            data, blocks = self.dataset, list[list[Array]]()
            for j in range(len(data.data)):
                pairs = zip(self.row_weights(fit, j), self._residuals(fit, j), strict=True)
                blocks.append([np.sqrt(w / fit.weights[j]) * residual for w, residual in pairs])
            effective = effective_of_rows(blocks, self.rows)
            repeated = np.minimum(effective, self.beliefs.discrepancy)
            # Errors beyond the noise of efforts vary with the motion, and repeat with it. So
            # does the noise of a base's accelerations, which is in the columns.
            moving = np.square(self.dataset.motion_noise)
            noise = np.square(self.dataset.noise_floor) - moving
            excess = np.maximum(1.0 - noise / fit.variance, moving / fit.variance)
            excess = np.clip(excess, 0.0, 1.0)
            samples = 1.0 / ((1.0 - excess) / effective + excess / repeated)
            self._shares[key] = np.clip(samples / self.rows, _LEAST_SHARE, 1.0)
        return self._shares[key]

    def forget_shares(self, fit: Fit) -> None:
        """Forget the shares of fits of the same explanation, whose weights may have been others."""
        self._shares.pop(fit.choice.key, None)

    def level_noise(self, fit: Fit) -> None:
        """Prevent other delays than a fit's from gaining by smaller noise at their instants.

        The filtered noise of efforts that are shifted by a few milliseconds may be smaller by
        chance, which is no evidence of a delay.
        """
        if len(self.dataset.delays) < 2 or self.dataset.is_mixed:
            return
        for block, j in enumerate(self.joint_of.tolist()):
            index, lags = fit.choice.delay[j], self.dataset.delays[:, j]
            rows, residuals = _rows(self.dataset.data[j]), self._residuals(fit, j)
            if sum(map(len, residuals)) < 2:
                continue
            time, efforts = (np.concatenate([getattr(r, f) for r in rows]) for f in ("time", "b"))
            predicted = efforts[:, index] - np.concatenate(residuals)
            turns = np.concatenate(self._turns[j])
            counted = turns == (block >= len(self.rows)) if j in self._reversing else turns | True
            counted_rows, period = np.flatnonzero(counted), float(np.median(np.diff(time)))
            squares = np.square(efforts - predicted[:, None])
            signals = time, predicted, contiguous(efforts), contiguous(squares)
            change = calc_noise_changes(signals, counted_rows, index, lags - lags[index], period)
            at = self._ends[j] + np.arange(len(change))
            scale = self.block_rows[block] / counted.sum()
            self._matrices[block][at, at] = self._powers[block] - change * scale

    def _residuals(self, fit: Fit, joint: int) -> list[Array]:
        """Return the residuals (K_i,) of a joint in each stretch of its rows."""
        data, delay = self.dataset.data[joint], fit.choice.delay[joint]
        x, mixed = np.zeros(len(self._matrices[joint])), self._mixed[joint]
        np.add.at(x, self.places[joint][fit.columns], -fit.x)
        weights = x[: len(mixed)] + mixed @ x[len(mixed) : len(mixed) + 2]
        weights[len(data.columns) + delay] += 1.0
        return [rows.joined @ weights for rows in _rows(data)]

    def usual_gains(self, fit: Fit) -> dict[str, tuple[float, float]]:
        """Return errors of gains that explain most of the error that would remain at their joints.

        The result is joint -> the error, and the gain's deviation stated by the log, both relative.
        """
        blocks, gains = self.normal(fit.columns, fit.choice.delay), dict[str, tuple[float, float]]()
        errors = self.sum_by_joint(fit.noise * self.block_rows)
        for j, joint in enumerate(self.dataset.joints):
            at, x = len(self._base.kept) + j, fit.x.copy()
            x[at] = 0.0
            if self.sum_by_joint(calc_squares(blocks, x))[j] * _NOTABLE > errors[j]:
                gains[joint] = float(fit.x[at]), float(self.dataset.gain_uncertainty[j])
        return gains

    def gain_moments(self, fit: Fit) -> Array:
        """Return the second moments (nv, nv) of the gains' errors in the posterior."""
        first = len(self._base.kept)
        at = np.arange(first, first + len(self.rows))
        factor, scale = scaled_cholesky(self.hessian(fit), RIDGE)
        covariance = solved(factor, np.eye(len(scale))[:, at])[at]
        return covariance * scale[at, None] * scale[at] + np.outer(fit.x[at], fit.x[at])

    def parameters(self, fit: Fit, term: Term) -> Array:
        """Return the parameters (k,) of a term of a fit."""
        return fit.x[self.spans(fit.terms)[term]]

    def row_columns(self, fit: Fit, joint: int, A: Array, b: Array) -> tuple[Array, Array]:
        """Return a fit's columns (…, n) and efforts (…) in rows of a joint.

        A (…, p) contains the joint's columns, and b (…, d) its efforts at each delay.
        """
        joined = np.concatenate([A, b], axis=-1)
        zeros = np.zeros((*joined.shape[:-1], 1))
        extended = np.concatenate([joined, joined @ self._mixed[joint], zeros], axis=-1)
        return extended[..., self.places[joint][fit.columns]], b[..., fit.choice.delay[joint]]

    def _values(self, fit: Fit) -> Array:
        """Return the most probable values (p,) of all unknowns of the model."""
        x = fit.x[: len(self._base.kept)]
        return self._base.all_of(x, fit.choice.width / self._spread)

    def bodies(self, fit: Fit) -> Array:
        """Return the bodies (nb, 10) of a fit, including wrong ones, without payloads."""
        phi = self._values(fit)[: self._bodies].reshape(-1, PARAMETERS_PER_BODY)
        for term in fit.terms:
            if term.effect is None:
                phi[self.dataset.bodies.index(term.where[0])] += self.parameters(fit, term)
        return phi

    # Cross-validation.

    def unknowns_of(self, choice: Choice) -> Unknowns:
        """Return the unknowns of an explanation with their prior, without nuisances."""
        unknowns = self.unknowns.loosened(choice.width / self._spread, self._bodies)
        wrong = [term for term in choice.terms if term.effect is None]
        if wrong:
            covariance = np.linalg.inv(unknowns.information)  # effects may correlate with bodies
            for term in wrong:
                at = np.ix_(term.columns, term.columns)
                covariance[at] += np.linalg.inv(term.information)
            unknowns = replace(unknowns, information=np.linalg.inv(covariance))
        for term in choice.terms:
            if term.effect in unknowns.effects:
                unknowns = unknowns.released(term.effect, term.information)
            elif term.effect is not None:
                unknowns = unknowns.with_effect(
                    term.effect, term.columns, term.information, term.mean
                )
        return unknowns

    def hypothesis(self, fit: Fit) -> Hypothesis:
        """Return a fit as a hypothesis with the same parameters in all folds."""
        unknowns, data, choice = self.unknowns_of(fit.choice), self.dataset, fit.choice
        first = self._first_reversal
        for effect in self._reversals:
            known = self.information[first : first + len(effect.parameters), 0]
            unknowns = unknowns.with_effect(effect, data.effect_columns(effect), np.diag(known))
            first += len(effect.parameters)
        x, p = np.zeros(len(unknowns.columns)), len(self.unknowns.columns)
        x[:p] = self._values(fit)
        x[: self._bodies] = self.bodies(fit).ravel()
        for term, span in self.spans(fit.terms).items():
            if term.effect is not None:
                x[unknowns.span(term.effect)] += fit.x[span]
        unsure = fit.x[self._first_reversal : self.first_term]
        x[len(x) - len(unsure) :] = unsure
        held_out = hold_out(
            data, unknowns.columns, np.tile(x, (len(data.folds), 1)), delay=choice.delay
        )
        return self._hypothesis(choice, unknowns, fit, held_out)

    def held_out(self, fit: Fit) -> HeldOut:
        """Return the errors in each fold of a fit to all other folds, including errors of gains."""
        data, weights = self.dataset, fit.weights[: len(self.rows), None, None]
        systems = [
            self.row_columns(fit, j, *np.split(own.factors, [len(own.columns)], axis=2))
            for j, own in enumerate(data.data)
        ]
        weighted = [w * np.swapaxes(A, 1, 2) for w, (A, _) in zip(weights, systems, strict=True)]
        pairs = [*zip(weighted, systems, strict=True)]
        # np.sum would need all products at once.
        gram = sum((own @ A for own, (A, _) in pairs), np.zeros(()))
        rhs = np.sum([(own @ b[..., None])[..., 0] for own, (_, b) in pairs], axis=0)
        moments, _ = self.moments(fit.columns, fit.choice.delay)
        prior = self.hessian(fit) @ fit.x - fit.weights @ moments
        factor, scale = scaled_cholesky(self.hessian(fit, uniform_noise=True) - gram)
        rhs = prior + rhs.sum(axis=0) - rhs
        x = np.array([s * solved(L, s * b) for L, s, b in zip(factor, scale, rhs, strict=True)])
        sse = [np.square(b - (A @ x[..., None])[..., 0]).sum(axis=1) for A, b in systems]
        inertias = inertias_of(self._inertias[: len(systems)].take(fit.columns, axis=1), x)
        return HeldOut(np.transpose(sse / inertias**2), data.samples, x)

    def validated(self, fit: Fit, *, physical: bool = True) -> Hypothesis:
        """Return the cross-validated hypothesis of a fit, with its noise and physical bodies."""
        unknowns = self.unknowns_of(fit.choice)
        return self._hypothesis(fit.choice, unknowns, fit, None, physical=physical)

    def _hypothesis(
        self,
        choice: Choice,
        unknowns: Unknowns,
        fit: Fit,
        held_out: HeldOut | None,
        *,
        physical: bool = True,
    ) -> Hypothesis:
        effective, weights = self.shares(fit) * self.rows, fit.weights[: len(self.rows)]
        # Only bodies and payloads have inertia.
        x = np.zeros(len(unknowns.columns))
        x[: self._bodies] = self.bodies(fit).ravel()
        for term, span in self.spans(fit.terms).items():
            if term.is_whole and term.effect is not None:
                x[unknowns.span(term.effect)] = fit.x[span]
        unknowns = unknowns.pulled(self.dataset, x, effective)
        cv = CrossValidation(
            self.dataset,
            unknowns,
            weights,
            delay=choice.delay,
            held_out=held_out,
            physical=physical,
        )
        prior_scale = choice.width / self._spread
        return Hypothesis(self.dataset, unknowns, weights, choice.delay, prior_scale, cv, effective)


def _rows(data: JointData) -> list[JointRows]:
    return [rows for blocks in data.rows for rows in blocks]
