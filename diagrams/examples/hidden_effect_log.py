"""A log of a robot that has effects its model file lacks.

In a Drake diagram, a plant follows a random smooth motion by PD control of its joints, with the
inverse dynamics of the model file as feedforward and the hidden effects from `EffectForce`; a
payload is a welded body, a rotor that of Drake's actuators. Efforts have white noise and positions
encoder ticks, so that the log looks measured. For example

    python -m diagrams.examples.hidden_effect_log --robot arm7 --log friction.csv \
        --effect coulomb_friction --where joint_4 --size 3
    geodrake explain models/arm7.urdf friction.csv

(these three options may be repeated). The log that comes with the package is made by

    python -m diagrams.examples.hidden_effect_log --demo --log geodrake/demo/demo.csv
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex, JointIndex, PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from diagrams.harness import MODELS, script_parser, sines, tell
from geodrake.control import DelayedEffort, EffectForce
from geodrake.effects import Effect, EffortDelay, make_effect
from geodrake.effects.sensors import delays_of
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array, from_mass_com_inertia, to_spatial_inertia
from geodrake.logs import JointLog, write_log
from geodrake.robot import joint_names

ROBOTS = ("arm6", "arm7", "double_pendulum")
FREQUENCIES = 0.1 * np.arange(1, 7)  # 1/s, of the motion, about
LONGEST = 60.0  # s, over which the motion stays within its limits
REACH, PACE = 0.6, 0.6  # shares of the position and velocity limits that the motion uses
FASTEST = 3.0  # rad/s, for joints that could go faster
DENSITY = 3000.0  # kg/m³, of payloads given by mass and centre
TIME_STEP = 1e-3  # s
SIGN_WIDTH = 0.01  # rad/s, speed below which dry friction fades
ENCODER_STEP = 2e-5  # rad
DRIVE_GAINS = PdControllerGains(p=1e4, d=2e2)  # N·m/rad and N·m·s/rad
PLANT_EFFECTS = ("payload", "rotor_inertia")  # those that Drake's plant has itself


@dataclass(frozen=True)
class HiddenEffect:
    """An effect of the simulated robot."""

    name: str
    where: tuple[str, ...]  # joints or body it acts at; nothing for a delay of all efforts
    # Its linear parameters in SI units; the delay in s for `effort_delay`; mass and centre (m, x,
    # y, z) for a `payload`, which is then a ball.
    size: tuple[float, ...]

    def law(self) -> tuple[Effect, Array]:
        """Return the effect and its linear parameters."""
        if self.name == EffortDelay.name:
            return EffortDelay(self.size[0], *self.where), np.empty(0)
        effect, size = make_effect(self.name, self.where), np.array(self.size)
        if self.name == "payload" and len(size) == 4:
            radius = np.cbrt(size[0] / (4 / 3 * np.pi * DENSITY))
            size = from_mass_com_inertia(size[0], size[1:], 0.4 * size[0] * radius**2 * np.eye(3))
        return effect, size


@dataclass(frozen=True)
class Scenario:
    """A simulation and its log."""

    robot: str = "arm6"
    hidden: tuple[HiddenEffect, ...] = ()
    duration: float = 24.0
    rate: float = 250.0
    effort_noise: float = 0.03  # deviation of the efforts' white noise, as a share of their own
    seed: int = 0

    def laws(self) -> list[tuple[Effect, Array]]:
        """Return hidden effects and their linear parameters."""
        return [hidden.law() for hidden in self.hidden]


DEMO = Scenario(
    robot="arm6",
    hidden=(
        HiddenEffect("payload", ("flange",), (2.5, 0.02, -0.01, 0.12)),
        HiddenEffect("coulomb_friction", ("shoulder_pitch",), (8.0,)),
        HiddenEffect("viscous_friction", ("shoulder_pitch",), (10.0,)),
        HiddenEffect("coulomb_friction", ("elbow_pitch",), (4.0,)),
        HiddenEffect("viscous_friction", ("elbow_pitch",), (5.0,)),
    ),
    rate=200.0,
)


def simulate(*, scenario: Scenario) -> JointLog:
    """Simulate a scenario and log it.

    Raises:
        ArgumentError: There is no such robot, effect or place.
    """
    plant = load(scenario)
    motion = random_motion(plant, scenario=scenario)
    states, efforts = track(plant, motion, scenario=scenario)
    return measure(plant, states, efforts, scenario=scenario)


def load(scenario: Scenario, *, hidden: bool = True) -> MultibodyPlant:
    """Return the plant of the model file with drives at its joints, and with hidden bodies."""
    if scenario.robot not in ROBOTS:
        raise ArgumentError(f"There is no robot {scenario.robot!r}.", advice=f"Choose of {ROBOTS}.")
    plant = MultibodyPlant(TIME_STEP)
    (arm,) = Parser(plant).AddModels(str(MODELS / f"{scenario.robot}.urdf"))
    root = plant.get_body(plant.GetBodyIndices(arm)[0])
    plant.WeldFrames(plant.world_frame(), root.body_frame())
    laws = scenario.laws() if hidden else []
    for place in {place for effect, _ in laws for place in effect.where}:
        if not (plant.HasJointNamed(place) or plant.HasBodyNamed(place)):
            raise ArgumentError(f"{scenario.robot} has no joint or body {place!r}.")
    rotors = {e.where[0]: mu[0] for e, mu in laws if e.name == "rotor_inertia"}
    for index in plant.GetJointIndices(arm):
        joint = plant.get_joint(JointIndex(index))
        if joint.num_velocities():
            drive = plant.AddJointActuator(joint.name(), joint)
            drive.set_default_rotor_inertia(rotors.get(joint.name(), 0.0))
            drive.set_controller_gains(DRIVE_GAINS)
    for effect, phi in laws:
        if effect.name == "payload":
            ball = plant.AddRigidBody("hidden payload", arm, to_spatial_inertia(phi))
            plant.WeldFrames(plant.GetFrameByName(effect.where[0]), ball.body_frame())
    plant.Finalize()
    return plant


def random_motion(plant: MultibodyPlant, *, scenario: Scenario) -> PiecewisePolynomial:
    """Return a sum of sines that does not repeat, of random frequencies, amplitudes and phases."""
    rng = np.random.default_rng(scenario.seed)
    shape = (len(FREQUENCIES), plant.num_velocities())
    amplitude, phase = rng.uniform(0.3, 1.0, shape), rng.uniform(0, 2 * np.pi, shape)
    rate = 2 * np.pi * (FREQUENCIES[:, None] + rng.uniform(-0.04, 0.04, shape))
    time = np.arange(0.0, max(scenario.duration, LONGEST) + 0.02, 0.01)
    q, v, _ = sines(time, amplitude, rate, phase)
    low, high = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    half = np.minimum((high - low) / 2, np.pi / 2)
    center = np.clip(0.0, low + half, high - half)
    fastest = np.minimum(plant.GetVelocityUpperLimits(), FASTEST)
    scale = np.maximum(np.abs(q).max(0) / (REACH * half), np.abs(v).max(0) / (PACE * fastest))
    return PiecewisePolynomial.CubicHermite(time, (center + q / scale).T, (v / scale).T)


def add_drives(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    motion: PiecewisePolynomial,
    clean: MultibodyPlant,
) -> OutputPort:
    """Have the plant follow a motion, and return the effort (nv) of its drives in the last step.

    That is inverse dynamics of the `clean` plant, which a controller knows, and PD control of the
    actuators, which a discrete plant takes implicitly: gains may be as stiff as real ones.
    """
    feedforward = builder.AddSystem(
        InverseDynamics(clean, InverseDynamics.InverseDynamicsMode.kInverseDynamics)
    )
    state = builder.AddSystem(TrajectorySource(motion, 1)).get_output_port()
    acceleration = builder.AddSystem(TrajectorySource(motion.MakeDerivative(2))).get_output_port()
    arm = plant.get_joint_actuator(JointActuatorIndex(0)).model_instance()
    builder.Connect(state, feedforward.GetInputPort("estimated_state"))
    builder.Connect(state, plant.get_desired_state_input_port(arm))
    builder.Connect(acceleration, feedforward.GetInputPort("desired_acceleration"))
    builder.Connect(feedforward.get_output_port(), plant.get_actuation_input_port())
    return plant.get_net_actuation_output_port()


def track(
    plant: MultibodyPlant, motion: PiecewisePolynomial, *, scenario: Scenario
) -> tuple[Array, Array]:
    """Return states (N, nq + nv) and efforts (N, nv) of the plant along its motion."""
    laws = scenario.laws()
    forces = [law for law in laws if law[0].name not in (*PLANT_EFFECTS, EffortDelay.name)]
    delays = delays_of([effect for effect, _ in laws], joint_names(plant))
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    clean = load(scenario, hidden=False)
    effort = add_drives(builder, plant, motion, clean)
    if forces:
        block = EffectForce.AddToBuilder(builder, plant, forces, sign_width=SIGN_WIDTH)
        builder.Connect(effort, block.GetInputPort("applied_effort"))
    if delays.any():
        late = builder.AddSystem(DelayedEffort(delays, period=TIME_STEP))
        builder.Connect(effort, late.get_input_port())
        effort = late.get_output_port()
    ports = plant.get_state_output_port(), effort
    logs = [LogVectorOutput(port, builder, TIME_STEP) for port in ports]
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    start = [motion.value(0.0), motion.derivative().value(0.0)]
    plant.SetPositionsAndVelocities(plant.GetMyContextFromRoot(context), np.ravel(start))
    simulator.AdvanceTo(scenario.duration)
    states, efforts = (log.FindLog(context).data().T for log in logs)
    # The plant's port tells the effort of the step that ends; it belongs to the state before.
    every = round(1 / (scenario.rate * TIME_STEP))
    return states[:-1:every], efforts[1::every]


def measure(
    plant: MultibodyPlant, states: Array, efforts: Array, *, scenario: Scenario
) -> JointLog:
    """Return the log of a simulation, as measured by sensors."""
    on_effort, on_velocity = np.random.default_rng(scenario.seed + 1).spawn(2)
    q, v = np.split(states, [plant.num_positions()], axis=1)
    noise = scenario.effort_noise * efforts.std(axis=0)
    return JointLog(
        name=f"{scenario.robot} seed {scenario.seed}",
        joints=joint_names(plant),
        time=np.round(np.arange(len(q)) / scenario.rate, 6),
        position=np.round(ENCODER_STEP * np.round(q / ENCODER_STEP), 6),
        effort=np.round(efforts + noise * on_effort.normal(size=efforts.shape), 4),
        velocity=np.round(v + 10 * ENCODER_STEP * on_velocity.normal(size=v.shape), 5),
    )


def read_scenario() -> tuple[argparse.Namespace, Scenario]:
    """Return command line options, and their scenario."""
    parser = script_parser(__doc__, "a log of 4 s, for a first look")
    parser.add_argument("--log", type=Path, help="file for the log, .csv or .npz")
    parser.add_argument("--demo", action="store_true", help="the log that comes with the package")
    parser.add_argument("--robot", choices=ROBOTS, default=ROBOTS[0])
    parser.add_argument("--effect", action="append", default=[], help="name of a hidden effect")
    parser.add_argument("--where", action="append", default=[], help="joints or body, by commas")
    parser.add_argument("--size", action="append", default=[], help="parameters, by commas")
    options = parser.parse_args()
    hidden = tuple(
        HiddenEffect(name, tuple(filter(None, at.split(","))), tuple(map(float, size.split(","))))
        for name, at, size in zip(options.effect, options.where, options.size, strict=True)
    )
    scenario = DEMO if options.demo else Scenario(robot=options.robot, hidden=hidden)
    duration = 4.0 if options.quick else scenario.duration
    return options, replace(scenario, seed=options.seed, duration=duration)


def main() -> None:
    """Simulate, print, and write what was asked for."""
    try:
        options, scenario = read_scenario()
        log = simulate(scenario=scenario)
        if options.log:
            write_log(log, options.log)
    except (GeodrakeError, ValueError) as error:
        raise SystemExit(str(error)) from None
    effort = dict(zip(log.joints, log.effort.std(0).tolist(), strict=True))
    tell(options, {"scenario": scenario, "samples": len(log), "effort_std": effort})


if __name__ == "__main__":
    main()
