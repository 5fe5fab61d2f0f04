"""The leg's bodies, identified with the base fixed, in a gallop of the whole robot.

As in [Lee2019] §3.6.2.2 and figure 3.12: random true legs, noiseless torques of the gallop's motion
of one leg on a fixed base, almost no regularization, equal residuals; then the errors of joint
torques and of the force and moment on the trunk while the whole robot gallops. Robot and motion are
this project's (`models/cheetah.dmd.yaml`, `gallop`).

    python -m diagrams.studies.cheetah_gallop --json cheetah_gallop.json --figures figures
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from rich.progress import track

from diagrams.harness import chart, script_parser, show, sines, write
from diagrams.studies.cheetah.leg import (
    JOINTS,
    MODELS,
    Array,
    Condensed,
    Leg,
    fit,
    fit_points,
    geared,
    load_leg,
)
from geodrake.identification import PointMasses
from geodrake.inertia import PARAMETERS_PER_BODY, is_realizable, perturb
from geodrake.inertia.ellipsoids import ellipsoid_of_quadric
from geodrake.logs import Motion
from geodrake.model import RobotModel, load_model
from geodrake.robot import base_parameters, base_wrench_regressor, inverse_dynamics_regressor
from geodrake.robot.regressor import body_poses

# A gallop-like motion of the whole robot: trunk and four legs ([Lee2019] §3.6.2.2).
#
# The motion is ours: surge, heave and pitch of the trunk and swings of the legs at the stride's
# frequency and its double, each leg with its own phase in the stride as in a transverse gallop.

LEGS = ("front_left", "front_right", "rear_left", "rear_right")
ACTUATORS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
PHASES = {"front_left": 0.0, "front_right": 0.15, "rear_left": 0.55, "rear_right": 0.7}
GEARS = (7.667, 7.667, 8.846)
STRIDE = 2.5  # Hz


@dataclass(frozen=True, eq=False)
class Quantity:
    """A linear part of the inverse dynamics by the parameters of a leg, the same for all legs."""

    rows: Array  # (m, 60) regressor, over samples and components
    components: int  # number of components that a sample has

    def rms(self, error: Array) -> float:
        """Return the RMS effect over samples of errors (6, 10) of the parameters."""
        values = (self.rows @ error.ravel()).reshape(-1, self.components)
        return float(np.sqrt(np.mean(np.square(values).sum(1))))


_ORDERS = np.array([[1], [2]])  # of the waves, in the stride's frequency


def leg_motion(time: Array, phase: float) -> Motion:
    """Return angles of a leg's joints, with their derivatives."""
    size = np.array([[0.08, 0.55, 0.35], [0.04, 0.12, 0.25]])
    own = np.array([[0.4, 0.0, 1.9], [1.3, 0.8, 0.5]])
    rate = 2 * np.pi * STRIDE * _ORDERS
    q, v, vd = sines(time, size, rate, 2 * np.pi * phase * _ORDERS + own)
    return Motion(q + np.array([0.05, 0.75, -1.5]), v, vd)


def trunk_motion(time: Array) -> Motion:
    """Return surge, heave and pitch of the trunk, with their derivatives; 3 m/s forward."""
    size = np.array([[0.02, 0.05, 0.18], [0.01, 0.02, 0.05]])
    phase = np.array([[0.3, 1.1, 0.2], [2.0, 0.4, 1.5]])
    q, v, vd = sines(time, size, 2 * np.pi * STRIDE * _ORDERS, phase)
    forward = np.array([3.0, 0.0, 0.0])
    return Motion(q + [0.0, 0.55, 0.0] + time[:, None] * forward, v + forward, vd)


def whole_robot() -> RobotModel:
    """Return the floating trunk with four legs of geared joints."""
    gears = geared(ACTUATORS, GEARS * len(LEGS))
    return load_model(MODELS / "cheetah.dmd.yaml", floating=True, transmission=[gears])


def gallop(time: Array) -> Motion:
    """Return a motion of the whole robot, of its base and then of the joints of its legs."""
    legs = [leg_motion(time, PHASES[leg]) for leg in LEGS]
    joints = Motion(*(np.hstack([getattr(leg, part) for leg in legs]) for part in ("q", "v", "vd")))
    trunk, zero = trunk_motion(time), np.zeros(len(time))
    (x, z, pitch), (xd, zd, w), (xdd, zdd, wd) = (part.T for part in (trunk.q, trunk.v, trunk.vd))
    base_q = np.stack([x, zero, z, zero, pitch, zero], -1)
    base_v = np.stack([xd, zero, zd, zero, w, zero], -1)
    base_vd = np.stack([xdd, zero, zdd, zero, wd, zero], -1)
    return Motion(
        np.hstack([base_q, joints.q]),
        np.hstack([base_v, joints.v]),
        np.hstack([base_vd, joints.vd]),
        time,
    )


def quantities(model: RobotModel, motion: Motion) -> dict[str, Quantity]:
    """Return joint torques, and force and moment on the trunk, in its frame."""
    tree, state = model.tree, (motion.q, motion.v, motion.vd)
    trunk = body_poses(tree, motion.q)[:, tree.bodies.index("trunk")]
    wrench = base_wrench_regressor(tree, *state, X_WP=trunk)
    torque = inverse_dynamics_regressor(tree, *state)[:, len(model.base_joints) :]

    def of_a_leg(regressor: Array) -> Quantity:
        blocks = regressor.reshape(*regressor.shape[:2], len(tree.bodies), PARAMETERS_PER_BODY)
        places = [[k for k, b in enumerate(tree.bodies) if b.startswith(leg)] for leg in LEGS]
        rows = sum(blocks[:, :, place] for place in places)
        return Quantity(rows.reshape(-1, 6 * PARAMETERS_PER_BODY), regressor.shape[1])

    return {
        "joint torque": of_a_leg(torque),
        "body force": of_a_leg(wrench[:, 3:]),
        "body moment": of_a_leg(wrench[:, :3]),
    }


ALPHA = 1e-11
"""The Euclidean γ over tr(AᵀA)."""
DELTA, POINTS = 0.5, 10
"""Greatest share of the mass that is added or taken away, and by how many points."""
SETS = {f"{number} point masses": number for number in (264, 687)}
"""Of Eq. (3.6.78), and how many there are in each."""
KINDS = ("euclidean", *SETS, "pullback", "entropic")


def true_legs(leg: Leg, count: int, rng: np.random.Generator) -> Array:
    """Return legs (count, 6, 10) that differ from the prior by point masses inside the ellipsoids.

    Legs are left out if a body with removed mass no longer fits into its ellipsoid.
    """
    support, legs = ellipsoid_of_quadric(leg.ellipsoids), np.empty((0, *leg.prior.shape))
    while len(legs) < count:
        drawn = perturb(
            leg.prior,
            2 * count,
            rng=rng,
            mass_uncertainty=DELTA,
            point_masses=POINTS,
            support=support,
        ).phi
        inside = is_realizable(drawn, leg.ellipsoids).all(axis=1)
        legs = np.concatenate([legs, drawn[inside]])
    return legs[:count]


def identified(
    leg: Leg, points: Mapping[str, PointMasses], A: Array, truth: Array
) -> tuple[dict[str, Array], dict[str, float]]:
    """Return parameters and RMS training errors by regularizer, from noiseless torques."""
    data = Condensed.of(A, A @ truth.ravel())
    euclidean = fit(data, leg, "euclidean", gamma=ALPHA * float(np.square(A).sum()))
    bound, found = euclidean.residual, {"euclidean": euclidean}
    for kind in KINDS[1:]:
        if kind in points:
            found[kind] = fit_points(data, leg, points[kind], bound)
        else:
            found[kind] = fit(data, leg, kind, residual_bound=bound)
    return (
        {kind: result.phi for kind, result in found.items()},
        {kind: data.rms(result) for kind, result in found.items()},
    )


def run(*, seed: int, truths: int) -> tuple[list[dict[str, Any]], int]:
    """Identify `truths` random legs.

    Returns:
        The table, and the number of base parameters that the leg's motion identifies.
    """
    rng, leg = np.random.default_rng(seed), load_leg(GEARS)
    time = np.linspace(0.0, 1.0 / STRIDE, 200, endpoint=False)
    predicted = quantities(whole_robot(), gallop(time))
    A = leg.regressor(leg_motion(time, PHASES["front_left"])).reshape(-1, 60)
    kinds = (*KINDS, "prior")
    errors = np.empty((truths, len(kinds), len(predicted)))
    train = np.empty((truths, len(kinds)))
    legs = true_legs(leg, truths, rng)
    points = {kind: leg.point_masses(number) for kind, number in SETS.items()}
    for k, truth in enumerate(track(legs, "true legs", transient=True)):
        found, fitted = identified(leg, points, A, truth)
        found["prior"] = leg.prior
        fitted["prior"] = float(np.sqrt(np.mean((A @ (truth - leg.prior).ravel()) ** 2)))
        for i, kind in enumerate(kinds):
            errors[k, i] = [q.rms(found[kind] - truth) for q in predicted.values()]
            train[k, i] = fitted[kind]
    rows = [
        {
            "regularizer": kind,
            "quantity": name,
            "unit": "N" if name == "body force" else "N·m",
            "mean": float(errors[:, i, j].mean()),
            "deviation": float(errors[:, i, j].std()),
            "train": float(train[:, i].mean()),
        }
        for j, name in enumerate(predicted)
        for i, kind in enumerate(kinds)
    ]
    return rows, base_parameters(A).rank


def main() -> None:
    """Run the study from the command line."""
    options = script_parser(
        __doc__, "five true legs instead of a hundred", figures=True
    ).parse_args()
    logging.getLogger("drake").setLevel(logging.WARNING)
    rows, rank = run(seed=options.seed, truths=5 if options.quick else 100)
    show("RMS", rows)
    print(f"The leg's motion tells {rank} base parameters of its 60 parameters.")
    drawn = [{**row, "mean_deviation": row["deviation"]} for row in rows]
    draw = partial(chart, drawn, "regularizer", "mean", panel="quantity", note="RMS, N and N·m")
    write(options, rows, cheetah_gallop_errors=draw)


if __name__ == "__main__":
    main()
