"""Motions that tell effects apart: separations, their gradient, designs, what cannot be asked."""

from dataclasses import replace

import numpy as np
import pytest
from excitation_robots import MODELS, arm, motion_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, sqrtm
from scipy.optimize import lsq_linear

from geodrake import effects
from geodrake.errors import ArgumentError
from geodrake.excitation import make_rival, make_separation, motion_limits
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.logs import Motion
from geodrake.model import load_model
from geodrake.robot import inverse_dynamics_regressor

NOISE = np.array([0.1, 0.2, 0.05])
WIDTH = np.array([0.05, 0.1, 0.2])
PENDULUM = MODELS / "double_pendulum.urdf"


def separation_of(model, names, **settings):
    limits = motion_limits(model, velocity=dict.fromkeys(model.joints, 2.0))
    return make_separation(model, *(make_rival(n, model, limits) for n in names), **settings)


def pendulum(*effects):
    return replace(load_model(PENDULUM), effects=effects)


def best_imitation(rows, wanted, prior, lower):
    """Least ‖wanted − rows x‖² + xᵀ Λ x with some x ≥ lower, by a solver for bounds."""
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
        separation = separation_of(model, names, noise=NOISE, sign_width=WIDTH)
        Y = inverse_dynamics_regressor(model.tree, motion.q, motion.v, motion.vd)
        sign, load = np.tanh(motion.v / WIDTH), np.abs(Y @ model.phi.ravel())
        columns = {
            name: values[:, :, None] * np.eye(3)
            for name, values in zip(names, (sign, load * sign), strict=True)
        }
        weight = np.abs(sign)[..., None] / NOISE[:, None]
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

    def test_friction_that_drives_is_no_explanation(self):
        """What pushes forwards, viscous friction could only explain with a negative sign."""
        model, v = pendulum(), np.linspace(-1.0, 1.0, 41)[:, None] * np.ones(2)
        separation = separation_of(model, ("coulomb_friction", "viscous_friction"), noise=0.1)
        pair = next(p for p in separation.pairs if p.truth == "coulomb_friction")
        driving = replace(separation, pairs=(replace(pair, effects=-pair.effects),))
        motion = Motion(0.0 * v, v, 0.0 * v)
        sign = np.tanh(v[:, 0] / separation.target.sign_width[0])
        expected = (pair.effects.sum() / 0.1) ** 2 * np.sum(sign**4)
        assert driving.separations(motion) == pytest.approx(expected, rel=1e-6)
        assert (separation.separations(motion)[0] < 0.5 * expected).all()

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
        separation = separation_of(model, names, noise=NOISE, sign_width=2.0 * WIDTH)
        motion, rng = motion_of(model, 5, 25), np.random.default_rng(0)
        gradient = separation.value_and_gradient(motion)[1]
        for name in ("q", "v", "vd"):
            direction = rng.normal(size=motion.v.shape)
            ends = [
                separation.value_and_gradient(
                    replace(motion, **{name: getattr(motion, name) + step * direction})
                )[0]
                for step in (1e-6, -1e-6)
            ]
            slope = np.sum(getattr(gradient, name) * direction)
            assert slope == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=2e-4, abs=1e-6)

    def test_an_effect_of_known_size_sets_that_of_its_rival(self):
        """The rival is as large as it must be to be taken for it."""
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

    def test_what_contains_another_effect_can_be_told_one_way_only(self):
        """Asymmetric friction is Coulomb friction too, never the other way around."""
        separation = separation_of(pendulum(), ("coulomb_friction", "asymmetric_friction"))
        assert {(p.truth, p.rival) for p in separation.pairs} == {
            ("asymmetric_friction", "coulomb_friction")
        }


class TestRivals:
    def test_places(self):
        model = pendulum()
        limits = motion_limits(model)
        everywhere = make_rival("coulomb_friction", model, limits)
        assert [e.where for e in everywhere.effects] == [("shoulder",), ("elbow",)]
        assert len(make_rival("coulomb_friction", model, limits, where=["elbow"]).effects) == 1
        assert make_rival("gravity_tilt", model, limits).effects[0].where == ()

    def test_shapes_are_those_of_the_model_or_all_that_a_diagnosis_tries(self):
        limits = motion_limits(pendulum())
        tried = make_rival("nonlinear_viscous_friction", pendulum(), limits)
        assert len(tried.alternatives) == len(
            tuple(effects.NonlinearViscousFriction.candidates("elbow", 1.0))
        )
        own = effects.NonlinearViscousFriction("elbow", exponent=2.2)
        model = pendulum(effects.FittedEffect(own, np.array([1.0])))
        known = make_rival("nonlinear_viscous_friction", model, limits, where=["elbow"])
        assert known.effects == (own,)
        said = make_rival(
            "nonlinear_viscous_friction", model, limits, where=["elbow"], shape={"exponent": 3.0}
        )
        assert said.effects[0].exponent == 3.0

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
        """At one speed, forwards and backwards, an offset of viscosity is Coulomb friction."""
        model = pendulum()
        separation = separation_of(model, ("coulomb_friction", "viscous_friction"), noise=0.1)
        v = np.where(np.arange(30)[:, None] % 2, 1.0, -1.0) * np.ones(2)
        motion = Motion(np.zeros_like(v), v, np.zeros_like(v))
        with pytest.raises(ArgumentError, match=r"viscous_friction completely explains"):
            separation.value_and_gradient(motion)
