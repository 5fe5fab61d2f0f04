"""Several effects evaluated together, and what their columns depend on."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from effect_motions import JOINTS, instances, random_motion

from geodrake import effects
from geodrake.effects import BodyEffect, JointEffect, JointMotion, Parameter
from geodrake.effects.effect_columns import EffectColumns, dependencies

GAIN = (Parameter("gain", "N·m"),)
EVERY = tuple(instances())


def trial(v, vd, load):
    """The hand's columns are like those of gravity and of accelerations."""
    motion = random_motion(len(v), width=0.1)
    columns = motion.body_columns("hand") * (1.0 + vd[:, :, None])
    return replace(motion, v=v, vd=vd, load=load, body_columns={"hand": columns}.__getitem__)


@dataclass(frozen=True)
class Flywheel(JointEffect):
    name = "flywheel"
    parameters = GAIN

    def columns(self, joint):
        return [joint.vd * np.sin(joint.q)]


@dataclass(frozen=True)
class ByName(JointEffect):
    """An effect that is another one at every joint, and sees its own sample only."""

    name = "by_name"
    parameters = GAIN

    def columns(self, joint):
        return [{"shoulder": 1.0, "elbow": -2.0}[self.joint] * joint.q]


@dataclass(frozen=True)
class Weight(BodyEffect):
    name = "weight"
    parameters = GAIN

    def rows(self, motion):
        return {j: motion.body_columns(self.body)[:, i, :1] for i, j in enumerate(motion.joints)}


@dataclass(frozen=True)
class Pressed(effects.CoulombFriction):
    """A user's effect that inherits what another one declares."""

    name = "pressed"

    def columns(self, joint):
        return [joint.load * joint.sign_v]


@dataclass(frozen=True)
class Declared(Flywheel):
    name = "declared"
    depends_on = frozenset({"q", "vd", "time"})


@pytest.mark.parametrize(
    ("effect", "found"),
    [
        (Flywheel("elbow"), {"q", "v", "vd"}),
        (Declared("elbow"), {"q", "vd", "time"}),
        (ByName("elbow"), {"q", "v"}),
        (Weight("hand"), {"q", "v", "vd", "bodies", "time"}),
        (Pressed("elbow"), {"q", "v", "load"}),
        (effects.RotorInertia("elbow"), {"vd"}),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_users_effects_are_tried(effect, found):
    assert dependencies(effect, trial, len(JOINTS)) == found


USERS = (Flywheel("elbow"), Flywheel("wrist"), ByName("elbow"), ByName("shoulder"), Weight("hand"))
SETS = {"all": EVERY, "users": USERS, "both": (*EVERY, *USERS), "none": ()}


def sample_of(motion):
    """Motion of all joints at the one sample of a motion."""
    sign_v = motion.direction(motion.v, motion.sign_width)
    return JointMotion(*(x[0] for x in (motion.q, motion.v, motion.vd, motion.load, sign_v)))


@pytest.mark.parametrize("some", SETS.values(), ids=SETS)
@pytest.mark.parametrize("tried", [trial, None])
def test_one_sample_is_a_motion_of_one_sample(some, tried):
    columns, motion = EffectColumns(JOINTS, some, tried), random_motion(1, width=0.1)
    expected = [effect.regressor(motion)[0] for effect in some]
    found = columns.at(sample_of(motion), lambda joints: motion)
    assert found.shape == (3, columns.count)
    np.testing.assert_array_equal(found, np.concatenate([np.zeros((3, 0)), *expected], axis=1))
    mu = np.random.default_rng(2).normal(size=columns.count)
    np.testing.assert_allclose(columns.effort(motion, mu)[0], found @ mu, atol=1e-12)
