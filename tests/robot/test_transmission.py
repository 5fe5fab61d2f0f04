"""Transmissions against Drake's gears and couplers, Pinocchio's mimic joints, and differences."""

import numpy as np
import pytest
from own_transmission import OwnTransmission
from pydrake.math import RigidTransform
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator

from geodrake.errors import ArgumentError
from geodrake.inertia import inertial_parameters
from geodrake.logs.motion import Motion
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.plant import joint_names
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor
from geodrake.robot.transmission import Drive, LinearTransmission
from geodrake.robot.transmission.base import InSequence, SideBySide, gears, rolling_joint

RATIO = 10.6
SPIN = 0.003  # kg·m², of a rotor about its axis


def rotor_inertia(mass=0.5):
    unit = UnitInertia(*(np.array([0.6, 1.0, 0.6]) * SPIN / mass))
    return SpatialInertia(mass, np.zeros(3), unit)


def arm(*, rotors, time_step=0.0, gear_in_drake=False):
    """Two links in a vertical plane; rotor 1 on the world, rotor 2 on the first link."""
    plant = MultibodyPlant(time_step)
    if time_step:
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    links = []
    for i in range(2):
        link = SpatialInertia.SolidBoxWithMass(1.0 + i, 0.4, 0.05, 0.1)
        link = SpatialInertia.MakeFromCentralInertia(
            link.get_mass(), [0.2, 0.01, 0.03], (1.0 + i) * UnitInertia.SolidBox(0.4, 0.05, 0.1)
        )
        links.append(plant.AddRigidBody(f"link{i}", link))
    base = plant.world_frame()
    elbow = plant.AddFrame(
        FixedOffsetFrame("elbow", links[0].body_frame(), RigidTransform([0.4, 0, 0]))
    )
    joints = [
        plant.AddJoint(RevoluteJoint(f"joint{i}", frame, links[i].body_frame(), [0, 1, 0]))
        for i, frame in enumerate((base, elbow))
    ]
    if rotors:
        for i, frame in enumerate((base, elbow)):
            rotor = plant.AddRigidBody(f"rotor{i}", rotor_inertia())
            plant.AddJoint(RevoluteJoint(f"spin{i}", frame, rotor.body_frame(), [0, 1, 0]))
    for joint in joints if not rotors else []:
        actuator = plant.AddJointActuator(joint.name(), joint)
        if gear_in_drake:
            actuator.set_default_rotor_inertia(SPIN)
            actuator.set_default_gear_ratio(RATIO)
    return plant


def spinning(plant):
    """Joints turn with q, rotors by the ratio."""
    ratios = {f"joint{i}": {f"q{i}": 1.0} for i in range(2)}
    ratios |= {f"spin{i}": {f"q{i}": RATIO} for i in range(2)}
    return LinearTransmission.from_ratios(joint_names(plant), ["q0", "q1"], ratios)


def random_motion(count=6, width=2, seed=0):
    q, v, vd = np.random.default_rng(seed).uniform(-2, 2, (3, count, width))
    return Motion(q, v, vd)


def actuator_efforts(plant, transmission, motion):
    moved = transmission.joint_motion(motion)
    regressor = inverse_dynamics_regressor(plant, moved.q, moved.v, moved.vd)
    return transmission.regressor(motion.q, regressor) @ inertial_parameters(plant).ravel()


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
WRIST = LinearTransmission.of([[1.0, 0.0], [1.0, -1.0]], [0.1, -0.2])
PARTS = {
    "linear": WRIST,
    "crank": CRANK,
    "gears": gears([30.0, -10.0]),
    "rolling": rolling_joint(0.3),
    "side by side": SideBySide((CRANK, rolling_joint(), WRIST)),
    "in sequence": InSequence((gears([2.0, -3.0]), WRIST, CRANK)),
    "both": SideBySide((InSequence((WRIST, CRANK)), InSequence((gears([7.0]), rolling_joint())))),
}


@pytest.mark.parametrize("name", PARTS)
def test_derivatives_are_differences(name):
    part, step = PARTS[name], 1e-5
    motion = random_motion(width=part.num_actuators)
    q, v, J = motion.q, motion.v, part.jacobian(motion.q)
    assert J.shape == (6, part.num_joints, part.num_actuators)
    for i, direction in enumerate(np.eye(part.num_actuators)):
        change = part.joint_positions(q + step * direction) - part.joint_positions(
            q - step * direction
        )
        np.testing.assert_allclose(J[:, :, i], change / (2 * step), atol=1e-9)
    rate = (part.jacobian(q + step * v) - part.jacobian(q - step * v)) / (2 * step)
    np.testing.assert_allclose(part.jacobian_rate(q, v), rate, atol=1e-9)


@pytest.mark.parametrize("name", PARTS)
def test_actuators_follow_from_the_joints(name):
    part = PARTS[name]
    motion = random_motion(width=part.num_actuators)
    q = part.actuator_positions(part.joint_positions(motion.q), start=motion.q + 0.05)
    np.testing.assert_allclose(q, motion.q, atol=1e-8)


def test_a_rotor_on_a_fixed_base_is_drakes_reflected_inertia():
    """Drake's rotor_inertia and gear_ratio; the rotor of the second joint is left out."""
    geared, plain = arm(rotors=False, gear_in_drake=True), arm(rotors=True)
    geared.Finalize(), plain.Finalize()
    phi, motion = inertial_parameters(plain), random_motion()
    phi[3] = 0.0
    context = geared.CreateDefaultContext()
    geared.GetJointActuatorByName("joint1").SetRotorInertia(context, 0.0)
    moved = spinning(plain).joint_motion(motion)
    tree = inverse_dynamics(plain, moved.q, moved.v, moved.vd, phi)
    efforts = spinning(plain).regressor(motion.q, tree[..., None])[..., 0]
    for q, v, vd, ours in zip(motion.q, motion.v, motion.vd, efforts, strict=True):
        geared.SetPositions(context, q)
        geared.SetVelocities(context, v)
        M = geared.CalcMassMatrix(context)  # with the reflected inertia
        bias = geared.CalcBiasTerm(context) - geared.CalcGravityGeneralizedForces(context)
        np.testing.assert_allclose(ours, M @ vd + bias, atol=1e-11)


def test_a_joint_that_an_actuator_does_not_move_does_not_limit_it():
    """Without a warning, although 0 · ∞ is no number."""
    idle = Drive(("m",), ("a", "b"), LinearTransmission.of([[2.0], [0.0]]))
    robot = RobotCoordinates.of(("a", "b"), {0: 0, 1: 1}, 2, (idle,))
    within = np.full(1, -1.0), np.full(1, 1.0)
    most = np.array([5.0, np.inf])
    np.testing.assert_array_equal(robot.effort_limits(most, within), [10.0])
    np.testing.assert_array_equal(robot.rates(most, within), [2.5])
    np.testing.assert_array_equal(robot.rates(np.zeros(2), within), [0.0])


def test_bad_input():
    with pytest.raises(ArgumentError, match=r"'knees' among knee, hip"):
        LinearTransmission.from_ratios(["knee", "hip"], ["m"], {"knees": {"m": 1.0}})
    with pytest.raises(ArgumentError, match="'n' among m"):
        LinearTransmission.from_ratios(["knee", "hip"], ["m"], {"knee": {"n": 1.0}})
    with pytest.raises(ArgumentError, match="rank n"):
        LinearTransmission.of([[1.0, 1.0], [2.0, 2.0]])
    with pytest.raises(ArgumentError, match="must not be zero"):
        gears([1.0, 0.0])
    with pytest.raises(ArgumentError, match="from 0 to 1"):
        rolling_joint(1.5)
    with pytest.raises(ArgumentError, match="takes 2"):
        InSequence((rolling_joint(), CRANK, WRIST))
    with pytest.raises(ArgumentError, match=r"must be \(N, 2\)"):
        WRIST.joint_motion(random_motion(width=3))
    with pytest.raises(ArgumentError, match="regressor must be"):
        WRIST.regressor(np.zeros((4, 2)), np.zeros((4, 3, 10)))
    with pytest.raises(ArgumentError, match="cannot be reached"):
        rolling_joint().actuator_positions(np.array([[1.0, -1.0]]))
    with pytest.raises(ArgumentError, match=r"start has the shape \(2,\)"):
        WRIST.actuator_positions(np.zeros((1, 2)), start=[1.0, 2.0, 3.0])
    with pytest.raises(ArgumentError, match="offset"):
        LinearTransmission.of(np.eye(2), [1.0, 2.0, 3.0])
    for nothing in (SideBySide, InSequence):
        with pytest.raises(ArgumentError, match="at least one"):
            nothing(())


@pytest.mark.parametrize("name", PARTS)
def test_joint_motion_is_the_motion_in_time(name):
    part = PARTS[name]
    start = random_motion(width=part.num_actuators)

    def at(time):
        q = start.q + time * start.v + 0.5 * time**2 * start.vd
        return part.joint_positions(q)

    step, moved = 1e-4, part.joint_motion(start)
    np.testing.assert_allclose(moved.v, (at(step) - at(-step)) / (2 * step), atol=1e-6)
    acceleration = (at(step) - 2 * at(0) + at(-step)) / step**2
    np.testing.assert_allclose(moved.vd, acceleration, atol=1e-5)


def test_accelerations_are_those_of_drakes_coupler_constraints():
    """One step of Drake's discrete solver, whose constraints are only nearly rigid."""
    step = 1e-5
    plant = arm(rotors=True, time_step=step)
    names = ["joint0", "joint1", "spin0", "spin1"]
    joints = {name: plant.GetJointByName(name) for name in names}
    for i in range(2):
        plant.AddCouplerConstraint(joints[f"spin{i}"], joints[f"joint{i}"], RATIO, 0.0)
        plant.AddJointActuator(f"spin{i}", joints[f"spin{i}"])
    plant.Finalize()
    transmission, continuous = spinning(plant), arm(rotors=True)
    continuous.Finalize()
    assert joint_names(continuous) == joint_names(plant)
    q, v = np.array([[0.4, 0.9]]), np.array([[1.0, -0.7]])
    torque = np.array([0.2, -0.1])  # of the rotors
    simulator = Simulator(plant)
    context = simulator.get_mutable_context()
    plant.SetPositions(context, transmission.joint_positions(q)[0])
    plant.SetVelocities(context, (transmission.jacobian(q) @ v[:, :, None])[0, :, 0])
    plant.get_actuation_input_port().FixValue(context, torque)
    before = plant.GetVelocities(context).copy()
    simulator.AdvanceTo(step)
    theirs = (plant.GetVelocities(context) - before) / step

    def efforts(vd):
        return actuator_efforts(continuous, transmission, Motion(q, v, vd[None]))[0]

    bias = efforts(np.zeros(2))
    M = np.stack([efforts(unit) - bias for unit in np.eye(2)], -1)
    vd = np.linalg.solve(M, RATIO * torque - bias)  # a rotor's torque moves q by its ratio
    np.testing.assert_allclose(theirs, transmission.matrix @ vd, rtol=2e-3)
