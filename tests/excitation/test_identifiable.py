"""What data can tell: the source's formulas, a second solver, statistics, and invariance."""

import numpy as np
import pytest
from excitation_robots import arm, motion_of
from pydrake.math import RigidTransform
from scipy.linalg import sqrtm

from geodrake.effects import CoulombFriction, FittedEffect
from geodrake.errors import ArgumentError
from geodrake.excitation import (
    Criterion,
    DesignOptions,
    FourierMotion,
    MotionLimits,
    Objective,
    design_excitation,
    identifiable_parameters,
    make_target,
    measurement_factor,
    reduced_identification,
)
from geodrake.logs import Motion

NOISE = 0.5


def slow_motion(model, seed=0, count=60):
    """A motion that hardly excites inertia."""
    motion = motion_of(model, seed, count)
    return Motion(0.4 * motion.q, 0.1 * motion.v, 0.1 * motion.vd)


def measured_case(seed=0, *, effects=()):
    """A target, a slow motion, noisy efforts of other parameters, and those parameters."""
    model, rng = arm(effects=effects), np.random.default_rng(seed)
    target = make_target(model, noise=NOISE)
    truth = target.prior + 0.1 * target.metric_root @ rng.normal(size=target.size)
    motion = slow_motion(model, seed)
    exact = target.measure(motion).regressor @ truth
    return target, motion, exact + NOISE * rng.normal(size=exact.shape), truth


class TestFormulas:
    def test_closed_form_of_the_source(self):
        """[Lee2019] Eqs. (4.5.53) to (4.5.60), with explicit matrices in base parameters."""
        target, *_ = measured_case()
        motion = motion_of(target.model, 0, 60)  # so lively that inverses have digits left
        b = 10.0 * np.random.default_rng(1).normal(size=(60, 3))
        B, prior_B = target.base.matrix, target.base.values(target.prior)
        A = target.base.regressor(target.measure(motion).regressor).reshape(-1, len(B)) / NOISE
        b_white = b.reshape(-1) / NOISE
        H = target.base.metric(target.inertial_prior)
        root = np.real(sqrtm(H))
        variances, U = np.linalg.eigh(root @ np.linalg.inv(A.T @ A) @ root)
        V = np.linalg.solve(root, U)
        threshold = float(np.sqrt(variances[7] * variances[8]))
        low, high = V[:, :8], V[:, 8:]
        expected = low @ (variances[:8, None] * (low.T @ A.T @ b_white)[:, None]).ravel()
        expected = expected + high @ high.T @ H @ prior_B
        factor = measurement_factor(target, motion, [b])
        found = reduced_identification(target, factor, threshold=threshold)
        assert found.identifiable.kept == 8
        np.testing.assert_allclose(found.identifiable.variances, variances, rtol=1e-6)
        np.testing.assert_allclose(found.base_parameters, expected, rtol=1e-6, atol=1e-8)
        directions = found.identifiable.base_directions
        np.testing.assert_allclose(directions.T @ H @ directions, np.eye(len(B)), atol=1e-7)
        np.testing.assert_allclose(found.base_parameters, B @ found.parameters, rtol=1e-9)


class TestProperties:
    def test_eigenvalues_are_those_of_the_criterion(self):
        target, motion, *_ = measured_case()
        found = identifiable_parameters(target, measurement_factor(target, motion), threshold=1.0)
        expected = Objective(target).eigenvalues(motion)
        np.testing.assert_allclose(1.0 / found.variances, expected[::-1], rtol=1e-8)

    def test_shares_and_counts(self):
        friction = [FittedEffect(CoulombFriction("joint_0"), np.array([2.0]))]
        target, motion, *_ = measured_case(effects=friction)
        found = identifiable_parameters(target, measurement_factor(target, motion), threshold=1.0)
        assert found.shares.shape == (4, target.base.rank)
        np.testing.assert_allclose(found.shares.sum(axis=0), 1.0)
        assert found.counts.sum() == pytest.approx(found.kept)
        assert (found.counts[:3] <= 10).all() and 0 <= found.counts[3] <= 1 + 1e-9

    def test_reduced_beats_full_where_data_are_poor(self):
        """Parameter errors √(⟨φ_B* − φ_B, ·⟩/n_B), as in table 4.3."""
        for seed in range(2):
            target, motion, b, truth = measured_case(seed)
            H = target.base.metric(target.inertial_prior)
            factor = measurement_factor(target, motion, [b])

            def error(values, target=target, H=H, truth=truth):
                off = values - target.base.values(truth)
                return np.sqrt(off @ H @ off / len(off))

            reduced = reduced_identification(target, factor, threshold=1e-3)
            full = reduced_identification(target, factor, threshold=np.inf)
            prior = error(target.base.values(target.prior))
            assert error(reduced.base_parameters) < prior < error(full.base_parameters)

    def test_base_wrench_of_a_force_plate(self):
        model = arm()
        noise = [1.5] * 3 + [0.5] * 3
        target = make_target(model, noise=noise, X_WP=RigidTransform([0.1, 0.0, -0.2]))
        motion, rng = motion_of(model, 0, 300), np.random.default_rng(7)
        truth = target.prior + 0.1 * target.metric_root @ rng.normal(size=target.size)
        b = target.measure(motion).regressor @ truth + noise * rng.normal(size=(300, 6))
        found = reduced_identification(target, measurement_factor(target, motion, [b]))
        off = np.abs(found.base_parameters - target.base.values(truth))
        prior = np.abs(target.base.values(target.prior) - target.base.values(truth))
        assert np.linalg.norm(off) < 0.5 * np.linalg.norm(prior)

    def test_long_motions_are_reduced_in_pieces(self):
        target, *_ = measured_case()
        motion = motion_of(target.model, 0, 4500)
        X = target.measure(motion).regressor.reshape(-1, target.size) / NOISE
        R = measurement_factor(target, motion)
        np.testing.assert_allclose(R.T @ R, X.T @ X, rtol=1e-9, atol=1e-6)


class TestBadInput:
    def test_nothing_is_kept(self):
        target, motion, b, _ = measured_case()
        factor = measurement_factor(target, motion, [b])
        for threshold in (1e-12, 0.0, -1.0, np.nan):
            with pytest.raises(ArgumentError, match=r"most certain .* variance|threshold must"):
                reduced_identification(target, factor, threshold=threshold)
        for kept in (0, 99):
            with pytest.raises(ArgumentError, match=f"{kept} directions cannot be kept"):
                identifiable_parameters(target, factor, kept=kept)
        still = Motion(np.zeros((5, 3)), np.zeros((5, 3)), np.zeros((5, 3)))
        with pytest.raises(ArgumentError, match="No direction is within the threshold"):
            identifiable_parameters(target, 0.0 * measurement_factor(target, still))

    def test_more_than_the_data_see_is_kept(self):
        target, motion, *_ = measured_case()
        alone = np.array([1.0, 0.0, 0.0])  # the first joint moves, and the others rest
        motion = Motion(alone * motion.q, alone * motion.v, alone * motion.vd)
        b = target.measure(motion).regressor @ target.prior
        factor = measurement_factor(target, motion, [b])
        full = reduced_identification(target, factor, threshold=np.inf)
        assert full.identifiable.kept < target.base.rank
        np.testing.assert_allclose(full.parameters, target.prior, atol=1e-6)
        with pytest.raises(ArgumentError, match=r"the data identify only \d+"):
            reduced_identification(target, factor, kept=target.base.rank)


def test_a_motion_for_as_many_directions_as_are_asked_for():
    model = arm(joints="RR")
    sizes = np.full(2, -0.3), np.full(2, 0.3), np.full(2, 0.5), np.full(2, 2.0)
    limits = MotionLimits(model.joints, *sizes, np.full(2, np.inf))
    target, values = make_target(model, noise=0.05), []
    for kept in (2, 4):
        found = design_excitation(
            target,
            limits,
            criterion=Criterion(kept=kept),
            trajectory=FourierMotion(4.0, 2),
            options=DesignOptions(samples=50, iterations=40, sharpness=(8.0,)),
            seeds=1,
        )
        told = identifiable_parameters(target, measurement_factor(target, found.motion), kept=kept)
        assert told.threshold == pytest.approx(found.value, rel=1e-6)
        values.append(found.value)
    assert values[0] < values[1]
