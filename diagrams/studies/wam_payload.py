"""Adapt an unknown load on the palm of a WAM-like arm, by four laws ([Lee2019] §5.5.2).

The arm is known. The first estimate of the load is a sphere of 1 kg; it is one of three of 3 kg: a
small sphere, a rod-like ellipsoid, or an ellipsoid that is off by 9.5 cm. The controller is that of
`wam_adaptation.py`, for five rounds of one motion (figure 5.6). Adaptation speeds γ⁻¹ are the
source's, or with `--gains rule` chosen by one rule for all laws, on other loads
(`adaptive/laws.py`, `--choose-gains`). The order of the laws is the source's with its speeds only.

    python -m diagrams.studies.wam_payload --json payload.json --figures figures
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import product
from typing import Any

from diagrams.harness import chart, show, write
from diagrams.studies.adaptive import laws, loop, wam
from geodrake.control import PassivityBasedAdaptiveController, VaryingGains
from geodrake.inertia import is_physical, riemannian_distance

ROUNDS = 5


@dataclass(frozen=True)
class Draw:
    """One closed loop."""

    load: str  # name of the load; a number is that of one for the choice of speeds
    law: str
    speed: float
    rounds: int = ROUNDS  # number of rounds
    end: float | None = None  # when to stop, s; None for the end of the last round


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table; only the loads for the choice of speeds are random."""
    arm = wam.load_loaded()
    load = wam.LOADS.get(draw.load)
    part = "loads" if load is not None else "grid"
    load = wam.some_load(laws.CALIBRATION_SEED, int(draw.load)) if load is None else load
    controller = PassivityBasedAdaptiveController(
        arm.control,
        arm.law(draw.law, draw.speed),
        gains=VaryingGains(wam.RATE),
        parameters=arm.parameters(wam.GUESS),
        truth=arm.parameters(load),
    )
    motion = loop.rounds((wam.AMPLITUDE,) * draw.rounds, wam.PERIOD, len(arm.control.joints))
    record = loop.simulate(controller, wam.make_plant(load), motion, end=draw.end)
    estimate = record.parameters[:, -len(load) :]
    physical = is_physical(estimate)
    distance = float(riemannian_distance(estimate[-1], load)) if physical[-1] else None
    return {
        **record.told(draw, controller),
        "part": part,
        "load": draw.load,
        "rounds": record.rounds(wam.PERIOD, draw.rounds),
        "unphysical": float(1.0 - physical.mean()),
        "mass": float(estimate[-1, 0]),
        "distance": distance,
        "series": record.series,
    }


def all_draws(options: argparse.Namespace) -> list[Draw]:
    """Return every load with every law."""
    speed = laws.speeds("payload", options.gains)
    some = {"rounds": 1, "end": 1.2} if options.quick else {}
    loads = ("ellipsoid 2",) if options.quick else tuple(wam.LOADS)
    return [Draw(load, law, speed[law], **some) for load, law in product(loads, laws.LAWS)]


def grid_draws(options: argparse.Namespace) -> list[Draw]:
    """Return the draws from which speeds are chosen."""
    tried = product(laws.LAWS[1:], laws.GRID, range(4))
    return [Draw(str(k), law, speed, 1) for law, speed, k in tried]


def tell(options: argparse.Namespace, rows: list[Any]) -> None:
    """Print and write the results."""
    lines = [{**r, "first": r["rounds"][0], "last": r["rounds"][-1]} for r in rows]
    show(f"Tracking RMS in degrees, gains: {options.gains}", lines)
    table = {"gains": options.gains, "period": loop.SHOWN_PERIOD, "rows": rows}
    figures = {
        "wam_payload_rounds": lambda: chart(rows, "", "rounds", "law", panel="load"),
        "wam_payload": lambda: chart(loop.timed(rows), "time", "series", "law", panel="load"),
    }
    write(options, table, **figures)


def main() -> None:
    """Run the study from the command line."""
    parser = laws.study_parser(__doc__, gains="source")
    laws.run_study(parser, run_draw, all_draws, grid_draws, tell, group="part")


if __name__ == "__main__":
    main()
