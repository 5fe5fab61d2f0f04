"""Adaptive controllers in Drake diagrams: the guarantees of the source, the life of a system."""

import numpy as np
import pytest
from adaptive_loops import (
    MANIFOLD,
    MODELS,
    START,
    TRUTH,
    SlowSensor,
    check_estimates,
    computed,
    motion,
    natural,
    passive,
    pendulum_plant,
    run,
    tracking_error,
)
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from geodrake.control.adaptation import (
    ProjectedLaw,
    euclidean_adaptation,
    mass_limits,
    pullback_adaptation,
)
from geodrake.control.loops import add_adaptive_loop
from geodrake.control.systems import (
    FixedGains,
    PredictionError,
    VaryingGains,
)
from geodrake.errors import ArgumentError

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


@pytest.mark.parametrize("make", [passive, computed])
def test_with_the_true_model_nothing_is_left_to_adapt(make):
    controller = make(parameters=TRUTH, time_step=1e-3)
    time, logs = run(controller, 0.5)
    assert tracking_error(logs).max() < 1e-3
    np.testing.assert_allclose(logs["parameters"], np.tile(TRUTH, (len(time), 1)), atol=1e-3)


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
        with pytest.raises(ArgumentError, match="inside of the law's manifold"):
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
