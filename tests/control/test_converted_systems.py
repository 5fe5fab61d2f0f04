"""Controllers, residuals and delays: clones, slopes against mass matrices, gains in the Context."""

import numpy as np
import pytest
from adaptive_loops import CONTROL, TRUTH, closed_loop, natural, perturbed
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from geodrake.control.systems import (
    AdaptiveComputedTorqueController,
    DelayedEffort,
    FixedGains,
    LogSource,
    ModelResidual,
    PassivityBasedAdaptiveController,
    VaryingGains,
)
from geodrake.errors import ArgumentError
from geodrake.logs.motion import JointLog
from geodrake.model.simulation.scalar_system import scalars

START = perturbed(0.15)
RNG = np.random.default_rng(3)
STATE, DESIRED, ACCELERATION = RNG.normal(size=4), RNG.normal(size=4), RNG.normal(size=2)


VARYING = VaryingGains(8.0)


def passive(gains=VARYING, law="natural", **options):
    law = natural() if law == "natural" else law
    options = {"parameters": START, "truth": TRUTH, "time_step": 0.0, **options}
    return PassivityBasedAdaptiveController(CONTROL, law, gains=gains, **options)


def computed(rate=8.0, **options):
    options = {"parameters": START, "truth": TRUTH, "time_step": 0.0, **options}
    return AdaptiveComputedTorqueController(CONTROL, natural(), rate=rate, **options)


def seen(system, **inputs):
    """A Context with a state, a desired one and accelerations."""
    context = system.CreateDefaultContext()
    known = {
        "estimated_state": STATE,
        "desired_state": DESIRED,
        "desired_acceleration": ACCELERATION,
        "acceleration": ACCELERATION,
        "effort": ACCELERATION,
        **inputs,
    }
    for name, values in known.items():
        if system.HasInputPort(name):
            system.GetInputPort(name).FixValue(context, values)
    return context


def output(system, context, name):
    return system.GetOutputPort(name).Eval(context)


def smooth(system, name, values):
    """A Context of AutoDiffXd in which an input has derivatives."""
    plain = {
        key: scalars(v, AutoDiffXd)
        for key, v in (
            ("estimated_state", STATE),
            ("desired_state", DESIRED),
            ("desired_acceleration", ACCELERATION),
            ("acceleration", ACCELERATION),
            ("effort", ACCELERATION),
        )
    }
    plain[name] = InitializeAutoDiff(values).ravel()
    return seen(system, **plain)


@pytest.mark.parametrize("make", [passive, computed])
def test_slopes_of_controllers(make):
    """∂u/∂q̈_d is the mass matrix of the estimate; ∂u/∂p̂ the regressor, whose product is u."""
    system = make()
    other = system.ToAutoDiffXd()
    context = smooth(other, "desired_acceleration", ACCELERATION)
    M = CONTROL.at(STATE[:2], STATE[2:], STATE[2:], ACCELERATION).mass_matrix(START)
    found = output(other, context, "actuation")
    np.testing.assert_allclose(ExtractGradient(found), M, atol=1e-7)
    context.SetContinuousState(InitializeAutoDiff(START).ravel())
    context = _without_input_slopes(other, context)
    Y = ExtractGradient(output(other, context, "actuation"))
    u = output(system, seen(system), "actuation")
    np.testing.assert_allclose(Y @ START, u, atol=1e-6)


def _without_input_slopes(system, context):
    system.GetInputPort("desired_acceleration").FixValue(context, scalars(ACCELERATION, AutoDiffXd))
    return context


@pytest.mark.parametrize("make", [passive, computed])
@pytest.mark.parametrize("time_step", [0.0, 2e-3])
def test_a_cloned_loop_does_the_same(make, time_step):
    builder, loop = closed_loop(make(time_step=time_step))
    diagram = builder.Build()
    clone = diagram.Clone()
    ends = []
    for each in (diagram, clone):
        context = each.CreateDefaultContext()
        context.SetTimeStateAndParametersFrom(loop.context(diagram))
        simulator = Simulator(each, context)
        simulator.AdvanceTo(0.02)
        context = simulator.get_context()
        ends.append(each.EvalTimeDerivatives(context).CopyToVector())
        if time_step:
            ends[-1] = np.concatenate([ends[-1], context.get_discrete_state(0).value()])
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (VaryingGains(8.0), VaryingGains(5.0)),
        (FixedGains([8.0, 4.0], 6.0), FixedGains([3.0, 2.0], [5.0, 7.0])),
    ],
)
def test_gains_and_speed_of_a_context_count(before, after):
    system, fresh = passive(before), passive(after, natural(0.2))
    context, expected = seen(system), seen(fresh)
    system.set_gains(context, after)
    system.set_gamma(context, 0.2)
    for name in ("actuation", "lyapunov"):
        np.testing.assert_allclose(
            output(system, context, name), output(fresh, expected, name), rtol=1e-12
        )
    both = (system, context), (fresh, expected)
    rates = [each.EvalTimeDerivatives(own).CopyToVector() for each, own in both]
    np.testing.assert_allclose(*rates, rtol=1e-12)
    assert np.abs(rates[0]).max() > 0.0


def test_poles_of_a_context_count():
    system, fresh = computed(8.0), computed([4.0, 6.0])
    context, expected = seen(system), seen(fresh)
    system.set_gains(context, [4.0, 6.0])
    for name in ("actuation", "lyapunov"):
        np.testing.assert_allclose(
            output(system, context, name), output(fresh, expected, name), rtol=1e-12
        )


def test_gains_that_cannot_be_are_refused():
    system = passive()
    context = seen(system)
    with pytest.raises(ArgumentError, match="made with varying gains"):
        system.set_gains(context, FixedGains(1.0, 1.0))
    with pytest.raises(ArgumentError, match="gamma"):
        system.set_gamma(context, 0.0)
    with pytest.raises(ArgumentError, match="does not adapt"):
        passive(law=None).set_gamma(context, 1.0)


def test_slopes_of_a_residual():
    """measured − predicted effort: −M by the acceleration, 𝟙 by the effort."""
    system = ModelResidual(CONTROL)
    other = system.ToAutoDiffXd()
    M = CONTROL.at(STATE[:2], STATE[2:], STATE[2:], ACCELERATION).mass_matrix(CONTROL.prior)
    for name, expected in (("acceleration", -M), ("effort", np.eye(2))):
        found = output(other, smooth(other, name, ACCELERATION), "residual")
        np.testing.assert_allclose(ExtractGradient(found), expected, atol=1e-7)
    clone = system.Clone()
    assert isinstance(clone, ModelResidual)
    np.testing.assert_array_equal(
        output(clone, seen(clone), "residual"), output(system, seen(system), "residual")
    )
    with pytest.raises(RuntimeError, match="does not support scalar conversion"):
        system.ToSymbolic()


def test_delays_and_logs_are_cloned():
    late = DelayedEffort([0.0, 2e-3])
    other = late.ToAutoDiffXd()
    context = other.CreateDefaultContext()
    other.get_input_port().FixValue(context, InitializeAutoDiff(ACCELERATION).ravel())
    slopes = ExtractGradient(other.get_output_port().Eval(context))
    np.testing.assert_allclose(slopes, [[1.0, 0.0], [0.0, 0.0]], atol=1e-9)
    copy = late.Clone()
    assert isinstance(copy, DelayedEffort)
    assert copy.get_input_port().size() == 2
    time = np.arange(4.0)[:, None]
    log = JointLog("log", ("hinge",), time[:, 0], time**2, time)
    copy = LogSource(log).Clone()
    context = copy.CreateDefaultContext()
    context.SetTime(2.0)
    assert copy.GetOutputPort("position").Eval(context) == [4.0]
