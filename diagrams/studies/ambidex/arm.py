"""The arm of the AMBIDEX study, and measurements of its random point-to-point motions.

    τ = Jᵀ Γ(θ, θ̇, θ̈) Φ + diag(q̈) I_r + diag(sign q̇) f_c + diag(q̇) f_v     [Lee2019] Eq. (3.6.57)

Each rotor is also a body. As it is balanced and its axis fixed, only I_zz = I_r shows. Regularizers
treat it like a link; 59 points a link and 9 a rotor are the source's 653 point masses.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from scipy.signal import savgol_filter

from diagrams.harness import MODELS
from geodrake.identification import PointMasses
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    Array,
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
    rolling_joint,
)
from geodrake.robot.plant import load_plant
from geodrake.robot.reduction import triangular_factor

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
    """The arm, as measurements are simulated with it."""

    plant: MultibodyPlant
    transmission: Transmission
    phi: Array  # (17, 10) inertial parameters of the links and then the rotors

    @classmethod
    def load(cls) -> Arm:
        """Return the arm of the model file, with this study's rotors."""
        plant = load_plant(MODEL).plant
        rotor = np.diag([0.6, 0.6, 1.0]) * ROTOR_INERTIA[:, None, None]
        rotors = from_mass_com_inertia(np.full(7, ROTOR_MASS), np.zeros((7, 3)), rotor)
        phi = np.vstack([inertial_parameters(plant), rotors])
        return cls(plant, transmission(), phi)

    def motors(self, turns: Array) -> Array:
        """Return motor positions (..., 7) for the turns (..., 7) of the arm, rad."""
        wrist = turns[..., 5:] @ np.array([[1.0, 1.0], [1.0, -1.0]])
        return REDUCTION * np.concatenate([turns[..., :5], wrist], axis=-1)

    def regressor(self, motion: Motion) -> Array:
        """Return (N, 7, 170) columns of links and rotors for motor torques."""
        joints = self.transmission.joint_motion(motion)
        links = inverse_dynamics_regressor(self.plant, joints.q, joints.v, joints.vd)
        rotors = np.zeros((len(motion.q), 7, 7, PARAMETERS_PER_BODY))
        motor = np.arange(7)
        rotors[:, motor, motor, 6] = motion.vd
        links = self.transmission.regressor(motion.q, links)
        return np.concatenate([links, rotors.reshape(len(links), 7, -1)], axis=2)

    def wrench_regressor(self, motion: Motion) -> Array:
        """Return (N, 6, 100) columns of the links for the wrench about the world's origin."""
        joints = self.transmission.joint_motion(motion)
        return base_wrench_regressor(self.plant, joints.q, joints.v, joints.vd)


def transmission() -> Transmission:
    """Return shoulder, rolling elbow, forearm, and two rolling joints that two motors share."""
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
    """Return (N, 7, 14) columns of Coulomb and viscous friction for motor velocities (N, 7)."""
    columns = np.zeros((len(v), 7, 14))
    motor = np.arange(7)
    columns[:, motor, motor], columns[:, motor, 7 + motor] = np.sign(v), v
    return columns


def perturbed(phi: Array, rng: np.random.Generator, delta: float) -> Array:
    """Return wrong bodies (17, 10), as without measurements of the arm.

    Ten point masses in and around every link are added or removed, at most a share δ of its mass
    in all ([Lee2019] Eq. (B.2.11)); a rotor, of which one number counts, is scaled by 1 ± δ.
    """
    support = equivalent_ellipsoid(phi[:10]).scaled(SUPPORT)
    links = perturb(phi[:10], 1, rng=rng, mass_uncertainty=delta, support=support).phi[0]
    return np.vstack([links, phi[10:] * rng.uniform(1 - delta, 1 + delta, (len(phi) - 10, 1))])


def point_masses(prior: Array, hulls: Ellipsoid, rng: np.random.Generator) -> PointMasses:
    """Return random points of every link in its hull, nine of every rotor, and their masses.

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
    """Return places (59, 3) and masses (59,) with the parameters φ (10,)."""
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
    """Return the most even masses of points (n, 3) with a pseudo inertia (4, 4), if any.

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


MOTIONS, DURATION, PERIOD = 47, 1.3, 0.01  # s
TRAINING, TESTING = 4100, 2000  # samples
TORQUE_NOISE = 0.005  # N·m, of a motor
UNEVEN = 0.5  # share of Coulomb friction, RMS, that depends on the position
WAVES = 4.0  # of that friction in a turn of the arm
ENCODER_NOISE = 1e-3  # rad, of a motor
WINDOW, ORDER = 35, 5  # of the Savitzky-Golay filter
LINKS = 100  # columns of the links


@dataclass(frozen=True, eq=False)
class Measurements:
    """Arrays for fits and their tests, without objects of Drake."""

    bodies: Array  # (N, 7, 170) regressor of links and rotors, of the training samples
    friction: Array  # (N, 7, 14) regressor of friction
    torque: Array  # (N, 7) motor torques as measured, N·m
    full: Array  # triangular factor of [bodies | friction | torque]
    test: Array  # triangular factor of the same of the test samples, whose torque is filtered
    test_rows: int  # number of its rows before
    wrench: Array  # (T, 6, 100) regressor of the wrench on the ground, of every fifth test sample
    truth: Array  # (17, 10) the parameters behind the measurements
    hulls: Array  # (17, 4, 4) matrices Q of ellipsoids that hold all mass of a body

    def test_rms(self, phi: Array, friction: Array) -> float:
        """Return RMS error of the motor torques of the test samples, N·m."""
        x = np.concatenate([phi.ravel(), friction, [-1.0]])
        return float(np.linalg.norm(self.test @ x) / np.sqrt(self.test_rows))

    def wrenches(self, phi: Array) -> Array:
        """Return (T, 6) wrenches on the ground."""
        return self.wrench @ phi.ravel()[:LINKS]


def point_to_point(arm: Arm, rng: np.random.Generator) -> Motion:
    """Return 47 motor motions of 1.3 s at 100 Hz of least jerk, one after another."""
    ends = arm.motors(rng.uniform(-REACH, REACH, (MOTIONS + 1, 7)))
    count = round(DURATION / PERIOD)
    s = np.arange(count) / count
    share = np.stack([10 * s**3 - 15 * s**4 + 6 * s**5, 30 * (s - s * s) ** 2])
    curve = 60 * s * (1 - s) * (1 - 2 * s)
    way = np.diff(ends, axis=0)[:, None]
    q = ends[:-1, None] + share[0][:, None] * way
    v = share[1][:, None] * way / DURATION
    vd = curve[:, None] * way / DURATION**2
    return Motion(*(x.reshape(-1, 7) for x in (q, v, vd)))


def uneven_friction(motion: Motion, rng: np.random.Generator) -> Array:
    """Return friction (N, 7) by position, which no parameter explains, as the source found.

    At full data it makes up most of the test error, 0.012 N·m there and here.
    """
    turn = WAVES * motion.q / REDUCTION + rng.uniform(0.0, 2.0 * np.pi, 7)
    return np.sqrt(2.0) * UNEVEN * COULOMB * np.sin(turn) * np.sign(motion.v)


def smoothed(position: Array) -> Motion:
    """Return the motion of measured positions, filtered, then differentiated, as in the source."""
    q = savgol_filter(position, WINDOW, ORDER, axis=0)
    v = savgol_filter(position, WINDOW, ORDER, deriv=1, delta=PERIOD, axis=0)
    return Motion(q, v, np.gradient(v, PERIOD, axis=0))


def measure(arm: Arm, *, seed: int, hull: float) -> Measurements:
    """Return simulated measurements: exact motions, with noise of torques and encoders.

    Hulls are equivalent uniform ellipsoids of the bodies with `hull` times the semi-axes.
    """
    rng = np.random.default_rng([seed, 0])
    motion = point_to_point(arm, rng)
    friction = friction_regressor(motion.v) @ np.concatenate([COULOMB, VISCOUS])
    torque = arm.regressor(motion) @ arm.phi.ravel() + friction
    torque = torque + uneven_friction(motion, rng) + rng.normal(0.0, TORQUE_NOISE, torque.shape)
    seen = smoothed(motion.q + rng.normal(0.0, ENCODER_NOISE, motion.q.shape))
    bodies, friction = arm.regressor(seen), friction_regressor(seen.v)
    first, last = slice(0, TRAINING), slice(-TESTING, None)
    quiet = savgol_filter(torque[last], WINDOW, ORDER, axis=0)
    every = Motion(*(x[last][::5] for x in (seen.q, seen.v, seen.vd)))
    return Measurements(
        bodies=bodies[first],
        friction=friction[first],
        torque=torque[first],
        full=factor_of(bodies[first], friction[first], torque[first]),
        test=factor_of(bodies[last], friction[last], quiet),
        test_rows=quiet.size,
        wrench=arm.wrench_regressor(every),
        truth=arm.phi,
        hulls=equivalent_ellipsoid(arm.phi).scaled(hull).quadric,
    )


def factor_of(*columns: Array) -> Array:
    """Return the triangular factor of rows with blocks of columns (N, 7, n), the last (N, 7).

    Columns of zeros, which no motion excites, stay out of the factorization.
    """
    rows = np.concatenate([*columns[:-1], columns[-1][..., None]], axis=2)
    rows = rows.reshape(-1, rows.shape[2])
    seen = np.flatnonzero(rows.any(axis=0))
    factor = np.zeros((len(seen), rows.shape[1]))
    factor[:, seen] = triangular_factor([rows[:, seen]])
    return factor
