"""Composite adaptation: by tracking errors and errors of prediction, alone and together."""

import numpy as np
import pytest
from adaptive_loops import (
    CONTROL,
    MANIFOLD,
    MODEL,
    TRUTH,
    check_estimates,
    motion,
    natural,
    pendulum_plant,
    perturbed,
    run,
)

from diagrams.studies.adaptive.faults import moments
from geodrake.control.adaptation import (
    PartialLaw,
    adapted_parameters,
    natural_adaptation,
)
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.systems import (
    AdaptiveComputedTorqueController,
    PassivityBasedAdaptiveController,
    PredictionError,
    Safeguards,
)
from geodrake.control.systems.prediction_error import Prediction
from geodrake.control.systems.safeguards import Seen
from geodrake.manifolds import PhysicalInertia

LAST = adapted_parameters(MODEL, [MODEL.bodies[-1]])
START = np.where(LAST, perturbed(0.3), TRUTH)
LAW = PartialLaw(natural_adaptation(PhysicalInertia(), 0.1), LAST)
STEP = 2e-3


def passive(prediction, law=LAW, **options):
    options = {"parameters": START, "truth": TRUTH, "time_step": STEP, **options}
    return PassivityBasedAdaptiveController(CONTROL, law, prediction=prediction, **options)


def computed(prediction, law=LAW, **options):
    options = {"parameters": START, "truth": TRUTH, "time_step": STEP, **options}
    return AdaptiveComputedTorqueController(CONTROL, law, prediction=prediction, **options)


@pytest.mark.parametrize("make", [passive, computed])
def test_the_estimate_nears_the_truth_faster_than_by_tracking_alone(make):
    fallen = []
    for prediction in (None, PredictionError(0.5)):
        _, logs = run(make(prediction), 1.0)
        check_estimates(logs)
        V = logs["lyapunov"].ravel()
        assert np.diff(V).max() <= 1e-4 * V[0]
        D = MANIFOLD.divergence(TRUTH, logs["parameters"])
        fallen.append(D[0] - D[-1])
    assert fallen[1] > 2.0 * fallen[0] > 0.0


def test_an_exact_sensor_of_efforts_says_what_the_controller_knows():
    own, measured = (run(passive(PredictionError(0.5, measured=m)), 0.1)[1] for m in (False, True))
    np.testing.assert_allclose(measured["parameters"], own["parameters"], rtol=1e-9)
    assert np.abs(own["parameters"][-1] - START).max() > 1e-6


def test_a_step_is_by_the_sum_of_both_covectors():
    """Against the pure functions, from the second sample on, where there are filtered rows."""
    error = PredictionError([0.3, 0.2], bandwidth=30.0, tolerance=[0.01, 0.02])
    guards = Safeguards(drift=np.inf, dead_zone=0.0)  # states are random
    system = passive(error, natural(0.7), parameters=perturbed(0.2), safeguards=guards)
    context = system.CreateDefaultContext()
    filtered = FilteredRegressor(CONTROL, STEP, 30.0, held_effort=True)
    memory, held, p = filtered.start(), np.zeros(2), perturbed(0.2)
    rng = np.random.default_rng(0)
    for _ in range(3):
        q, qd, q_d, v_d, a_d = rng.normal(size=(5, 2))
        system.GetInputPort("estimated_state").FixValue(context, np.concatenate([q, qd]))
        system.GetInputPort("desired_state").FixValue(context, np.concatenate([q_d, v_d]))
        system.GetInputPort("desired_acceleration").FixValue(context, a_d)
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
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
        np.testing.assert_allclose(system.parameters(context), p, rtol=1e-9, atol=1e-12)
    # All of it is in the Context: a clone goes on alike, and a fresh one begins anew.
    ends = [
        system.EvalUniquePeriodicDiscreteUpdate(one).value(0) for one in (context, context.Clone())
    ]
    np.testing.assert_array_equal(*ends)
    np.testing.assert_array_equal(system.parameters(system.CreateDefaultContext()), perturbed(0.2))


def test_rows_are_remembered():
    """Against sums over all samples so far, each of which fades with time."""
    error = PredictionError([0.3, 0.2], 30.0, [0.01, 0.02], alone=True, memory=0.5)
    prediction = Prediction(error, CONTROL, STEP)
    filtered = FilteredRegressor(CONTROL, STEP, 30.0, held_effort=True)
    memory, own, W = prediction.start(), filtered.start(), np.diag([0.3, 0.2])
    rng, law, past = np.random.default_rng(0), natural(0.7), []
    for k in range(5):
        p, (q, qd, effort) = perturbed(0.2, k), rng.normal(size=(3, 2))
        sample = CONTROL.at(q, qd, qd, np.zeros(2))
        seen = Seen(q, qd, q, qd, 0 * q, True, False, True, True)
        memory = prediction.advanced(memory, p, seen, effort, sample)
        own = filtered.advanced(own, q, qd, effort)
        if k == 2:
            memory, own = prediction.skipped(memory), filtered.skipped(own)
        Y, u = filtered.rows(own)
        believed = Y @ p - np.sign(Y @ p - u) * np.maximum(np.abs(Y @ p - u) - [0.01, 0.02], 0.0)
        past.append((Y, believed))
        fading = np.exp(-np.arange(k, -1, -1) * STEP / 0.5) * -np.expm1(-30.0 * STEP)
        b = Y.T @ W @ (Y @ p - believed)
        reach = np.trace(W @ Y @ MANIFOLD.inverse_metric_times(p, Y).T) / 0.7
        for share, (Z, z) in zip(fading, past, strict=True):
            b = b + share * Z.T @ W @ (Z @ p - z)
            reach += share * np.trace(W @ Z @ MANIFOLD.inverse_metric_times(p, Z).T) / 0.7
        found = prediction.covector(law, p, memory)
        np.testing.assert_allclose(found, b / (1.0 + STEP * reach), rtol=1e-6, atol=1e-9)


def test_what_is_remembered_is_not_undone():
    """Computed torque from a wrong estimate: errors are less by far, and D never rises."""
    worst = []
    for memory in (0.0, 1.0):
        error = PredictionError(1.0, alone=True, memory=memory)
        system = computed(error, natural(0.02), parameters=perturbed(0.1, 2), rate=15.0)
        limits = np.full(2, np.inf)
        found = list(moments(system, pendulum_plant(), motion(), [], limits=limits, end=5.0))
        D = MANIFOLD.divergence(TRUTH, np.array([moment.parameters for moment in found]))
        assert np.diff(D).max() <= 1e-4 * D[0]
        worst.append(max(np.abs(moment.error).max() for moment in found if moment.time > 2.0))
    assert worst[1] < 0.3 * worst[0]


def test_efforts_that_are_not_measured_move_nothing():
    """Tracking goes on to adapt by itself, and the filter leaves the samples out."""
    ends = {}
    for name, prediction in (
        ("none", None),
        ("measured", PredictionError(0.5, measured=True)),
        ("alone", PredictionError(1.0, measured=True, alone=True)),
    ):
        system = passive(prediction)
        context = system.CreateDefaultContext()
        for k in range(5):
            x = np.array([0.1, 0.2, 0.3, -0.1]) * (1.0 + k)
            system.GetInputPort("estimated_state").FixValue(context, x)
            system.GetInputPort("desired_state").FixValue(context, np.zeros(4))
            system.GetInputPort("desired_acceleration").FixValue(context, np.zeros(2))
            if prediction is not None:
                system.GetInputPort("effort").FixValue(context, [np.nan, 1e300])
            context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
        ends[name] = system.parameters(context)
    np.testing.assert_array_equal(ends["measured"], ends["none"])
    np.testing.assert_array_equal(ends["alone"], START)
    assert np.abs(ends["none"] - START).max() > 1e-6


def test_prediction_goes_on_where_efforts_are_at_their_limits():
    tight = Safeguards(effort_limits=0.05)
    moved = {}
    for name, prediction in (("tracking", None), ("both", PredictionError(0.5))):
        system = passive(prediction, safeguards=tight)
        context = system.CreateDefaultContext()
        for k in range(4):
            x = np.array([0.5, 0.2, 0.3, -0.1]) * (1.0 + 0.01 * k)
            system.GetInputPort("estimated_state").FixValue(context, x)
            system.GetInputPort("desired_state").FixValue(context, np.zeros(4))
            system.GetInputPort("desired_acceleration").FixValue(context, np.zeros(2))
            context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
            assert (np.abs(system.GetOutputPort("actuation").Eval(context)) <= 0.05).all()
        moved[name] = np.abs(system.parameters(context) - START).max()
    assert moved["tracking"] == 0.0 < moved["both"]
