"""Gains of servos by the motion itself: each joint simulated under its commands, and compared.

What a stiff servo makes of its command hardly shows in inverse dynamics: it moves its joint almost
as it is told, so that its stiffness times how far it lags, its damping and its delay all look like
friction. It shows in how the joint moves. Each joint is therefore simulated alone, while all others
move as they were measured to (`servo_motion`).

Its parameters are those of least squares of x − q by Levenberg and Marquardt's method, from a
linear fit on; what a data sheet says of them, and a usual delay, count like further samples. They
count only if windows of the log that the fit did not see are predicted better than from where it
began.

An integral that goes on since before the log has left an effort w where a stretch begins, of which
nobody knows; without an integral w would be a constant effort. A servo therefore has an integral
only if windows that a fit did not see are predicted better with ki than with such a constant alone,
and if all of them then say that there is one.

A servo saturates in the simulation, its integral held, where such windows are predicted better for
it: at the limit of effort that the model states, or at one of its own, which is sought like another
parameter, from what bodies need at most on. A share of the damping d is the servo's own, within the
limit, and the rest the joint's: only a servo at its limit tells them apart.

Friction by the load is rarer than all else: it must predict such windows better, too, and a dead
band by far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.bounded_descent import descended
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
"""Commands are late by so much in the mean, s."""

USUAL_PERIOD = 1e-3
"""Servos compute their effort about so often, s: the motion that they feel is late by as much.

As a servo's damping and the joint's inertia make up for that exactly, no motion tells it.
"""

_PLACES = {name: at for at, name in enumerate((*PARAMETERS, "limit"))}
_MOST_EVALUATIONS, _FIRST_EVALUATIONS = 60, 8
_FARTHEST = 3.0  # deviations of a number from what is expected
_LEAST_LIMIT = 0.01  # of its size
LOWERED = 0.7  # deviation of the logarithm of a limit from a stall torque: servos are set to less
_USUAL_LOAD, _MOST_LOAD = 0.2, 2.0  # of the largest load, that friction by its square is there
_USUAL_BAND = 0.01  # rad or m
_IDLE_LEAVES = 0.5  # share of what is left of positions, that a dead band leaves at most
_SMOOTHER = 1.0 / 24.0 / np.sqrt(3.0)  # of second differences of commands: deviation
_TRIED_DELAYS = (0.0, 0.01, 0.03)  # s, that searches begin from


@dataclass(frozen=True, eq=False)
class ServoFit:
    """A servo and what its joint has beside the bodies, by the joint's motion."""

    # (10,) values of `PARAMETERS`: the rate's with all damping that the servo makes, damping that
    # of the joint alone; the last two are 0 for a servo without an integral, and a dead band
    parameters: Array
    # (10,) their standard deviations; of all but kp for bodies that are known exactly. Counted are
    # feedback that acts late, and commands between the rows of a log, which no log shows
    deviations: Array
    error: float  # RMS of simulated − measured positions, rad or m
    start: float  # the same where the search began
    moved: float  # deviation of the measured positions, rad or m
    limit: float  # effort at which the servo saturates; infinite where the motion shows none
    rate_share: float  # of the command's rate, that the servo's damping knows

    def with_gain_uncertainty(self, share: float) -> ServoFit:
        """Return the fit with deviations no smaller than its gain's, as a share.

        The motion tells ratios of forces: all but times and positions scale with the stiffness.
        """
        forces = ~np.isin(PARAMETERS, ("delay", "dead_band"))
        least = share * forces * np.abs(self.parameters)
        return replace(self, deviations=np.maximum(self.deviations, least))


@dataclass(frozen=True, eq=False)
class _Servo:
    """A servo in a search: its numbers (12 + S,), and which of them (12 + S,) move."""

    numbers: Array
    free: Mask

    @classmethod
    def of(cls, numbers: Array, *, summed: bool = False) -> _Servo:
        """Return one with an integral, or a constant effort w in each stretch, or without."""
        free = np.arange(len(numbers)) < LOAD
        free[INTEGRAL], free[SHARE] = summed, np.isfinite(numbers[LIMIT])
        free[OFFSET], free[BEGUN:] = not summed, summed  # w has it
        return cls(numbers, free)

    @property
    def summed(self) -> bool:
        """Whether each stretch has an effort w."""
        return bool(self.free[BEGUN])

    def freed(self, which: int) -> _Servo:
        """Return the servo with one more of its numbers free."""
        free = self.free.copy()
        free[which] = True
        return _Servo(self.numbers, free)

    def without(self, which: int) -> _Servo:
        """Return the servo with one of its numbers zero for good."""
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
        """Return the servo along other stretches; its integral begins as bodies need it."""
        plain = self.numbers[:BEGUN]
        numbers = motions.servo(plain.tolist(), limit=float(plain[LIMIT]))
        if self.summed:
            numbers = motions.with_integral(numbers, float(plain[INTEGRAL]))
        numbers[SHARE] = plain[SHARE]
        free = np.append(self.free[:BEGUN], np.full(len(motions.rows), self.summed))
        return _Servo(numbers, free)

    def limited(self, limit: float, share: float, *, sought: bool = False) -> _Servo:
        """Return the servo with another limit, and a share of its damping within it to be found."""
        numbers, free = self.numbers.copy(), self.free.copy()
        numbers[[LIMIT, SHARE]] = limit, share
        free[LIMIT], free[SHARE] = sought, np.isfinite(limit)
        return _Servo(numbers, free)


Expected = Mapping[str, tuple[float, float]]
"""Parameter above 0, or `limit` -> what is expected of it, and the deviation of its logarithm."""


def fit_servo(
    motions: JointMotions,
    signal: EffortSignal,
    limit: float = np.inf,
    *,
    expected: Expected | None = None,
    bodies: float = 0.0,
) -> ServoFit | None:
    """Return the servo that moves a joint as it was measured to, from that by a linear fit on.

    The `limit` is the largest effort of the joint, N·m or N, by the model: the servo may keep it,
    or another one, or none. Of the stiffness and other parameters values may be `expected`, by
    default of the stiffness about that by the linear fit; `bodies` are known to a share. A limit
    that is expected is the servo's where the motion does not reach it. None if windows that the fit
    did not see are predicted no better than from where it began, or than by a joint that stands
    still.
    """
    inertia, some = np.concatenate(motions.rows)[:, 1], motions.pieces()
    begin = [
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
    told = signal.integral or some.linear_servo(signal).integral
    first = _Search(some, told, expected)
    found = first.with_dead_band(first.at_its_limit(some.servo(begin), limit))
    loaded = first.best([found.freed(LOAD)], seen=True)
    if some is not motions:
        found, loaded = found.along(motions), loaded.along(motions)
    search, start = replace(first, motions=motions), motions.servo(begin)
    fit = search.fitted(found, loaded, start, bodies)
    if fit is not None and fit.parameters[INTEGRAL] ** 2 < PENALTY * fit.deviations[INTEGRAL] ** 2:
        plain = search.best([found.plain()], seen=True)
        return search.fitted(plain, plain.freed(LOAD), start, bodies)
    return fit


@dataclass(frozen=True, eq=False)
class _Search:
    """Searches for the servo of a joint, from servos (12 + S,) on."""

    motions: JointMotions
    told: float  # the integral gain by a linear fit; 0 if it has none
    expected: Expected

    def fitted(self, half: _Servo, loaded: _Servo, start: Array, bodies: float) -> ServoFit | None:
        """Return the fit to all rows, from those to half of the windows on; see `fit_servo`.

        One of these has friction by the load.
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
            never = self.best([best.limited(np.inf, 0.0), _Servo.of(start)])
            odd = np.log(best.numbers[LIMIT] / usual) / spread if np.isfinite(usual) else 0.0
            if motions.gain(never.numbers, best.numbers) < PENALTY + odd**2:
                best = never
        for which in (OFFSET, LOAD, DEAD_BAND, RATE, DELAY, SHARE):
            bare = best.without(which)
            if best.numbers[which]:
                bare = self.best([bare])
            if motions.gain(bare.numbers, best.numbers) < PENALTY:
                best = bare
        error, first = motions.rms(best.numbers), motions.rms(began)
        if not error < min(first, moved):
            return None
        if np.isfinite(usual):
            # Of what a servo gives, friction takes its part before the shaft of a data sheet. By
            # its load it is known up to the largest one that was seen.
            seen = min(usual, self._most)
            dry = float(best.numbers[COULOMB] + best.numbers[LOAD] * seen**2)
            held = best.limited(usual + dry, 0.0)
            if (motions.residual(held.numbers) == motions.residual(best.numbers)).all():
                best = held
        parameters, limit, rate_share = _with_own_damping(best.numbers)
        deviations = self._deviations(best)
        # Bodies that are heavier move as these do with a stiffness that is larger by as much.
        whole = np.hypot(deviations[0], bodies * parameters[0])
        deviations[0] = min(whole, self.expected["stiffness"][1] * parameters[0])
        return ServoFit(parameters, deviations, error, first, moved, limit, rate_share)

    def at_its_limit(self, start: Array, limit: float) -> _Servo:
        """Return the servo by half of the windows, saturating as the others ask for.

        That is never, or at a limit of the joint, or at one that is found.
        """
        motions, begin, best = self.motions, _Servo.of(start), self._by_half(start)

        def is_better(servo: _Servo) -> bool:
            gain = motions.gain(best.numbers, servo.numbers, motions.tested)
            return gain >= PENALTY * (1 + int(servo.summed) - int(best.summed))

        tried = [(each.numbers, each.limited(limit, 0.0).numbers) for each in (begin, best)]
        if any((motions.simulated(free) != motions.simulated(held)).any() for free, held in tried):
            hidden = replace(self, told=self.told or float(start[0]))  # an integral by its limit
            other = hidden._by_half(begin.limited(limit, 0.0).numbers)
            best = other if is_better(other) else best
        starts = [best]
        for integral in (0.0, self.told or start[0]):
            starts.append(_Servo.of(motions.with_integral(start, integral), summed=True))
        starts = [
            each.limited(self._most, share, sought=True) for share in (0.0, 1.0) for each in starts
        ]
        found = self.best(starts, seen=True)
        if is_better(found):
            told = float(found.numbers[INTEGRAL]) or self.told
            other = replace(self, told=told)._by_half(found.plain().numbers)
            found = self.best([other.freed(LIMIT)], seen=True)
            best = found if is_better(found) else best
        return best

    def with_dead_band(self, servo: _Servo) -> _Servo:
        """Return the servo with a dead band, if that predicts the other windows far better.

        One that takes away little of what is left of positions is not told from what else is
        lacking, such as the steps of a servo's clock. It is sought where slopes promise enough.
        """
        motions, tried = self.motions, servo.freed(DEAD_BAND)
        seen, rows = motions.seen
        left, J = (each[rows] for each in seen.with_slopes(servo.numbers, tried.free))
        unexplained = left - J @ np.linalg.lstsq(J, left)[0]
        if np.std(unexplained) > np.sqrt(_IDLE_LEAVES) * np.std(left):
            return servo
        idle, tested = self.best([tried], seen=True), motions.tested
        far = motions.rms(idle.numbers, tested) <= _IDLE_LEAVES * motions.rms(servo.numbers, tested)
        worth = motions.gain(servo.numbers, idle.numbers, tested) >= PENALTY
        return idle if far and worth else servo

    @cached_property
    def _most(self) -> float:
        """The most effort that bodies need, N·m or N; 1 if they need none."""
        return float(np.abs(self.motions.needed).max()) or 1.0

    def _by_half(self, start: Array) -> _Servo:
        """Return a servo by the windows that a test does not need.

        It has an integral if the others are predicted better with it than with a constant effort.
        """
        motions = self.motions
        starts = [start]  # with several delays, and damping known to the command or not
        for delay in _TRIED_DELAYS:
            starts.append(start.copy())
            starts[-1][[RATE, DELAY]] = 0.0 if delay else 0.5 * start[2], delay
        if np.isfinite(start[LIMIT]):
            starts = [_with_share(each, share) for share in (0.0, 1.0) for each in starts]
        plain = self.best([_Servo.of(each) for each in starts], seen=True)
        constant = _Servo.of(plain.numbers, summed=True)
        if not self.told:
            return plain
        resets = [motions.with_integral(each, self.told) for each in starts]
        best = self.best([_Servo.of(each, summed=True) for each in resets], seen=True)
        constant = self.best([each.without(INTEGRAL) for each in (constant, best)], seen=True)
        worth = motions.gain(constant.numbers, best.numbers, motions.tested)
        return best if worth >= PENALTY else plain

    def best(self, starts: Sequence[_Servo], *, seen: bool = False) -> _Servo:
        """Return the least squares over all rows, or those that a fit sees, from several starts on.

        Of several the one that is best after a few steps is followed to its end. What is expected
        of numbers bounds them in searches, and counts over all rows.
        """
        whole, size = self.motions, len(starts[0].numbers)
        most = _MOST_EVALUATIONS if len(starts) == 1 else _FIRST_EVALUATIONS
        motions, rows = whole.seen if seen else (whole, np.ones(len(whole.measured), bool))
        expected = {_PLACES[name]: value for name, value in self.expected.items()}
        places = [at for at in expected if starts[0].free[at] or at != LIMIT]
        usual, spread = np.transpose([expected[at] for at in places])
        weights, late = 0.0 * spread, 0.0
        if not seen:  # on the scale of what is left of positions
            left = motions.residual(starts[0].numbers)
            noise = np.sqrt(left @ left / WORTH)
            weights, late = noise / spread, noise / USUAL_DELAY * np.sqrt(2.0 / np.pi)
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
                return beside(numbers(x), motions.simulated(numbers(x)) - motions.measured)

            def beside(at: Array, left: Array) -> Array:
                known = weights * np.log(at[places] / usual)
                return np.hstack([left[rows], known, late * at[DELAY]])

            def with_slopes(x: Array) -> tuple[Array, Array]:
                at, own = numbers(x), np.zeros((len(places) + 1, size))
                own[range(len(places)), places] = weights / at[places]
                own[-1, DELAY] = late
                left, J = motions.with_slopes(at, free)
                return beside(at, left), np.vstack([J[rows], own[:, free]])

            begin = np.clip(start.numbers, lower, upper)[free]
            x, cost = descended((residual, with_slopes), begin, (lower[free], upper[free]), most)
            return cost, replace(start, numbers=numbers(x))

        best = min(map(search, starts), key=lambda each: each[0])[1]
        return best if len(starts) == 1 else self.best([best], seen=seen)

    def _deviations(self, best: _Servo) -> Array:
        """Return (10,) standard deviations of parameters that are free.

        Each is that with all others unknown, and with what no log shows; see `_unobservable`.
        """
        numbers, free, gain = best.numbers, best.free, best.numbers[0]
        least = np.full(len(numbers), float(np.std(self.motions.needed)) or 1.0)
        least[:OFFSET] = 0.0, 0.02 * gain, 0.01 * gain, 1e-3, 1e-4, 0.01
        least[LOAD], least[INTEGRAL], least[SHARE] = _USUAL_LOAD / self._most, gain, 0.5
        least[DEAD_BAND] = _USUAL_BAND
        size = np.maximum(np.abs(numbers), least)[free]
        J = self.motions.with_slopes(numbers, free)[1]
        columns = np.column_stack([J * size, *self._unobservable(numbers, J, free)])
        # What the motion does not show is known to its own size.
        known = np.ones(columns.shape[1])
        for name, (_, spread) in self.expected.items():
            known[: len(size)][np.flatnonzero(free) == _PLACES[name]] = spread**-2.0
        H = columns.T @ columns / self.motions.noise(self.motions.residual(numbers))
        values, vectors = np.linalg.eigh(H + np.diag(known))
        # (Rounding may leave less than what is known.)
        covariance = vectors / np.maximum(values, known.min()) @ vectors.T
        moves = np.zeros((len(free), len(known)))
        moves[free, : len(size)] = np.diag(size)
        d, share = numbers[[DAMPING, SHARE]]
        own = share * moves[DAMPING] + d * moves[SHARE]
        moves[RATE] += own
        moves[DAMPING] -= own
        return np.sqrt(np.einsum("ij,jk,ik->i", moves, covariance, moves))[:LIMIT]

    def _unobservable(self, numbers: Array, J: Array, free: Mask) -> tuple[Array, Array]:
        """Return changes (N,) of positions by one deviation of each quantity that no log shows.

        Feedback that acts late by τ takes kp τ off the damping and d τ off the inertia. How
        commands go on between rows of period T matters too: one that a servo holds is, but for a
        delay, a smooth one c with T² c̈ / 24 more in the mean; any share of that is as likely.
        `J` (N, f) are slopes with the numbers that are `free`.
        """
        motions, at = self.motions, np.flatnonzero(free).searchsorted([DAMPING, ARMATURE])
        late = J[:, at] @ [numbers[0], numbers[RATE] + numbers[DAMPING]]
        rows = tuple(each.copy() for each in motions.rows)
        for each in rows:
            each[1:-1, 7] -= _SMOOTHER * np.diff(each[:, 7], 2)
        rounded = replace(motions, rows=rows).simulated(numbers)
        return -USUAL_PERIOD * late, rounded - motions.measured - motions.residual(numbers)


def _with_share(numbers: Array, share: float) -> Array:
    """Return numbers of a servo that makes a share of the damping."""
    found = numbers.copy()
    found[SHARE] = share
    return found


def _with_own_damping(numbers: Array) -> tuple[Array, float, float]:
    """Return parameters (10,) of a servo that makes its share of the damping, and two numbers more.

    These are its limit, and how much of the command's rate its damping knows.
    """
    parameters, share = numbers[:LIMIT].copy(), float(numbers[SHARE])
    own, known = share * float(parameters[DAMPING]), float(parameters[RATE])
    parameters[[RATE, DAMPING]] = known + own, parameters[DAMPING] - own
    return parameters, float(numbers[LIMIT]), known / (known + own) if own else 1.0
