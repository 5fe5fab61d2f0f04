"""What was found of servos over what is true, as a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from geodrake.report import style

TITLES: Mapping[str, str] = {
    "kp": "stiffness",
    "kd": "damping",
    "ki": "integral gain",
    "coulomb_friction": "dry friction",
    "viscous_friction": "viscous friction",
    "rotor_inertia": "armature",
}
_RANGE = (0.5, 2.0)


def save_ratios(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Every value over the truth with its interval, a panel for each quantity.

    Args:
        rows: Rows of the table.
        folder: Where `servo_gains.png` goes.
    """
    values = [value for row in rows for value in row["values"] if value["ratio"]]
    kinds = [kind for kind in TITLES if any(value["what"] == kind for value in values)]
    figure = Figure(figsize=(1.0 + 1.9 * len(kinds), 3.2), layout="constrained")
    for axes, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        same = sorted((v for v in values if v["what"] == kind), key=lambda v: v["ratio"])
        ratios = np.array([value["ratio"] for value in same])
        spread = 2.0 * np.array([v["deviation"] / abs(v["truth"]) for v in same])
        places = np.arange(len(same))
        axes.vlines(places, ratios - spread, ratios + spread, color=style.BEFORE, linewidth=0.8)
        axes.plot(places, ratios, "o", markersize=2.5, color=style.AFTER)
        axes.axhline(1.0, color="0.3", linewidth=0.8)
        axes.set(title=TITLES[kind], ylim=_RANGE, xticks=[])
        axes.set_xlabel(f"{len(same)} joints")
    figure.supylabel("found / true, ± 2 standard deviations")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "servo_gains.png", dpi=110)
