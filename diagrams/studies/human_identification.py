"""A human on a force plate: inertial parameters by five regularizers with the same residual.

As in [Lee2019] §3.6.3: 16 bodies, 330 samples of the vertical force and the zero-moment point, a
prior of uniform density, an outer ellipsoid for every body, and a total mass that is known, Eq.
(3.6.83). γ = α tr(AᵀA) of the Euclidean regularizer sets the residual that all others meet (figure
3.13). Point masses, Eq. (3.6.84), fill bodies of uniform density evenly.

Errors in N and cm are those of table 3.1. The source's test motions are not public: here blocks of
consecutive steps, with a gap at both ends, are predicted by fits to all others.

    python -m diagrams.studies.human_identification --json human.json --figures figures

The measurements are not part of the project; without them the script says where they go.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from diagrams.harness import script_parser, write
from diagrams.public_data import add_folder_option, require
from diagrams.studies.human.figures import ellipsoid_figure, mass_figure, sweep_figure
from diagrams.studies.human.plate import DATA, NAMES, PREDICTED, Array, Human, blocks
from diagrams.studies.human.table import Errors, Row, errors_of, rows_of
from geodrake.identification import (
    PointMasses,
    PointMassEuclidean,
    RegularizerComparison,
    compare_regularizers,
)

REGULARIZERS = ("euclidean", "point_mass_euclidean", "pullback", "entropic", "riemannian")
BASELINE = 1e-2
ALPHAS, QUICK_ALPHAS = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0), (1e-2, 1.0)
POINTS, QUICK_POINTS = 1351, 240
BLOCKS, QUICK_BLOCKS = 11, 3
GAP = 5  # steps beside a block


def point_masses(human: Human, number: int) -> PointMasses:
    """So many points, nearly all of the same mass, as the prior's density is uniform."""
    spare = number - 10 * len(NAMES)
    counts = 10 + np.rint(spare * human.prior[:, 0] / human.mass).astype(int)
    return PointMasses.of_bodies(human.prior, counts.tolist())


def compare(human: Human, alpha: float, points: PointMasses) -> RegularizerComparison:
    """Fits of equal residual, that of the Euclidean one at α."""
    own = {"point_mass_euclidean": PointMassEuclidean(points)}
    return compare_regularizers(
        human.A,
        human.b,
        human.prior,
        gamma=human.gamma(alpha),
        reference="euclidean",
        regularizers=[own.get(name, name) for name in REGULARIZERS],
        sigma=human.sigma,
        ellipsoids=human.ellipsoids,
        total_mass=human.mass,
    )


def held_out(human: Human, points: PointMasses, number: int) -> dict[str, list[Array]]:
    """Errors (t, 3) of each of as many blocks, from fits to the others, for every regularizer."""
    found: dict[str, list[Array]] = {name: [] for name in REGULARIZERS}
    for training, test in track(list(blocks(human.steps, number, GAP)), "blocks", transient=True):
        for name, fit in compare(human.at(training), BASELINE, points).results.items():
            found[name].append(human.at(test).errors(fit.phi))
    return found


def show(rows: Sequence[Row], errors: Sequence[Errors], console: Console) -> None:
    """Print the tables."""
    table = Table("α", "regularizer", "residual", "mismatch", "distance", "least λ", "degenerate")
    table.add_column("starts")
    for row in rows:
        table.add_row(
            f"{row.alpha:g}" if row.regularizer == REGULARIZERS[0] else "",
            row.regularizer,
            f"{row.residual:.2f}",
            f"{row.mismatch:.1e}",
            f"{row.distance:.2f}",
            f"{row.least:.1e}",
            f"{len(row.degenerate)} of {len(NAMES)}",
            {None: "", True: "agree", False: "differ"}[row.starts_agree],
        )
    console.print(table)
    table = Table(
        "RMS errors", *(f"{when}: {what}" for when in ("train", "test") for what in PREDICTED)
    )
    for line in errors:
        table.add_row(line.regularizer, *(f"{value:.2f}" for value in (*line.train, *line.test)))
    console.print(table)


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, "only α = 0.01 and 1, three blocks")
    add_folder_option(parser)
    options = parser.parse_args()
    require(parser, options.shared, DATA)
    human, found, rows = Human.read(options.shared / DATA), {}, []
    points = point_masses(human, QUICK_POINTS if options.quick else POINTS)
    for alpha in QUICK_ALPHAS if options.quick else ALPHAS:
        found[alpha] = compare(human, alpha, points)
        rows += rows_of(human, alpha, found[alpha])
    tested = held_out(human, points, QUICK_BLOCKS if options.quick else BLOCKS)
    errors = errors_of(human, found[BASELINE], tested)
    show(rows, errors, Console(width=160))
    shown = {alpha: found[alpha] for alpha in (1e-4, BASELINE, 1.0) if alpha in found}
    baseline = [row for row in rows if row.alpha == BASELINE]
    write(
        options,
        {"fits": rows, "errors": errors},
        human_ellipsoids=lambda: ellipsoid_figure(human, shown),
        human_masses=lambda: mass_figure(human, baseline),
        human_sweep=lambda: sweep_figure(rows),
    )


if __name__ == "__main__":
    main()
