"""The arm of the AMBIDEX study: joints, motors, rotors and friction.

    τ = Jᵀ Γ(θ, θ̇, θ̈) Φ + diag(q̈) I_r + diag(sign q̇) f_c + diag(q̇) f_v     [Lee2019] Eq. (3.6.57)

Each rotor is a body as well, of which its balanced turning on a fixed axis shows I_zz = I_r alone.
So the regularizers treat it like a link, and 59 points a link and 9 a rotor make the 653 point
masses of the source.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant

from diagrams.harness import MODELS
from geodrake.identification import PointMasses
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    Ellipsoid,
    equivalent_ellipsoid,
    from_mass_com_inertia,
    inertial_parameters,
    perturb,
    pseudo_inertia,
)
from geodrake.logs import Motion
from geodrake.robot import (
    InSequence,
    LinearTransmission,
    SideBySide,
    Transmission,
    base_wrench_regressor,
    gears,
    inverse_dynamics_regressor,
    load_plant,
    rolling_joint,
)

Array = NDArray[np.float64]

MODEL = MODELS / "ambidex_like.urdf"
REDUCTION = 30.0
REACH = np.array([1.0, 0.8, 1.2, 1.6, 1.4, 0.9, 0.9])  # rad, of the seven turns of the arm
ROTOR_MASS = 0.12  # kg
ROTOR_INERTIA = 1e-6 * np.array([14.0, 14.0, 12.0, 12.0, 8.0, 6.0, 6.0])  # kg·m²
COULOMB = 1e-3 * np.array([28.0, 26.0, 22.0, 24.0, 18.0, 14.0, 14.0])  # N·m, of the motor
VISCOUS = 1e-4 * np.array([2.4, 2.2, 2.0, 2.0, 1.6, 1.3, 1.3])  # N·m·s/rad, of the motor
SUPPORT = 1.4  # semi-axes of where parts may be, over those of the equivalent ellipsoid
LINK_POINTS = 59  # and nine a rotor: 653
POINT_TRIALS = 20


@dataclass(frozen=True, eq=False)
class Arm:
    """The arm with everything that the measurements come from.

    Attributes:
        plant: The ten links.
        transmission: From seven motors to ten joints.
        phi: (17, 10) inertial parameters of the links and then the rotors.
    """

    plant: MultibodyPlant
    transmission: Transmission
    phi: Array

    @classmethod
    def load(cls) -> Arm:
        """The arm of the model file, with our rotors."""
        plant = load_plant(MODEL).plant
        rotor = np.diag([0.6, 0.6, 1.0]) * ROTOR_INERTIA[:, None, None]
        rotors = from_mass_com_inertia(np.full(7, ROTOR_MASS), np.zeros((7, 3)), rotor)
        phi = np.vstack([inertial_parameters(plant), rotors])
        return cls(plant, transmission(), phi)

    def motors(self, turns: Array) -> Array:
        """Motor positions (..., 7) of the turns (..., 7) of the arm, rad."""
        wrist = turns[..., 5:] @ np.array([[1.0, 1.0], [1.0, -1.0]])
        return REDUCTION * np.concatenate([turns[..., :5], wrist], axis=-1)

    def regressor(self, motion: Motion) -> Array:
        """(N, 7, 170) columns of links and rotors for motor torques."""
        joints = self.transmission.joint_motion(motion)
        links = inverse_dynamics_regressor(self.plant, joints.q, joints.v, joints.vd)
        rotors = np.zeros((len(motion.q), 7, 7, PARAMETERS_PER_BODY))
        motor = np.arange(7)
        rotors[:, motor, motor, 6] = motion.vd
        links = self.transmission.regressor(motion.q, links)
        return np.concatenate([links, rotors.reshape(len(links), 7, -1)], axis=2)

    def wrench_regressor(self, motion: Motion) -> Array:
        """(N, 6, 100) columns of the links for the wrench about the world's origin."""
        joints = self.transmission.joint_motion(motion)
        return base_wrench_regressor(self.plant, joints.q, joints.v, joints.vd)


def transmission() -> Transmission:
    """Shoulder, rolling elbow, forearm, and a wrist of two rolling joints that two motors share."""
    mean_and_half_difference = LinearTransmission.of([[0.5, 0.5], [0.5, -0.5]])
    both = SideBySide((rolling_joint(), rolling_joint()))
    joints = SideBySide(
        (
            gears([1.0, 1.0, 1.0]),
            rolling_joint(),
            gears([1.0]),
            InSequence((mean_and_half_difference, both)),
        )
    )
    return InSequence((gears(np.full(7, REDUCTION)), joints))


def friction_regressor(v: Array) -> Array:
    """(N, 7, 14) columns of Coulomb and then viscous friction for motor velocities (N, 7)."""
    columns = np.zeros((len(v), 7, 14))
    motor = np.arange(7)
    columns[:, motor, motor], columns[:, motor, 7 + motor] = np.sign(v), v
    return columns


def perturbed(phi: Array, rng: np.random.Generator, delta: float) -> Array:
    """The bodies (17, 10) as somebody knows them who has never seen the arm.

    Every link has ten point masses in and around it added or taken away, up to a share δ of its
    mass in all ([Lee2019] Eq. (B.2.11)); a rotor, of which one number counts, is scaled by 1 ± δ.
    """
    support = equivalent_ellipsoid(phi[:10]).scaled(SUPPORT)
    links = perturb(phi[:10], 1, rng=rng, mass_uncertainty=delta, support=support).phi[0]
    return np.vstack([links, phi[10:] * rng.uniform(1 - delta, 1 + delta, (len(phi) - 10, 1))])


def point_masses(prior: Array, hulls: Ellipsoid, rng: np.random.Generator) -> PointMasses:
    """Points of every link, random in its hull, and nine of every rotor, with the prior's masses.

    Masses are as even as the prior's parameters allow.
    """
    places, masses = [], []
    for body in range(10):
        hull = Ellipsoid(hulls.center[body], hulls.semi_axes[body], hulls.rotation[body])
        place, mass = _points_of_link(prior[body], hull, rng)
        places.append(place)
        masses.append(mass)
    corners = np.vstack([np.zeros(3), *itertools.product((-1.0, 1.0), repeat=3)])
    for rotor in prior[10:]:
        spread = np.sqrt(9 / 8 * np.diagonal(pseudo_inertia(rotor))[:3] / rotor[0])
        places.append(corners * spread)
        masses.append(np.full(9, rotor[0] / 9))
    return PointMasses(tuple(places), tuple(masses))


def _points_of_link(phi: Array, hull: Ellipsoid, rng: np.random.Generator) -> tuple[Array, Array]:
    """Places (59, 3) and masses (59,) with the parameters φ (10,)."""
    frame = np.eye(4)
    frame[:3] = np.column_stack([hull.rotation * hull.semi_axes, hull.center])
    inverse = np.linalg.inv(frame)
    wanted = inverse @ pseudo_inertia(phi) @ inverse.T
    unit = Ellipsoid(np.zeros(3), np.ones(3), np.eye(3))
    for _ in range(POINT_TRIALS):
        local = unit.random_points(rng, (LINK_POINTS,))
        mass = even_masses(local, wanted)
        if mass is not None:
            return local @ frame[:3, :3].T + hull.center, mass
    # Too flat for points all over its hull: spread over the body itself.
    own = PointMasses.of_bodies(phi[None], LINK_POINTS)
    return own.positions[0], own.masses[0]


def even_masses(points: Array, wanted: Array) -> Array | None:
    """The most even masses of points (n, 3) with a pseudo inertia (4, 4); None if there are none.

    Those of greatest entropy are μ_j = exp(λ · f_j), with f_j the ten moments of point j, and λ
    minimizes the convex Σ μ_j − λ · φ.
    """
    lifted = np.column_stack([points, np.ones(len(points))])
    rows, columns = np.tril_indices(4)
    moments, phi = lifted[:, rows] * lifted[:, columns], wanted[rows, columns]
    multipliers = np.append(np.zeros(9), np.log(phi[-1] / len(points)))
    for _ in range(60):
        masses = np.exp(moments @ multipliers)
        error = moments.T @ masses - phi
        if np.abs(error).max() < 1e-13 * phi[-1]:
            return np.asarray(masses)
        hessian = (moments.T * masses) @ moments
        if np.linalg.cond(hessian) > 1e14:
            break
        step = np.linalg.solve(hessian, -error)
        multipliers = multipliers + step / max(1.0, float(np.abs(moments @ step).max()))
    return None
