"""Adapt an unknown load on the palm of a WAM-like arm, by four laws ([Lee2019] §5.5.2).

The arm is known. The load is thought to be a sphere of 1 kg, and is one of three of 3 kg: a small
sphere, a rod-like ellipsoid, and an ellipsoid that is off by 9.5 cm. The controller is that of
`wam_adaptation.py`, for five rounds of one motion (figure 5.6). Adaptation speeds γ⁻¹ are the
source's, or with `--gains rule` chosen by one rule for all laws, on other loads
(`adaptive/laws.py`, `--choose-gains`). The order of the laws is the source's with its speeds only.

    python -m diagrams.studies.wam_payload --json payload.json --figures figures
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from diagrams.harness import chart, run_draws, script_parser, show, write
from diagrams.studies.adaptive.laws import (
    CALIBRATION_SEED,
    EUCLIDEAN,
    GRID,
    LAWS,
    NATURAL,
    NONE,
    PULLBACK,
    add_gains,
    speeds,
    tell_grid,
)
from diagrams.studies.adaptive.loop import LOG_PERIOD, rounds, simulate
from diagrams.studies.adaptive.wam import (
    AMPLITUDE,
    GUESS,
    LOADS,
    PERIOD,
    RATE,
    load_loaded,
    make_plant,
    some_load,
)
from geodrake.control import PassivityBasedAdaptiveController, VaryingGains
from geodrake.inertia import is_physical, riemannian_distance

ROUNDS = 5
SHOWN = 5  # logged samples between those of the time series


@dataclass(frozen=True)
class Draw:
    """One closed loop."""

    load: str  # name of the load; a number is that of one for the choice of speeds
    law: str
    speed: float
    rounds: int = ROUNDS  # number of rounds
    end: float | None = None  # when to stop, s; None for the end of the last round


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table; nothing is random but the loads of the choice of speeds."""
    arm = load_loaded()
    numbered = draw.load.isdigit()
    load = some_load(CALIBRATION_SEED, int(draw.load)) if numbered else LOADS[draw.load]
    controller = PassivityBasedAdaptiveController(
        arm.control,
        arm.law(draw.law, draw.speed),
        gains=VaryingGains(RATE),
        parameters=arm.parameters(GUESS),
        truth=arm.parameters(load),
    )
    motion = rounds((AMPLITUDE,) * draw.rounds, PERIOD, len(arm.control.joints))
    record = simulate(controller, make_plant(load), motion, end=draw.end)
    estimate = record.parameters[:, -len(load) :]
    physical = is_physical(estimate)
    distance = riemannian_distance(estimate[-1], load) if physical[-1] else None
    series = np.degrees(np.sqrt(np.mean(record.error**2, axis=1)))[::SHOWN]
    return {
        **record.told(draw, controller),
        "part": "grid" if numbered else "loads",
        "load": draw.load,
        "rounds": record.rounds(PERIOD, draw.rounds),
        "unphysical": float(1.0 - physical.mean()),
        "mass": float(estimate[-1, 0]),
        "distance": None if distance is None else float(distance),
        "series": [] if numbered else [round(float(x), 5) for x in series],
    }


def all_draws(kind: str, *, quick: bool) -> list[Draw]:
    """Return every load with every law."""
    speed = {NONE: 1.0, **speeds("payload", kind)}
    some = {"rounds": 1, "end": 1.2} if quick else {}
    loads = ("ellipsoid 2",) if quick else tuple(LOADS)
    return [Draw(load, law, speed[law], **some) for load in loads for law in LAWS]


def grid_draws(count: int) -> list[Draw]:
    """Return the draws that speeds are chosen on."""
    return [
        Draw(str(k), law, speed, 1)
        for law in (EUCLIDEAN, PULLBACK, NATURAL)
        for speed in GRID
        for k in range(count)
    ]


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    add_gains(parser, "source")
    options = parser.parse_args()
    task = partial(run_draw, seed=options.seed)
    if options.choose_gains:
        tell_grid(options, run_draws(parser, options, task, grid_draws(4)), "part")
        return
    rows = run_draws(parser, options, task, all_draws(options.gains, quick=options.quick))
    lines = [{**r, "first": r["rounds"][0], "last": r["rounds"][-1]} for r in rows]
    show(f"Tracking RMS in degrees, gains: {options.gains}", lines)
    period = SHOWN * LOG_PERIOD
    table = {"gains": options.gains, "period": period, "rows": rows}
    times = [[period * k for k in range(len(row["series"]))] for row in rows]
    drawn = [{**row, "time": own} for row, own in zip(rows, times, strict=True)]
    figures = {
        "wam_payload_rounds": lambda: chart(rows, "", "rounds", "law", panel="load"),
        "wam_payload": lambda: chart(drawn, "time", "series", "law", panel="load"),
    }
    write(options, table, **figures)


if __name__ == "__main__":
    main()
