"""Regressors for control against Drake, Pinocchio, finite differences and the batched regressor."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_robots import PINOCCHIO_ORDER, description, plant_of
from random_plants import JOINTS, random_plant

from geodrake.control.regressor import ControlModel
from geodrake.control.rigid_bodies import RigidSample
from geodrake.effects import (
    AerodynamicDrag,
    CoulombFriction,
    CoupledFriction,
    CoupledRotorInertia,
    EffortDelay,
    EffortOffset,
    EffortScale,
    FittedEffect,
    GravityTilt,
    JointEffect,
    JointSpring,
    LoadDependentFriction,
    Parameter,
    Payload,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.inertia import inertial_parameters
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import load_description
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import inverse_dynamics_regressor

MODELS = Path(__file__).parents[2] / "models"
KINDS = sorted(set(JOINTS) - {"none"})
MOVING = sorted(set(KINDS) - {"weld", "weld, reversed"})


@dataclass(frozen=True)
class RunningMean(JointEffect):
    """An effect that sees more than its own sample, and so cannot be evaluated with others."""

    name = "running_mean"
    parameters = (Parameter("gain", "N·m"),)

    def columns(self, joint):
        return [np.cumsum(joint.q)]


@dataclass(frozen=True, eq=False, repr=False)
class Case:
    plant: object
    tree: KinematicTree
    phi: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    v: np.ndarray
    a: np.ndarray
    r: np.ndarray

    def sample(self, **given):
        states = {"q": self.q, "qd": self.qd, "v": self.v, "a": self.a, **given}
        return RigidSample.at(self.tree, *states.values())

    def regressor(self, **given):
        return self.sample(**given).regressor(self.phi.size)

    def momentum_regressors(self, **given):
        return self.sample(**given).momentum_regressors(self.phi.size)

    def coriolis_matrix(self, **given):
        """C(q, q̇), from efforts at unit reference velocities."""
        still, columns = np.zeros(len(self.v)), []
        at_rest = self.sample(**given, v=still, a=still).effort(self.phi)
        for unit in np.eye(len(self.v)):
            columns.append(self.sample(**given, v=unit, a=still).effort(self.phi) - at_rest)
        return np.stack(columns, axis=1)

    @property
    def context(self):
        context = self.plant.CreateDefaultContext()
        self.plant.SetPositions(context, self.q)
        self.plant.SetVelocities(context, self.qd)
        return context

    def rate(self, function):
        """Rate of a function of (q, q̇) along the motion with the acceleration a, to O(h⁴)."""
        qdot = self.plant.MapVelocityToQDot(self.context, self.qd)
        h = 1e-3 / (1.0 + np.abs(qdot).max())

        def at(step):
            return function(self.q + step * qdot, self.qd + step * self.a)

        return (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)


def case_of(plant, rng):
    tree, nv = KinematicTree.from_plant(plant), plant.num_velocities()
    motion = rng.normal(size=(4, nv))
    q = rng.uniform(-2, 2, plant.num_positions())
    return Case(plant, tree, inertial_parameters(plant), q, *motion)


def close(actual, expected, tolerance=1e-11):
    scale = np.abs(expected).max(initial=1e-9)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * scale)


def with_equal_velocities_it_is_the_regressor_of_inverse_dynamics(case):
    expected = inverse_dynamics_regressor(case.tree, case.q[None], case.qd[None], case.a[None])[0]
    close(case.regressor(v=case.qd), expected)


def efforts_without_the_regressor_are_those_with_it(case):
    sample = case.sample()
    close(sample.effort(case.phi), case.regressor() @ case.phi.ravel())


def mass_and_bias_are_drakes(case):
    sample, context = case.sample(), case.context
    M, C = sample.mass_matrix(case.phi), case.coriolis_matrix()
    gravity = case.plant.CalcGravityGeneralizedForces(context)
    close(M, case.plant.CalcMassMatrix(context))
    bias = case.plant.CalcBiasTerm(context)
    np.testing.assert_allclose(C @ case.qd, bias, atol=1e-11 * max(1.0, np.abs(C).max()))
    close(sample.effort(case.phi), M @ case.a + C @ case.v - gravity)


def the_rate_of_mass_less_twice_coriolis_is_skew(case):
    rate = case.rate(lambda q, _: case.sample(q=q).mass_matrix(case.phi))
    C = case.coriolis_matrix()
    scale = np.abs(case.sample().mass_matrix(case.phi)).max() + np.abs(C).max()
    np.testing.assert_allclose(rate, C + C.T, rtol=0, atol=1e-7 * scale)
    x = case.r
    assert abs(x @ (rate - 2 * C) @ x) < 1e-7 * scale * (x @ x)


def efforts_are_the_rate_of_momentum_less_its_drift(case):
    rate = case.rate(lambda q, qd: case.momentum_regressors(q=q, qd=qd)[0])
    expected = inverse_dynamics_regressor(case.tree, case.q[None], case.qd[None], case.a[None])[0]
    drift = case.momentum_regressors()[1]
    close(rate - drift, expected, 1e-7)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    kinds=st.lists(st.sampled_from(KINDS), max_size=7),
    last=st.sampled_from(MOVING),
)
def test_axioms_hold_on_trees_of_every_joint_type(seed, kinds, last):
    rng = np.random.default_rng(seed)
    case = case_of(random_plant(rng, [*kinds, last]), rng)
    with_equal_velocities_it_is_the_regressor_of_inverse_dynamics(case)
    efforts_without_the_regressor_are_those_with_it(case)
    mass_and_bias_are_drakes(case)
    the_rate_of_mass_less_twice_coriolis_is_skew(case)
    efforts_are_the_rate_of_momentum_less_its_drift(case)


def test_coriolis_matrix_and_regressor_are_pinocchios():
    pin = pytest.importorskip("pinocchio")
    text = description("models/ambidex_like.urdf")
    case = case_of(plant_of(text), np.random.default_rng(1))
    model = pin.buildModelFromXML(text)
    data = model.createData()
    names = [case.plant.get_joint(i).name() for i in case.plant.GetJointIndices()]
    moving = [n for n in names if case.plant.GetJointByName(n).num_velocities()]
    order = [model.joints[model.getJointId(n)].idx_v for n in moving]
    at = [case.plant.GetJointByName(n).velocity_start() for n in moving]
    q, qd, a = (np.empty(len(at)) for _ in range(3))
    q[order], qd[order], a[order] = case.q[at], case.qd[at], case.a[at]
    C = pin.computeCoriolisMatrix(model, data, q, qd)[np.ix_(order, order)]
    close(case.coriolis_matrix()[np.ix_(at, at)], C)
    Y = pin.computeJointTorqueRegressor(model, data, q, qd, a)
    blocks = Y.reshape(len(q), -1, 10)[:, :, PINOCCHIO_ORDER]
    own = case.regressor(v=case.qd).reshape(len(q), -1, 10)
    bodies = [
        case.tree.bodies.index(case.plant.GetJointByName(n).child_body().name()) for n in moving
    ]
    theirs = [model.getJointId(n) - 1 for n in moving]
    close(own[np.ix_(at, bodies)], blocks[np.ix_(order, theirs)])


@pytest.fixture(scope="module")
def arm():
    return load_description(MODELS / "arm7.urdf")


def fitted(model, *effects, seed=0):
    rng = np.random.default_rng(seed)
    values = tuple(FittedEffect(e, rng.uniform(0.5, 2.0, len(e.parameters))) for e in effects)
    return replace(model, effects=values)


def all_effects(arm):
    joints = arm.joints
    each = [kind(j) for kind in (CoulombFriction, ViscousFriction, RotorInertia) for j in joints]
    return (
        *each,
        *(StribeckFriction(j, 0.1 * (1 + i % 2)) for i, j in enumerate(joints)),
        JointSpring(joints[1]),
        JointSpring(joints[2], exponent=3),
        EffortOffset(joints[3]),
        EffortDelay(0.01),
        LoadDependentFriction(joints[4]),
        CoupledFriction((joints[4], joints[5])),
        CoupledRotorInertia((joints[5], joints[6])),
        Payload(arm.bodies[-1]),
        GravityTilt(),
        AerodynamicDrag(arm.bodies[-2], z=0.1),
        EffortScale(joints[4]),
        RunningMean(joints[0]),
        RunningMean(joints[1]),
    )


def motion_of(arm, seed=0):
    return np.random.default_rng(seed).normal(size=(5, len(arm.joints)))


def test_effects_beside_inertia_are_those_of_the_model(arm):
    model = fitted(arm, *(e for e in all_effects(arm) if e.name != "payload"))
    load = FittedEffect(Payload(arm.bodies[-1]), 0.1 * inertial_parameters(arm.plant)[-1])
    model = replace(model, effects=(*model.effects, load))
    control = ControlModel.of(model, sign_width=0.3)
    q, qd, _, a, r = motion_of(arm)
    sample = control.at(q, qd, qd, a)
    motion = Motion(q[None], qd[None], a[None])
    close(sample.effort(control.prior), model.effort(motion, sign_width=0.3)[0])
    close(sample.covector(r), sample.regressor.T @ r)


def test_effects_see_the_reference_velocity_or_the_measured_one(arm):
    model = fitted(arm, *(CoulombFriction(j) for j in arm.joints))
    q, qd, v, a, _ = motion_of(arm)
    bare = ControlModel.of(replace(model, effects=())).at(q, qd, v, a)
    for measured, seen in ((False, v), (True, qd)):
        control = ControlModel.of(model, sign_width=0.5, measured_friction=measured)
        mu = control.prior[control.num_inertial :]
        friction = control.at(q, qd, v, a).effort(control.prior) - bare.effort(model.phi.ravel())
        close(friction, mu * np.tanh(seen / 0.5), 1e-9)


def test_mass_matrix_is_the_slope_of_the_effort_in_the_acceleration(arm):
    left_out = ("load_dependent_friction", "effort_scale")
    effects = [e for e in all_effects(arm) if e.name not in left_out]
    control = ControlModel.of(fitted(arm, *effects))
    q, qd, v, a, _ = motion_of(arm)
    rest = control.at(q, qd, v, 0 * a).effort(control.prior)
    slopes = [control.at(q, qd, v, e).effort(control.prior) - rest for e in np.eye(len(a))]
    close(control.at(q, qd, v, a).mass_matrix(control.prior), np.transpose(slopes), 1e-10)


def test_momentum_regressors_with_effects(arm):
    effects = [
        e for e in all_effects(arm) if e.name not in ("running_mean", "load_dependent_friction")
    ]
    control = ControlModel.of(fitted(arm, *effects), sign_width=0.3)
    q, qd, _, a, _ = motion_of(arm)
    h, zero = 1e-5, np.zeros_like(q)

    def momenta(step):
        moved = control.at(q + step * qd, qd + step * a, zero, zero)
        return moved.momentum_regressors[0]

    rate = (momenta(h) - momenta(-h)) / (2 * h)
    drift = control.at(q, qd, zero, zero).momentum_regressors[1]
    close(rate - drift, control.at(q, qd, qd, a).regressor, 1e-7)
