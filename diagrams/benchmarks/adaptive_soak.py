"""Ten minutes of an adaptive loop whose sensors and actuators fail again and again.

A double pendulum with viscous friction follows a motion under effort limits. Every ten
seconds or so, one of the faults of `adaptive/faults.py` lasts a second: noise, outliers, encoders
that jump or stick, late or missing samples, wrong signs, weak actuators. Both controllers start
from wrong bodies. Reported for each are the errors between faults (from five seconds after
one until the next), the time until tracking recovers, the distance of the estimate from the truth,
and the memory of the process. `unguarded` has only the effort limits, for a minute.

    python -m diagrams.benchmarks.adaptive_soak --json soak.json
"""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.trajectories import PiecewisePolynomial

from diagrams.harness import MODELS, run_draws, script_parser, show, write
from diagrams.studies.adaptive.faults import FAULTS, Array, Episode, faulty_loop
from diagrams.studies.adaptive.loop import Record, on_its_base
from geodrake.control import (
    AdaptiveComputedTorqueController,
    AdaptiveController,
    ControlModel,
    PassivityBasedAdaptiveController,
    PredictionError,
    Safeguards,
    natural_adaptation,
    parameter_manifold,
)
from geodrake.control.adaptation import UpdateLaw
from geodrake.effects import FittedEffect, ViscousFriction
from geodrake.inertia import perturb, pseudo_inertia
from geodrake.model import RobotModel, load_model

MODEL = MODELS / "double_pendulum.urdf"
LIMITS = np.array([8.0, 4.0])  # N·m
MINUTES, QUICK = 10.0, 0.5
LASTS, RECOVERS = 1.0, 5.0  # s
GAP = (6.0, 12.0)  # s, from the end of a fault to the next one
WRONG = 0.3  # of masses, at first
GAMMA = 0.05
DAMPING = 0.3  # N·m·s/rad
TIME_STEP = 4e-3  # s, of a controller
UNGUARDED = Safeguards(LIMITS, dead_zone=0.0, drift=np.inf, settling_time=0.0, factor=np.inf)
CONTROLLERS = ("passivity", "computed torque", "unguarded")


@dataclass(frozen=True)
class Draw:
    """One loop."""

    controller: str
    duration: float


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return what a loop did."""
    robot = make_robot()
    control, rng = ControlModel.of(robot), np.random.default_rng([seed, 43])
    episodes = draw_episodes(draw.duration, rng)
    start = control.prior.copy()
    drawn = perturb(control.phi(start), 1, rng=rng, mass_uncertainty=WRONG)
    start[: control.num_inertial] = drawn.phi[0].ravel()
    controller = make_controller(draw.controller, control, robot, start)
    seconds, memory = process_time(), list[float]()
    how = {"limits": LIMITS, "end": draw.duration, "seed": seed}
    found = faulty_loop(
        controller,
        make_plant(),
        make_motion(draw.duration),
        episodes,
        seen=lambda: memory.append(resident()),
        **how,
    )
    numbers = judge(found, episodes, control)
    return {
        "controller": draw.controller,
        "faults": len(episodes),
        **numbers,
        "first_memory": memory[len(memory) // 10],
        "last_memory": memory[-1],
        "seconds": process_time() - seconds,
    }


def make_robot() -> RobotModel:
    """Return the double pendulum with viscous friction at both joints."""
    model = load_model(MODEL)
    effects = tuple(FittedEffect(ViscousFriction(j), np.array([DAMPING])) for j in model.joints)
    return replace(model, effects=effects)


def make_plant() -> MultibodyPlant:
    """Return the plant, with friction as Drake's damping, which is much faster."""
    plant = MultibodyPlant(0.0)
    on_its_base(MODEL, "base_link", plant, damping=DAMPING)
    plant.Finalize()
    return plant


def draw_episodes(duration: float, rng: np.random.Generator) -> list[Episode]:
    """Return endless random faults at random times."""
    episodes, queue, t = list[Episode](), list[str](), float(rng.uniform(*GAP))
    while t + LASTS + RECOVERS < duration:
        queue = queue or list(rng.permutation(FAULTS))
        start = round(t, 3)
        episodes.append(Episode(str(queue.pop()), start, start + LASTS))
        t += LASTS + float(rng.uniform(*GAP))
    return episodes


def make_motion(duration: float) -> PiecewisePolynomial:
    """Return sines at both joints."""
    t = np.linspace(0.0, duration + 1.0, round(10 * duration) + 11)
    q = 0.8 * np.sin(np.outer([1.3, 2.1], t) + np.array([[0.0], [0.4]]))
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(t, q)


def make_controller(
    name: str, control: ControlModel, robot: RobotModel, start: Array
) -> AdaptiveController:
    """Return a controller by its name, with the natural law."""
    law: UpdateLaw = natural_adaptation(parameter_manifold(robot), GAMMA)
    if name == "computed torque":
        return AdaptiveComputedTorqueController(
            control,
            law,
            rate=15.0,
            time_step=TIME_STEP,
            parameters=start,
            safeguards=Safeguards(LIMITS),
            prediction=PredictionError(1.0, alone=True),
        )
    guards = UNGUARDED if name == "unguarded" else Safeguards(LIMITS)
    return PassivityBasedAdaptiveController(
        control, law, time_step=TIME_STEP, parameters=start, safeguards=guards
    )


def judge(found: Record, episodes: Sequence[Episode], control: ControlModel) -> dict[str, Any]:
    """Return errors, distances and masses of a loop."""
    # At the start there is nothing to be judged yet.
    time, estimates = found.time[1:], found.parameters[1:]
    error = np.degrees(np.abs(found.error[1:]).max(1))
    distance = distances(control, estimates)
    masses = control.phi(control.prior)[:, 0]
    ratio = estimates[:, : control.num_inertial : 10] / masses
    between = np.ones(len(time), bool)
    for episode in episodes:
        between &= (time < episode.start) | (time >= episode.end + RECOVERS)
    quiet = between & (time > RECOVERS)
    usual = float(np.quantile(error[quiet], 0.99))
    rows = []
    for k, episode in enumerate(episodes):
        until = episodes[k + 1].start if k + 1 < len(episodes) else time[-1]
        after = (time >= episode.end) & (time <= until)
        late = time[after & (error > max(2.0 * usual, 3.0))]
        before = float(distance[time <= episode.start][-1])
        rows.append(
            {
                "fault": episode.fault,
                "recovery": float(late[-1] - episode.end) if len(late) else 0.0,
                "ratio": float(distance[after & (time <= episode.end + RECOVERS)][-1] / before),
                "error": float(error[(time >= episode.start) & (time <= episode.end)].max()),
            }
        )
    return {
        "rms": float(np.sqrt(np.mean(error[quiet] ** 2))),
        "greatest": float(error[quiet].max()),
        "recovery": max(row["recovery"] for row in rows),
        "ratio": max(row["ratio"] for row in rows),
        "first_distance": float(distance[0]),
        "greatest_distance": float(distance.max()),
        "last_distance": float(distance[-1]),
        "least_mass": float(ratio.min()),
        "greatest_mass": float(ratio.max()),
        "by_fault": rows,
    }


def distances(control: ControlModel, estimates: Array) -> Array:
    """Return geodesic distances (N,) of estimates, bodies and effects together, from the truth."""
    bodies = control.num_inertial
    truth = pseudo_inertia(control.phi(control.prior))
    phi = estimates[:, :bodies].reshape(len(estimates), -1, 10)
    ratios = np.linalg.eigvals(np.linalg.solve(truth, pseudo_inertia(phi))).real
    squared = (np.log(ratios) ** 2).sum((1, 2))
    squared += (np.log(estimates[:, bodies:] / control.prior[bodies:]) ** 2).sum(1)
    return np.asarray(np.sqrt(squared))


def resident() -> float:
    """Return the memory of this process, MB, after garbage collection."""
    gc.collect()
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024.0


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    options = parser.parse_args()
    duration = 60.0 * (QUICK if options.quick else MINUTES)
    draws = [Draw(name, duration) for name in CONTROLLERS if name != "unguarded"]
    draws.append(Draw("unguarded", min(duration, 60.0)))  # lost by then
    rows = run_draws(parser, options, partial(run_draw, seed=options.seed), draws)
    show("Errors in degrees, times in s, masses over the true ones, MB", rows)
    guarded = [row for row in rows if row["controller"] != "unguarded"]
    show("Worst of each fault", worst(guarded))
    write(options, {"rows": rows, "worst": worst(guarded)})


def worst(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return each fault's worst numbers over controllers and times."""
    each = [line for row in rows for line in row["by_fault"]]
    return [
        {"fault": name}
        | {key: max(line[key] for line in lines) for key in ("error", "recovery", "ratio")}
        for name in FAULTS
        if (lines := [line for line in each if line["fault"] == name])
    ]


if __name__ == "__main__":
    main()
