"""Closed loops of small robots for the tests of adaptive systems."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from geodrake.control import (
    AdaptiveComputedTorqueController,
    ControlModel,
    PassivityBasedAdaptiveController,
    add_adaptive_loop,
    natural_adaptation,
    parameter_manifold,
)
from geodrake.effects import FittedEffect, ViscousFriction
from geodrake.inertia import from_pseudo_inertia, is_physical, pseudo_inertia, to_spatial_inertia
from geodrake.model import load_description

MODELS = Path(__file__).parents[1] / "models"
DAMPING = 0.3


def pendulum_model():
    """The double pendulum with viscous friction."""
    model = load_description(MODELS / "double_pendulum.urdf")
    effects = tuple(FittedEffect(ViscousFriction(j), np.array([DAMPING])) for j in model.joints)
    return replace(model, effects=effects)


MODEL = pendulum_model()
CONTROL = ControlModel.of(MODEL)
MANIFOLD = parameter_manifold(MODEL)
TRUTH = CONTROL.prior
EFFECTS = [(fitted.effect, fitted.parameters) for fitted in MODEL.effects]


def pendulum_plant(time_step=0.0, *, payload=None, limits=None, reverse=False, damping=DAMPING):
    """A finalized plant of the double pendulum, with its friction as Drake's own damping."""
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
    if payload is not None:
        body = plant.GetBodyByName(MODEL.bodies[-1])
        extra = plant.AddRigidBody("payload", to_spatial_inertia(payload))
        plant.WeldFrames(body.body_frame(), extra.body_frame())
    plant.Finalize()
    return plant


def motion(size=0.8, duration=20.0):
    """A smooth motion of the double pendulum."""
    t = np.linspace(0.0, duration, round(10 * duration) + 1)
    q = size * np.sin(np.outer([1.3, 2.1], t) + np.array([[0.0], [0.4]]))
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, q)


def states_along(time):
    """Positions, velocities and accelerations (N, 2) of that motion at instants."""
    path = motion()
    return (np.array([path.EvalDerivative(t, k).ravel() for t in time]) for k in range(3))


def perturbed(size, seed=0, truth=TRUTH, control=CONTROL):
    """A wrong estimate: bodies changed by congruences, friction by factors."""
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
    """A controller by passivity that begins with a wrong estimate and knows the truth."""
    return _controller(PassivityBasedAdaptiveController, law, options)


def computed(law="natural", **options):
    """The same by computed torque."""
    return _controller(AdaptiveComputedTorqueController, law, options)


def _controller(kind, law, options):
    law = natural() if law == "natural" else law
    return kind(CONTROL, law, **{"parameters": START, "truth": TRUTH, **options})


def closed_loop(controller, *, plant=None, size=0.8, effects=(), log_period=1e-2, sensor=None):
    """A builder with a loop in it."""
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
    """A simulator that is exact enough between the samples of a controller."""
    found = Simulator(diagram) if context is None else Simulator(diagram, context)
    config = SimulatorConfig(
        integration_scheme="runge_kutta3", max_step_size=step, accuracy=accuracy
    )
    ApplySimulatorConfig(config, found)
    return found


def run(controller, duration, **options):
    """Times and logs of a loop from the start of the motion."""
    builder, loop = closed_loop(controller, **options)
    diagram = builder.Build()
    found = simulator(diagram, loop.context(diagram))
    found.Initialize()
    found.AdvanceTo(duration)
    return loop.logged(found.get_context())


def check_estimates(logs):
    """All is finite and every estimate physical."""
    for name, values in logs.items():
        assert np.isfinite(values).all(), name
    phi = logs["parameters"][:, : CONTROL.num_inertial]
    assert is_physical(phi.reshape(len(phi), -1, 10)).all()


def tracking_error(logs):
    """Greatest error of position (N,), rad."""
    n = logs["actuation"].shape[1]
    return np.abs(logs["state"] - logs["desired_state"])[:, :n].max(1)


class FaultySensor(LeafSystem):
    """A sensor of positions and velocities that has faults.

    Args:
        size: Length of what it measures.
        fault: Maps time, the value and the last value before `start` to what it says instead.
        start: From when on, s.
        stop: Until when, s.
    """

    def __init__(self, size, fault, start=0.0, stop=np.inf):
        LeafSystem.__init__(self)
        self._fault, self._start, self._stop = fault, start, stop
        self._input = self.DeclareVectorInputPort("true", BasicVector(size))
        self._last = self.DeclareDiscreteState(size)
        self.DeclarePeriodicDiscreteUpdateEvent(2e-3, 0.0, self._keep)
        self.DeclareVectorOutputPort("measured", BasicVector(size), self._measure)

    def _keep(self, context, state):
        if context.get_time() < self._start:
            state.set_value(self._last, self._input.Eval(context))

    def _measure(self, context, output):
        value, t = self._input.Eval(context), context.get_time()
        if self._start <= t < self._stop:
            value = self._fault(t, value, context.get_discrete_state(self._last).value())
        output.SetFromVector(value)


class SlowSensor(LeafSystem):
    """A sensor that holds what it measured until its next sample, and first has nothing.

    Args:
        size: Length of what it measures.
        period: From sample to sample, s.
    """

    def __init__(self, size, period):
        LeafSystem.__init__(self)
        self._input = self.DeclareVectorInputPort("true", BasicVector(size))
        held = self.DeclareDiscreteState(np.full(size, np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._measure)
        self.DeclareStateOutputPort("measured", held)

    def _measure(self, context, state):
        state.set_value(self._input.Eval(context))


def nothing(t, value, last):
    return np.full(len(value), np.nan)


def infinite(t, value, last):
    return np.where(np.arange(len(value)) == 1, np.inf, value)


def frozen(t, value, last):
    return last


def noisy(position, velocity):
    """A fault of Gaussian noise of these sizes, rad and rad/s, new every other millisecond."""

    def fault(t, value, last):
        noise = np.random.default_rng(round(500 * t)).normal(size=len(value))
        half = len(value) // 2
        return value + noise * np.repeat([position, velocity], half)

    return fault
