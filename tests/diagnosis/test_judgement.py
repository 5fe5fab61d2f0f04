"""What held-out errors say of a hypothesis against another one.

Logs are Pinocchio's inverse dynamics, so that no formula of the library makes them.
"""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import Criteria
from geodrake.diagnosis.judgement import Judgement, judge
from geodrake.effects import CoulombFriction
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.evidence import log_likelihood_gain
from geodrake.identification.logs.hypothesis import first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns

LOAD = pin.Inertia(2.0, np.array([0.05, 0.02, 0.1]), 0.02 * np.eye(3))
FRICTION = CoulombFriction("elbow_pitch")


def carrying(joint):
    """What the joints need more if the body of a joint carries a load."""

    def hidden(seen):
        model = seen.model.copy()
        model.inertias[joint] += LOAD
        data, motion = model.createData(), zip(seen.q, seen.v, seen.a, strict=True)
        return np.array([pin.rnea(model, data, *sample) for sample in motion]) - seen.load

    return hidden


def rubbing(seen):
    return {2: 1.5 * np.sign(seen.v[:, 2])}


@cache
def first(hidden):
    """The model of the arm, refitted within its prior to a log with something hidden."""
    model = load_model(MODELS / "arm6.urdf")
    case = open_case(model, [effort_log("arm6", 1, hidden).log], candidates=True)
    return first_hypothesis(case.dataset, model_unknowns(case.dataset, model))


class TestJudgement:
    def test_gain_and_parameters_are_those_of_what_was_added(self):
        start = first(rubbing)
        after = start.with_effects([FRICTION])
        found = judge(start, after)
        gain = log_likelihood_gain(start.held_out.mse, after.held_out.mse, after.effective).sum()
        assert found.gain == pytest.approx(gain)
        assert found.parameters == 1
        assert found.is_better and found.convinces(Criteria())
        assert not judge(after, start).is_better

    def test_folds_are_compared_where_the_difference_is_felt(self):
        start = first(rubbing)
        after = start.with_effects([FRICTION])
        joint = start.dataset.joints.index("elbow_pitch")
        found, ratio = judge(start, after), after.held_out.mse / start.held_out.mse
        assert found.left == pytest.approx(ratio[joint])
        assert found.before == pytest.approx(
            start.held_out.sse[:, joint] / start.held_out.mse[joint]
        )
        everywhere = judge(start, after, joints=np.ones(6, bool))
        assert everywhere.left == pytest.approx(ratio.mean(), rel=1e-3)

    def test_a_hypothesis_ties_with_itself(self):
        start = first(rubbing)
        assert judge(start, start).is_tie(Criteria())
        assert judge(start, start).gain == 0.0

    def test_bodies_pay_for_their_way(self):
        start = first(carrying(6))
        loose = start.loosened(10.0)
        gain = log_likelihood_gain(start.held_out.mse, loose.held_out.mse, loose.effective).sum()
        way = loose.inertial_penalty - start.inertial_penalty
        assert way > 1.0
        assert judge(start, loose).gain == pytest.approx(gain - way)
        back = log_likelihood_gain(loose.held_out.mse, start.held_out.mse, start.effective).sum()
        assert judge(loose, start).gain == pytest.approx(back + way)

    @pytest.mark.parametrize("left", [0.1, 0.5])
    def test_what_leaves_several_times_the_error_is_no_tie(self, left):
        """However few the folds are."""
        before = np.array([1.0, 100.0])
        found = Judgement(1.0, 0, before, left * before)
        assert 0.2 < found.chance_of_other < 0.3
        assert found.is_tie(Criteria()) == (left > 0.25)
