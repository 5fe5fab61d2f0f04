"""Criteria of motions, their gradients, and parameters and effects that a motion identifies."""

from dataclasses import replace

import numpy as np
import pytest
from excitation_robots import MODELS, arm, assert_gradient, motion_of, random_pose
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw
from random_plants import JOINTS, random_motion, random_plant, random_tree
from scipy.linalg import block_diag, eigh, sqrtm
from scipy.optimize import lsq_linear

from geodrake import effects
from geodrake.effects import (
    CoulombFriction,
    CoupledFriction,
    FittedEffect,
    JointSpring,
    LoadDependentFriction,
    Payload,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.errors import ArgumentError
from geodrake.excitation import (
    Criterion,
    Objective,
    identifiable_parameters,
    make_rival,
    make_separation,
    make_target,
    measurement_factor,
    motion_limits,
    reduced_identification,
)
from geodrake.excitation.objective import CRITERIA, NORMALIZATIONS
from geodrake.excitation.regressor_gradient import (
    base_wrench_regressor_gradient,
    inverse_dynamics_regressor_gradient,
)
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs import Motion
from geodrake.model import load_model
from geodrake.robot import KinematicTree, base_wrench_regressor, inverse_dynamics_regressor

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
    """Test [Lee2019] Proposition 4.1 to 1e-9 for every criterion."""

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
    def check(objective, motion):
        gradient = objective.value_and_gradient(motion)[1]
        assert_gradient(lambda there: objective.value_and_gradient(there)[0], motion, gradient)

    @pytest.mark.parametrize("name", CRITERIA)
    @pytest.mark.parametrize("normalization", NORMALIZATIONS)
    def test_every_criterion_and_normalization(self, name, normalization):
        target = make_target(arm(effects=friction()), noise=[0.1, 0.2, 0.3], sign_width=0.5)
        objective = Objective(target, Criterion(name), normalization)
        self.check(objective, motion_of(target.model))

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
        self.check(Objective(target), motion_of(target.model, count=60))

    def test_base_wrench(self):
        X_WP = random_pose(np.random.default_rng(3))
        target = make_target(arm(), noise=[1.5] * 3 + [0.5] * 3, X_WP=X_WP)
        self.check(Objective(target), motion_of(target.model))


class TestTarget:
    def test_payloads_belong_to_the_prior_or_to_the_unknown(self):
        payload = FittedEffect(Payload("body_2"), BODY)
        model = arm(effects=[payload, *friction(1)])
        known = make_target(model)
        np.testing.assert_allclose(known.inertial_prior, model.total_phi)
        assert "payload" not in {f.effect.name for f in known.effects}
        unknown = make_target(model, effects=[*friction(1), payload], bodies=("body_2",))
        np.testing.assert_allclose(unknown.inertial_prior, [model.phi[2], BODY])
        assert unknown.base.rank == make_target(model, bodies=("body_2",)).base.rank

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


def assert_equals_differences(plant, rng):
    tree, motion = KinematicTree.from_plant(plant), Motion(*random_motion(plant, rng, 3))
    weights = rng.normal(size=(3, plant.num_velocities(), 10 * len(tree.bodies)))

    def value(motion):
        Y = inverse_dynamics_regressor(tree, motion.q, motion.v, motion.vd)
        return np.einsum("nij,nij->n", weights, Y)

    samples = motion.q, motion.v, motion.vd
    gradient = inverse_dynamics_regressor_gradient(plant, *samples, weights)
    assert_gradient(value, motion, gradient, rtol=2e-9)


def test_a_chain_of_every_joint_type():
    rng = np.random.default_rng(0)
    kinds = ("revolute", *sorted(set(JOINTS) - {"none"}), "revolute")
    assert_equals_differences(random_plant(rng, kinds, chain=True), rng)


@settings(max_examples=12)
@given(st.lists(st.sampled_from(sorted(JOINTS)), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_random_trees(kinds, seed):
    rng = np.random.default_rng(seed)
    assert_equals_differences(random_tree(rng, kinds), rng)


@pytest.mark.parametrize("base", ["revolute", "quaternion floating"])
def test_base_wrench(base):
    rng = np.random.default_rng(2)
    plant = random_plant(rng, (base, "prismatic", "ball", "revolute", "weld", "universal"))
    tree, motion = KinematicTree.from_plant(plant), Motion(*random_motion(plant, rng, 4))
    weights, samples = (
        rng.normal(size=(4, 6, 10 * len(tree.bodies))),
        (motion.q, motion.v, motion.vd),
    )
    poses = [RigidTransform(RollPitchYaw(rng.normal(size=3)), rng.normal(size=3)) for _ in "1234"]
    for X_WP in (None, poses[0], np.stack([X.GetAsMatrix4() for X in poses])):

        def value(motion, X_WP=X_WP):
            Y = base_wrench_regressor(tree, motion.q, motion.v, motion.vd, X_WP=X_WP)
            return np.einsum("nij,nij->n", weights, Y)

        gradient = base_wrench_regressor_gradient(plant, *samples, weights, X_WP=X_WP)
        assert_gradient(value, motion, gradient, rtol=2e-9)


NOISE = 0.5


def slow_motion(model, seed=0, count=60):
    """Return a motion that hardly excites inertia."""
    motion = motion_of(model, seed, count)
    return Motion(0.4 * motion.q, 0.1 * motion.v, 0.1 * motion.vd)


def measured_case(seed=0, *, effects=()):
    """Return a target, a slow motion, noisy efforts of other parameters, and those parameters."""
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


EFFORT_NOISE = np.array([0.1, 0.2, 0.05])
WIDTH = np.array([0.05, 0.1, 0.2])
PENDULUM = MODELS / "double_pendulum.urdf"


def separation_of(model, names, **settings):
    limits = motion_limits(model, velocity=dict.fromkeys(model.joints, 2.0))
    return make_separation(model, *(make_rival(n, model, limits) for n in names), **settings)


def pendulum(*effects):
    return replace(load_model(PENDULUM), effects=effects)


def best_imitation(rows, wanted, prior, lower):
    """Return the least ‖wanted − rows x‖² + xᵀ Λ x with some x ≥ lower, by a bounded solver."""
    root = np.real(sqrtm(prior))
    A = np.vstack([rows, np.hstack([root, np.zeros((len(root), rows.shape[1] - len(root)))])])
    b = np.concatenate([wanted, np.zeros(len(root))])
    sizes = np.linalg.norm(A, axis=0)
    bounds = lower * sizes, np.inf
    found = lsq_linear(A / sizes, b, bounds, tol=1e-14, lsmr_tol="auto", max_iter=500)
    return 2.0 * found.cost


class TestSeparation:
    @settings(max_examples=8)
    @given(st.integers(0, 2**32 - 1))
    def test_is_what_two_fits_leave(self, seed):
        """Every pair, against a bounded least-squares fit of its stacked rows."""
        names = ("coulomb_friction", "load_dependent_friction")
        known = effects.FittedEffect(effects.ViscousFriction("joint_1"), np.array([0.7]))
        model = arm(seed, effects=[known])
        motion = motion_of(model, seed)
        separation = separation_of(model, names, noise=EFFORT_NOISE, sign_width=WIDTH)
        Y = inverse_dynamics_regressor(model.tree, motion.q, motion.v, motion.vd)
        sign, load = np.tanh(motion.v / WIDTH), np.abs(Y @ model.phi.ravel())
        columns = {
            name: values[:, :, None] * np.eye(3)
            for name, values in zip(names, (sign, load * sign), strict=True)
        }
        weight = np.abs(sign)[..., None] / EFFORT_NOISE[:, None]
        viscous = motion.v[:, :, None] * np.eye(3)[:, 1:2]
        base = np.concatenate([Y, viscous], axis=2)
        prior = block_diag(pullback_information(model.phi, SPREAD), [[1.0 / 0.7**2]])
        lower = np.r_[np.full(Y.shape[2], -np.inf), -0.7, np.zeros(3)]
        assert len(separation.pairs) == 6
        for pair, found in zip(separation.pairs, separation.separations(motion), strict=True):
            joint = model.joints.index(*pair.where)
            (size,) = pair.effects[pair.effects != 0]
            truth = size * (weight * columns[pair.truth])[:, :, joint].ravel()
            rows = np.concatenate([base, columns[pair.rival]], axis=2) * weight
            left = best_imitation(rows.reshape(len(truth), -1), truth, prior, lower)
            assert found == pytest.approx(left, rel=1e-5)

    @pytest.mark.parametrize(
        "names",
        [
            ("coulomb_friction", "load_dependent_friction"),
            ("viscous_friction", "nonlinear_viscous_friction"),
            ("effort_offset", "asymmetric_friction"),
            ("joint_spring", "gravity_tilt"),
        ],
    )
    def test_gradient(self, names):
        """Against central differences, sample by sample along random directions."""
        model = arm(
            5, effects=[effects.FittedEffect(effects.CoulombFriction("joint_0"), np.array([0.8]))]
        )
        if "coulomb_friction" in names:
            model = replace(model, effects=())
        separation = separation_of(model, names, noise=EFFORT_NOISE, sign_width=2.0 * WIDTH)
        TestGradient.check(separation, motion_of(model, 5, 25))

    def test_an_effect_of_known_size_sets_that_of_its_rival(self):
        """The rival is as large as needed to be confused with it."""
        fitted = effects.FittedEffect(effects.CoulombFriction("elbow"), np.array([0.3]))
        model = pendulum(fitted)
        limits = motion_limits(model)
        rivals = [
            make_rival(name, model, limits, where=["elbow"])
            for name in ("coulomb_friction", "viscous_friction")
        ]
        separation = make_separation(model, *rivals, noise=0.1)
        first, second = separation.pairs
        assert first.effects[first.effects != 0] == pytest.approx([0.3])
        motion = separation.target.random_motion
        seen = model.motion(motion, sign_width=separation.target.sign_width)
        sign, v = seen.joint("elbow").sign_v, motion.v[:, 1]
        assert second.effects[second.effects != 0] == pytest.approx([0.3 * sign @ v / (v @ v)])


class TestRivals:
    def test_what_cannot_be_told_apart(self):
        model = pendulum()
        limits = motion_limits(model)
        rivals = [
            make_rival("joint_spring", model, limits, where=["elbow"], shape={"center": center})
            for center in (0.0, 0.3)
        ]
        with pytest.raises(ArgumentError, match="are equivalent on every motion"):
            make_separation(model, *rivals, noise=0.1)


class TestDesign:
    def test_a_motion_on_which_rivals_agree(self):
        """At one speed in both directions, viscous friction is Coulomb friction."""
        model = pendulum()
        separation = separation_of(model, ("coulomb_friction", "viscous_friction"), noise=0.1)
        v = np.where(np.arange(30)[:, None] % 2, 1.0, -1.0) * np.ones(2)
        motion = Motion(np.zeros_like(v), v, np.zeros_like(v))
        with pytest.raises(ArgumentError, match=r"viscous_friction completely explains"):
            separation.value_and_gradient(motion)
