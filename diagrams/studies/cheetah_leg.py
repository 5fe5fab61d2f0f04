"""A leg like the MIT Cheetah 3's, identified from few samples with every regularizer.

Three links and three geared rotors (`models/cheetah_leg.urdf`), as in [Lee2019] §3.6.2.1 and
figures 3.10 and 3.11. Torques are those of the parameters that others identified on the robot; the
leg swings with friction, encoder and torque noise, filtered as in the source. Training samples are
5 ms apart, from one stretch of the first ten seconds, or, to compare, 30 samples scattered over
them; the next ten are the test. All regularizers but the Riemannian one meet the training residual
of the entropic one. 300 point masses are spread over the bodies' ellipsoids, Eq. (3.6.72).

    python -m diagrams.studies.cheetah_leg --json cheetah_leg.json --figures figures
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.progress import track

from diagrams.harness import SHADES, chart, script_parser, show, write
from diagrams.studies.cheetah.leg import (
    REGULARIZERS,
    Condensed,
    Leg,
    Samples,
    compare,
    load_leg,
    measure,
)
from geodrake.identification import IdentificationResult
from geodrake.report import style
from geodrake.report.ellipsoids import EllipsoidSet, ellipsoid_figure

SPACING = 5  # ms between the samples of a stretch
SIZES, QUICK_SIZES = (10, 30, 60, 120, 240, 480, 960), (30,)
DRAWS, QUICK_DRAWS = 35, 8
POINTS = 300


@dataclass(frozen=True, eq=False)
class Study:
    """Results of the study."""

    leg: Leg
    # One a size of the training set and regularizer; the last ones for all samples.
    rows: list[dict[str, Any]]
    # Regularizer -> parameters from the first stretch of 30 samples.
    example: dict[str, IdentificationResult]


def run(*, seed: int, sizes: Sequence[int], draws: int) -> Study:
    """Fit all samples, keep their friction, and fit draws of each size.

    Sizes are numbers of consecutive training samples; there are also draws of 30 scattered ones.
    """
    rng, leg = np.random.default_rng(seed), load_leg()
    points = leg.point_masses(POINTS)
    train, test = measure(leg, rng)
    columns = np.concatenate([train.regressor, train.friction], -1).reshape(-1, 66)
    everything = Condensed.of(columns, train.torque.ravel())
    whole = compare(everything, leg, points, extra_bounds=[(0.0, np.inf)] * 6)
    friction = whole["entropic"].extra
    prior, count = test.rms(leg.prior, friction), len(train.torque)
    rows: list[dict[str, Any]] = []
    example: dict[str, IdentificationResult] = {}
    for size, stretch in (*((size, True) for size in sizes), (30, False)):
        errors = np.empty((draws, len(REGULARIZERS), 2))
        for draw in track(range(draws), f"{size} samples", transient=True):
            data = drawn(train, friction, size, stretch, rng)
            found = compare(data, leg, points)
            example = example or (found if (size, stretch) == (30, True) else {})
            for k, kind in enumerate(REGULARIZERS):
                errors[draw, k] = data.rms(found[kind]), test.rms(found[kind].phi, friction)
        for kind, (fitted, tested) in zip(REGULARIZERS, errors.transpose(1, 2, 0), strict=True):
            numbers = (fitted.mean(), tested.mean(), np.median(tested), tested.std(), prior)
            rows.append(row(size, stretch, kind, numbers))
    for kind, found in whole.items():
        tested = test.rms(found.phi, found.extra)
        numbers = (everything.rms(found), tested, tested, 0.0, prior)
        rows.append(row(count, True, kind, numbers))
    return Study(leg, rows, example)


def row(samples: int, stretch: bool, kind: str, numbers: Sequence[float]) -> dict[str, Any]:
    """Return a row of the table: RMS errors in N·m, with the deviation over draws."""
    own = {"samples": samples, "stretch": stretch, "regularizer": kind}
    names = ("train", "test", "median", "deviation", "prior")
    return own | dict(zip(names, map(float, numbers), strict=True))


def drawn(
    train: Samples, friction: np.ndarray, size: int, stretch: bool, rng: np.random.Generator
) -> Condensed:
    """Return training samples without their friction, from one stretch or scattered."""
    if stretch:
        first = rng.integers(len(train.torque) - size * SPACING)
        chosen = first + SPACING * np.arange(size)
    else:
        chosen = rng.choice(len(train.torque), size, replace=False)
    left = train.torque[chosen] - train.friction[chosen] @ friction
    return Condensed.of(train.regressor[chosen].reshape(-1, 60), left.ravel())


def error_figure(study: Study) -> Figure:
    """Return training and test errors against the number of training samples, figure 3.10."""
    drawn = [r for r in study.rows[: -len(REGULARIZERS)] if r["stretch"]]
    drawn = [{**r, "test_deviation": r["deviation"]} for r in drawn]
    last = study.rows[-1]
    levels = {"prior": {"test": last["prior"]}, f"all {last['samples']} samples": last}
    return chart(drawn, "samples", ("train", "test"), "regularizer", levels=levels, note="N·m")


def body_figure(study: Study) -> Figure:
    """Return the bodies identified from the first stretch of 30 samples, figure 3.11."""
    plant, sets = (
        study.leg.model.plant,
        [EllipsoidSet.of("prior", study.leg.prior, color=style.MEASURED)],
    )
    for shade, (kind, found) in zip(SHADES, study.example.items(), strict=False):
        at = [first // 10 for first in found.active_blocks]
        name = kind.replace("_", " ")
        sets.append(EllipsoidSet.of(name, found.phi, color=shade, at_boundary=at))
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, study.leg.model.plant_positions(np.array([[0, 0.5, -1]]))[0])
    return ellipsoid_figure(plant, sets, context=context)


def main() -> None:
    """Run the study from the command line."""
    options = script_parser(__doc__, "eight draws of one size", figures=True).parse_args()
    logging.getLogger("drake").setLevel(logging.WARNING)
    sizes, draws = (QUICK_SIZES, QUICK_DRAWS) if options.quick else (SIZES, DRAWS)
    study = run(seed=options.seed, sizes=sizes, draws=draws)
    show("RMS errors of joint torques, N·m", study.rows)
    figures = {"cheetah_leg_errors": error_figure, "cheetah_leg_bodies": body_figure}
    write(options, study.rows, **{name: partial(draw, study) for name, draw in figures.items()})


if __name__ == "__main__":
    main()
