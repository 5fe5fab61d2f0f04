"""The simulation behind rollouts of a robot behind a transmission, at its actuators."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus

from geodrake.control.rollout.acting import Acting, picked
from geodrake.control.rollout.passages import Passage
from geodrake.control.rollout.simulation import FASTEST, positions_along
from geodrake.model.robot_model import RobotModel
from geodrake.model.simulation.driven_robot import DrivenPlant, Driving
from geodrake.robot.plant import load_plant, set_inertial_parameters

Array = NDArray[np.float64]


class DrivenSimulation:
    """The diagram: efforts of actuators, and the plant, in the time of a log.

    Args:
        fastest: (nv,) peak speeds of the measured motion, rad/s or m/s.
        steps: One item for each step of the integrator that is left.
    """

    notes: tuple[str, ...] = ()

    def __init__(
        self,
        model: RobotModel,
        driving: Driving,
        acting: Acting,
        *,
        fastest: Array,
        steps: Iterator[int],
    ) -> None:
        self._model, self._fastest, self._steps = model, fastest, steps
        self._acting = acting
        builder = DiagramBuilder()
        loaded = load_plant(model.path, floating=model.floating, held=model.held, given=model.given)
        self._plant = builder.AddSystem(loaded.plant)
        self._driving = driving.in_plant(self._plant)
        places = model.positions(np.arange(len(model.joints), dtype=float)[None])[0]
        self._order = np.argsort(places)  # where the position of each velocity stands
        system = builder.AddSystem(DrivenPlant(self._driving))
        system.close_loop(builder)
        own = np.concatenate([self._order, len(places) + np.arange(len(places))])
        state = picked(builder, system.GetOutputPort("state"), own)
        builder.Connect(acting.add(builder, state), system.GetInputPort("effort"))
        self._diagram = builder.Build()

    def positions(self, passage: Passage) -> Array:
        """(K, nv) positions from a passage's first state on; see `Simulation.positions`."""
        segment, time = passage.segment, passage.time
        self._acting.begin(passage)
        simulator = Simulator(self._diagram)
        root = simulator.get_mutable_context()
        root.SetTime(time[0])
        self._acting.remember(passage, root)
        context = self._plant.GetMyMutableContextFromRoot(root)
        set_inertial_parameters(self._plant, context, self._model.total_phi)
        q = self._model.positions(segment.position[:1])[0]
        state = self._driving.plant_state(q, np.asarray(segment.velocity[0]))
        self._plant.SetPositionsAndVelocities(context, np.concatenate(state))
        return positions_along(
            simulator,
            time,
            lambda: self._state(context)[0][self._order],
            decay=self._decay(q, float(time[0])),
            limit=self._limit,
        )

    def _state(self, context: Context) -> tuple[Array, Array]:
        return self._driving.model_state(self._plant.GetPositionsAndVelocities(context))

    def _limit(self, root: Context) -> EventStatus:
        """Ends a simulation that has no steps left, or whose robot is too fast for any."""
        _, velocity = self._state(self._plant.GetMyContextFromRoot(root))
        inside = bool((np.abs(velocity) < FASTEST * self._fastest).all())
        if inside and next(self._steps, None) is not None:
            return EventStatus.DidNothing()
        return EventStatus.ReachedTermination(self._diagram, "beyond all reason")

    def _decay(self, q: Array, time: float) -> float:
        """The fastest rate, 1/s, at which velocities near rest at q (nq,) decay by friction."""
        nv, step = len(self._model.joints), 1e-6
        M, _ = self._driving.mass_and_drift(q, np.zeros(nv), time)
        rates = step * np.eye(nv + 1, nv)
        places = np.repeat(q[None], nv + 1, axis=0)
        efforts = self._driving.needed(places, rates, np.zeros((nv + 1, nv)), time)
        slope = np.linalg.solve(M, (efforts[:nv] - efforts[nv]).T / step)
        return float(np.abs(np.linalg.eigvals(slope)).max())
