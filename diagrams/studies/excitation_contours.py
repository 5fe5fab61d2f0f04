"""A-optimality of a pendulum's motion, seen from other frames and in other units.

One link with one-dimensional mass, [Lee2019] §4.2.3 and figure 4.2, moves by

    q = A sin 2πt + q₀,   0 ≤ t ≤ 2,

and two base parameters are identifiable, h − m L and I − m L², with the joint at L of the body's
frame. The best A and q₀ depend on frame and units, unless the normalization is geometric.

    python -m diagrams.studies.excitation_contours --json contours.json --figures figures
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagrams.harness import script_parser, show, write
from geodrake.excitation.objective import NORMALIZATIONS, normalizing_map
from geodrake.report import style

Array = np.ndarray

GRAVITY = 9.81  # m/s²
MASS, LENGTH = 1.0, 0.5  # kg, m, of a uniform rod from the joint
NOISE = 0.1  # N·m
LARGEST = 2.0  # amplitude, rad


@dataclass(frozen=True)
class Coordinates:
    """Frame and units of the link's description."""

    name: str
    joint: float
    metre: float = 1.0  # how many units of length a metre is


COORDINATES = (
    Coordinates("frame at the joint, m", 0.0),
    Coordinates("frame at the centre of mass, m", -LENGTH / 2),
    Coordinates("frame 1 m beyond the tip, m", -LENGTH - 1.0),
    Coordinates("frame at the joint, cm", 0.0, 100.0),
)


def motions(A: Array, offset: Array, samples: int) -> tuple[Array, Array]:
    """Return g cos q and q̈ (..., samples) of motions with amplitudes and offsets (...), rad."""
    t = np.linspace(0.0, 2.0, samples)
    q = A[..., None] * np.sin(2 * np.pi * t) + offset[..., None]
    return GRAVITY * np.cos(q), -((2 * np.pi) ** 2) * A[..., None] * np.sin(2 * np.pi * t)


def normalizations(coordinates: Coordinates) -> dict[str, Array]:
    """Return K (3, 2) of every normalization for the parameters (m, h, I) in these coordinates.

    The metric ½ tr(P⁻¹ dP P⁻¹ dP) is that of P = [[I, h], [h, m]].
    """
    L, end = coordinates.joint * coordinates.metre, LENGTH * coordinates.metre
    h_J, I_J = MASS * end / 2, MASS * end**2 / 3
    prior = np.array([MASS, h_J + MASS * L, I_J + 2 * L * h_J + MASS * L**2])
    # A root of P, with P = C Cᵀ, carries the metric of the identity over: dP = C E Cᵀ.
    C = np.linalg.cholesky(np.array([[prior[2], prior[1]], [prior[1], prior[0]]]))
    units = (np.diag([2**0.5, 0.0]), np.diag([0.0, 2**0.5]), np.array([[0.0, 1.0], [1.0, 0.0]]))
    changes = [C @ E @ C.T for E in units]
    root = np.array([[x[1, 1], x[0, 1], x[0, 0]] for x in changes]).T
    B = np.array([[-L, 1.0, 0.0], [-(L**2), 0.0, 1.0]])
    return {name: normalizing_map(name, B, prior, root) for name in NORMALIZATIONS}


def criterion_map(coordinates: Coordinates, K: Array, columns: tuple[Array, Array]) -> Array:
    """Return A-optimality (...) of motions, [Lee2019] Eqs. (4.2.20) to (4.2.22) with −2 L q̈."""
    L, metre = coordinates.joint * coordinates.metre, coordinates.metre
    weight, acceleration = columns
    weight = weight * metre  # the effort is in units of kg · unit²/s²
    moment = weight - 2 * L * acceleration
    own = np.stack([L**2 * acceleration - L * weight, moment, acceleration], axis=-1)
    A = own / (NOISE * metre**2) @ K
    return np.asarray((np.linalg.svd(A, compute_uv=False) ** -2.0).sum(-1))


def run(points: int, samples: int) -> dict[str, Any]:
    """Return maps of every normalization in every coordinates, and their minima."""
    A = np.linspace(0.05, LARGEST, points)
    offset = np.linspace(-np.pi / 2, np.pi / 2, points + 1 - points % 2)
    grid = np.meshgrid(A, offset, indexing="ij")
    columns = motions(*grid, samples)
    rows: list[dict[str, Any]] = []
    for coordinates in COORDINATES:
        for normalization, K in normalizations(coordinates).items():
            values = criterion_map(coordinates, K, columns)
            best = np.unravel_index(int(values.argmin()), values.shape)
            rows.append(
                {
                    "normalization": normalization,
                    "coordinates": coordinates.name,
                    "best_amplitude": float(grid[0][best]),
                    "best_offset": float(grid[1][best]),
                    "best_value": float(values[best]),
                    "values": values,
                    "index": best,
                }
            )
    reference = next(r for r in rows if r["normalization"] == "geometric")["values"]
    for row in rows:
        shape = np.log10(row["values"]) - np.log10(reference)
        row["shape_difference"] = float(np.ptp(shape))  # decades, 0 for the same map
        row["geometric_loss"] = float(reference[row["index"]] / reference.min())
    return {"amplitude": A, "offset": offset, "rows": rows}


def draw(found: dict[str, Any]) -> Figure:
    """Return figure 4.2: a map for every normalization and coordinates, with its best motion."""
    figure = style.new_figure(7.2)
    axes = figure.subplots(len(NORMALIZATIONS), len(COORDINATES), sharex=True, sharey=True)
    for row in found["rows"]:
        names = [c.name for c in COORDINATES]
        i, j = NORMALIZATIONS.index(row["normalization"]), names.index(row["coordinates"])
        ax = axes[i, j]
        levels = np.log10(row["values"])
        levels = np.minimum(levels - levels.min(), 2.0)
        shape = (np.degrees(found["offset"]), found["amplitude"], levels)
        ax.contourf(*shape, levels=np.linspace(0.0, 2.0, 17), cmap="Blues_r")
        at = np.degrees(row["best_offset"])
        ax.plot(at, row["best_amplitude"], "o", color=style.BEFORE, clip_on=False, zorder=5)
        style.polish(ax, grid="none")
        if i == 0:
            ax.set_title(row["coordinates"], loc="left", **style.plain())
        if j == 0:
            label = f"{row['normalization']}\namplitude A, rad"
            ax.set_ylabel(label, **style.plain(8.5, style.QUIET))
        if i == len(NORMALIZATIONS) - 1:
            ax.set_xlabel("offset q₀, degrees from level", **style.plain(8.5, style.QUIET))
    style.note_below(
        figure,
        "Decades of A-optimality above the least value, light from two on; dots: best motions.",
    )
    return figure


def main() -> None:
    """Run the study from the command line."""
    options = script_parser(__doc__, figures=True).parse_args()
    found = run(41 if options.quick else 121, 200)
    hidden = ("values", "index")
    rows = [{k: v for k, v in row.items() if k not in hidden} for row in found["rows"]]
    lines = sorted(rows, key=lambda row: NORMALIZATIONS.index(row["normalization"]))
    show("Where each map is least, decades by which it differs, and what that costs", lines)
    write(options, {"rows": rows}, excitation_contours=lambda: draw(found))


if __name__ == "__main__":
    main()
