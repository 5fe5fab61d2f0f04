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

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia

from diagrams.harness import chart, run_draws, script_parser, show, write
from diagrams.public_data import add_folder_option
from geodrake.excitation import (
    ExcitationTrajectory,
    ReducedIdentification,
    SplineMotion,
    Target,
    make_target,
    measurement_factor,
    reduced_identification,
)
from geodrake.inertia import inertial_parameters, perturb
from geodrake.logs import Motion
from geodrake.model import RobotModel
from geodrake.robot import (
    base_wrench_regressor,
    inverse_dynamics_regressor,
    zero_moment_point,
)
from geodrake.robot.base_parameters import pushforward_metric
from geodrake.robot.files.description import drake_messages
from geodrake.robot.plant import position_limits, velocity_limits

# Robots on one foot, [Lee2019] §4.6.3: Atlas from a folder of its own, or a small one of ours.
#
# The left sole is the ground's frame: both are welded together there, so that a robot in balance
# is a tree with a fixed base, and what the force plate under it measures is the base wrench.

ATLAS = Path("reference") / "atlas_v5.urdf"
SOLE = "l_foot_sole"
HALF_SOLE = np.array([0.13, 0.06])
"""Half length and half width of the sole, m; the length is Atlas's, the width is ours."""
STANCE = ("l_leg_akx", "l_leg_aky")
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

_X, _Y, _Z = np.eye(3)
_LEG, _TRUNK = (0.08, 0.08, 0.4), (0.2, 0.3, 0.4)
_SMALL = (
    # joint, parent, place of the joint in the parent, axis, mass, box about its centre, its centre
    ("l_leg_akx", None, (0, 0, 0.08), _X, 0.5, (0.05, 0.05, 0.05), (0, 0, 0)),
    ("l_leg_aky", "l_leg_akx", (0, 0, 0), _Y, 3.0, _LEG, (0, 0, 0.2)),
    ("l_leg_kny", "l_leg_aky", (0, 0, 0.4), _Y, 5.0, _LEG, (0, 0, 0.2)),
    ("l_leg_hpy", "l_leg_kny", (0, 0, 0.4), _Y, 1.0, (0.1, 0.1, 0.1), (0, -0.02, 0)),
    ("l_leg_hpx", "l_leg_hpy", (0, 0, 0), _X, 8.0, (0.2, 0.25, 0.15), (0, -0.1, 0.05)),
    ("back_bky", "l_leg_hpx", (0, -0.1, 0.12), _Y, 20.0, _TRUNK, (0, 0, 0.25)),
    ("l_arm_shx", "back_bky", (0, 0.2, 0.4), _X, 2.0, (0.07, 0.3, 0.07), (0, 0.15, 0)),
    ("l_arm_elx", "l_arm_shx", (0, 0.3, 0), _X, 1.5, (0.06, 0.25, 0.06), (0, 0.12, 0)),
    ("r_arm_shx", "back_bky", (0, -0.2, 0.4), _X, 2.0, (0.07, 0.3, 0.07), (0, -0.15, 0)),
    ("r_arm_elx", "r_arm_shx", (0, -0.3, 0), _X, 1.5, (0.06, 0.25, 0.06), (0, -0.12, 0)),
    ("r_leg_hpy", "l_leg_hpx", (0, -0.2, 0), _Y, 5.0, _LEG, (0, 0, -0.2)),
    ("r_leg_kny", "r_leg_hpy", (0, 0, -0.4), _Y, 3.0, _LEG, (0, 0, -0.2)),
)


def standing_robot(shared: Path | None) -> RobotModel:
    """Return Atlas on its left foot, of the folder `shared`; our small robot if None.

    Its neck, which is not among the source's 29 joints, is held.
    """
    return _small() if shared is None else _atlas(shared / ATLAS)


def _atlas(path: Path) -> RobotModel:
    text = re.sub(r"<safety_controller[^>]*/>", "", path.read_text(encoding="utf-8"))
    text = re.sub(r'(name="neck_ay"\s+type=)"revolute"', r'\1"fixed"', text)
    plant = MultibodyPlant(0.0)
    with drake_messages():
        Parser(plant).AddModelsFromString(text, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(SOLE), RigidTransform())
    plant.Finalize()
    return RobotModel(plant, path, False, inertial_parameters(plant))


def _small() -> RobotModel:
    plant, reach = MultibodyPlant(0.0), 1.0
    for name, parent, place, axis, mass, box, center in _SMALL:
        P = plant.world_body() if parent is None else plant.GetBodyByName(parent)
        inertia = SpatialInertia.SolidBoxWithMass(mass, *box)
        B = plant.AddRigidBody(name, inertia.Shift(-np.array(center, float)))
        frame = FixedOffsetFrame(f"{name}_F", P.body_frame(), RigidTransform(np.array(place)))
        F = plant.AddFrame(frame)
        joint = plant.AddJoint(RevoluteJoint(name, F, B.body_frame(), axis, -reach, reach))
        joint.set_velocity_limits([-12.0], [12.0])
    plant.Finalize()
    return RobotModel(plant, Path("standing"), False, inertial_parameters(plant))


def groups(model: RobotModel) -> dict[str, np.ndarray]:
    """Return indices of the joints of every group that the robot has."""
    found = {
        group: np.array([i for i, joint in enumerate(model.joints) if re.search(pattern, joint)])
        for group, pattern in GROUPS.items()
    }
    return {group: indices for group, indices in found.items() if len(indices)}


Array = NDArray[np.float64]

# Random motions of a robot that balances on one foot, [Lee2019] §4.6.3.
#
# Random postures get their centre of mass over the sole by the ankle. A spline leads from one to
# another by way of others, as much out of the straight line as the zero-moment point allows.

FAMILY = SplineMotion(3.0, 10, 5)
CHECK_RATE = 15.0  # 1/s, at which the source checks balance
_MARGIN = 0.95  # of the sole, within which the zero-moment point is to be
_AIM = 0.5  # of the sole, over which centres of mass of postures are
_REACH = 0.6  # of the joints' ranges
_SHARES = np.linspace(1.0, 0.2, 17)
_CLOSE, _STEP, _NEWTON, _BATCH, _TRIES = 1e-3, 1e-5, 8, 40, 60


@dataclass(frozen=True, eq=False)
class Balance:
    """A robot whose left sole is the world's frame."""

    model: RobotModel

    def zmp(self, q: Array, v: Array, vd: Array) -> Array:
        """Return (N, 2) zero-moment points on the ground, m; NaN where the foot would lift off."""
        Y = base_wrench_regressor(self.model.tree, q, v, vd)
        return zero_moment_point(Y @ self.model.phi.ravel())

    def postures(self, rng: np.random.Generator, count: int) -> Array:
        """Return (count, nv) random postures by joint with the centre of mass over the sole."""
        model, (lower, upper) = self.model, position_limits(self.model.plant)
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        ankle = [model.joints.index(name) for name in STANCE]
        found: list[Array] = []
        for _ in range(_TRIES):
            tried = middle + rng.uniform(-_REACH, _REACH, (_BATCH, len(lower))) * half
            aim = rng.uniform(-_AIM, _AIM, (_BATCH, 2)) * HALF_SOLE
            error = self._correct(tried, aim, ankle)
            within = ((tried >= lower) & (tried <= upper)).all(axis=1)
            found += list(tried[within & (error < _CLOSE)])
            if len(found) >= count:
                return np.array(found[:count])
        raise RuntimeError(f"Only {len(found)} of {count} postures are in balance.")

    def _correct(self, postures: Array, aim: Array, ankle: list[int]) -> Array:
        """Turn the ankle until centres of mass are over `aim`; the distances (N,) left, m."""
        still = np.zeros_like(postures)

        def off(x: Array) -> Array:
            return self.zmp(x, still, still) - aim

        error = off(postures)
        for _ in range(_NEWTON):
            jacobian = np.empty((len(postures), 2, 2))
            for k, joint in enumerate(ankle):
                moved = postures.copy()
                moved[:, joint] += _STEP
                jacobian[:, :, k] = (off(moved) - error) / _STEP
            jacobian += 1e-9 * np.eye(2)
            step = np.linalg.solve(jacobian, error[..., None])[..., 0]
            postures[:, ankle] -= np.clip(step, -0.3, 0.3)
            error = off(postures)
        return np.asarray(np.linalg.norm(error, axis=1))

    def motion(self, rng: np.random.Generator) -> tuple[ExcitationTrajectory, float]:
        """A random motion in balance, from rest to rest, and its share out of the straight line."""
        inner = FAMILY.points - 4  # two free ends of three equal points each, less the ends
        along = np.clip((np.arange(FAMILY.points) - 2) / (FAMILY.points - 5), 0.0, 1.0)[:, None]
        for _ in range(_TRIES):
            postures = self.postures(rng, inner)
            straight = (1 - along) * postures[0] + along * postures[-1]
            detour = np.zeros_like(straight)
            detour[3:-3] = postures[1:-1] - straight[3:-3]
            for share in _SHARES:
                moving = straight + share * detour
                trajectory = ExcitationTrajectory(FAMILY, moving, self.model.joints)
                if self.keeps(trajectory):
                    return trajectory, float(share)
        raise RuntimeError("No random motion is in balance.")

    def keeps(self, trajectory: ExcitationTrajectory) -> bool:
        """Whether a motion keeps its zero-moment point in the sole, and speeds in their limits.

        Positions of a spline are between its points, which keep their limits.
        """
        motion = trajectory.motion(FAMILY.times(round(CHECK_RATE * FAMILY.length) + 1))
        if (np.abs(motion.v) > velocity_limits(self.model.plant)).any():
            return False
        zmp = self.zmp(motion.q, motion.v, motion.vd)
        return bool((np.abs(zmp) <= _MARGIN * HALF_SOLE).all())  # NaN is not


NOISE = np.array([1.5, 1.5, 1.5, 0.5, 0.5, 0.5])  # N·m and N
RATE = 300  # samples a second


@dataclass(frozen=True)
class Plan:
    """What a run is made of."""

    shared: str | None  # folder with the description of Atlas; None for the small robot
    motions: int = 20
    rate: int = RATE
    threshold: float = 1e-2  # ε_λ
    uncertainty: float = 0.8  # how wrong the masses of the prior's links are, at most
    seed: int = 0


def robot(plan: Plan) -> RobotModel:
    """Return the true robot."""
    return standing_robot(None if plan.shared is None else Path(plan.shared))


def one_motion(number: int, *, plan: Plan) -> dict[str, Any]:
    """Return a random motion in balance."""
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
    """Return a motion at a rate (1/s)."""
    trajectory = ExcitationTrajectory(FAMILY, np.array(found["coefficients"]), model.joints)
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
    """Return the root mean square of all."""
    return float(np.sqrt(np.mean(np.square(x))))


def run(found: Sequence[dict[str, Any]], plan: Plan) -> dict[str, Any]:
    """Return figure 4.7 and tables 4.3 and 4.4, of motions in balance."""
    truth, kept = robot(plan), asdict(plan)
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


def tell(table: dict[str, Any]) -> None:
    """Print tables 4.3 and 4.4."""
    plan, rows = table["plan"], table["rows"]
    print(
        f"{table['identifiable']} of {table['base_parameters']} base parameters have a variance of "
        f"at most {plan['threshold']:g}; zero-moment points stay within "
        f"{100 * table['largest_zmp']:.0f} % of the sole's half sizes"
    )
    show("Errors of parameters; RMS errors in N, N·m and rad/s²", rows)
    print(f"Full over reduced parameter error: {table['error_full_over_reduced']:.3g}")


def figures_of(table: dict[str, Any]) -> dict[str, Figure]:
    """Return figure 4.7: variances along principal directions, and errors of accelerations."""
    threshold = table["plan"]["threshold"]
    variances = [
        {"direction": k + 1, "variance": x, "identifiable": "yes" if x <= threshold else "no"}
        for k, x in enumerate(table["variances"])
        if np.isfinite(x)
    ]
    errors = [
        {"way": row["way"], "joint": joint, kind: row[kind][joint]}
        for row in table["rows"]
        for kind in ("effort", "acceleration")
        for joint in row[kind]
    ]
    levels = {"threshold": {"variance": threshold}}
    by = {"levels": levels, "joined": False}
    return {
        "atlas_variances": chart(variances, "direction", "variance", "identifiable", **by),
        "atlas_identification": chart(errors, "joint", ("effort", "acceleration"), "way"),
    }


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True, figures=True)
    add_folder_option(parser, "with Atlas")
    parser.add_argument("--motions", type=int, help="how many (20; 6 with --quick)")
    parser.add_argument("--threshold", type=float, default=1e-2, help="of identifiable variances")
    parser.add_argument("--uncertainty", type=float, default=0.8, help="of the prior's masses")
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
    if small and not options.quick:
        print(f"Without {options.shared / ATLAS}, a small robot of our own is on one foot.")
    task, numbers = partial(one_motion, plan=plan), range(plan.motions)
    table = run(run_draws(parser, options, task, numbers, shared=not small), plan)
    tell(table)
    write(options, table, atlas_identification=lambda: figures_of(table))


if __name__ == "__main__":
    main()
