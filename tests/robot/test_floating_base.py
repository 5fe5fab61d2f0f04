"""Base wrenches against Pinocchio and rates of momentum, and what they tell."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_robots import (
    HUMANOIDS,
    assert_close,
    cases,
    description,
    efforts_on_a_free_base,
    plant_of,
)
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from random_plants import JOINTS, random_motion, random_plant

from geodrake.inertia import inertial_parameters
from geodrake.inertia.bodies import lumped_bodies
from geodrake.robot.base_parameters import base_parameters, structural_base_parameters
from geodrake.robot.regressor import (
    base_wrench_regressor,
    body_poses,
    inverse_dynamics,
    zero_moment_point,
)

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
        """Momentum (n, f) about the world's origin, moving on from the sample."""
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


def test_in_the_air_there_is_no_zero_moment_point():
    flying = np.array([[1.0, 2, 3, 0, 0, -1], [1.0, 2, 3, 0, 0, 0], [1.0, 2, 3, 0, 0, 5]])
    np.testing.assert_array_equal(
        np.isnan(zero_moment_point(flying)), [[True, True], [True, True], [False, False]]
    )
    # A sample that was not measured says nothing about the others.
    lost = np.vstack([flying[2:], np.full((1, 6), np.nan)])
    np.testing.assert_array_equal(np.isnan(zero_moment_point(lost)), [[False, False], [True, True]])


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
