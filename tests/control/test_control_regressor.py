"""Regressors for control against Drake, Pinocchio, finite differences and the batched regressor."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_robots import description, moving_joints, plant_of
from own_code import own_effect
from random_plants import JOINTS, random_plant

from geodrake.control import ControlModel
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
    JointSpring,
    LoadDependentFriction,
    Payload,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.inertia import inertial_parameters
from geodrake.model import load_description
from geodrake.robot import KinematicTree, inverse_dynamics_regressor

MODELS = Path(__file__).parents[2] / "models"
KINDS = sorted(set(JOINTS) - {"none"})
MOVING = sorted(set(KINDS) - {"weld", "weld, reversed"})


RunningMean = own_effect("running_mean", columns=lambda self, joint: [np.cumsum(joint.q)])
"""An effect that sees more than its own sample, and so cannot be evaluated with others."""


@dataclass(frozen=True, eq=False, repr=False)
class Case:
    plant: object
    tree: KinematicTree
    phi: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    v: np.ndarray
    a: np.ndarray

    @classmethod
    def of(cls, plant, rng):
        states = rng.normal(size=(3, plant.num_velocities()))
        q = rng.uniform(-2, 2, plant.num_positions())
        return cls(plant, KinematicTree.from_plant(plant), inertial_parameters(plant), q, *states)

    def sample(self, **given):
        states = {"q": self.q, "qd": self.qd, "v": self.v, "a": self.a, **given}
        return RigidSample.at(self.tree, *states.values())

    def coriolis_matrix(self):
        """Return C(q, q̇) from efforts at unit reference velocities."""
        still = np.zeros(len(self.v))
        at_rest = self.sample(v=still, a=still).effort(self.phi)
        columns = [self.sample(v=unit, a=still).effort(self.phi) for unit in np.eye(len(still))]
        return np.stack(columns, axis=1) - at_rest[:, None]

    def context(self):
        context = self.plant.CreateDefaultContext()
        self.plant.SetPositions(context, self.q)
        self.plant.SetVelocities(context, self.qd)
        return context

    def rate(self, function):
        """Return the rate of a function of (q, q̇) along a motion with acceleration a, to O(h⁴)."""
        qdot = self.plant.MapVelocityToQDot(self.context(), self.qd)
        h = 1e-3 / (1.0 + np.abs(qdot).max())

        def at(step):
            return function(self.q + step * qdot, self.qd + step * self.a)

        return (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)


def close(actual, expected, tolerance=1e-11):
    scale = np.abs(expected).max(initial=1e-9)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * scale)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    kinds=st.lists(st.sampled_from(KINDS), max_size=7),
    last=st.sampled_from(MOVING),
)
def test_axioms_hold_on_trees_of_every_joint_type(seed, kinds, last):
    rng = np.random.default_rng(seed)
    case = Case.of(random_plant(rng, [*kinds, last]), rng)
    sample, context, phi, size = case.sample(), case.context(), case.phi, case.phi.size
    close(sample.effort(phi), sample.regressor(size) @ phi.ravel())

    # With equal velocities it is the regressor of inverse dynamics.
    Y = inverse_dynamics_regressor(case.tree, case.q[None], case.qd[None], case.a[None])[0]
    close(case.sample(v=case.qd).regressor(size), Y)

    # Mass and bias are Drake's.
    M, C = sample.mass_matrix(phi), case.coriolis_matrix()
    close(M, case.plant.CalcMassMatrix(context))
    bias = case.plant.CalcBiasTerm(context)
    np.testing.assert_allclose(C @ case.qd, bias, atol=1e-11 * max(1.0, np.abs(C).max()))
    gravity = case.plant.CalcGravityGeneralizedForces(context)
    close(sample.effort(phi), M @ case.a + C @ case.v - gravity)

    # dM/dt − 2 C is skew.
    rate, scale = case.rate(lambda q, _: case.sample(q=q).mass_matrix(phi)), np.abs(M).max()
    atol = 1e-7 * (scale + np.abs(C).max())
    np.testing.assert_allclose(rate, C + C.T, rtol=0, atol=atol)

    # Efforts are the rate of momentum less its drift.
    rate = case.rate(lambda q, qd: case.sample(q=q, qd=qd).momentum_regressors(size)[0])
    close(rate - sample.momentum_regressors(size)[1], Y, 1e-7)


def test_the_coriolis_matrix_is_pinocchios():
    pin = pytest.importorskip("pinocchio")
    text = description("models/ambidex_like.urdf")
    case, model = Case.of(plant_of(text), np.random.default_rng(1)), pin.buildModelFromXML(text)
    joints = moving_joints(case.plant)
    order = [model.joints[model.getJointId(joint.name())].idx_v for joint in joints]
    at = [joint.velocity_start() for joint in joints]
    q, qd = np.empty(len(at)), np.empty(len(at))
    q[order], qd[order] = case.q[at], case.qd[at]
    C = pin.computeCoriolisMatrix(model, model.createData(), q, qd)[np.ix_(order, order)]
    close(case.coriolis_matrix()[np.ix_(at, at)], C)


ARM = load_description(MODELS / "arm7.urdf")


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


def test_effects_see_the_reference_velocity_or_the_measured_one():
    model = fitted(ARM, *(CoulombFriction(j) for j in ARM.joints))
    q, qd, v, a, _ = motion_of(ARM)
    bare = ControlModel.of(replace(model, effects=())).at(q, qd, v, a)
    for measured, seen in ((False, v), (True, qd)):
        control = ControlModel.of(model, sign_width=0.5, measured_friction=measured)
        mu = control.prior[control.num_inertial :]
        friction = control.at(q, qd, v, a).effort(control.prior) - bare.effort(model.phi.ravel())
        close(friction, mu * np.tanh(seen / 0.5), 1e-9)


def test_mass_matrix_is_the_slope_of_the_effort_in_the_acceleration():
    left_out = ("load_dependent_friction", "effort_scale")
    effects = [e for e in all_effects(ARM) if e.name not in left_out]
    control = ControlModel.of(fitted(ARM, *effects))
    q, qd, v, a, _ = motion_of(ARM)
    rest = control.at(q, qd, v, 0 * a).effort(control.prior)
    slopes = [control.at(q, qd, v, e).effort(control.prior) - rest for e in np.eye(len(a))]
    close(control.at(q, qd, v, a).mass_matrix(control.prior), np.transpose(slopes), 1e-10)


def test_momentum_regressors_with_effects():
    effects = [
        e for e in all_effects(ARM) if e.name not in ("running_mean", "load_dependent_friction")
    ]
    control = ControlModel.of(fitted(ARM, *effects), sign_width=0.3)
    q, qd, _, a, _ = motion_of(ARM)
    h, zero = 1e-5, np.zeros_like(q)

    def momenta(step):
        moved = control.at(q + step * qd, qd + step * a, zero, zero)
        return moved.momentum_regressors[0]

    rate = (momenta(h) - momenta(-h)) / (2 * h)
    drift = control.at(q, qd, zero, zero).momentum_regressors[1]
    close(rate - drift, control.at(q, qd, qd, a).regressor, 1e-7)
