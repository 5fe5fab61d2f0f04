"""Candidates and their search: choices, ties, shapes, pairs of joints, and orders of waves."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from chain_logs import chain_log
from excitation_robots import arm
from own_code import own_effect
from pendulum_logs import JOINTS, PENDULUM, friction, pendulum_log

from geodrake import load_model
from geodrake.diagnosis import add, diagnose, explain
from geodrake.diagnosis.coupled import other_pairs
from geodrake.effects import (
    CoulombFriction,
    EffortOffset,
    FittedEffect,
    JointSpring,
    Shape,
)
from geodrake.errors import ArgumentError

MODEL = load_model(PENDULUM)
BANDWIDTH = 6.0


def knowing(*effects, model=MODEL):
    """Return the model with effects of given parameters."""
    fitted = tuple(FittedEffect(effect, np.atleast_1d(values)) for effect, values in effects)
    return replace(model, effects=fitted)


def at_elbow(law):
    """Return a hidden effort at the elbow, a function of its motion."""
    return lambda q, v, vd, load: np.stack([np.zeros(len(q)), law(q[:, 1], v[:, 1], vd[:, 1])], 1)


def diagnosed(log, model=MODEL, **options):
    return diagnose(model, [log], bandwidth=BANDWIDTH, **options).candidates


def explained(log, model=MODEL, **options):
    return explain(model, [log], bandwidth=BANDWIDTH, **options)


def places(explanation):
    return {step.effect: step.where for step in explanation.steps}


def tied(candidates):
    return {candidate.effect for candidate in candidates if candidate.tied}


class TestChoice:
    def test_refinements_come_after_what_they_refine(self):
        log = pendulum_log(
            1,
            at_elbow(lambda q, v, vd: np.sign(v) * (0.3 + 0.4 * np.exp(-np.abs(v) / 0.3))),
            seconds=24.0,
        )
        found = diagnosed(log)
        assert found[0].effect == "coulomb_friction"
        assert "stribeck_friction" not in {candidate.effect for candidate in found}
        (after,) = diagnosed(log, knowing((CoulombFriction("elbow"), 0.3)))
        assert (after.effect, after.where) == ("stribeck_friction", ("elbow",))

    def test_the_simplest_of_those_that_tie_is_chosen(self):
        """A user's effect fits slightly better."""

        Oil = own_effect("oil", columns=lambda self, j: [j.v * (1.0 + 0.004 * j.q)])

        def hidden(q, v, vd, load):
            return np.array([0.2, 0.1]) * v * (1.0 + 0.004 * q)

        first, *others = diagnosed(pendulum_log(1, hidden, seconds=20.0), extra=[Oil])
        oils = {c.where: c for c in others if c.effect == "oil"}
        assert (first.effect, first.where) == ("viscous_friction", JOINTS)
        assert all(oil.tied for oil in oils.values())
        assert oils[JOINTS].error_after < first.error_after

    def test_values_of_a_shape_that_a_log_does_not_tell_apart_count_once(self):
        """However many are tried: here a shape that changes nothing."""

        def odds(count):
            values = tuple(np.linspace(1.0, 2.0, count).tolist())
            kind = own_effect(
                "wavy",
                __annotations__={"setting": "float"},
                shapes=(Shape("setting", grid=values),),
                columns=lambda self, j: [np.cos(7.0 * j.q)],
            )
            log = pendulum_log(3, at_elbow(lambda q, v, vd: 0.003 * np.cos(7.0 * q)), seconds=12.0)
            (step,) = explained(log, extra=[kind]).steps
            assert (step.effect, step.where) == ("wavy", ("elbow",))
            return step.probability / (1.0 - step.probability)

        one = odds(1)
        assert 3.0 < one < 1e3
        assert odds(8) == pytest.approx(one, rel=0.3)

    def test_two_simple_effects_take_the_place_of_one_whose_bounds_hide_it(self):
        """An offset pushes as well as it brakes, which friction with a law a direction may not."""

        def hidden(q, v, vd, load):
            return np.array([1.0, 0.6]) * (0.05 + 0.3 * v)

        found = explained(pendulum_log(2, hidden, seconds=20.0))
        assert places(found) == {"effort_offset": JOINTS, "viscous_friction": JOINTS}
        assert found.verdict == "explained"

    @pytest.mark.parametrize(("stiffness", "is_spring"), [(0.3, True), (-0.3, False)])
    def test_a_spring_without_stiffness_is_none(self, stiffness, is_spring):
        """Its preload alone would explain an offset."""
        log = pendulum_log(1, at_elbow(lambda q, v, vd: 0.5 + stiffness * q), seconds=16.0)
        named = {candidate.effect for candidate in diagnosed(log)}
        assert ("joint_spring" in named) == is_spring

    def test_effects_of_the_model_stay(self):
        """Even one that explains nothing, and an elaborate one where a simple one would do."""
        known = knowing(
            (EffortOffset("elbow"), 0.0), (JointSpring("elbow", exponent=3), [0.0, 0.0])
        )
        found = explained(pendulum_log(1, friction((0.2, 0.1)), seconds=20.0), known)
        assert places(found) == {"coulomb_friction": JOINTS}
        kept = {fitted.effect for fitted in found.model.effects}
        assert kept >= {fitted.effect for fitted in known.effects}

    def test_what_is_fitted_along_is_told_in_the_units_of_its_joint(self):
        robot = arm(joints="RP")
        assert robot.sliding_joints == ("joint_1",)
        log = chain_log(robot, 1, lambda q, v, vd, load: np.sign(v))
        found = explained(log, robot)
        assert places(found) == {"coulomb_friction": robot.joints}
        told = [note for note in found.notes if "was fitted, but is too small to be a step" in note]
        assert [note.split()[-1] for note in told] == ["N·m·s/rad", "N·s/m"]
        for joint, note in zip(robot.joints, told, strict=True):
            assert note.startswith(f"viscous friction of {joint} was fitted")


class TestTies:
    def test_what_needs_impossible_bodies_is_no_tie(self):
        """Rotors that turn alone would leave as little, with bodies that cannot be."""
        log = pendulum_log(2, lambda q, v, vd, load: -0.05 * vd[:, ::-1], seconds=20.0)
        candidates = diagnose(MODEL, [log]).candidates
        first = candidates[0]
        assert (first.effect, first.where) == ("coupled_rotor_inertia", JOINTS)
        others = [candidate for candidate in candidates if candidate.effect == "rotor_inertia"]
        assert all(c.error_after > 1.5 * first.error_after and not c.tied for c in others)


class TestShapes:
    def test_a_curve_of_friction_that_falls_like_a_bell_is_told_from_one_that_falls_at_once(self):
        law = at_elbow(lambda q, v, vd: np.tanh(v / 0.02) * (0.3 + 0.3 * np.exp(-((v / 0.3) ** 2))))
        found = explained(pendulum_log(4, law))
        steps = {step.effect: step.parameters["elbow"] for step in found.steps}
        assert steps.keys() == {"coulomb_friction", "stribeck_friction"}
        assert steps["stribeck_friction"]["exponent"] == 2.0
        assert steps["stribeck_friction"]["stribeck_velocity"] == pytest.approx(0.3, rel=0.1)
        assert steps["stribeck_friction"]["excess"] == pytest.approx(0.3, rel=0.1)
        assert found.verdict == "explained"

    @pytest.mark.parametrize("speed", [0.1, 0.2, 3.0])  # 0.02 rad/s pass within a sample
    def test_a_shape_between_those_of_the_grid_or_at_its_edge(self, speed):
        law = at_elbow(lambda q, v, vd: np.sign(v) * (0.3 + 0.8 * np.exp(-np.abs(v) / speed)))
        known = knowing((CoulombFriction("elbow"), 0.3))
        log = pendulum_log(1, law, seconds=20.0)
        found = add("stribeck_friction", known, [log], where=["elbow"], bandwidth=BANDWIDTH)
        values = found.steps[0].parameters["elbow"]
        assert values["exponent"] == 1.0
        assert values["stribeck_velocity"] == pytest.approx(speed, rel=0.2 if speed != 0.2 else 0.1)
        assert found.verdict == "explained"


NAMES = ("coupled_friction", "coupled_rotor_inertia")
CHAIN = arm(joints="RRRR")
APART = (("joint_0", "joint_2"), ("joint_0", "joint_3"), ("joint_1", "joint_3"))
SECOND_AND_LAST = APART[-1]


def wrong(off=0.2):
    """Return the chain with bodies whose masses are off by a share."""
    factors = np.exp(off * np.random.default_rng(0).normal(size=(4, 1)))
    return replace(CHAIN, phi=factors * CHAIN.phi)


def diagnosed_arm(hidden, *, off=0.2):
    """Return candidates of a log with a hidden effort, and those that couple joints of `APART`."""
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
        (first, *_), apart = diagnosed_arm(shared(0, 2, 1, lambda w, _: 0.5 * (sign(w) + 0.4 * w)))
        assert (first.effect, first.where) == ("coupled_friction", ("joint_0", "joint_2"))
        assert apart == [first]

    def test_not_friction_of_both_joints(self):
        def hidden(q, v, vd, load):
            return [0.0, 0.5, 0.0, 0.3] * sign(v) * (1.0 + 1.5 * np.exp(-np.abs(v) / 0.1))

        (first, *_), apart = diagnosed_arm(hidden)
        assert set(first.where) == set(SECOND_AND_LAST)
        assert apart == []


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
