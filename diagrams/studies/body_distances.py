"""How far apart two bodies are, by four measures, in other frames and units.

Euclidean, constant pullback, entropic and Riemannian distance ([Lee2019] §3.3, figures 3.2 to 3.4):
the last three depend on the bodies alone, the first on the frame and the units of their numbers.

    python -m diagrams.studies.body_distances --json distances.json --figures figures
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.spatial.transform import Rotation

from diagrams.harness import chart, script_parser, write
from geodrake.inertia import (
    Ellipsoid,
    change_frame,
    change_units,
    entropic_divergence,
    equivalent_ellipsoid,
    from_pseudo_inertia,
    perturb,
    pseudo_inertia,
    pullback_distance,
    riemannian_distance,
)
from geodrake.inertia.positive_definite import geodesic
from geodrake.report import style

INCH_POUND = {"metre": 1 / 0.0254, "kilogram": 1 / 0.45359237}
MASS = 5.0  # kg
SIZE = np.array([0.3, 0.1, 0.1])  # semi-axes of the long body, m
APART = 0.15  # m between the centres of figure 3.3(a)
RADIUS = 0.1  # m, of the ball of figure 3.4(b)
MEASURES = ("euclidean, kg-m", "euclidean, inch-pound", "pullback", "entropic", "riemannian")

Curves = dict[str, Any]


def squared_distances(phi: np.ndarray, target: np.ndarray) -> dict[str, np.ndarray]:
    """Return every measure of bodies (..., 10) from a target (..., 10), SI."""
    imperial = change_units(phi - target, **INCH_POUND)
    return {
        "euclidean, kg-m": ((phi - target) ** 2).sum(-1),
        "euclidean, inch-pound": (imperial**2).sum(-1),
        "pullback": pullback_distance(phi, target, target) ** 2,
        "entropic": entropic_divergence(phi, target),
        "riemannian": riemannian_distance(phi, target) ** 2,
    }


def turns(angle: Any) -> np.ndarray:
    """Return rotations (..., 3, 3) about z by angles (...), rad."""
    return Rotation.from_rotvec(np.multiply.outer(angle, [0.0, 0.0, 1.0])).as_matrix()


def long_body(center: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return the long uniform ellipsoid, with its length along x."""
    return Ellipsoid(np.asarray(center), SIZE, np.eye(3)).uniform_body(MASS)


def normalized(name: str, unit: str, x: np.ndarray, bodies: tuple[Any, Any], at: float) -> Curves:
    """Return curves of all measures over x, divided by their values at `at`."""
    phi, target = bodies
    k = int(np.argmin(np.abs(x - at)))
    curves = {key: value / value[k] for key, value in squared_distances(phi, target).items()}
    lists = {key: value.tolist() for key, value in curves.items()}
    return {"name": name, "unit": unit, "x": x.tolist(), "normalized_at": float(x[k]), **lists}


def position_curves(points: int) -> Curves:
    """Return figure 3.3(a): the same body with its centre moved in every direction."""
    angle = np.linspace(0.0, 180.0, points)
    target = long_body()
    direction = turns(np.deg2rad(angle))[..., 0]
    phi = change_frame(target, np.eye(3), APART * direction)
    return normalized("moved in this direction", "°", angle, (phi, target), 90.0)


def orientation_curves(points: int) -> Curves:
    """Return figure 3.3(b): the same body rotated about one of its ends."""
    angle = np.linspace(2.0, 180.0, points)
    target = long_body((SIZE[0], 0.0, 0.0))
    phi = change_frame(target, turns(np.deg2rad(angle)), np.zeros(3))
    return normalized("turned about its end by", "°", angle, (phi, target), 90.0)


def volume_curves(points: int) -> Curves:
    """Return figure 3.4(a): a body of the same mass and shape that grows from its foot."""
    length = np.geomspace(0.01, 1.25, points)
    target = long_body((SIZE[0], 0.0, 0.0))
    center, semi_axes = np.outer(length, [SIZE[0], 0.0, 0.0]), np.outer(length, SIZE)
    phi = Ellipsoid(center, semi_axes, np.eye(3)).uniform_body(MASS)
    return normalized("volume over the target's", "", length**3, (phi, target), 0.2)


def mass_curves(masses: np.ndarray, samples: int, rng: np.random.Generator) -> Curves:
    """Return figure 3.4(b): mean over perturbed balls, for balls of every mass."""
    ball = Ellipsoid(np.zeros(3), np.full(3, RADIUS), np.eye(3))
    targets = ball.uniform_body(masses)
    perturbed = perturb(targets, samples, rng=rng, mass_uncertainty=0.3, point_masses=10).phi
    means = {k: v.mean(0) for k, v in squared_distances(perturbed, targets).items()}
    middle = len(masses) // 2
    curves = {key: (value / value[middle]).tolist() for key, value in means.items()}
    at = float(masses[middle])
    return {"name": "mass", "unit": "kg", "x": masses.tolist(), "normalized_at": at, **curves}


def frame_and_unit_table(changes: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return distances of one pair of bodies in random frames and units of length and mass."""
    first, second = long_body(), 1.2 * change_frame(long_body(), turns(0.4), [0.1, 0, 0])
    reference = {k: float(v) for k, v in squared_distances(second, first).items()}
    values = {key: [] for key in ("euclidean", "pullback", "entropic", "riemannian")}
    for _ in range(changes):
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        place = rng.uniform(-0.5, 0.5, 3)
        metre, kilogram = 10.0 ** rng.uniform(-2, 2, 2)
        seen = [
            change_units(change_frame(x, rotation, place), metre=metre, kilogram=kilogram)
            for x in (second, first)
        ]
        for key, value in squared_distances(*seen).items():
            if key != "euclidean, inch-pound":
                values[key.split(",")[0]].append(float(value))
    spread = {key: max(value) / min(value) - 1 for key, value in values.items()}
    return {"squared_distance": reference, "largest_over_smallest_less_1": spread}


def measure(*, quick: bool, seed: int) -> dict[str, Any]:
    """Return all curves and the table."""
    rng, points = np.random.default_rng(seed), 37 if quick else 181
    position, volume = position_curves(points), volume_curves(points)
    masses = np.geomspace(0.5, 20.0, 5 if quick else 15)
    by_mass = mass_curves(masses, 200 if quick else 500, rng)
    curves = {"mass": by_mass, "position": position, "orientation": orientation_curves(points)}
    return {
        "frames_and_units": frame_and_unit_table(10 if quick else 100, rng),
        "shortest_over_longest_by_direction": {
            key: min(position[key]) / max(position[key]) for key in MEASURES
        },
        "direction_of_shortest_deg": {
            key: position["x"][int(np.argmin(position[key]))] for key in MEASURES[2:]
        },
        "largest_over_smallest_by_mass": {
            key: max(by_mass[key]) / min(by_mass[key]) for key in MEASURES
        },
        "at_smallest_volume_over_at_0.2": {key: volume[key][0] for key in MEASURES},
        "curves": {**curves, "volume": volume},
    }


def add_body(axes: Any, phi: np.ndarray, **look: Any) -> None:
    """Draw the outline of a body's equivalent ellipsoid in the xy-plane."""
    body = equivalent_ellipsoid(phi)
    shape = (body.rotation * body.semi_axes**2) @ body.rotation.T
    squares, sides = np.linalg.eigh(shape[:2, :2])
    angle = np.rad2deg(np.arctan2(sides[1, 1], sides[0, 1]))
    axes.add_patch(Ellipse(body.center[:2], *(2 * np.sqrt(squares[::-1])), angle=angle, **look))


def draw_geodesics() -> Figure:
    """Return figure 3.2: distance by direction, and the bodies along a geodesic."""
    figure = style.new_figure(4.2)
    left, right = figure.subplots(1, 2)
    target = long_body()
    directions = turns(np.linspace(0.0, 2 * np.pi, 16, endpoint=False))[..., 0]
    bodies = change_frame(target, np.eye(3), 0.4 * directions)
    distance = riemannian_distance(bodies, target)
    share = (distance - distance.min()) / np.ptp(distance)
    add_body(left, target, facecolor=style.MEASURED, edgecolor=style.INK)
    for direction, phi, d, s in zip(directions[:, :2], bodies, distance, share, strict=True):
        color = (1 - s) * np.array([0.25, 0.61, 0.42]) + s * np.array([0.88, 0.54, 0.24])
        left.plot(*np.outer(direction, [0.0, 0.4]), color=color, linewidth=2.0)
        left.plot(*(0.4 * direction), "o", color=color, markersize=4)
        add_body(left, phi, fill=False, edgecolor=color, alpha=0.25)
        left.text(
            *(0.47 * direction), f"{d:.2f}", ha="center", va="center", **style.plain(8, style.INK)
        )
    left.set_title("Distance of the body moved by 0.4 m", loc="left", **style.plain())
    first, second = (
        change_frame(target, turns(angle), [x, 0.0, 0.0])
        for angle, x in ((np.pi / 6, -0.4), (-np.pi / 3, 0.4))
    )
    path_of = geodesic(pseudo_inertia(first), pseudo_inertia(second), np.linspace(0, 1, 201))
    along = from_pseudo_inertia(path_of)
    for k in range(0, 201, 40):
        end = k % 200 == 0
        edge, face = (style.INK, style.MEASURED) if end else (style.FLOOR, "none")
        add_body(right, along[k], edgecolor=edge, facecolor=face, zorder=0 if end else 1)
    right.plot(*(along[:, 1:3] / along[:, :1]).T, color=style.AFTER, linewidth=1.8)
    lightest = along[:, 0].min()
    title = f"A geodesic: bodies, their centres of mass; {MASS:g} kg fall to {lightest:.2g} kg"
    right.set_title(title, loc="left", **style.plain())
    for axes in (left, right):
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.set_axis_off()
    return figure


def draw_curves(curves: Sequence[Curves], note: str = "") -> Figure:
    """Return figures 3.3 and 3.4: curves of every measure."""
    rows = [
        {"measure": key, "of": f"{one['name']} {one['unit']}", "x": one["x"], "squared": one[key]}
        for one in curves
        for key in MEASURES
    ]
    note = f"Squared distances over those at one place. {note}"
    return chart(rows, "x", "squared", "measure", panel="of", note=note)


def main() -> None:
    """Measure, print and write."""
    options = script_parser(__doc__, figures=True).parse_args()
    table = measure(quick=options.quick, seed=options.seed)
    print(json.dumps({key: value for key, value in table.items() if key != "curves"}, indent=2))
    mass = "Mass: mean of balls of 0.1 m radius, perturbed by point masses of up to 30 %."
    curves = table["curves"]
    write(
        options,
        table,
        body_distances_geodesic=draw_geodesics,
        body_distances_pose=lambda: draw_curves([curves["position"], curves["orientation"]]),
        body_distances_size=lambda: draw_curves([curves["volume"], curves["mass"]], mass),
    )


if __name__ == "__main__":
    main()
