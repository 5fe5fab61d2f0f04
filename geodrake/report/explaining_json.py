"""Comparisons, diagnoses, explanations and identifications in numbers: JSON, and rows of tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geodrake.diagnosis.drafting import Draft
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.effects import FittedEffect
from geodrake.identification.fit import Certificate
from geodrake.identification.logs.model_errors import Comparison, ErrorTable
from geodrake.identification.models.results import BodyChange, ModelIdentification
from geodrake.inertia import PARAMETER_NAMES
from geodrake.report.json_output import number_or, picked, record
from geodrake.report.page import Records


def comparison_dict(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison."""
    errors = comparison.errors
    return record(
        "Comparison",
        comparison,
        error=record("TotalError", errors, noise_is_known=errors.knows_noise),
        joints={each.joint: each for each in errors.joints},
    )


def error_records(comparison: Comparison) -> Records:
    """Return a row for each joint."""
    names = ("joint", "std", "rms", "floor", "nrms", "removable")
    return [picked(joint, *names) for joint in comparison.errors.joints]


def diagnosis_dict(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis, with errors before any candidate."""
    errors = _errors(start=diagnosis.start, refit=diagnosis.refitted)
    return record("Diagnosis", diagnosis, error=errors)


def explanation_dict(explanation: Explanation, **more: Any) -> dict[str, Any]:
    """Return an explanation, and what is told beside it."""
    tables = {"start": explanation.start, "refit": explanation.refitted, "end": explanation.end}
    return record(
        "Explanation",
        explanation,
        interrupted=explanation.is_interrupted,
        steps=map(_step, explanation.steps),
        error={**_errors(**tables), "of_motion": explanation.of_motion},
        bodies=_bodies(explanation.bodies),
        certificate=_certificate(explanation.certificate),
        signals=explanation.model.effort_signals,
        failing=explanation.after.failing,
        **more,
    )


def step_records(found: Explanation) -> Records:
    """Return a row for each parameter of each step."""
    return [
        {
            "effect": step.effect,
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


def _certificate(certificate: Certificate | None) -> dict[str, Any] | None:
    """Return what the MathematicalProgram of a fit says of it; None without a fit."""
    if certificate is None:
        return None
    gap = number_or(certificate.relative_gap, certificate.failure)
    violation = number_or(certificate.violation, certificate.failure)
    return record("Certificate", certificate, gap=gap, violation=violation)


def _bodies(bodies: Sequence[BodyChange]) -> dict[str, Any]:
    """Return bodies before and after a fit by name."""
    return {
        body.name: record(
            "BodyChange",
            body,
            mass=body.mass[1],
            mass_before=body.mass[0],
            com=body.com[1],
            com_before=body.com[0],
        )
        for body in bodies
    }


def draft_dict(draft: Draft) -> dict[str, Any]:
    """Return drafted formulas."""
    found = []
    for effect in draft.effects:
        formula = effect.formula
        values = zip(formula.parameters, effect.coefficients, effect.deviations, strict=True)
        found.append(
            record(
                "DraftedEffect",
                effect,
                name=draft.names[formula.joint],
                joint=formula.joint,
                formula=formula.words(),
                coefficients={
                    p.name: {"value": value, "deviation": deviation, "unit": p.unit}
                    for p, value, deviation in values
                },
                indistinguishable_from=effect.rivals,
            )
        )
    return record(
        "Draft",
        draft,
        effects=found,
        needless=[{"effect": effect.name, "where": effect.where} for effect in draft.needless],
        error=_errors(before=draft.before, after=draft.after),
    )


def identification_dict(found: ModelIdentification) -> dict[str, Any]:
    """Return an identification."""
    after, model, result = found.after, found.model, found.result
    return record(
        "Identification",
        found,
        **picked(result, "residual", "divergence", "solver"),
        certificate=_certificate(result.certificate),
        error={
            "start": found.before.by_joint(),
            "end": after.by_joint(),
            "floor": {joint.joint: joint.floor for joint in after.joints},
            "start_nrms": found.before.nrms,
            "end_nrms": after.nrms,
            "floor_nrms": after.floor_nrms,
        },
        bodies=_bodies(found.bodies),
        inertial_parameters={
            body: dict(zip(PARAMETER_NAMES, phi, strict=True))
            for body, phi in zip(model.bodies, model.phi, strict=True)
        },
        effects=[_effect(fitted) for fitted in model.effects if len(fitted.parameters)],
        comparison=[
            {
                **picked(other, "regularizer", "gamma", "residual", "at_boundary"),
                "nrms": other.errors.nrms,
                "joints": other.errors.by_joint(),
            }
            for other in found.alternatives
        ],
    )


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
    told = [record("Rival", rival, probability=share) for rival, share in rivals]
    return record("Step", step, rivals=told)


def _errors(**tables: ErrorTable) -> dict[str, Any]:
    """Return RMS by joint of tables, then their nrms and pooled RMS; the floor is common."""
    last = list(tables.values())[-1]
    return {
        **{name: table.by_joint() for name, table in tables.items()},
        "floor": {joint.joint: joint.floor for joint in last.joints},
        **{f"{name}_nrms": table.nrms for name, table in tables.items()},
        "floor_nrms": last.floor_nrms,
        "noise_is_known": last.knows_noise,
        "pooled_rms": {name: table.pooled_rms for name, table in tables.items()},
    }
