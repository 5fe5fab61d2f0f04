"""Slopes of efforts: against Drake's AutoDiff on random trees."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
from pydrake.multibody.tree import MultibodyForces_
from random_plants import JOINTS, random_motion, random_plant, random_tree

from geodrake.inertia import inertial_parameters
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.kinematics import KinematicTree

NAMES = ("position", "velocity", "acceleration")


def drake_slopes(plant, q, v, vd):
    """(N, nv, nq + 2 nv) derivatives of the effort."""
    smooth = plant.ToAutoDiffXd()
    context, forces = smooth.CreateDefaultContext(), MultibodyForces_[AutoDiffXd](smooth)
    nq, nv = q.shape[1], v.shape[1]
    slopes = np.empty((len(q), nv, nq + 2 * nv))
    for i in range(len(q)):
        x = InitializeAutoDiff(np.concatenate([q[i], v[i], vd[i]])).ravel()
        smooth.SetPositions(context, x[:nq])
        smooth.SetVelocities(context, x[nq : nq + nv])
        effort = smooth.CalcInverseDynamics(context, x[nq + nv :], forces)
        slopes[i] = ExtractGradient(effort - smooth.CalcGravityGeneralizedForces(context))
    return slopes


def assert_equals_drake(plant, rng, count=3):
    tree, motion = KinematicTree.from_plant(plant), random_motion(plant, rng, count)
    found = effort_slopes(plant, *motion, inertial_parameters(plant))
    expected = drake_slopes(plant, *motion)
    (nq, nv), scale = (x.shape[1] for x in motion[:2]), np.abs(expected).max(initial=0.0)
    for mobilizer in tree.mobilizers:
        own = mobilizer.velocities
        if own.stop - own.start > 1:
            for name in NAMES:
                assert np.isnan(getattr(found, name)[:, :, own]).all()
            continue
        places = (mobilizer.positions.start, nq + own.start, nq + nv + own.start)
        for name, place in zip(NAMES, places, strict=True):
            np.testing.assert_allclose(
                getattr(found, name)[:, :, own.start], expected[:, :, place], atol=1e-11 * scale
            )


@pytest.mark.parametrize("kind", sorted(set(JOINTS) - {"weld", "weld, reversed"}))
def test_every_joint_type_alone_and_inside_a_chain(kind):
    rng = np.random.default_rng(0)
    assert_equals_drake(random_plant(rng, [kind]), rng)
    if kind != "none":
        kinds = ["revolute", kind, "prismatic", "revolute"]
        assert_equals_drake(random_plant(rng, kinds, chain=True), rng)


@settings(max_examples=40)
@given(st.lists(st.sampled_from(sorted(JOINTS)), min_size=1, max_size=7), st.integers(0, 2**32 - 1))
def test_random_trees(kinds, seed):
    rng = np.random.default_rng(seed)
    assert_equals_drake(random_tree(rng, kinds), rng)
