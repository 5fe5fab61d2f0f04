"""Sandbags on an AMBIDEX-like arm: inertia and friction adapt, by four laws ([Lee2019] §5.6).

Sandbags of 500 g are on one to three links. The controller begins with what was identified without
them, as in `ambidex_arm.py`: bodies and friction of the motors are a little off, and friction is
uneven, which no parameter explains. Its gains are small, λ = 3 1/s, it acts at 1 kHz, and friction
adapts twice as fast as inertia. Fourteen random point-to-point motions of 1.5 s (figures 5.8, 5.9).
The plant has ten joints, coupled in pairs by constraints. Adaptation speeds γ⁻¹ are the source's,
or with `--gains rule` chosen by one rule for all laws (`adaptive/gains.py`), with other motions and
a sandbag at link 8; there is no V here to rule out any, as the truth is not among the parameters.

    python -m diagrams.studies.ambidex_sandbags --json sandbags.json --figures figures
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from diagrams.harness import run_draws, script_parser, show, write
from diagrams.studies.adaptive.coupled import BAGS, CoupledArm, Known
from diagrams.studies.adaptive.gains import (
    CALIBRATION_SEED,
    GRID,
    add_gains,
    speeds,
    summarize_grid,
)
from diagrams.studies.adaptive.laws import EUCLIDEAN, LAWS, NATURAL, NONE, PULLBACK
from diagrams.studies.adaptive.loop import LOG_PERIOD
from diagrams.studies.adaptive.sandbag_loop import (
    DURATION,
    identified,
    point_to_point,
    simulate_coupled,
)
from diagrams.studies.ambidex.arm import REDUCTION
from geodrake.control import PassivityBasedAdaptiveController, VaryingGains
from geodrake.inertia import is_physical

RATE = 3.0  # λ, 1/s, [Lee2019] §5.6
MOTIONS = 14
GRID_CASE, GRID_BAGS = "grid", (7,)
LINKS = 100  # parameters of the links
SHOWN = 5  # logged samples between those of the time series


@dataclass(frozen=True)
class Draw:
    """One closed loop.

    Attributes:
        case: Where sandbags are.
        law: Its name.
        speed: γ⁻¹.
        motions: Number of motions.
        end: When to stop, s; None for the end of the last motion.
    """

    case: str
    law: str
    speed: float
    motions: int = MOTIONS
    end: float | None = None


@cache
def known_arm(seed: int) -> Known:
    """What was identified, once in a process."""
    return identified(seed)


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """A row of the table."""
    seed, bags = (seed, BAGS[draw.case]) if draw.case in BAGS else (CALIBRATION_SEED, GRID_BAGS)
    arm = CoupledArm.of(known_arm(seed))
    controller = PassivityBasedAdaptiveController(
        arm.control, arm.law(draw.law, draw.speed), gains=VaryingGains(RATE)
    )
    motion = point_to_point(draw.motions, seed)
    record = simulate_coupled(controller, bags, motion, seed=seed, end=draw.end)
    p = record.parameters
    physical = is_physical(p[:, :LINKS].reshape(len(p), -1, 10)).all(axis=1)
    physical &= (p[:, LINKS:] > 0).all(axis=1)
    return {
        "case": draw.case,
        "law": draw.law,
        "speed": draw.speed,
        "rms": record.rms(),
        "rounds": record.rounds(DURATION, draw.motions),
        "unphysical": float(1.0 - physical.mean()),
        "added": float((p[-1] - p[0])[:LINKS:10].sum()),
        "rise": None,
        "lost": record.lost,
        "series": np.degrees(np.sqrt(np.mean(record.error[::SHOWN] ** 2, axis=1)))
        .round(4)
        .tolist(),
    }


def all_draws(kind: str, *, quick: bool) -> list[Draw]:
    """Every case with every law."""
    speed = {NONE: 1.0, **speeds("sandbags", kind)}
    cases = ("link 10",) if quick else tuple(BAGS)
    motions, end = (1, 1.0) if quick else (MOTIONS, None)
    return [Draw(case, law, speed[law], motions, end) for case in cases for law in LAWS]


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    add_gains(parser, "source")
    options = parser.parse_args()
    form = {"law": "", "speed": "g", "lost": "d", "rms": ".2f", "unphysical": ".1%"}
    if options.choose_gains:
        laws = (EUCLIDEAN, PULLBACK, NATURAL)
        draws = [Draw(GRID_CASE, law, speed, 3) for law in laws for speed in GRID]
        lines = summarize_grid(run_draws(parser, options, run_draw, draws), "case")
        show("RMS in degrees", {**form, "chosen": ""}, lines)
        write(options, {"grid": lines})
        return
    rows = run_draws(parser, options, run_draw, all_draws(options.gains, quick=options.quick))
    for row in rows:
        row["motor"] = REDUCTION * row["rms"]
        half = [x for x in row["rounds"][len(row["rounds"]) // 2 :] if x is not None]
        row["late"] = float(np.mean(half)) if half else None
    columns = {"case": "", **form, "late": ".2f", "motor": ".0f", "added": ".2f"}
    show(f"Tracking RMS in degrees, gains: {options.gains}", columns, rows)
    write(options, {"gains": options.gains, "period": SHOWN * LOG_PERIOD, "rows": rows})
    if options.figures:
        from diagrams.studies.adaptive.sandbag_figures import write_sandbag_figure

        write_sandbag_figure(options.figures, rows, SHOWN * LOG_PERIOD)


if __name__ == "__main__":
    main()
