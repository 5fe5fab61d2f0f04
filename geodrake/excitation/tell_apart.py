"""Motions that distinguish two effects which logs so far could not.

    limits = motion_limits(model, bounded=True)
    rivals = [make_rival(name, model, limits) for name in ("coulomb_friction", "viscous_friction")]
    separation = make_separation(model, *rivals, noise=0.1)
    result = design_excitation(separation, limits, trajectory=FourierMotion(10.0, 5))

If a robot has effect A, of parameters α, and is thought to have B instead, the best that B can do
on a motion is

    Δ = min over θ, β of ‖X_A α − X θ − X_B β‖² + θᵀ Λ θ     (T-optimality)

with regressors whitened by the noise, everything else that may move in θ (the inertias, near what
is known of them, and all other effects of the model), and what is known of it in Λ. As a function
of α this is αᵀ S α with the Schur complement S of the information matrix of (θ, β, α), as long as
no bound holds β. √Δ is by how many deviations of the noise A and B differ.

Since θ and β are at a minimum, only the regressors' own change counts: with the residual e and the
coefficients x = (−θ, −β, α) of all columns, ∂Δ/∂X = 2 e xᵀ. So one gradient costs as much as that
of a criterion of information.

Samples at which a joint's direction of motion is hardly known count less, by sgn²: no model says
what dry friction is there, and a diagnosis leaves them out. Efforts at the base of a robot on
several feet include those of all legs, so that the signs of all joints that may have the effects
count there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear

from geodrake.boundary.arguments import Sizes, instance, instances, one_of, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.effects import Effect, FittedEffect, Role, effect_class, make_effect
from geodrake.effects.user_effects import candidates_of
from geodrake.errors import ArgumentError
from geodrake.excitation.design import ExcitationResult
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.objective import Criterion, Objective
from geodrake.excitation.regressor_gradient import (
    MotionGradient,
    at_actuators,
    regressor_motion_gradient,
)
from geodrake.excitation.stance import MotorCoordinates, Stance
from geodrake.excitation.target import SIZE_WORDS, Measurement, Target, make_target, sized_effects
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.model_fit import known_information
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.transmission import times

Indices = NDArray[np.intp]

CLEAR = 5.0
"""Standard deviations by which effects must differ for a log to distinguish them reliably."""

Placed = tuple[str, tuple[str, ...]]  # an effect's name and place, which may be empty

_SIGN_SHARE = 0.02  # of the fastest that is allowed, over which friction changes sign
_LEAST = 1e-12  # separation that counts as none, per sample
_ALIKE = 0.1  # share of an effect's effort that an imitation must have
_LOOSE = 1e-4  # of what is known, where that shall not matter
_SAME = 1e-8  # share of an effect's squared effort that is rounding alone


@dataclass(frozen=True)
class Rival(Short):
    """One of two effects that are to be distinguished."""

    name: str
    # For each shape that it may have, the effect at each of its places.
    alternatives: tuple[tuple[Effect, ...], ...]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All of them."""
        return tuple(effect for alternative in self.alternatives for effect in alternative)


def make_rival(
    name: str,
    model: RobotModel,
    limits: MotionLimits,
    *,
    where: Sequence[str] = (),
    shape: Mapping[str, Any] | None = None,
    extra: Sequence[type[Effect]] = (),
) -> Rival:
    """Return an effect by name, at a place or wherever it can be.

    Args:
        model: The robot; an effect that it has keeps its shape.
        limits: Whose speeds the shapes scale with that a diagnosis would try.
        where: One place; all joints, or pairs of joints, if empty.
        shape: Shape parameters by name. If it is None, those of the model, else the defaults, else
            all that a diagnosis would try.
    """
    instance(model, "model", RobotModel)
    instance(limits, "limits", MotionLimits)
    where = instances(where, "where", str)
    cls = effect_class(name, extra)
    if not getattr(cls, "parameters", ()):
        raise ArgumentError(
            f"{name} has no linear parameters, so no motion is better for it than another.",
            advice="Let geodrake diagnose find it.",
        )
    places = [tuple(where)] if where else every_place(cls, model)
    speed = dict(zip(limits.joints, limits.velocity.tolist(), strict=True))
    known = {(f.effect.name, f.effect.where): f.effect for f in model.effects}
    body = cls.places == "body"
    what, known_names = ("body", model.bodies) if body else ("joint", model.joints)
    per_place: list[tuple[Effect, ...]] = []
    for place in places:
        if shape is None and (name, place) in known:
            per_place.append((known[name, place],))
            continue
        for each in place:
            one_of(each, what, known_names)
        try:
            per_place.append((make_effect(name, place, shape, extra),))
        except ArgumentError:
            if shape is not None or cls.places != "joint":
                raise
            per_place.append(candidates_of(cls, place[0], speed[place[0]]))
    most = max(len(effects) for effects in per_place)
    every = [effects * most if len(effects) == 1 else effects for effects in per_place]
    if any(len(effects) != most for effects in every):
        raise ArgumentError(
            f"{name} has different shapes at different joints.",
            advice=f"Use one joint at a time, such as {name}@{places[0][0]}.",
        )
    return Rival(name, tuple(zip(*every, strict=True)))


def every_place(cls: type[Effect], model: RobotModel) -> list[tuple[str, ...]]:
    """Return the places where a robot can have an effect that no place is given for."""
    if cls.places == "robot":
        return [()]
    if cls.places == "joint":
        left_out = (*model.base_joints, *(model.sliding_joints if cls.turning_only else ()))
        return [(joint,) for joint in model.single_joints if joint not in left_out]
    if cls.places == "joint_pair":
        return [pair for pair in model.joint_pairs if not {*pair}.intersection(model.base_joints)]
    advice = f"Let geodrake find it: geodrake add {cls.name} MODEL LOG --save model.yaml."
    if cls.places == "body":
        advice = f"Give its body: {cls.name}@{model.bodies[-1]}."
    raise ArgumentError(f"{cls.name} needs a place.", advice=advice)


@dataclass(frozen=True, eq=False)
class Pair(Short):
    """A robot with one effect at a place, explained by another one."""

    truth: str  # name of the effect that the robot has
    rival: str  # name of the effect that is to explain it
    where: tuple[str, ...]
    # (r, p) columns' coefficients of r robots, whose separations are added: one if the parameters
    # are known, and one for each parameter if not.
    effects: Array
    columns: Indices  # (c,) columns that an explanation may use: what may move, and the rival


@dataclass(frozen=True, eq=False)
class Separation(Objective):
    """The separations of pairs as a criterion: the least of them, as large as can be.

    They stand in for the eigenvalues of an information matrix: E-optimality is 1/Δ of the pair that
    is hardest to distinguish, with the smooth form of `Criterion`.

    Attributes:
        prior: (q, p) rows Λ^½ of what is known of each column's parameter.
        lower: (p,) least change of each column's parameter from its nominal value.
        upper: (p,) greatest change.
        fading: Joint that may have the effects and follows a base on its feet -> speed over which
            its friction changes sign.
    """

    pairs: tuple[Pair, ...] = ()
    prior: Array = field(default_factory=lambda: np.zeros((0, 0)))
    lower: Array = field(default_factory=lambda: np.zeros(0))
    upper: Array = field(default_factory=lambda: np.zeros(0))
    fading: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        instances(self.pairs, "pairs", Pair)
        sizes: Sizes = {}
        real_array(self.prior, "prior", ("q", "p"), sizes)
        lower = real_array(self.lower, "lower", ("p",), sizes, finite=False)
        upper = real_array(self.upper, "upper", ("p",), sizes, finite=False)
        if not (lower <= upper).all():
            raise ArgumentError(
                "lower must not exceed upper, and neither may be NaN, at every column."
            )

    def separations(self, motion: Motion) -> Array:
        """Return Δ (K,) of every pair, in squared standard deviations of all samples together."""
        measurement = self.target.measure(motion)
        return self._solve(measurement)[0]

    def efforts(self, motion: Motion) -> Array:
        """Return the RMS (K,) of what no rival explains, at the joint where it is most."""
        measurement = self.target.measure(motion)
        known, values = np.abs(self._known(measurement))[..., None], []
        for solutions in self._solve(measurement)[1]:
            left = measurement.regressor @ solutions.T * known
            values.append(float(np.sqrt(np.mean(np.square(left).sum(2), axis=0)).max()))
        return np.array(values)

    def imitation(self, motion: Motion, pair: int) -> tuple[Array, Array]:
        """Return a pair's true effort (N, nv), and the most that its rival makes of it.

        Of several robots, that one's which the rival explains worst.
        """
        measurement = self.target.measure(motion)
        solutions = self._solve(measurement)[1][pair]
        left = measurement.regressor @ solutions.T
        worst = int(np.argmax(np.square(left / self.target.noise[:, None]).sum((0, 1))))
        truth = measurement.regressor @ self.pairs[pair].effects[worst]
        return truth, truth - left[:, :, worst]

    def eigenvalues(self, motion: Motion) -> Array:
        """Return the separations (K,), ascending."""
        return np.sort(self.separations(motion))

    def value_and_gradient(self, motion: Motion) -> tuple[float, MotionGradient]:
        """Return what a solver minimizes, and its gradient by the motion.

        Raises:
            ArgumentError: The motion distinguishes some pair not at all, whatever the noise.
        """
        measurement = self.target.measure(motion)
        separations, solutions = self._solve(measurement)
        alike = np.flatnonzero(~(separations > _LEAST * len(motion)))
        if len(alike):
            pair = self.pairs[alike[0]]
            raise ArgumentError(
                f"On this motion {pair.rival} completely explains {pair.truth} of "
                f"{', '.join(pair.where) or 'the robot'}.",
                advice="Start from another motion, or use another pair.",
            )
        value, slope = self.criterion.objective(np.log(separations))
        gains = np.repeat(slope / separations, [len(x) for x in solutions])
        x, known, noise = np.concatenate(solutions), self._known(measurement), self.target.noise
        left = (measurement.regressor / noise[:, None]) @ x.T  # (N, nv, robots)
        weights = (left * known[..., None] ** 2) @ (2.0 * gains[:, None] * x)
        gradient = regressor_motion_gradient(self.target, measurement, weights / noise[:, None])
        slope = 2.0 * known * (np.square(left) @ gains)  # by signs
        own = 1.0 - known**2
        own[:, self._base] = 0.0
        gradient.v[:] += slope * own / self.target.sign_width
        if self.fading:
            by_legs = (slope * known)[:, self._base].sum(axis=1)
            gradient = gradient.plus(self._by_legs(motion, by_legs))
        return value, gradient

    def _by_legs(self, motion: Motion, weights: Array) -> MotionGradient:
        """Return the gradient of Σ w log Π s, w (N,), with the signs s of joints that follow."""
        (legs, width), rows = self._legs, np.zeros((3, len(motion), len(self.fading)))
        G = legs.jacobian(motion.q)
        sign = np.tanh(times(G, motion.v) / width)
        slope = (1.0 - sign**2) / (width * np.where(sign == 0.0, 1.0, sign))
        rows[1] = weights[:, None] * slope
        return at_actuators(legs, G, motion, MotionGradient(*rows))

    @cached_property
    def _legs(self) -> tuple[MotorCoordinates, Array]:
        """The map to joints that follow, and their fading speeds."""
        joints = MotorCoordinates(self.target.model.coordinates, tuple(self.fading))
        return joints, np.array([*self.fading.values()])

    @cached_property
    def _base(self) -> Indices:
        """Which joints are those of a base on its feet."""
        model = self.target.model
        return np.flatnonzero(np.isin(model.joints, model.base_joints))

    def _known(self, measurement: Measurement) -> Array:
        """Return smoothed signs (N, nv) of joints' speeds, the roots of samples' weights."""
        motion, (legs, width) = measurement.motion, self._legs
        known = np.tanh(motion.v / self.target.sign_width)
        known[:, self._base] = 1.0
        if self.fading:
            v = times(legs.jacobian(motion.q), motion.v)
            known[:, self._base] = np.tanh(v / width).prod(axis=1, keepdims=True)
        return known

    def _solve(self, measurement: Measurement) -> tuple[Array, list[Array]]:
        """Return separations (K,), and of each pair the coefficients (r, p) of what is left."""
        known = self._known(measurement)[..., None]
        rows = measurement.regressor * (known / self.target.noise[:, None])
        rows = rows.reshape(-1, rows.shape[2])
        R = np.asarray(np.linalg.qr(np.concatenate([rows, self.prior]), mode="r"))
        first, none = self._robots, np.zeros((0, R.shape[1]))
        robots = np.concatenate([none, *(pair.effects for pair in self.pairs)])
        for columns, members in self._groups.items():
            at = np.array(columns, np.intp)
            own = np.array(members)[:, None], at
            robots[own] -= self._explained(R, at, R @ robots[members].T)
        left = np.square(R @ robots.T).sum(axis=0)
        return np.add.reduceat(left, first[:-1]), np.split(robots, first[1:-1])

    @cached_property
    def _robots(self) -> Indices:
        """(K + 1,) numbers of the first robot of every pair, and of all robots."""
        return np.cumsum([0, *(len(pair.effects) for pair in self.pairs)])

    @cached_property
    def _groups(self) -> dict[tuple[int, ...], list[int]]:
        """Columns -> numbers of the robots whose explanations use them."""
        found: dict[tuple[int, ...], list[int]] = {}
        for pair, first in zip(self.pairs, self._robots.tolist(), strict=False):
            numbers = range(first, first + len(pair.effects))
            found.setdefault(tuple(pair.columns.tolist()), []).extend(numbers)
        return found

    def _explained(self, R: Array, columns: Indices, targets: Array) -> Array:
        """Return coefficients (r, c) of columns nearest to targets (q, r), within bounds."""
        A = R[:, columns]
        sizes = np.linalg.norm(A, axis=0)
        sizes = np.where(sizes > 0, sizes, 1.0)
        A, low, high = A / sizes, self.lower[columns] * sizes, self.upper[columns] * sizes
        found = np.asarray(np.linalg.lstsq(A, targets)[0].T)
        outside = np.flatnonzero(((found < low) | (found > high)).any(axis=1))
        if not len(outside):
            return found / sizes
        # Columns without bounds are eliminated first, so that the bounded problem is small.
        bound = np.isfinite(low) | np.isfinite(high)
        free, held, count = A[:, ~bound], A[:, bound], int(np.count_nonzero(bound))
        wanted = np.concatenate([held, targets[:, outside]], axis=1)
        shares = np.linalg.lstsq(free, wanted)[0]
        factor = np.asarray(np.linalg.qr(wanted - free @ shares, mode="r"))
        for row, k in enumerate(outside, count):
            bounds = low[bound], high[bound]
            x = lsq_linear(factor[:, :count], factor[:, row], bounds, method="bvls").x
            found[k, bound], found[k, ~bound] = x, shares[:, row] - shares[:, :count] @ x
        return found / sizes


def make_separation(
    model: RobotModel,
    first: Rival,
    second: Rival,
    *,
    noise: ArrayLike | None = None,
    sign_width: ArrayLike | None = None,
    spread: float = SPREAD,
    stance: Stance | None = None,
) -> Separation:
    """Return the objective that distinguishes two effects of a robot.

    Args:
        model: The robot. Its other effects may be refitted within what is known of them; if it has
            one of the rivals, that one's parameters say how large it is, and the other one is as
            large as it must be to be taken for it. Rivals of unknown size have a usual one.
        sign_width: Speed over which friction changes sign, as for `make_target`.
        spread: Relative uncertainty of a model file's inertias, as a geometric distance.
        stance: The feet on which the robot stands; the model is that of the stance then.
    """
    instance(model, "model", RobotModel)
    for name, rival in (("first", first), ("second", second)):
        instance(rival, name, Rival)
    positive(spread, "spread")
    rivals = (*first.effects, *second.effects)
    if set(first.effects) & set(second.effects):
        raise ArgumentError(
            f"{first.name} cannot be distinguished from itself.",
            advice="Use two different effects.",
        )
    common = [f for f in model.effects if f.effect not in rivals and len(f.effect.parameters)]
    unknown = [FittedEffect(effect, np.zeros(len(effect.parameters))) for effect in rivals]
    target = make_target(model, noise=noise, effects=[*common, *unknown], sign_width=sign_width)
    fading = dict[str, float]()
    if stance is not None:
        target = replace(target, trial=stance.random_motion())
        fading = _fading(stance, rivals)
    every = np.arange(target.size)
    spans = zip(target.effects, target.spans, strict=True)
    columns = {fitted.effect: every[span] for fitted, span in spans}
    sizes = _sizes(target, model, (first, second))
    bodies = every[: PARAMETERS_PER_BODY * len(target.bodies)]
    base = np.concatenate([bodies, *(columns[fitted.effect] for fitted in common)])
    pairs = []
    for truth, rival in ((first, second), (second, first)):
        for alternative in truth.alternatives:
            for other in rival.alternatives:
                used = np.concatenate([base, *(columns[effect] for effect in other)])
                for effect in alternative:
                    robots = np.zeros((len(sizes[effect]), target.size))
                    robots[:, columns[effect]] = sizes[effect]
                    words = (_words(truth, effect), _words(rival, other[0]))
                    pairs.append(Pair(*words, effect.where, robots, used))
    prior, lower, upper = np.zeros((len(base), target.size)), *_bounds(target, columns, common)
    prior[:, base] = _root(_information(model, common, spread))
    separation = Separation(
        target, Criterion("e_optimality"), "none", None, tuple(pairs), prior, lower, upper, fading
    )
    return replace(separation, pairs=_different(separation))


def _fading(stance: Stance, effects: Sequence[Effect]) -> dict[str, float]:
    """Return speeds over which friction of joints that follow a base changes sign, by joint."""
    behind, found = stance.model.coordinates.behind, dict[str, float]()
    speeds = dict(zip(stance.motors, stance.motor_limits.velocity.tolist(), strict=True))
    for effect in effects:
        joints = [joint for joint in effect.where if joint in behind]
        if joints and (effect.role is not Role.FORCE or "load" in effect.depends_on):
            raise ArgumentError(
                f"{effect.name} of {', '.join(joints)} depends on the load there, which the motors "
                "of a robot on several feet share.",
                advice="Name one foot, or use effects of positions, speeds and accelerations.",
            )
        found |= {joint: _SIGN_SHARE * speeds[joint] for joint in joints if joint in speeds}
    return found


def placed_rivals(
    model: RobotModel,
    first: Placed,
    second: Placed,
    limits: MotionLimits,
    *,
    extra: Sequence[type[Effect]] = (),
) -> tuple[Rival, Rival]:
    """Return two effects at their places; that of one counts for both, if both have such places."""
    (one, there), (other, here) = first, second
    if effect_class(one, extra).places == effect_class(other, extra).places:
        there, here = there or here, here or there
    return (
        make_rival(one, model, limits, where=there, extra=extra),
        make_rival(other, model, limits, where=here, extra=extra),
    )


def separation_of(
    model: RobotModel,
    first: Placed,
    second: Placed,
    limits: MotionLimits,
    *,
    noise: ArrayLike,
    extra: Sequence[type[Effect]] = (),
    stance: Stance | None = None,
) -> tuple[Separation, tuple[str, ...]]:
    """Return what distinguishing two effects amounts to, and what to say of it.

    Args:
        limits: Of the robot's motors.
        stance: The feet on which it stands.
    """
    rivals = placed_rivals(model, first, second, limits, extra=extra)
    if stance is not None:
        model, limits = stance.model, stance.limits()
    width = _SIGN_SHARE * limits.velocity
    separation = make_separation(model, *rivals, noise=noise, sign_width=width, stance=stance)
    named = {pair.truth.partition(" (")[0] for pair in separation.pairs}
    notes = [
        f"{other.name} explains everything that {rival.name} does: only the reverse can be "
        "distinguished"
        for rival, other in (rivals, rivals[::-1])
        if rival.name not in named
    ]
    known = {fitted.effect for fitted in model.effects if fitted.parameters.any()}
    if any(known.intersection(rival.effects) for rival in rivals):
        sizes = "effects have the sizes in the model, and rivals are fitted to them"
    else:
        sizes = f"effects of unknown size are assumed to take {SIZE_WORDS}"
    return separation, (*notes, sizes)


def _different(separation: Separation) -> tuple[Pair, ...]:
    """Return the pairs of which one is not wholly explained by the other, whatever the motion.

    An effect that contains another one explains it: these can be distinguished one way only.
    """
    motion = separation.target.random_motion
    loose = replace(separation, prior=_LOOSE * separation.prior)
    alone = replace(loose, pairs=tuple(replace(p, columns=p.columns[:0]) for p in loose.pairs))
    shares = loose.separations(motion) / np.maximum(alone.separations(motion), 1e-300)
    kept = tuple(p for p, share in zip(loose.pairs, shares, strict=True) if share > _SAME)
    if not kept:
        pair = separation.pairs[0]
        raise ArgumentError(
            f"{pair.rival} and {pair.truth} are equivalent on every motion.",
            advice="Use another pair, or another place.",
        )
    return kept


def _words(rival: Rival, effect: Effect) -> str:
    """Return the name of an effect, with its shape if it may have several."""
    if len(rival.alternatives) == 1:
        return rival.name
    shape = ", ".join(f"{name} {value:.3g}" for name, value in effect.shape.items())
    return f"{rival.name} ({shape})"


def _sizes(target: Target, model: RobotModel, rivals: Sequence[Rival]) -> dict[Effect, Array]:
    """Return parameters (r, k) of r robots that have an effect, for every rival effect."""
    known = {f.effect: f.parameters for f in model.effects if np.any(f.parameters)}
    typical = {fitted.effect: fitted.parameters for fitted in sized_effects(target)}
    found = {}
    for rival, other in zip(rivals, reversed(rivals), strict=True):
        for effect in rival.effects:
            alone = known.get(effect, typical[effect] if is_payload(effect) else None)
            found[effect] = np.diag(typical[effect]) if alone is None else alone[None]
            for counterpart in other.effects if effect not in known else ():
                shared = set(effect.where) & set(counterpart.where) or not effect.where
                if counterpart in known and shared:
                    like = _imitations(target, counterpart, known[counterpart], effect)
                    found[effect] = found[effect] if like is None else like[None]
    return found


def _bounds(
    target: Target, columns: dict[Effect, NDArray[np.intp]], common: Sequence[FittedEffect]
) -> tuple[Array, Array]:
    """Return the least and greatest change (p,) of every parameter from its nominal value."""
    lower, upper = np.full(target.size, -np.inf), np.full(target.size, np.inf)
    nominal = {fitted.effect: fitted.parameters for fitted in common}
    for effect, at in columns.items():
        value = nominal.get(effect, np.zeros(len(at)))
        lower[at] = np.minimum([p.lower for p in effect.parameters] - value, 0.0)
        upper[at] = np.maximum([p.upper for p in effect.parameters] - value, 0.0)
    return lower, upper


def _information(model: RobotModel, common: Sequence[FittedEffect], spread: float) -> Array:
    """Return what is known (b, b) of the inertias and common effects, whatever the others are."""
    wanted = {fitted.effect for fitted in common}
    counts = [model.phi.size, *(len(fitted.effect.parameters) for fitted in model.effects)]
    kept = np.repeat([True, *(fitted.effect in wanted for fitted in model.effects)], counts)
    information = known_information(model, spread=spread)
    known, rest = (information[np.ix_(at, at)] for at in (kept, ~kept))
    cross = information[np.ix_(kept, ~kept)]
    return np.asarray(known - cross @ np.linalg.pinv(rest, hermitian=True) @ cross.T)


def _root(information: Array) -> Array:
    """Return rows whose product RᵀR is an information matrix; units are scaled out first."""
    diagonal = np.diag(information)
    sizes = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / sizes[:, None] / sizes)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * sizes)


def _imitations(target: Target, truth: Effect, size: Array, rival: Effect) -> Array | None:
    """Return parameters (k,) with which a rival is most like a known effect, on random motion.

    They are within bounds; None if the effects have nothing to do with each other.
    """
    seen = target.measure(target.random_motion).seen
    if seen is None:
        return None
    wanted = (truth.regressor(seen) @ size).ravel()
    columns = rival.regressor(seen).reshape(len(wanted), -1)
    bounds = tuple(np.array([getattr(p, s) for p in rival.parameters]) for s in ("lower", "upper"))
    found = np.asarray(lsq_linear(columns, wanted, bounds).x)
    return found if np.linalg.norm(columns @ found) > _ALIKE * np.linalg.norm(wanted) else None


@dataclass(frozen=True)
class DistinguishedPair:
    """A pair of effects on a designed motion."""

    pair: Pair
    deviations: float  # √Δ, by how many standard deviations of the noise of all samples together
    # RMS effort that the rival does not explain, at the worst joint, N·m or N.
    effort: float


@lru_cache(maxsize=1)  # what is told of a result asks for them again and again
def distinguished_pairs(result: ExcitationResult) -> tuple[DistinguishedPair, ...]:
    """Return the pairs of a motion that is to distinguish effects, the hardest first; else none."""
    objective, motion = result.objective, result.motion
    if not isinstance(objective, Separation):
        return ()
    values = np.sqrt(objective.separations(motion)).tolist(), objective.efforts(motion).tolist()
    found = [DistinguishedPair(*entry) for entry in zip(objective.pairs, *values, strict=True)]
    return tuple(sorted(found, key=lambda pair: pair.deviations))
