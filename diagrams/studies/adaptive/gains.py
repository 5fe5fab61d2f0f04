"""How the speed γ⁻¹ of every law is chosen, by one rule for all.

Of one grid, 1e-5, 3e-5, 1e-4, … 3e3 for every law, the speed of least mean tracking error over
draws of a seed that no reported draw has, among the speeds at which no draw is lost and V, which
must not rise, rises by no more than 1 % of its start. The second half is the source's "as large as
possible without accruing large numerical integration errors" ([Lee2019] §5.5).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from statistics import fmean
from typing import Any

from diagrams.studies.adaptive.laws import (
    EUCLIDEAN,
    NATURAL,
    NATURAL_EULER,
    PULLBACK,
    SOURCE_SPEEDS,
)

GRID = tuple(float(f"{digit}e{power}") for power in range(-5, 4) for digit in (1, 3))
LARGEST_RISE = 0.01
CALIBRATION_SEED = 20_190_801
"""Of the draws that speeds are chosen on; those of studies have small seeds."""

CHOSEN = {
    "wam": {EUCLIDEAN: 1e-3, PULLBACK: 30.0, NATURAL: 30.0},
    "wam_100_hz": {EUCLIDEAN: 3e-5, PULLBACK: 3.0, NATURAL: 3.0},
    "payload": {EUCLIDEAN: 3.0, PULLBACK: 300.0, NATURAL: 3.0},
    "controller_acceleration": {EUCLIDEAN: 3e-5, NATURAL: 10.0},
    "controller_filtered": {EUCLIDEAN: 1e-5, NATURAL: 3e3},  # Euclidean: all were lost
    "sandbags": {EUCLIDEAN: 10.0, PULLBACK: 300.0, NATURAL: 100.0},
}
"""γ⁻¹ that `--choose-gains` of the scripts found."""


def speeds(study: str, kind: str) -> dict[str, float]:
    """γ⁻¹ of every law: of the source, or as chosen by the rule."""
    if kind == "source":
        return dict(SOURCE_SPEEDS)
    chosen = CHOSEN[study]
    return {**chosen, NATURAL_EULER: chosen[NATURAL]}


def summarize_grid(rows: Sequence[Any], group: str) -> list[dict[str, Any]]:
    """One line a speed of the grid, of every law and whatever else tells draws apart.

    Args:
        rows: Rows of draws with law, speed, rms, lost, rise and unphysical.
        group: Column beside the law within which a speed is chosen.
    """
    lines: list[dict[str, Any]] = []
    for value, law in dict.fromkeys((r[group], r["law"]) for r in rows):
        of_law = []
        for speed in GRID:
            found = [r for r in rows if (r[group], r["law"], r["speed"]) == (value, law, speed)]
            kept = [r["rms"] for r in found if not r["lost"]]
            line = {
                group: value,
                "law": law,
                "speed": speed,
                "draws": len(found),
                "lost": len(found) - len(kept),
                "rms": fmean(kept) if kept else None,
                "unphysical": fmean(r["unphysical"] for r in found),
                "rise": max(r["rise"] or 0.0 for r in found),
            }
            of_law.append(line)
        allowed = [x for x in of_law if x["lost"] == 0 and x["rise"] <= LARGEST_RISE]
        best = min(allowed, key=lambda x: x["rms"], default=None)
        lines += [{**x, "chosen": "chosen" if x is best else ""} for x in of_law]
    return lines


def add_gains(parser: argparse.ArgumentParser, default: str = "rule") -> None:
    """Options of how fast laws are."""
    parser.add_argument(
        "--gains",
        choices=("rule", "source"),
        default=default,
        help="adaptation speeds: by one rule for all laws, or of [Lee2019] §5.5 (%(default)s)",
    )
    parser.add_argument(
        "--choose-gains", action="store_true", help="apply that rule, and say what it chooses"
    )
