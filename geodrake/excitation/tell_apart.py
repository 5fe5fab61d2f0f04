"""Motions that distinguish two effects which logs so far could not.

    limits = motion_limits(model, acceleration=5.0)
    rivals = [make_rival(name, model, limits) for name in ("coulomb_friction", "viscous_friction")]
    separation = make_separation(model, *rivals, noise=0.1)
    result = design_separation(separation, limits, trajectory=FourierMotion(10.0, 5))

Two effects are as far apart as `geodrake.excitation.separation` says. Whatever else a fit may move,
it may move in both: the inertias, near what is known of them, and all other effects of the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from geodrake.boundary.arguments import instance, positive
from geodrake.effects import Effect, FittedEffect
from geodrake.errors import ArgumentError
from geodrake.excitation.criteria import Criterion
from geodrake.excitation.design import design_objective
from geodrake.excitation.design_results import DesignOptions, DesignProgress, ExcitationResult
from geodrake.excitation.families import MotionFamily
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.rivals import Rival, imitations, known_sizes, typical_sizes
from geodrake.excitation.separation import Pair, Separation
from geodrake.excitation.target import Target, make_target
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_LOOSE = 1e-4  # of what is known, where that shall not matter
_SAME = 1e-8  # share of an effect's squared effort that is rounding alone


def make_separation(
    model: RobotModel,
    first: Rival,
    second: Rival,
    *,
    noise: ArrayLike | None = None,
    sign_width: ArrayLike | None = None,
    spread: float = SPREAD,
) -> Separation:
    """What distinguishing two effects of a robot amounts to.

    Args:
        model: The robot. Its other effects may be refitted within what is known of them; if it has
            one of the rivals, that one's parameters say how large it is, and the other one is as
            large as it must be to be taken for it. Rivals of unknown size have a usual one.
        sign_width: Speed over which friction changes sign, as for `make_target`.
        spread: Relative uncertainty of a model file's inertias, as a geometric distance.

    Raises:
        ArgumentError: Both are the same effect, or mean the same whatever the motion; or the noise
            is not positive.
    """
    instance(model, "model", RobotModel)
    for name, rival in (("first", first), ("second", second)):
        instance(rival, name, Rival)
    positive(spread, "spread")
    rivals = (*first.effects, *second.effects)
    if set(first.effects) & set(second.effects):
        raise ArgumentError(
            f"{first.name} cannot be distinguished from itself.",
            advice="Name two different effects.",
        )
    common = [f for f in model.effects if f.effect not in rivals and len(f.effect.parameters)]
    unknown = [FittedEffect(effect, np.zeros(len(effect.parameters))) for effect in rivals]
    target = make_target(model, noise=noise, effects=[*common, *unknown], sign_width=sign_width)
    columns = _columns(target)
    sizes = _sizes(target, model, (first, second))
    base = np.concatenate(
        [np.arange(PARAMETERS_PER_BODY * len(target.bodies)), *(columns[f.effect] for f in common)]
    ).astype(np.intp)
    pairs = []
    for truth, rival in ((first, second), (second, first)):
        for alternative in truth.alternatives:
            for other in rival.alternatives:
                used = np.concatenate([base, *(columns[effect] for effect in other)])
                for effect in alternative:
                    robots = np.zeros((len(sizes[effect]), target.size))
                    robots[:, columns[effect]] = sizes[effect]
                    words = (_words(truth, effect), _words(rival, other[0]))
                    pairs.append(Pair(*words, effect.where, robots, used.astype(np.intp)))
    prior, lower, upper = np.zeros((len(base), target.size)), *_bounds(target, columns, common)
    prior[:, base] = _root(_information(model, common, spread))
    every = Separation(
        target, Criterion("e_optimality"), "none", None, tuple(pairs), prior, lower, upper
    )
    return replace(every, pairs=_different(every))


def _different(separation: Separation) -> tuple[Pair, ...]:
    """The pairs of which one is not wholly explained by the other, whatever the motion.

    An effect that contains another one explains it: these can be distinguished one way only.

    Raises:
        ArgumentError: There is no such pair.
    """
    motion = separation.target.random_motion
    loose = replace(separation, prior=_LOOSE * separation.prior)
    alone = replace(loose, pairs=tuple(replace(p, columns=p.columns[:0]) for p in loose.pairs))
    shares = loose.separations(motion) / np.maximum(alone.separations(motion), 1e-300)
    kept = tuple(p for p, share in zip(loose.pairs, shares, strict=True) if share > _SAME)
    if not kept:
        pair = separation.pairs[0]
        raise ArgumentError(
            f"{pair.rival} and {pair.truth} mean the same on every motion.",
            advice="Ask for a pair that differs, or for another place.",
        )
    return kept


def _words(rival: Rival, effect: Effect) -> str:
    """Name of an effect, with its shape if it may have several."""
    if len(rival.alternatives) == 1:
        return rival.name
    shape = ", ".join(f"{name} {value:.3g}" for name, value in effect.shape.items())
    return f"{rival.name} ({shape})"


def _columns(target: Target) -> dict[Effect, NDArray[np.intp]]:
    """Columns of every effect of a target."""
    found, at = {}, PARAMETERS_PER_BODY * len(target.bodies)
    for fitted in target.effects:
        count = len(fitted.effect.parameters)
        found[fitted.effect] = np.arange(at, at + count)
        at += count
    return found


def _sizes(target: Target, model: RobotModel, rivals: Sequence[Rival]) -> dict[Effect, Array]:
    """(r, k) parameters of r robots that have an effect, for every rival effect."""
    every = [effect for rival in rivals for effect in rival.effects]
    known, typical = known_sizes(model, every), typical_sizes(target)
    found = {effect: value[None] for effect, value in known.items()}
    for rival, other in zip(rivals, reversed(rivals), strict=True):
        for effect in rival.effects:
            if effect in found:
                continue
            found[effect] = (
                np.diag(typical[effect]) if not is_payload(effect) else typical[effect][None]
            )
            for counterpart in other.effects:
                shared = set(effect.where) & set(counterpart.where) or not effect.where
                if counterpart in known and shared:
                    like = imitations(target, counterpart, known[counterpart], effect)
                    if like is not None:
                        found[effect] = like[None]
    return found


def _bounds(
    target: Target, columns: dict[Effect, NDArray[np.intp]], common: Sequence[FittedEffect]
) -> tuple[Array, Array]:
    """(p,) least and greatest change of every parameter from its nominal value."""
    lower, upper = np.full(target.size, -np.inf), np.full(target.size, np.inf)
    nominal = {fitted.effect: fitted.parameters for fitted in common}
    for effect, at in columns.items():
        value = nominal.get(effect, np.zeros(len(at)))
        lower[at] = np.minimum([p.lower for p in effect.parameters] - value, 0.0)
        upper[at] = np.maximum([p.upper for p in effect.parameters] - value, 0.0)
    return lower, upper


def _information(model: RobotModel, common: Sequence[FittedEffect], spread: float) -> Array:
    """(b, b) what is known of the inertias and of the common effects, whatever the others are."""
    if model.information is None:
        sizes = [np.diag(1.0 / np.maximum(f.parameters**2, 1e-12)) for f in common]
        return np.asarray(block_diag(pullback_information(model.phi, spread), *sizes))
    kept = np.ones(len(model.information), bool)
    at, wanted = model.phi.size, {fitted.effect for fitted in common}
    for fitted in model.effects:
        count = len(fitted.effect.parameters)
        kept[at : at + count] = fitted.effect in wanted
        at += count
    known, rest = model.information[np.ix_(kept, kept)], model.information[np.ix_(~kept, ~kept)]
    cross = model.information[np.ix_(kept, ~kept)]
    return np.asarray(known - cross @ np.linalg.pinv(rest, hermitian=True) @ cross.T)


def _root(information: Array) -> Array:
    """Rows whose product RᵀR is an information matrix; units are scaled out first."""
    sizes = np.sqrt(np.maximum(np.diag(information), 0.0))
    sizes = np.where(sizes > 0, sizes, 1.0)
    values, vectors = np.linalg.eigh(information / sizes[:, None] / sizes)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * sizes)


def design_separation(
    separation: Separation,
    limits: MotionLimits | None = None,
    *,
    trajectory: MotionFamily | None = None,
    options: DesignOptions | None = None,
    seeds: int | Sequence[int] = 3,
    progress: Callable[[DesignProgress], None] | None = None,
) -> ExcitationResult:
    """The motion within limits that distinguishes rivals best.

    Args:
        limits: What the robot may do; the limits of its model file if None.
        trajectory: The family of motions; a Fourier series of 10 s if None.

    Returns:
        The motion; its objective is the separation, and its eigenvalues are those Δ.

    Raises:
        ArgumentError: As `design_excitation`, or on no motion the rivals differ.
    """
    return design_objective(
        separation,
        limits,
        trajectory=trajectory,
        options=options,
        seeds=seeds,
        progress=progress,
    )
