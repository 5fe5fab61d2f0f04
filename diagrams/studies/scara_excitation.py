"""A payload on a SCARA arm: motions designed in four frames with three normalizations.

[Lee2019] §4.6.1 and table 4.1: 50 free samples minimize the condition number, for the mass, centre
and moment of inertia of the payload. With the geometric normalization, the optimum is the same in
every frame, until rounding has made the solver's ways part: some 300 steps along a flat valley,
hence the limit of --iterations. Errors are those to be expected, exactly, by the covariance of
least squares. Finished designs are kept beside the table, so that an interrupted run goes on.

    python -m diagrams.studies.scara_excitation --json scara.json
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    RotationalInertia,
    SpatialInertia,
)

from diagrams.harness import run_draws, script_parser, show, show_values, write
from diagrams.studies.iiwa_excitation import identified_by, parameter_error, root_covariance
from geodrake.excitation import (
    Criterion,
    DesignOptions,
    ExcitationTrajectory,
    FreeSamples,
    MotionLimits,
    Objective,
    Target,
    design_excitation,
    make_target,
)
from geodrake.excitation.objective import CRITERIA, NORMALIZATIONS
from geodrake.inertia import inertial_parameters
from geodrake.model import RobotModel

Array = NDArray[np.float64]

# The SCARA arm of [Lee2019] §4.6.1: two links in a plane, a payload, and frames to see it from.
#
# A payload's ten parameters are about the origin of its link's frame. Moving that frame, with
# joints and masses where they are, changes what the parameters mean and nothing else.

LINK = 0.5  # m, both
NOISE = 0.03  # N·m
SAMPLES = 50
TRUTH = (4.0, (0.0, 0.0), 0.08165)
PRIOR = (4.58, (0.02e-3, 1.94e-3), 0.08607)
"""Mass, kg; centre of mass in frame {3}, m; radius of gyration about the vertical, m."""
_FLANGE = 0.15  # m, from the end of the second link to the payload's centre

FRAMES = {
    "1": RigidTransform([0.0, -0.3, 0.0]),
    "2": RigidTransform(RotationMatrix.MakeZRotation(0.6), [-0.25, 0.1, 0.0]),
    "3": RigidTransform(),
    "4": RigidTransform(RotationMatrix.MakeZRotation(-0.9), [0.12, 0.2, 0.0]),
}
"""Poses in the frame {3} at the payload's centre; {1} is on its y-axis, where p^x is as small."""


def payload(mass: float, com: tuple[float, float], gyration: float) -> SpatialInertia:
    """A uniform sphere in frame {3}; its moment about z is that about the frame's own origin."""
    p = np.array([*com, 0.0])
    own = mass * (gyration**2 - p @ p)
    return SpatialInertia.MakeFromCentralInertia(mass, p, RotationalInertia(own, own, own))


def scara(frame: str, body: SpatialInertia) -> RobotModel:
    """Return the arm with a body at its end, described in one of `FRAMES`.

    Its links are known, so that they do not matter; they are light.
    """
    plant, X_3B = MultibodyPlant(0.0), FRAMES[frame]
    rod = SpatialInertia.SolidBoxWithMass(1.0, LINK, 0.05, 0.05).Shift([-LINK / 2, 0.0, 0.0])
    upper = plant.AddRigidBody("upper_arm", rod)
    moved = body.Shift(X_3B.translation()).ReExpress(X_3B.rotation().inverse())
    fore = plant.AddRigidBody("forearm", moved)
    world = plant.world_body().body_frame()
    plant.AddJoint(RevoluteJoint("shoulder", world, upper.body_frame(), [0, 0, 1], -np.pi, np.pi))
    # The payload is beside the forearm's line, so that no frame here is aligned with it.
    X_J3 = RigidTransform(RotationMatrix.MakeZRotation(0.4), [LINK, _FLANGE, 0.0])
    elbow = FixedOffsetFrame("elbow_F", upper.body_frame(), RigidTransform([LINK, 0.0, 0.0]))
    inverse = FixedOffsetFrame("elbow_M", fore.body_frame(), (X_J3 @ X_3B).inverse())
    F, M = plant.AddFrame(elbow), plant.AddFrame(inverse)
    plant.AddJoint(RevoluteJoint("elbow", F, M, [0, 0, 1], -np.pi, np.pi))
    plant.Finalize()
    return RobotModel(plant, Path("scara"), False, inertial_parameters(plant))


def payload_target(frame: str) -> Target:
    """Return the unknown payload in a frame, with its prior."""
    return make_target(scara(frame, payload(*PRIOR)), noise=NOISE, bodies=["forearm"])


def limits() -> MotionLimits:
    """Return our limits of samples; the source does not state its own."""
    return MotionLimits(
        ("shoulder", "elbow"),
        lower=np.full(2, -np.pi),
        upper=np.full(2, np.pi),
        velocity=np.full(2, 2.0),
        acceleration=np.full(2, 5.0),
        effort=np.full(2, np.inf),
    )


def errors_in_frame_3(covariance: Array) -> dict[str, float]:
    """Return RMS errors of m (kg), p^x, p^y and r^z (mm) from the covariance (10, 10) of φ in {3}.

    To first order in the noise, at the true payload, whose centre is the origin.
    """
    mass, _, gyration = TRUTH
    variance = np.diagonal(covariance)
    by_r = np.zeros(10)
    by_r[0], by_r[6] = -gyration / (2 * mass), 1 / (2 * mass * gyration)
    return {
        "m": float(np.sqrt(variance[0])),
        "px": float(1e3 * np.sqrt(variance[1]) / mass),
        "py": float(1e3 * np.sqrt(variance[2]) / mass),
        "rz": float(1e3 * np.sqrt(by_r @ covariance @ by_r)),
    }


COLUMNS = {"m": "m, kg", "px": "p^x, mm", "py": "p^y, mm", "rz": "r^z, mm", "error": "error"}


@dataclass(frozen=True)
class Plan:
    """What every design has in common."""

    criterion: str = "condition_number"
    iterations: int = 100  # most iterations of the solver, in each of its two stages
    seeds: int = 1
    seed: int = 0


@dataclass(frozen=True)
class Cell:
    """A line of the table."""

    normalization: str  # one of `NORMALIZATIONS`
    frame: str


def design(cell: Cell, *, plan: Plan) -> dict[str, Any]:
    """Return the best samples by one normalization in one frame, and the errors that they leave."""
    target = payload_target(cell.frame)
    result = design_excitation(
        target,
        limits(),
        criterion=plan.criterion,
        normalization=cell.normalization,
        trajectory=FreeSamples(SAMPLES),
        options=DesignOptions(iterations=plan.iterations, quick=False),
        seeds=range(plan.seed, plan.seed + plan.seeds),
    )
    return {
        **asdict(cell),
        "value": result.value,
        "random_value": result.outcomes[0].random_value,
        "coefficients": result.trajectory.coefficients.tolist(),
        **errors(result.trajectory),
        **geometric_value(result.trajectory, plan),
        "value_by_frame": values_by_frame(result.trajectory, cell.normalization, plan),
    }


def values_by_frame(
    trajectory: ExcitationTrajectory, normalization: str, plan: Plan
) -> dict[str, float]:
    """Return the criterion of the same samples in every frame."""
    criterion, motion = Criterion(plan.criterion), trajectory.motion(np.zeros(SAMPLES))
    return {
        frame: Objective(payload_target(frame), criterion, normalization).value(motion)
        for frame in FRAMES
    }


def errors(trajectory: ExcitationTrajectory) -> dict[str, float]:
    """Return errors to be expected: those of table 4.1, in frame {3}, and the dimensionless one."""
    found = identified_by(payload_target("3"), trajectory, SAMPLES)
    R, truth = root_covariance(found), scara("3", payload(*TRUTH)).phi[1:]
    return {**errors_in_frame_3(R @ R.T), "error": parameter_error(found, truth)}


def geometric_value(trajectory: ExcitationTrajectory, plan: Plan) -> dict[str, float]:
    """Return the criterion with geometric normalization, by which all motions can be compared."""
    objective = Objective(payload_target("3"), Criterion(plan.criterion))
    return {"geometric_value": objective.value(trajectory.motion(np.zeros(SAMPLES)))}


def spread(rows: Sequence[dict[str, Any]], normalization: str) -> dict[str, float]:
    """How much frames matter: to the criterion of the same samples, to errors, and to samples."""
    own = [row for row in rows if row["normalization"] == normalization]
    error = [row["error"] for row in own]
    samples = np.array([row["coefficients"] for row in own])
    values = [[*row["value_by_frame"].values()] for row in own]
    return {
        "criterion_largest_over_smallest_less_1": max(max(v) / min(v) - 1.0 for v in values),
        "error_largest_over_smallest_less_1": max(error) / min(error) - 1.0,
        "samples_apart": float(np.abs(samples - samples[0]).max()),
    }


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--criterion", choices=CRITERIA, default="condition_number")
    parser.add_argument("--iterations", type=int, help="of the solver (100; 10 with --quick)")
    parser.add_argument("--seeds", type=int, default=1, help="number of random starts")
    options = parser.parse_args()
    iterations = options.iterations or (10 if options.quick else 100)
    plan = Plan(options.criterion, iterations, options.seeds, options.seed)
    cells = [Cell(name, frame) for name in NORMALIZATIONS for frame in FRAMES]
    rows = run_draws(parser, options, partial(design, plan=plan), cells, plan=asdict(plan))
    spreads = {name: spread(rows, name) for name in NORMALIZATIONS}
    rows = [{k: v for k, v in row.items() if k != "coefficients"} for row in rows]
    show("RMS errors of m in kg, and of p^x, p^y and r^z in mm", rows)
    show_values("Differences between frames", spreads)
    write(options, {"plan": plan, "rows": rows, "spread": spreads})


if __name__ == "__main__":
    main()
