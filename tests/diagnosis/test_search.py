"""What a diagnosis finds, prefers, calls a tie and lets go, on short logs of small robots."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from chain_logs import chain_log
from excitation_robots import arm
from pendulum_logs import JOINTS, PENDULUM, friction, pendulum_log

from geodrake import load_model
from geodrake.diagnosis import add, diagnose, explain
from geodrake.effects import (
    CoulombFriction,
    EffortOffset,
    FittedEffect,
    JointEffect,
    JointSpring,
    Parameter,
)

MODEL = load_model(PENDULUM)
BANDWIDTH = 6.0


def knowing(*effects, model=MODEL):
    """The model with effects, given with their parameters."""
    fitted = tuple(FittedEffect(effect, np.atleast_1d(values)) for effect, values in effects)
    return replace(model, effects=fitted)


def at_elbow(law):
    """A hidden effort at the elbow: a law of its position, velocity and acceleration."""
    return lambda q, v, vd, load: np.stack([np.zeros(len(q)), law(q[:, 1], v[:, 1], vd[:, 1])], 1)


def power(exponent):
    return lambda q, v, vd: 0.2 * np.sign(v) * np.abs(v) ** exponent


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
            1, at_elbow(lambda q, v, vd: np.sign(v) * (0.3 + 0.4 * np.exp(-np.abs(v) / 0.3)))
        )
        found = diagnosed(log)
        assert found[0].effect == "coulomb_friction"
        assert "stribeck_friction" not in {candidate.effect for candidate in found}
        (after,) = diagnosed(log, knowing((CoulombFriction("elbow"), 0.3)))
        assert (after.effect, after.where) == ("stribeck_friction", ("elbow",))

    def test_the_simplest_of_those_that_tie_is_chosen(self):
        """Though an effect of one's own fits a little better."""

        @dataclass(frozen=True)
        class Oil(JointEffect):
            name = "oil"
            parameters = (Parameter("drag", "N·m·s/rad"),)

            def columns(self, joint):
                return [joint.v * (1.0 + 0.004 * joint.q)]

        def hidden(q, v, vd, load):
            return np.array([0.2, 0.1]) * v * (1.0 + 0.004 * q)

        first, *others = diagnosed(pendulum_log(1, hidden, seconds=20.0), extra=[Oil])
        oils = {c.where: c for c in others if c.effect == "oil"}
        assert (first.effect, first.where) == ("viscous_friction", JOINTS)
        assert all(oil.tied for oil in oils.values())
        assert oils[JOINTS].error_after < first.error_after

    def test_two_simple_effects_take_the_place_of_one_whose_bounds_hide_it(self):
        """An offset pushes as well as it brakes, which friction with a law a direction may not."""

        def hidden(q, v, vd, load):
            return np.array([1.0, 0.6]) * (0.05 + 0.3 * v)

        found = explained(pendulum_log(2, hidden, seconds=20.0))
        assert places(found) == {"effort_offset": JOINTS, "viscous_friction": JOINTS}
        assert found.verdict == "explained"

    @pytest.mark.parametrize(("stiffness", "is_spring"), [(0.3, True), (-0.3, False)])
    def test_a_spring_without_stiffness_is_none(self, stiffness, is_spring):
        """Though its preload alone explains an offset."""
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

    def test_a_curve_comes_after_the_friction_that_it_refines(self):
        """Though alone it would take more of the error away."""
        law = at_elbow(lambda q, v, vd: np.tanh(v / 0.02) * (0.1 + 0.5 * np.exp(-(v**2))))
        found = explained(pendulum_log(4, law))
        assert [step.effect for step in found.steps] == ["coulomb_friction", "stribeck_friction"]

    def test_a_power_that_is_nearly_viscous_friction_is_told_beside_it(self):
        found = explained(pendulum_log(9, at_elbow(power(1.1))))
        steps = {step.effect: step for step in found.steps}
        assert steps.keys() == {"viscous_friction", "nonlinear_viscous_friction"}
        assert steps["nonlinear_viscous_friction"].parameters["elbow"]["exponent"] >= 1.25

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
