"""Atlas on one foot: what a force plate identifies of it, and identification of that alone.

[Lee2019] §4.6.3, figure 4.7, tables 4.3 and 4.4. Of 20 random motions that keep the zero-moment
point in the sole, 10 identify and 10 validate. Least squares of all base parameters drowns in the
noise along directions that no motion excites; reduced identification leaves those at the prior. The
prior is the robot with random point masses added or taken away. Atlas is read from the folder
--shared; without it, and with --quick, a small robot of our own takes its place. Motions that are
done are kept beside the table, so that an interrupted run goes on.

    python -m diagrams.studies.atlas_identification --json atlas.json --figures figures
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydrake.math import RigidTransform
from rich.console import Console
from rich.table import Table

from diagrams.harness import cache_beside, results_of, script_parser, write
from diagrams.public_data import add_folder_option
from diagrams.studies.excitation.balancing import FAMILY, Balance
from diagrams.studies.excitation.humanoid import ATLAS, HALF_SOLE, groups, standing_robot
from geodrake.excitation import (
    ExcitationTrajectory,
    ReducedIdentification,
    Target,
    make_target,
    measurement_factor,
    reduced_identification,
)
from geodrake.excitation.trajectory import joint_order
from geodrake.inertia import perturb
from geodrake.logs import Motion
from geodrake.model import RobotModel
from geodrake.report import style
from geodrake.robot import inverse_dynamics_regressor, pushforward_metric

VERSION = 1
"""Of what a motion is; one more when kept motions of older versions must not be used."""
NOISE = np.array([1.5, 1.5, 1.5, 0.5, 0.5, 0.5])  # N·m and N
RATE = 300  # samples a second


@dataclass(frozen=True)
class Plan:
    """What a run is made of.

    Attributes:
        shared: Folder with the description of Atlas; None for the small robot.
        motions: Number of motions, half of which identify.
        rate: Samples a second for identification.
        threshold: ε_λ.
        uncertainty: How wrong the masses of the prior's links are, at most.
        seed: Of motions, prior and noise.
    """

    shared: str | None
    motions: int = 20
    rate: int = RATE
    threshold: float = 1e-2
    uncertainty: float = 0.8
    seed: int = 0


def robot(plan: Plan) -> RobotModel:
    """The true robot."""
    return standing_robot(None if plan.shared is None else Path(plan.shared))


def one_motion(number: int, *, plan: Plan) -> dict[str, Any]:
    """A random motion in balance."""
    balance = Balance(robot(plan))
    trajectory, share = balance.motion(np.random.default_rng([plan.seed, number]))
    motion = trajectory.motion(FAMILY.times(round(RATE * FAMILY.length)))
    zmp = np.abs(balance.zmp(motion.q, motion.v, motion.vd)) / HALF_SOLE
    return {
        "coefficients": trajectory.coefficients.tolist(),
        "detour": share,
        "zmp": float(zmp.max()),
        "fastest": float(np.abs(motion.v).max()),
    }


def sampled(model: RobotModel, found: dict[str, Any], rate: float) -> Motion:
    """A motion at a rate (1/s)."""
    order = joint_order(model)
    coefficients = np.array(found["coefficients"])
    trajectory = ExcitationTrajectory(FAMILY, coefficients, model.joints, order)
    return trajectory.motion(FAMILY.times(round(rate * FAMILY.length)))


def identify(
    truth: RobotModel, motions: list[Motion], plan: Plan
) -> tuple[Target, ReducedIdentification, ReducedIdentification]:
    """The target with its prior, and what full and reduced identification make of noisy wrenches.

    Raises:
        ArgumentError: The threshold keeps nothing.
    """
    rng = np.random.default_rng([plan.seed, plan.motions, 1])
    prior = perturb(truth.phi, 1, rng=rng, mass_uncertainty=plan.uncertainty).phi[0]
    guess = replace(truth, phi=prior)
    target = make_target(guess, noise=NOISE, effects=[], X_WP=RigidTransform())
    wrenches = [
        target.measure(motion).regressor @ truth.phi.ravel()
        + NOISE * rng.normal(size=(len(motion), 6))
        for motion in motions
    ]
    factor = measurement_factor(target, motions, wrenches)
    reduced = reduced_identification(target, factor, threshold=plan.threshold)
    return target, reduced_identification(target, factor, threshold=np.inf), reduced


def validate(truth: RobotModel, motions: list[Motion], delta: np.ndarray) -> dict[str, Any]:
    """RMS errors of wrenches, of efforts and of accelerations, for errors δ (p,) of parameters."""
    context, wrench, effort, acceleration = truth.plant.CreateDefaultContext(), [], [], []
    target = make_target(truth, noise=NOISE, effects=[], X_WP=RigidTransform())
    for motion in motions:
        wrench.append(target.measure(motion).regressor @ delta)
        Y = inverse_dynamics_regressor(truth.tree, motion.q, motion.v, motion.vd)
        effort.append(Y @ delta)
        for q, tau in zip(motion.q, effort[-1], strict=True):
            truth.plant.SetPositions(context, q)
            acceleration.append(np.linalg.solve(truth.plant.CalcMassMatrix(context), tau))
    moment, force = np.split(np.vstack(wrench), 2, axis=1)
    joints = groups(truth)
    return {
        "force": rms(force),
        "moment": rms(moment),
        "effort": {name: rms(np.vstack(effort)[:, at]) for name, at in joints.items()},
        "acceleration": {name: rms(np.array(acceleration)[:, at]) for name, at in joints.items()},
    }


def rms(x: np.ndarray) -> float:
    """Root mean square of all."""
    return float(np.sqrt(np.mean(np.square(x))))


def run(plan: Plan, *, cache: Path | None, workers: int) -> dict[str, Any]:
    """Figure 4.7 and tables 4.3 and 4.4."""
    truth, kept = robot(plan), asdict(plan)
    key = {"version": VERSION, "shared": plan.shared is not None, "seed": plan.seed}
    task, numbers = partial(one_motion, plan=plan), range(plan.motions)
    found = results_of(task, numbers, key=key, cache=cache, workers=workers)
    half = plan.motions // 2
    target, full, reduced = identify(
        truth, [sampled(truth, one, plan.rate) for one in found[:half]], plan
    )
    held_out = [sampled(truth, one, RATE / 10) for one in found[half:]]
    H, B = pushforward_metric(target.base.matrix, truth.phi), target.base.matrix
    rows = []
    ways = {"prior": target.prior, "full": full.parameters, "reduced": reduced.parameters}
    for name, parameters in ways.items():
        delta = parameters - truth.phi.ravel()
        error = float(np.sqrt((B @ delta) @ H @ (B @ delta) / len(B)))
        rows.append({"way": name, "error": error, **validate(truth, held_out, delta)})
    variances = reduced.identifiable.variances
    return {
        "plan": {**kept, "shared": plan.shared is not None},
        "robot": "atlas" if plan.shared else "small",
        "joints": len(truth.joints),
        "base_parameters": target.base.rank,
        "identifiable": reduced.identifiable.kept,
        "variances": variances.tolist(),
        "largest_zmp": max(one["zmp"] for one in found),
        "rows": rows,
        "error_full_over_reduced": rows[1]["error"] / rows[2]["error"],
    }


def show(table: dict[str, Any], console: Console) -> None:
    """Print tables 4.3 and 4.4."""
    plan = table["plan"]
    console.print(
        f"{table['identifiable']} of {table['base_parameters']} base parameters have a variance of "
        f"at most {plan['threshold']:g}; zero-moment points stay within "
        f"{100 * table['largest_zmp']:.0f} % of the sole's half sizes"
    )
    output = Table("identification", "parameter error", "force, N", "moment, N·m")
    for row in table["rows"]:
        values = [f"{row[key]:.4g}" for key in ("error", "force", "moment")]
        output.add_row(row["way"], *values)
    console.print(output)
    for kind, unit in (("effort", "N·m"), ("acceleration", "rad/s²")):
        inner = Table(f"RMS error of {kind}, {unit}", *table["rows"][0][kind])
        for row in table["rows"]:
            inner.add_row(row["way"], *(f"{value:.3g}" for value in row[kind].values()))
        console.print(inner)
    console.print(f"Full over reduced parameter error: {table['error_full_over_reduced']:.3g}")


def draw(table: dict[str, Any]) -> Figure:
    """Figure 4.7: variances along principal directions, beside errors of accelerations."""
    figure = style.new_figure(3.8)
    left, right = figure.subplots(1, 2)
    variances, threshold = np.array(table["variances"]), table["plan"]["threshold"]
    index = np.arange(1, len(variances) + 1)
    for those, color in (
        (variances <= threshold, style.AFTER),
        (variances > threshold, style.BEFORE),
    ):
        left.semilogy(index[those], variances[those], ".", color=color)
    left.axhline(threshold, color=style.INK, linewidth=1.0, linestyle="--")
    left.set_title(
        f"Variances: {table['identifiable']} of {len(variances)} are identifiable to {threshold:g}",
        loc="left",
        **style.plain(),
    )
    left.set_xlabel("direction", **style.plain(8.5, style.QUIET))
    colors = {"prior": style.MEASURED, "full": style.BEFORE, "reduced": style.AFTER}
    for row in table["rows"]:
        values = row["acceleration"]
        right.semilogy(range(len(values)), list(values.values()), "o", color=colors[row["way"]])
        right.set_xticks(range(len(values)), list(values))
    right.set_title("RMS error of accelerations, rad/s²", loc="left", **style.plain())
    right.legend(list(colors), frameon=False, fontsize=8.5)
    for ax in (left, right):
        style.polish(ax)
    return figure


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__)
    add_folder_option(parser, "with Atlas")
    parser.add_argument("--motions", type=int, help="how many (20; 6 with --quick)")
    parser.add_argument("--threshold", type=float, default=1e-2, help="of identifiable variances")
    parser.add_argument("--uncertainty", type=float, default=0.8, help="of the prior's masses")
    parser.add_argument("--workers", type=int, help="number of processes")
    options = parser.parse_args()
    small = options.quick or not (options.shared / ATLAS).is_file()
    plan = Plan(
        shared=None if small else str(options.shared),
        motions=options.motions or (6 if options.quick else 20),
        rate=60 if options.quick else RATE,
        threshold=options.threshold,
        uncertainty=options.uncertainty,
        seed=options.seed,
    )
    if plan.motions < 2 or not 0 < plan.uncertainty < 1:
        parser.error("--motions are at least two, and --uncertainty is between 0 and 1.")
    console = Console(width=140)
    if small and not options.quick:
        console.print(f"Without {options.shared / ATLAS}, a small robot of our own is on one foot.")
    workers = options.workers or (1 if small else min(2, os.cpu_count() or 1))
    table = run(plan, cache=cache_beside(options.json), workers=workers)
    show(table, console)
    write(options, table, atlas_identification=lambda: draw(table))


if __name__ == "__main__":
    main()
