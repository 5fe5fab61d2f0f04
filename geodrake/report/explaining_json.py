"""JSON and records of comparisons, diagnoses, explanations and identifications."""

from __future__ import annotations

from typing import Any

from geodrake.diagnosis.drafting import Draft
from geodrake.diagnosis.results import Explanation, Step
from geodrake.identification.logs.model_errors import Comparison
from geodrake.identification.models.results import ModelIdentification
from geodrake.inertia.parameters import PARAMETER_NAMES
from geodrake.report.json_output import picked, record
from geodrake.report.page import Records


def error_records(comparison: Comparison) -> Records:
    """Return a row for each joint."""
    names = ("joint", "std", "rms", "floor", "nrms", "removable")
    return [picked(joint, *names) for joint in comparison.errors.joints]


def explanation_values(found: Explanation) -> dict[str, Any]:
    """Return the steps of an explanation, in which rivals have their probabilities."""
    return {"steps": map(_step, found.steps)}


def _step(step: Step) -> dict[str, Any]:
    rivals = zip(step.rivals, step.probabilities_of_rivals, strict=True)
    told = [record("Rival", rival, probability=share) for rival, share in rivals]
    return record("Step", step, rivals=told)


def draft_values(draft: Draft) -> dict[str, Any]:
    """Return the effects of a draft, with their names and coefficients."""
    found = []
    for effect in draft.effects:
        numbers = effect.formula.parameters, effect.coefficients, effect.deviations
        values = {p.name: (c, d, p.unit) for p, c, d in zip(*numbers, strict=True)}
        name = draft.names[effect.formula.joint]
        found.append(record("DraftedEffect", effect, name=name, coefficients=values))
    return {"effects": found}


def identification_values(found: ModelIdentification) -> dict[str, Any]:
    """Return the bodies of an identified model, and its effects with parameters."""
    model = found.model
    bodies = zip(model.bodies, model.phi, strict=True)
    return {
        "inertial_parameters": {
            body: dict(zip(PARAMETER_NAMES, phi, strict=True)) for body, phi in bodies
        },
        "effects": [fitted for fitted in model.effects if len(fitted.parameters)],
    }


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
