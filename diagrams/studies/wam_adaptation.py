"""Adapt all bodies of a WAM-like arm while it moves, by four laws ([Lee2019] §5.5.1).

The controller is the passivity-based one with K = λ M̂, Λ = λ and λ = 10 1/s; it and the laws act
at 1 kHz. The first estimate scales every body by 1 ± σ. Three parts:

- noise: over σ, two rounds of amplitude 0.8 rad (figure 5.4);
- rounds: five rounds of growing amplitude at σ = 0.4 (figure 5.5);
- steps: time steps of control and adaptation at σ = 0.4, one round, with speeds that 100 Hz can
  bear; and at 100 Hz with those of 1 kHz, which are too fast for it.

The Euclidean and the pullback law have a constant gain, for which Euler steps are exact; the
natural law's are geodesic, and for comparison the source's Euler steps. The speed γ⁻¹ of each law
is chosen by one rule on draws of their own (`adaptive/laws.py`, `--choose-gains`), or is the
source's (`--gains source`). There is no friction, and no limit of joints and efforts, as there.

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
from geodrake.control import PassivityBasedAdaptiveController, VaryingGains

SIGMAS = tuple(round(0.05 * k, 2) for k in range(1, 9))
AMPLITUDES = (0.4, 0.6, 0.8, 1.0, 1.2)  # rad
STEPS = (1e-4, 1e-3, 1e-2)  # s
STEPPED = (laws.EUCLIDEAN, laws.PULLBACK, laws.NATURAL, laws.NATURAL_EULER)
NOISE, ROUNDS, STEP, TOO_FAST, GRID_PART = "noise", "rounds", "steps", "too_fast", "grid"


@dataclass(frozen=True)
class Draw:
    """One closed loop."""

    part: str  # of the study
    law: str
    speed: float
    sigma: float
    number: int
    step: float = 1e-3
    amplitudes: tuple[float, ...] = (wam.AMPLITUDE, wam.AMPLITUDE)  # of the rounds, rad
    period: float = wam.PERIOD
    end: float | None = None  # when to stop, s; None for the end of the last round


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table."""
    arm = wam.load_wam()
    seed = laws.CALIBRATION_SEED if draw.part == GRID_PART else seed
    start = wam.first_estimate(draw.sigma, seed, draw.number)
    controller = PassivityBasedAdaptiveController(
        arm.control,
        laws.make_law(draw.law, arm.manifold, start, draw.speed),
        gains=VaryingGains(wam.RATE),
        time_step=draw.step,
        parameters=start,
        # V is not defined where Euler steps may take the natural law's estimate.
        truth=None if draw.law == laws.NATURAL_EULER else arm.truth,
    )
    motion = loop.rounds(draw.amplitudes, draw.period, len(arm.control.joints))
    record = loop.simulate(controller, wam.make_plant(), motion, end=draw.end)
    return {
        **record.told(draw, controller),
        "part": draw.part,
        "sigma": draw.sigma,
        "draw": draw.number,
        "step": draw.step,
        "rounds": record.rounds(draw.period, len(draw.amplitudes)),
        "unphysical": float(arm.unphysical(record.parameters).mean()),
    }


def all_draws(options: argparse.Namespace) -> list[Draw]:
    """Return the draws of the three parts, or some short ones."""
    if options.quick:
        return quick_draws(options)
    speed, worst = laws.speeds("wam", options.gains), SIGMAS[-1]
    slow, few = laws.speeds("wam_100_hz", options.gains), range(max(options.draws // 2, 1))
    found = [
        Draw(NOISE, law, speed[law], sigma, k)
        for sigma, k, law in product(SIGMAS, range(options.draws), laws.LAWS)
    ]
    found += [
        Draw(ROUNDS, law, speed[law], worst, k, amplitudes=AMPLITUDES)
        for k, law in product(few, laws.LAWS)
    ]
    for k, law in product(few, STEPPED):
        found += [Draw(STEP, law, slow[law], worst, k, h, (wam.AMPLITUDE,)) for h in STEPS]
        found.append(Draw(TOO_FAST, law, speed[law], worst, k, STEPS[-1], (wam.AMPLITUDE,)))
    return found


def quick_draws(options: argparse.Namespace) -> list[Draw]:
    """Return some short ones of all parts.

    Two seconds are enough for the geometric laws to be ahead. Rounds of two seconds are no faster
    than the chosen speeds bear: at 0.8 s the natural law's loop was lost.
    """
    speed, slow = (laws.speeds(name, options.gains) for name in ("wam", "wam_100_hz"))
    found = []
    for k in range(options.draws):
        for law in laws.LAWS:
            found += [
                Draw(NOISE, law, speed[law], SIGMAS[-1], k, amplitudes=(wam.AMPLITUDE,), end=2.0),
                Draw(ROUNDS, law, speed[law], SIGMAS[-1], k, 1e-3, AMPLITUDES[:2], 2.0, 2.4),
            ]
        slowly = {"step": 1e-2, "amplitudes": (wam.AMPLITUDE,), "end": 1.5}
        found += [Draw(STEP, law, slow[law], 0.4, k, **slowly) for law in STEPPED]
    return found


def grid_draws(options: argparse.Namespace) -> list[Draw]:
    """Return the draws that speeds are chosen on."""
    tried = product((1e-3, 1e-2), laws.LAWS[1:], laws.GRID, range(options.draws))
    return [
        Draw(GRID_PART, law, speed, SIGMAS[-1], k, step, (wam.AMPLITUDE,))
        for step, law, speed, k in tried
    ]


def summarize(rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Return means and deviations over draws, one line a part, σ, time step and law."""
    lines = []
    for line, _, kept in laws.cells(rows, ("part", "sigma", "step", "law")):
        rounds = np.mean([r["rounds"] for r in kept], axis=0).tolist() if kept else None
        lines.append({**line, "rounds": rounds, "last_round": rounds and rounds[-1]})
    return lines


def figures_of(summary: Sequence[dict[str, Any]]) -> dict[str, Figure]:
    """Return figures 5.4 and 5.5 of the source, and one of time steps."""
    lines = [{**line, "rms_deviation": line["deviation"] or 0.0} for line in summary]
    noise, growing, steps = ([x for x in lines if x["part"] == p] for p in (NOISE, ROUNDS, STEP))
    both = ("rms", "unphysical")
    return {
        "wam_initial_error": chart(noise, "sigma", both, "law", note="RMS in degrees"),
        "wam_rounds": chart(growing, "", "rounds", "law", note="RMS of each round, degrees"),
        "wam_time_steps": chart(steps, "step", both, "law", note="time steps in s, degrees"),
    }


def tell(options: argparse.Namespace, rows: list[Any]) -> None:
    """Print and write what came out."""
    summary = summarize(rows)
    show(f"Tracking RMS in degrees, gains: {options.gains}", summary)
    table = {"gains": options.gains, "summary": summary, "rows": rows}
    write(options, table, wam=lambda: figures_of(summary))


def main() -> None:
    """Run the study from the command line."""
    how = {"group": "step", "gains": "rule", "estimates": True}
    laws.run_study(__doc__, run_draw, all_draws, grid_draws, tell, **how)


if __name__ == "__main__":
    main()
