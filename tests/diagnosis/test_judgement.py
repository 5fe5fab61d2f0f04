"""What held-out errors say of a hypothesis against another one.

Logs are Pinocchio's inverse dynamics, so that no formula of the library makes them.
"""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis.drafting.judgement import Judgement, judge
from geodrake.effects import CoulombFriction
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.evidence import log_likelihood_gain, tie_probability
from geodrake.identification.logs.hypothesis import first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns

FRICTION = CoulombFriction("elbow_pitch")


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
        assert found.is_better and found.convinces
        assert not judge(after, start).is_better

    def test_folds_are_compared_at_the_joints_that_are_asked_about(self):
        start = first(rubbing)
        after = start.with_effects([FRICTION])
        joint = start.dataset.joints.index("elbow_pitch")
        here = np.isin(start.dataset.joints, ["elbow_pitch"])
        ratio = after.held_out.mse / start.held_out.mse
        found = judge(start, after, joints=here)
        assert found.left == pytest.approx(ratio[joint])
        assert found.before == pytest.approx(
            start.held_out.sse[:, joint] / start.held_out.mse[joint]
        )
        everywhere = judge(start, after)
        assert everywhere.left == pytest.approx(ratio.mean(), rel=1e-3)

    def test_a_hypothesis_ties_with_itself(self):
        start = first(rubbing)
        assert judge(start, start).is_tie
        assert judge(start, start).gain == 0.0

    @pytest.mark.parametrize("left", [0.1, 0.5])
    def test_what_leaves_several_times_the_error_is_no_tie(self, left):
        """However few the folds are."""
        before = np.array([1.0, 100.0])
        found = Judgement(1.0, 0, before, left * before)
        assert 0.2 < tie_probability(found.after, found.before) < 0.3
        assert found.is_tie == (left > 0.25)
