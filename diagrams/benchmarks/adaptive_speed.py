"""How fast adaptive control is: a closed loop, and the online estimator.

The passivity-based controller with the natural law drives a seven-joint arm (70 inertial and 14
friction parameters) at 1 kHz, its plant at 10 kHz. How much faster than real time is that, and how
many samples a second does the estimator take? Times are CPU times of one core, of 50 ms pieces of
runs that take turns: the median, and the fastest tenth, which other processes disturb least.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.adaptive_speed --json speed.json
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from rich.progress import track

from diagrams.harness import MODELS, cpu_time, script_parser, tell
from diagrams.studies.adaptive.loop import on_its_base
from geodrake.control import (
    BregmanProjectionEstimator,
    ControlModel,
    PassivityBasedAdaptiveController,
    SampleUpdate,
    add_adaptive_loop,
    natural_adaptation,
    parameter_manifold,
)
from geodrake.effects import CoulombFriction, FittedEffect, ViscousFriction
from geodrake.inertia import Array, from_pseudo_inertia, pseudo_inertia
from geodrake.manifolds import Product
from geodrake.model import RobotModel, load_description

ARM = MODELS / "arm7.urdf"
CONTROL_STEP, PLANT_STEP = 1e-3, 1e-4  # s
DAMPING, COULOMB = 2.0, 1.0  # N·m·s/rad, N·m
PIECE = 0.05  # s, of simulated time
GAMMA = 0.05
NOISE = 0.02  # N·m, of the efforts that the estimator sees
WRONG = 0.1  # size of the congruences that spoil the first estimate


@dataclass(frozen=True)
class Arm:
    """The arm, a wrong estimate of it, and a motion."""

    model: RobotModel
    seed: int

    @classmethod
    def load(cls, seed: int) -> Arm:
        """Return the seven-joint arm with viscous and Coulomb friction at every joint."""
        model = load_description(ARM)
        effects = [
            FittedEffect(kind(joint), np.array([value]))
            for kind, value in ((ViscousFriction, DAMPING), (CoulombFriction, COULOMB))
            for joint in model.joints
        ]
        return cls(replace(model, effects=tuple(effects)), seed)

    @cached_property
    def control(self) -> ControlModel:
        """The arm as the controller knows it."""
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

    def plant(self) -> MultibodyPlant:
        """Return the discrete plant, with viscous friction as Drake's damping."""
        plant = MultibodyPlant(PLANT_STEP)
        plant.SetUseSampledOutputPorts(False)
        # Without contact every approximation is the same; this one is the fastest.
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kTamsi)
        on_its_base(ARM, "link_0", plant, damping=DAMPING)
        plant.Finalize()
        return plant


def closed_loop(arm: Arm) -> tuple[Diagram, Context]:
    """Return the whole loop, of the passivity-based controller with the natural law."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(arm.plant())
    law = natural_adaptation(arm.manifold, GAMMA)
    how = {"time_step": CONTROL_STEP, "parameters": arm.start}
    controller = PassivityBasedAdaptiveController(arm.control, law, **how)
    loop = add_adaptive_loop(builder, plant, controller, arm.motion)
    diagram = builder.Build()
    return diagram, loop.context(diagram)


def plant_alone(arm: Arm) -> tuple[Diagram, Context]:
    """Return the plant without a controller, in free fall."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(arm.plant())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyMutableContextFromRoot(context)
    plant.SetPositions(own, arm.motion.value(0.0).ravel())
    plant.SetVelocities(own, arm.motion.EvalDerivative(0.0, 1).ravel())
    return diagram, context


def estimator(arm: Arm, duration: float) -> tuple[Diagram, Context]:
    """Return the estimator along the motion, fed with noisy efforts."""
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
            SampleUpdate(arm.manifold, np.full(7, 2.0 * NOISE)),
            time_step=CONTROL_STEP,
            parameters=arm.start,
        )
    )
    for name, source in sources.items():
        builder.Connect(builder.AddSystem(source).get_output_port(), system.GetInputPort(name))
    diagram = builder.Build()
    return diagram, diagram.CreateDefaultContext()


def cpu_times(made: tuple[Diagram, Context], duration: float) -> list[float]:
    """Return CPU seconds a simulated second of every piece, after a warm-up of a tenth."""
    simulator = Simulator(*made)
    simulator.Initialize()
    simulator.AdvanceTo(0.1)
    stops = 0.1 + PIECE * np.arange(1, round(duration / PIECE) + 1)
    return [cpu_time(partial(simulator.AdvanceTo, stop)) / PIECE for stop in stops]


def measure(arm: Arm, *, duration: float, repeats: int) -> dict[str, list[float]]:
    """Return CPU seconds a simulated second of all pieces, `repeats` times in turn."""
    work: dict[str, Callable[[], tuple[Diagram, Context]]] = {
        "plant": lambda: plant_alone(arm),
        "loop": lambda: closed_loop(arm),
        "estimator": lambda: estimator(arm, duration),
    }
    times: dict[str, list[float]] = {name: [] for name in work}
    for _ in track(range(repeats), description="measuring"):
        for name, make in work.items():
            times[name] += cpu_times(make(), duration)
    return times


def summary(times: dict[str, list[float]]) -> dict[str, Any]:
    """Return the answers by the fastest tenth of all pieces (undisturbed) and by the median."""
    table: dict[str, Any] = {}
    for name, share in (("undisturbed", 0.1), ("median", 0.5)):
        cost = {key: float(np.quantile(values, share)) for key, values in times.items()}
        table[name] = {
            "CPU seconds a simulated second": cost,
            "times real time": 1.0 / cost["loop"],
            "times real time, the plant alone": 1.0 / cost["plant"],
            "speed of the loop / of the plant": cost["plant"] / cost["loop"],
            "estimator, samples a second": 1.0 / (CONTROL_STEP * cost["estimator"]),
        }
    return table


def main() -> None:
    """Measure, print and write."""
    options = script_parser(__doc__, "a short run, once").parse_args()
    duration, repeats = (0.05, 1) if options.quick else (2.0, 7)
    arm = Arm.load(options.seed)
    times = measure(arm, duration=duration, repeats=repeats)
    tell(options, summary(times))


if __name__ == "__main__":
    main()
