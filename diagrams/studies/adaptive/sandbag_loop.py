"""The AMBIDEX-like arm in a closed loop: point-to-point motions, uneven friction, simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import Adder, LogVectorOutput, MatrixGain, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from diagrams.studies.adaptive.coupled import SIGN_WIDTH, Known, joint_map, make_coupled_plant
from diagrams.studies.adaptive.loop import LOG_PERIOD, LOST, Record
from diagrams.studies.ambidex.arm import COULOMB, REACH, REDUCTION, Arm
from diagrams.studies.ambidex.draws import Plan, prior_of
from diagrams.studies.ambidex.measurements import UNEVEN, WAVES, measure
from geodrake.control import EffectForce
from geodrake.control.systems import AdaptiveController
from geodrake.identification import identify

DURATION = 1.5  # s of a motion, [Lee2019] §5.6
GAMMA, DELTA, HULL = 0.03, 0.4, 2.0  # of the identification, as in ambidex_arm.py


def identified(seed: int) -> Known:
    """The arm as identified from the motions of `ambidex_arm.py` with the entropic divergence."""
    arm = Arm.load()
    measured = measure(arm, seed=seed, hull=HULL)
    plan = Plan(draws=1, counts=(), gamma=GAMMA, delta=DELTA, hull=HULL, seed=seed)
    result = identify(
        measured.full[:, :-1],
        measured.full[:, -1],
        prior_of(0, plan, measured)[1],
        regularizer="entropic",
        gamma=GAMMA,
        ellipsoids=measured.hulls,
        extra_bounds=np.tile([0.0, np.inf], (14, 1)),
        solver="newton",
    )
    return Known(result.phi, result.extra[:7], result.extra[7:])


def point_to_point(count: int, seed: int) -> PiecewisePolynomial:
    """Turns (7) that go from one random place to the next with least jerk, starting at zero."""
    rng = np.random.default_rng([seed, 56])
    ends = np.vstack([np.zeros(7), rng.uniform(-REACH, REACH, (count, 7))])
    s = np.linspace(0.0, 1.0, 31)
    share = 10 * s**3 - 15 * s**4 + 6 * s**5
    still, whole = np.zeros((7, 1)), PiecewisePolynomial()
    for k in range(count):
        q = ends[k] + share[:, None] * (ends[k + 1] - ends[k])
        part = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
            (s + k) * DURATION, q.T, still, still
        )
        if k:
            whole.ConcatenateInTime(part)
        else:
            whole = part
    return whole


class UnevenFriction(LeafSystem):
    """Dry friction of motors that depends on their position, which no parameter explains.

    .. pydrake_system::

        name: UnevenFriction
        input_ports:
        - state
        output_ports:
        - generalized_force
    """

    def __init__(self, seed: int) -> None:
        """Constructs the system.

        Args:
            seed: Of where it is more and where less.
        """
        LeafSystem.__init__(self)
        self._phase = np.random.default_rng([seed, 57]).uniform(0.0, 2.0 * np.pi, 7)
        motors = np.eye(7)
        motors[5:, 5:] = [[1.0, 1.0], [1.0, -1.0]]
        self._motors = REDUCTION * motors @ np.linalg.pinv(joint_map())
        self._state = self.DeclareVectorInputPort("state", BasicVector(20))
        self.DeclareVectorOutputPort("generalized_force", BasicVector(10), self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state = self._state.Eval(context)
        q, v = self._motors @ state[:10], self._motors @ state[10:]
        sign = np.tanh(v / (SIGN_WIDTH * REDUCTION))
        share = np.sqrt(2.0) * UNEVEN * np.sin(WAVES * q / REDUCTION + self._phase)
        output.SetFromVector(-self._motors.T @ (share * COULOMB * sign))


def simulate_coupled(
    controller: AdaptiveController,
    bags: Sequence[int],
    motion: Trajectory,
    *,
    seed: int,
    end: float | None = None,
) -> Record:
    """Simulates the arm with sandbags over a motion of its turns, to `end`, or until it is lost."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(make_coupled_plant(bags))
    builder.AddSystem(controller)
    turns = np.linalg.pinv(joint_map())
    measured = builder.AddSystem(MatrixGain(np.kron(np.eye(2), turns)))
    applied = builder.AddSystem(MatrixGain(turns.T))
    desired = builder.AddSystem(TrajectorySource(motion, 1))
    acceleration = builder.AddSystem(TrajectorySource(motion.MakeDerivative(2)))
    state = plant.get_state_output_port()
    builder.Connect(state, measured.get_input_port())
    builder.Connect(measured.get_output_port(), controller.GetInputPort("estimated_state"))
    builder.Connect(desired.get_output_port(), controller.GetInputPort("desired_state"))
    builder.Connect(acceleration.get_output_port(), controller.GetInputPort("desired_acceleration"))
    builder.Connect(controller.GetOutputPort("actuation"), applied.get_input_port())
    builder.Connect(applied.get_output_port(), plant.get_actuation_input_port())
    _add_friction(builder, plant, seed)
    ports = {
        "state": measured.get_output_port(),
        "desired": desired.get_output_port(),
        "parameters": controller.GetOutputPort("parameters"),
    }
    sinks = {name: LogVectorOutput(port, builder, LOG_PERIOD) for name, port in ports.items()}
    simulator = Simulator(builder.Build())
    lost = _watch(simulator, plant, motion)
    simulator.Initialize()
    simulator.AdvanceTo(motion.end_time() if end is None else end)
    logs = {name: sink.FindLog(simulator.get_context()) for name, sink in sinks.items()}
    data = {name: np.array(log.data().T) for name, log in logs.items()}
    return Record(
        time=np.array(logs["state"].sample_times()),
        error=(data["state"] - data["desired"])[:, :7],
        parameters=data["parameters"],
        lyapunov=np.zeros(0),
        lost=lost[0],
    )


def _add_friction(builder: DiagramBuilder, plant: MultibodyPlant, seed: int) -> None:
    """Friction that parameters explain, and friction that they do not."""
    joints = [plant.get_joint(index).name() for index in plant.GetJointIndices()]
    moving = [name for name in joints if plant.GetJointByName(name).num_velocities()]
    known = Known.true(Arm.load().phi).friction(moving)
    effects = [(fitted.effect, fitted.parameters) for fitted in known]
    even = builder.AddSystem(EffectForce(plant, effects, sign_width=SIGN_WIDTH))
    uneven = builder.AddSystem(UnevenFriction(seed))
    both = builder.AddSystem(Adder(2, 10))
    state = plant.get_state_output_port()
    builder.Connect(state, even.GetInputPort("state"))
    builder.Connect(state, uneven.get_input_port())
    builder.Connect(even.get_output_port(), both.get_input_port(0))
    builder.Connect(uneven.get_output_port(), both.get_input_port(1))
    builder.Connect(both.get_output_port(), plant.get_applied_generalized_force_input_port())


def _watch(simulator: Simulator, plant: MultibodyPlant, motion: Trajectory) -> list[bool]:
    """Ends the simulation when the arm is lost; whether it was."""
    J, gone = joint_map(), [False]

    def monitor(root: Context) -> EventStatus:
        q = plant.GetPositions(plant.GetMyContextFromRoot(root))
        wanted = J @ motion.value(min(root.get_time(), motion.end_time())).ravel()
        gone[0] = not np.abs(q - wanted).max() < LOST
        if gone[0]:
            return EventStatus.ReachedTermination(plant, "lost")
        return EventStatus.DidNothing()

    simulator.set_monitor(monitor)
    return gone
