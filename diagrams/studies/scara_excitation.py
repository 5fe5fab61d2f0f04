"""A payload on a SCARA arm: motions designed in four frames with three normalizations.

[Lee2019] §4.6.1 and table 4.1: 50 free samples minimize the condition number, for the mass, centre
and moment of inertia of the payload. With the geometric normalization the optimum is the same in
every frame, until rounding leads the solver different ways, after some 300 steps along a flat
valley; hence the limit of iterations. Errors are expected ones, from the covariance of least
squares. Finished designs are kept beside the table, so that an interrupted run goes on.

    python -m diagrams.studies.scara_excitation --json scara.json
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    RotationalInertia,
    SpatialInertia,
)

from diagrams.harness import run_draws, script_parser, show, show_values, write
from diagrams.studies.iiwa_excitation import (
    apart,
    identified_by,
    parameter_error,
    ratio_less_1,
    root_covariance,
)
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
from geodrake.excitation.objective import NORMALIZATIONS
from geodrake.inertia import Array, inertial_parameters
from geodrake.model import RobotModel

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
    """Return a uniform sphere in frame {3}, by its moment about the frame's own z-axis."""
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
    """Return this study's limits of samples; the source does not state its own."""
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


@dataclass(frozen=True)
class Cell:
    """A line of the table."""

    normalization: str  # one of `NORMALIZATIONS`
    frame: str


CRITERION = Criterion("condition_number")


def design(cell: Cell, *, iterations: int, seed: int) -> dict[str, Any]:
    """Return the best samples by one normalization in one frame, and their errors.

    "value_by_frame" has the criterion of the same samples in every frame, and "geometric_value"
    that with geometric normalization, by which all motions can be compared.
    """
    result = design_excitation(
        payload_target(cell.frame),
        limits(),
        criterion=CRITERION.name,
        normalization=cell.normalization,
        trajectory=FreeSamples(SAMPLES),
        options=DesignOptions(iterations=iterations, quick=False),
        seeds=[seed],
    )
    motion, way = result.trajectory.motion(np.zeros(SAMPLES)), cell.normalization
    by_frame = {f: Objective(payload_target(f), CRITERION, way).value(motion) for f in FRAMES}
    return {
        **asdict(cell),
        "value": result.value,
        "random_value": result.outcomes[0].random_value,
        "coefficients": result.trajectory.coefficients.tolist(),
        **errors(result.trajectory),
        "geometric_value": Objective(payload_target("3"), CRITERION).value(motion),
        "value_by_frame": by_frame,
    }


def errors(trajectory: ExcitationTrajectory) -> dict[str, float]:
    """Return expected errors: those of table 4.1, in frame {3}, and the dimensionless one."""
    found = identified_by(payload_target("3"), trajectory, SAMPLES)
    R, truth = root_covariance(found), scara("3", payload(*TRUTH)).phi[1:]
    return {**errors_in_frame_3(R @ R.T), "error": parameter_error(found, truth)}


def spread(rows: Sequence[dict[str, Any]], normalization: str) -> dict[str, float]:
    """Return the spread over frames of the same samples' criterion, of errors, and of samples."""
    own = [row for row in rows if row["normalization"] == normalization]
    return {
        "criterion_largest_over_smallest_less_1": max(
            ratio_less_1(row["value_by_frame"].values()) for row in own
        ),
        "error_largest_over_smallest_less_1": ratio_less_1([row["error"] for row in own]),
        "samples_apart": apart(own),
    }


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    options = parser.parse_args()
    how = {"iterations": 10 if options.quick else 100, "seed": options.seed}
    cells = [Cell(name, frame) for name in NORMALIZATIONS for frame in FRAMES]
    rows = run_draws(parser, options, partial(design, **how), cells, plan=how)
    spreads = {name: spread(rows, name) for name in NORMALIZATIONS}
    rows = [{k: v for k, v in row.items() if k != "coefficients"} for row in rows]
    show("RMS errors of m in kg, and of p^x, p^y and r^z in mm", rows)
    show_values("Differences between frames", spreads)
    write(options, {"plan": how, "rows": rows, "spread": spreads})


if __name__ == "__main__":
    main()
