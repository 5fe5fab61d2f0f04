"""Identify an AMBIDEX-like arm from few samples, with every regularizer ([Lee2019] §3.6.1).

Torques of 47 random point-to-point motions are simulated with friction and noise, and the prior is
wrong in every link ([Lee2019] §B.2). Each draw has its own prior and its own stretches of the
training samples. All regularizers reach the training residual of the entropic divergence, and
friction is identified from all samples ([Lee2019] §3.5.1, §3.6.1). Finished draws are kept in a
file, so that an interrupted run goes on.

With the Euclidean distance, kilograms are dear and moments of inertia cost almost nothing. Masses,
and with them the zero-moment point, stay as wrong as they were; moments follow noise and uneven
friction until P ⪰ 0 or the hull stops them. So its error grows with the hull, unlike the others',
and whether it beats the prior depends on how wrong that is.

    python -m diagrams.studies.ambidex_arm --json ambidex.json --figures figures
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from statistics import fmean, pstdev
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagrams.harness import SHADES, chart, run_draws, script_parser, show, write
from diagrams.studies.ambidex.arm import (
    LINKS,
    PERIOD,
    TRAINING,
    Arm,
    Array,
    Measurements,
    factor_of,
    measure,
    perturbed,
    point_masses,
)
from geodrake.errors import IdentificationError
from geodrake.identification import (
    IdentificationResult,
    PointMassEuclidean,
    PointMassKL,
    Regularizer,
    Riemannian,
    identify,
)
from geodrake.inertia import PARAMETERS_PER_BODY, riemannian_distance
from geodrake.inertia.ellipsoids import ellipsoid_of_quadric
from geodrake.report import style
from geodrake.report.ellipsoids import EllipsoidSet, ellipsoid_figure
from geodrake.robot import zero_moment_point

NAMES = ("euclidean", "point_mass_euclidean", "point_mass_kl", "pullback", "entropic", "riemannian")
"""In the order of the figures."""
GAMMA = 0.03  # of the entropic divergence, the source's, (N·m)²; others get its residual
DELTA = 0.4  # share of its mass by which a link of a prior is off, at most
HULL = 2.0  # semi-axes of hulls over those of the equivalent uniform ellipsoids
COUNTS, QUICK_COUNTS = (10, 30, 100, 300, 1000, TRAINING), (30, TRAINING)  # of training samples
DRAWS, QUICK_DRAWS = 30, 4
SHOWN = 400  # samples of the ZMP, 4 s
EXAMPLE = 30  # training samples of the fits that are drawn


def run_draw(
    draw: int, *, counts: Sequence[int], seed: int, measured: Measurements
) -> list[dict[str, object]]:
    """Return all fits of one draw as rows of a table; a fit that fails is left out."""
    rng, prior = prior_of(draw, seed, measured)
    points = point_masses(prior, ellipsoid_of_quadric(measured.hulls), rng)
    kinds: dict[str, Regularizer | str] = {
        "euclidean": "euclidean",
        "pullback": "pullback",
        "riemannian": Riemannian(starts=("entropic",)),
        "point_mass_euclidean": PointMassEuclidean(points),
        "point_mass_kl": PointMassKL(points),
    }
    friction = identified(prior, measured).extra
    rows = [row_of(measured, prior, friction, (draw, 0, "prior"))]
    for count in counts:
        data = training_data(draw, count, friction, seed, measured)
        begin = time.process_time()
        entropic = fit(data, prior, "entropic", measured, gamma=GAMMA)
        name = (draw, count, "entropic")
        rows.append(row_of(measured, entropic, friction, name, time.process_time() - begin))
        for kind, regularizer in kinds.items():
            begin = time.process_time()
            with suppress(IdentificationError):
                found = compared(data, points.parameters(), regularizer, measured, entropic)
                seconds = time.process_time() - begin
                rows.append(row_of(measured, found, friction, (draw, count, kind), seconds))
    return rows


def prior_of(draw: int, seed: int, measured: Measurements) -> tuple[np.random.Generator, Array]:
    """Return a draw's random generator and its prior (17, 10)."""
    rng = np.random.default_rng([seed, 1 + draw])
    return rng, perturbed(measured.truth, rng, DELTA)


def identified(prior: Array, measured: Measurements) -> IdentificationResult:
    """Return bodies and friction from all training samples, as the source fixes friction.

    Its `extra` has the friction (14,).
    """
    A, b = measured.full[:, :-1], measured.full[:, -1]
    bounds = np.tile([0.0, np.inf], (A.shape[1] - prior.size, 1))
    more = {"ellipsoids": measured.hulls, "extra_bounds": bounds, "solver": "newton"}
    return identify(A, b, prior, regularizer="entropic", gamma=GAMMA, **more)


def training_data(
    draw: int, count: int, friction: Array, seed: int, measured: Measurements
) -> Array:
    """Return the factor of [bodies | torque without friction] of consecutive random samples."""
    if count == len(measured.torque):
        bodies, rest = np.split(measured.full, [measured.truth.size], axis=1)
        return np.column_stack([bodies, rest[:, -1] - rest[:, :-1] @ friction])
    rng = np.random.default_rng([seed, 1 + draw, count])
    start = int(rng.integers(0, len(measured.torque) - count + 1))
    part = slice(start, start + count)
    torque = measured.torque[part] - measured.friction[part] @ friction
    return factor_of(measured.bodies[part], torque)


def fit(
    data: Array,
    prior: Array,
    regularizer: str | Regularizer,
    measured: Measurements,
    **weight: float,
) -> IdentificationResult:
    """Return a fit to a triangular factor by γ or residual bound, with bodies in their hulls."""
    by_points = isinstance(regularizer, PointMassEuclidean | PointMassKL)
    how = {"ellipsoids": None if by_points else measured.hulls}
    how["solver"] = "newton" if "gamma" in weight else "clarabel"
    return identify(data[:, :-1], data[:, -1], prior, regularizer=regularizer, **how, **weight)


def compared(
    data: Array,
    prior: Array,
    regularizer: str | Regularizer,
    measured: Measurements,
    entropic: IdentificationResult,
) -> IdentificationResult:
    """Return a fit to compare with the entropic one ([Lee2019] §3.5.1).

    At the same training residual; with the Riemannian distance, which is not convex, with the same
    γ (Eq. (3.5.53)).
    """
    if isinstance(regularizer, Riemannian):
        return fit(data, prior, regularizer, measured, gamma=entropic.gamma)
    try:
        return fit(data, prior, regularizer, measured, residual_bound=entropic.residual)
    except IdentificationError:
        # A solver that got stuck finds its way from a bound that is the same to five digits.
        bound = entropic.residual * (1 + 5e-6)
        return fit(data, prior, regularizer, measured, residual_bound=bound)


def row_of(
    measured: Measurements,
    found: IdentificationResult | Array,
    friction: Array,
    name: tuple[int, int, str],
    seconds: float = 0.0,
) -> dict[str, object]:
    """Return the table's row of a fit, or of a prior (17, 10); RMS errors in N·m.

    "rigid" is the difference from the torques of the true bodies on the test motions, "distance"
    that of all links from the true ones, "zmp" the mean distance of zero-moment points, m, "gamma"
    is the solution's γ, and "at_boundary" counts bodies.
    """
    fitted = isinstance(found, IdentificationResult)
    phi = found.phi if fitted else found
    draw, samples, regularizer = name
    change = (phi - measured.truth).ravel()
    rigid = np.linalg.norm(measured.test[:, : change.size] @ change) / np.sqrt(measured.test_rows)
    links = LINKS // 10
    truth = measured.truth[:links]
    miss = zmp(measured, phi) - zmp(measured, measured.truth)
    return {
        "draw": draw,
        "samples": samples,
        "regularizer": regularizer,
        "training": float(np.sqrt(found.residual / (7 * samples))) if fitted else None,
        "test": measured.test_rms(phi, friction),
        "rigid": float(rigid),
        "distance": float(np.linalg.norm(riemannian_distance(phi[:links], truth))),
        "zmp": float(np.linalg.norm(miss, axis=1).mean()),
        "gamma": found.gamma if fitted else None,
        "at_boundary": len(found.active_blocks) if fitted else 0,
        "seconds": seconds,
    }


def zmp(measured: Measurements, phi: Array) -> Array:
    """Return (T, 2) zero-moment points on the ground of every fifth test sample, m."""
    return zero_moment_point(measured.wrenches(phi))


def figures_of(
    summary: Sequence[dict[str, Any]], seed: int, made: tuple[Arm, Measurements]
) -> dict[str, Figure]:
    """Return all figures of a run."""
    arm, measured = made
    models = example(measured, seed)
    return {
        "ambidex_errors": error_figure(summary),
        **zmp_figures(measured, models),
        "ambidex_ellipsoids": link_figure(arm, models),
    }


def error_figure(summary: Sequence[dict[str, Any]]) -> Figure:
    """Return errors against the number of training samples, like figure 3.7 of the source."""
    prior, *fits = summary
    entropic = [line for line in fits if line["regularizer"] == "entropic"]
    last = max(entropic, key=lambda line: line["samples"])
    return chart(
        fits,
        "samples",
        ("training", "test", "rigid", "distance"),
        "regularizer",
        levels={"prior": prior, "entropic, all samples": last},
        note=f"N·m; means and standard deviations over {prior['draws']} draws of prior and "
        "samples. All at the training residual of the entropic divergence with "
        f"γ = {GAMMA:g} (N·m)², the Riemannian distance at its γ.",
    )


def zmp_figures(measured: Measurements, models: Sequence[EllipsoidSet]) -> dict[str, Figure]:
    """Return zero-moment points over time and on the ground, like figure 3.9 of the source."""
    time = (5 * PERIOD * np.arange(SHOWN // 5)).tolist()
    rows = [
        {
            "bodies": one.name,
            "time": time,
            **dict(zip(("x, cm", "y, cm"), at.T.tolist(), strict=True)),
        }
        for one in models
        for at in (100.0 * zmp(measured, one.phi)[: SHOWN // 5],)
    ]
    note = (
        "Zero-moment point of the arm alone on the ground, 1 m below its shoulder; test motions, "
        "one draw, 30 training samples."
    )
    return {
        "ambidex_zmp": chart(rows, "time", ("x, cm", "y, cm"), "bodies", note=note),
        "ambidex_zmp_ground": chart(rows, "x, cm", "y, cm", "bodies", note=note),
    }


def link_figure(arm: Arm, models: Sequence[EllipsoidSet]) -> Figure:
    """Return the links as ellipsoids, like figure 3.8 of the source."""
    links = [replace(one, phi=one.phi[:10], at_boundary=one.at_boundary[:10]) for one in models]
    context = arm.plant.CreateDefaultContext()
    turns = np.array([[0.3, -0.5, 0.2, 1.2, 0.0, 0.4, 0.0]])
    arm.plant.SetPositions(context, arm.transmission.joint_positions(arm.motors(turns))[0])
    return ellipsoid_figure(arm.plant, links, context=context)


def example(measured: Measurements, seed: int) -> list[EllipsoidSet]:
    """Return truth, prior, and solved fits to 30 samples of the first draw."""
    _, prior = prior_of(0, seed, measured)
    friction = identified(prior, measured).extra
    data = training_data(0, EXAMPLE, friction, seed, measured)
    entropic = fit(data, prior, "entropic", measured, gamma=GAMMA)
    fits = {"entropic": entropic}
    with suppress(IdentificationError):
        found = compared(data, prior, "euclidean", measured, entropic)
        fits = {"euclidean": found, **fits}
    models = [
        EllipsoidSet.of("true bodies", measured.truth, color=style.INK),
        EllipsoidSet.of("prior", prior, color=style.QUIET),
    ]
    for shade, (name, one) in zip(SHADES, fits.items(), strict=False):
        flat = [column // PARAMETERS_PER_BODY for column in one.active_blocks]
        models.append(EllipsoidSet.of(name, one.phi, color=shade, at_boundary=flat))
    return models


def summarize(rows: Sequence[Any], counts: Sequence[int]) -> list[dict[str, Any]]:
    """Return means and deviations over the draws, for the prior and every fit."""
    summary = []
    priors = {r["draw"]: r["test"] for r in rows if r["regularizer"] == "prior"}
    for count, name in [(0, "prior")] + [(count, name) for count in counts for name in NAMES]:
        found = [r for r in rows if (r["samples"], r["regularizer"]) == (count, name)]
        if not found:
            continue
        line: dict[str, Any] = {"samples": count, "regularizer": name, "draws": len(found)}
        for column in ("training", "test", "rigid", "distance", "zmp", "seconds", "at_boundary"):
            values = [r[column] for r in found if r[column] is not None]
            if values:
                line[column], line[f"{column}_deviation"] = fmean(values), pstdev(values)
        line["worse_than_prior"] = fmean(r["test"] > priors[r["draw"]] for r in found)
        summary.append(line)
    return summary


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, "few draws, 30 and all samples", draws=True, figures=True)
    options = parser.parse_args()
    counts, draws = (QUICK_COUNTS, QUICK_DRAWS) if options.quick else (COUNTS, DRAWS)
    arm = Arm.load()
    measured = measure(arm, seed=options.seed, hull=HULL)
    task = partial(run_draw, counts=counts, seed=options.seed, measured=measured)
    found = run_draws(parser, options, task, range(draws), counts=counts)
    rows = [row for own in found for row in own]
    summary = summarize(rows, counts)
    show("RMS errors of motor torques in N·m, of zero-moment points in m", summary)
    made = arm, measured
    table = {"gamma": GAMMA, "delta": DELTA, "hull": HULL, "summary": summary, "rows": rows}
    write(options, table, ambidex=lambda: figures_of(summary, options.seed, made))


if __name__ == "__main__":
    main()
