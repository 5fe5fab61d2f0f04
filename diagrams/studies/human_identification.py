"""A human on a force plate: inertial parameters by five regularizers with the same residual.

As in [Lee2019] §3.6.3: 16 bodies, 330 samples of the vertical force and the zero-moment point, a
prior of uniform density, an outer ellipsoid for every body, and a known total mass, Eq. (3.6.83).
γ = α tr(AᵀA) of the Euclidean regularizer sets the residual that all others meet (figure 3.13).
Point masses, Eq. (3.6.84), fill bodies of uniform density evenly. Errors in N and cm are those of
table 3.1. The source's test motions are not public: here blocks of consecutive steps, with a gap at
both ends, are predicted by fits to all others.

    python -m diagrams.studies.human_identification --json human.json --figures figures

The measurements are not part of the project; without them the script says where they go.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from rich.progress import track

from diagrams.harness import chart, script_parser, show, write
from diagrams.public_data import add_folder_option, require
from geodrake.identification import (
    PointMasses,
    PointMassEuclidean,
    RegularizerComparison,
    compare_regularizers,
)
from geodrake.inertia import Array, pseudo_inertia
from geodrake.inertia.parameters import central_second_moment
from geodrake.inertia.positive_definite import distance, relative_logarithms
from geodrake.report import style

Steps = NDArray[np.intp]

DATA = "data/human_force_plate.npz"
PREDICTED = ("vertical force, N", "zero-moment x, cm", "zero-moment y, cm")
ROWS = 3  # of a step: moments about the plate's y and x, then the vertical force

# The data have no names; these are read off the places of the bodies. A and B are the two sides.
_LIMBS = [f"{name} {side}" for name in ("foot", "shank", "thigh") for side in "AB"]
_ARMS = [f"{name} {side}" for name in ("hand", "forearm") for side in "AB"]
NAMES = (*_LIMBS, "pelvis", *_ARMS, "abdomen", "chest", "upper arm A", "upper arm B", "head")


@dataclass(frozen=True, eq=False)
class Human:
    """The measurements."""

    # (3 T, 160) regressor; b: (3 T,) measurements; sigma: (3 T,) their standard deviations.
    A: Array
    b: Array
    sigma: Array
    prior: Array  # (16, 10) inertial parameters of the mesh with uniform density
    ellipsoids: Array  # (16, 4, 4) outer ellipsoids, positive inside
    X_WB: Array  # (16, 4, 4) poses of the bodies, for pictures

    @classmethod
    def read(cls, path: Path) -> Human:
        """Return the measurements of a file."""
        with np.load(path) as file:
            sigma = np.tile(file["sigma"], len(file["b"]) // ROWS)
            return cls(file["A"], file["b"], sigma, file["phi_prior"], file["Q"], file["X_WB"])

    @property
    def steps(self) -> int:
        """Number of time steps T."""
        return len(self.b) // ROWS

    @property
    def mass(self) -> float:
        """Mass of the whole human, kg, which is known and which the prior has."""
        return float(self.prior[:, 0].sum())

    def gamma(self, alpha: float) -> float:
        """Return γ = α tr(AᵀΣ⁻¹A)."""
        return alpha * float(np.square(self.A / self.sigma[:, None]).sum())

    def at(self, steps: Steps) -> Human:
        """Return the measurements of some steps."""
        rows = (ROWS * steps[:, None] + np.arange(ROWS)).ravel()
        return replace(self, A=self.A[rows], b=self.b[rows], sigma=self.sigma[rows])

    def errors(self, phi: Array) -> Array:
        """Return (T, 3) errors of the vertical force, N, and of the zero-moment point, cm."""
        wrenches = np.stack([self.A @ phi.ravel(), self.b]).reshape(2, -1, ROWS)
        points = 100.0 * wrenches[..., [1, 0]] / wrenches[..., 2:]
        predicted, measured = np.concatenate([wrenches[..., 2:], points], axis=-1)
        return np.asarray(predicted - measured)


def blocks(steps: int, number: int, gap: int) -> Iterator[tuple[Steps, Steps]]:
    """Yield steps for training and testing, for each of `number` blocks of consecutive steps.

    `gap` steps on both sides of the tested block are omitted: velocities and accelerations are
    differences of filtered poses, so neighbours share noise.
    """
    every = np.arange(steps)
    for block in np.array_split(every, number):
        far = (every < block[0] - gap) | (every > block[-1] + gap)
        yield every[far], block


BOUNDARY = 1e-3
"""Smallest eigenvalue of P(φ⁰)⁻¹P(φ) below which a body is flat or a point, for all purposes."""


def rows_of(human: Human, alpha: float, found: RegularizerComparison) -> list[dict[str, Any]]:
    """Return a row for each regularizer at one α, from all measurements.

    "mismatch" is the relative difference of the residual from the Euclidean one, "distance" that of
    all bodies from the prior, "least" the smallest eigenvalue of P(φ⁰)⁻¹P(φ), "degenerate" where it
    is below 1e-3; "starts_agree" is None for convex regularizers.
    """
    rows, prior = [], pseudo_inertia(human.prior)
    for name, result in found.results.items():
        bodies = pseudo_inertia(result.phi)
        least = np.exp(relative_logarithms(prior, bodies))
        rows.append(
            {
                "alpha": alpha,
                "regularizer": name,
                "gamma": result.gamma,
                "residual": result.residual,
                "mismatch": result.residual / found.residual - 1.0,
                "distance": float(np.linalg.norm(distance(prior, bodies))),
                "least": float(least.min()),
                "degenerate": [NAMES[i] for i in np.flatnonzero(least.min(1) < BOUNDARY)],
                "starts_agree": result.minima.agree if result.minima else None,
                "masses": result.phi[:, 0].tolist(),
            }
        )
    return rows


def errors_of(
    human: Human, found: RegularizerComparison, tested: Mapping[str, Sequence[Array]]
) -> list[dict[str, Any]]:
    """Return the rows of [Lee2019] table 3.1: RMS errors of all data, and (t, 3) of blocks."""
    bodies = {"prior": human.prior, **{name: fit.phi for name, fit in found.results.items()}}
    parts = {"prior": [human.errors(human.prior)], **tested}
    return [
        {
            "regularizer": name,
            "train": _rms(human.errors(phi)),
            "test": _rms(np.concatenate(parts[name])),
        }
        for name, phi in bodies.items()
    ]


def _named(value: Any) -> Any:
    """Return errors by the names of predictions."""
    return value if isinstance(value, str) else dict(zip(PREDICTED, value, strict=True))


def _rms(errors: Array) -> list[float]:
    return [float(value) for value in np.sqrt(np.square(errors).mean(0))]


COLORS = {
    "euclidean": style.BEFORE,
    "point_mass_euclidean": "#c8a415",
    "pullback": style.AFTER,
    "entropic": style.FLOOR,
    "riemannian": "#8a5fa8",
}
LABELS = {"point_mass_euclidean": "euclidean,\npoint masses"}


def ellipsoid_figure(human: Human, found: Mapping[float, RegularizerComparison]) -> Figure:
    """Return every body as its equivalent uniform ellipsoid, seen from the front (figure 3.13)."""
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


REGULARIZERS = ("euclidean", "point_mass_euclidean", "pullback", "entropic", "riemannian")
BASELINE = 1e-2
ALPHAS, QUICK_ALPHAS = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0), (1e-2, 1.0)
POINTS, QUICK_POINTS = 1351, 240
BLOCKS, QUICK_BLOCKS = 11, 3
GAP = 5  # steps beside a block


def point_masses(human: Human, number: int) -> PointMasses:
    """Return `number` points of almost equal masses, as the prior's density is uniform."""
    spare = number - 10 * len(NAMES)
    counts = 10 + np.rint(spare * human.prior[:, 0] / human.mass).astype(int)
    return PointMasses.of_bodies(human.prior, counts.tolist())


def compare(human: Human, alpha: float, points: PointMasses) -> RegularizerComparison:
    """Return the fit with the residual of the Euclidean one at α."""
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
    """Return errors (t, 3) of each block, from fits to the others, for every regularizer."""
    found: dict[str, list[Array]] = {name: [] for name in REGULARIZERS}
    for training, test in track(list(blocks(human.steps, number, GAP)), "blocks", transient=True):
        for name, fit in compare(human.at(training), BASELINE, points).results.items():
            found[name].append(human.at(test).errors(fit.phi))
    return found


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, "only α = 0.01 and 1, three blocks", figures=True)
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
    lines = [{**row, "degenerate": len(row["degenerate"])} for row in rows]
    show(f"Fits; degenerate bodies, of {len(NAMES)}", lines)
    show("RMS errors", [{k: _named(v) for k, v in each.items()} for each in errors])
    shown = {alpha: found[alpha] for alpha in (1e-4, BASELINE, 1.0) if alpha in found}
    write(
        options,
        {"fits": rows, "errors": errors},
        human_ellipsoids=lambda: ellipsoid_figure(human, shown),
        human_sweep=lambda: chart(rows, "alpha", ("residual", "distance", "least"), "regularizer"),
    )


if __name__ == "__main__":
    main()
