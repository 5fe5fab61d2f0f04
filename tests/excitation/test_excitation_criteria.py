"""Criteria of excitation: values, gradients, and what the geometric normalization is blind to."""

import numpy as np
import pytest
from excitation_robots import arm, motion_of, random_pose
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform
from scipy.linalg import eigh

from geodrake.effects import (
    BodyEffect,
    CoulombFriction,
    CoupledFriction,
    FittedEffect,
    JointSpring,
    LoadDependentFriction,
    Parameter,
    Payload,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.errors import ArgumentError
from geodrake.excitation import Criterion, Objective, make_target
from geodrake.excitation.objective import CRITERIA, NORMALIZATIONS
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs import Motion

BODY = from_mass_com_inertia(2.0, [0.02, 0.1, 0.0], 0.01 * np.eye(3))


def friction(joints=2):
    names = [f"joint_{i}" for i in range(joints)]
    return [
        *(FittedEffect(CoulombFriction(n), np.array([1.5])) for n in names),
        *(FittedEffect(ViscousFriction(n), np.array([0.4])) for n in names),
        FittedEffect(RotorInertia(names[0]), np.array([0.3])),
    ]


class TestValues:
    @pytest.mark.parametrize("name", CRITERIA)
    def test_definitions(self, name):
        rng = np.random.default_rng(0)
        A = rng.normal(size=(9, 5))
        M, C = A.T @ A, np.linalg.inv(A.T @ A)
        expected = {
            "a_optimality": np.trace(C),
            "d_optimality": -np.linalg.slogdet(M)[1],
            "e_optimality": np.linalg.norm(C, 2),
            "condition_number": np.linalg.cond(A),
        }
        value = Criterion(name).value(np.linalg.eigvalsh(M))
        assert value == pytest.approx(expected[name], rel=1e-12)

    @pytest.mark.parametrize("name", CRITERIA)
    @pytest.mark.parametrize("kept", [None, 3])
    def test_objective_and_its_gradient(self, name, kept):
        logs = np.random.default_rng(1).normal(size=6)
        criterion = Criterion(name, kept=kept)
        value, gradient = criterion.objective(logs)
        for i in range(6):
            step = 1e-6 * np.eye(6)[i]
            slope = (
                criterion.objective(logs + step)[0] - criterion.objective(logs - step)[0]
            ) / 2e-6
            assert gradient[i] == pytest.approx(slope, abs=1e-8)
        exact = criterion.value(np.exp(logs))
        exact = exact / (kept or 6) if name == "d_optimality" else np.log(exact)
        above = 0.0 if name in ("a_optimality", "d_optimality") else np.log(kept or 6) / 16.0
        assert exact - 1e-12 <= value <= exact + above + 1e-12

    def test_kept(self):
        eigenvalues = np.array([1e-9, 2.0, 8.0])
        assert Criterion(kept=2).value(eigenvalues) == 0.5
        assert Criterion("condition_number", kept=2).value(eigenvalues) == 2.0
        assert Criterion().value(np.array([0.0, 1.0])) == np.inf


class TestNormalizations:
    def test_spectra(self):
        """Against generalized eigenvalues of the information and the metric of each kind."""
        target = make_target(arm(effects=friction()), noise=[0.1, 0.2, 0.3])
        motion, base = motion_of(target.model), target.base
        weight, inverse = np.diag(target.noise**-2.0), np.linalg.pinv(base.matrix)
        full = sum(X.T @ weight @ X for X in target.measure(motion).regressor)
        M = inverse.T @ full @ inverse
        phi_B = base.values(target.prior)
        sizes = np.array([1.5, 1.5, 0.4, 0.4, 0.3])
        metrics = {
            "none": np.eye(base.rank),
            "diagonal": np.diag(phi_B**-2.0),
            "geometric": base.metric(target.inertial_prior, extra=0.5 / sizes**2),
        }
        for normalization, metric in metrics.items():
            found = Objective(target, normalization=normalization).eigenvalues(motion)
            expected = eigh(M, metric, eigvals_only=True)
            np.testing.assert_allclose(found, expected, rtol=1e-6)


class TestInvariance:
    """[Lee2019] Proposition 4.1, to 1e-9, for every criterion."""

    @staticmethod
    def values(model, motion, noise, **settings):
        target = make_target(model, noise=noise, sign_width=settings.pop("sign_width", 0.05))
        return np.array(
            [Objective(target, Criterion(name), **settings).value(motion) for name in CRITERIA]
        )

    @settings(max_examples=10)
    @given(st.integers(0, 2**32 - 1))
    def test_body_frames(self, seed):
        rng = np.random.default_rng(seed)
        model = arm(seed, effects=friction())
        turned = arm(seed, effects=friction(), frames=[random_pose(rng) for _ in range(3)])
        motion = motion_of(model, seed)
        first, second = (self.values(m, motion, 0.1) for m in (model, turned))
        np.testing.assert_allclose(second, first, rtol=1e-9)

    @settings(max_examples=10)
    @given(st.integers(0, 2**32 - 1))
    def test_units(self, seed):
        rng = np.random.default_rng(seed)
        length, mass, time = np.exp(rng.uniform(-5, 5, 3))
        effort, inertia = mass * length**2 / time**2, mass * length**2
        model = arm(seed, effects=friction())
        scales = [effort, effort, effort * time, effort * time, inertia]
        scaled = [
            FittedEffect(f.effect, f.parameters * scale)
            for f, scale in zip(friction(), scales, strict=True)
        ]
        other = arm(seed, effects=scaled, length=length, mass=mass, time=time)
        first = self.values(model, motion_of(model, seed), 0.1)
        second = self.values(
            other, motion_of(other, seed, time=time), 0.1 * effort, sign_width=0.05 / time
        )
        np.testing.assert_allclose(second, first, rtol=1e-9)

    @settings(max_examples=10)
    @given(st.integers(0, 2**32 - 1))
    def test_base_representations(self, seed):
        rng = np.random.default_rng(seed)
        model = arm(seed, effects=friction())
        motion, target = motion_of(model, seed), make_target(model)
        B = target.base.matrix
        first = self.values(model, motion, 1.0)
        second = self.values(model, motion, 1.0, base=rng.normal(size=(len(B), len(B))) @ B)
        np.testing.assert_allclose(second, first, rtol=1e-9)


class TestGradient:
    @staticmethod
    def assert_gradient(objective, motion, *, rtol=1e-6):
        value, gradient = objective.value_and_gradient(motion)
        rng = np.random.default_rng(5)
        for _ in range(3):
            q, v, vd = (rng.normal(size=x.shape) for x in (motion.q, motion.v, motion.vd))

            def moved(h, q=q, v=v, vd=vd):
                there = Motion(motion.q + h * q, motion.v + h * v, motion.vd + h * vd)
                return objective.value_and_gradient(there)[0]

            h = 1e-4
            slope = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h)
            analytic = (gradient.q * q).sum() + (gradient.v * v).sum() + (gradient.vd * vd).sum()
            assert analytic == pytest.approx(slope, rel=rtol)
        assert np.isfinite(value)

    @pytest.mark.parametrize("name", CRITERIA)
    @pytest.mark.parametrize("normalization", NORMALIZATIONS)
    def test_every_criterion_and_normalization(self, name, normalization):
        target = make_target(arm(effects=friction()), noise=[0.1, 0.2, 0.3], sign_width=0.5)
        objective = Objective(target, Criterion(name), normalization)
        self.assert_gradient(objective, motion_of(target.model))

    def test_many_effects(self):
        effects = [
            *friction(3)[:6],
            FittedEffect(LoadDependentFriction("joint_1"), np.array([0.05])),
            FittedEffect(StribeckFriction("joint_0", 0.5), np.array([0.5])),
            FittedEffect(CoupledFriction(("joint_1", "joint_2")), np.array([0.5, 0.1])),
            FittedEffect(JointSpring("joint_2"), np.array([3.0, 0.0])),
        ]
        target = make_target(arm(effects=effects), noise=0.1, sign_width=0.5)
        assert target.size == 30 + 12
        self.assert_gradient(Objective(target), motion_of(target.model, count=60))

    def test_effects_that_state_no_gradient(self):
        class Drag(BodyEffect):
            name = "drag"
            parameters = (Parameter("d", "N·s²/m²"),)

            def rows(self, motion):
                arm = motion.body_columns(self.body)[:, 1, 1]
                return {"joint_1": (arm * motion.v[:, 1] ** 2)[:, None]}

        target = make_target(arm(), effects=[Drag("body_2")], noise=0.1)
        self.assert_gradient(Objective(target), motion_of(target.model))

    def test_base_wrench(self):
        X_WP = random_pose(np.random.default_rng(3))
        target = make_target(arm(), noise=[1.5] * 3 + [0.5] * 3, X_WP=X_WP)
        self.assert_gradient(Objective(target), motion_of(target.model))


class TestTarget:
    def test_effects_count(self):
        """Friction is among the base parameters, and a robot that rests tells nothing of it."""
        bare, full = (make_target(arm(effects=e), noise=0.1) for e in ((), friction()))
        assert full.base.rank == bare.base.rank + 4  # the rotor inertia of the first joint is Izz
        assert any("coulomb_friction of joint_1" in label for label in full.labels)
        motion = motion_of(full.model)
        slow = Motion(motion.q, 0.01 * motion.v, motion.vd)
        fast, still = (Objective(full).value(m) for m in (motion, slow))
        assert still > 10 * fast

    def test_payloads_belong_to_the_prior_or_to_the_unknown(self):
        payload = FittedEffect(Payload("body_2"), BODY)
        model = arm(effects=[payload, *friction(1)])
        known = make_target(model)
        np.testing.assert_allclose(known.inertial_prior, model.total_phi)
        assert "payload" not in {f.effect.name for f in known.effects}
        unknown = make_target(model, effects=[*friction(1), payload], bodies=("body_2",))
        np.testing.assert_allclose(unknown.inertial_prior, [model.phi[2], BODY])
        assert unknown.base.rank == make_target(model, bodies=("body_2",)).base.rank

    def test_effects_of_unknown_size(self):
        model = arm()
        target = make_target(model, effects=[CoulombFriction("joint_1"), Payload("body_2")])
        load = np.abs(model.motion(target.random_motion).load[:, 1])
        assert 0.03 * load.mean() < target.effect_sizes[0] < 0.3 * load.mean()
        assert target.inertial_prior[-1, 0] == pytest.approx(0.1 * model.phi[:, 0].sum())
        given = make_target(arm(effects=friction(1)))
        np.testing.assert_array_equal(given.effect_sizes, [1.5, 0.4, 0.3])

    def test_bad_arguments(self):
        model = arm(effects=friction())
        for arguments, message in (
            ({"noise": np.inf}, "not a positive number"),
            ({"noise": [0.1, 0.0, 0.1]}, r"of joint_1 is not a positive"),
            ({"noise": [0.1, 0.2]}, r"one number or 3; its shape is \(2,\)"),
            ({"bodies": ("hand",)}, r"body must be .*body_0.*'hand'"),
            ({"bodies": (), "effects": ()}, "nothing to identify"),
            ({"effects": friction(), "X_WP": RigidTransform()}, "internal efforts"),
        ):
            with pytest.raises(ArgumentError, match=message):
                make_target(model, **arguments)

    def test_too_few_samples(self):
        target = make_target(arm())
        with pytest.raises(ArgumentError, match="Use more samples"):
            Objective(target).value(motion_of(target.model, count=3))
        rest = motion_of(target.model)
        still = Motion(rest.q, 0 * rest.v, 0 * rest.vd)
        assert Objective(target).value(still) > 1e20
