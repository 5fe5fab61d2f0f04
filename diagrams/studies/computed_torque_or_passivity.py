"""Adaptive computed torque against passivity-based control, on a WAM-like arm ([Lee2019] §5.2.1).

Both have the same poles, (s + λ)² with λ = 10 1/s, and begin with bodies that are wrong by ±σ, as
in `wam_adaptation.py`. Computed torque adapts by the measured acceleration, Eq. (5.2.9), or by the
filtered regressor, which needs none; passivity-based control needs none either. Each adapts by the
natural and by the Euclidean law, whose speeds γ⁻¹ are chosen by one rule for all of them
(`adaptive/laws.py`, `--choose-gains`; of passivity-based control by `wam_adaptation.py`). The
velocity is exact, or has noise; the acceleration, where it is used, is exact in both cases.

    python -m diagrams.studies.computed_torque_or_passivity --json controllers.json
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from statistics import fmean
from typing import Any

from diagrams.harness import chart, positive_number, run_draws, script_parser, show, write
from diagrams.studies.adaptive.faults import NoisyVelocities
from diagrams.studies.adaptive.laws import (
    CALIBRATION_SEED,
    EUCLIDEAN,
    GRID,
    NATURAL,
    NONE,
    cells,
    make_law,
    speeds,
    tell_grid,
)
from diagrams.studies.adaptive.loop import rounds, simulate
from diagrams.studies.adaptive.wam import (
    AMPLITUDE,
    PERIOD,
    RATE,
    first_estimate,
    load_wam,
    make_plant,
)
from geodrake.control import (
    AdaptiveComputedTorqueController,
    PassivityBasedAdaptiveController,
    PredictionError,
    VaryingGains,
)
from geodrake.control.systems import AdaptiveController

PASSIVITY, ACCELERATION, FILTERED = "passivity", "acceleration", "filtered"
CONTROLLERS = (PASSIVITY, ACCELERATION, FILTERED)
LAWS = (NONE, EUCLIDEAN, NATURAL)
SIGMAS = (0.1, 0.2, 0.4)
NOISE = 0.02  # rad/s
PREDICTION = PredictionError(1.0, alone=True)


@dataclass(frozen=True)
class Draw:
    """One closed loop."""

    controller: str
    law: str
    speed: float
    sigma: float
    number: int
    noise: float = 0.0
    grid: bool = False
    end: float = PERIOD


def make_controller(draw: Draw, seed: int) -> AdaptiveController:
    """Return the controller of a draw."""
    wam = load_wam()
    start = first_estimate(draw.sigma, seed, draw.number)
    law = make_law(draw.law, wam.manifold, start, draw.speed)
    if draw.controller == PASSIVITY:
        return PassivityBasedAdaptiveController(
            wam.control, law, gains=VaryingGains(RATE), parameters=start, truth=wam.truth
        )
    return AdaptiveComputedTorqueController(
        wam.control,
        law,
        rate=RATE,
        prediction=PREDICTION if draw.controller == FILTERED else None,
        parameters=start,
        truth=wam.truth,
    )


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table."""
    wam = load_wam()
    seed = CALIBRATION_SEED if draw.grid else seed
    controller, size = make_controller(draw, seed), len(wam.control.joints)
    sensor = None
    if draw.noise:
        sensor = NoisyVelocities(size, draw.noise, duration=PERIOD, seed=seed + draw.number)
    motion = rounds((AMPLITUDE,), PERIOD, size)
    begin = time.process_time()
    record = simulate(controller, make_plant(), motion, end=draw.end, sensor=sensor)
    return {
        **record.told(draw, controller),
        "controller": draw.controller,
        "sigma": draw.sigma,
        "draw": draw.number,
        "noise": draw.noise,
        "late": record.rms(0.5 * draw.end),
        "unphysical": float(wam.unphysical(record.parameters).mean()),
        "seconds": (time.process_time() - begin) / max(record.time[-1], 1e-3),
    }


def speed_of(controller: str, law: str) -> float:
    """Return γ⁻¹ as chosen."""
    study = "wam" if controller == PASSIVITY else f"controller_{controller}"
    return 1.0 if law == NONE else speeds(study, "rule")[law]


def all_draws(draws: int, *, quick: bool) -> list[Draw]:
    """Return every controller with every law."""
    sigmas, end = ((0.4,), 0.2) if quick else (SIGMAS, PERIOD)
    return [
        Draw(controller, law, speed_of(controller, law), sigma, k, noise, end=end)
        for noise in (0.0, NOISE)
        for sigma in sigmas
        for k in range(draws)
        for controller in CONTROLLERS
        for law in LAWS
        # Without adaptation there is one computed torque.
        if (controller, law) != (FILTERED, NONE)
    ]


def grid_draws(count: int) -> list[Draw]:
    """Return the draws that speeds are chosen on."""
    return [
        Draw(controller, law, speed, SIGMAS[-1], k, grid=True)
        for controller in (ACCELERATION, FILTERED)
        for law in (EUCLIDEAN, NATURAL)
        for speed in GRID
        for k in range(count)
    ]


def summarize(rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Return means over draws, one line a noise, σ, controller and law."""
    return [
        {
            **line,
            "late": fmean(r["late"] for r in kept) if kept else None,
            "seconds": fmean(r["seconds"] for r in found),
        }
        for line, found, kept in cells(rows, ("noise", "sigma", "controller", "law"))
    ]


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--choose-gains", action="store_true", help="choose adaptation speeds")
    parser.add_argument(
        "--draws",
        type=positive_number,
        help="number of first estimates (2; 1 with --quick)",
    )
    options = parser.parse_args()
    draws = options.draws or (1 if options.quick else 2)
    task = partial(run_draw, seed=options.seed)
    if options.choose_gains:
        tell_grid(options, run_draws(parser, options, task, grid_draws(draws)), "controller")
        return
    rows = run_draws(parser, options, task, all_draws(draws, quick=options.quick))
    summary = summarize(rows)
    show("Tracking RMS in degrees; CPU seconds a simulated second", summary)
    table = {"summary": summary, "rows": rows}
    sigma = max(line["sigma"] for line in summary)
    worst = [{**x, "rms_deviation": x["deviation"] or 0.0} for x in summary if x["sigma"] == sigma]
    note = f"RMS in degrees at σ = {sigma:g}; noise of the velocity in rad/s"
    draw = partial(chart, worst, "controller", "rms", "law", panel="noise", note=note)
    write(options, table, computed_torque_or_passivity=draw)


if __name__ == "__main__":
    main()
