"""Online estimation: filtered rows, updates, the estimator, and log players."""

import inspect
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
import yaml
from adaptive_loops import (
    CONTROL,
    MANIFOLD,
    MODEL,
    MODELS,
    TRUTH,
    check_estimates,
    computed,
    faulty,
    nothing,
    passive,
    pendulum_plant,
    perturbed,
    simulator,
    states_along,
)
from chain_logs import inverse_dynamics
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from scipy.signal import lfilter

from geodrake.control import (
    BregmanProjectionEstimator,
    ControlModel,
    DelayedEffort,
    EffectForce,
    LogSource,
    ModelResidual,
    PassivityBasedAdaptiveController,
    PredictionError,
    SampleUpdate,
)
from geodrake.control.adaptation import mass_limits
from geodrake.control.online_estimation import FilteredRegressor, slab_step
from geodrake.effects import JointElasticity
from geodrake.errors import ArgumentError, LogError
from geodrake.logs import JointLog
from geodrake.manifolds import (
    ConstrainedInertia,
    Free,
    Interval,
    PhysicalInertia,
    Positive,
    Product,
)
from geodrake.model import load_description

STEP = 2e-3
QUANTITIES = ("time", "position", "velocity", "effort")
UPDATE = SampleUpdate(MANIFOLD, np.full(2, 0.005))


def recorded(duration=4.0, truth=TRUTH, gap=()):
    """Return a log of the double pendulum along a motion, with exact efforts of some parameters."""
    time = STEP * np.arange(round(duration / STEP) + 1)
    q, v, a = states_along(time)
    rows = zip(q, v, a, strict=True)
    effort = np.array([CONTROL.at(q, v, v, a).effort(truth) for q, v, a in rows])
    kept = np.ones(len(time), bool)
    if gap:
        kept[slice(*gap)] = False
    return JointLog("made", MODEL.joints, 3.0 + time[kept], q[kept], effort[kept], velocity=v[kept])


def estimated(log, *, start=TRUTH, sensor=None, update=UPDATE, every=1):
    """Return times and outputs of an estimator for a log."""
    builder = DiagramBuilder()
    source = builder.AddSystem(LogSource(log, MODEL.joints))
    system = builder.AddSystem(
        BregmanProjectionEstimator(
            CONTROL, update, time_step=STEP, parameters=start, update_every=every
        )
    )
    state = source.GetOutputPort("state")
    if sensor is not None:
        builder.AddSystem(sensor)
        builder.Connect(state, sensor.get_input_port())
        state = sensor.get_output_port()
    builder.Connect(state, system.GetInputPort("estimated_state"))
    builder.Connect(source.GetOutputPort("effort"), system.GetInputPort("effort"))
    sinks = [LogVectorOutput(system.get_output_port(i), builder, 0.02) for i in range(3)]
    found = simulator(builder.Build())
    found.AdvanceTo(source.duration)
    logs = [sink.FindLog(found.get_context()) for sink in sinks]
    return logs[0].sample_times(), *(np.array(log.data().T) for log in logs)


# The estimator


def unexplained(p):
    """Return the RMS of the effort along the motion that an estimate does not explain, N·m."""
    rows = zip(*states_along(np.arange(0.0, 4.0, 0.02)), strict=True)
    left = [CONTROL.at(q, v, v, a).regressor @ (p - TRUTH) for q, v, a in rows]
    return np.sqrt(np.mean(np.square(left)))


def test_the_estimate_explains_what_is_measured():
    """Exact projections, the default, have a certificate and go farther than single steps."""
    start, fallen = perturbed(0.3), {}
    for method in ("projection", "nudge"):
        update = SampleUpdate(MANIFOLD, np.full(2, 0.005), method=method)
        _, p, residual, error = estimated(recorded(), start=start, every=2, update=update)
        check_estimates({"parameters": p})
        D = MANIFOLD.divergence(TRUTH, p)
        assert np.diff(D).max() < 1e-6
        assert unexplained(p[-1]) < 0.2 * unexplained(p[0])
        assert np.abs(residual).max() < 0.2
        fallen[method] = D[0] - D[-1]
        certified = error[1:] <= 1e-8
        assert certified.all() if method == "projection" else not certified.any()
    assert fallen["projection"] > 1.3 * fallen["nudge"]


@pytest.mark.parametrize("fault", [None, nothing, "frozen"])
def test_the_compiled_update_is_the_one_step_by_step(monkeypatch, fault):
    """The estimate stays while a sensor fails, and continues after it."""
    found = []
    for compiled in (True, False):
        if not compiled:
            monkeypatch.setattr(SampleUpdate, "compiled", None)
        sensor = faulty(fault, 0.5, 0.9) if fault else None
        found.append(estimated(recorded(1.5), start=perturbed(0.3), sensor=sensor))
    for one, other in zip(*(each[:3] for each in found), strict=True):  # (errors are of rounding)
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(found[0][3] <= 1e-8, found[1][3] <= 1e-8)
    time, p, residual, _ = found[0]
    check_estimates({"parameters": p, "residual": residual})
    assert np.diff(MANIFOLD.divergence(TRUTH, p)).max() < 1e-3
    during = p[(time > 0.61) & (time < 0.89)]
    assert np.array_equal(during, np.broadcast_to(during[0], during.shape)) == bool(fault)
    assert not np.array_equal(p[-1], during[-1])


def test_estimators_that_do_not_fit_are_refused():
    with pytest.raises(ArgumentError, match="filter has a period of"):
        BregmanProjectionEstimator(CONTROL, UPDATE, filtered=FilteredRegressor(CONTROL, 0.01))
    other = FilteredRegressor(ControlModel.of(MODEL), STEP)
    with pytest.raises(ArgumentError, match="another ControlModel"):
        BregmanProjectionEstimator(CONTROL, UPDATE, filtered=other, time_step=STEP)
    with pytest.raises(ArgumentError, match="another ControlModel"):
        ModelResidual(CONTROL, filtered=other)
    with pytest.raises(ArgumentError, match="inside the law's manifold"):
        BregmanProjectionEstimator(CONTROL, UPDATE, parameters=-TRUTH)
    with pytest.raises(ArgumentError, match="tolerance"):
        BregmanProjectionEstimator(CONTROL, SampleUpdate(MANIFOLD, np.ones(3)))


# The player of logs


def played(source, time):
    context = source.CreateDefaultContext()
    context.SetTime(time)
    names = ("position", "velocity", "effort", "state")
    return {name: source.GetOutputPort(name).Eval(context) for name in names}


def test_logs_are_played_from_their_first_sample():
    log = recorded(1.0)
    source = LogSource(log, MODEL.joints[::-1])
    assert source.duration == pytest.approx(1.0)
    for time, share in ((0.0, 0.0), (0.1, 0.0), (0.1007, 0.35)):
        i = int(time / STEP + 1e-6)
        found = played(source, time)
        for name in ("position", "velocity", "effort"):
            values = getattr(log, name)[:, ::-1]
            expected = (1 - share) * values[i] + share * values[i + 1]
            np.testing.assert_allclose(found[name], expected, rtol=1e-7, atol=1e-9)
        np.testing.assert_array_equal(found["state"], [*found["position"], *found["velocity"]])
    after = played(source, 5.0)
    np.testing.assert_array_equal(after["position"], log.position[-1, ::-1])
    np.testing.assert_array_equal(after["velocity"], 0.0)


def test_logs_without_velocities_and_with_gaps():
    log = recorded(1.0, gap=(100, 200))
    bare = JointLog("made", log.joints, log.time, log.position, log.effort)
    source = LogSource(bare)
    np.testing.assert_allclose(played(source, 0.1)["velocity"], log.velocity[50], atol=1e-4)
    assert np.isnan(played(source, 0.3)["state"]).all()
    assert np.isfinite(played(LogSource(bare, largest_gap=1.0), 0.3)["state"]).all()


def test_logs_that_cannot_be_played():
    with pytest.raises(LogError):
        LogSource(recorded(0.1), ["wrist"])
    short = recorded(0.1)
    with pytest.raises(ArgumentError, match="gap"):
        LogSource(short, largest_gap=np.nan)
    with pytest.raises(ArgumentError, match="needs two"):
        LogSource(replace(short, **{name: getattr(short, name)[:1] for name in QUANTITIES}))


# The comparison


def compared(log, filtered):
    """Return residuals of a log every 0.02 s, and which of them are valid."""
    builder = DiagramBuilder()
    source = builder.AddSystem(LogSource(log, MODEL.joints))
    system = builder.AddSystem(ModelResidual(CONTROL, filtered=filtered))
    builder.Connect(source.GetOutputPort("state"), system.GetInputPort("estimated_state"))
    builder.Connect(source.GetOutputPort("effort"), system.GetInputPort("effort"))
    sinks = [LogVectorOutput(system.get_output_port(i), builder, 0.02) for i in range(2)]
    found = simulator(builder.Build())
    found.AdvanceTo(source.duration)
    return [np.array(sink.FindLog(found.get_context()).data().T) for sink in sinks]


def test_the_residual_is_what_the_model_lacks():
    """It is low-pass filtered friction of 0.5 N·m·s/rad, and invalid in a gap."""
    more = TRUTH.copy()
    more[20] += 0.5
    log = recorded(2.0, more, gap=(500, 600))
    residual, valid = compared(log, FilteredRegressor(CONTROL, STEP, 60.0, 1))
    assert np.isfinite(residual).all() and (valid[1:50] == 1.0).all()
    assert (valid[52:60] == 0.0).all() and (valid[62:] == 1.0).all()
    friction = 0.5 * log.velocity[:, 0]
    expected = np.interp(np.arange(len(residual)) * 0.02 - 1 / 60, log.time - 3.0, friction)
    assert np.abs(residual[20:50, 0] - expected[20:50]).max() < 0.02
    assert np.abs(residual[:, 1]).max() < 1e-3


# What every system says of its ports


def systems_with_all_ports():
    measured = PredictionError(measured=True)
    yield passive(prediction=measured)
    yield computed()
    yield computed(prediction=measured)
    yield BregmanProjectionEstimator(CONTROL, UPDATE)
    yield ModelResidual(CONTROL)
    yield ModelResidual(CONTROL, filtered=FilteredRegressor(CONTROL, 0.1))
    yield LogSource(recorded(0.1))
    yield EffectForce(pendulum_plant(), [(JointElasticity("elbow"), [1e-3])])
    yield DelayedEffort(0.01)


def test_docstrings_name_the_ports():
    """Compare the block diagrams of Drake's documentation with the ports."""
    ports = defaultdict(lambda: (set(), set()))
    for system in systems_with_all_ports():
        inputs, outputs = ports[type(system)]
        inputs |= {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}
        outputs |= {system.get_output_port(i).get_name() for i in range(system.num_output_ports())}
    for kind, found in ports.items():
        text = inspect.getdoc(kind).split(".. pydrake_system::\n\n")[1].split("\n\n")[0]
        said = yaml.safe_load(text)
        assert said["name"] == kind.__name__
        assert (set(said.get("input_ports", [])), set(said["output_ports"])) == found


def test_floating_robots_and_balls_are_refused(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" type="ball"/>'
        '<geom size=".1"/></body></worldbody></mujoco>'
    )
    ball = ControlModel.of(load_description(path))
    floating = ControlModel.of(load_description(MODELS / "double_pendulum.urdf", floating=True))
    for control, words in ((ball, "one degree of freedom"), (floating, "this robot floats")):
        for kind in (ModelResidual, BregmanProjectionEstimator, PassivityBasedAdaptiveController):
            with pytest.raises(ArgumentError, match=words):
                kind(control, *([] if kind is ModelResidual else [UPDATE]))


SHORT_STEP = 1e-3
MIXED = Product(
    (
        PhysicalInertia(),
        Positive(2),
        Interval((-1.0, -np.inf, 0.0), (2.0, 1.0, np.inf)),
        Free(2),
        PhysicalInertia(),
    ),
    (1.0, 0.5, 2.0, 1.0, 3.0),
)


def inside(rng, size=0.3):
    """Return a point of MIXED."""
    bodies = [perturbed(size, int(rng.integers(1 << 30)))[:10] for _ in range(2)]
    others = [np.exp(rng.normal(size=2)), [rng.uniform(-0.9, 1.9), rng.uniform(-3, 0.9)]]
    return np.concatenate(
        [bodies[0], *others, np.exp(rng.normal(size=1)), rng.normal(size=2), bodies[1]]
    )


def samples(count=1500):
    """Return positions, velocities and Drake's damped efforts along a motion, (N, 2) each."""
    q, v, a = states_along(SHORT_STEP * np.arange(count))
    return q, v, inverse_dynamics(pendulum_plant(), q, v, a)


# Filtered regressors


@pytest.mark.parametrize("order", [1, 3])
def test_filtered_rows_are_the_filtered_efforts(order):
    """Compare with SciPy's filter of Drake's efforts, without accelerations."""
    q, v, effort = samples()
    filtered = FilteredRegressor(CONTROL, SHORT_STEP, 15.0, order)
    memory, rows = filtered.start(), []
    for now in zip(q, v, effort, strict=True):
        memory = filtered.advanced(memory, *now)
        rows.append(filtered.rows(memory))
    Y, found = (np.array(part) for part in zip(*rows, strict=True))
    share = -np.expm1(-15.0 * SHORT_STEP)
    expected = np.vstack([np.zeros(2), 0.5 * (effort[1:] + effort[:-1])])
    for _ in range(order):
        expected = lfilter([share], [1.0, share - 1.0], expected, axis=0)
    np.testing.assert_allclose(found, expected, atol=1e-10)
    # The trapezoidal rule is of second order.
    np.testing.assert_allclose(Y @ TRUTH, expected, atol=2e-5)


# Slabs


def slabs(rng, rows=3, size=0.3):
    """Return an estimate, rows with values and tolerances, and a truth inside the slabs."""
    x, truth = inside(rng, size), inside(rng, size)
    Y = rng.normal(size=(rows, MIXED.dimension))
    tolerance = rng.uniform(0.01, 0.5, rows)
    return x, Y, Y @ truth + rng.uniform(-1, 1, rows) * tolerance, tolerance, truth


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.integers(1, 6), st.sampled_from([0.3, 0.5, 1.0]))
def test_no_step_leads_away_from_the_truth(seed, rows, relaxation):
    """D(p‖y) ≤ D(p‖x) if p is in the slabs, for any share of the step."""
    x, Y, effort, tolerance, truth = slabs(np.random.default_rng(seed), rows)
    y = slab_step(MIXED, x, Y, effort, tolerance, relaxation=relaxation)
    before = MIXED.divergence(truth, x)
    assert MIXED.divergence(truth, y) <= before * (1 + 1e-9) + 1e-9


# Samples


def update(tolerance=2e-3, **options):
    return SampleUpdate(MANIFOLD, np.full(2, tolerance), **options)


def test_bodies_with_constraints_are_estimated_too():
    rng = np.random.default_rng(2)
    bounded = ConstrainedInertia(-np.eye(10)[:1], np.array([-2.0]))  # lighter than 2 kg
    manifold, truth, p = Product((bounded,)), perturbed(0.1)[:10], perturbed(0.3)[:10]
    made = SampleUpdate(manifold, 1e-5)
    before = manifold.divergence(truth, p)
    for _ in range(60):
        Y = rng.normal(size=(2, 10))
        p = made.updated(p, Y, Y @ truth, SHORT_STEP).point
        assert manifold.contains(p)
    assert manifold.divergence(truth, p) < 0.2 * before


def test_a_nudge_goes_a_little_toward_efforts_that_no_body_has():
    p = perturbed(0.2)
    Y = np.zeros((2, len(p)))
    Y[:, 0] = 1.0
    moved = update(method="nudge").updated(p, Y, np.full(2, -3.0), SHORT_STEP).point
    assert 0 < moved[0] < p[0]
    assert MANIFOLD.contains(moved)
    # No certificate, no step of a projection: there is no mass of −3 kg.
    for effort in ([-3.0, -3.0], [0.0, np.nan], [0.0, np.inf]):
        found = update().updated(p, Y, np.array(effort), SHORT_STEP)
        assert found.point is p
        assert found.error == np.inf


def test_constraints_hold_after_every_sample():
    limits = mass_limits(len(TRUTH), 1, 0.9 * TRUTH[10], 1.1 * TRUTH[10])
    rng, made = np.random.default_rng(0), update(constraints=limits)
    p = TRUTH.copy()
    for _ in range(50):
        Y = rng.normal(size=(2, len(p)))
        p = made.updated(p, Y, rng.normal(size=2), SHORT_STEP).point
        assert (limits.violation(p) <= 1e-9).all()


def test_forgetting_goes_back_where_no_sample_holds():
    p = perturbed(0.2)
    made = update(forgetting=2.0, prior=TRUTH)
    nothing = (np.zeros((2, len(p))), np.zeros(2))
    gap = MANIFOLD.gradient(p) - MANIFOLD.gradient(TRUTH)
    for _ in range(1000):
        p = made.updated(p, *nothing, SHORT_STEP).point
    left = MANIFOLD.gradient(p) - MANIFOLD.gradient(TRUTH)
    np.testing.assert_allclose(left, np.exp(-2.0) * gap, rtol=1e-5, atol=1e-7 * np.abs(gap).max())
