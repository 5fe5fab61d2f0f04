"""Base parameters against known numbers, a second basis, and changes of frame, unit and basis."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint, SpatialInertia
from scipy.linalg import block_diag, solve_triangular
from scipy.spatial.transform import Rotation

from geodrake.inertia import change_frame, inertial_parameters, pullback_metric
from geodrake.robot.base_parameters import (
    base_parameters,
    pushforward_metric,
    structural_base_parameters,
)
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import load_plant
from geodrake.robot.regressor import inverse_dynamics_regressor

ROOT = Path(__file__).parents[2]


def serial(axes, *, slides=(), gravity=(0.0, 0.0, -9.81)):
    """A chain of joints about local axes, each 0.4 m along x from the one before."""
    plant, last = MultibodyPlant(0.0), None
    for i, axis in enumerate(axes):
        body = plant.AddRigidBody(f"link{i}", SpatialInertia.SolidBoxWithMass(1, 0.2, 0.1, 0.3))
        P = plant.world_body() if last is None else last
        kind = PrismaticJoint if i in slides else RevoluteJoint
        X_PF = RigidTransform([0.0 if last is None else 0.4, 0, 0])
        frame_F = plant.AddFrame(FixedOffsetFrame(f"F{i}", P.body_frame(), X_PF))
        plant.AddJoint(kind(f"joint{i}", frame_F, body.body_frame(), axis))
        last = body
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    return plant


def random_regressor(plant, count, seed=0):
    random, nv = np.random.default_rng(seed), plant.num_velocities()
    q, v, vd = (random.uniform(-2, 2, (count, n)) for n in (plant.num_positions(), nv, nv))
    return inverse_dynamics_regressor(plant, q, v, vd)


@pytest.fixture(scope="module")
def arm():
    return load_plant(ROOT / "models" / "arm6.urdf").plant


@pytest.mark.parametrize(
    ("plant", "rank"),
    [
        (lambda: serial([[0, 0, 1]], gravity=(0, 0, -9.81)), 1),  # Izz
        (lambda: serial([[0, 0, 1]], gravity=(0, -9.81, 0)), 3),  # and hx, hy
        (lambda: serial([[0, 0, 1]] * 2, gravity=(0, 0, -9.81)), 4),  # Izz each, hx and hy of 2
        (lambda: serial([[0, 0, 1]] * 2, gravity=(0, -9.81, 0)), 6),  # and hx, hy of 1
        (lambda: serial([[1, 0, 0]], slides={0}), 1),  # a mass
        (lambda: serial([[1, 0, 0], [0, 0, 1]], slides={0}, gravity=(0, -9.81, 0)), 4),
        (lambda: load_plant(ROOT / "models" / "arm6.urdf").plant, 36),
        (lambda: load_plant(ROOT / "models" / "arm7.urdf").plant, 43),
        (lambda: load_plant(ROOT / "models" / "arm7.urdf", floating=True).plant, 10 + 7 * 7),
    ],
)
def test_known_ranks(plant, rank):
    assert structural_base_parameters(plant()).rank == rank


def test_two_links_in_words():
    plant = serial([[0, 0, 1]] * 2, gravity=(0, -9.81, 0))
    base = structural_base_parameters(plant)
    assert base.labels(["upper", "lower"]) == (
        "hx of upper + 0.4 m of lower",
        "hy of upper",
        "Izz of upper + 0.16 m of lower",
        "hx of lower",
        "hy of lower",
        "Izz of lower",
    )
    assert base.unseen == (0, 3, 4, 5, 7, 8, 9, 13, 14, 15, 17, 18, 19)


def test_further_columns_are_base_parameters_of_their_own(arm):
    random = np.random.default_rng(1)
    q, v, vd = random.uniform(-2, 2, (3, 80, 6))
    friction = 1e-6 * v[:, :, None] * np.eye(6)  # in a tiny unit
    columns = np.concatenate([inverse_dynamics_regressor(arm, q, v, vd), friction], -1)
    base = base_parameters(columns, extra=6)
    assert base.rank == 42
    assert set(range(60, 66)) <= set(base.independent)
    names = base.labels(KinematicTree.from_plant(arm).bodies, extra=[f"c{i}" for i in range(6)])
    assert names[-6:] == ("c0", "c1", "c2", "c3", "c4", "c5")


frames = st.integers(0, 2**32 - 1)


@settings(max_examples=8)
@given(frames, st.sampled_from([1e-3, 1.0, 1e3]))
@example(10**9, 1e-3)  # an axis of the last body is nearly at right angles to its joint's
def test_rank_and_criterion_do_not_depend_on_frames_units_and_basis(seed, unit):
    plant = serial([[0, 0, 1], [0, 1, 0], [0, 1, 0]])
    random, phi = np.random.default_rng(seed), inertial_parameters(plant)
    A = random_regressor(plant, 40).reshape(-1, 30)
    blocks, inverses = [], []
    length = unit ** np.r_[0, 1, 1, 1, np.full(6, 2.0)]
    for _ in range(3):  # φ in other frames and another unit of length, body by body
        R, p = Rotation.random(random_state=int(random.integers(1e6))), random.uniform(-0.3, 0.3, 3)
        moved = change_frame(np.eye(10), R.as_matrix(), p).T
        blocks.append(length[:, None] * moved)
        inverses.append(np.linalg.inv(moved) / length)
    other_phi = np.array([block @ row for block, row in zip(blocks, phi, strict=True)])
    other_A = A @ block_diag(*inverses)
    base, other = base_parameters(A), base_parameters(other_A)
    assert base.rank == other.rank

    def criterion(base, A, phi, S):
        """Eigenvalues of A_Bᵀ A_B H₀⁻¹, [Lee2019] Eq. (4.3.38)."""
        B, A_B = S @ base.matrix, base.regressor(A) @ np.linalg.inv(S)
        root = np.linalg.cholesky(pushforward_metric(B, phi))
        return np.linalg.svd(solve_triangular(root, A_B.T, lower=True), compute_uv=False) ** 2

    turn = np.linalg.qr(random.normal(size=(base.rank, base.rank)))[0]
    S = random.uniform(0.3, 3.0, (base.rank, 1)) * turn
    here = criterion(base, A, phi, np.eye(base.rank))
    there = criterion(other, other_A, other_phi, np.eye(base.rank))
    np.testing.assert_allclose(there, here, rtol=1e-7)
    np.testing.assert_allclose(criterion(base, A, phi, S), here, rtol=1e-7)
    # The nonzero eigenvalues of Aᵀ A G₀⁻¹, [Lee2019] Eq. (4.3.39).
    root = np.linalg.cholesky(block_diag(*pullback_metric(phi)))
    full = np.linalg.svd(np.linalg.solve(root, A.T), compute_uv=False)[: base.rank] ** 2
    np.testing.assert_allclose(here, full, rtol=1e-7)


def test_metric_is_the_shortest_change_of_the_parameters(arm):
    base, phi = structural_base_parameters(arm), inertial_parameters(arm)
    H0, G0 = base.metric(phi), block_diag(*pullback_metric(phi))
    step = np.random.default_rng(0).normal(size=base.rank)
    # The least norm solution of B dφ = step, by coordinates in which G₀ is the identity.
    root = np.linalg.cholesky(G0)
    shortest = np.linalg.lstsq(np.linalg.solve(root, base.matrix.T).T, step)[0]
    assert step @ H0 @ step == pytest.approx(shortest @ shortest, rel=1e-8)


def test_base_parameters_reproduce_efforts_of_other_motions(arm):
    base, phi = structural_base_parameters(arm), inertial_parameters(arm)
    regressor = random_regressor(arm, 50, seed=9)
    expected = regressor @ phi.ravel()
    actual = base.regressor(regressor) @ base.values(phi)
    np.testing.assert_allclose(actual, expected, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(base.regressor(regressor) @ base.matrix, regressor, atol=1e-11)
    np.testing.assert_array_equal(base.matrix[:, base.independent], np.eye(base.rank))
