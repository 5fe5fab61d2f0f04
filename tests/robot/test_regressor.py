"""Regressors, slopes and poses against Drake on random trees, and others on known robots."""

import weakref

import numpy as np
import pytest
from chain_logs import inverse_dynamics as drakes_efforts
from hypothesis import given, settings
from hypothesis import strategies as st
from known_robots import (
    ARMS,
    HUMANOIDS,
    PINOCCHIO_ORDER,
    assert_close,
    cases,
    description,
    moving_joints,
    plant_of,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint
from random_plants import (
    JOINTS,
    drake_slopes,
    random_body,
    random_motion,
    random_plant,
    random_tree,
)

from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import inertial_parameters
from geodrake.inertia.bodies import lumped_bodies
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.reduction import triangular_factor
from geodrake.robot.regressor import (
    base_wrench_regressor,
    body_poses,
    body_regressor,
    inverse_dynamics,
    inverse_dynamics_regressor,
    regressor_pieces,
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
