"""The studies of the Cheetah-like leg show what they claim to show."""

from pathlib import Path

import numpy as np

from diagrams.studies import cheetah_gallop as gallop
from diagrams.studies.cheetah import leg as cheetah
from geodrake.robot import base_parameters, base_wrench_regressor, inverse_dynamics, joint_names
from geodrake.robot.regressor import body_poses

MODELS = Path(__file__).parents[2] / "models"


def test_motion_of_a_leg_tells_32_combinations_and_its_base_wrench_more():
    """Of 60, geared rotors counted; on a fixed base the wrench is not measured."""
    leg = cheetah.load_leg(gallop.GEARS)
    time = np.linspace(0.0, 1.0 / gallop.STRIDE, 200, endpoint=False)
    motion = gallop.leg_motion(time, gallop.PHASES["front_left"])
    rows = leg.regressor(motion).reshape(-1, 60)
    assert base_parameters(rows).rank == 32
    base = base_wrench_regressor(leg.model.tree, motion.q, motion.v, motion.vd).reshape(-1, 60)
    assert base_parameters(np.vstack([rows, base])).rank > 32


def test_quantities_are_the_inverse_dynamics():
    """Of Drake's joints, rotors among them, which turn by the gear ratio."""
    robot, motion = gallop.whole_robot(), gallop.gallop(np.array([0.05, 0.31]))
    assert robot.joints[6:] == gallop.ACTUATORS
    quantities, plant = gallop.quantities(robot, motion), robot.plant
    change = np.random.default_rng(0).normal(size=(6, 10))
    names, order = list(robot.bodies), list(joint_names(plant))
    phi = np.zeros((25, 10))
    for name in gallop.LEGS:
        phi[[k for k, body in enumerate(names) if body.startswith(name)]] = change
    whole = np.zeros((3, 2, len(order)))
    for part, values in zip(whole, (motion.q, motion.v, motion.vd), strict=True):
        for k, name in enumerate(robot.joints):
            part[:, order.index(name)] = values[:, k]
        for name, gear in zip(gallop.ACTUATORS, 4 * gallop.GEARS, strict=True):
            part[:, order.index(f"{name}_rotor")] = gear * part[:, order.index(name)]
    efforts = inverse_dynamics(plant, *whole, phi)
    R_WB = body_poses(plant, whole[0])[:, names.index("trunk"), :3, :3]
    axes = np.broadcast_to(np.eye(3)[::-1], R_WB.shape).copy()  # of yaw, pitch and roll, here
    axes[:, 2] = R_WB[:, :, 0]
    moment = np.linalg.solve(axes, efforts[:, 3:6, None])[:, :, 0]
    for wrench, name in ((moment, "body moment"), (efforts[:, :3], "body force")):
        rows = quantities[name].rows @ change.ravel()
        local = np.einsum("nji,nj->ni", R_WB, wrench)
        np.testing.assert_allclose(rows.reshape(2, 3), local, atol=1e-8 * np.abs(efforts).max())
    # At a joint: the link's effort, and that of its rotor, geared.
    torque = (quantities["joint torque"].rows @ change.ravel()).reshape(2, 12)
    knee, rotor = order.index("rear_left_knee"), order.index("rear_left_knee_rotor")
    expected = efforts[:, knee] + gallop.GEARS[2] * efforts[:, rotor]
    np.testing.assert_allclose(torque[:, 8], expected, atol=1e-8 * np.abs(efforts).max())
