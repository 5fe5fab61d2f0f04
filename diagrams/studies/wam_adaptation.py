"""Adapt all bodies of a WAM-like arm while it moves, by four laws ([Lee2019] §5.5.1).

The controller is the passivity-based one with K = λ M̂, Λ = λ and λ = 10 1/s; it and the laws act
at 1 kHz. The first estimate scales every body by 1 ± σ. Two parts:

- noise: over σ, two rounds of amplitude 0.8 rad (figure 5.4);
- rounds: five rounds of growing amplitude at σ = 0.4 (figure 5.5).

--controllers adds adaptive computed torque ([Lee2019] §5.2.1), with the same poles (s + λ)². It
adapts by the measured acceleration, Eq. (5.2.9), or by the filtered regressor, which needs none.
The velocity is exact, or has noise; the acceleration is exact.

The Euclidean and the pullback law have a constant gain, for which Euler steps are exact; the
natural law's are geodesic. The speed γ⁻¹ of each law is chosen by one rule on draws of their own
(`adaptive/laws.py`, `--choose-gains`), or is the source's (`--gains source`). As in the source,
there is no friction, and joints and efforts have no limits.

    python -m diagrams.studies.wam_adaptation --draws 4 --json wam.json --figures figures
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagrams.harness import chart, show, write
from diagrams.studies.adaptive import laws, loop, wam
from diagrams.studies.adaptive.faults import NoisyVelocities
from geodrake.control import (
    AdaptiveComputedTorqueController,
    AdaptiveController,
    PassivityBasedAdaptiveController,
    PredictionError,
    VaryingGains,
)

SIGMAS = tuple(round(0.05 * k, 2) for k in range(1, 9))
AMPLITUDES = (0.4, 0.6, 0.8, 1.0, 1.2)  # rad
NOISE, ROUNDS, CONTROLLERS, GRID_PART = "noise", "rounds", "controllers", "grid"
PASSIVITY, ACCELERATION, FILTERED = "passivity", "acceleration", "filtered"
COMPARED = (laws.NONE, laws.EUCLIDEAN, laws.NATURAL)
DEVIATION = 0.02  # rad/s, of a noisy velocity


@dataclass(frozen=True)
class Draw:
    """One closed loop."""

    part: str  # of the study
    law: str
    speed: float
    sigma: float
    number: int
    amplitudes: tuple[float, ...] = (wam.AMPLITUDE, wam.AMPLITUDE)  # of the rounds, rad
    period: float = wam.PERIOD
    end: float | None = None  # when to stop, s; None for the end of the last round
    controller: str = PASSIVITY
    deviation: float = 0.0  # of the velocity's noise, rad/s


def make_controller(draw: Draw, seed: int) -> AdaptiveController:
    """Return the controller of a draw."""
    arm, start = wam.load_wam(), wam.first_estimate(draw.sigma, seed, draw.number)
    law = laws.make_law(draw.law, arm.manifold, start, draw.speed)
    known = {"parameters": start, "truth": arm.truth}
    if draw.controller == PASSIVITY:
        return PassivityBasedAdaptiveController(
            arm.control, law, gains=VaryingGains(wam.RATE), **known
        )
    prediction = PredictionError(1.0, alone=True) if draw.controller == FILTERED else None
    return AdaptiveComputedTorqueController(
        arm.control, law, rate=wam.RATE, prediction=prediction, **known
    )


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table."""
    arm = wam.load_wam()
    seed = laws.CALIBRATION_SEED if draw.part == GRID_PART else seed
    controller, size = make_controller(draw, seed), len(arm.control.joints)
    sensor = None
    if draw.deviation:
        how = {"duration": draw.period, "seed": seed + draw.number}
        sensor = NoisyVelocities(size, draw.deviation, **how)
    motion = loop.rounds(draw.amplitudes, draw.period, size)
    record = loop.simulate(controller, wam.make_plant(), motion, end=draw.end, sensor=sensor)
    return {
        **record.told(draw, controller),
        "part": draw.part,
        "sigma": draw.sigma,
        "draw": draw.number,
        "controller": draw.controller,
        "noise": draw.deviation,
        "rounds": record.rounds(draw.period, len(draw.amplitudes)),
        "unphysical": float(arm.unphysical(record.parameters).mean()),
    }


def all_draws(options: argparse.Namespace) -> list[Draw]:
    """Return the draws of both parts, or of all controllers, as the options say."""
    speed, worst = laws.speeds("wam", options.gains), SIGMAS[-1]
    if options.controllers:
        return compared_draws(options)
    if options.quick:
        # Two seconds are enough for the geometric laws to be ahead. Rounds of two seconds are no
        # faster than the chosen speeds bear: at 0.8 s the natural law's loop was lost.
        short = (
            (NOISE, {"amplitudes": (wam.AMPLITUDE,), "end": 2.0}),
            (ROUNDS, {"amplitudes": AMPLITUDES[:2], "period": 2.0, "end": 2.4}),
        )
        return [
            Draw(part, law, speed[law], worst, k, **how)
            for k, law, (part, how) in product(range(options.draws), laws.LAWS, short)
        ]
    few = range(max(options.draws // 2, 1))
    return [
        *(
            Draw(NOISE, law, speed[law], sigma, k)
            for sigma, k, law in product(SIGMAS, range(options.draws), laws.LAWS)
        ),
        *(
            Draw(ROUNDS, law, speed[law], worst, k, amplitudes=AMPLITUDES)
            for k, law in product(few, laws.LAWS)
        ),
    ]


def compared_draws(options: argparse.Namespace) -> list[Draw]:
    """Return every controller with every law."""
    sigmas, end = ((0.4,), 0.2) if options.quick else ((0.1, 0.2, 0.4), None)
    kinds = product((PASSIVITY, ACCELERATION, FILTERED), COMPARED)
    found = product((0.0, DEVIATION), sigmas, range(options.draws), kinds)
    return [
        Draw(
            *(CONTROLLERS, law, speed_of(controller, law), sigma, k),
            **{"amplitudes": (wam.AMPLITUDE,), "end": end},
            **{"controller": controller, "deviation": noise},
        )
        for noise, sigma, k, (controller, law) in found
        # Without adaptation there is one computed torque.
        if (controller, law) != (FILTERED, laws.NONE)
    ]


def speed_of(controller: str, law: str) -> float:
    """Return the chosen γ⁻¹."""
    study = "wam" if controller == PASSIVITY else f"controller_{controller}"
    return laws.speeds(study, "rule")[law]


def grid_draws(options: argparse.Namespace) -> list[Draw]:
    """Return the draws from which speeds are chosen."""
    known = {PASSIVITY: laws.LAWS[1:]}
    known |= dict.fromkeys((ACCELERATION, FILTERED), COMPARED[1:]) if options.controllers else {}
    return [
        Draw(
            *(GRID_PART, law, speed, SIGMAS[-1], k, (wam.AMPLITUDE,)), **{"controller": controller}
        )
        for controller, own in known.items()
        for law, speed, k in product(own, laws.GRID, range(options.draws))
    ]


def summarize(rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Return means and deviations over draws, one line a part, σ, controller, noise and law."""
    lines = []
    for line, _, kept in laws.cells(rows, ("part", "sigma", "controller", "noise", "law")):
        rounds = np.mean([r["rounds"] for r in kept], axis=0).tolist() if kept else None
        lines.append({**line, "rounds": rounds, "last_round": rounds and rounds[-1]})
    return lines


def figures_of(summary: Sequence[dict[str, Any]]) -> dict[str, Figure]:
    """Return figures 5.4 and 5.5 of the source."""
    lines = [{**line, "rms_deviation": line["deviation"] or 0.0} for line in summary]
    noise, growing = ([x for x in lines if x["part"] == part] for part in (NOISE, ROUNDS))
    if not noise:
        return {}
    both = ("rms", "unphysical")
    return {
        "wam_initial_error": chart(noise, "sigma", both, "law", note="RMS in degrees"),
        "wam_rounds": chart(growing, "", "rounds", "law", note="RMS of each round, degrees"),
    }


def tell(options: argparse.Namespace, rows: list[Any]) -> None:
    """Print and write the results."""
    summary = summarize(rows)
    show(f"Tracking RMS in degrees, gains: {options.gains}", summary)
    table = {"gains": options.gains, "summary": summary, "rows": rows}
    write(options, table, wam=lambda: figures_of(summary))


def main() -> None:
    """Run the study from the command line."""
    parser = laws.study_parser(__doc__, gains="rule", estimates=True)
    words = "compare adaptive computed torque with passivity-based control"
    parser.add_argument("--controllers", action="store_true", help=words)
    laws.run_study(parser, run_draw, all_draws, grid_draws, tell, group="controller")


if __name__ == "__main__":
    main()
