"""Closed loops of small robots for the tests of adaptive systems."""

from pathlib import Path

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from diagrams.benchmarks.adaptive_soak import DAMPING, make_robot
from diagrams.studies.adaptive.faults import Episode, FaultySensor
from geodrake.control import (
    AdaptiveComputedTorqueController,
    ControlModel,
    PassivityBasedAdaptiveController,
    add_adaptive_loop,
    natural_adaptation,
    parameter_manifold,
)
from geodrake.inertia import from_pseudo_inertia, is_physical, pseudo_inertia

MODELS = Path(__file__).parents[1] / "models"


MODEL = make_robot()
CONTROL = ControlModel.of(MODEL)
MANIFOLD = parameter_manifold(MODEL)
TRUTH = CONTROL.prior


def pendulum_plant(time_step=0.0, *, limits=None, reverse=False, damping=DAMPING, finalized=True):
    """Return a plant of the double pendulum, with its friction as Drake's own damping."""
    plant = MultibodyPlant(time_step)
    Parser(plant).AddModels(str(MODELS / "double_pendulum.urdf"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    indices = plant.GetJointIndices()
    for index in reversed(indices) if reverse else indices:
        joint = plant.get_mutable_joint(index)
        if joint.num_velocities() == 1:
            joint.set_default_damping_vector([damping])
            effort = (limits or {}).get(joint.name(), np.inf)
            plant.AddJointActuator(f"motor_{joint.name()}", joint, effort)
    if finalized:
        plant.Finalize()
    return plant


def motion(size=0.8, duration=20.0):
    """Return a smooth motion of the double pendulum."""
    t = np.linspace(0.0, duration, round(10 * duration) + 1)
    q = size * np.sin(np.outer([1.3, 2.1], t) + np.array([[0.0], [0.4]]))
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, q)


def states_along(time):
    """Return positions, velocities and accelerations (N, 2) of that motion."""
    path = motion()
    return (np.array([path.EvalDerivative(t, k).ravel() for t in time]) for k in range(3))


def perturbed(size, seed=0, truth=TRUTH, control=CONTROL):
    """Return a wrong estimate: bodies changed by congruences, friction by factors."""
    rng = np.random.default_rng(seed)
    phi = control.phi(truth)
    G = np.eye(4) + size * rng.normal(size=(len(phi), 4, 4))
    wrong = from_pseudo_inertia(G @ pseudo_inertia(phi) @ G.transpose(0, 2, 1))
    mu = truth[control.num_inertial :]
    return np.concatenate([wrong.ravel(), mu * np.exp(size * rng.normal(size=len(mu)))])


def natural(gamma=1.0):
    return natural_adaptation(MANIFOLD, gamma)


START = perturbed(0.15)


def passive(law="natural", **options):
    """Return a passivity-based controller that begins with a wrong estimate and knows the truth."""
    return _controller(PassivityBasedAdaptiveController, law, options)


def computed(law="natural", **options):
    """Return a computed-torque controller that begins with a wrong estimate and knows the truth."""
    return _controller(AdaptiveComputedTorqueController, law, options)


def _controller(kind, law, options):
    law = natural() if law == "natural" else law
    return kind(CONTROL, law, **{"parameters": START, "truth": TRUTH, **options})


def closed_loop(controller, *, plant=None, size=0.8, effects=(), log_period=1e-2, sensor=None):
    """Return a builder with a loop in it."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(plant or pendulum_plant())
    loop = add_adaptive_loop(
        builder,
        plant,
        controller,
        size if isinstance(size, Trajectory) else motion(size),
        effects=effects,
        log_period=log_period,
        sensor=sensor,
    )
    return builder, loop


def simulator(diagram, context=None, *, step=1e-3, accuracy=1e-6):
    """Return a simulator that is accurate between the samples of a controller."""
    found = Simulator(diagram) if context is None else Simulator(diagram, context)
    config = SimulatorConfig(
        integration_scheme="runge_kutta3", max_step_size=step, accuracy=accuracy
    )
    ApplySimulatorConfig(config, found)
    return found


def run(controller, duration, **options):
    """Return times and logs of a loop from the start of the motion."""
    builder, loop = closed_loop(controller, **options)
    diagram = builder.Build()
    found = simulator(diagram, loop.context(diagram))
    found.Initialize()
    found.AdvanceTo(duration)
    return loop.logged(found.get_context())


def check_estimates(logs):
    """Check that all numbers are finite and every estimate is physical."""
    for name, values in logs.items():
        assert np.isfinite(values).all(), name
    phi = logs["parameters"][:, : CONTROL.num_inertial]
    assert is_physical(phi.reshape(len(phi), -1, 10)).all()


def tracking_error(logs):
    """Return the largest error of position (N,), rad."""
    n = logs["actuation"].shape[1]
    return np.abs(logs["state"] - logs["desired_state"])[:, :n].max(1)


class SlowSensor(LeafSystem):
    """A sensor that holds its last sample, and has none at first.

    Args:
        size: Length of a sample.
        period: Time between samples, s.
    """

    def __init__(self, size, period):
        LeafSystem.__init__(self)
        self._input = self.DeclareVectorInputPort("true", BasicVector(size))
        held = self.DeclareDiscreteState(np.full(size, np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._measure)
        self.DeclareStateOutputPort("measured", held)

    def _measure(self, context, state):
        state.set_value(self._input.Eval(context))


def faulty(fault, start=0.0, stop=np.inf):
    """Return a sensor whose fault changes the values of each `Sample` from some time on."""
    return FaultySensor(4, [Episode(fault, start, stop)], seed=0)


def nothing(sample):
    return np.full(len(sample.true), np.nan)


def infinite(sample):
    return np.where(np.arange(len(sample.true)) == 1, np.inf, sample.true)


def noisy(position, velocity):
    """Return a fault of Gaussian noise of these sizes, rad and rad/s."""
    sizes = np.repeat([position, velocity], 2)
    return lambda sample: sample.true + sizes * sample.rng.normal(size=len(sizes))


def fixed(system, context=None, **inputs):
    """Return a Context, new if none is given, with values of input ports."""
    context = context or system.CreateDefaultContext()
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)
    return context
