"""Adaptive controllers in Drake diagrams: guarantees, states, and faults."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_loops import (
    CONTROL,
    DAMPING,
    MANIFOLD,
    MODEL,
    MODELS,
    START,
    TRUTH,
    SlowSensor,
    check_estimates,
    computed,
    faulty,
    fixed,
    infinite,
    motion,
    natural,
    noisy,
    nothing,
    passive,
    pendulum_plant,
    perturbed,
    run,
    tracking_error,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from own_code import own_effect
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from diagrams.benchmarks.adaptive_soak import distances
from diagrams.studies.adaptive.faults import Episode, faulty_loop
from geodrake.control import (
    AdaptiveComputedTorqueController,
    ControlModel,
    FixedGains,
    PartialLaw,
    PassivityBasedAdaptiveController,
    PredictionError,
    Safeguards,
    VaryingGains,
    add_adaptive_loop,
    euclidean_adaptation,
    natural_adaptation,
    parameter_manifold,
    pullback_adaptation,
)
from geodrake.control.adaptation import adapted_parameters
from geodrake.control.adaptation.outer_laws import limited
from geodrake.control.systems.safeguards import InputMonitor
from geodrake.effects import FittedEffect
from geodrake.errors import ArgumentError
from geodrake.inertia import change_frame, is_physical
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
    """Check [Lee2019] Proposition 5.7 and Remark 5.1 with Drake's own dynamics and friction."""
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


@pytest.mark.parametrize(
    ("gains", "fault"), [("varying", None), ("varying", nothing), ("fixed", infinite)]
)
def test_the_compiled_step_is_the_one_step_by_step(monkeypatch, gains, fault):
    """The uncompiled step handles each fault and limit of efforts one by one."""
    found = []
    for compiled in (True, False):
        if not compiled:
            monkeypatch.setattr(PassivityBasedAdaptiveController, "_fast_step", None)
        sensor = faulty(fault, 0.2, 0.4) if fault else None
        guards = Safeguards(effort_limits=[30.0, 20.0], settling_time=0.05)
        controller = passive(natural(), gains=GAINS[gains], time_step=2e-3, safeguards=guards)
        assert (controller._fast_step is not None) == compiled
        found.append(run(controller, 0.8, sensor=sensor))
    time, logs = found[0]
    for name, values in logs.items():
        np.testing.assert_allclose(values, found[1][1][name], rtol=1e-7, atol=1e-8, err_msg=name)
    check_estimates(logs)
    during = logs["parameters"][(time > 0.202) & (time < 0.399)]
    assert np.array_equal(during, np.broadcast_to(during[0], during.shape)) == bool(fault)
    assert not np.array_equal(logs["parameters"][-1], during[-1])  # it goes on after a fault
    assert tracking_error(logs)[-10:].max() < 0.4


def test_lyapunov_value_of_computed_torque():
    """The value is ½ eᵀ P e + γ D, with the acceleration of the plant itself."""
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
    """Return a controller that adapts the last body by its prediction error."""
    options = {"parameters": WRONG, "time_step": STEP, **options}
    return make(law, prediction=prediction, **options)


def told(system, state, desired=(0.0,) * 4, acceleration=(0.0,) * 2, context=None, effort=None):
    """Return the Context of a controller a sample later."""
    measured = {} if effort is None else {"effort": effort}
    states = {"estimated_state": state, "desired_state": desired}
    context = fixed(system, context, **states, desired_acceleration=acceleration, **measured)
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    return context


def test_an_exact_sensor_of_efforts_says_what_the_controller_knows():
    own, measured = (
        run(predicting(PredictionError(0.5, measured=m)), 0.1)[1]["parameters"]
        for m in (False, True)
    )
    np.testing.assert_allclose(measured, own, rtol=1e-9)
    assert np.abs(own[-1] - WRONG).max() > 1e-6


def test_what_is_remembered_is_not_undone():
    """From a wrong estimate, computed torque reduces errors by far, and D never rises."""
    worst = []
    for memory in (0.0, 1.0):
        error = PredictionError(1.0, alone=True, memory=memory)
        start = perturbed(0.1, 2)
        system = predicting(error, computed, natural(0.02), parameters=start, rate=15.0)
        limits = np.full(2, np.inf)
        found = faulty_loop(system, pendulum_plant(), motion(), [], limits=limits, end=3.5)
        D = MANIFOLD.divergence(TRUTH, found.parameters)
        assert np.diff(D).max() <= 1e-4 * D[0]
        worst.append(np.abs(found.error[found.time > 2.0]).max())
    assert worst[1] < 0.3 * worst[0]


def test_efforts_that_are_not_measured_move_nothing():
    """Tracking continues to adapt, and the filter omits the samples."""
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


LIMITS = np.array([8.0, 4.0])
STRONG = Safeguards(LIMITS)
"""What is known of any robot: masses and friction within a factor of twenty."""

GAMMA = {"varying": 0.02, "fixed": 0.02, "filtered": 0.02, "accelerated": 0.2}


def controller(kind, **options):
    """Return a controller of a kind, with effort limits that the motion does not reach."""
    options = {"time_step": 2e-3, "safeguards": STRONG, **options}
    if kind in ("varying", "fixed"):
        gains = {"gains": FixedGains([6.0, 3.0], [6.0, 7.0])} if kind == "fixed" else {}
        return passive(natural(GAMMA[kind]), **gains, **options)
    prediction = FILTERED if kind == "filtered" else None
    return computed(natural(GAMMA[kind]), rate=15.0, prediction=prediction, **options)


def check(logs):
    """Check that all numbers are finite and within the limits, and every estimate is physical."""
    check_estimates(logs)
    assert (logs["parameters"][:, CONTROL.num_inertial :] > 0).all()
    assert (np.abs(logs["actuation"]) <= LIMITS + 1e-9).all()


def test_the_dead_zone_keeps_noise_from_moving_the_estimate():
    rest = PiecewisePolynomial(np.array([[0.7], [-0.4]]))
    moved = []
    for dead_zone in (0.0, 0.6):
        guards = Safeguards(LIMITS, dead_zone=dead_zone)
        system = controller("varying", safeguards=guards, parameters=TRUTH)
        sensor = faulty(noisy(1e-4, 0.05))
        _, logs = run(system, 1.0, sensor=sensor, size=rest)
        check(logs)
        moved.append(np.abs(logs["parameters"][-1] - TRUTH).max())
    assert moved[1] == 0.0 < moved[0]


Exponential = own_effect("exponential", columns=lambda self, j: [np.cumsum(np.exp(j.v))])
"""An effect that sees more than its own sample, and overflows."""


@pytest.mark.parametrize("time_step", [0.0, 1e-3])
def test_effects_that_overflow(time_step):
    """The last actuation is held, or none is applied."""
    fitted = (FittedEffect(Exponential(MODEL.joints[0]), np.array([0.1])),)
    model = replace(MODEL, effects=fitted)
    control, law = ControlModel.of(model), natural_adaptation(parameter_manifold(model))
    for system in (
        PassivityBasedAdaptiveController(control, law, time_step=time_step, truth=control.prior),
        AdaptiveComputedTorqueController(
            control, law, time_step=time_step, prediction=FILTERED if time_step else None
        ),
    ):
        states = dict.fromkeys(("estimated_state", "desired_state"), (0.0, 0.0, 1e4, 0.0))
        context = fixed(system, **states, desired_acceleration=np.zeros(2))
        if time_step > 0:
            context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
        else:
            rate = system.EvalTimeDerivatives(context).CopyToVector()
            np.testing.assert_array_equal(rate, 0.0)
        np.testing.assert_array_equal(system.GetOutputPort("actuation").Eval(context), 0.0)
        np.testing.assert_array_equal(system.parameters(context), control.prior)
        if system.HasOutputPort("lyapunov"):
            assert np.isfinite(system.GetOutputPort("lyapunov").Eval(context)).all()


ANY = st.one_of(
    st.floats(-3, 3),
    st.sampled_from([np.nan, np.inf, -np.inf, 1e12, -1e100, 1e154, -1e300, 5e-324]),
)
MESSAGE = st.lists(ANY, min_size=8, max_size=8)


@settings(max_examples=25)
@given(
    st.sampled_from(list(GAMMA)),
    st.sampled_from([0.0, 1e-3, 0.1]),
    st.booleans(),
    st.lists(MESSAGE, min_size=1, max_size=4),
)
def test_whatever_comes_in_numbers_come_out(kind, time_step, limited, messages):
    """Any input, alone or after another, leaves actuation finite and the estimate physical."""
    if kind == "filtered" and time_step == 0:
        return
    guards = STRONG if limited else Safeguards()
    system = controller(kind, time_step=time_step, safeguards=guards)
    context = system.CreateDefaultContext()
    for message in messages:
        values = np.array(message)
        more = {"acceleration": values[5:7]} if kind == "accelerated" else {}
        states = {"estimated_state": values[:4], "desired_state": values[4:]}
        fixed(system, context, **states, desired_acceleration=values[2:4], **more)
        if time_step > 0:
            state = system.EvalUniquePeriodicDiscreteUpdate(context)
            context.SetDiscreteState(state)
        else:
            rate = system.EvalTimeDerivatives(context).CopyToVector()
            assert np.isfinite(rate).all()
        assert np.isfinite(system.GetOutputPort("actuation").Eval(context)).all()
        assert np.isfinite(system.GetOutputPort("lyapunov").Eval(context)).all()
        p = system.GetOutputPort("parameters").Eval(context)
        assert is_physical(p[: CONTROL.num_inertial].reshape(-1, 10)).all()


# A second of faults


BEGIN, STOP = 1.0, 2.0  # of a fault, s
USUAL = 0.1  # rad, error of a joint under a sound sensor
PATIENCE, GROWTH = 3.5, 3.0  # s until tracking is as before, and times the estimate's distance


def interrupted(kind, law, model):
    """Return an interrupted loop, and the distance of its estimates from the truth."""
    control, manifold = ControlModel.of(model), parameter_manifold(model)
    options = {
        "time_step": 2e-3,
        "parameters": perturbed(0.1, 0, control.prior, control),
        "safeguards": STRONG,
    }
    chosen = euclidean_adaptation(len(control.prior), 50.0)
    if law == "natural":
        chosen = natural_adaptation(manifold, 0.02)
    if kind == "passivity":
        return PassivityBasedAdaptiveController(control, chosen, **options)
    prediction = PredictionError(1.0, alone=True, memory=1.0)
    return AdaptiveComputedTorqueController(
        control, chosen, rate=15.0, prediction=prediction, **options
    )


@pytest.mark.parametrize(
    ("kind", "law", "friction", "fault"),
    [
        ("passivity", "natural", True, "noise"),
        ("passivity", "natural", True, "dropped"),
        ("computed torque", "natural", True, "stuck"),
        ("computed torque", "euclidean", True, "turns"),
        ("computed torque", "natural", False, "reversed joint"),
    ],
)
def test_a_second_of_faults_ruins_no_estimate(kind, law, friction, fault):
    """The benchmark `adaptive_soak` runs hours of all faults with other seeds."""
    model = MODEL if friction else replace(MODEL, effects=())
    system = interrupted(kind, law, model)
    episode, end = Episode(fault, BEGIN, STOP), STOP + PATIENCE + 0.5
    path = motion(duration=end + 1.0)
    plant = pendulum_plant(damping=DAMPING if friction else 0.0)
    found = faulty_loop(system, plant, path, [episode], limits=LIMITS, end=end, seed=0)
    time, estimates, error = found.time, found.parameters, np.abs(found.error).max(1)
    off = np.linalg.norm(estimates - system.control.prior, axis=1)
    if law == "natural":
        off = distances(system.control, estimates)  # which are geodesic
    assert off[-1] <= GROWTH * off[time <= BEGIN][-1]
    assert error[time >= STOP + PATIENCE].max() < max(USUAL, 2.0 * error[time <= BEGIN].max())
    phi = estimates[:, : system.control.num_inertial].reshape(len(time), -1, 10)
    if law == "natural":
        assert is_physical(phi).all()
        masses = phi[:, :, 0] / system.control.phi(system.control.prior)[:, 0]
        assert masses.max() < 20.0


@pytest.mark.parametrize(
    ("sample", "wrong"), [(0, [0.0, 0.0]), (500, [2.0 * np.pi, 0.0]), (500, [0.0, 1e3])]
)
def test_good_sensors_are_believed_outliers_are_not_and_stuck_encoders_within_their_drift(
    sample, wrong
):
    t, told = 2e-3 * np.arange(1250), []
    states = np.stack([np.sin(3.0 * t), 3.0 * np.cos(3.0 * t)], axis=1)
    states += [1e-3, 0.05] * np.random.default_rng(0).normal(size=states.shape)
    states[sample] += wrong
    states[1100:, 0] = states[1100, 0]
    watch = InputMonitor(1, 2e-3, 0.05, 0.02, 1.0)
    memory = watch.start()
    for state in states:
        seen, memory = watch.observe(memory, state, np.zeros(2), np.zeros(1))
        told.append((bool(seen.q == state[:1]), seen.trusted))
    told, first = np.array(told), 1100 + int(np.argmin(np.array(told)[1100:, 0]))
    assert told[:first, 0].sum() == first - (sample > 0) and told[sample, 0] == (sample == 0)
    assert (~told[500:1000, 1]).sum() == (500 if sample else 0)
    assert np.abs(states[1100:first, 1]).sum() * 2e-3 < 2 * 0.02 and not told[first:, 1].any()


def test_what_was_learned_just_before_an_interruption_is_not_believed():
    """A jump of the desired motion takes efforts to their limits."""
    system = interrupted("passivity", "natural", MODEL)
    context, p = system.CreateDefaultContext(), []
    steady, jump = np.array([0.3, -0.2, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    fixed(system, context, desired_acceleration=np.zeros(2))
    rng = np.random.default_rng(0)
    for k in range(1800):
        wanted = steady + jump * (1e-3 * np.sin(0.01 * k) + 2.0 * (k == 1000))
        fixed(system, context, estimated_state=steady + 1e-6 * rng.random(4), desired_state=wanted)
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
        p.append(system.parameters(context))
    then = [k for k in range(750, 876) if np.array_equal(p[k], p[1000])]
    assert then and not np.array_equal(p[999], p[1000])
    assert np.ptp(p[1000:1500], axis=0).max() == 0.0 and not np.array_equal(p[1600], p[1000])


def test_no_frame_matters_to_limits_about_a_model():
    turned = np.array([[0.0, -0.6, 0.8], [0.0, 0.8, 0.6], [-1.0, 0.0, 0.0]])
    link, law = CONTROL.phi(TRUTH)[0], natural_adaptation(PhysicalInertia())
    for phi in (link, change_frame(link, turned, np.array([0.3, -0.2, 0.5]))):
        held = np.concatenate([phi, [1.0]])
        partial = limited(PartialLaw(law, np.arange(11) < 10), held[None], 10.0)
        limits = partial.law.constraints
        np.testing.assert_allclose([limits.lower, limits.upper], [[0.4], [40.0]])
        np.testing.assert_allclose(limits.matrix @ phi, 4.0)


def test_leakage_takes_the_estimate_to_the_model():
    """Besides the effect of b, D(p₀‖p̂) falls by σ (D(p₀‖p̂) + D(p̂‖p₀)) h in a step h."""
    p, b, h = perturbed(0.2), 1e-9 * np.ones(len(TRUTH)), 1e-4
    law = replace(natural(0.3), leakage=2.0, toward=TRUTH)
    before = MANIFOLD.divergence(TRUTH, p)
    symmetric = before + MANIFOLD.divergence(p, TRUTH)
    for moved in (law, limited(law, [TRUTH, p], 5.0)):
        fallen = before - MANIFOLD.divergence(TRUTH, moved.step(p, b, h))
        np.testing.assert_allclose(fallen, 2.0 * h * symmetric, rtol=1e-2)
        np.testing.assert_array_equal(moved.step(p, 0.0 * b, h), natural().step(p, 0.0 * b, h))
    for toward in (None, -TRUTH, TRUTH[:3]):
        with pytest.raises(ArgumentError):
            replace(law, toward=toward)
