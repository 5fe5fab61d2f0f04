"""Identify a robot model from logs: inertias close to their prior, effects from the data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import function, instance, instances
from geodrake.effects import Effect, FittedEffect, Role, catalogue
from geodrake.effects.effect_columns import declares_signals
from geodrake.errors import ArgumentError, GeodrakeError, IdentificationError
from geodrake.identification.fit import FitResult
from geodrake.identification.identify import IdentificationResult, physical_prior
from geodrake.identification.logs.case import error_table, prepare_case, reduce_fitted
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.hypothesis import first_hypothesis, reweight
from geodrake.identification.logs.log_fits import GammaScore, LogFits, choose_gamma, log_unknowns
from geodrake.identification.logs.model_fit import (
    ModelFit,
    model_with,
    unfitted_errors,
    with_settled_effects,
)
from geodrake.identification.models.results import (
    Alternative,
    BodyChange,
    IdentificationSettings,
    ModelIdentification,
)
from geodrake.inertia import PARAMETERS_PER_BODY, Array, pullback_distance, to_mass_com_inertia
from geodrake.logs.motion import JointLog
from geodrake.model.holding import holding
from geodrake.model.robot_model import RobotModel

_FAR = 2.0
"""Ratio of masses from which a body's change is reported."""

_USUAL = 2.0
"""Usual change of the total mass, relative to the uncertainty of a file."""

USUAL = tuple(e.name for e in catalogue() if e.complexity == 0 and "v" in e.depends_on)
"""Effects of almost every robot, which inertias otherwise absorb."""


def changed_bodies(model: RobotModel, fit: ModelFit) -> tuple[BodyChange, ...]:
    """Return the changes of a model's bodies in a fit, the largest first."""
    changes = body_changes(model.bodies, model.phi, fit.model.phi, fit.result)
    return tuple(sorted(changes, key=lambda body: -body.distance))


def body_changes(
    names: Sequence[str], before: Array, after: Array, fit: FitResult
) -> tuple[BodyChange, ...]:
    """Return the changes of bodies (nb, 10), the first parameters of a fit."""
    covariance = fit.covariance()
    masses, com, _ = to_mass_com_inertia(np.stack([before, after], axis=1))
    distances = pullback_distance(before, after, before)
    changes = []
    for k, name in enumerate(names):
        start, (m0, m1) = k * PARAMETERS_PER_BODY, masses[k].tolist()
        block = covariance[start : start + 4, start : start + 4]
        jacobian = np.hstack([-com[k, 1][:, None], np.eye(3)]) / m1  # of h/m by [m, h]
        unknown = np.isinf(np.diagonal(block))
        known = np.where(np.isinf(block), 0.0, block)
        spread = np.einsum("ij,jk,ik->i", jacobian, known, jacobian)
        spread[unknown[1:] | unknown[0] | (spread < 0.0)] = np.inf  # negative: only rounding errors
        changes.append(
            BodyChange(
                name,
                (m0, m1),
                com[k],
                float(np.sqrt(block[0, 0])),
                np.sqrt(spread),
                start in fit.active_blocks,
                float(distances[k]),
            )
        )
    return tuple(changes)


def model_notes(model: RobotModel, bodies: Sequence[BodyChange]) -> list[str]:
    """Return notes on a fitted model: missing friction, masses far from the prior."""
    notes = []
    if not any("friction" in fitted.effect.name for fitted in model.effects):
        notes.append(
            "the model has no friction, so that inertias absorb it: fit some "
            f"(--effects {','.join(USUAL)}), or let geodrake explain find it"
        )
    distant = [
        f"{body.name} {body.mass[0]:.3g} → {body.mass[1]:.3g} kg"
        for body in bodies
        if not 1 / _FAR < body.mass[1] / body.mass[0] < _FAR
    ]
    if distant:
        notes.append(
            f"masses far from the prior ({', '.join(distant)}): unless the prior is wrong, the "
            "model lacks an effect that inertias absorb; geodrake diagnose looks for it, and a "
            "larger gamma keeps the masses closer"
        )
    return [*notes, *common_factor_notes(bodies)]


def common_factor_notes(bodies: Sequence[BodyChange]) -> list[str]:
    """Return a note if the total mass changed by more than the usual error of a file.

    A common factor of all efforts, such as currents or torques of motors, causes that.
    """
    before, after = (sum(body.mass[k] for body in bodies) for k in (0, 1))
    if before <= 0.0 or after <= 0.0 or abs(np.log(after / before)) <= _USUAL * SPREAD:
        return []
    return [
        f"these bodies weigh {after:.3g} kg instead of {before:.3g} kg: are the efforts of "
        f"all joints in N·m or N? If they were {before / after:.3g} times as large, the "
        "bodies would not change"
    ]


_MOST_ITERATIONS = 10  # largest number of refits
_SAME_INERTIA = 1e-3  # relative change of an inertia at a joint without a motor at convergence
_LOADS = frozenset({"load", "bodies"})
_NOTABLY = 0.95  # ratio of held-out errors below which a smaller γ is reported


def identify_model(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    settings: IdentificationSettings | None = None,
    *,
    effects: Sequence[Effect] = (),
    progress: Callable[[str], None] = lambda message: None,
) -> ModelIdentification:
    """Identify the inertial parameters and effects of a model, with the model as prior.

    Inertial parameters are regularized towards those of the model. Positive parameters of its
    effects, such as friction and rotor inertias, have an uncertainty of their own size in the
    regularizer's divergence on P(1) ([Lee2019] Remark 3.13). Other parameters and new effects are
    not regularized. A joint's residuals are weighted by its held-out error and scaled to effective
    samples, so that γ weighs d² against the log-likelihood: 1/γ is the variance of d.

    `effects` are fitted in addition to the model's; `progress` receives messages.

    Raises:
        ArgumentError: The model already has one of the effects, or one of its bodies is not
            physical.
        LogError: A log cannot be used.
        IdentificationError: No physical parameters reach the residual bound.
    """
    given = IdentificationSettings() if settings is None else settings
    settings = instance(given, "settings", IdentificationSettings)
    function(progress, "progress")
    instance(model, "model", RobotModel)
    model = model.with_volume
    physical_prior(model.phi, model.bodies)
    prior = with_effects(model, effects)
    case = prepare_case(
        prior,
        logs,
        candidates=False,
        bandwidth=settings.bandwidth,
        blocks=settings.blocks,
        hold_resting=settings.hold_resting and settings.total_mass is None,
    )
    if case.model.joints != prior.joints:  # some joints are held
        held = {joint: case.model.held[joint] for joint in prior.joints if joint in case.model.held}
        model, prior = holding(model, held), case.model
    prior = replace(prior, motorless=case.model.motorless)
    unknowns = log_unknowns(case.dataset, prior)
    hypothesis = reweight(first_hypothesis(case.dataset, unknowns), iterations=_MOST_ITERATIONS)
    fits = LogFits(
        case.dataset,
        unknowns,
        hypothesis.weights,
        settings.total_mass,
        near=hypothesis.held_out.x.mean(0),
        power=hypothesis.power,
    )
    gamma, sweep = settings.gamma, tuple[GammaScore, ...]()
    if settings.residual_ratio is None and gamma is None:
        progress(f"Choosing the weight of the {settings.regularizer} regularizer")
        gamma, sweep = choose_gamma(fits, settings.regularizer)
    fits, result, folds = _settled(fits, settings, gamma)
    if any(_is_friction_by_load(effect) for effect in unknowns.effects):
        # Refit with the loads of the first fit instead of the prior's.
        phi = result.phi[: len(prior.phi)]
        case = replace(reduce_fitted(case, replace(prior, phi=phi)), model=prior)
        unknowns = log_unknowns(case.dataset, prior)
        fits = replace(fits, dataset=case.dataset, unknowns=unknowns)
        fits, result, folds = _settled(fits, settings, gamma)
    alternatives, unsolved = tuple[Alternative, ...](), list[str]()
    if settings.compare and np.isfinite(result.gamma):
        progress("Comparing regularizers")
        alternatives, unsolved = _compared(fits, result, folds)
    held_out = fits.held_out(folds)
    delays = [f for f in prior.effects if f.effect.role is Role.DELAY]
    fitted = model_with(prior, unknowns, result, noise=held_out.rms, delays=delays)
    fitted = with_settled_effects(fitted)
    seen = tuple(dict.fromkeys((*prior.fitted_to, *case.fingerprints)))
    fitted = replace(fitted, fitted_to=seen, bandwidths=case.bandwidths)
    bodies = body_changes(_block_names(fits), fits.prior, result.phi, result)
    notes = [*case.notes, *model_notes(fitted, bodies), *_sweep_notes(gamma, sweep), *unsolved]
    if not np.isfinite(result.gamma):
        notes.append(
            "the model already satisfies the residual bound, so gamma is unlimited and all "
            "regularizers are equal"
        )
    return ModelIdentification(
        fitted,
        model,
        settings.regularizer,
        result.gamma,
        sweep,
        error_table(case.dataset, unfitted_errors(case.dataset, prior)),
        error_table(case.dataset, held_out),
        bodies,
        result,
        comparison(case, unknowns, held_out),
        alternatives,
        (*notes, *result.notes),
    )


def _is_friction_by_load(effect: Effect) -> bool:
    by_load = declares_signals(type(effect)) and not effect.depends_on.isdisjoint(_LOADS)
    return effect.role is Role.FORCE and effect.jumps and by_load


def _block_names(fits: LogFits) -> tuple[str, ...]:
    """Return the names of the bodies and payloads."""
    payloads = [e for e in fits.unknowns.effects if e.role is Role.BODY]
    return (*fits.dataset.bodies, *(f"payload on {e.where[0]}" for e in payloads))


def _sweep_notes(gamma: float | None, sweep: Sequence[GammaScore]) -> list[str]:
    """Return a note if a γ below the allowed ones would fit better."""
    chosen = [score.nrms for score in sweep if score.gamma == gamma]
    smaller = [score for score in sweep if gamma is not None and score.gamma < gamma]
    best = min(smaller, key=lambda score: score.nrms, default=None)
    if best is None or not chosen or best.nrms > _NOTABLY * chosen[0]:
        return []
    return [
        f"gamma {best.gamma:.3g} would lower the held-out nrms to {best.nrms:.3f}, but with "
        "inertias further from the prior than model files usually are: the model probably "
        "lacks an effect; geodrake diagnose looks for it"
    ]


def with_effects(model: RobotModel, effects: Sequence[Effect]) -> RobotModel:
    """Return the model with additional effects of zero parameters.

    Raises:
        ArgumentError: The model already has one of them.
    """
    instance(model, "model", RobotModel)
    for effect in (effects := instances(effects, "effects", Effect)):
        if any(
            (f.effect.name, f.effect.where) == (effect.name, effect.where) for f in model.effects
        ):
            raise ArgumentError(
                f"The model already has {effect.name} at {', '.join(effect.where)}.",
                advice="Effects of the model are always fitted.",
            )
    added = [FittedEffect(effect, np.zeros(len(effect.parameters))) for effect in effects]
    if not added:
        return model
    return replace(model, effects=(*model.effects, *added), information=None)


def _settled(
    fits: LogFits, settings: IdentificationSettings, gamma: float | None
) -> tuple[LogFits, IdentificationResult, list[IdentificationResult]]:
    """Return `_solved`, iterated until inertias at joints without motors converge."""
    result, folds = _solved(fits, settings, gamma)
    columns, dataset = fits.unknowns.columns, fits.dataset
    for _ in range(_MOST_ITERATIONS if dataset.passive_inertia is not None else 0):
        near = fits.near if fits.near is not None else fits.unknowns.mean
        previous, current = (dataset.inertias(columns, x) for x in (near, result.x))
        if np.abs(np.log(current / previous)).max() < _SAME_INERTIA:
            break
        fits = replace(fits, near=result.x)
        result, folds = _solved(fits, settings, gamma)
    return fits, result, folds


def _solved(
    fits: LogFits, settings: IdentificationSettings, gamma: float | None
) -> tuple[IdentificationResult, list[IdentificationResult]]:
    """Return the fits to all folds and without each fold, with one γ or each at its own bound."""
    name, ratio = settings.regularizer, settings.residual_ratio or 1.0

    def solve(without: int | None) -> IdentificationResult:
        bound = ratio**2 * fits.least_residual(without) if gamma is None else None
        certify = without is None
        return fits.solve(name, gamma=gamma, residual_bound=bound, without=without, certify=certify)

    try:
        return solve(None), [solve(f) for f in fits.folds]
    except (IdentificationError, ArgumentError) as error:
        if gamma is None:
            limit = ""
            if (least := error.evidence.get("minimum")) is not None:
                reached = np.sqrt(least / fits.least_residual())
                limit = f" Physical bodies reach about {reached:.4g}."
            raise IdentificationError(
                f"No physical parameters have an RMS residual within {ratio:g} times the "
                f"smallest of any parameters.{limit}",
                advice="Raise the bound, or use gamma instead.",
            ) from error
        if isinstance(error, ArgumentError):
            raise
        starts = dict(enumerate(_block_names(fits)))
        columns = [column // PARAMETERS_PER_BODY for column in error.evidence.get("columns", ())]
        blocks = [starts[k] for k in columns if k in starts]
        where = f" ({', '.join(blocks)})" if blocks else ""
        raise IdentificationError(
            f"The {name} regularizer with gamma {gamma:g} has no reliable solution{where}.",
            advice="Use a larger gamma; check the total mass if one is given.",
        ) from error


def _compared(
    fits: LogFits, result: IdentificationResult, folds: Sequence[IdentificationResult]
) -> tuple[tuple[Alternative, ...], list[str]]:
    """Return all regularizers at the residual of a fit, and notes on those without a solution.

    `folds` are the same fit without each fold.
    """
    names, alternatives = _block_names(fits), list[Alternative]()
    compared = fits.compare(result.regularizer, result.gamma)
    failures = dict(compared.failures)
    for name, fit in compared.results.items():
        try:
            parts = folds
            if name != result.regularizer:
                parts = [fits.solve(name, gamma=fit.gamma, without=f) for f in fits.folds]
        except GeodrakeError as error:
            failures[name] = f"Without one fold: {error}"
            continue
        errors = error_table(fits.dataset, fits.held_out(parts))
        boundary = tuple(names[start // PARAMETERS_PER_BODY] for start in fit.active_blocks)
        phi = fit.phi[: len(fits.dataset.bodies)]
        alternatives.append(Alternative(name, fit.gamma, fit.residual, errors, phi, boundary))
    notes = [
        f"the {name} regularizer has no solution to compare: {failures[name]}" for name in failures
    ]
    return tuple(alternatives), notes
