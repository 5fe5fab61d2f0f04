"""Designs of motions and what logs can tell, as plain dictionaries of numbers and names."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from geodrake.identifiability import LogIdentifiability, ToldBlock


def identifiable_dict(found: LogIdentifiability) -> dict[str, Any]:
    """What logs can tell: directions, bodies, effects and base parameters.

    Args:
        found: The result of `geodrake.identifiability.log_identifiability`.

    Returns:
        `told` of `possible` directions, `threshold`, and `directions`, `bodies`, `effects`,
        `combinations` with their (relative) deviations.
    """
    identifiable = found.identifiable
    return {
        "told": found.told,
        "possible": found.possible,
        "told_at_sensor_noise": found.told_at_floor,
        "threshold": identifiable.threshold,
        "verdict": found.verdict(),
        "directions": [
            {
                "variance": variance,
                "variance_at_sensor_noise": ideal,
                "told": k < found.told,
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


def _block(block: ToldBlock) -> dict[str, float]:
    return {"told": block.told, "possible": block.possible, "share": block.share}
