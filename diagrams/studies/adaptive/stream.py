"""Logs streamed through the online estimator."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from geodrake.control import (
    BregmanProjectionEstimator,
    ControlModel,
    FilteredRegressor,
    LogSource,
    SampleUpdate,
)
from geodrake.logs import JointLog

Array = NDArray[np.float64]

STANDING = 0.02  # rad/s, below which a joint's friction is not known


@dataclass(frozen=True, eq=False)
class Streamed:
    """What an estimator made of a log, sample by sample.

    Attributes:
        time: (N,) s since the log's first sample.
        parameters: (N, p) the estimate.
        residual: (N, nv) filtered efforts − their prediction, N·m, before each update.
        used: (N,) whether the robot moved in all joints.
        seconds: CPU time, s.
    """

    time: Array
    parameters: Array
    residual: Array
    used: NDArray[np.bool_]
    seconds: float

    def rms(self, start: float = 0.0) -> Array:
        """(nv,) RMS of the residual of used samples after a share of the log."""
        part = self.used & (self.time >= start * self.time[-1])
        return np.sqrt(np.mean(self.residual[part] ** 2, axis=0))


def without_standing(log: JointLog) -> JointLog:
    """A log whose effort is missing while a joint stands.

    A standing joint holds whatever effort dry friction takes; no model predicts it.
    """
    effort = log.effort.copy()
    effort[(np.abs(log.velocity) < STANDING).any(axis=1)] = np.nan
    return replace(log, effort=effort)


def stream(
    log: JointLog, control: ControlModel, update: SampleUpdate, start: Array, *, period: float
) -> Streamed:
    """Plays a log to an estimator.

    Args:
        log: The log.
        control: The robot.
        update: What a sample does to the estimate.
        start: (p,) first estimate.
        period: Sampling period, s.
    """
    builder = DiagramBuilder()
    source = builder.AddSystem(LogSource(log, control.joints))
    estimator = builder.AddSystem(
        BregmanProjectionEstimator(
            control,
            update,
            filtered=FilteredRegressor(control, period),
            time_step=period,
            parameters=start,
        )
    )
    builder.Connect(source.GetOutputPort("state"), estimator.GetInputPort("estimated_state"))
    builder.Connect(source.GetOutputPort("effort"), estimator.GetInputPort("effort"))
    names = ("parameters", "residual")
    sinks = {
        name: LogVectorOutput(estimator.GetOutputPort(name), builder, period) for name in names
    }
    sinks["effort"] = LogVectorOutput(source.GetOutputPort("effort"), builder, period)
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    begin = time.process_time()
    simulator.AdvanceTo(source.duration)
    seconds = time.process_time() - begin
    found = {name: sink.FindLog(simulator.get_context()) for name, sink in sinks.items()}
    data = {name: np.array(one.data().T) for name, one in found.items()}
    return Streamed(
        time=np.array(found["residual"].sample_times()),
        parameters=data["parameters"],
        residual=data["residual"],
        used=np.isfinite(data["effort"]).all(axis=1),
        seconds=seconds,
    )
