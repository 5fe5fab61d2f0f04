"""Actuators that turn with two joints which do not follow each other, seen in residuals.

Logs are inverse dynamics by Pinocchio; friction in them is v / √(v² + ε²), not tanh. That `explain`
names such actuators is in test_hidden_forces.py.
"""

from dataclasses import replace
from functools import cache
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from effort_logs import MODELS, effort_log
from scipy.signal import lfilter

from geodrake import load_model
from geodrake.diagnosis import add
from geodrake.diagnosis.coupled import coupled_joints, other_pairs
from geodrake.diagnosis.proposals import suggested
from geodrake.diagnosis.residuals import full_motion, joint_residuals
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.evidence import effective_samples
from geodrake.identification.logs.hypothesis import first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns

NAMES = ("coupled_friction", "coupled_rotor_inertia")
ROLL_AND_SPIN = ("wrist_roll", "wrist_spin")  # joints 3 and 5
SEEDS = (1, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (2, 3)))


@cache
def model_file(name):
    return load_model(MODELS / f"{name}.urdf")


def opened(name, recording):
    model = model_file(name)
    case = open_case(model, [recording.log], candidates=False)
    return case, first_hypothesis(case.dataset, model_unknowns(case.dataset, model))


def offered(hidden, *, name="arm6", seed=1, off=0.2, **motion):
    """Names and pairs that the residual of a log with a hidden effort suggests."""
    case, hypothesis = opened(name, effort_log(name, seed, hidden, off=off, **motion))
    found = suggested(case, hypothesis, ())
    return {(effect.name, effect.where) for effect in found if effect.name in NAMES}


def sign(v):
    return v / np.hypot(v, 5e-3)


def shared(i, j, sense, law):
    """Effort of an actuator that turns with v_i ± v_j, from its power: Jᵀ of the speed's slope."""

    def hidden(seen):
        slope = np.eye(seen.v.shape[1])[i] + sense * np.eye(seen.v.shape[1])[j]
        return np.outer(law(seen.v @ slope, seen.a @ slope), slope)

    return hidden


class TestProposal:
    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize("sense", [1, -1])
    @pytest.mark.parametrize(
        ("i", "j", "size"), [(0, 2, 2.0), (1, 3, 0.3), (3, 5, 0.05), (0, 5, 0.2)]
    )
    def test_friction_of_a_pair_and_no_other(self, i, j, size, sense, seed):
        joints = model_file("arm6").joints
        found = offered(shared(i, j, sense, lambda w, _: size * (sign(w) + 0.4 * w)), seed=seed)
        assert found == {("coupled_friction", (joints[i], joints[j]))}

    @pytest.mark.parametrize("law", [lambda w, _: 0.1 * sign(w), lambda w, _: 0.1 * w])
    def test_dry_or_viscous_alone(self, law):
        assert offered(shared(3, 5, -1, law)) == {("coupled_friction", ROLL_AND_SPIN)}

    @pytest.mark.parametrize("sense", [1, -1])
    def test_rotor(self, sense):
        found = offered(shared(3, 5, sense, lambda _, a: 0.02 * a))
        assert found == {("coupled_rotor_inertia", ROLL_AND_SPIN)}

    def test_under_friction_of_the_joints(self):
        belt = shared(3, 5, 1, lambda w, _: 0.3 * sign(w))
        size = np.array([3.0, 3.0, 3.0, 0.15, 0.15, 0.15])
        found = offered(lambda seen: belt(seen) + size * (sign(seen.v) + 0.7 * seen.v))
        assert found == {("coupled_friction", ROLL_AND_SPIN)}

    def test_not_at_one_joint_alone(self):
        """Friction that follows another joint's speed too, but is not felt there."""
        belt = shared(3, 5, 1, lambda w, _: 0.3 * sign(w))
        assert offered(lambda seen: belt(seen) * np.eye(6)[3]) == set()

    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize(
        "law",
        [
            sign,
            lambda v: v * np.abs(v),
            lambda v: sign(v) * (1.0 + 1.5 * np.exp(-np.abs(v) / 0.1)),
            lambda v: sign(v) * (1.0 + 0.4 * sign(v)),
        ],
        ids=["dry", "quadratic", "Stribeck", "asymmetric"],
    )
    def test_not_friction_of_both_joints(self, law, seed):
        size = np.array([0.0, 4.0, 0.0, 0.4, 0.0, 0.4])
        assert offered(lambda seen: size * law(seen.v), seed=seed) == set()

    @pytest.mark.parametrize("off", [0.0, 0.2])
    @pytest.mark.parametrize("name", ["arm6", "arm7"])
    @pytest.mark.parametrize("seed", SEEDS)
    def test_not_in_bodies_that_are_off(self, name, seed, off):
        assert offered(None, name=name, seed=seed, off=off) == set()


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_chance_is_as_small_as_told(colour):
    """Noise in the place of residuals: as many false alarms at most as are admitted."""
    case, hypothesis = opened("arm7", effort_log("arm7", 4))
    joints, motion = joint_residuals(case, hypothesis), full_motion(case)
    rng, least = np.random.default_rng(5), []
    for _ in range(100):
        noise = [lfilter([1.0], [1.0, -colour], rng.normal(size=len(j.v))) for j in joints]
        looked_at = [
            replace(joint, residual=own, effective=effective_samples([own]))
            for joint, own in zip(joints, noise, strict=True)
        ]
        by_name = dict.fromkeys(NAMES, 1.0)
        for proposal in coupled_joints(case, looked_at, motion):
            name = proposal.effects[0].name
            by_name[name] = min(by_name[name], proposal.alarm)
        least.append(list(by_name.values()))
    assert np.all(np.mean(np.array(least) < 0.1, axis=0) <= 0.1)


def test_pairs_are_of_one_type_and_do_not_follow_each_other():
    model = SimpleNamespace(
        single_joints=("a", "b", "slide", "c", "lift"),
        sliding_joints=("slide", "lift"),
        joint_pairs=(("a", "b"), ("c", "a")),
    )
    assert other_pairs(model, model.single_joints) == [("b", "c"), ("slide", "lift")]
    assert other_pairs(model, ("a", "b", "slide", "c")) == [("b", "c")]


def test_every_pair_of_an_arm_is_looked_at_once():
    model = model_file("arm7")
    both = [*model.joint_pairs, *other_pairs(model, model.single_joints)]
    assert sorted(both) == sorted(combinations(model.joints, 2))


class TestAdd:
    def test_pair_by_name(self):
        belt = shared(1, 3, -1, lambda w, _: 0.8 * sign(w) + 0.3 * w)
        place = ("shoulder_pitch", "wrist_roll")
        found = add(
            "coupled_friction", model_file("arm6"), [effort_log("arm6", 2, belt).log], where=place
        )
        (step,) = found.steps
        assert step.where == place
        values = step.parameters["shoulder_pitch & wrist_roll"]
        assert values["sign"] == -1
        assert values["coulomb"] == pytest.approx(0.8, rel=0.03)
        assert values["viscous"] == pytest.approx(0.3, rel=0.05)

    def test_joint_of_a_pair_cannot_have_it_alone(self):
        with pytest.raises(ArgumentError, match="cannot be added at wrist_roll"):
            add(
                "coupled_friction",
                model_file("arm6"),
                [effort_log("arm6", 2, duration=12.0).log],
                where=["wrist_roll"],
            )
