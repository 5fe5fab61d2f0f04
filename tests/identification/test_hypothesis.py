"""Weights that a fit finds for itself: a fixed point, which is kept."""

import numpy as np
import pytest
from pendulum_logs import PENDULUM, pendulum_log

from geodrake import load_model
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.hypothesis import first_hypothesis, settle
from geodrake.identification.logs.model_fit import model_unknowns


def test_first_hypothesis_is_settled():
    """Weights that it begins with are far from those that its errors deserve."""

    def compensator(q, v, vd, load):
        return [0.4, 0.0] * np.sin(q - 1.0)

    model, log = load_model(PENDULUM), pendulum_log(1, compensator, seconds=16.0)
    case = open_case(model, [log], candidates=False)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    again = settle(start, iterations=20)
    assert again.nrms == pytest.approx(start.nrms, rel=0.01)
