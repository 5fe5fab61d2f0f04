"""Results as JSON: plain dictionaries of finite numbers and names; every null comes with a reason.

The keys of an explanation are a stable interface; more may be added, none are renamed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from geodrake.boundary.escaping import json_text
from geodrake.control.rollout import Rollout, RolloutFit
from geodrake.diagnosis.drafting import Draft
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.effects import FittedEffect
from geodrake.identification.fit import Certificate
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, Failing
from geodrake.identification.models.results import BodyChange, ModelIdentification
from geodrake.inertia import PARAMETER_NAMES
from geodrake.model.effort_signal import EffortSignal

_APART = "the robot departs further than can be simulated"
_NO_NOISE = "the logs show no sensor noise"
_UNKNOWN = "the logs do not identify it"


@dataclass(frozen=True)
class NoNumber:
    """What stands for a number that there is not: null in JSON, with the reason."""

    reason: str


def number_or(value: float | None, reason: str) -> float | NoNumber:
    """Return a finite number, or the word for one that is not."""
    return NoNumber(reason) if value is None or not math.isfinite(value) else value


def picked(value: object, *names: str) -> dict[str, Any]:
    """Return attributes of an object by their names."""
    return {name: getattr(value, name) for name in names}


def comparison_dict(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison: errors of the whole and of each joint, and where they are concentrated.

    Returns:
        `error` (nrms, floor_nrms, pooled_rms, noise_is_known), `joints` by name (rms, std, nrms,
        floor in N·m or N, removable, which is null without noise), `failing` and `notes`.
    """
    errors = comparison.errors
    return {
        "error": {
            **picked(errors, "nrms", "floor_nrms", "pooled_rms"),
            "noise_is_known": errors.knows_noise,
        },
        "joints": {
            joint.joint: {
                **picked(joint, "rms", "std", "nrms", "floor"),
                "removable": number_or(joint.removable, _NO_NOISE),
            }
            for joint in errors.joints
        },
        "failing": [_failing(case) for case in comparison.failing],
        "notes": list(comparison.notes),
    }


def diagnosis_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis: verdict, candidates from the best on, and errors before any of them."""
    return {
        "verdict": diagnosis.verdict,
        "candidates": [asdict(candidate) for candidate in diagnosis.candidates],
        "error": _errors(start=diagnosis.start, refit=diagnosis.refitted),
        "notes": list(diagnosis.notes),
    }


def explanation_dict(explanation: Explanation) -> dict[str, Any]:
    """Return an explanation: verdict, steps, and errors at the start, refitted and at the end."""
    tables = {"start": explanation.start, "refit": explanation.refitted, "end": explanation.end}
    return {
        "verdict": explanation.verdict,
        "interrupted": explanation.is_interrupted,
        "steps": [_step(step) for step in explanation.steps],
        "error": {**_errors(**tables), "of_motion": dict(explanation.of_motion)},
        "bodies": bodies_dict(explanation.bodies),
        "certificate": certificate_dict(explanation.certificate),
        "signals": [_signal(signal) for signal in explanation.model.effort_signals],
        "failing": [_failing(case) for case in explanation.after.failing],
        "notes": list(explanation.notes),
    }


def _signal(signal: EffortSignal) -> dict[str, Any]:
    """Return how a signal becomes efforts; an infinite limit is left out."""
    limit = number_or(signal.limit, "no limit is known")
    speed = number_or(signal.no_load_speed, "the limit is the same at every speed")
    return {**asdict(signal), "limit": limit, "no_load_speed": speed}


def certificate_dict(certificate: Certificate | None) -> dict[str, Any] | NoNumber:
    """Return what the MathematicalProgram of a fit says of it; the gap as a share of the cost."""
    if certificate is None:
        return NoNumber("the model stays as it is")
    return {
        **picked(certificate, "holds", "solver"),
        "gap": number_or(certificate.relative_gap, certificate.failure),
        "violation": number_or(certificate.violation, certificate.failure),
        **picked(certificate, "scope", "replaced"),
    }


def bodies_dict(bodies: Sequence[BodyChange]) -> dict[str, Any]:
    """Mass and centre of mass of bodies before and after a fit, kg and m."""
    return {
        body.name: {
            "mass": body.mass[1],
            "mass_before": body.mass[0],
            "mass_deviation": body.mass_deviation,
            "com": body.com[1],
            "com_before": body.com[0],
            **picked(body, "com_deviation", "at_boundary", "distance"),
        }
        for body in bodies
    }


def draft_dict(draft: Draft) -> dict[str, Any]:
    """Return drafted formulas: where, in words, coefficients, held-out RMS before and after."""
    return {
        "effects": [
            {
                "name": draft.names[effect.formula.joint],
                "joint": effect.formula.joint,
                "formula": effect.formula.words(),
                "coefficients": {
                    p.name: {"value": value, "deviation": deviation, "unit": p.unit}
                    for p, value, deviation in zip(
                        effect.formula.parameters,
                        effect.coefficients,
                        effect.deviations,
                        strict=True,
                    )
                },
                **picked(effect, "rms_before", "rms_after", "floor", "false_alarm_probability"),
                "indistinguishable_from": effect.rivals,
            }
            for effect in draft.effects
        ],
        "correlates": [asdict(correlate) for correlate in draft.correlates],
        "needless": [{"effect": e.name, "where": e.where} for e in draft.needless],
        "error": _errors(before=draft.before, after=draft.after),
    }


def rollout_dict(rollout: Rollout) -> dict[str, Any]:
    """Return a rollout: departures of every joint from the measured motion."""
    return {
        **picked(rollout, "under", "horizon"),
        "windows": [{"log": w.log, "start": float(w.time[0])} for w in rollout.windows],
        "broken": rollout.broken,
        "relative": number_or(rollout.relative, _APART),
        "joints": {
            joint.joint: {
                "rms": number_or(joint.rms, _APART),
                "moved": joint.moved,
                "relative": number_or(joint.relative, _APART),
                "worst": joint.worst,
            }
            for joint in rollout.joints
        },
        "notes": list(rollout.notes),
    }


def rollout_fit_dict(found: RolloutFit) -> dict[str, Any]:
    """Return a fit of rollouts: values before and after, and departures in all windows."""
    stages = {"fitted": found.fitted, "held_out": found.held_out}
    return {
        **picked(found, "taken", "chance"),
        "values": [asdict(value) for value in found.values],
        **{
            name: {"before": rollout_dict(before), "after": rollout_dict(after)}
            for name, (before, after) in stages.items()
        },
        "notes": list(found.notes),
    }


def motions_dict(motions: Sequence[Rollout] | None) -> dict[str, Any]:
    """Return rollouts under commands, by the key `motion`; nothing without commands.

    Those before and after the fit, and after each step but the last.
    """
    if motions is None:
        return {}
    before, *between, after = map(rollout_dict, motions)
    return {"motion": {"before": before, "after": after, "steps": between}}


def identification_dict(found: ModelIdentification) -> dict[str, Any]:
    """Return an identification as plain numbers, for JSON."""
    names = [joint.joint for joint in found.after.joints]
    model = found.model
    return {
        "regularizer": found.regularizer,
        "gamma": number_or(found.gamma, "any weight meets the bound on the residual"),
        "sweep": [asdict(tried) for tried in found.sweep],
        **picked(found.result, "residual", "divergence", "solver"),
        "certificate": certificate_dict(found.result.certificate),
        "error": {
            "start": found.before.by_joint(),
            "end": found.after.by_joint(),
            "floor": dict(zip(names, (j.floor for j in found.after.joints), strict=True)),
            "start_nrms": found.before.nrms,
            "end_nrms": found.after.nrms,
            "floor_nrms": found.after.floor_nrms,
        },
        "bodies": bodies_dict(found.bodies),
        "inertial_parameters": {
            body: dict(zip(PARAMETER_NAMES, phi, strict=True))
            for body, phi in zip(model.bodies, model.phi, strict=True)
        },
        "effects": [_effect_dict(fitted) for fitted in model.effects if len(fitted.parameters)],
        "comparison": [
            {
                **picked(other, "regularizer", "gamma", "residual"),
                "nrms": other.errors.nrms,
                "joints": other.errors.by_joint(),
                "at_boundary": other.at_boundary,
            }
            for other in found.alternatives
        ],
        "notes": list(found.notes),
    }


def _effect_dict(fitted: FittedEffect) -> dict[str, Any]:
    names = [parameter.name for parameter in fitted.effect.parameters]
    deviations = [None] * len(names) if fitted.deviations is None else fitted.deviations
    return {
        "effect": fitted.effect.name,
        "where": fitted.effect.where,
        "parameters": dict(zip(names, fitted.parameters, strict=True)),
        "deviations": dict(zip(names, deviations, strict=True)),
    }


def to_json(result: Mapping[str, Any]) -> str:
    """Return the text of a result; every number in it is finite, or null with a reason.

    Where there is a null, the key `nulls` says of each why: its place as a JSON pointer, such as
    `/steps/0/deviations/flange/mass`, and the reason in words.
    """
    nulls: dict[str, str] = {}
    plain = _plain(result, "", nulls)
    if nulls:
        plain["nulls"] = nulls
    return json_text(json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)) + "\n"


def _step(step: Step) -> dict[str, Any]:
    return {
        **picked(step, "effect", "where", "error_before", "error_after", "parameters"),
        **{
            kind: {
                place: {name: number_or(deviation, _UNKNOWN) for name, deviation in own.items()}
                for place, own in getattr(step, kind).items()
            }
            for kind in ("deviations", "systematic")
        },
        **picked(step, "indistinguishable_from", "probability"),
        "rivals": [
            {**asdict(rival), "probability": probability}
            for rival, probability in zip(step.rivals, step.probabilities_of_rivals, strict=True)
        ],
        **picked(step, "false_alarm_probability", "unknown_probability", "agreement"),
        **picked(step, "rms_before", "rms_after"),
    }


def _errors(**tables: ErrorTable) -> dict[str, Any]:
    """RMS by joint of several tables, then their nrms and pooled RMS; the floor is common."""
    last = list(tables.values())[-1]
    return {
        **{name: table.by_joint() for name, table in tables.items()},
        "floor": {joint.joint: joint.floor for joint in last.joints},
        **{f"{name}_nrms": table.nrms for name, table in tables.items()},
        "floor_nrms": last.floor_nrms,
        "noise_is_known": last.knows_noise,
        "pooled_rms": {name: table.pooled_rms for name, table in tables.items()},
    }


def _plain(value: Any, place: str, nulls: dict[str, str]) -> Any:
    """Return the value in dictionaries, lists, strings, Python numbers and None."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v, f"{place}/{_token(k)}", nulls) for k, v in value.items()}
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return _plain(value.tolist(), place, nulls)
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_plain(item, f"{place}/{k}", nulls) for k, item in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        value = NoNumber("was not determined" if math.isnan(value) else "is infinite")
    elif value is None:
        value = NoNumber("does not apply here")
    if isinstance(value, NoNumber):
        nulls[place] = value.reason
        return None
    return value


def _token(key: object) -> str:
    """Return a key in a JSON pointer (RFC 6901)."""
    return str(key).replace("~", "~0").replace("/", "~1")


def _failing(case: Failing) -> dict[str, Any]:
    """Return a circumstance in numbers; efforts are in N·m or N by the kind of the joint."""
    return {name: value for name, value in asdict(case).items() if name != "unit"}
