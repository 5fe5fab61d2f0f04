"""Adaptive controllers in Drake diagrams: guarantees, the life of a system, and prediction."""

import numpy as np
import pytest
from adaptive_loops import (
    CONTROL,
    MANIFOLD,
    MODEL,
    MODELS,
    START,
    TRUTH,
    FaultySensor,
    SlowSensor,
    check_estimates,
    computed,
    motion,
    natural,
    nothing,
    passive,
    pendulum_plant,
    perturbed,
    run,
    tracking_error,
)
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from diagrams.studies.adaptive.faults import moments
from geodrake.control import (
    FixedGains,
    PartialLaw,
    PassivityBasedAdaptiveController,
    PredictionError,
    VaryingGains,
    add_adaptive_loop,
    euclidean_adaptation,
    natural_adaptation,
    pullback_adaptation,
)
from geodrake.control.adaptation import ProjectedLaw, adapted_parameters, mass_limits
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.systems import Safeguards
from geodrake.errors import ArgumentError
from geodrake.manifolds import PhysicalInertia

FILTERED = PredictionError(1.0, alone=True)
GAINS = {"varying": VaryingGains(8.0), "fixed": FixedGains([8.0, 4.0], [6.0, 7.0])}


# The laws of [Lee2019] Chapter 5 in closed loop


@pytest.mark.parametrize(
    ("law", "gains", "time_step"),
    [
        ("natural", "varying", 0.0),
        ("natural", "fixed", 1e-3),
        ("natural", "varying", 4e-3),
        ("euclidean", "varying", 0.0),
        ("pullback", "varying", 0.0),
    ],
)
def test_lyapunov_value_never_rises(law, gains, time_step):
    """[Lee2019] Proposition 5.7 and Remark 5.1, by Drake's own dynamics with Drake's friction."""
    laws = {
        "natural": natural(),
        "euclidean": euclidean_adaptation(len(TRUTH), 50.0),
        "pullback": pullback_adaptation(MANIFOLD, START),
    }
    _, logs = run(passive(laws[law], gains=GAINS[gains], time_step=time_step), 0.6)
    V = logs["lyapunov"].ravel()
    rise = 2e-6 if time_step == 0 else 0.05 * time_step
    assert np.diff(V).max() <= rise * V[0]
    assert V[-1] < V[0]
    if law == "natural":
        check_estimates(logs)


@pytest.mark.parametrize("gains", GAINS)
@pytest.mark.parametrize("fault", [None, nothing])
def test_the_compiled_step_is_the_one_step_by_step(monkeypatch, gains, fault):
    """Steps with faults and limits of efforts too, which are made one by one."""
    found = []
    for compiled in (True, False):
        if not compiled:
            monkeypatch.setattr(PassivityBasedAdaptiveController, "_usual", None)
        sensor = FaultySensor(4, fault, 0.1, 0.2) if fault else None
        guards = Safeguards(effort_limits=[30.0, 20.0], settling_time=0.05)
        controller = passive(natural(), gains=GAINS[gains], time_step=2e-3, safeguards=guards)
        assert (controller._usual is not None) == compiled
        found.append(run(controller, 0.5, sensor=sensor)[1])
    for name, values in found[0].items():
        np.testing.assert_allclose(values, found[1][name], rtol=1e-7, atol=1e-8, err_msg=name)


def test_lyapunov_value_of_computed_torque():
    """½ eᵀ P e + γ D with the acceleration of the plant itself."""
    controller = computed(natural(0.02), time_step=0.0, rate=6.0)
    _, logs = run(controller, 0.8)
    V = logs["lyapunov"].ravel()
    assert np.diff(V).max() <= 2e-6 * V[0]
    fixed = run(computed(None, time_step=0.0, rate=6.0), 0.8)[1]
    assert tracking_error(logs).max() < 0.3 * tracking_error(fixed).max()


def test_filtered_computed_torque_with_a_sensor_of_a_third_of_the_rate():
    controller = computed(natural(1e-2), rate=10.0, prediction=FILTERED)
    _, logs = run(controller, 1.5, sensor=SlowSensor(4, 3e-3))
    V = logs["lyapunov"].ravel()
    assert np.diff(V).max() <= 1e-3 * V[0]
    assert V[-1] < 0.97 * V[0]


def test_actuation_is_the_formula_of_the_source():
    """u against [Lee2019] Eq. (5.2.10) and Remark 5.1 from Drake's own mass matrix and bias."""
    rng = np.random.default_rng(0)
    q, qd, q_d, v_d, a_d = rng.normal(size=(5, 2))
    plant = pendulum_plant(damping=0.0)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    M = plant.CalcMassMatrix(context)
    gravity = -plant.CalcGravityGeneralizedForces(context)
    damping = np.array([0.3, 0.3])

    def bias(velocity):
        plant.SetVelocities(context, velocity)
        return plant.CalcBiasTerm(context)

    def coriolis(v):  # C(q, q̇) v is bilinear and symmetric for Christoffel symbols
        return 0.25 * (bias(qd + v) - bias(qd - v))

    for name, gains in GAINS.items():
        system = passive(parameters=TRUTH, gains=gains, time_step=0.0)
        own = system.CreateDefaultContext()
        for port, value in (
            ("estimated_state", np.concatenate([q, qd])),
            ("desired_state", np.concatenate([q_d, v_d])),
            ("desired_acceleration", a_d),
        ):
            system.GetInputPort(port).FixValue(own, value)
        rate = np.asarray(gains.rate)
        v, a = v_d - rate * (q - q_d), a_d - rate * (qd - v_d)
        r = qd - v
        K_r = gains.rate * (M @ r) if name == "varying" else np.array(gains.damping) * r
        expected = M @ a + coriolis(v) + gravity + damping * v - K_r
        np.testing.assert_allclose(
            system.GetOutputPort("actuation").Eval(own), expected, rtol=1e-9, atol=1e-9
        )


def test_constraints_hold_all_the_way():
    truth = TRUTH[10]
    law = ProjectedLaw(natural(), mass_limits(len(TRUTH), 1, 0.9 * truth, 1.1 * truth))
    start = TRUTH.copy()
    start[10:20] *= 1.08
    _, logs = run(passive(law, parameters=start), 1.0)
    masses = logs["parameters"][:, 10]
    assert (masses >= 0.9 * truth * (1 - 1e-9)).all()
    assert (masses <= 1.1 * truth * (1 + 1e-9)).all()


# The life of a Drake system


def test_actuators_in_another_order():
    plain = run(passive(), 0.1)[1]["actuation"]
    plant = pendulum_plant(reverse=True)
    turned = run(passive(), 0.1, plant=plant)[1]["actuation"]
    np.testing.assert_allclose(turned, plain, rtol=1e-6, atol=1e-8)


def test_parameters_can_be_set_in_a_context():
    for time_step in (0.0, 1e-3):
        system = passive(time_step=time_step)
        context = system.CreateDefaultContext()
        system.set_parameters(context, TRUTH)
        np.testing.assert_array_equal(system.parameters(context), TRUTH)
        np.testing.assert_array_equal(system.GetOutputPort("parameters").Eval(context), TRUTH)
        with pytest.raises(ArgumentError, match="inside the law's manifold"):
            system.set_parameters(context, -TRUTH)


def test_only_what_is_needed_is_read():
    """Ports that do not matter to an output need no value, and no loop is closed through them."""
    system = computed(time_step=0.0)

    def feeds(system, source, sink):
        i, o = system.GetInputPort(source).get_index(), system.GetOutputPort(sink).get_index()
        return system.HasDirectFeedthrough(int(i), int(o))

    assert feeds(system, "estimated_state", "actuation")
    assert not feeds(system, "acceleration", "actuation")
    assert not feeds(system, "estimated_state", "parameters")
    assert not feeds(computed(), "estimated_state", "actuation")
    assert feeds(computed(), "estimated_state", "lyapunov")
    assert "lyapunov" not in [passive(truth=None).get_output_port(i).get_name() for i in range(2)]


@pytest.mark.parametrize(
    ("actuated", "welded", "message"),
    [(["shoulder"], True, "none at elbow"), (["shoulder", "elbow"], False, "WeldFrames")],
)
def test_plants_that_do_not_fit_are_refused(actuated, welded, message):
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    Parser(plant).AddModels(str(MODELS / "double_pendulum.urdf"))
    if welded:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    for number, joint in enumerate(actuated):
        plant.AddJointActuator(f"motor_{number}", plant.GetJointByName(joint))
    plant.Finalize()
    with pytest.raises(ArgumentError, match=message):
        add_adaptive_loop(builder, plant, passive(), motion())


# By tracking errors and errors of prediction, alone and together


LAST = adapted_parameters(MODEL, [MODEL.bodies[-1]])
WRONG = np.where(LAST, perturbed(0.3), TRUTH)
LAW = PartialLaw(natural_adaptation(PhysicalInertia(), 0.1), LAST)
STEP = 2e-3


def predicting(prediction, make=passive, law=LAW, **options):
    """A controller that adapts the last body by what it predicts."""
    options = {"parameters": WRONG, "time_step": STEP, **options}
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
    assert np.abs(own[-1] - WRONG).max() > 1e-6


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
    np.testing.assert_array_equal(alone, WRONG)
    assert np.abs(tracking - WRONG).max() > 1e-6


def test_prediction_goes_on_where_efforts_are_at_their_limits():
    moved = []
    for prediction in (None, PredictionError(0.5)):
        system, context = predicting(prediction, safeguards=Safeguards(effort_limits=0.05)), None
        for k in range(4):
            state = np.array([0.5, 0.2, 0.3, -0.1]) * (1.0 + 0.01 * k)
            context = told(system, state, context=context)
            assert (np.abs(system.GetOutputPort("actuation").Eval(context)) <= 0.05).all()
        moved.append(np.abs(system.parameters(context) - WRONG).max())
    assert moved[0] == 0.0 < moved[1]
