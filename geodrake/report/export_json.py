"""An export as plain numbers, for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from geodrake.control.export_proof.export import ProvenExport


def export_dict(found: ProvenExport) -> dict[str, Any]:
    """An export: its files, what they hold and lack, and what simulators make of them.

    Returns:
        `format`, `files`; `holds`, the effects in them with their parameters; `lacks`, each with
        what stands `into` its place and its `nrms`; `error` on the logs; `differences` from the
        model by simulator (N·m or N, rad or m), `ignored` effects, and `notes`.
    """
    costs = found.costs
    return {
        "format": found.form.name,
        "files": list(found.exported.files),
        "holds": [
            {
                "effect": fitted.effect.name,
                "where": list(fitted.effect.where),
                "shape": fitted.effect.reported_shape,
                "parameters": dict(
                    zip(
                        (parameter.name for parameter in fitted.effect.parameters),
                        fitted.parameters.tolist(),
                        strict=True,
                    )
                ),
            }
            for fitted in found.held.effects
        ],
        "lacks": [
            {
                "effect": cost.lost.effect,
                "where": list(cost.lost.where),
                "into": list(cost.lost.into),
                **({} if cost.nrms is None else {"nrms": cost.nrms}),
            }
            for cost in found.lacks
        ],
        "error": {}
        if costs is None
        else {"nrms": costs.whole, "held_nrms": costs.held}
        | ({} if costs.ignored is None else {"simulated_nrms": costs.ignored}),
        "differences": [asdict(difference) for difference in found.proof.differences],
        "ignored": list(found.proof.ignored),
        "notes": list(found.notes),
    }
