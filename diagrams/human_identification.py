"""A human on a force plate: inertial parameters by four regularizers with the same residual.

As in [Lee2019] §3.6.3 and figure 3.13: 16 bodies, 330 samples of the vertical force and the
zero-moment point, a prior of uniform density and an outer ellipsoid for every body. γ = α tr(AᵀA)
of the Euclidean regularizer sets the residual that all others meet.

    python diagrams/human_identification.py --json human.json --figures figures

The measurements are not part of the project; without them the script says where they go.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from public_data import add_folder_option, require
from rich.console import Console
from rich.table import Table

from geodrake.identification import RegularizerComparison, compare_regularizers
from geodrake.inertia import central_second_moment, pseudo_inertia
from geodrake.inertia.positive_definite import distance, relative_logarithms
from geodrake.report import style

Array = NDArray[np.float64]

DATA = "data/human_force_plate.npz"
REGULARIZERS = ("euclidean", "pullback", "entropic", "riemannian")
COLORS = (style.BEFORE, style.AFTER, style.FLOOR, "#8a5fa8")
BASELINE = 1e-2
ALPHAS = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
QUICK = (1e-2, 1.0)
ROWS = ("vertical force", "zero-moment x", "zero-moment y")
BOUNDARY = 1e-3
"""Smallest eigenvalue of P(φ⁰)⁻¹P(φ) below which a body is flat or a point, for all purposes."""

# The data have no names; these are read off the places of the bodies. A and B are the two sides.
_LIMBS = [f"{name} {side}" for name in ("foot", "shank", "thigh") for side in "AB"]
_ARMS = [f"{name} {side}" for name in ("hand", "forearm") for side in "AB"]
NAMES = (*_LIMBS, "pelvis", *_ARMS, "abdomen", "chest", "upper arm A", "upper arm B", "head")


@dataclass(frozen=True, eq=False)
class Human:
    """The measurements.

    Attributes:
        A: (m, 160) regressor; b: (m,) measurements; sigma: (m,) their standard deviations.
        prior: (16, 10) inertial parameters of the mesh with uniform density.
        ellipsoids: (16, 4, 4) outer ellipsoids, positive inside.
        X_WB: (16, 4, 4) poses of the bodies, for pictures.
    """

    A: Array
    b: Array
    sigma: Array
    prior: Array
    ellipsoids: Array
    X_WB: Array

    @classmethod
    def read(cls, path: Path) -> Human:
        """The measurements of a file."""
        with np.load(path) as file:
            sigma = np.tile(file["sigma"], len(file["b"]) // 3)
            return cls(file["A"], file["b"], sigma, file["phi_prior"], file["Q"], file["X_WB"])

    def gamma(self, alpha: float) -> float:
        """γ = α tr(AᵀΣ⁻¹A)."""
        return alpha * float(np.square(self.A / self.sigma[:, None]).sum())


@dataclass(frozen=True)
class Row:
    """One regularizer at one α.

    Attributes:
        alpha: α of the Euclidean regularizer.
        regularizer: Name.
        gamma: Its own γ.
        residual: ‖A Φ − b‖²_{Σ⁻¹}.
        mismatch: Relative difference of the residual from the Euclidean one.
        distance: Geodesic distance of all bodies from the prior.
        least: Smallest eigenvalue of P(φ⁰)⁻¹P(φ) of all bodies.
        degenerate: Bodies where that is below 1e-3.
        starts_agree: Whether all starts led to the same minimum; None for convex regularizers.
        rms: RMS error of the three kinds of rows, in standard deviations.
        masses: Mass of every body, kg.
    """

    alpha: float
    regularizer: str
    gamma: float
    residual: float
    mismatch: float
    distance: float
    least: float
    degenerate: Sequence[str]
    starts_agree: bool | None
    rms: Sequence[float]
    masses: Sequence[float]


def rows_of(human: Human, alpha: float, found: RegularizerComparison) -> list[Row]:
    """The table of one α."""
    rows = []
    for name, result in found.results.items():
        errors = (human.A @ result.phi.ravel() - human.b) / human.sigma
        least = np.exp(relative_logarithms(pseudo_inertia(human.prior), pseudo_inertia(result.phi)))
        bodies = distance(pseudo_inertia(human.prior), pseudo_inertia(result.phi))
        rows.append(
            Row(
                alpha=alpha,
                regularizer=name,
                gamma=result.gamma,
                residual=result.residual,
                mismatch=result.residual / found.residual - 1.0,
                distance=float(np.linalg.norm(bodies)),
                least=float(least.min()),
                degenerate=[NAMES[i] for i in np.flatnonzero(least.min(1) < BOUNDARY)],
                starts_agree=result.minima.agree if result.minima else None,
                rms=np.sqrt(np.square(errors.reshape(-1, 3)).mean(0)).tolist(),
                masses=result.phi[:, 0].tolist(),
            )
        )
    return rows


def show(rows: Sequence[Row], console: Console) -> None:
    """Print the table."""
    table = Table("α", "regularizer", "residual", "mismatch", "distance", "least λ", "degenerate")
    table.add_column("starts")
    for column in ROWS:
        table.add_column(f"{column}, σ")
    for row in rows:
        agree = {None: "", True: "agree", False: "differ"}[row.starts_agree]
        table.add_row(
            f"{row.alpha:g}" if row.regularizer == REGULARIZERS[0] else "",
            row.regularizer,
            f"{row.residual:.2f}",
            f"{row.mismatch:.1e}",
            f"{row.distance:.2f}",
            f"{row.least:.1e}",
            f"{len(row.degenerate)} of {len(NAMES)}",
            agree,
            *(f"{value:.3f}" for value in row.rms),
        )
    console.print(table)


def ellipsoid_figure(human: Human, found: dict[float, RegularizerComparison]) -> Figure:
    """Every body as its equivalent uniform ellipsoid, seen from the front (figure 3.13)."""
    columns = ("prior", *REGULARIZERS)
    figure = style.new_figure(2.55 * len(found) + 0.5)
    axes = figure.subplots(len(found), len(columns), sharex=True, sharey=True, squeeze=False)
    for line, (alpha, comparison) in zip(axes, found.items(), strict=True):
        for ax, name, color in zip(line, columns, (style.MEASURED, *COLORS), strict=True):
            phi = human.prior if name == "prior" else comparison.results[name].phi
            _draw_bodies(ax, human, phi, color)
            ax.set_title("prior" if name == "prior" else f"{name}, α = {alpha:g}", fontsize=8)
        line[0].set_ylabel("z, m", fontsize=8)
    for ax in axes[-1]:
        ax.set_xlabel("x, m", fontsize=8)
    style.note_below(
        figure,
        "Uniform ellipsoids of the same mass, centre of mass and inertia. "
        "Red: flat or a point, at the boundary of what a body can be.",
    )
    return figure


def _draw_bodies(ax, human: Human, phi: Array, color: str) -> None:  # type: ignore[no-untyped-def]
    style.polish(ax)
    ax.set(aspect="equal", xlim=(-0.75, 0.85), ylim=(-0.1, 1.85))
    R, p = human.X_WB[:, :3, :3], human.X_WB[:, :3, 3]
    centers = p + np.einsum("bij,bj->bi", R, phi[:, 1:4] / phi[:, :1])
    # A uniform ellipsoid has semi-axes √(5 λ) for eigenvalues λ of Σᶜ/m; its shadow likewise.
    spread = 5.0 * R @ central_second_moment(phi) @ np.swapaxes(R, 1, 2) / phi[:, :1, None]
    least = relative_logarithms(pseudo_inertia(human.prior), pseudo_inertia(phi)).min(1)
    for center, shape, low in zip(centers, spread[:, ::2, ::2], least, strict=True):
        values, vectors = np.linalg.eigh(shape)
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        height, width = 2.0 * np.sqrt(np.maximum(values, 1e-5))
        flat = low < np.log(BOUNDARY)
        face = "#c8372d" if flat else color
        patch = Ellipse(center[::2], width, height, angle=angle, facecolor=face, alpha=0.55)
        patch.set(edgecolor=style.INK, linewidth=0.5)
        ax.add_patch(patch)


def mass_figure(human: Human, rows: Sequence[Row]) -> Figure:
    """Mass of every body, side by side."""
    figure = style.new_figure(3.6)
    ax = style.polish(figure.subplots(), grid="y")
    everyone = [("prior", human.prior[:, 0].tolist(), style.MEASURED)]
    everyone += [(r.regularizer, r.masses, c) for r, c in zip(rows, COLORS, strict=True)]
    width, places = 0.8 / len(everyone), np.arange(len(NAMES))
    for k, (name, masses, color) in enumerate(everyone):
        ax.bar(
            places + (k - 0.5 * (len(everyone) - 1)) * width, masses, width, color=color, label=name
        )
    ax.set_xticks(places, NAMES, rotation=40, ha="right")
    ax.set_ylabel("mass, kg", fontsize=8)
    ax.legend(frameon=False, fontsize=8, title=f"α = {rows[0].alpha:g}", title_fontsize=8)
    return figure


def sweep_figure(rows: Sequence[Row]) -> Figure:
    """What α does: residual, distance from the prior, and how flat the flattest body gets."""
    figure = style.new_figure(3.2)
    names = {
        "residual": "residual ‖AΦ − b‖²",
        "distance": "geodesic distance from the prior",
        "least": "smallest eigenvalue of P(φ⁰)⁻¹P(φ)",
    }
    for ax, (field, label) in zip(figure.subplots(1, 3), names.items(), strict=True):
        style.polish(ax)
        for name, color in zip(REGULARIZERS, COLORS, strict=True):
            own = [row for row in rows if row.regularizer == name]
            values = [getattr(row, field) for row in own]
            dashed = "--" if name == "riemannian" else "-"
            ax.plot(
                [row.alpha for row in own],
                values,
                dashed,
                marker="o",
                ms=3,
                color=color,
                label=name,
            )
        style.log_scale(ax, "x")
        if field != "distance":
            style.log_scale(ax, "y")
        ax.set_title(label, fontsize=8, loc="left")
        ax.set_xlabel("α", fontsize=8)
    figure.axes[1].legend(frameon=False, fontsize=8)
    return figure


def main() -> None:
    """Run the study from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_folder_option(parser)
    parser.add_argument("--quick", action="store_true", help="only α = 0.01 and 1")
    parser.add_argument("--seed", type=int, default=0, help="nothing here is random")
    parser.add_argument("--json", type=Path, help="write the table here")
    parser.add_argument("--figures", type=Path, help="write figures into this folder")
    options = parser.parse_args()
    require(parser, options.shared, DATA)
    human, found, rows = Human.read(options.shared / DATA), {}, []
    for alpha in QUICK if options.quick else ALPHAS:
        found[alpha] = compare_regularizers(
            human.A,
            human.b,
            human.prior,
            gamma=human.gamma(alpha),
            reference="euclidean",
            regularizers=REGULARIZERS,
            sigma=human.sigma,
            ellipsoids=human.ellipsoids,
        )
        rows += rows_of(human, alpha, found[alpha])
    show(rows, Console(width=160))
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        shown = {alpha: found[alpha] for alpha in (1e-4, BASELINE, 1.0) if alpha in found}
        baseline = [row for row in rows if row.alpha == BASELINE]
        figures = {
            "human_ellipsoids": ellipsoid_figure(human, shown),
            "human_masses": mass_figure(human, baseline),
            "human_sweep": sweep_figure(rows),
        }
        for name, figure in figures.items():
            (options.figures / f"{name}.png").write_bytes(style.png(figure))


if __name__ == "__main__":
    main()
