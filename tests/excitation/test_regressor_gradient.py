"""Gradients of regressors: against finite differences, and Drake's AutoDiff of inverse dynamics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw
from random_plants import JOINTS, drake_slopes, random_motion, random_plant, random_tree

from geodrake.excitation.regressor_gradient import (
    base_wrench_regressor_gradient,
    inverse_dynamics_regressor_gradient,
)
from geodrake.inertia import inertial_parameters
from geodrake.robot import KinematicTree, base_wrench_regressor, inverse_dynamics_regressor

NAMES = ("q", "v", "vd")


def differences(function, motion, step=1e-4):
    """Fourth-order differences of (N, ...) values that depend on their own sample only."""
    found = []
    for which in range(3):
        columns = []
        for column in range(motion[which].shape[1]):

            def moved(by, which=which, column=column):
                changed = [x.copy() for x in motion]
                changed[which][:, column] += by
                return function(*changed)

            near, far = moved(step) - moved(-step), moved(2 * step) - moved(-2 * step)
            columns.append((8 * near - far) / (12 * step))
        found.append(np.stack([*columns, function(*motion)], -1)[..., :-1])  # of none, too
    return found


def assert_gradient(gradient, expected):
    for name, values in zip(NAMES, expected, strict=True):
        scale = np.abs(values).max(initial=0.0) + 1.0
        np.testing.assert_allclose(getattr(gradient, name), values, rtol=0, atol=2e-9 * scale)


def assert_equals_differences(plant, rng):
    tree, motion = KinematicTree.from_plant(plant), random_motion(plant, rng, 3)
    weights = rng.normal(size=(3, plant.num_velocities(), 10 * len(tree.bodies)))

    def value(*motion):
        return np.einsum("nij,nij->n", weights, inverse_dynamics_regressor(tree, *motion))

    gradient = inverse_dynamics_regressor_gradient(plant, *motion, weights)
    assert_gradient(gradient, differences(value, motion))


def test_a_chain_of_every_joint_type():
    rng = np.random.default_rng(0)
    kinds = ("revolute", *sorted(set(JOINTS) - {"none"}), "revolute")
    assert_equals_differences(random_plant(rng, kinds, chain=True), rng)


@settings(max_examples=12)
@given(st.lists(st.sampled_from(sorted(JOINTS)), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_random_trees(kinds, seed):
    rng = np.random.default_rng(seed)
    assert_equals_differences(random_tree(rng, kinds), rng)


def test_drake_autodiff_of_efforts():
    """With W = λ φᵀ the gradient is that of λᵀ τ, which Drake differentiates by itself."""
    rng = np.random.default_rng(1)
    plant = random_plant(rng, ("revolute", "universal", "weld", "prismatic", "screw", "planar"))
    q, v, vd = random_motion(plant, rng, 5)
    phi, weights = inertial_parameters(plant).ravel(), rng.normal(size=v.shape)
    gradient = inverse_dynamics_regressor_gradient(
        plant, q, v, vd, weights[:, :, None] * phi[None, None]
    )
    for i, slopes in enumerate(drake_slopes(plant, q, v, vd)):
        expected = weights[i] @ slopes
        found = np.concatenate([gradient.q[i], gradient.v[i], gradient.vd[i]])
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("base", ["revolute", "quaternion floating"])
def test_base_wrench(base):
    rng = np.random.default_rng(2)
    plant = random_plant(rng, (base, "prismatic", "ball", "revolute", "weld", "universal"))
    tree, motion = KinematicTree.from_plant(plant), random_motion(plant, rng, 4)
    weights = rng.normal(size=(4, 6, 10 * len(tree.bodies)))
    poses = [RigidTransform(RollPitchYaw(rng.normal(size=3)), rng.normal(size=3)) for _ in "1234"]
    for X_WP in (None, poses[0], np.stack([X.GetAsMatrix4() for X in poses])):

        def value(*motion, X_WP=X_WP):
            return np.einsum("nij,nij->n", weights, base_wrench_regressor(tree, *motion, X_WP=X_WP))

        gradient = base_wrench_regressor_gradient(plant, *motion, weights, X_WP=X_WP)
        assert_gradient(gradient, differences(value, motion))
