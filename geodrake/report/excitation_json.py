"""Designs of motions and what is identifiable from logs, as dictionaries of numbers and names."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from geodrake.excitation import ExcitationResult
from geodrake.excitation.identifiability import LogIdentifiability
from geodrake.excitation.identifiability.results import IdentifiableBlock
from geodrake.excitation.verdict import (
    distinguished_pairs,
    identifiable_directions,
    improvement,
)
from geodrake.report.excitation_words import excitation_verdict, identifiability_verdict
from geodrake.report.json_output import number_or


def excitation_dict(result: ExcitationResult) -> dict[str, Any]:
    """A designed motion: its coefficients, what it is worth, what it uses of the limits.

    Args:
        result: The result of `geodrake.excitation.design_excitation`, or of `design_separation`,
            whose value is 1/Δ of the pair that is hardest to distinguish.
    """
    objective, family, use = result.objective, result.trajectory.family, result.use
    pairs = distinguished_pairs(result)
    shares = ("position", "velocity", "acceleration", "effort")
    return {
        "criterion": "separation" if pairs else objective.criterion.name,
        "normalization": objective.normalization,
        "value": result.value,
        "improvement_over_random": improvement(result),
        "verdict": excitation_verdict(result),
        "interrupted": result.is_interrupted,
        "eigenvalues": result.eigenvalues,
        "directions_told": None if pairs else identifiable_directions(result),
        "pairs": [
            {
                "truth": found.pair.truth,
                "where": found.pair.where,
                "rival": found.pair.rival,
                "deviations": found.deviations,
                "effort_rms": found.effort,
            }
            for found in pairs
        ],
        "samples": result.samples,
        "noise": dict(zip(objective.target.model.joints, objective.target.noise, strict=True)),
        "motion": {
            "family": family.name,
            **asdict(family),  # type: ignore[call-overload]
            "coefficients": dict(
                zip(result.trajectory.joints, result.trajectory.coefficients.T, strict=True)
            ),
        },
        "limits": {
            joint: {
                "lower": result.limits.lower[j],
                "upper": result.limits.upper[j],
                **{name: getattr(result.limits, name)[j] for name in shares[1:]},
            }
            for j, joint in enumerate(result.limits.joints)
        },
        "use": {
            joint: {name: getattr(use, name)[j] for name in shares}
            for j, joint in enumerate(result.limits.joints)
        },
        "distance": {
            "least": number_or(use.distance, "collisions were not looked for"),
            "between": use.nearest,
            "clearance": use.clearance,
        },
        "starts": [asdict(outcome) for outcome in result.outcomes],
        "notes": list(result.notes),
    }


def identifiable_dict(found: LogIdentifiability) -> dict[str, Any]:
    """What is identifiable from logs: directions, bodies, effects and base parameters.

    Returns:
        `told` of `possible` directions, `threshold`, and `directions`, `bodies`, `effects`,
        `combinations` with their (relative) deviations.
    """
    identifiable = found.identifiable
    return {
        "told": found.count,
        "possible": found.possible,
        "told_at_sensor_noise": found.count_at_floor,
        "threshold": identifiable.threshold,
        "verdict": identifiability_verdict(found),
        "directions": [
            {
                "variance": variance,
                "variance_at_sensor_noise": ideal,
                "told": k < found.count,
                "shares": dict(zip(found.blocks, shares, strict=True)),
            }
            for k, (variance, ideal, shares) in enumerate(
                zip(
                    identifiable.variances.tolist(),
                    found.floor_variances.tolist(),
                    identifiable.shares.T.tolist(),
                    strict=True,
                )
            )
        ],
        "bodies": {body.name: _block(body) for body in found.bodies},
        "effects": [
            {
                "effect": entry.effect,
                "parameter": entry.parameter,
                "where": entry.where,
                **_block(entry),
                "value": entry.value,
                "deviation": entry.deviation,
            }
            for entry in found.effects
        ],
        "combinations": [asdict(combination) for combination in found.combinations],
        "joints": {
            joint: {"noise": noise, "sensor_noise": floor, "samples": samples}
            for joint, noise, floor, samples in zip(
                found.model.joints,
                found.noise.tolist(),
                found.floor.tolist(),
                found.samples.tolist(),
                strict=True,
            )
        },
        "notes": list(found.notes),
    }


def _block(block: IdentifiableBlock) -> dict[str, float]:
    return {"told": block.count, "possible": block.possible, "share": block.share}
