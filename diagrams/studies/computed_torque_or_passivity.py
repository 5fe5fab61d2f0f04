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

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from statistics import fmean
from typing import Any

from diagrams.harness import chart, show, write
from diagrams.studies.adaptive import laws, loop, wam
from diagrams.studies.adaptive.faults import NoisyVelocities
from geodrake.control import (
    AdaptiveComputedTorqueController,
    PassivityBasedAdaptiveController,
    PredictionError,
    VaryingGains,
)
from geodrake.control.systems import AdaptiveController

PASSIVITY, ACCELERATION, FILTERED = "passivity", "acceleration", "filtered"
CONTROLLERS = (PASSIVITY, ACCELERATION, FILTERED)
LAWS = (laws.NONE, laws.EUCLIDEAN, laws.NATURAL)
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
    end: float = wam.PERIOD


def make_controller(draw: Draw, seed: int) -> AdaptiveController:
    """Return the controller of a draw."""
    arm = wam.load_wam()
    start = wam.first_estimate(draw.sigma, seed, draw.number)
    law = laws.make_law(draw.law, arm.manifold, start, draw.speed)
    if draw.controller == PASSIVITY:
        return PassivityBasedAdaptiveController(
            arm.control, law, gains=VaryingGains(wam.RATE), parameters=start, truth=arm.truth
        )
    return AdaptiveComputedTorqueController(
        arm.control,
        law,
        rate=wam.RATE,
        prediction=PREDICTION if draw.controller == FILTERED else None,
        parameters=start,
        truth=arm.truth,
    )


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table."""
    arm = wam.load_wam()
    seed = laws.CALIBRATION_SEED if draw.grid else seed
    controller, size = make_controller(draw, seed), len(arm.control.joints)
    sensor = None
    if draw.noise:
        sensor = NoisyVelocities(size, draw.noise, duration=wam.PERIOD, seed=seed + draw.number)
    motion = loop.rounds((wam.AMPLITUDE,), wam.PERIOD, size)
    begin = time.process_time()
    record = loop.simulate(controller, wam.make_plant(), motion, end=draw.end, sensor=sensor)
    return {
        **record.told(draw, controller),
        "controller": draw.controller,
        "sigma": draw.sigma,
        "draw": draw.number,
        "noise": draw.noise,
        "late": record.rms(0.5 * draw.end),
        "unphysical": float(arm.unphysical(record.parameters).mean()),
        "seconds": (time.process_time() - begin) / max(record.time[-1], 1e-3),
    }


def speed_of(controller: str, law: str) -> float:
    """Return γ⁻¹ as chosen."""
    study = "wam" if controller == PASSIVITY else f"controller_{controller}"
    return laws.speeds(study, "rule")[law]


def all_draws(options: argparse.Namespace) -> list[Draw]:
    """Return every controller with every law."""
    sigmas, end = ((0.4,), 0.2) if options.quick else (SIGMAS, wam.PERIOD)
    found = product((0.0, NOISE), sigmas, range(options.draws), CONTROLLERS, LAWS)
    return [
        Draw(controller, law, speed_of(controller, law), sigma, k, noise, end=end)
        for noise, sigma, k, controller, law in found
        # Without adaptation there is one computed torque.
        if (controller, law) != (FILTERED, laws.NONE)
    ]


def grid_draws(options: argparse.Namespace) -> list[Draw]:
    """Return the draws that speeds are chosen on."""
    tried = product(CONTROLLERS[1:], LAWS[1:], laws.GRID, range(options.draws))
    return [Draw(kind, law, speed, SIGMAS[-1], k, grid=True) for kind, law, speed, k in tried]


def summarize(rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Return means over draws, one line a noise, σ, controller and law."""
    return [
        {
            **line,
            "late": fmean(r["late"] for r in kept) if kept else None,
            "seconds": fmean(r["seconds"] for r in found),
        }
        for line, found, kept in laws.cells(rows, ("noise", "sigma", "controller", "law"))
    ]


def tell(options: argparse.Namespace, rows: list[Any]) -> None:
    """Print and write what came out."""
    summary = summarize(rows)
    show("Tracking RMS in degrees; CPU seconds a simulated second", summary)
    table = {"summary": summary, "rows": rows}
    sigma = max(line["sigma"] for line in summary)
    worst = [{**x, "rms_deviation": x["deviation"] or 0.0} for x in summary if x["sigma"] == sigma]
    note = f"RMS in degrees at σ = {sigma:g}; noise of the velocity in rad/s"
    draw = partial(chart, worst, "controller", "rms", "law", panel="noise", note=note)
    write(options, table, computed_torque_or_passivity=draw)


def main() -> None:
    """Run the study from the command line."""
    how = {"group": "controller", "estimates": True}
    laws.run_study(__doc__, run_draw, all_draws, grid_draws, tell, **how)


if __name__ == "__main__":
    main()
