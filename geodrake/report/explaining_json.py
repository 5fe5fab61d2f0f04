"""Comparisons, diagnoses, explanations and identifications in numbers: JSON, and rows of tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from geodrake.diagnosis.drafting import Draft
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.effects import FittedEffect
from geodrake.identification.fit import Certificate
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, Failing
from geodrake.identification.models.results import BodyChange, ModelIdentification
from geodrake.inertia import PARAMETER_NAMES
from geodrake.model.effort_signal import EffortSignal
from geodrake.report.json_output import NoNumber, finite, number_or, picked
from geodrake.report.page import Records

_NO_NOISE = "the logs show no sensor noise"
_UNKNOWN = "the logs do not identify it"


def comparison_dict(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison: errors of the whole and of each joint, and where they are large."""
    errors = comparison.errors
    totals = ("nrms", "floor_nrms", "pooled_rms")
    return {
        "error": picked(errors, *totals, noise_is_known="knows_noise"),
        "joints": {
            joint.joint: {
                **picked(joint, "rms", "std", "nrms", "floor"),
                **finite(joint, _NO_NOISE, "removable"),
            }
            for joint in errors.joints
        },
        "failing": _failing(comparison.failing),
        "notes": comparison.notes,
    }


def error_records(comparison: Comparison) -> Records:
    """Return a row for each joint."""
    names = ("joint", "std", "rms", "floor", "nrms", "removable")
    return [picked(joint, *names) for joint in comparison.errors.joints]


def diagnosis_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis: verdict, candidates from the best on, and errors before any of them."""
    return {
        **picked(diagnosis, "verdict", "candidates"),
        "error": _errors(start=diagnosis.start, refit=diagnosis.refitted),
        "notes": diagnosis.notes,
    }


def explanation_dict(explanation: Explanation) -> dict[str, Any]:
    """Return an explanation: verdict, steps, and errors at the start, refitted and at the end."""
    tables = {"start": explanation.start, "refit": explanation.refitted, "end": explanation.end}
    return {
        **picked(explanation, "verdict", interrupted="is_interrupted"),
        "steps": [_step(step) for step in explanation.steps],
        "error": {**_errors(**tables), "of_motion": explanation.of_motion},
        "bodies": _bodies(explanation.bodies),
        "certificate": _certificate(explanation.certificate),
        "signals": [_signal(signal) for signal in explanation.model.effort_signals],
        "failing": _failing(explanation.after.failing),
        "notes": explanation.notes,
    }


def step_records(found: Explanation) -> Records:
    """Return a row for each parameter of each step."""
    return [
        {
            **picked(step, "effect"),
            "where": where,
            "parameter": name,
            "value": value,
            "deviation": step.deviations.get(where, {}).get(name),
            **picked(step, "error_before", "error_after", "probability"),
        }
        for step in found.steps
        for where, values in step.parameters.items()
        for name, value in values.items()
    ]


def _signal(signal: EffortSignal) -> dict[str, Any]:
    """Return how a signal becomes efforts; an infinite limit is left out."""
    limit = number_or(signal.limit, "no limit is known")
    speed = number_or(signal.no_load_speed, "the limit is the same at every speed")
    return {**asdict(signal), "limit": limit, "no_load_speed": speed}


def _certificate(certificate: Certificate | None) -> dict[str, Any] | NoNumber:
    """Return what the MathematicalProgram of a fit says of it; the gap as a share of the cost."""
    if certificate is None:
        return NoNumber("the model stays as it is")
    return {
        **picked(certificate, "holds", "solver"),
        "gap": number_or(certificate.relative_gap, certificate.failure),
        "violation": number_or(certificate.violation, certificate.failure),
        **picked(certificate, "scope", "replaced"),
    }


def _bodies(bodies: Sequence[BodyChange]) -> dict[str, Any]:
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
    found = []
    for effect in draft.effects:
        values = zip(effect.formula.parameters, effect.coefficients, effect.deviations, strict=True)
        found.append(
            {
                "name": draft.names[effect.formula.joint],
                "joint": effect.formula.joint,
                "formula": effect.formula.words(),
                "coefficients": {
                    p.name: {"value": value, "deviation": deviation, "unit": p.unit}
                    for p, value, deviation in values
                },
                **picked(effect, "rms_before", "rms_after", "floor", "false_alarm_probability"),
                "indistinguishable_from": effect.rivals,
            }
        )
    return {
        "effects": found,
        "correlates": draft.correlates,
        "needless": [picked(effect, "where", effect="name") for effect in draft.needless],
        "error": _errors(before=draft.before, after=draft.after),
    }


def identification_dict(found: ModelIdentification) -> dict[str, Any]:
    """Return an identification as plain numbers, for JSON."""
    after, model = found.after, found.model
    return {
        "regularizer": found.regularizer,
        "gamma": number_or(found.gamma, "any weight meets the bound on the residual"),
        "sweep": found.sweep,
        **picked(found.result, "residual", "divergence", "solver"),
        "certificate": _certificate(found.result.certificate),
        "error": {
            "start": found.before.by_joint(),
            "end": after.by_joint(),
            "floor": {joint.joint: joint.floor for joint in after.joints},
            "start_nrms": found.before.nrms,
            **picked(after, end_nrms="nrms", floor_nrms="floor_nrms"),
        },
        "bodies": _bodies(found.bodies),
        "inertial_parameters": {
            body: dict(zip(PARAMETER_NAMES, phi, strict=True))
            for body, phi in zip(model.bodies, model.phi, strict=True)
        },
        "effects": [_effect(fitted) for fitted in model.effects if len(fitted.parameters)],
        "comparison": [
            {
                **picked(other, "regularizer", "gamma", "residual"),
                "nrms": other.errors.nrms,
                "joints": other.errors.by_joint(),
                "at_boundary": other.at_boundary,
            }
            for other in found.alternatives
        ],
        "notes": found.notes,
    }


def body_records(found: ModelIdentification) -> Records:
    """Return a row for each body."""
    return [
        {
            "body": body.name,
            "mass_before": body.mass[0],
            "mass": body.mass[1],
            "mass_deviation": body.mass_deviation,
            **{
                f"com_{axis}{end}": float(body.com[k][i])
                for k, end in enumerate(("_before", ""))
                for i, axis in enumerate("xyz")
            },
        }
        for body in found.bodies
    ]


def _effect(fitted: FittedEffect) -> dict[str, Any]:
    names = [parameter.name for parameter in fitted.effect.parameters]
    deviations = [None] * len(names) if fitted.deviations is None else fitted.deviations
    return {
        "effect": fitted.effect.name,
        "where": fitted.effect.where,
        "parameters": dict(zip(names, fitted.parameters, strict=True)),
        "deviations": dict(zip(names, deviations, strict=True)),
    }


def _step(step: Step) -> dict[str, Any]:
    rivals = zip(step.rivals, step.probabilities_of_rivals, strict=True)
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
        "rivals": [{**asdict(rival), "probability": share} for rival, share in rivals],
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
        **picked(last, "floor_nrms", noise_is_known="knows_noise"),
        "pooled_rms": {name: table.pooled_rms for name, table in tables.items()},
    }


def _failing(cases: Iterable[Failing]) -> list[dict[str, Any]]:
    """Return circumstances in numbers; efforts are in N·m or N by the kind of the joint."""
    return [{n: value for n, value in asdict(case).items() if n != "unit"} for case in cases]
