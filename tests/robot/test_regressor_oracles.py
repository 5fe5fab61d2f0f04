"""The regressor against Pinocchio and MuJoCo on robots that people have."""

import mujoco
import numpy as np
import pytest
from known_robots import (
    ARMS,
    HUMANOIDS,
    PINOCCHIO_ORDER,
    assert_close,
    cases,
    description,
    moving_joints,
    plant_of,
    random_motion,
)
from mujoco_efforts import mujoco_efforts

from geodrake.inertia import inertial_parameters
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor


@pytest.mark.parametrize("name", cases(*ARMS, *HUMANOIDS))
def test_every_entry_is_pinocchios(name):
    pinocchio = pytest.importorskip("pinocchio")
    text = description(name)
    plant, model = plant_of(text), pinocchio.buildModelFromXML(text)
    data, (q, v, vd) = model.createData(), random_motion(plant, 5)
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


# MuJoCo refuses the last link of tx40, which has no mass.
@pytest.mark.parametrize("name", cases(*sorted({*ARMS} - {"reference/tx40.urdf"})))
def test_efforts_of_arms_are_mujocos(name):
    text = description(name)
    plant, model = plant_of(text), mujoco.MjModel.from_xml_string(text)
    motion, joints = random_motion(plant, 5), moving_joints(plant)
    efforts = inverse_dynamics(plant, *motion, inertial_parameters(plant))
    ours = [joint.velocity_start() for joint in joints]
    names = [joint.name() for joint in joints]
    assert_close(efforts[:, ours], mujoco_efforts(model, names, *(x[:, ours] for x in motion)))
