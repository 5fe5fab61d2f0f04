"""Transmissions against differences, limits through them, and what is no transmission."""

import msgspec
import numpy as np
import pytest
from own_transmission import OwnTransmission
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia

from geodrake.errors import ArgumentError
from geodrake.logs.motion import Motion
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.transmission import (
    InSequence,
    LinearTransmission,
    SideBySide,
    gears,
    rolling_joint,
)
from geodrake.robot.transmission.statements import Drive, FourBarLinkage, LinearActuator


def random_motion(count=6, width=2, seed=0):
    q, v, vd = np.random.default_rng(seed).uniform(-2, 2, (3, count, width))
    return Motion(q, v, vd)


def crank(q):
    """A slider crank's angle and stroke, and a plain joint: 3 joints of 2 actuators."""
    a, b = q.T
    return np.stack([np.arcsin(0.4 * np.sin(a)), np.cos(a) + 0.3 * np.sin(a + b), b], -1)


def crank_jacobian(q):
    a, b = q.T
    J = np.zeros((len(q), 3, 2))
    J[:, 0, 0] = 0.4 * np.cos(a) / np.sqrt(1 - 0.16 * np.sin(a) ** 2)
    J[:, 1, 0] = -np.sin(a) + 0.3 * np.cos(a + b)
    J[:, 1, 1] = 0.3 * np.cos(a + b)
    J[:, 2, 1] = 1.0
    return J


CRANK = OwnTransmission((3, 2), crank, crank_jacobian)
BELTS = LinearTransmission.of([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.2, 0.0, 1.0]])
WRIST = LinearTransmission.of([[1.0, 0.0], [1.0, -1.0]], [0.1, -0.2])


@pytest.mark.parametrize(
    "part",
    [
        InSequence((gears([2.0, -3.0]), CRANK, BELTS)),
        SideBySide((InSequence((gears([7.0]), rolling_joint(0.3))), WRIST)),
    ],
)
def test_derivatives_are_differences_and_actuators_follow_from_the_joints(part):
    motion, step = random_motion(width=part.num_actuators), 1e-5
    q, v, J = motion.q, motion.v, part.jacobian(motion.q)
    assert J.shape == (6, part.num_joints, part.num_actuators)
    for i, direction in enumerate(np.eye(part.num_actuators)):
        ends = [part.joint_positions(q + h * direction) for h in (step, -step)]
        np.testing.assert_allclose(J[:, :, i], (ends[0] - ends[1]) / (2 * step), atol=1e-9)
    rate = (part.jacobian(q + step * v) - part.jacobian(q - step * v)) / (2 * step)
    np.testing.assert_allclose(part.jacobian_rate(q, v), rate, atol=1e-9)
    found = part.actuator_positions(part.joint_positions(q), start=q + 0.05)
    np.testing.assert_allclose(found, q, atol=1e-8)
    rows = np.random.default_rng(1).normal(size=(6, part.num_joints, 4))
    np.testing.assert_allclose(part.regressor(q, rows), np.einsum("nki,nkp->nip", J, rows))
    moved, h = part.joint_motion(motion), 1e-4
    before, here, after = (
        part.joint_positions(q + t * v + 0.5 * t**2 * motion.vd) for t in (-h, 0.0, h)
    )
    np.testing.assert_allclose(moved.v, (after - before) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(moved.vd, (after - 2 * here + before) / h**2, atol=1e-5)


BARS = FourBarLinkage(
    actuator="m", joint="j", ground=0.1, crank=0.04, coupler=0.09, rocker=0.06,
    crank_angle=1.2, rocker_angle=1.5,
)  # fmt: skip
CYLINDER = LinearActuator(actuator="m", joint="j", base=0.5, lever=0.4, length=0.5, angle=1.16)


def rocker_of(bars, q):
    """The rocker's angle by the law of cosines in the triangle of coupler, rocker and diagonal."""
    end = bars.crank * np.exp(1j * (q + bars.crank_angle)) - bars.ground
    sides = abs(end) ** 2 + bars.rocker**2 - bars.coupler**2
    bend = np.arccos(sides / (2 * bars.rocker * abs(end)))
    return np.angle(end) + (bend if bars.crossed else -bend) - bars.rocker_angle


def lever_of(cylinder, q):
    a, b = cylinder.base, cylinder.lever
    turned = np.arccos((a**2 + b**2 - (q + cylinder.length) ** 2) / (2 * a * b)) - cylinder.angle
    return -turned if cylinder.reversed else turned


@pytest.mark.parametrize(
    ("part", "angle", "reach"),
    [
        (BARS, rocker_of, 9.0),
        (msgspec.structs.replace(BARS, crossed=True), rocker_of, 9.0),
        (msgspec.structs.replace(BARS, crank=0.08, crank_angle=0.9), rocker_of, 0.6),
        (CYLINDER, lever_of, 0.39),
        (msgspec.structs.replace(CYLINDER, reversed=True), lever_of, 0.39),
    ],
)
def test_linkages_are_those_of_the_law_of_cosines(part, angle, reach):
    """A crank that goes around goes on through several turns, joint and all."""
    q, found = np.linspace(-reach, reach, 401)[:, None], Drive.of(part).map
    theta, J, rate = found.along(q, np.ones_like(q))
    turns = (theta[:, 0] - angle(part, q[:, 0])) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    assert np.abs(np.diff(theta[:, 0])).max() < 0.3
    slope = (angle(part, q + 1e-6) - angle(part, q - 1e-6)) / 2e-6
    np.testing.assert_allclose(J[:, 0], slope, atol=1e-6)
    bend = (found.jacobian(q + 1e-5) - found.jacobian(q - 1e-5)) / 2e-5
    np.testing.assert_allclose(rate, bend, rtol=1e-5, atol=1e-5)
    low, high = found.range
    assert low[0] <= -reach and high[0] >= reach


def test_linkages_say_where_they_do_not_close():
    assert np.abs(np.ravel(Drive.of(CYLINDER).map.range) - [-0.4, 0.4]).max() < 1e-3
    with pytest.raises(ArgumentError, match=r"loop of the cylinder m does not close at m = 0\.45"):
        Drive.of(CYLINDER).map.joint_positions(np.array([[0.45]]))
    with pytest.raises(ArgumentError, match="do not reach each other at q = 0 with the crank at 3"):
        Drive.of(msgspec.structs.replace(BARS, ground=0.2, crank_angle=3.0))


def test_a_joint_that_an_actuator_does_not_move_does_not_limit_it():
    """Without a warning, although 0 · ∞ is no number."""
    idle = Drive(("m",), ("a", "b"), LinearTransmission.of([[2.0], [0.0]]))
    plant = MultibodyPlant(0.0)
    for name, axis in (("a", [1, 0, 0]), ("b", [0, 1, 0])):
        body = plant.AddRigidBody(name, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        world = plant.world_frame()
        plant.AddJoint(PrismaticJoint(name, world, body.body_frame(), axis))
    plant.Finalize()
    robot = RobotCoordinates.of(plant, (), (idle,))
    within = np.full(1, -1.0), np.full(1, 1.0)
    most = np.array([5.0, np.inf])
    np.testing.assert_array_equal(robot.effort_limits(most, within), [10.0])
    np.testing.assert_array_equal(robot.rates(most, within), [2.5])
    np.testing.assert_array_equal(robot.rates(np.zeros(2), within), [0.0])


def test_bad_input():
    with pytest.raises(ArgumentError, match=r"'knees' is none of knee, hip"):
        LinearTransmission.from_ratios(["knee", "hip"], ["m"], {"knees": {"m": 1.0}})
    with pytest.raises(ArgumentError, match="rank n"):
        LinearTransmission.of([[1.0, 1.0], [2.0, 2.0]])
    with pytest.raises(ArgumentError, match="must not be zero"):
        gears([1.0, 0.0])
    with pytest.raises(ArgumentError, match="from 0 to 1"):
        rolling_joint(1.5)
    with pytest.raises(ArgumentError, match="but the next one 2"):
        InSequence((rolling_joint(), CRANK, WRIST))
    with pytest.raises(ArgumentError, match="actuators cannot reach"):
        rolling_joint().actuator_positions(np.array([[1.0, -1.0]]))
    with pytest.raises(ArgumentError, match=r"initial guess must have shape \(2,\)"):
        WRIST.actuator_positions(np.zeros((1, 2)), start=[1.0, 2.0, 3.0])
    for nothing in (SideBySide, InSequence):
        with pytest.raises(ArgumentError, match="at least one"):
            nothing(())
