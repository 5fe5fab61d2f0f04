"""Figures of the study of a manipulator's motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from geodrake.report import style

_CRITERIA = {
    "a_optimality": "A",
    "d_optimality": "D",
    "e_optimality": "E",
    "condition_number": "condition",
}


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Errors by criterion and base representation."""
    figure = style.new_figure(4.2)
    colors = {"none": style.MEASURED, "diagonal": style.BEFORE, "geometric": style.AFTER}
    names = [
        f"{r['normalization']}: {_CRITERIA[r['criterion']]}, base {r['base']}"
        if r["normalization"].split(",")[0] in colors
        else r["normalization"]
        for r in rows
    ]
    panels = {
        "parameter error": [row["error"] for row in rows],
        "acceleration of the last joint, rad/s²": [
            list(row["acceleration"].values())[-1] for row in rows
        ],
        "criterion (geometric E) over the best": [
            row["criterion_over_best_geometric"] for row in rows
        ],
    }
    shades = [colors.get(row["normalization"].split(",")[0], style.FLOOR) for row in rows]
    for i, (ax, title) in enumerate(zip(figure.subplots(1, 3), panels, strict=True)):
        ax.scatter(panels[title], range(len(rows)), color=shades, s=28)
        ax.set_yticks(range(len(rows)), [""] * len(rows) if i else names)
        ax.invert_yaxis()
        style.polish(ax)
        style.log_scale(ax, "x")
        ax.set_title(title, loc="left", **style.plain())
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
