"""The estimator, the player of logs and the comparison with a model, in Drake diagrams."""

import inspect
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
    FaultySensor,
    SlowSensor,
    frozen,
    motion,
    natural,
    nothing,
    pendulum_plant,
    perturbed,
    simulator,
)
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from geodrake.control import systems
from geodrake.control.loops import add_adaptive_loop
from geodrake.control.online_estimation import FilteredRegressor, SampleUpdate
from geodrake.control.regressor import ControlModel
from geodrake.control.systems import (
    AdaptiveComputedTorqueController,
    BregmanProjectionEstimator,
    DelayedEffort,
    EffectForce,
    LogSource,
    ModelResidual,
    PassivityBasedAdaptiveController,
    PredictionError,
)
from geodrake.effects import JointElasticity
from geodrake.errors import ArgumentError, LogError
from geodrake.inertia import is_physical
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import load_description

STEP = 2e-3
QUANTITIES = ("time", "position", "velocity", "effort")
UPDATE = SampleUpdate(MANIFOLD, np.full(2, 0.005))


def recorded(duration=4.0, truth=TRUTH, gap=()):
    """A log of the double pendulum along a motion, with exact efforts of some parameters."""
    path, time = motion(), STEP * np.arange(round(duration / STEP) + 1)
    q = path.vector_values(time).T
    v, a = (np.array([path.EvalDerivative(t, k).ravel() for t in time]) for k in (1, 2))
    rows = zip(q, v, a, strict=True)
    effort = np.array([CONTROL.at(q, v, v, a).effort(truth) for q, v, a in rows])
    kept = np.ones(len(time), bool)
    if gap:
        kept[slice(*gap)] = False
    return JointLog("made", MODEL.joints, 3.0 + time[kept], q[kept], effort[kept], velocity=v[kept])


def estimated(log, *, start=TRUTH, sensor=None, update=UPDATE, duration=None, every=1):
    """What an estimator makes of a log: the system, times, and its outputs then."""
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
    found.AdvanceTo(duration or source.duration)
    logs = [sink.FindLog(found.get_context()) for sink in sinks]
    return system, logs[0].sample_times(), *(np.array(log.data().T) for log in logs)


def check(p):
    assert np.isfinite(p).all()
    assert is_physical(p[:, : CONTROL.num_inertial].reshape(len(p), -1, 10)).all()


# The estimator


def unexplained(p, truth=TRUTH):
    """RMS of the effort along the motion that an estimate does not explain, N·m."""
    path = motion()
    squares = []
    for t in np.arange(0.0, 4.0, 0.02):
        q, v, a = path.value(t).ravel(), *(path.EvalDerivative(t, k).ravel() for k in (1, 2))
        squares.append((CONTROL.at(q, v, v, a).regressor @ (p - truth)) ** 2)
    return np.sqrt(np.mean(squares))


@pytest.mark.parametrize("every", [pytest.param(1, marks=pytest.mark.thorough), 2])
def test_the_estimate_explains_what_is_measured(every):
    """Exact projections by default, each with a certificate, go farther than nudges."""
    start, fallen = perturbed(0.3), {}
    for method in ("projection", "nudge"):
        update = SampleUpdate(MANIFOLD, np.full(2, 0.005), method=method)
        _, _, p, residual, error = estimated(recorded(), start=start, every=every, update=update)
        check(p)
        D = MANIFOLD.divergence(TRUTH, p)
        assert np.diff(D).max() < 1e-6
        # (What D bounds is the parameters; of every second sample, 4 s leave this a little more.)
        most = 0.2 if (method, every) == ("projection", 2) else 0.15
        assert unexplained(p[-1]) < most * unexplained(p[0])
        assert np.abs(residual).max() < 0.2
        fallen[method] = D[0] - D[-1]
        certified = error[1:] <= 1e-8
        assert certified.all() if method == "projection" else not certified.any()
    assert UPDATE.method == "projection"
    assert fallen["projection"] > 1.3 * fallen["nudge"]


def test_a_payload_shows_within_seconds():
    """Half the arm's mass more on the second link: the effort that it needs, while moving."""
    heavier = TRUTH.copy()
    p = np.array([0.0, 0.0, 0.15])
    extra = np.array([1, *p, 0.15**2 + 1e-4, 0.15**2 + 1e-4, 1e-4, 0, 0, 0])
    heavier[10:20] += 0.5 * (TRUTH[0] + TRUTH[10]) * extra
    _, time, p, _, _ = estimated(recorded(6.0, truth=heavier))
    check(p)
    # Its effort is explained within a second, …
    assert unexplained(p[time >= 1.0][0], heavier) < 0.15 * unexplained(p[0], heavier)
    # … and what shows of it by gravity, the first moment, settles as the motion goes on.
    moved, expected = p[:, 13] - TRUTH[13], heavier[13] - TRUTH[13]
    assert np.abs(moved[time > 1.0] / expected - 1.0).max() < 0.6
    assert np.abs(moved[time > 5.0] / expected - 1.0).max() < 0.15
    assert unexplained(p[-1], heavier) < 0.1 * unexplained(p[0], heavier)


@pytest.mark.parametrize("fault", [nothing, frozen])
def test_a_sensor_that_fails_for_a_while(fault):
    start = perturbed(0.3)
    sensor = FaultySensor(4, fault, 0.5, 1.2)
    _, time, p, residual, _ = estimated(recorded(2.0), start=start, sensor=sensor)
    check(p)
    assert np.diff(MANIFOLD.divergence(TRUTH, p)).max() < 1e-3
    during = p[(time > 0.61) & (time < 1.19)]
    np.testing.assert_array_equal(during, np.broadcast_to(during[0], during.shape))
    assert np.isfinite(residual).all()
    assert not np.array_equal(p[-1], during[0])


def test_an_estimator_beside_a_controller_that_does_not_adapt():
    """One that watches a loop: the actuation holds between its samples."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(pendulum_plant())
    start = perturbed(0.15)
    controller = PassivityBasedAdaptiveController(CONTROL, None, time_step=STEP, parameters=start)
    loop = add_adaptive_loop(builder, plant, controller, motion())
    filtered = FilteredRegressor(CONTROL, STEP, held_effort=True)
    watching = builder.AddSystem(
        BregmanProjectionEstimator(
            CONTROL, UPDATE, filtered=filtered, time_step=STEP, parameters=start
        )
    )
    builder.Connect(loop.state, watching.GetInputPort("estimated_state"))
    builder.Connect(loop.actuation, watching.GetInputPort("effort"))
    diagram = builder.Build()
    found = simulator(diagram, loop.context(diagram))
    distances = []
    for stop in np.linspace(0.2, 2.0, 10):
        found.AdvanceTo(stop)
        p = watching.parameters(watching.GetMyContextFromRoot(found.get_context()))
        distances.append(float(MANIFOLD.divergence(TRUTH, p)))
    assert np.diff(distances).max() < 1e-6
    assert distances[-1] < distances[0]


def test_estimators_that_do_not_fit_are_refused():
    with pytest.raises(ArgumentError, match="filter is one for"):
        BregmanProjectionEstimator(CONTROL, UPDATE, filtered=FilteredRegressor(CONTROL, 0.01))
    other = FilteredRegressor(ControlModel.of(MODEL), STEP)
    with pytest.raises(ArgumentError, match="another ControlModel"):
        BregmanProjectionEstimator(CONTROL, UPDATE, filtered=other, time_step=STEP)
    with pytest.raises(ArgumentError, match="another ControlModel"):
        ModelResidual(CONTROL, filtered=other)
    with pytest.raises(ArgumentError, match="inside of the law's manifold"):
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


@pytest.mark.parametrize("times", [2, 4])
def test_a_sensor_that_is_slower_than_the_estimator(times):
    """States that only repeat say nothing; what is learned is that of the new ones."""
    sensor = SlowSensor(4, times * STEP)
    _, _, p, _, _ = estimated(recorded(2.0), start=perturbed(0.3), sensor=sensor)
    check(p)
    # (The effort is later than the held state by up to a sample of the sensor.)
    assert np.diff(MANIFOLD.divergence(TRUTH, p)).max() < 1e-3
    assert unexplained(p[-1]) < 0.3 * unexplained(p[0])


# The comparison


def compared(model, log, *, filtered=None, accelerations=False, duration=None):
    builder = DiagramBuilder()
    source = builder.AddSystem(LogSource(log, MODEL.joints))
    system = builder.AddSystem(ModelResidual(model, filtered=filtered))
    builder.Connect(source.GetOutputPort("state"), system.GetInputPort("estimated_state"))
    builder.Connect(source.GetOutputPort("effort"), system.GetInputPort("effort"))
    sinks = [LogVectorOutput(system.get_output_port(i), builder, 0.02) for i in range(2)]
    found = simulator(builder.Build())
    found.AdvanceTo(duration or source.duration)
    return [np.array(sink.FindLog(found.get_context()).data().T) for sink in sinks]


def test_the_residual_is_what_the_model_lacks():
    """Friction of 0.5 N·m·s/rad that the model does not have, low-passed."""
    more = TRUTH.copy()
    more[20] += 0.5
    log = recorded(2.0, more)
    filtered = FilteredRegressor(CONTROL, STEP, 60.0, 1)
    residual, valid = compared(CONTROL, log, filtered=filtered)
    assert valid[1:].all()
    friction = 0.5 * log.velocity[:, 0]
    expected = np.interp(np.arange(len(residual)) * 0.02 - 1 / 60, log.time - 3.0, friction)
    assert np.abs(residual[20:, 0] - expected[20:]).max() < 0.02
    assert np.abs(residual[:, 1]).max() < 1e-3


def test_the_residual_of_one_instant():
    system = ModelResidual(CONTROL)
    context = system.CreateDefaultContext()
    q, v, a, u = np.random.default_rng(0).normal(size=(4, 2))
    system.GetInputPort("estimated_state").FixValue(context, np.concatenate([q, v]))
    system.GetInputPort("acceleration").FixValue(context, a)
    system.GetInputPort("effort").FixValue(context, u)
    residual, valid = system.GetOutputPort("residual"), system.GetOutputPort("valid")
    expected = u - CONTROL.at(q, v, v, a).effort(TRUTH)
    np.testing.assert_allclose(residual.Eval(context), expected)
    system.GetInputPort("parameters").FixValue(context, 2 * TRUTH)
    expected = u - CONTROL.at(q, v, v, a).effort(2 * TRUTH)
    np.testing.assert_allclose(residual.Eval(context), expected)
    assert valid.Eval(context) == 1.0
    for broken in (np.nan, np.inf, 1e200):
        system.GetInputPort("estimated_state").FixValue(context, [0.0, 0.0, broken, 0.0])
        assert valid.Eval(context) == 0.0
        np.testing.assert_array_equal(residual.Eval(context), 0.0)


def test_the_residual_with_gaps_and_before_samples():
    filtered = FilteredRegressor(CONTROL, STEP)
    residual, valid = compared(CONTROL, recorded(1.0, gap=(100, 200)), filtered=filtered)
    assert np.isfinite(residual).all()
    assert np.abs(residual).max() < 1e-3
    assert (valid[12:20] == 0.0).all()
    assert (valid[22:] == 1.0).all()


# What every system says of its ports


LAW = natural()
MAKERS = {
    "PassivityBasedAdaptiveController": lambda: [
        PassivityBasedAdaptiveController(
            CONTROL, LAW, truth=TRUTH, prediction=PredictionError(measured=True)
        )
    ],
    "AdaptiveComputedTorqueController": lambda: [
        AdaptiveComputedTorqueController(CONTROL, LAW, truth=TRUTH, prediction=prediction)
        for prediction in (None, PredictionError(measured=True))
    ],
    "BregmanProjectionEstimator": lambda: [BregmanProjectionEstimator(CONTROL, UPDATE)],
    "ModelResidual": lambda: [
        ModelResidual(CONTROL, filtered=filtered)
        for filtered in (None, FilteredRegressor(CONTROL, 0.1))
    ],
    "LogSource": lambda: [LogSource(recorded(0.1))],
    "EffectForce": lambda: [EffectForce(pendulum_plant(), [(JointElasticity("elbow"), [1e-3])])],
    "DelayedEffort": lambda: [DelayedEffort(0.01)],
}
"""Systems of every class, which together have all of its ports."""


@pytest.mark.parametrize("name", MAKERS)
def test_docstrings_name_the_ports(name):
    """The block that Drake's documentation is made of, against the ports that there are."""
    text = inspect.getdoc(getattr(systems, name))
    block = text.split(".. pydrake_system::\n\n")[1].split("\n\n")[0]
    said = yaml.safe_load(block)
    made = MAKERS[name]()
    assert said["name"] == name
    inputs = {s.get_input_port(i).get_name() for s in made for i in range(s.num_input_ports())}
    outputs = {s.get_output_port(i).get_name() for s in made for i in range(s.num_output_ports())}
    assert set(said.get("input_ports", [])) == inputs
    assert set(said["output_ports"]) == outputs


def test_floating_robots_and_balls_are_refused(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" type="ball"/>'
        '<geom size=".1"/></body></worldbody></mujoco>'
    )
    ball = ControlModel.of(load_description(path))
    floating = ControlModel.of(load_description(MODELS / "double_pendulum.urdf", floating=True))
    for control, words in ((ball, "one degree of freedom"), (floating, "this one floats")):
        with pytest.raises(ArgumentError, match=words):
            ModelResidual(control)
        with pytest.raises(ArgumentError, match=words):
            BregmanProjectionEstimator(control, UPDATE)
