"""How fast adaptive control is: a closed loop, one step of a controller, and the online estimator.

A seven-joint arm with 70 inertial parameters and 14 of friction is controlled at 1 kHz by the
passivity-based controller with the natural law, its plant at 10 kHz. Three questions: how much
faster than real time that is, beside the plant alone, and the plant with a system that does
nothing; how much longer a step of the controller is with adaptation than without; how many samples
a second the estimator takes, and what it makes of them, by exact projections and by nudges. All
times are CPU times of one core, of pieces of 50 ms of runs that take turns: the median, and the
fastest tenth, which is what they are where nothing else runs.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.adaptive_speed --json speed.json
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from rich.progress import track

from diagrams.harness import MODELS, bars, cpu_time, script_parser, tell
from geodrake.control import (
    AdaptiveComputedTorqueController,
    BregmanProjectionEstimator,
    ControlModel,
    PassivityBasedAdaptiveController,
    PredictionError,
    SampleUpdate,
    add_adaptive_loop,
    natural_adaptation,
    parameter_manifold,
)
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.systems import AdaptiveController
from geodrake.effects import CoulombFriction, FittedEffect, ViscousFriction
from geodrake.inertia import Array, from_pseudo_inertia, pseudo_inertia
from geodrake.manifolds import Product
from geodrake.manifolds.slabs import TOLERANCE
from geodrake.model import RobotModel, load_description

ARM = MODELS / "arm7.urdf"
CONTROL_STEP, PLANT_STEP = 1e-3, 1e-4  # s
DAMPING, COULOMB = 2.0, 1.0  # N·m·s/rad, N·m
PIECE = 0.05  # s, of simulated time
GAMMA = 0.05
NOISE = 0.02  # N·m, of the efforts that the estimator sees
EVERY = 2  # samples of the estimator to a projection
IDLE = "plant with an idle system"
WRONG = 0.1  # size of the congruences that spoil the first estimate


@dataclass(frozen=True)
class Arm:
    """The arm, a wrong estimate of it, and a motion."""

    model: RobotModel
    seed: int

    @classmethod
    def load(cls, seed: int) -> Arm:
        """The seven-joint arm with viscous and Coulomb friction at every joint."""
        model = load_description(ARM)
        effects = [
            FittedEffect(kind(joint), np.array([value]))
            for kind, value in ((ViscousFriction, DAMPING), (CoulombFriction, COULOMB))
            for joint in model.joints
        ]
        return cls(replace(model, effects=tuple(effects)), seed)

    @cached_property
    def control(self) -> ControlModel:
        """The arm as a controller sees it."""
        return ControlModel.of(self.model)

    @cached_property
    def manifold(self) -> Product:
        """The manifold of its 84 parameters."""
        return parameter_manifold(self.model)

    @cached_property
    def start(self) -> Array:
        """A wrong but physical estimate (84,)."""
        rng = np.random.default_rng(self.seed)
        P = pseudo_inertia(self.control.phi(self.control.prior))
        G = np.eye(4) + WRONG * rng.normal(size=P.shape)
        phi = from_pseudo_inertia(G @ P @ G.transpose(0, 2, 1))
        return np.concatenate([phi.ravel(), 1.2 * self.control.prior[phi.size :]])

    @cached_property
    def motion(self) -> PiecewisePolynomial:
        """A smooth motion of all joints."""
        t = np.linspace(0.0, 20.0, 201)
        phase = np.outer(np.linspace(0.7, 2.0, 7), t) + np.arange(7)[:, None]
        return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, 0.5 * np.sin(phase))

    def plant(self, damping: float = DAMPING) -> MultibodyPlant:
        """The discrete plant, with viscous friction as Drake's damping."""
        plant = MultibodyPlant(PLANT_STEP)
        plant.SetUseSampledOutputPorts(False)
        # Without contact every approximation is the same; this one is the fastest.
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kTamsi)
        Parser(plant).AddModels(str(ARM))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("link_0"))
        for index in plant.GetJointIndices():
            joint = plant.get_mutable_joint(index)
            if joint.num_velocities() == 1:
                joint.set_default_damping_vector([damping])
                if not plant.HasJointActuatorNamed(joint.name()):
                    plant.AddJointActuator(joint.name(), joint)
        plant.Finalize()
        return plant

    def controller(self, law: UpdateLaw | None) -> AdaptiveController:
        """The passivity-based controller."""
        return PassivityBasedAdaptiveController(
            self.control, law, time_step=CONTROL_STEP, parameters=self.start
        )

    def filtered(self, law: UpdateLaw | None) -> AdaptiveController:
        """Computed torque by the filtered regressor."""
        return AdaptiveComputedTorqueController(
            self.control,
            law,
            time_step=CONTROL_STEP,
            parameters=self.start,
            prediction=PredictionError(1.0, alone=True),
        )

    @cached_property
    def law(self) -> UpdateLaw:
        """The natural law."""
        return natural_adaptation(self.manifold, GAMMA)


def closed_loop(arm: Arm, law: UpdateLaw | None, *, dry: bool) -> tuple[Diagram, Context]:
    """The whole loop; with dry friction, its force is evaluated at every step of the plant."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(arm.plant(0.0 if dry else DAMPING))
    effects = [(fitted.effect, fitted.parameters) for fitted in arm.model.effects] if dry else []
    loop = add_adaptive_loop(
        builder, plant, arm.controller(law), arm.motion, effects=effects, sign_width=0.05
    )
    diagram = builder.Build()
    return diagram, loop.context(diagram)


class Idle(LeafSystem):
    """A system in Python that sees the state at the controller's rate, and asks for no effort."""

    def __init__(self, states: int, efforts: int) -> None:
        super().__init__()
        self._state = self.DeclareVectorInputPort("state", states)
        self._effort = self.DeclareDiscreteState(efforts)
        self.DeclarePeriodicDiscreteUpdateEvent(CONTROL_STEP, 0.0, self._update)
        self.DeclareStateOutputPort("effort", self._effort)

    def _update(self, context: Context, discrete_state: Any) -> EventStatus:
        self._state.Eval(context)
        return EventStatus.Succeeded()


def plant_alone(arm: Arm, *, idle: bool = False) -> tuple[Diagram, Context]:
    """The plant that falls by itself, perhaps with a system that does nothing about it."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(arm.plant())
    if idle:
        system = builder.AddSystem(Idle(plant.num_multibody_states(), plant.num_actuators()))
        builder.Connect(plant.get_state_output_port(), system.GetInputPort("state"))
        builder.Connect(system.GetOutputPort("effort"), plant.get_actuation_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyMutableContextFromRoot(context)
    plant.SetPositions(own, arm.motion.value(0.0).ravel())
    plant.SetVelocities(own, arm.motion.EvalDerivative(0.0, 1).ravel())
    return diagram, context


def controller_alone(arm: Arm, system: AdaptiveController) -> tuple[Diagram, Context]:
    """A controller that sees a motion 0.1 ms late, so that there always is a little to adapt to."""
    builder = DiagramBuilder()
    builder.AddSystem(system)
    t = np.linspace(0.0, 20.0, 201)
    late = arm.motion.vector_values(np.maximum(t - 1e-4, 0.0))
    seen = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, late)
    sources = {
        "estimated_state": TrajectorySource(seen, 1),
        "desired_state": TrajectorySource(arm.motion, 1),
        "desired_acceleration": TrajectorySource(arm.motion.MakeDerivative(2)),
    }
    for name, source in sources.items():
        builder.Connect(builder.AddSystem(source).get_output_port(), system.GetInputPort(name))
    diagram = builder.Build()
    return diagram, diagram.CreateDefaultContext()


def estimator(
    arm: Arm, duration: float, *, every: int = 1, method: str = "projection"
) -> tuple[Diagram, Context]:
    """The estimator along the motion, fed with noisy efforts, projecting every so many samples."""
    time_stamps = np.arange(0.0, duration + 0.2, CONTROL_STEP)
    q, v, a = (
        np.array([arm.motion.EvalDerivative(t, order).ravel() for t in time_stamps])
        for order in range(3)
    )
    control = arm.control
    rows = zip(q, v, a, strict=True)
    effort = np.array([control.at(q, v, v, a).effort(control.prior) for q, v, a in rows])
    effort += NOISE * np.random.default_rng(arm.seed).normal(size=effort.shape)
    builder = DiagramBuilder()
    sources = {
        "estimated_state": TrajectorySource(arm.motion, 1),
        "effort": TrajectorySource(PiecewisePolynomial.FirstOrderHold(time_stamps, effort.T)),
    }
    system = builder.AddSystem(
        BregmanProjectionEstimator(
            control,
            SampleUpdate(arm.manifold, np.full(7, 2.0 * NOISE), method=method),
            time_step=CONTROL_STEP,
            parameters=arm.start,
            update_every=every,
        )
    )
    for name, source in sources.items():
        builder.Connect(builder.AddSystem(source).get_output_port(), system.GetInputPort(name))
    diagram = builder.Build()
    return diagram, diagram.CreateDefaultContext()


def accuracy(arm: Arm, duration: float) -> dict[str, dict[str, float]]:
    """What exact projections and nudges make of the same samples, every one of them."""
    table = {}
    for method in ("projection", "nudge"):
        diagram, context = estimator(arm, duration, method=method)
        (system,) = (s for s in diagram.GetSystems() if isinstance(s, BregmanProjectionEstimator))
        simulator = Simulator(diagram, context)
        own, residuals, errors = system.GetMyContextFromRoot(context), [], []
        simulator.Initialize()
        for stop in np.arange(0.01, duration, 0.01):
            simulator.AdvanceTo(stop)
            residuals.append(system.GetOutputPort("residual").Eval(own))
            errors.append(float(system.GetOutputPort("projection_error").Eval(own)[0]))
        p, truth = system.parameters(own), arm.control.prior
        first = float(arm.manifold.divergence(truth, arm.start))
        table[method] = {
            "RMS error of a sample before it is used, last half, N·m": float(
                np.sqrt(np.mean(np.square(residuals[len(residuals) // 2 :])))
            ),
            "RMS error of the motion's efforts, N·m": unexplained(arm, p),
            "divergence from the truth / at the start": float(
                arm.manifold.divergence(truth, p) / first
            ),
            "share of samples with a certificate": float(np.mean(np.array(errors) <= TOLERANCE)),
        }
    table["start"] = {"RMS error of the motion's efforts, N·m": unexplained(arm, arm.start)}
    return table


def unexplained(arm: Arm, p: Array) -> float:
    """RMS error of the efforts along the whole motion, N·m."""
    squares = []
    for t in np.arange(0.0, 20.0, 0.1):
        q, v, a = (arm.motion.EvalDerivative(t, order).ravel() for order in range(3))
        error = arm.control.at(q, v, v, a).regressor @ (p - arm.control.prior)
        squares.append(error**2)
    return float(np.sqrt(np.mean(squares)))


def cpu_times(made: tuple[Diagram, Context], duration: float) -> list[float]:
    """Return CPU seconds a simulated second of every piece, after a tenth to warm up."""
    simulator = Simulator(*made)
    simulator.Initialize()
    simulator.AdvanceTo(0.1)
    stops = 0.1 + PIECE * np.arange(1, round(duration / PIECE) + 1)
    return [cpu_time(partial(simulator.AdvanceTo, stop)) / PIECE for stop in stops]


def measure(arm: Arm, *, duration: float, repeats: int) -> dict[str, list[float]]:
    """CPU seconds a simulated second of all pieces of everything, `repeats` times in turn."""
    work: dict[str, Callable[[], tuple[Diagram, Context]]] = {
        "plant": lambda: plant_alone(arm),
        IDLE: lambda: plant_alone(arm, idle=True),
        "loop": lambda: closed_loop(arm, arm.law, dry=False),
        "loop without adaptation": lambda: closed_loop(arm, None, dry=False),
        "loop with dry friction": lambda: closed_loop(arm, arm.law, dry=True),
        "step": lambda: controller_alone(arm, arm.controller(arm.law)),
        "step without adaptation": lambda: controller_alone(arm, arm.controller(None)),
        "filtered step": lambda: controller_alone(arm, arm.filtered(arm.law)),
        "filtered step without adaptation": lambda: controller_alone(arm, arm.filtered(None)),
        "estimator": lambda: estimator(arm, duration),
        "estimator, projecting every second": lambda: estimator(arm, duration, every=EVERY),
        "estimator, nudging": lambda: estimator(arm, duration, method="nudge"),
        "estimator, nudging every second": lambda: estimator(
            arm, duration, every=EVERY, method="nudge"
        ),
    }
    times: dict[str, list[float]] = {name: [] for name in work}
    for _ in track(range(repeats), description="measuring"):
        for name, make in work.items():
            times[name] += cpu_times(make(), duration)
    return times


def summary(times: dict[str, list[float]]) -> dict[str, Any]:
    """Return the answers, of the fastest tenth of all pieces (undisturbed) and of the median."""
    table: dict[str, Any] = {}
    for name, share in (("undisturbed", 0.1), ("median", 0.5)):
        cost = {key: float(np.quantile(values, share)) for key, values in times.items()}
        filtered = cost["filtered step"], cost["filtered step without adaptation"]
        table[name] = {
            "CPU seconds a simulated second": cost,
            "times real time": 1.0 / cost["loop"],
            "times real time, the plant alone": 1.0 / cost["plant"],
            "speed of the loop / of the plant": cost["plant"] / cost["loop"],
            "speed with an idle system / of the plant": cost["plant"] / cost[IDLE],
            "times real time, without adaptation": 1.0 / cost["loop without adaptation"],
            "times real time, with dry friction": 1.0 / cost["loop with dry friction"],
            "adaptive step / step": cost["step"] / cost["step without adaptation"],
            "filtered adaptive step / step": filtered[0] / filtered[1],
        }
        estimators = [key for key in cost if key.startswith("estimator")]
        table[name] |= {
            f"{key}, samples a second": 1.0 / (CONTROL_STEP * cost[key]) for key in estimators
        }
    return table


def main() -> None:
    """Measure, print, and write what was asked for."""
    parser = script_parser(__doc__, "a short run, once")
    parser.add_argument("--repeats", type=int, help="of every time")
    options = parser.parse_args()
    duration, repeats = (0.05, 1) if options.quick else (2.0, 7)
    arm = Arm.load(options.seed)
    times = measure(arm, duration=duration, repeats=options.repeats or repeats)
    table = summary(times) | {"estimator": accuracy(arm, 1.0 if options.quick else 10.0)}
    cost = table["undisturbed"]["CPU seconds a simulated second"]
    each = {name: 1e3 * CONTROL_STEP * value for name, value in cost.items()}
    title = "CPU time of one millisecond of control"
    tell(options, table, adaptive_speed=lambda: bars({title: each}, "ms"))


if __name__ == "__main__":
    main()
