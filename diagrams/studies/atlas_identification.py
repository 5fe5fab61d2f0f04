"""Atlas on one foot: what a force plate identifies of it, and identification of that alone.

[Lee2019] §4.6.3, figure 4.7, tables 4.3 and 4.4. Of 20 random motions that keep the zero-moment
point in the sole, 10 identify and 10 validate. Least squares of all base parameters drowns in the
noise along directions that no motion excites; reduced identification keeps the prior there. The
prior is the robot with random point masses added or removed. Atlas is read from the folder
--shared; without it, or with --quick, a small robot of this project is used instead. Finished
motions are kept beside the table, so that an interrupted run goes on.

    python -m diagrams.studies.atlas_identification --json atlas.json --figures figures
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydrake.math import RigidTransform

from diagrams.harness import MODELS, chart, run_draws, script_parser, show, write
from diagrams.public_data import add_folder_option
from geodrake.excitation import (
    DesignOptions,
    ExcitationTrajectory,
    Foot,
    ReducedIdentification,
    SplineMotion,
    Stance,
    Target,
    make_stance,
    make_target,
    measurement_factor,
    random_excitation,
    reduced_identification,
)
from geodrake.inertia import perturb
from geodrake.logs import Motion
from geodrake.model import RobotModel, load_model
from geodrake.robot import inverse_dynamics_regressor
from geodrake.robot.base_parameters import pushforward_metric

# Robots on one foot, [Lee2019] §4.6.3: Atlas from a folder of its own, or a small one of ours.
# What the force plate under the left sole measures is the wrench of the ground.

ATLAS = Path("reference") / "atlas_v5.urdf"
ATLAS_FOOT = Foot.sole("l_foot_sole", 0.26, 0.12)
"""The sole of Atlas: its length is Atlas's, its width is ours."""
GROUPS = {
    "hip": r"leg_hp",
    "knee": r"leg_kn",
    "ankle": r"leg_ak",
    "waist": r"back_",
    "shoulder": r"arm_sh",
    "elbow": r"arm_el",
    "wrist": r"arm_(uw|mw|lw)",
}
"""Joints of table 4.4 by name."""


def standing_robot(shared: Path | None) -> Stance:
    """Return Atlas of the folder `shared` on its left foot, or a small robot if None.

    Its neck, which is not among the source's 29 joints, is held.
    """
    if shared is None:
        small = load_model(MODELS / "biped.urdf", floating=True)
        return make_stance(small, ["l_foot"], margin=MARGIN)
    atlas = load_model(shared / ATLAS, floating=True, lock={"neck_ay": 0.0})
    return make_stance(replace(atlas, effects=()), [ATLAS_FOOT], margin=MARGIN)


def groups(model: RobotModel) -> dict[str, np.ndarray]:
    """Return indices of the robot's joints by group."""
    found = {
        group: np.array([i for i, joint in enumerate(model.joints) if re.search(pattern, joint)])
        for group, pattern in GROUPS.items()
    }
    return {group: indices for group, indices in found.items() if len(indices)}


FAMILY = SplineMotion(3.0, 10, 5)
MARGIN = 0.95  # of the sole, within which the zero-moment point is to be
NOISE = np.array([1.5, 1.5, 1.5, 0.5, 0.5, 0.5])  # N·m and N
RATE = 300  # samples a second
THRESHOLD = 1e-2  # ε_λ, of identifiable variances
UNCERTAINTY = 0.8  # how wrong the masses of the prior's links are, at most


@dataclass(frozen=True)
class Plan:
    """Settings of a run."""

    shared: str | None  # folder with the description of Atlas; None for the small robot
    motions: int = 20
    rate: int = RATE
    seed: int = 0


def robot(plan: Plan) -> Stance:
    """Return the true robot on its foot."""
    return standing_robot(None if plan.shared is None else Path(plan.shared))


def target_of(stance: Stance, phi: np.ndarray) -> Target:
    """Return the target of a force plate, with nominal parameters."""
    guess = replace(stance.model, phi=phi)
    return make_target(guess, noise=NOISE, effects=[], X_WP=RigidTransform())


def one_motion(number: int, *, plan: Plan) -> dict[str, Any]:
    """Return a random balanced motion."""
    stance = robot(plan)
    trajectory = random_excitation(
        stance.target(noise=NOISE, effects=[], on_plate=True),
        trajectory=FAMILY,
        options=DesignOptions(stance=stance),
        seed=1000 * plan.seed + number,
    )
    motion = trajectory.motion(FAMILY.times(round(RATE * FAMILY.length)))
    return {
        "coefficients": trajectory.coefficients.tolist(),
        "zmp": float(stance.support(motion)[0].max()),
        "fastest": float(np.abs(motion.v).max()),
        "widest": float(np.ptp(motion.q, axis=0).max()),
    }


def sampled(stance: Stance, found: dict[str, Any], rate: float) -> Motion:
    """Return a motion at a rate (1/s)."""
    coefficients = np.array(found["coefficients"])
    trajectory = ExcitationTrajectory(FAMILY, coefficients, stance.motors, stance)
    return trajectory.motion(FAMILY.times(round(rate * FAMILY.length)))


def identify(
    stance: Stance, motions: list[Motion], plan: Plan
) -> tuple[Target, ReducedIdentification, ReducedIdentification]:
    """Return the target with its prior, and full and reduced fits to noisy wrenches."""
    rng = np.random.default_rng([plan.seed, plan.motions, 1])
    truth = stance.model.phi
    prior = perturb(truth, 1, rng=rng, mass_uncertainty=UNCERTAINTY).phi[0]
    target = target_of(stance, prior)
    wrenches = [
        target.measure(motion).regressor @ truth.ravel() + NOISE * rng.normal(size=(len(motion), 6))
        for motion in motions
    ]
    factor = measurement_factor(target, motions, wrenches)
    reduced = reduced_identification(target, factor, threshold=THRESHOLD)
    return target, reduced_identification(target, factor, threshold=np.inf), reduced


def validate(stance: Stance, motions: list[Motion], delta: np.ndarray) -> dict[str, Any]:
    """Return RMS errors of wrenches, efforts and accelerations for errors δ (p,) of parameters."""
    truth = stance.model
    context, wrench, effort, acceleration = truth.plant.CreateDefaultContext(), [], [], []
    target = target_of(stance, truth.phi)
    for motion in motions:
        wrench.append(target.measure(motion).regressor @ delta)
        Y = inverse_dynamics_regressor(truth.tree, motion.q, motion.v, motion.vd)
        effort.append(Y @ delta)
        whole, ratios = truth.plant_positions(motion.q), truth.coordinates.jacobian(motion.q)
        for q, G, tau in zip(whole, ratios, effort[-1], strict=True):
            truth.plant.SetPositions(context, q)
            M = G.T @ truth.plant.CalcMassMatrix(context) @ G
            acceleration.append(np.linalg.solve(M, tau))
    moment, force = np.split(np.vstack(wrench), 2, axis=1)
    joints = groups(truth)
    return {
        "force": rms(force),
        "moment": rms(moment),
        "effort": {name: rms(np.vstack(effort)[:, at]) for name, at in joints.items()},
        "acceleration": {name: rms(np.array(acceleration)[:, at]) for name, at in joints.items()},
    }


def rms(x: np.ndarray) -> float:
    """Return the root mean square of all."""
    return float(np.sqrt(np.mean(np.square(x))))


def run(found: Sequence[dict[str, Any]], plan: Plan) -> dict[str, Any]:
    """Return the data of figure 4.7 and of tables 4.3 and 4.4."""
    stance, kept = robot(plan), asdict(plan)
    half, truth = plan.motions // 2, stance.model
    target, full, reduced = identify(
        stance, [sampled(stance, one, plan.rate) for one in found[:half]], plan
    )
    held_out = [sampled(stance, one, RATE / 10) for one in found[half:]]
    H, B = pushforward_metric(target.base.matrix, truth.phi), target.base.matrix
    rows = []
    ways = {"prior": target.prior, "full": full.parameters, "reduced": reduced.parameters}
    for name, parameters in ways.items():
        delta = parameters - truth.phi.ravel()
        error = float(np.sqrt((B @ delta) @ H @ (B @ delta) / len(B)))
        rows.append({"way": name, "error": error, **validate(stance, held_out, delta)})
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


def figures_of(table: dict[str, Any]) -> dict[str, Figure]:
    """Return figure 4.7: variances along principal directions, and errors of accelerations."""
    variances = [
        {"direction": k + 1, "variance": x, "identifiable": "yes" if x <= THRESHOLD else "no"}
        for k, x in enumerate(table["variances"])
        if np.isfinite(x)
    ]
    errors = [
        {"way": row["way"], "joint": joint, kind: row[kind][joint]}
        for row in table["rows"]
        for kind in ("effort", "acceleration")
        for joint in row[kind]
    ]
    levels = {"threshold": {"variance": THRESHOLD}}
    by = {"levels": levels, "joined": False}
    return {
        "atlas_variances": chart(variances, "direction", "variance", "identifiable", **by),
        "atlas_identification": chart(errors, "joint", ("effort", "acceleration"), "way"),
    }


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True, figures=True)
    add_folder_option(parser, "with Atlas")
    options = parser.parse_args()
    small = options.quick or not (options.shared / ATLAS).is_file()
    plan = Plan(None if small else str(options.shared), seed=options.seed)
    if options.quick:
        plan = replace(plan, motions=6, rate=60)
    elif small:
        print(f"Without {options.shared / ATLAS}, a small robot of our own is on one foot.")
    task, numbers = partial(one_motion, plan=plan), range(plan.motions)
    table = run(run_draws(parser, options, task, numbers, shared=not small), plan)
    print(
        f"{table['identifiable']} of {table['base_parameters']} base parameters have a variance of "
        f"at most {THRESHOLD:g}; zero-moment points stay within "
        f"{100 * table['largest_zmp']:.0f} % of the sole's half sizes"
    )
    show("Errors of parameters; RMS errors in N, N·m and rad/s²", table["rows"])
    print(f"Full over reduced parameter error: {table['error_full_over_reduced']:.3g}")
    write(options, table, atlas_identification=lambda: figures_of(table))


if __name__ == "__main__":
    main()
