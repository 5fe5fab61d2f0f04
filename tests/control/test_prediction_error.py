"""Composite adaptation: by tracking errors and errors of prediction, alone and together."""

import numpy as np
import pytest
from adaptive_loops import (
    CONTROL,
    MANIFOLD,
    MODEL,
    TRUTH,
    check_estimates,
    computed,
    motion,
    natural,
    passive,
    pendulum_plant,
    perturbed,
    run,
)

from diagrams.studies.adaptive.faults import moments
from geodrake.control.adaptation import PartialLaw, adapted_parameters, natural_adaptation
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.systems import PredictionError, Safeguards
from geodrake.manifolds import PhysicalInertia

LAST = adapted_parameters(MODEL, [MODEL.bodies[-1]])
START = np.where(LAST, perturbed(0.3), TRUTH)
LAW = PartialLaw(natural_adaptation(PhysicalInertia(), 0.1), LAST)
STEP = 2e-3


def predicting(prediction, make=passive, law=LAW, **options):
    """A controller that adapts the last body by what it predicts."""
    options = {"parameters": START, "time_step": STEP, **options}
    return make(law, prediction=prediction, **options)


def told(system, state, desired=(0.0,) * 4, acceleration=(0.0,) * 2, context=None, effort=None):
    """The Context of a controller a sample later."""
    context = context or system.CreateDefaultContext()
    system.GetInputPort("estimated_state").FixValue(context, state)
    system.GetInputPort("desired_state").FixValue(context, desired)
    system.GetInputPort("desired_acceleration").FixValue(context, acceleration)
    if effort is not None:
        system.GetInputPort("effort").FixValue(context, effort)
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    return context


@pytest.mark.parametrize("make", [passive, computed])
def test_the_estimate_nears_the_truth_faster_than_by_tracking_alone(make):
    fallen = []
    for prediction in (None, PredictionError(0.5)):
        _, logs = run(predicting(prediction, make), 1.0)
        check_estimates(logs)
        V = logs["lyapunov"].ravel()
        assert np.diff(V).max() <= 1e-4 * V[0]
        D = MANIFOLD.divergence(TRUTH, logs["parameters"])
        fallen.append(D[0] - D[-1])
    assert fallen[1] > 2.0 * fallen[0] > 0.0


def test_an_exact_sensor_of_efforts_says_what_the_controller_knows():
    own, measured = (
        run(predicting(PredictionError(0.5, measured=m)), 0.1)[1]["parameters"]
        for m in (False, True)
    )
    np.testing.assert_allclose(measured, own, rtol=1e-9)
    assert np.abs(own[-1] - START).max() > 1e-6


def test_a_step_is_by_the_sum_of_both_covectors():
    """Against the pure functions, from the second sample on, where there are filtered rows."""
    error = PredictionError([0.3, 0.2], bandwidth=30.0, tolerance=[0.01, 0.02])
    guards = Safeguards(drift=np.inf, dead_zone=0.0)  # states are random
    p = perturbed(0.2)
    system = predicting(error, law=natural(0.7), parameters=p, safeguards=guards)
    filtered = FilteredRegressor(CONTROL, STEP, 30.0, held_effort=True)
    memory, held, context = filtered.start(), np.zeros(2), None
    rng = np.random.default_rng(0)
    for _ in range(3):
        q, qd, q_d, v_d, a_d = rng.normal(size=(5, 2))
        context = told(system, [*q, *qd], [*q_d, *v_d], a_d, context)
        v, a = v_d - 10.0 * (q - q_d), a_d - 10.0 * (qd - v_d)
        sample = CONTROL.at(q, qd, v, a - 10.0 * (qd - v))
        memory = filtered.advanced(memory, q, qd, held)
        Y, u = filtered.rows(memory)
        wrong = Y @ p - u
        believed = np.sign(wrong) * np.maximum(np.abs(wrong) - [0.01, 0.02], 0.0)
        W = np.diag([0.3, 0.2])
        b = Y.T @ W @ believed
        pulls = MANIFOLD.inverse_metric_times(p, Y)
        b = b / (1.0 + STEP * np.trace(W @ (pulls @ Y.T)) / 0.7) + sample.covector(qd - v)
        held, p = sample.effort(p), natural(0.7).step(p, b, STEP)
        np.testing.assert_allclose(system.parameters(context), p, rtol=1e-9, atol=1e-12)


def test_what_is_remembered_is_not_undone():
    """Computed torque from a wrong estimate: errors are less by far, and D never rises."""
    worst = []
    for memory in (0.0, 1.0):
        error = PredictionError(1.0, alone=True, memory=memory)
        start = perturbed(0.1, 2)
        system = predicting(error, computed, natural(0.02), parameters=start, rate=15.0)
        limits = np.full(2, np.inf)
        found = list(moments(system, pendulum_plant(), motion(), [], limits=limits, end=3.5))
        D = MANIFOLD.divergence(TRUTH, np.array([moment.parameters for moment in found]))
        assert np.diff(D).max() <= 1e-4 * D[0]
        worst.append(max(np.abs(moment.error).max() for moment in found if moment.time > 2.0))
    assert worst[1] < 0.3 * worst[0]


def test_efforts_that_are_not_measured_move_nothing():
    """Tracking goes on to adapt by itself, and the filter leaves the samples out."""
    ends = []
    for prediction in (
        None,
        PredictionError(0.5, measured=True),
        PredictionError(1.0, measured=True, alone=True),
    ):
        system, context = predicting(prediction), None
        effort = None if prediction is None else [np.nan, 1e300]
        for k in range(5):
            state = np.array([0.1, 0.2, 0.3, -0.1]) * (1.0 + k)
            context = told(system, state, context=context, effort=effort)
        ends.append(system.parameters(context))
    tracking, both, alone = ends
    np.testing.assert_array_equal(both, tracking)
    np.testing.assert_array_equal(alone, START)
    assert np.abs(tracking - START).max() > 1e-6


def test_prediction_goes_on_where_efforts_are_at_their_limits():
    moved = []
    for prediction in (None, PredictionError(0.5)):
        system, context = predicting(prediction, safeguards=Safeguards(effort_limits=0.05)), None
        for k in range(4):
            state = np.array([0.5, 0.2, 0.3, -0.1]) * (1.0 + 0.01 * k)
            context = told(system, state, context=context)
            assert (np.abs(system.GetOutputPort("actuation").Eval(context)) <= 0.05).all()
        moved.append(np.abs(system.parameters(context) - START).max())
    assert moved[0] == 0.0 < moved[1]
