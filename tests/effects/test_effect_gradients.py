"""Gradients of every effect's regressor, against differences of the regressor itself."""

import dataclasses

import numpy as np
import pytest
from effect_motions import instances, random_motion

from geodrake import effects

WIDTH = 0.7
STEP = 1e-5


def differences(effect, motion, weights, name):
    """Central differences of Σ weights ∘ regressor by one field of the motion."""
    values = getattr(motion, name)
    found = np.empty(values.shape)
    for entry in np.ndindex(values.shape):

        def moved(by, entry=entry):
            changed = values.copy()
            changed[entry] += by
            regressor = effect.regressor(dataclasses.replace(motion, **{name: changed}))
            return (weights * regressor).sum()

        found[entry] = (moved(STEP) - moved(-STEP)) / (2 * STEP)
    return found


def weights_of(effect, motion):
    shape = *motion.v.shape, len(effect.parameters)
    return np.random.default_rng(1).normal(size=shape)


def with_gradient():
    """The effects that do not leave it to differences of the whole motion."""
    motion = random_motion(width=WIDTH)
    return [e for e in instances() if e.gradient(motion, weights_of(e, motion)) is not None]


@pytest.mark.parametrize("effect", with_gradient(), ids=lambda e: e.name)
def test_every_effect(effect):
    motion = random_motion(width=WIDTH)
    weights = weights_of(effect, motion)
    gradient = effect.gradient(motion, weights)
    for name in ("q", "v", "vd", "load"):
        expected = differences(effect, motion, weights, name)
        np.testing.assert_allclose(getattr(gradient, name), expected, atol=2e-8)


def test_effects_without_slopes():
    @dataclasses.dataclass(frozen=True)
    class Hose(effects.JointEffect):
        name = "hose"
        parameters = (effects.Parameter("a", "N·m"), effects.Parameter("b", "N·m"))

        def columns(self, joint):
            return [np.cos(joint.q) * joint.sign_v, 3.0]

    hose, motion = Hose("elbow"), random_motion(width=WIDTH)
    weights = weights_of(hose, motion)
    gradient = hose.gradient(motion, weights)
    for name in ("q", "v", "vd", "load"):
        expected = differences(hose, motion, weights, name)
        np.testing.assert_allclose(getattr(gradient, name), expected, atol=1e-7)

    @dataclasses.dataclass(frozen=True)
    class Drag(effects.BodyEffect):
        name = "drag"
        parameters = (effects.Parameter("d", "N·s²/m²"),)

        def rows(self, motion):
            return {"elbow": motion.v[:, :1] ** 2}

    assert Drag("hand").gradient(motion, np.ones((20, 3, 1))) is None


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_at_rest(exponent):
    motion = dataclasses.replace(random_motion(width=WIDTH), v=np.zeros((20, 3)))
    for effect in (
        effects.NonlinearViscousFriction("elbow", exponent),
        effects.StribeckFriction("elbow", 0.1, exponent),
        effects.AsymmetricFriction("elbow"),
    ):
        gradient = effect.gradient(motion, weights_of(effect, motion))
        assert np.isfinite(gradient.v).all()
