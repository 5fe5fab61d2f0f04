"""All systems: clones, slopes of their outputs, and gains in the Context."""

import numpy as np
import pytest
from adaptive_loops import CONTROL, START, closed_loop, computed, natural, passive, pendulum_plant
from pydrake.autodiffutils import AutoDiffXd, InitializeAutoDiff
from pydrake.systems.analysis import Simulator

from geodrake import effects
from geodrake.control import (
    DelayedEffort,
    EffectForce,
    FixedGains,
    LogSource,
    ModelResidual,
    PositionServo,
    VaryingGains,
)
from geodrake.errors import ArgumentError
from geodrake.logs import JointLog
from geodrake.model.simulation.scalar_system import scalars

SPRING = [(effects.JointElasticity("elbow"), [1e-3]), (effects.RotorInertia("elbow"), [0.3])]
SERVO = PositionServo([20.0, 8.0], kd=[1.5, 0.4], ki=3.0, limit=[5.0, np.inf])
SYSTEMS = {
    "passivity": passive(time_step=0.0),
    "fixed gains": passive(gains=FixedGains(8.0, 6.0), time_step=0.0),
    "computed torque": computed(time_step=0.0),
    "residual": ModelResidual(CONTROL),
    "effects": EffectForce(pendulum_plant(), SPRING, sign_width=0.3),
    "servo": SERVO,
    "delays": DelayedEffort([0.0, 2e-3]),
}
RNG = np.random.default_rng(3)
INPUTS = {"estimated_state": RNG.normal(size=4), "desired_state": RNG.normal(size=4)}
OTHER = {4: INPUTS["estimated_state"], 2: RNG.normal(size=2), 22: START}  # by size


def seen(system, changed="", values=None):
    """A Context with all inputs, of which one may have other values."""
    context, smooth = system.CreateDefaultContext(), values is not None and values.dtype == object
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        given = INPUTS.get(port.get_name(), OTHER[port.size()])
        if port.get_name() == changed:
            given = values
        elif smooth:
            given = scalars(given, AutoDiffXd)
        port.FixValue(context, given)
    return context


def everything(system, context):
    """All outputs, and rates."""
    ports = (system.get_output_port(i) for i in range(system.num_output_ports()))
    parts = [np.atleast_1d(port.Eval(context)) for port in ports]
    return np.concatenate([*parts, system.EvalTimeDerivatives(context).CopyToVector()])


@pytest.mark.parametrize("name", SYSTEMS)
def test_clones_and_slopes(name):
    """A clone does the same, and slopes are those of differences."""
    system = SYSTEMS[name]
    clone, smooth = system.Clone(), system.ToAutoDiffXd()
    assert type(clone) is type(system)
    np.testing.assert_array_equal(everything(clone, seen(clone)), everything(system, seen(system)))
    largest = 0.0
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        x = np.asarray(INPUTS.get(port.get_name(), OTHER[port.size()]))
        context = seen(smooth, port.get_name(), InitializeAutoDiff(x).ravel())
        slopes = [value.derivatives() for value in everything(smooth, context)]
        found = np.array([slope if slope.size else 0.0 * x for slope in slopes])
        ends = [
            [everything(system, seen(system, port.get_name(), x + h * e)) for e in np.eye(len(x))]
            for h in (1e-6, -1e-6)
        ]
        expected = np.transpose(np.subtract(*ends)) / 2e-6
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found, expected, atol=1e-6 * scale, err_msg=port.get_name())
        largest = max(largest, np.abs(expected).max())
    assert largest > 0.1
    with pytest.raises(RuntimeError, match="does not support scalar conversion"):
        system.ToSymbolic()


@pytest.mark.parametrize("make", [passive, computed])
@pytest.mark.parametrize("time_step", [0.0, 2e-3])
def test_a_loop_goes_on_alike_in_a_clone_and_in_a_copy_of_its_context(make, time_step):
    builder, loop = closed_loop(make(time_step=time_step))
    diagram = builder.Build()
    clone, first = diagram.Clone(), loop.context(diagram)
    Simulator(diagram, first).AdvanceTo(0.01)
    there = clone.CreateDefaultContext()
    there.SetTimeStateAndParametersFrom(first)
    ends = []
    for each, context in ((diagram, first.Clone()), (clone, there), (diagram, first)):
        Simulator(each, context).AdvanceTo(0.02)
        rates = each.EvalTimeDerivatives(context).CopyToVector()
        states = context.get_discrete_state(0).value() if time_step else rates
        ends.append((rates, states))
    for end in ends[1:]:
        np.testing.assert_equal(end, ends[0])
    controller = loop.controller
    fresh = controller.GetMyContextFromRoot(diagram.CreateDefaultContext())
    np.testing.assert_array_equal(controller.parameters(fresh), START)


def with_gains(gains, gamma=1.0):
    if isinstance(gains, list):
        return computed(natural(gamma), rate=gains, time_step=0.0)
    return passive(natural(gamma), gains=gains, time_step=0.0)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (VaryingGains(8.0), VaryingGains(5.0)),
        (FixedGains([8.0, 4.0], 6.0), FixedGains([3.0, 2.0], [5.0, 7.0])),
        ([8.0, 8.0], [4.0, 6.0]),
    ],
)
def test_gains_and_speed_of_a_context_count(before, after):
    system, fresh = with_gains(before), with_gains(after, 0.2)
    context = seen(system)
    system.set_gains(context, after)
    system.set_gamma(context, 0.2)
    expected = everything(fresh, seen(fresh))
    np.testing.assert_allclose(everything(system, context), expected, rtol=1e-12)


def test_gains_that_cannot_be_are_refused():
    system = passive(time_step=0.0)
    context = seen(system)
    with pytest.raises(ArgumentError, match="has varying gains"):
        system.set_gains(context, FixedGains(1.0, 1.0))
    with pytest.raises(ArgumentError, match="gamma"):
        system.set_gamma(context, 0.0)
    with pytest.raises(ArgumentError, match="does not adapt"):
        passive(None, time_step=0.0).set_gamma(context, 1.0)


def test_logs_are_cloned():
    time = np.arange(4.0)[:, None]
    log = JointLog("log", ("hinge",), time[:, 0], time**2, time)
    copy = LogSource(log).Clone()
    context = copy.CreateDefaultContext()
    context.SetTime(2.0)
    assert copy.GetOutputPort("position").Eval(context) == [4.0]
