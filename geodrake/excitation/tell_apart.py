"""Motions that distinguish two effects when existing logs cannot.

    limits = motion_limits(model, bounded=True)
    rivals = [make_rival(name, model, limits) for name in names_of_two_effects]
    separation = make_separation(model, *rivals, noise=0.1)
    result = design_excitation(separation, limits, trajectory=FourierMotion(10.0, 5))

If a robot has effect A with parameters α, the best explanation by effect B leaves the residual

    Δ = min over θ, β of ‖X_A α − X θ − X_B β‖² + θᵀ Λ θ     (T-optimality)

with regressors whitened by the noise. θ contains all other parameters (the inertias and the other
effects of the model), Λ their prior precision. While no bound on β is active, Δ = αᵀ S α with the
Schur complement S of the information matrix of (θ, β, α). A and B differ by √Δ standard deviations.

At the minimum over θ and β, only the explicit change of the regressors matters: with the residual e
and the coefficients x = (−θ, −β, α) of all columns, ∂Δ/∂X = 2 e xᵀ. A gradient therefore costs as
much as that of an information criterion.

Samples where the direction of a joint is uncertain are weighted by sgn², as dry friction is not
modelled there and a diagnosis excludes them. Efforts at the base of a robot on several feet include
those of all legs, so the signs of all joints that may have the effects count there.
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
"""Separation √Δ from which a log distinguishes effects reliably."""

Placed = tuple[str, tuple[str, ...]]  # an effect's name and place, which may be empty

_SIGN_SHARE = 0.02  # of the velocity limit, over which friction changes sign
_LEAST = 1e-12  # negligible separation per sample
_ALIKE = 0.1  # least share of an effect's effort that an imitation must produce
_LOOSE = 1e-4  # factor on the prior rows where the prior should not matter
_SAME = 1e-8  # share of an effect's squared effort attributed to rounding


@dataclass(frozen=True)
class Rival(Short):
    """One of two effects to distinguish."""

    name: str
    # For each candidate shape, the effect at each of its places.
    alternatives: tuple[tuple[Effect, ...], ...]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects of all alternatives."""
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
    """Return the named effect at one place or at all possible places.

    Args:
        model: The robot; an effect of the model keeps its shape.
        limits: Limits whose velocities scale the candidate shapes.
        where: One place; all joints, or pairs of joints, if empty.
        shape: Shape parameters by name. If None, those of the model, otherwise the defaults,
            otherwise all candidates of a diagnosis.
    """
    instance(model, "model", RobotModel)
    instance(limits, "limits", MotionLimits)
    where = instances(where, "where", str)
    cls = effect_class(name, extra)
    if not getattr(cls, "parameters", ()):
        raise ArgumentError(
            f"{name} has no linear parameters, so no motion can be designed for it.",
            advice="Use geodrake diagnose to find it.",
        )
    places = [tuple(where)] if where else every_place(cls, model)
    speed = dict(zip(limits.joints, limits.velocity.tolist(), strict=True))
    known = {(f.effect.name, f.effect.where): f.effect for f in model.effects}
    body = cls.places == "body"
    kind, known_names = ("body", model.bodies) if body else ("joint", model.joints)
    per_place: list[tuple[Effect, ...]] = []
    for place in places:
        if shape is None and (name, place) in known:
            per_place.append((known[name, place],))
            continue
        for part in place:
            one_of(part, kind, known_names)
        try:
            per_place.append((make_effect(name, place, shape, extra),))
        except ArgumentError:
            if shape is not None or cls.places != "joint":
                raise
            per_place.append(candidates_of(cls, place[0], speed[place[0]]))
    count = max(len(effects) for effects in per_place)
    padded = [effects * count if len(effects) == 1 else effects for effects in per_place]
    if any(len(effects) != count for effects in padded):
        raise ArgumentError(
            f"{name} has different shapes at different joints.",
            advice=f"Use one joint at a time, such as {name}@{places[0][0]}.",
        )
    return Rival(name, tuple(zip(*padded, strict=True)))


def every_place(cls: type[Effect], model: RobotModel) -> list[tuple[str, ...]]:
    """Return all places where the robot can have the effect."""
    if cls.places == "robot":
        return [()]
    if cls.places == "joint":
        excluded = (*model.base_joints, *(model.sliding_joints if cls.turning_only else ()))
        return [(joint,) for joint in model.single_joints if joint not in excluded]
    if cls.places == "joint_pair":
        return [pair for pair in model.joint_pairs if not {*pair}.intersection(model.base_joints)]
    advice = f"Find it with geodrake add {cls.name} MODEL LOG --save model.yaml."
    if cls.places == "body":
        advice = f"Give its body: {cls.name}@{model.bodies[-1]}."
    raise ArgumentError(f"{cls.name} needs a place.", advice=advice)


@dataclass(frozen=True, eq=False)
class Pair(Short):
    """A true effect at a place and a rival that may explain it."""

    truth: str  # name of the true effect
    rival: str  # name of the effect fitted to it
    where: tuple[str, ...]
    # (r, p) coefficients of r robots, whose separations are summed: one robot if the parameters
    # are known, otherwise one for each parameter.
    effects: Array
    columns: Indices  # (c,) columns of the explanation: common parameters and the rival


@dataclass(frozen=True, eq=False)
class Separation(Objective):
    """A criterion that maximizes the smallest separation of several pairs.

    Separations take the place of the eigenvalues of an information matrix: E-optimality is 1/Δ of
    the pair that is hardest to distinguish, smoothed as in `Criterion`.

    Attributes:
        prior: (q, p) rows Λ^½ of the prior precision.
        lower: (p,) lower bounds of each column's parameter, relative to its nominal value.
        upper: (p,) upper bounds.
        fading: Speeds over which friction changes sign, for the joints that may have the effects
            and follow a base on its feet.
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
                "In every column, lower must not exceed upper, and neither may be NaN."
            )

    def separations(self, motion: Motion) -> Array:
        """Return Δ (K,) of every pair over all samples, in squared standard deviations."""
        measurement = self.target.measure(motion)
        return self._solve(measurement)[0]

    def efforts(self, motion: Motion) -> Array:
        """Return the RMS unexplained effort (K,) of every pair, at the worst joint."""
        measurement = self.target.measure(motion)
        signs, values = np.abs(self._signs(measurement))[..., None], []
        for solutions in self._solve(measurement)[1]:
            residual = measurement.regressor @ solutions.T * signs
            values.append(float(np.sqrt(np.mean(np.square(residual).sum(2), axis=0)).max()))
        return np.array(values)

    def imitation(self, motion: Motion, pair: int) -> tuple[Array, Array]:
        """Return a pair's true effort (N, nv), and the rival's best imitation of it.

        If the pair has several robots, these belong to the one that the rival explains worst.
        """
        measurement = self.target.measure(motion)
        solutions = self._solve(measurement)[1][pair]
        residual = measurement.regressor @ solutions.T
        worst = int(np.argmax(np.square(residual / self.target.noise[:, None]).sum((0, 1))))
        truth = measurement.regressor @ self.pairs[pair].effects[worst]
        return truth, truth - residual[:, :, worst]

    def eigenvalues(self, motion: Motion) -> Array:
        """Return the separations (K,), ascending."""
        return np.sort(self.separations(motion))

    def value_and_gradient(self, motion: Motion) -> tuple[float, MotionGradient]:
        """Return the criterion to minimize, and its gradient with respect to the motion."""
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
        x, signs, noise = np.concatenate(solutions), self._signs(measurement), self.target.noise
        residual = (measurement.regressor / noise[:, None]) @ x.T  # (N, nv, robots)
        weights = (residual * signs[..., None] ** 2) @ (2.0 * gains[:, None] * x)
        gradient = regressor_motion_gradient(self.target, measurement, weights / noise[:, None])
        by_signs = 2.0 * signs * (np.square(residual) @ gains)
        sign_slope = 1.0 - signs**2
        sign_slope[:, self._base] = 0.0
        gradient.v[:] += by_signs * sign_slope / self.target.sign_width
        if self.fading:
            by_legs = (by_signs * signs)[:, self._base].sum(axis=1)
            gradient = gradient.plus(self._by_legs(motion, by_legs))
        return value, gradient

    def _by_legs(self, motion: Motion, weights: Array) -> MotionGradient:
        """Return the gradient of Σ w log Π s, w (N,), with the signs s of dependent joints."""
        (legs, width), rows = self._legs, np.zeros((3, len(motion), len(self.fading)))
        G = legs.jacobian(motion.q)
        sign = np.tanh(times(G, motion.v) / width)
        slope = (1.0 - sign**2) / (width * np.where(sign == 0.0, 1.0, sign))
        rows[1] = weights[:, None] * slope
        return at_actuators(legs, G, motion, MotionGradient(*rows))

    @cached_property
    def _legs(self) -> tuple[MotorCoordinates, Array]:
        """The map to the dependent joints, and their fading speeds."""
        joints = MotorCoordinates(self.target.model.coordinates, tuple(self.fading))
        return joints, np.array([*self.fading.values()])

    @cached_property
    def _base(self) -> Indices:
        """Indices of the joints of a base on its feet."""
        model = self.target.model
        return np.flatnonzero(np.isin(model.joints, model.base_joints))

    def _signs(self, measurement: Measurement) -> Array:
        """Return the smoothed signs (N, nv) of joint velocities, the roots of sample weights."""
        motion, (legs, width) = measurement.motion, self._legs
        signs = np.tanh(motion.v / self.target.sign_width)
        signs[:, self._base] = 1.0
        if self.fading:
            v = times(legs.jacobian(motion.q), motion.v)
            signs[:, self._base] = np.tanh(v / width).prod(axis=1, keepdims=True)
        return signs

    def _solve(self, measurement: Measurement) -> tuple[Array, list[Array]]:
        """Return separations (K,), and each pair's coefficients (r, p) of the residual."""
        signs = self._signs(measurement)[..., None]
        rows = measurement.regressor * (signs / self.target.noise[:, None])
        rows = rows.reshape(-1, rows.shape[2])
        R = np.asarray(np.linalg.qr(np.concatenate([rows, self.prior]), mode="r"))
        first, empty = self._robots, np.zeros((0, R.shape[1]))
        robots = np.concatenate([empty, *(pair.effects for pair in self.pairs)])
        for columns, members in self._groups.items():
            index = np.array(columns, np.intp)
            entries = np.array(members)[:, None], index
            robots[entries] -= self._explained(R, index, R @ robots[members].T)
        squares = np.square(R @ robots.T).sum(axis=0)
        return np.add.reduceat(squares, first[:-1]), np.split(robots, first[1:-1])

    @cached_property
    def _robots(self) -> Indices:
        """(K + 1,) index of the first robot of every pair, and the number of robots."""
        return np.cumsum([0, *(len(pair.effects) for pair in self.pairs)])

    @cached_property
    def _groups(self) -> dict[tuple[int, ...], list[int]]:
        """Columns -> indices of the robots whose explanations use them."""
        groups: dict[tuple[int, ...], list[int]] = {}
        for pair, first in zip(self.pairs, self._robots.tolist(), strict=False):
            indices = range(first, first + len(pair.effects))
            groups.setdefault(tuple(pair.columns.tolist()), []).extend(indices)
        return groups

    def _explained(self, R: Array, columns: Indices, targets: Array) -> Array:
        """Return the bounded least-squares coefficients (r, c) of columns for targets (q, r)."""
        A = R[:, columns]
        sizes = np.linalg.norm(A, axis=0)
        sizes = np.where(sizes > 0, sizes, 1.0)
        A, low, high = A / sizes, self.lower[columns] * sizes, self.upper[columns] * sizes
        solution = np.asarray(np.linalg.lstsq(A, targets)[0].T)
        outside = np.flatnonzero(((solution < low) | (solution > high)).any(axis=1))
        if not len(outside):
            return solution / sizes
        # Eliminate the unbounded columns first: the bounded problem is then small.
        bound = np.isfinite(low) | np.isfinite(high)
        free, count = A[:, ~bound], int(np.count_nonzero(bound))
        outputs = np.concatenate([A[:, bound], targets[:, outside]], axis=1)
        shares = np.linalg.lstsq(free, outputs)[0]
        factor = np.asarray(np.linalg.qr(outputs - free @ shares, mode="r"))
        for row, k in enumerate(outside, count):
            bounds = low[bound], high[bound]
            x = lsq_linear(factor[:, :count], factor[:, row], bounds, method="bvls").x
            solution[k, bound], solution[k, ~bound] = x, shares[:, row] - shares[:, :count] @ x
        return solution / sizes


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
        model: The robot. Its other effects may be refitted within their priors. A rival that the
            model has keeps its parameters, and the other rival is fitted to it. Rivals of unknown
            size get typical parameters.
        sign_width: Speed over which friction changes sign, as for `make_target`.
        spread: Relative uncertainty of a model file's inertias, as a geometric distance.
        stance: The feet on which the robot stands; the model is then that of the stance.
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
    indices = np.arange(target.size)
    spans = zip(target.effects, target.spans, strict=True)
    columns = {fitted.effect: indices[span] for fitted, span in spans}
    sizes = _sizes(target, model, (first, second))
    bodies = indices[: PARAMETERS_PER_BODY * len(target.bodies)]
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
    """Return the speed over which friction changes sign for each joint that follows a base."""
    behind, fading = stance.model.coordinates.behind, dict[str, float]()
    speeds = dict(zip(stance.motors, stance.motor_limits.velocity.tolist(), strict=True))
    for effect in effects:
        joints = [joint for joint in effect.where if joint in behind]
        if joints and (effect.role is not Role.FORCE or "load" in effect.depends_on):
            raise ArgumentError(
                f"{effect.name} of {', '.join(joints)} depends on the load there, which the motors "
                "of a robot on several feet share.",
                advice="Name one foot, or use effects of positions, speeds and accelerations.",
            )
        fading |= {joint: _SIGN_SHARE * speeds[joint] for joint in joints if joint in speeds}
    return fading


def placed_rivals(
    model: RobotModel,
    first: Placed,
    second: Placed,
    limits: MotionLimits,
    *,
    extra: Sequence[type[Effect]] = (),
) -> tuple[Rival, Rival]:
    """Return two effects at their places; a place given once counts for both if it suits both."""
    (name, place), (other, other_place) = first, second
    if effect_class(name, extra).places == effect_class(other, extra).places:
        place, other_place = place or other_place, other_place or place
    return (
        make_rival(name, model, limits, where=place, extra=extra),
        make_rival(other, model, limits, where=other_place, extra=extra),
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
    """Return the objective that distinguishes two effects, and notes for the user.

    Args:
        limits: Limits of the robot's motors.
        stance: The feet on which it stands.
    """
    rivals = placed_rivals(model, first, second, limits, extra=extra)
    if stance is not None:
        model, limits = stance.model, stance.limits()
    width = _SIGN_SHARE * limits.velocity
    separation = make_separation(model, *rivals, noise=noise, sign_width=width, stance=stance)
    named = {pair.truth.partition(" (")[0] for pair in separation.pairs}
    notes = [
        f"{other.name} can explain any effort of {rival.name}, so only the reverse can be tested"
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
    """Return the pairs whose rival does not fully explain the truth on every motion.

    An effect that contains another one explains it, so such a pair is kept in one direction only.
    """
    motion = separation.target.random_motion
    loose = replace(separation, prior=_LOOSE * separation.prior)
    total = replace(loose, pairs=tuple(replace(p, columns=p.columns[:0]) for p in loose.pairs))
    shares = loose.separations(motion) / np.maximum(total.separations(motion), 1e-300)
    kept = tuple(p for p, share in zip(loose.pairs, shares, strict=True) if share > _SAME)
    if not kept:
        pair = separation.pairs[0]
        raise ArgumentError(
            f"{pair.rival} and {pair.truth} are equivalent on every motion.",
            advice="Use another pair, or another place.",
        )
    return kept


def _words(rival: Rival, effect: Effect) -> str:
    """Return the name of an effect, with its shape if it has several candidates."""
    if len(rival.alternatives) == 1:
        return rival.name
    shape = ", ".join(f"{name} {value:.3g}" for name, value in effect.shape.items())
    return f"{rival.name} ({shape})"


def _sizes(target: Target, model: RobotModel, rivals: Sequence[Rival]) -> dict[Effect, Array]:
    """Return the parameters (r, k) of r robots for every rival effect."""
    known = {f.effect: f.parameters for f in model.effects if np.any(f.parameters)}
    typical = {fitted.effect: fitted.parameters for fitted in sized_effects(target)}
    sizes = {}
    for rival, other in zip(rivals, reversed(rivals), strict=True):
        for effect in rival.effects:
            size = known.get(effect, typical[effect] if is_payload(effect) else None)
            sizes[effect] = np.diag(typical[effect]) if size is None else size[None]
            for counterpart in other.effects if effect not in known else ():
                shared = set(effect.where) & set(counterpart.where) or not effect.where
                if counterpart in known and shared:
                    size = _imitation(target, counterpart, known[counterpart], effect)
                    sizes[effect] = sizes[effect] if size is None else size[None]
    return sizes


def _bounds(
    target: Target, columns: dict[Effect, NDArray[np.intp]], common: Sequence[FittedEffect]
) -> tuple[Array, Array]:
    """Return the bounds (p,) of every parameter relative to its nominal value."""
    lower, upper = np.full(target.size, -np.inf), np.full(target.size, np.inf)
    nominal = {fitted.effect: fitted.parameters for fitted in common}
    for effect, index in columns.items():
        value = nominal.get(effect, np.zeros(len(index)))
        lower[index] = np.minimum([p.lower for p in effect.parameters] - value, 0.0)
        upper[index] = np.maximum([p.upper for p in effect.parameters] - value, 0.0)
    return lower, upper


def _information(model: RobotModel, common: Sequence[FittedEffect], spread: float) -> Array:
    """Return the prior precision (b, b) of inertias and common effects, the others marginalized."""
    selected = {fitted.effect for fitted in common}
    counts = [model.phi.size, *(len(fitted.effect.parameters) for fitted in model.effects)]
    kept = np.repeat([True, *(fitted.effect in selected for fitted in model.effects)], counts)
    information = known_information(model, spread=spread)
    common_block, other_block = (information[np.ix_(mask, mask)] for mask in (kept, ~kept))
    cross = information[np.ix_(kept, ~kept)]
    return np.asarray(common_block - cross @ np.linalg.pinv(other_block, hermitian=True) @ cross.T)


def _root(information: Array) -> Array:
    """Return R with RᵀR the information matrix, whose units are scaled out first."""
    diagonal = np.diag(information)
    sizes = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / sizes[:, None] / sizes)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * sizes)


def _imitation(target: Target, truth: Effect, size: Array, rival: Effect) -> Array | None:
    """Return the rival's parameters (k,) that best imitate a known effect on random motion.

    They are within bounds; None if the effects are unrelated.
    """
    seen = target.measure(target.random_motion).seen
    if seen is None:
        return None
    effort = (truth.regressor(seen) @ size).ravel()
    columns = rival.regressor(seen).reshape(len(effort), -1)
    bounds = tuple(np.array([getattr(p, s) for p in rival.parameters]) for s in ("lower", "upper"))
    x = np.asarray(lsq_linear(columns, effort, bounds).x)
    return x if np.linalg.norm(columns @ x) > _ALIKE * np.linalg.norm(effort) else None


@dataclass(frozen=True)
class DistinguishedPair:
    """The separation of a pair of effects on a designed motion."""

    pair: Pair
    deviations: float  # √Δ over all samples, in standard deviations of the noise
    effort: float  # RMS unexplained effort at the worst joint, N·m or N


@lru_cache(maxsize=1)  # summaries of a result call it repeatedly
def distinguished_pairs(result: ExcitationResult) -> tuple[DistinguishedPair, ...]:
    """Return the pairs of a motion designed to distinguish effects, the hardest first."""
    objective, motion = result.objective, result.motion
    if not isinstance(objective, Separation):
        return ()
    values = np.sqrt(objective.separations(motion)).tolist(), objective.efforts(motion).tolist()
    pairs = [DistinguishedPair(*entry) for entry in zip(objective.pairs, *values, strict=True)]
    return tuple(sorted(pairs, key=lambda pair: pair.deviations))
