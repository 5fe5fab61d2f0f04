"""The simulations of a case: one for each of its logs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.control.rollout.acting import acting_in
from geodrake.control.rollout.driven_simulation import DrivenSimulation
from geodrake.control.rollout.passages import Passage, moving_passages
from geodrake.control.rollout.simulation import Simulation, allowed_steps
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.reduce import peak_speeds
from geodrake.model.carried_payloads import carrying

Array = NDArray[np.float64]

_SIGN_WIDTH = 5e-3  # share of a joint's peak speed below which dry friction fades


def chosen_passages(case: Case, horizon: float, most: int) -> list[Passage]:
    """Passages that are simulated, spread evenly over all that moves.

    Args:
        horizon: Length of each, s.

    Raises:
        LogError: No log moves for as long.
    """
    passages = moving_passages(case, horizon)
    count = min(most, len(passages))
    chosen = np.unique(np.linspace(0, len(passages) - 1, count).round().astype(int))
    return [passages[k] for k in chosen.tolist()]


class Simulations:
    """Simulations of the model of a case, made when a log is first asked for.

    Args:
        commands: Whether servos close the loop.
    """

    def __init__(self, case: Case, passages: Sequence[Passage], *, commands: bool = False) -> None:
        self._case, self._commands = case, commands
        self._logs = {log.name: log for log in case.asked.logs}
        self._prepared = {trajectory.name: trajectory for trajectory in case.trajectories}
        self._steps = allowed_steps(passages)
        self._fastest = np.maximum(peak_speeds(case.trajectories), 1e-3)
        self._made: dict[str, Simulation | DrivenSimulation] = {}
        self._sign_width = case.model.sign_widths(_SIGN_WIDTH * self._fastest)

    def __call__(self, log: str) -> Simulation | DrivenSimulation:
        """The simulation of a log."""
        if log not in self._made:
            self._made[log] = self._make(log)
        return self._made[log]

    def _make(self, log: str) -> Simulation | DrivenSimulation:
        prepared = self._prepared[log]
        loaded, warmth = carrying(self._case.model, prepared.payloads), prepared.temperatures
        acting = acting_in(loaded, self._logs[log], commands=self._commands)
        fastest, steps = self._fastest, self._steps
        if loaded.transmission:
            driving = loaded.driving(self._sign_width, log, warmth)
            if driving is not None:
                return DrivenSimulation(loaded, driving, acting, fastest=fastest, steps=steps)
        return Simulation(
            loaded, self._sign_width, log, warmth, acting=acting, fastest=fastest, steps=steps
        )
