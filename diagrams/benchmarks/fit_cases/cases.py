"""An arm of ten bodies with seven motors, made here, and a human on a force plate, measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia

from geodrake.identification import BodyConstraints, FitProblem, identify
from geodrake.identification.identify import build_problem
from geodrake.identification.problem import whitened_factor
from geodrake.identification.regularizer import Entropic
from geodrake.inertia import inertial_parameters
from geodrake.robot import KinematicTree, inverse_dynamics_regressor

ROLLING = (2, 5, 8)  # Joints that share their motor with the joint after them, half a turn each.
NOISE = 0.02  # N·m
GAMMA = 0.03


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is fitted: arguments of `identify`.

    Attributes:
        name: Its name.
        A: (m, p) regressor.
        b: (m,) measurements.
        prior: (nb, 10) prior.
        gamma: Weight of the prior.
        sigma: Standard deviations of b.
        ellipsoids: (nb, 4, 4) bounding ellipsoids.
        extra_bounds: Bounds of the parameters after the inertial ones.
        truth: (p,) true parameters, if they are known.
    """

    name: str
    A: np.ndarray
    b: np.ndarray
    prior: np.ndarray
    gamma: float
    sigma: np.ndarray | float
    ellipsoids: np.ndarray
    extra_bounds: np.ndarray | None = None
    truth: np.ndarray | None = None

    def identified(self, regularizer: str, solver: str) -> Any:
        """The result of `identify`, from the regressors."""
        return identify(
            self.A,
            self.b,
            self.prior,
            regularizer=regularizer,
            gamma=self.gamma,
            sigma=self.sigma,
            ellipsoids=self.ellipsoids,
            extra_bounds=self.extra_bounds,
            solver=solver,
        )

    def problem(self, gamma: float) -> FitProblem:
        """The entropic fit on the triangular factor of the data."""
        problem = build_problem(
            whitened_factor(self.A, self.b, sigma=self.sigma),
            self.prior,
            constraints=BodyConstraints(ellipsoids=self.ellipsoids),
            extra_bounds=self.extra_bounds,
        )
        return Entropic().regularize(problem, self.prior, gamma)


def arm_case(*, samples: int, seed: int) -> Case:
    """Ten bodies on seven motors, three of which turn two joints each; 107 parameters."""
    rng = np.random.default_rng(seed)
    plant = _arm()
    truth, tree = inertial_parameters(plant), KinematicTree.from_plant(plant)
    J = np.zeros((10, 7))
    motors = np.cumsum([joint - 1 not in ROLLING for joint in range(10)]) - 1
    J[range(10), motors] = [0.5 if {j, j - 1} & set(ROLLING) else 1.0 for j in range(10)]
    motion = [rng.uniform(-scale, scale, (samples, 7)) for scale in (1.5, 2.0, 6.0)]
    joints = inverse_dynamics_regressor(tree, *(part @ J.T for part in motion))
    rotors = np.eye(7) * motion[2][:, None, :]
    A = np.concatenate([J.T @ joints, rotors], -1).reshape(7 * samples, 107)
    parameters = np.append(truth.ravel(), np.full(7, 0.02))
    stretch = np.exp(rng.normal(0.0, 0.2, (10, 1)))
    radii = np.array([0.12, 0.12, 0.25])
    com = truth[:, 1:4] / truth[:, :1]
    return Case(
        name="arm",
        A=A,
        b=A @ parameters + rng.normal(0.0, NOISE, 7 * samples),
        prior=truth * stretch,
        gamma=GAMMA,
        sigma=1.0,
        ellipsoids=np.array([_ellipsoid(centre, radii) for centre in com]),
        extra_bounds=np.tile([0.0, np.inf], (7, 1)),
        truth=parameters,
    )


def _arm() -> MultibodyPlant:
    """Ten cylinders in a row, hinged about x, y and z in turn."""
    plant, parent = MultibodyPlant(time_step=0.0), None
    for i in range(10):
        mass = 3.0 * 0.8**i
        inertia = SpatialInertia.SolidCylinderWithMass(mass, 0.05, 0.2, [0.0, 0.0, 1.0])
        body = plant.AddRigidBody(f"link_{i}", inertia.Shift([0.01, 0.02, -0.1]))
        frame = plant.world_frame() if parent is None else parent.body_frame()
        X = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.0, 0.0, 0.2])
        hinge = plant.AddFrame(FixedOffsetFrame(f"hinge_{i}", frame, X))
        axis = np.eye(3)[i % 3]
        plant.AddJoint(RevoluteJoint(f"joint_{i}", hinge, body.body_frame(), axis))
        parent = body
    plant.Finalize()
    return plant


def _ellipsoid(centre: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Q with [x;1]ᵀ Q [x;1] ≥ 0 inside."""
    Q = np.zeros((4, 4))
    shape = np.diag(radii**-2.0)
    Q[:3, :3], Q[:3, 3], Q[3, :3] = -shape, shape @ centre, shape @ centre
    Q[3, 3] = 1.0 - centre @ shape @ centre
    return Q


def human_case(shared: Path) -> Case | None:
    """The human on a force plate at the residual of α = 0.01; None without the measurements."""
    path = shared / "data" / "human_force_plate.npz"
    if not path.exists():
        return None
    human = np.load(path)
    return Case(
        name="human",
        A=human["A"],
        b=human["b"],
        prior=human["phi_prior"],
        gamma=1.05e6,
        sigma=np.tile(human["sigma"], len(human["b"]) // 3),
        ellipsoids=human["Q"],
    )
