"""Estimate servo gains from the motion: simulate each joint under its commands.

Inverse dynamics hardly reveals a stiff servo: the joint follows its command so closely that
stiffness times lag, damping and delay all look like friction. The motion reveals it. Each joint is
therefore simulated alone, while all others follow their measured motion (`servo_motion`). The
parameters minimize Σ (x − q)² by Levenberg–Marquardt from a linear fit on; data-sheet values and a
usual delay act as priors.

A fit is accepted only if it predicts held-out windows better than its starting point. So is each of

- an integral: its state at the start of a stretch, an effort w, is unknown. It must predict better
  than a constant w alone, and be significant in the final fit.
- saturation, at the model's effort limit or at a fitted one; the integral then stops. A share of
  the damping d is the servo's and saturates too. Only a servo at its limit tells it from the rest.
- load-dependent friction, and a dead band, which must halve the error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.bounded_descent import bounded_least_squares
from geodrake.identification.logs.criteria import PENALTY, WORTH
from geodrake.identification.logs.effort_gains import ALIKE
from geodrake.identification.logs.joint_motions import LONGEST_DELAY, JointMotions
from geodrake.identification.logs.servo_motion import (
    ARMATURE,
    BEGUN,
    COULOMB,
    DAMPING,
    DEAD_BAND,
    DELAY,
    INTEGRAL,
    LIMIT,
    LOAD,
    OFFSET,
    PARAMETERS,
    RATE,
    SHARE,
)
from geodrake.model.effort_signal import EffortSignal

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

USUAL_DELAY = 0.01
"""Mean delay of commands, s."""

USUAL_PERIOD = 1e-3
"""Typical control period of a servo, s, by which its feedback is delayed.

The damping and the inertia compensate this delay exactly, so that no motion reveals it.
"""

_PLACES = {name: at for at, name in enumerate((*PARAMETERS, "limit"))}
_MOST_EVALUATIONS, _FIRST_EVALUATIONS = 60, 8
_FARTHEST = 3.0  # largest distance of a parameter from its prior, in standard deviations
_LEAST_LIMIT = 0.01  # smallest limit, relative to the largest effort of the bodies
LOWERED = 0.7  # standard deviation of log(limit / stall torque): limits are often set lower
_USUAL_LOAD, _MOST_LOAD = 0.2, 2.0  # load-dependent friction at the largest load, relative to it
_USUAL_BAND = 0.01  # rad or m
_IDLE_LEAVES = 0.5  # largest ratio of the residual with a dead band to that without
_SMOOTHER = 1.0 / 24.0 / np.sqrt(3.0)  # deviation per second difference of the command
_TRIED_DELAYS = (0.0, 0.01, 0.03)  # starting points of searches, s


@dataclass(frozen=True, eq=False)
class ServoFit:
    """Servo, friction and rotor inertia of a joint, estimated from its motion."""

    # (10,) values of `PARAMETERS`. `rate` is all damping of the servo, `damping` that of the joint
    # alone. The last two are 0 without an integral or a dead band.
    parameters: Array
    # (10,) standard deviations. Except for kp they assume exactly known bodies. They include
    # delayed feedback and the unknown commands between rows of a log.
    deviations: Array
    error: float  # RMS of simulated − measured positions, rad or m
    start: float  # the same at the start of the search
    moved: float  # standard deviation of the measured positions, rad or m
    limit: float  # saturation effort of the servo; infinite if the motion shows none
    rate_share: float  # share of the command's rate that the servo's damping sees

    def with_gain_uncertainty(self, share: float) -> ServoFit:
        """Return the fit with relative deviations of at least `share`, that of the gain.

        The motion identifies ratios of forces: all but times and positions scale with the
        stiffness.
        """
        forces = ~np.isin(PARAMETERS, ("delay", "dead_band"))
        least = share * forces * np.abs(self.parameters)
        return replace(self, deviations=np.maximum(self.deviations, least))


@dataclass(frozen=True, eq=False)
class _Servo:
    """Servo parameters (12 + S,) in a search, and which of them (12 + S,) are free."""

    numbers: Array
    free: Mask

    @classmethod
    def of(cls, numbers: Array, *, summed: bool = False) -> _Servo:
        """Return a servo with all usual parameters free.

        If `summed`, it has an integral and an initial effort w in each stretch, which includes the
        offset.
        """
        free = np.arange(len(numbers)) < LOAD
        free[INTEGRAL], free[SHARE] = summed, np.isfinite(numbers[LIMIT])
        free[OFFSET], free[BEGUN:] = not summed, summed
        return cls(numbers, free)

    @property
    def summed(self) -> bool:
        """Whether each stretch has an effort w."""
        return bool(self.free[BEGUN])

    def freed(self, which: int) -> _Servo:
        """Return the servo with one more free parameter."""
        free = self.free.copy()
        free[which] = True
        return _Servo(self.numbers, free)

    def without(self, which: int) -> _Servo:
        """Return the servo with one parameter fixed at zero."""
        numbers, free = self.numbers.copy(), self.free.copy()
        numbers[which], free[which] = 0.0, False
        return _Servo(numbers, free)

    def plain(self) -> _Servo:
        """Return the servo without an integral."""
        numbers, free = self.numbers.copy(), self.free.copy()
        numbers[INTEGRAL], numbers[BEGUN:] = 0.0, 0.0
        free[INTEGRAL], free[BEGUN:], free[OFFSET] = False, False, True
        return _Servo(numbers, free)

    def along(self, motions: JointMotions) -> _Servo:
        """Return the servo for other stretches, with integrals initialized from the bodies."""
        plain = self.numbers[:BEGUN]
        numbers = motions.servo(plain.tolist(), limit=float(plain[LIMIT]))
        if self.summed:
            numbers = motions.with_integral(numbers, float(plain[INTEGRAL]))
        numbers[SHARE] = plain[SHARE]
        free = np.append(self.free[:BEGUN], np.full(len(motions.rows), self.summed))
        return _Servo(numbers, free)

    def limited(self, limit: float, share: float, *, sought: bool = False) -> _Servo:
        """Return the servo with another limit, free if `sought`, and a free damping share."""
        numbers, free = self.numbers.copy(), self.free.copy()
        numbers[[LIMIT, SHARE]] = limit, share
        free[LIMIT], free[SHARE] = sought, np.isfinite(limit)
        return _Servo(numbers, free)


Expected = Mapping[str, tuple[float, float]]
"""Positive parameter, or `limit` -> prior median and standard deviation of its logarithm."""


def fit_servo(
    motions: JointMotions,
    signal: EffortSignal,
    limit: float = np.inf,
    *,
    expected: Expected | None = None,
    bodies: float = 0.0,
) -> ServoFit | None:
    """Fit the servo that reproduces a joint's measured motion, starting from a linear fit.

    The servo saturates at the `limit` of the model, N·m or N, at another one, or never. `expected`
    are priors, by default one of the stiffness around the linear fit. An expected limit is used if
    the motion does not reach it. `bodies` is the relative uncertainty of the bodies. Return None if
    held-out windows are predicted no better than at the start, or than by a joint at rest.
    """
    inertia, pieces = np.concatenate(motions.rows)[:, 1], motions.pieces()
    guess = [
        signal.gain,
        signal.damping,
        0.05 * signal.gain,
        0.1 * float(np.std(motions.needed)),
        0.2 * float(np.mean(inertia)),
        signal.delay,
        *np.zeros(DEAD_BAND - OFFSET),
        signal.dead_band,
    ]
    expected = {"stiffness": (signal.gain, ALIKE), **(expected or {})}
    linear_integral = signal.integral or pieces.linear_servo(signal).integral
    initial = _Search(pieces, linear_integral, expected)
    fitted = initial.with_dead_band(initial.at_its_limit(pieces.servo(guess), limit))
    loaded = initial.best([fitted.freed(LOAD)], seen=True)
    if pieces is not motions:
        fitted, loaded = fitted.along(motions), loaded.along(motions)
    search, start = replace(initial, motions=motions), motions.servo(guess)
    fit = search.fitted(fitted, loaded, start, bodies)
    if fit is not None and fit.parameters[INTEGRAL] ** 2 < PENALTY * fit.deviations[INTEGRAL] ** 2:
        without_integral = search.best([fitted.plain()], seen=True)
        return search.fitted(without_integral, without_integral.freed(LOAD), start, bodies)
    return fit


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for the servo of a joint."""

    motions: JointMotions
    linear_integral: float  # integral gain of the linear fit, 0 without one
    expected: Expected

    def fitted(self, half: _Servo, loaded: _Servo, start: Array, bodies: float) -> ServoFit | None:
        """Return the fit to all rows, starting from fits to half of the windows; see `fit_servo`.

        `half` has no load-dependent friction, `loaded` has.
        """
        motions, began = self.motions, start.copy()
        began[[LIMIT, SHARE]] = half.numbers[[LIMIT, SHARE]]
        sought, limited = half.free[LIMIT], began[[LIMIT, SHARE]].tolist()
        half, loaded = half.limited(*limited), loaded.limited(*limited)
        tested, moved = motions.tested, float(np.std(motions.measured))
        if not motions.rms(half.numbers, tested) < min(motions.rms(began, tested), moved):
            return None
        loaded = self.best([loaded], seen=True)
        if motions.gain(half.numbers, loaded.numbers, tested) >= PENALTY:
            half = loaded
        best = self.best([half])
        usual, spread = self.expected.get("limit", (np.inf, np.inf))
        if sought:
            unlimited = self.best([best.limited(np.inf, 0.0), _Servo.of(start)])
            surprise = np.log(best.numbers[LIMIT] / usual) / spread if np.isfinite(usual) else 0.0
            if motions.gain(unlimited.numbers, best.numbers) < PENALTY + surprise**2:
                best = unlimited
        for index in (OFFSET, LOAD, DEAD_BAND, RATE, DELAY, SHARE):
            bare = best.without(index)
            if best.numbers[index]:
                bare = self.best([bare])
            if motions.gain(bare.numbers, best.numbers) < PENALTY:
                best = bare
        error, start_error = motions.rms(best.numbers), motions.rms(began)
        if not error < min(start_error, moved):
            return None
        if np.isfinite(usual):
            # Data sheets state the torque at the shaft, after friction. Load-dependent friction is
            # known only up to the largest load in the logs.
            seen = min(usual, self._most)
            dry = float(best.numbers[COULOMB] + best.numbers[LOAD] * seen**2)
            at_usual_limit = best.limited(usual + dry, 0.0)
            if (motions.residual(at_usual_limit.numbers) == motions.residual(best.numbers)).all():
                best = at_usual_limit
        parameters, limit, rate_share = _with_own_damping(best.numbers)
        deviations = self._deviations(best)
        # Heavier bodies with a proportionally larger stiffness move alike.
        whole = np.hypot(deviations[0], bodies * parameters[0])
        deviations[0] = min(whole, self.expected["stiffness"][1] * parameters[0])
        return ServoFit(parameters, deviations, error, start_error, moved, limit, rate_share)

    def at_its_limit(self, start: Array, limit: float) -> _Servo:
        """Fit half of the windows, and choose the saturation by the others.

        Candidates are no saturation, the limit of the joint, and a fitted limit.
        """
        motions, begin, best = self.motions, _Servo.of(start), self._by_half(start)

        def is_better(servo: _Servo) -> bool:
            gain = motions.gain(best.numbers, servo.numbers, motions.tested)
            return gain >= PENALTY * (1 + int(servo.summed) - int(best.summed))

        tried = [(each.numbers, each.limited(limit, 0.0).numbers) for each in (begin, best)]
        if any((motions.simulated(free) != motions.simulated(held)).any() for free, held in tried):
            # Saturation can hide the integral from the linear fit.
            hidden = replace(self, linear_integral=self.linear_integral or float(start[0]))
            other = hidden._by_half(begin.limited(limit, 0.0).numbers)
            best = other if is_better(other) else best
        starts = [best]
        for integral in (0.0, self.linear_integral or start[0]):
            starts.append(_Servo.of(motions.with_integral(start, integral), summed=True))
        starts = [
            each.limited(self._most, share, sought=True) for share in (0.0, 1.0) for each in starts
        ]
        with_limit = self.best(starts, seen=True)
        if is_better(with_limit):
            integral = float(with_limit.numbers[INTEGRAL]) or self.linear_integral
            other = replace(self, linear_integral=integral)._by_half(with_limit.plain().numbers)
            with_limit = self.best([other.freed(LIMIT)], seen=True)
            best = with_limit if is_better(with_limit) else best
        return best

    def with_dead_band(self, servo: _Servo) -> _Servo:
        """Return the servo with a dead band if that predicts the other windows far better.

        A small improvement may come from other effects, such as the clock of the servo. The search
        starts only if the slopes promise enough.
        """
        motions, tried = self.motions, servo.freed(DEAD_BAND)
        seen, rows = motions.seen
        residual, J = (each[rows] for each in seen.with_slopes(servo.numbers, tried.free))
        unexplained = residual - J @ np.linalg.lstsq(J, residual)[0]
        if np.std(unexplained) > np.sqrt(_IDLE_LEAVES) * np.std(residual):
            return servo
        banded, tested = self.best([tried], seen=True), motions.tested
        before, after = (motions.rms(each.numbers, tested) for each in (servo, banded))
        much_better = after <= _IDLE_LEAVES * before
        significant = motions.gain(servo.numbers, banded.numbers, tested) >= PENALTY
        return banded if much_better and significant else servo

    @cached_property
    def _most(self) -> float:
        """Largest effort of the bodies, N·m or N; 1 if it is zero."""
        return float(np.abs(self.motions.needed).max()) or 1.0

    def _by_half(self, start: Array) -> _Servo:
        """Fit the windows that are not held out.

        Add an integral if it predicts the others better than a constant effort.
        """
        motions = self.motions
        starts = [start]  # several delays, damping with and without the command's rate
        for delay in _TRIED_DELAYS:
            starts.append(start.copy())
            starts[-1][[RATE, DELAY]] = 0.0 if delay else 0.5 * start[2], delay
        if np.isfinite(start[LIMIT]):
            starts = [_with_share(each, share) for share in (0.0, 1.0) for each in starts]
        plain = self.best([_Servo.of(each) for each in starts], seen=True)
        constant = _Servo.of(plain.numbers, summed=True)
        if not self.linear_integral:
            return plain
        resets = [motions.with_integral(each, self.linear_integral) for each in starts]
        best = self.best([_Servo.of(each, summed=True) for each in resets], seen=True)
        constant = self.best([each.without(INTEGRAL) for each in (constant, best)], seen=True)
        gain = motions.gain(constant.numbers, best.numbers, motions.tested)
        return best if gain >= PENALTY else plain

    def best(self, starts: Sequence[_Servo], *, seen: bool = False) -> _Servo:
        """Return the least-squares fit to all rows, or to those not held out if `seen`.

        A few steps are taken from each start, and the best one is continued to convergence. Priors
        bound the parameters; in fits to all rows they enter the cost too.
        """
        all_motions, size = self.motions, len(starts[0].numbers)
        max_steps = _MOST_EVALUATIONS if len(starts) == 1 else _FIRST_EVALUATIONS
        motions, rows = (
            all_motions.seen if seen else (all_motions, np.ones(len(all_motions.measured), bool))
        )
        expected = {_PLACES[name]: value for name, value in self.expected.items()}
        places = [at for at in expected if starts[0].free[at] or at != LIMIT]
        usual, spread = np.transpose([expected[at] for at in places])
        weights, delay_weight = 0.0 * spread, 0.0
        if not seen:  # on the scale of the residual
            residuals = motions.residual(starts[0].numbers)
            noise = np.sqrt(residuals @ residuals / WORTH)
            weights, delay_weight = noise / spread, noise / USUAL_DELAY * np.sqrt(2.0 / np.pi)
        upper, lower = np.full((2, size), np.inf)
        upper[[DELAY, LOAD]] = LONGEST_DELAY, _MOST_LOAD / self._most
        lower[:BEGUN], lower[LIMIT], lower[BEGUN:] = 0.0, _LEAST_LIMIT * self._most, -np.inf
        lower[OFFSET], upper[SHARE] = -np.inf, 1.0
        farthest = np.exp(_FARTHEST * spread)
        lower[places], upper[places] = usual / farthest, usual * farthest

        def search(start: _Servo) -> tuple[float, _Servo]:
            free = start.free

            def numbers(x: Array) -> Array:
                found = start.numbers.copy()
                found[free] = x
                return found

            def residual(x: Array) -> Array:
                return with_priors(numbers(x), motions.residual(numbers(x)))

            def with_priors(at: Array, residuals: Array) -> Array:
                log_ratios = weights * np.log(at[places] / usual)
                return np.hstack([residuals[rows], log_ratios, delay_weight * at[DELAY]])

            def with_slopes(x: Array) -> tuple[Array, Array]:
                at, prior_slopes = numbers(x), np.zeros((len(places) + 1, size))
                prior_slopes[range(len(places)), places] = weights / at[places]
                prior_slopes[-1, DELAY] = delay_weight
                residuals, J = motions.with_slopes(at, free)
                return with_priors(at, residuals), np.vstack([J[rows], prior_slopes[:, free]])

            begin = np.clip(start.numbers, lower, upper)[free]
            x, cost = bounded_least_squares(
                (residual, with_slopes), begin, (lower[free], upper[free]), max_steps
            )
            return cost, replace(start, numbers=numbers(x))

        best = min(map(search, starts), key=lambda each: each[0])[1]
        return best if len(starts) == 1 else self.best([best], seen=seen)

    def _deviations(self, best: _Servo) -> Array:
        """Return marginal standard deviations (10,), including what `_unobservable` adds."""
        numbers, free, gain = best.numbers, best.free, best.numbers[0]
        least = np.full(len(numbers), float(np.std(self.motions.needed)) or 1.0)
        least[:OFFSET] = 0.0, 0.02 * gain, 0.01 * gain, 1e-3, 1e-4, 0.01
        least[LOAD], least[INTEGRAL], least[SHARE] = _USUAL_LOAD / self._most, gain, 0.5
        least[DEAD_BAND] = _USUAL_BAND
        size = np.maximum(np.abs(numbers), least)[free]
        J = self.motions.with_slopes(numbers, free)[1]
        columns = np.column_stack([J * size, *self._unobservable(numbers, J, free)])
        # Parameters that the motion does not identify have a prior of their own size.
        prior = np.ones(columns.shape[1])
        for name, (_, spread) in self.expected.items():
            prior[: len(size)][np.flatnonzero(free) == _PLACES[name]] = spread**-2.0
        H = columns.T @ columns / self.motions.noise(self.motions.residual(numbers))
        values, vectors = np.linalg.eigh(H + np.diag(prior))
        # Rounding may leave eigenvalues below those of the prior.
        covariance = vectors / np.maximum(values, prior.min()) @ vectors.T
        moves = np.zeros((len(free), len(prior)))
        moves[free, : len(size)] = np.diag(size)
        d, share = numbers[[DAMPING, SHARE]]
        servo_damping = share * moves[DAMPING] + d * moves[SHARE]
        moves[RATE] += servo_damping
        moves[DAMPING] -= servo_damping
        return np.sqrt(np.einsum("ij,jk,ik->i", moves, covariance, moves))[:LIMIT]

    def _unobservable(self, numbers: Array, J: Array, free: Mask) -> tuple[Array, Array]:
        """Return changes (N,) of positions per standard deviation of unobservable quantities.

        Feedback delayed by τ reduces the damping by kp τ and the inertia by d τ. Commands between
        rows of period T are unknown too: a command that the servo holds equals, up to a delay, a
        smooth one c plus T² c̈ / 24, of which any share is equally likely. `J` (N, f) are slopes
        with respect to the `free` parameters.
        """
        motions, indices = self.motions, np.flatnonzero(free).searchsorted([DAMPING, ARMATURE])
        delayed = J[:, indices] @ [numbers[0], numbers[RATE] + numbers[DAMPING]]
        rows = tuple(each.copy() for each in motions.rows)
        for each in rows:
            each[1:-1, 7] -= _SMOOTHER * np.diff(each[:, 7], 2)
        rounded = replace(motions, rows=rows).simulated(numbers)
        return -USUAL_PERIOD * delayed, rounded - motions.measured - motions.residual(numbers)


def _with_share(numbers: Array, share: float) -> Array:
    """Return servo parameters with the servo's share of the damping."""
    found = numbers.copy()
    found[SHARE] = share
    return found


def _with_own_damping(numbers: Array) -> tuple[Array, float, float]:
    """Return parameters (10,) with the servo's damping moved into its rate gain.

    Return also the limit, and the share of the command's rate that the damping sees.
    """
    parameters, share = numbers[:LIMIT].copy(), float(numbers[SHARE])
    servo_damping, rate = share * float(parameters[DAMPING]), float(parameters[RATE])
    parameters[[RATE, DAMPING]] = rate + servo_damping, parameters[DAMPING] - servo_damping
    return (
        parameters,
        float(numbers[LIMIT]),
        rate / (rate + servo_damping) if servo_damping else 1.0,
    )
