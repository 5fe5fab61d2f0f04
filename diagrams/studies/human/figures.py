"""Figures of the human's identified bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from diagrams.studies.human.plate import NAMES, Array, Human
from diagrams.studies.human.table import BOUNDARY, Row
from geodrake.identification import RegularizerComparison
from geodrake.inertia import central_second_moment, pseudo_inertia
from geodrake.inertia.positive_definite import relative_logarithms
from geodrake.report import style

COLORS = {
    "euclidean": style.BEFORE,
    "point_mass_euclidean": "#c8a415",
    "pullback": style.AFTER,
    "entropic": style.FLOOR,
    "riemannian": "#8a5fa8",
}
LABELS = {"point_mass_euclidean": "euclidean,\npoint masses"}


def ellipsoid_figure(human: Human, found: Mapping[float, RegularizerComparison]) -> Figure:
    """Every body as its equivalent uniform ellipsoid, seen from the front (figure 3.13)."""
    colors = {"prior": style.MEASURED, **COLORS}
    figure = style.new_figure(2.2 * len(found) + 0.5)
    axes = figure.subplots(len(found), len(colors), sharex=True, sharey=True, squeeze=False)
    for line, (alpha, comparison) in zip(axes, found.items(), strict=True):
        for ax, (name, color) in zip(line, colors.items(), strict=True):
            phi = human.prior if name == "prior" else comparison.results[name].phi
            _draw_bodies(ax, human, phi, color)
            if comparison is next(iter(found.values())):
                ax.set_title(LABELS.get(name, name), fontsize=8)
        line[0].set_ylabel(f"α = {alpha:g}\nz, m", fontsize=8)
    for ax in axes[-1]:
        ax.set_xlabel("x, m", fontsize=8)
    style.note_below(
        figure,
        "Uniform ellipsoids of the same mass, centre of mass and inertia. "
        "Red: flat or a point, at the boundary of what a body can be.",
    )
    return figure


def _draw_bodies(ax: Axes, human: Human, phi: Array, color: str) -> None:
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
    everyone += [(r.regularizer, r.masses, COLORS[r.regularizer]) for r in rows]
    width, places = 0.8 / len(everyone), np.arange(len(NAMES))
    for k, (name, masses, color) in enumerate(everyone):
        ax.bar(
            places + (k - 0.5 * (len(everyone) - 1)) * width,
            masses,
            width,
            color=color,
            label=LABELS.get(name, name).replace("\n", " "),
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
        for name, color in COLORS.items():
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
                label=LABELS.get(name, name).replace("\n", " "),
            )
        style.log_scale(ax, "x")
        if field != "distance":
            style.log_scale(ax, "y")
        ax.set_title(label, fontsize=8, loc="left")
        ax.set_xlabel("α", fontsize=8)
    figure.axes[0].legend(frameon=False, fontsize=8, loc="upper left")
    return figure
