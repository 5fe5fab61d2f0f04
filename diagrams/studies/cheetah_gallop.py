"""The leg's bodies, identified with the base fixed, in a gallop of the whole robot.

As in [Lee2019] §3.6.2.2 and figure 3.12: random true legs, torques without noise from the gallop's
motion of one leg on a fixed base, next to no regularization, equal residuals; then the errors of
joint torques and of the force and moment on the trunk while the whole robot gallops. Robot and
motion are ours, see `models/cheetah.dmd.yaml` and `diagrams/cheetah/gallop.py`.

    python -m diagrams.studies.cheetah_gallop --json cheetah_gallop.json --figures figures
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from rich.progress import track

from diagrams.harness import plain, script_parser, show, write
from diagrams.studies.cheetah.fits import COLORS, Condensed, fit, fit_points
from diagrams.studies.cheetah.gallop import (
    GEARS,
    PHASES,
    STRIDE,
    gallop,
    leg_motion,
    quantities,
    whole_robot,
)
from diagrams.studies.cheetah.leg import Array, Leg, load_leg
from geodrake.identification import PointMasses
from geodrake.inertia import is_realizable, perturb
from geodrake.inertia.ellipsoids import ellipsoid_of_quadric
from geodrake.report import style
from geodrake.robot import base_parameters

ALPHA = 1e-11
"""The Euclidean γ over tr(AᵀA)."""
DELTA, POINTS = 0.5, 10
"""Greatest share of the mass that is added or taken away, and by how many points."""
SETS = {f"{number} point masses": number for number in (264, 687)}
"""Of Eq. (3.6.78), and how many there are in each."""
KINDS = ("euclidean", *SETS, "pullback", "entropic")


@dataclass(frozen=True)
class Row:
    """Errors of one regularizer in the gallop, over the true legs.

    Attributes:
        regularizer: Its name, or "prior".
        quantity: What is predicted.
        unit: Its unit.
        mean: Mean RMS error.
        deviation: Standard deviation of the RMS error.
        train: Mean RMS error of the torques that were fitted, N·m.
    """

    regularizer: str
    quantity: str
    unit: str
    mean: float
    deviation: float
    train: float


def true_legs(leg: Leg, count: int, rng: np.random.Generator) -> Array:
    """Legs (count, 6, 10) that differ from the prior by point masses inside the ellipsoids.

    Those of which mass was taken away so that a body no longer fits into its ellipsoid are left
    out.
    """
    support, legs = ellipsoid_of_quadric(leg.ellipsoids), np.empty((0, *leg.prior.shape))
    while len(legs) < count:
        drawn = perturb(
            leg.prior,
            2 * count,
            rng=rng,
            mass_uncertainty=DELTA,
            point_masses=POINTS,
            support=support,
        ).phi
        inside = is_realizable(drawn, leg.ellipsoids).all(axis=1)
        legs = np.concatenate([legs, drawn[inside]])
    return legs[:count]


def identified(
    leg: Leg, points: Mapping[str, PointMasses], A: Array, truth: Array
) -> tuple[dict[str, Array], dict[str, float]]:
    """Parameters and RMS training errors by regularizer, from torques without noise."""
    data = Condensed.of(A, A @ truth.ravel())
    euclidean = fit(data, leg, "euclidean", gamma=ALPHA * float(np.square(A).sum()))
    bound, found = euclidean.residual, {"euclidean": euclidean}
    for kind in KINDS[1:]:
        if kind in points:
            found[kind] = fit_points(data, leg, points[kind], bound)
        else:
            found[kind] = fit(data, leg, kind, residual_bound=bound)
    return (
        {kind: result.phi for kind, result in found.items()},
        {kind: data.rms(result) for kind, result in found.items()},
    )


def run(*, seed: int, truths: int) -> tuple[list[Row], int]:
    """Identify `truths` random legs.

    Returns:
        The table, and how many base parameters the motion of the leg tells.
    """
    rng, leg = np.random.default_rng(seed), load_leg(GEARS)
    time = np.linspace(0.0, 1.0 / STRIDE, 200, endpoint=False)
    plant = whole_robot()
    predicted = quantities(plant, gallop(plant, time))
    A = leg.regressor(leg_motion(time, PHASES["front_left"])).reshape(-1, 60)
    kinds = (*KINDS, "prior")
    errors = np.empty((truths, len(kinds), len(predicted)))
    train = np.empty((truths, len(kinds)))
    legs = true_legs(leg, truths, rng)
    points = {kind: leg.point_masses(number) for kind, number in SETS.items()}
    for k, truth in enumerate(track(legs, "true legs", transient=True)):
        found, fitted = identified(leg, points, A, truth)
        found["prior"] = leg.prior
        fitted["prior"] = float(np.sqrt(np.mean((A @ (truth - leg.prior).ravel()) ** 2)))
        for i, kind in enumerate(kinds):
            errors[k, i] = [q.rms(found[kind] - truth) for q in predicted.values()]
            train[k, i] = fitted[kind]
    rows = [
        Row(
            *(kind, name, "N" if name == "body force" else "N·m"),
            *(float(errors[:, i, j].mean()), float(errors[:, i, j].std())),
            float(train[:, i].mean()),
        )
        for j, name in enumerate(predicted)
        for i, kind in enumerate(kinds)
    ]
    return rows, base_parameters(A).rank


def error_figure(rows: Sequence[Row]) -> Figure:
    """Errors in the gallop by regularizer, figure 3.12."""
    figure = style.new_figure(3.6)
    names = list(dict.fromkeys(row.quantity for row in rows))
    for ax, name in zip(figure.subplots(1, len(names)), names, strict=True):
        *bars, prior = (row for row in rows if row.quantity == name)
        ax.bar(
            [row.regularizer.replace(" ", "\n") for row in bars],
            [row.mean for row in bars],
            yerr=[[min(row.mean, row.deviation) for row in bars], [row.deviation for row in bars]],
            color=[COLORS[row.regularizer] for row in bars],
            ecolor=style.INK,
            capsize=3,
            width=0.65,
        )
        style.polish(ax, grid="y")
        ax.set_title(f"{name}, {prior.unit}", loc="left", **style.plain(fontweight="bold"))
        ax.set_title(f"prior: {prior.mean:.3g}", loc="right", **style.plain(color=style.QUIET))
        top = max(row.mean + row.deviation for row in bars)
        ax.set_ylim(0, 1.12 * top)
        for k, row in enumerate(bars):
            place = row.mean + row.deviation + 0.02 * top
            ax.text(k, place, f"{row.mean:.3g}", ha="center", **style.plain(style.SMALL))
    return figure


def main() -> None:
    """Run the study from the command line."""
    options = script_parser(__doc__, "five true legs instead of a hundred").parse_args()
    logging.getLogger("drake").setLevel(logging.WARNING)
    rows, rank = run(seed=options.seed, truths=5 if options.quick else 100)
    columns = {"quantity": "", "regularizer": "", "mean": ".3g", "deviation": ".3g"}
    show("RMS", {**columns, "train": ".3g"}, plain(rows))
    print(f"The leg's motion tells {rank} base parameters of its 60 parameters.")
    write(options, rows, cheetah_gallop_errors=lambda: error_figure(rows))


if __name__ == "__main__":
    main()
