"""A payload found while a UR10e moves, by the online estimator on public measurements.

The logs of the arm without and with something at its wrist are played; they are no part of the
project, and without them the script says where they go. The arm is learned from the first log
(`identify_model`, with friction by load). Then its bodies and friction are kept by large weights,
and a payload is estimated, from the blind guess of [Lee2019] §5.5.2 (1 kg, a sphere of 0.1 m), by
exact projections on the log with one. There `geodrake explain` finds 3.08 ± 0.03 kg, offline. A
filtered effort is believed to three times the RMS error of the arm's own log. Samples at which a
joint stands are left out.

    python -m diagrams.benchmarks.online_payload --json online.json
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from diagrams.harness import first_samples, script_parser, show, write
from diagrams.public_data import add_folder_option, require
from geodrake.control import (
    BregmanProjectionEstimator,
    ControlModel,
    LogSource,
    SampleUpdate,
    parameter_manifold,
)
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.effects import (
    CoulombFriction,
    FittedEffect,
    LoadDependentFriction,
    Payload,
    RotorInertia,
    ViscousFriction,
)
from geodrake.identification import IdentificationSettings, identify_model
from geodrake.inertia import Array, from_mass_com_inertia, pseudo_inertia
from geodrake.logs import JointLog, read_log
from geodrake.model import RobotModel, load_model

STANDING = 0.02  # rad/s, below which a joint's friction is not known


@dataclass(frozen=True, eq=False)
class Streamed:
    """What an estimator made of a log, sample by sample."""

    time: Array  # (N,) s since the log's first sample
    parameters: Array  # (N, p) the estimate
    residual: Array  # (N, nv) filtered efforts − their prediction, N·m, before each update
    used: NDArray[np.bool_]  # (N,) whether the robot moved in all joints
    seconds: float


def stream(
    log: JointLog, control: ControlModel, update: SampleUpdate, start: Array, *, period: float
) -> Streamed:
    """Play a log to an estimator.

    Args:
        start: (p,) first estimate.
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


LEARNED, CHANGED = "ur10e_free_a", "ur10e_changed"
OFFLINE_MASS = 3.08  # kg, by `geodrake explain`
PERIOD = 0.01  # s
GUESS = from_mass_com_inertia(1.0, np.zeros(3), 0.4 * 0.1**2 * np.eye(3))
BELIEVED = 3.0  # tolerance over the RMS error of the log without payload
KNOWN = 1e6  # weight of what is known
SETTLED = 5.0  # s after the first used sample
CLOSE = 0.2  # of the mass
LARGE = 1e9  # N·m


@dataclass(frozen=True, eq=False)
class Arm:
    """The learned arm."""

    model: RobotModel
    control: ControlModel
    start: Array  # (p,) its parameters, with the guess of the payload
    error: Array  # (nv,) RMS error of filtered efforts on the log it was learned from, N·m
    share: float  # that over the standard deviation of the effort, pooled


def found_payload(shared: Path, end: float | None) -> dict[str, Any]:
    """Return what is found of the payload, in some seconds of its log; nothing is random."""
    arm = learn(shared, end)
    manifold = parameter_manifold(
        arm.model, body_weight=KNOWN, effect_weight=KNOWN, weights={"payload": 1.0}
    )
    update = SampleUpdate(manifold, BELIEVED * arm.error)
    log = read(shared, CHANGED, end)
    found = stream(log, arm.control, update, arm.start, period=PERIOD)
    return {"log": CHANGED, "learned": arm.share, **numbers(found)}


def learn(shared: Path, end: float | None) -> Arm:
    """Return the arm, from the log without payload."""
    kinds = (CoulombFriction, ViscousFriction, RotorInertia, LoadDependentFriction)
    model = load_model(shared / "reference" / "ur10e.urdf")
    effects = [kind(joint) for kind in kinds for joint in model.joints]
    raw = read(shared, LEARNED, end, moving=False)
    model = identify_model(
        model, [raw], IdentificationSettings(compare=False), effects=effects
    ).model
    fitted = [replace(one, parameters=np.maximum(one.parameters, 1e-6)) for one in model.effects]
    last = FittedEffect(Payload(model.bodies[-1]), GUESS)
    model = replace(model, effects=(*fitted, last), information=None)
    control = ControlModel.of(model)
    log = read(shared, LEARNED, end)
    deviation = np.nanstd(log.select(control.joints).effort, axis=0)
    # The payload is kept out, at next to nothing, and nothing is learned by so large a tolerance.
    start = np.concatenate([control.prior[: -len(GUESS)], 1e-9 * GUESS])
    manifold = parameter_manifold(model, weights={"payload": KNOWN})
    update = SampleUpdate(manifold, LARGE * deviation, method="nudge")
    found = stream(log, control, update, start, period=PERIOD)
    error = np.sqrt(np.mean(found.residual[found.used] ** 2, axis=0))
    known = found.parameters[-1, : -len(GUESS)]
    share = float(np.sqrt(np.mean((error / deviation) ** 2)))
    return Arm(model, control, np.concatenate([known, GUESS]), error, share)


def read(shared: Path, name: str, end: float | None, *, moving: bool = True) -> JointLog:
    """Return the first seconds of a log, as it is streamed.

    A standing joint holds whatever effort dry friction takes; no model predicts it. So efforts are
    missing while one stands, if the log is to be of a `moving` robot.
    """
    log = read_log(shared / "data" / f"{name}.csv")
    if end is not None:
        log = first_samples(log, int(np.searchsorted(log.time - log.time[0], end)))
    effort = log.effort.copy()
    effort[moving & (np.abs(log.velocity) < STANDING).any(axis=1)] = np.nan
    return replace(log, effort=effort)


def numbers(found: Streamed) -> dict[str, Any]:
    """Return what is known of a streamed log."""
    phi = found.parameters[:, -len(GUESS) :]
    eigenvalues = np.linalg.eigvalsh(pseudo_inertia(phi))
    first = float(found.time[found.used][0])
    late = found.time >= first + SETTLED
    near = np.abs(phi[:, 0] / OFFLINE_MASS - 1.0) < CLOSE
    low, median, high = np.quantile(phi[late, 0], [0.1, 0.5, 0.9])
    reached = found.time[near & (found.time > first)]
    return {
        "first": first,
        "mass": float(median),
        "low": float(low),
        "high": float(high),
        "reached": float(reached[0]) - first if reached.size else None,
        "least_eigenvalue": float(eigenvalues.min()),
        "rate": len(found.time) / found.seconds,
    }


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__)
    add_folder_option(parser)
    options = parser.parse_args()
    logs = (f"data/{name}.csv" for name in (LEARNED, CHANGED))
    require(parser, options.shared, "reference/ur10e.urdf", *logs)
    rows = [found_payload(options.shared, 12.0 if options.quick else None)]
    show("Mass of the payload in kg, times in s", rows)
    write(options, {"rows": rows})


if __name__ == "__main__":
    main()
