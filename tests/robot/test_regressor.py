"""Regressors of robots, also with a free base, and their identifiable parameters."""

import weakref
from pathlib import Path

import numpy as np
import pytest
from chain_logs import inverse_dynamics as drakes_efforts
from hypothesis import example, given, settings
from hypothesis import strategies as st
from known_robots import (
    ARMS,
    HUMANOIDS,
    PINOCCHIO_ORDER,
    assert_close,
    cases,
    description,
    efforts_on_a_free_base,
    moving_joints,
    plant_of,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint, SpatialInertia
from random_plants import (
    JOINTS,
    drake_slopes,
    random_body,
    random_motion,
    random_plant,
    random_tree,
)
from scipy.linalg import block_diag, solve_triangular
from scipy.spatial.transform import Rotation

from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import change_frame, inertial_parameters, pullback_metric
from geodrake.inertia.bodies import lumped_bodies
from geodrake.robot.base_parameters import (
    base_parameters,
    pushforward_metric,
    structural_base_parameters,
)
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import load_plant
from geodrake.robot.reduction import triangular_factor
from geodrake.robot.regressor import (
    base_wrench_regressor,
    body_poses,
    body_regressor,
    inverse_dynamics,
    inverse_dynamics_regressor,
    regressor_pieces,
    zero_moment_point,
)


def assert_slopes_are_drakes(plant, motion):
    found, expected = (
        effort_slopes(plant, *motion, inertial_parameters(plant)),
        drake_slopes(plant, *motion),
    )
    (nq, nv), scale = (x.shape[1] for x in motion[:2]), np.abs(expected).max(initial=0.0)
    for mobilizer in KinematicTree.from_plant(plant).mobilizers:
        at, own = mobilizer.positions.start, mobilizer.velocities
        for name, first in (("position", 0), ("velocity", nq), ("acceleration", nq + nv)):
            ours = getattr(found, name)[:, :, own]
            if own.stop - own.start > 1:
                assert np.isnan(ours).all()
            else:
                theirs = expected[:, :, [first + (own.start if first else at)]]
                np.testing.assert_allclose(ours, theirs, atol=1e-11 * scale)


def assert_equals_drake(plant, rng):
    motion = random_motion(plant, rng, 4)
    efforts = inverse_dynamics_regressor(plant, *motion) @ inertial_parameters(plant).ravel()
    expected = drakes_efforts(plant, *motion)
    scale = np.abs(expected).max(initial=0.0)
    np.testing.assert_allclose(efforts, expected, rtol=1e-10, atol=1e-10 * scale)
    assert_slopes_are_drakes(plant, [x[:3] for x in motion])
    poses, context = body_poses(plant, motion[0]), plant.CreateDefaultContext()
    for own, q in zip(poses, motion[0], strict=True):
        plant.SetPositions(context, q)
        for pose, body in zip(own, lumped_bodies(plant), strict=True):
            X_WB = plant.EvalBodyPoseInWorld(context, plant.get_body(body.body_index))
            np.testing.assert_allclose(pose, X_WB.GetAsMatrix4(), atol=1e-12)


@pytest.fixture(scope="module")
def arm():
    kinds = ("revolute", "universal", "weld", "prismatic", "ball")
    return random_plant(np.random.default_rng(4), kinds, chain=True)


@pytest.mark.parametrize("kind", sorted(set(JOINTS) - {"weld", "weld, reversed", "none"}))
def test_every_joint_type_inside_a_chain(kind):
    rng = np.random.default_rng(0)
    kinds = ["revolute", kind, "prismatic", "revolute"]
    assert_equals_drake(random_plant(rng, kinds, chain=True), rng)


@settings(max_examples=15)
@given(st.lists(st.sampled_from(sorted(JOINTS)), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_random_trees(kinds, seed):
    rng = np.random.default_rng(seed)
    assert_equals_drake(random_tree(rng, kinds), rng)


def test_other_forms_agree(arm):
    tree = KinematicTree.from_plant(arm)
    motion = random_motion(arm, np.random.default_rng(2), 2_300)
    whole, phi = inverse_dynamics_regressor(arm, *motion), inertial_parameters(arm)
    np.testing.assert_allclose(inverse_dynamics(tree, *motion, phi), whole @ phi.ravel(), atol=1e-9)
    for body in range(len(tree.bodies)):
        columns = whole[:, :, 10 * body : 10 * body + 10]
        np.testing.assert_array_equal(body_regressor(tree, *motion, body), columns)
    parts = [piece.copy() for _, piece in regressor_pieces(tree, *motion)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_gravity_can_be_off_for_a_whole_robot_but_not_for_a_part():
    rng = np.random.default_rng(6)

    def plant_of_two(joined):
        plant = MultibodyPlant(0.0)
        instances = [plant.AddModelInstance(name) for name in ("light", "heavy")]
        light, heavy = (random_body(plant, rng, "link", instance) for instance in instances)
        world = plant.world_body()
        plant.AddJoint(RevoluteJoint("a", world.body_frame(), light.body_frame(), [0, 1, 0]))
        base = light if joined else world
        plant.AddJoint(RevoluteJoint("b", base.body_frame(), heavy.body_frame(), [1, 0, 0]))
        plant.set_gravity_enabled(instances[0], False)
        plant.Finalize()
        return plant

    apart, still = plant_of_two(joined=False), np.zeros((1, 2))
    assert_equals_drake(apart, rng)
    wrench = base_wrench_regressor(apart, still, still, still) @ inertial_parameters(apart).ravel()
    heavy = apart.GetBodyByName("link", apart.GetModelInstanceByName("heavy"))
    np.testing.assert_allclose(wrench[0, 3:], [0, 0, 9.81 * heavy.default_mass()], atol=1e-12)
    with pytest.raises(ModelError, match="one part of a connected robot"):
        KinematicTree.from_plant(plant_of_two(joined=True))


def test_quaternions_of_any_length_mean_their_direction():
    rng = np.random.default_rng(8)
    plant = random_plant(rng, ["quaternion floating"])
    q, v, vd = random_motion(plant, rng, 5)
    scaled = q * np.r_[np.full(4, 3.0), np.ones(3)]
    np.testing.assert_allclose(
        inverse_dynamics_regressor(plant, scaled, v, vd),
        inverse_dynamics_regressor(plant, q, v, vd),
        rtol=1e-12,
        atol=1e-12,
    )


def test_the_tree_does_not_keep_the_plant():
    plant = random_plant(np.random.default_rng(0), ["revolute", "ball"])
    tree, gone = KinematicTree.from_plant(plant), weakref.ref(plant)
    del plant
    assert gone() is None
    assert tree.num_velocities == 4


def test_the_first_sample_that_is_not_finite_is_named(arm):
    q, v, vd = random_motion(arm, np.random.default_rng(0), 9)
    v[5, 1], v[7, 0] = np.nan, np.inf
    with pytest.raises(ArgumentError, match=r"has nan at \[5, 1\]") as caught:
        inverse_dynamics_regressor(arm, q, v, vd)
    assert caught.value.evidence["place"][0] == 5


def test_gravity_is_read_at_the_call():
    rng = np.random.default_rng(7)
    plant = random_plant(rng, ["revolute", "revolute"])
    assert_equals_drake(plant, rng)
    plant.mutable_gravity_field().set_gravity_vector([1.0, 2.0, 3.0])
    assert_equals_drake(plant, rng)


@pytest.mark.parametrize("name", cases(*ARMS, *HUMANOIDS))
def test_every_entry_is_pinocchios(name):
    pinocchio = pytest.importorskip("pinocchio")
    text = description(name)
    plant, model = plant_of(text), pinocchio.buildModelFromXML(text)
    motion = random_motion(plant, np.random.default_rng(0), 5)
    data, (q, v, vd) = model.createData(), motion
    joints = moving_joints(plant)
    drake = [joint.velocity_start() for joint in joints]
    ids = [model.getJointId(joint.name()) for joint in joints]
    pins = [model.joints[index].idx_v for index in ids]
    columns = [10 * (index - 1) + k for index in ids for k in PINOCCHIO_ORDER]
    bodies = np.argsort(np.argsort([int(joint.child_body().index()) for joint in joints]))
    ours = inverse_dynamics_regressor(plant, q, v, vd).reshape(5, len(joints), -1, 10)
    for i in range(5):
        state = tuple(np.zeros(model.nv) for _ in range(3))
        for theirs, sample in zip(state, (q, v, vd), strict=True):
            theirs[pins] = sample[i, drake]
        expected = pinocchio.computeJointTorqueRegressor(model, data, *state)[np.ix_(pins, columns)]
        assert_close(ours[i][drake][:, bodies].reshape(len(joints), -1), expected)


def test_small_singular_values_survive_where_the_gram_matrix_loses_them():
    rng = np.random.default_rng(1)
    left = np.linalg.qr(rng.normal(size=(5000, 20)))[0]
    right = np.linalg.qr(rng.normal(size=(20, 20)))[0]
    singular = np.logspace(0, -10, 20)
    matrix = left * singular @ right.T
    factor = triangular_factor(np.split(matrix, [3, 3, 2500, 4000]))
    assert factor.shape == (20, 20) and not np.tril(factor, -1).any()
    np.testing.assert_allclose(np.linalg.svd(factor, compute_uv=False), singular, rtol=1e-4)
    smallest = np.linalg.eigvalsh(matrix.T @ matrix)[0]
    assert abs(smallest / singular[-1] ** 2 - 1.0) > 1.0


moving = sorted(set(JOINTS) - {"weld", "weld, reversed"})


def wrench(plant, q, v, vd, **frame):
    return base_wrench_regressor(plant, q, v, vd, **frame) @ inertial_parameters(plant).ravel()


@pytest.mark.parametrize("name", cases(*HUMANOIDS))
def test_efforts_and_wrench_of_a_free_base_are_pinocchios(name):
    text = description(name)
    plant = plant_of(text, floating=True)
    q, v, vd = random_motion(plant, np.random.default_rng(1), 3)
    q[:, :4] /= np.linalg.norm(q[:, :4], axis=1, keepdims=True)
    (root,) = plant.GetFloatingBaseBodies()
    base = [body.body_index for body in lumped_bodies(plant)].index(root)
    ours = wrench(plant, q, v, vd, X_WP=body_poses(plant, q)[:, base])
    efforts = inverse_dynamics(plant, q, v, vd, inertial_parameters(plant))
    for i, (R, theirs, tau, at) in enumerate(efforts_on_a_free_base(text, plant, q, v, vd)):
        assert_close(ours[i], theirs)
        assert_close(efforts[i, at], tau)
        assert_close(efforts[i, :6], np.concatenate([R @ theirs[:3], R @ theirs[3:]]))


@settings(max_examples=15)
@given(st.lists(st.sampled_from(moving), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_wrench_is_the_rate_of_momentum_less_gravity(kinds, seed):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, kinds)
    q, v, vd = random_motion(plant, rng, 1)
    ours = wrench(plant, q, v, vd)[0]
    context, step = plant.CreateDefaultContext(), 1e-5

    def at(time):
        """Return momentum (n, f) about the world's origin, some time after the sample."""
        plant.SetPositions(context, q[0])
        qd = plant.MapVelocityToQDot(context, v[0] + 0.5 * time * vd[0])
        plant.SetPositions(context, q[0] + time * qd)
        # Second order in time: the velocity's map to q̇ changes on the way, too.
        middle = plant.MapVelocityToQDot(context, v[0] + 0.5 * time * vd[0])
        plant.SetPositions(context, q[0] + 0.5 * time * (qd + middle))
        plant.SetVelocities(context, v[0] + time * vd[0])
        momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
        return np.r_[momentum.rotational(), momentum.translational()]

    rate = (at(step) - at(-step)) / (2 * step)
    plant.SetPositions(context, q[0])
    weight = plant.CalcTotalMass(context) * plant.gravity_field().gravity_vector()
    com = plant.CalcCenterOfMassPositionInWorld(context)
    expected = rate - np.r_[np.cross(com, weight), weight]
    np.testing.assert_allclose(ours, expected, atol=2e-6 * np.abs(expected).max())


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(-1, 1))
def test_zero_moment_point_is_the_centre_of_pressure(seed, height):
    rng = np.random.default_rng(seed)
    points = np.c_[rng.uniform(-1, 1, (5, 2)), np.full(5, height)]
    forces = np.c_[rng.normal(size=(5, 2)), rng.uniform(0.1, 10, 5)]
    total = np.r_[np.cross(points, forces).sum(0), forces.sum(0)]
    expected = forces[:, 2] @ points[:, :2] / forces[:, 2].sum()
    np.testing.assert_allclose(zero_moment_point(total[None], height=height)[0], expected)


@pytest.mark.parametrize(
    "kinds", [["revolute"] * 4, ["prismatic", "revolute", "ball", "universal"]]
)
def test_base_wrench_tells_what_all_efforts_tell(kinds):
    """[Lee2019] Remark 3.1, for a tree with a floating base."""
    rng = np.random.default_rng(2)
    plant = random_plant(rng, ["rpy floating", *kinds], chain=True)
    motion = random_motion(plant, rng, 120)
    from_wrench = base_parameters(base_wrench_regressor(plant, *motion))
    everything = structural_base_parameters(plant)
    assert from_wrench.rank == everything.rank
    found = from_wrench.matrix  # the same combinations, of columns that may be others
    np.testing.assert_allclose(
        found[:, everything.independent] @ everything.matrix, found, atol=1e-9
    )


def test_a_force_plate_below_one_foot_tells_seven_parameters_a_joint():
    """Atlas on its left foot, as in [Lee2019] §4.6.3; its model there has a joint less."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(description("reference/atlas_v5.urdf"), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("l_foot"))
    plant.Finalize()
    motion = random_motion(plant, np.random.default_rng(0), 150)
    assert base_parameters(base_wrench_regressor(plant, *motion)).rank == 7 * 30


ROOT = Path(__file__).parents[2]


def serial(axes, *, slides=(), gravity=(0.0, 0.0, -9.81)):
    """Return a chain of joints about local axes, each 0.4 m along x from the previous one."""
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
def arm6():
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


def test_metric_is_the_shortest_change_of_the_parameters(arm6):
    base, phi = structural_base_parameters(arm6), inertial_parameters(arm6)
    H0, G0 = base.metric(phi), block_diag(*pullback_metric(phi))
    step = np.random.default_rng(0).normal(size=base.rank)
    # The least norm solution of B dφ = step, by coordinates in which G₀ is the identity.
    root = np.linalg.cholesky(G0)
    shortest = np.linalg.lstsq(np.linalg.solve(root, base.matrix.T).T, step)[0]
    assert step @ H0 @ step == pytest.approx(shortest @ shortest, rel=1e-8)


def test_base_parameters_reproduce_efforts_of_other_motions(arm6):
    base, phi = structural_base_parameters(arm6), inertial_parameters(arm6)
    regressor = random_regressor(arm6, 50, seed=9)
    expected = regressor @ phi.ravel()
    actual = base.regressor(regressor) @ base.values(phi)
    np.testing.assert_allclose(actual, expected, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(base.regressor(regressor) @ base.matrix, regressor, atol=1e-11)
    np.testing.assert_array_equal(base.matrix[:, base.independent], np.eye(base.rank))
