"""Actuators that turn with two joints which do not follow each other.

Logs are Drake's inverse dynamics of a chain of four joints whose bodies are not those of the model;
friction in them is v / √(v² + ε²), not tanh. That `explain` names such actuators of an arm, and how
large they are, is in test_planted_effects.py.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from chain_logs import chain_log
from excitation_robots import arm
from scipy.signal import lfilter

from geodrake.diagnosis import add, diagnose
from geodrake.diagnosis.coupled import coupled_joints, other_pairs
from geodrake.diagnosis.residuals import full_motion, joint_residuals
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.evidence import effective_samples
from geodrake.identification.logs.hypothesis import first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns

NAMES = ("coupled_friction", "coupled_rotor_inertia")
CHAIN = arm(joints="RRRR")
APART = (("joint_0", "joint_2"), ("joint_0", "joint_3"), ("joint_1", "joint_3"))
SECOND_AND_LAST = APART[-1]


def wrong(off=0.2):
    """The chain with bodies that weigh by a share `off` more or less."""
    factors = np.exp(off * np.random.default_rng(0).normal(size=(4, 1)))
    return replace(CHAIN, phi=factors * CHAIN.phi)


def diagnosed(hidden, *, off=0.2):
    """Candidates of a log with a hidden effort, and those that couple joints of `APART`."""
    log = chain_log(CHAIN, 1, hidden, seconds=16.0)
    candidates = diagnose(wrong(off), [log], bandwidth=6.0).candidates
    return candidates, [c for c in candidates if c.effect in NAMES and c.where in APART]


def sign(v):
    return v / np.hypot(v, 5e-3)


def shared(i, j, sense, law):
    """Effort of an actuator that turns with v_i ± v_j, from its power: Jᵀ of the speed's slope."""

    def hidden(q, v, vd, load):
        slope = np.eye(4)[i] + sense * np.eye(4)[j]
        return np.outer(law(v @ slope, vd @ slope), slope)

    return hidden


class TestCandidates:
    def test_friction_of_a_pair_and_no_other(self):
        (first, *_), apart = diagnosed(shared(0, 2, 1, lambda w, _: 0.5 * (sign(w) + 0.4 * w)))
        assert (first.effect, first.where) == ("coupled_friction", ("joint_0", "joint_2"))
        assert apart == [first]

    def test_not_at_one_joint_alone(self):
        """Friction that follows another joint's speed too, but is not felt there."""
        belt = shared(1, 3, 1, lambda w, _: 0.3 * sign(w))
        _, apart = diagnosed(lambda *motion: belt(*motion) * np.eye(4)[3])
        assert apart == []

    def test_not_friction_of_both_joints(self):
        def hidden(q, v, vd, load):
            return [0.0, 0.5, 0.0, 0.3] * sign(v) * (1.0 + 1.5 * np.exp(-np.abs(v) / 0.1))

        (first, *_), apart = diagnosed(hidden)
        assert set(first.where) == set(SECOND_AND_LAST)
        assert apart == []


def test_chance_is_as_small_as_told(colour=0.8):
    """Noise in the place of residuals: as many false alarms at most as are admitted."""
    case = open_case(CHAIN, [chain_log(CHAIN, 4)], candidates=False, bandwidth=6.0)
    hypothesis = first_hypothesis(case.dataset, model_unknowns(case.dataset, CHAIN))
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
    robot = arm(joints="RRPRP")
    turning = {("joint_0", "joint_3"), ("joint_1", "joint_3")}
    assert set(other_pairs(robot, robot.joints)) == turning | {("joint_2", "joint_4")}
    assert set(other_pairs(robot, robot.joints[:4])) == turning
    robot = arm(joints="RRRRRRR")
    both = [*robot.joint_pairs, *other_pairs(robot, robot.joints)]
    assert sorted(both) == sorted(combinations(robot.joints, 2))


def test_a_pair_is_added_by_name():
    belt = shared(1, 3, -1, lambda w, _: 0.8 * sign(w) + 0.3 * w)
    log, way = chain_log(CHAIN, 2, belt), {"bandwidth": 6.0}
    (step,) = add("coupled_friction", wrong(), [log], where=SECOND_AND_LAST, **way).steps
    assert step.where == SECOND_AND_LAST
    values = step.parameters["joint_1 & joint_3"]
    assert values["sign"] == -1
    assert values["coulomb"] == pytest.approx(0.8, rel=0.03)
    assert values["viscous"] == pytest.approx(0.3, rel=0.05)
    with pytest.raises(ArgumentError, match="cannot be added at joint_3"):
        add("coupled_friction", CHAIN, [log], where=["joint_3"], **way)
