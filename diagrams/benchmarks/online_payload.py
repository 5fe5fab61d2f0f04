"""A payload found while a UR10e moves, by the online estimator on public measurements.

The logs are of the arm with and without something at its wrist; they are not part of the project,
and without them the script says where they go. The arm is learned from the first log, either
offline (`identify_model`, with friction by load) or by the online estimator, from the model file
and guesses of friction. Large weights then hold its bodies and friction, and a payload is
estimated from the blind guess of [Lee2019] §5.5.2 (1 kg, a sphere of 0.1 m), on logs without one
and on the log with one, where `geodrake explain` finds 3.08 ± 0.03 kg offline. The standard
deviation of a filtered effort is three times the RMS error of the arm's own log or, while the arm
is learned, a tenth of the effort's own. Samples at which a joint stands are left out. Exact
projections and nudges estimate the payload, nudges an online arm.

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

from diagrams.harness import first_samples, run_draws, script_parser, show, write
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
    """Results of an estimator on a log, sample by sample."""

    time: Array  # (N,) s since the log's first sample
    parameters: Array  # (N, p) the estimate
    residual: Array  # (N, nv) filtered efforts − their prediction, N·m, before each update
    used: NDArray[np.bool_]  # (N,) whether the robot moved in all joints
    seconds: float

    def rms(self, start: float = 0.0) -> Array:
        """Return (nv,) RMS of the residual of used samples after a share of the log."""
        part = self.used & (self.time >= start * self.time[-1])
        return np.sqrt(np.mean(self.residual[part] ** 2, axis=0))


def stream(
    log: JointLog, control: ControlModel, update: SampleUpdate, start: Array, *, period: float
) -> Streamed:
    """Stream a log to an estimator that starts at an estimate (p,)."""
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


LEARNED, FREE, CHANGED = "ur10e_free_a", ("ur10e_free_b", "ur10e_free_c"), "ur10e_changed"
OFFLINE_MASS = 3.08  # kg, by `geodrake explain`
PERIOD = 0.01  # s
GUESS = from_mass_com_inertia(1.0, np.zeros(3), 0.4 * 0.1**2 * np.eye(3))
METHODS = {"projection": 1.0, "nudge": 0.2}
"""Share of the way to the slabs of a sample that is gone."""
BELIEVED = 3.0  # tolerance over the RMS error of the log without payload
SHARE = 0.1  # tolerance over the standard deviation of the effort, while the arm is learned
KNOWN, HEAVY = 1e6, 10.0  # weights of what is known, and of bodies over friction
SETTLED = 5.0  # s after the first used sample
CLOSE = 0.2  # of the mass
LARGE = 1e9  # N·m


@dataclass(frozen=True)
class Draw:
    """One way to learn the arm."""

    way: str
    shared: str
    end: float | None  # how much of every log, s; None for all


@dataclass(frozen=True, eq=False)
class Arm:
    """The learned arm."""

    model: RobotModel
    control: ControlModel
    start: Array  # (p,) its parameters, with the guess of the payload
    error: Array  # (nv,) RMS error of filtered efforts on the log it was learned from, N·m
    share: float  # that over the standard deviation of the effort, pooled


def run_draw(draw: Draw) -> list[dict[str, Any]]:
    """Return the rows of all logs; nothing is random."""
    arm = learn(draw)
    weights = {"payload": 1.0}
    manifold = parameter_manifold(
        arm.model, body_weight=KNOWN, effect_weight=KNOWN, weights=weights
    )
    rows = []
    for name in (*FREE, CHANGED) if draw.end is None else (FREE[0], CHANGED):
        log = read(draw, name)
        for method, relaxation in METHODS.items():
            update = SampleUpdate(
                manifold, BELIEVED * arm.error, method=method, relaxation=relaxation
            )
            found = stream(log, arm.control, update, arm.start, period=PERIOD)
            row = {"way": draw.way, "log": name, "method": method, "learned": arm.share}
            rows.append({**row, **numbers(found)})
    return rows


def learn(draw: Draw) -> Arm:
    """Return the arm, learned from the log without payload."""
    model = load_model(Path(draw.shared) / "reference" / "ur10e.urdf")
    log = read(draw, LEARNED)
    if draw.way == "offline":
        kinds = (CoulombFriction, ViscousFriction, RotorInertia, LoadDependentFriction)
        raw = read(draw, LEARNED, moving=False)
        effects = [kind(joint) for kind in kinds for joint in model.joints]
        settings = IdentificationSettings(compare=False)
        model = identify_model(model, [raw], settings, effects=effects).model
        fitted = [
            replace(one, parameters=np.maximum(one.parameters, 1e-6)) for one in model.effects
        ]
    else:
        guesses = ((CoulombFriction, 1.0), (ViscousFriction, 1.0), (RotorInertia, 0.1))
        fitted = [
            FittedEffect(kind(joint), np.array([value]))
            for kind, value in guesses
            for joint in model.joints
        ]
    last = FittedEffect(Payload(model.bodies[-1]), GUESS)
    model = replace(model, effects=(*fitted, last), information=None)
    control = ControlModel.of(model)
    deviation = np.nanstd(log.select(control.joints).effort, axis=0)
    # Nothing is fixed yet: the payload is kept out, at next to nothing.
    start = np.concatenate([control.prior[: -len(GUESS)], 1e-9 * GUESS])
    manifold = parameter_manifold(model, body_weight=HEAVY, weights={"payload": KNOWN})
    tolerance = (SHARE if draw.way == "online" else LARGE) * deviation
    # (No model of a whole arm is right to the tolerance: the nudge averages.)
    update = SampleUpdate(manifold, tolerance, method="nudge", relaxation=METHODS["nudge"])
    found = stream(log, control, update, start, period=PERIOD)
    error = found.rms(2 / 3 if draw.way == "online" else 0.0)
    known = found.parameters[-1, : -len(GUESS)]
    share = float(np.sqrt(np.mean((error / deviation) ** 2)))
    return Arm(model, control, np.concatenate([known, GUESS]), error, share)


def read(draw: Draw, name: str, *, moving: bool = True) -> JointLog:
    """Return the first seconds of a log as a stream.

    A standing joint's effort may have any dry friction, so that no model predicts it. If `moving`,
    efforts are missing while a joint stands.
    """
    log = read_log(Path(draw.shared) / "data" / f"{name}.csv")
    if draw.end is not None:
        log = first_samples(log, int(np.searchsorted(log.time - log.time[0], draw.end)))
    effort = log.effort.copy()
    effort[moving & (np.abs(log.velocity) < STANDING).any(axis=1)] = np.nan
    return replace(log, effort=effort)


def numbers(found: Streamed) -> dict[str, Any]:
    """Return the numbers of a streamed log."""
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
        "close": float(near[late].mean()),
        "center": [float(x) for x in np.median(phi[late, 1:4] / phi[late, :1], axis=0)],
        "least_eigenvalue": float(eigenvalues.min()),
        "rate": len(found.time) / found.seconds,
    }


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    add_folder_option(parser)
    options = parser.parse_args()
    logs = (f"data/{name}.csv" for name in (LEARNED, *FREE, CHANGED))
    require(parser, options.shared, "reference/ur10e.urdf", *logs)
    end = 12.0 if options.quick else None
    draws = [Draw(way, str(options.shared), end) for way in ("offline", "online")]
    rows = [row for own in run_draws(parser, options, run_draw, draws) for row in own]
    show("Mass of the payload in kg, times in s", rows)
    write(options, {"rows": rows})


if __name__ == "__main__":
    main()
