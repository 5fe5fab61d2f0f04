"""Motions that distinguish effects: what a first log leaves ambiguous, a designed motion settles.

A double pendulum has an effect that its model file lacks, in formulas of the study's own. Its first
log is slow and small, and `diagnose` cannot distinguish the effect from a rival. The robot then
executes the motion that `geodrake excite --tell-apart` designs for the pair within the same narrow
limits, and `diagnose` gets that log alone; next to it, the log of the random motion that the design
starts from. A pair is distinguished if the effect is as good as the best, and its rival is not.
Robots whose first log is not ambiguous are only counted. As a diagnosis wants most blocks of a log
to agree, a direction that few blocks excite counts little; so motions repeat. Draws are kept beside
the table, so that an interrupted run goes on.

    python -m diagrams.benchmarks.tell_apart --json tell_apart.json
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated.engines import (
    PENDULUM,
    Array,
    Generator,
    PinocchioEngine,
    robot_file,
    robot_model,
)
from diagrams.benchmarks.simulated.motions import Motion as Moved
from diagrams.benchmarks.simulated.recording import Sensors
from diagrams.benchmarks.simulated.truths import (
    DRY,
    OFFSET,
    TRUTHS,
    WET,
    Law,
    Seen,
    Site,
    of_joint,
)
from diagrams.harness import run_draws, script_parser, show, sines, write
from geodrake.diagnosis import Diagnosis, diagnose
from geodrake.effects import effect_class
from geodrake.excitation import (
    DesignOptions,
    ExcitationTrajectory,
    FourierMotion,
    MotionLimits,
    Separation,
    design_excitation,
    make_rival,
    make_separation,
    motion_limits,
)
from geodrake.excitation.problem import make_problem
from geodrake.excitation.starts import possible_postures, random_guess
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.logs import JointLog, Motion
from geodrake.model import RobotModel
from geodrake.report.words import effect_label

Reference = Callable[[Array], Moved]
"""Position, velocity and acceleration (N, n) at instants (N,)."""

# The robots of the study: which effect they have, which one it may be taken for, a first motion.
#
# First motions are those of a careful first try. Each leaves a pair ambiguous for a reason of its
# own: a small sway hardly changes load and posture, back and forth at one speed shows no law of
# speed, and a sweep in one direction does not show what happens in the other.

JOINTS = ("shoulder", "elbow")
CENTER = np.array([0.3, 1.27])  # the lower link is level: there gravity's direction moves one joint


@dataclass(frozen=True)
class Case:
    """A robot, its effect and the rival."""

    truth: str
    rival: str
    joint: str
    law: Law
    size: float
    motion: str
    parameters: tuple[float, ...] = (1.0,)  # of the truth, for a size of one

    def drawn_size(self, rng: Generator) -> float:
        """Return the usual size, changed at random by up to a fifth."""
        return self.size * rng.uniform(0.8, 1.2)

    def seen(self, motion: Reference, times: Array) -> Seen:
        """Return a motion of the robot without the effect."""
        engine, (q, v, a) = PinocchioEngine(robot_file(PENDULUM)), motion(times)
        return Seen(times, q, v, a, engine.efforts(q, v, a), engine)

    def effort(self, seen: Seen, size: float) -> Array:
        """Return (N, n) effort of the effect."""
        joint = JOINTS.index(self.joint)
        return self.law(seen, Site(joint, 1 - joint, np.random.default_rng(0)), size)


def about(center: Array, *waves: Array) -> Reference:
    """Return sines about a posture."""

    def motion(t: Array) -> Moved:
        q, v, a = sines(t, *waves)
        return center + q, v, a

    return motion


def sway(rng: Generator) -> Reference:
    """Return a slow sway of a degree or two."""
    center = CENTER + rng.uniform(-0.01, 0.01, 2)
    rates = 2.0 * np.pi * np.array([0.11, 0.24])[:, None] * rng.uniform(0.9, 1.1, (2, 2))
    sizes, phases = 0.02 * rng.uniform(0.5, 1.0, (2, 2)), rng.uniform(0.0, 2.0 * np.pi, (2, 2))
    return about(center, sizes, rates, phases)


def shuttle(rng: Generator, reach: float = 0.08) -> Reference:
    """Return a triangle wave with rounded corners, a few degrees back and forth at one speed."""
    rates = 2.0 * np.pi * np.array([0.13, 0.19]) * rng.uniform(0.9, 1.1, 2)
    phases, order = rng.uniform(0.0, 2.0 * np.pi, 2), np.arange(1, 24, 2)[:, None]
    triangle = 8.0 / np.pi**2 * (-1.0) ** ((order - 1) // 2) / order**2
    weights = reach * triangle * np.sinc(order / 25.0)
    center = CENTER + rng.uniform(-0.05, 0.05, 2)
    return about(center, weights, order * rates, order * phases)


def sweep(rng: Generator) -> Reference:
    """Return a motion in one direction at one slow speed."""
    start = np.array([-0.3, 0.6]) + rng.uniform(-0.05, 0.05, 2)
    speed = 0.08 * rng.uniform(0.9, 1.1, 2)

    def motion(t: Array) -> Moved:
        v = np.broadcast_to(speed, (len(t), 2))
        return start + t[:, None] * speed, v, np.zeros((len(t), 2))

    return motion


MOTIONS: Mapping[str, tuple[Callable[[Generator], Reference], str]] = {
    "sway": (sway, "a sway of a degree or two"),
    "shuttle": (shuttle, "back and forth, 5° at one speed"),
    "long shuttle": (partial(shuttle, reach=0.4), "back and forth, 25° at one speed"),
    "sweep": (sweep, "one way at one speed"),
}
"""First motions, and what they are like."""

LOAD, QUADRATIC = "load_dependent_friction", "nonlinear_viscous_friction"
ASYMMETRIC, SPRING, TILT = "asymmetric_friction", "joint_spring", "gravity_tilt"
_DRY, _LOAD, _WET, _SHIFT = (TRUTHS[name].law for name in (DRY, LOAD, WET, OFFSET))
_square = of_joint(lambda own, other, rng: np.abs(own.v) * own.v)
_one_way = of_joint(lambda own, other, rng: (own.v > 0.0) * own.v)
_spring = of_joint(lambda own, other, rng: own.q)


def _tilt(seen: Seen, site: Site, size: float) -> Array:
    return seen.tilted(0.0, size)


CASES = (
    Case(DRY, LOAD, "elbow", _DRY, 0.15, "shuttle"),
    Case(LOAD, DRY, "elbow", _LOAD, 0.1, "shuttle"),
    Case(WET, QUADRATIC, "elbow", _WET, 0.25, "long shuttle"),
    Case(QUADRATIC, WET, "elbow", _square, 0.8, "long shuttle"),
    Case(OFFSET, ASYMMETRIC, "elbow", _SHIFT, 0.1, "sweep"),
    Case(ASYMMETRIC, OFFSET, "elbow", _one_way, 1.2, "sweep", (0.0, 0.0, 1.0, 0.0)),
    Case(SPRING, TILT, "shoulder", _spring, 0.2, "sway", (1.0, 0.0)),
    Case(TILT, SPRING, "shoulder", _tilt, 0.03, "sway", (0.0, 1.0)),
)
_ENCODER, _RATE = 1e-5, 200.0  # rad, 1/s
NOISE = 0.06  # N·m, white, at 200 Hz
KNOWN = 0.01  # how well the inertias are known, as a geometric distance
FIRST = 16.0  # s, length of the first log
SECOND, PERIODS = 12.0, 3  # s, of the others; how often they repeat, so that each block tells
SAMPLES = 240  # by which separations are counted
SPEED, ACCELERATION, RANGE = 0.8, 4.0, 0.8  # rad/s, rad/s², rad about the first motion: allowed


@dataclass(frozen=True)
class Draw:
    """A robot of the study."""

    case: int
    seed: int


@cache
def known_model() -> RobotModel:
    """Return the model file's robot, with inertias identified to within 1 %."""
    model = robot_model(PENDULUM)
    information = pullback_information(model.phi, KNOWN)
    noise = np.full(len(model.joints), NOISE)
    return replace(model, information=information, effort_noise=noise)


def allowed() -> MotionLimits:
    """Return the limits of the robot."""
    joints = known_model().joints
    return motion_limits(
        known_model(),
        position={j: (q - RANGE, q + RANGE) for j, q in zip(joints, CENTER, strict=True)},
        velocity=dict.fromkeys(joints, SPEED),
        acceleration=dict.fromkeys(joints, ACCELERATION),
    )


@cache
def separation_of(case: Case) -> Separation:
    """Return the separation of a case's two effects, both of unknown size."""
    model, limits = known_model(), allowed()
    rivals = []
    for name in (case.truth, case.rival):
        where = [case.joint] if effect_class(name).places == "joint" else []
        shape = {"exponent": 2.0} if name == QUADRATIC else None
        rivals.append(make_rival(name, model, limits, where=where, shape=shape))
    return make_separation(model, *rivals, sign_width=0.02 * limits.velocity)


def run(draw: Draw, *, iterations: int) -> dict[str, Any]:
    """Return what is ambiguous in the first log and, if it is the pair, what other logs reveal."""
    case, rng = CASES[draw.case], np.random.default_rng([draw.seed, draw.case])
    size = case.drawn_size(rng)
    motion = MOTIONS[case.motion][0](rng)
    first = diagnose(known_model(), [measured(draw, "first", size, motion, FIRST)])
    row: dict[str, Any] = {
        "case": draw.case,
        "seed": draw.seed,
        "size": size,
        "truth": case.truth,
        "rival": case.rival,
        "first": verdict(case, first),
        "ambiguous": stands(first, case.truth) and stands(first, case.rival),
        "first_deviations": deviations(case, size, motion, FIRST),
    }
    if row["ambiguous"]:
        for name, trajectory in motions(case, draw.seed, iterations).items():
            reference = partial(moved, trajectory)
            log = measured(draw, name, size, reference, SECOND)
            row[name] = verdict(case, diagnose(known_model(), [log]))
            row[f"{name}_deviations"] = deviations(case, size, reference, SECOND)
    return row


def motions(case: Case, seed: int, iterations: int) -> dict[str, ExcitationTrajectory]:
    """Return a random motion that uses the limits, and the one designed from it."""
    separation, limits = separation_of(case), allowed()
    family, options = (
        FourierMotion(SECOND, 5, 2.0 * np.pi * PERIODS / SECOND),
        DesignOptions(SAMPLES, iterations=iterations, quick=False),
    )
    problem = make_problem(separation, limits, family, options)
    postures = possible_postures(known_model(), limits, None)
    guess = random_guess(problem, postures, np.random.default_rng(seed))
    result = design_excitation(separation, limits, trajectory=family, options=options, seeds=[seed])
    return {"random": problem.trajectory(guess), "designed": result.trajectory}


def moved(trajectory: ExcitationTrajectory, t: Array) -> Moved:
    """Return position, velocity and acceleration by joint, constant after the end."""
    q, v, vd = trajectory.states(np.minimum(t, trajectory.length))
    return q, v, vd


def measured(draw: Draw, name: str, size: float, motion: Reference, duration: float) -> JointLog:
    """Return the log of a motion."""
    case, seed = CASES[draw.case], 1000 * draw.seed + 10 * draw.case + len(name)
    seen = case.seen(motion, np.arange(0.0, duration, 1.0 / _RATE))
    effort = seen.load + case.effort(seen, size)
    sensors = Sensors(1.0, _ENCODER, 20.0 * _ENCODER, deviation=NOISE)
    return sensors.log(name, seen, effort, np.random.default_rng(seed))


def deviations(case: Case, size: float, motion: Reference, duration: float) -> float:
    """Return the deviations of noise between a robot and the best fit of its rival."""
    q, v, vd = motion(np.linspace(0.0, duration, SAMPLES))
    separation = separation_of(case)
    pair = next(p for p in separation.pairs if p.truth == case.truth)
    acting = np.flatnonzero(pair.effects.any(axis=0))
    effects = np.zeros((1, pair.effects.shape[1]))
    effects[0, acting] = size * np.array(case.parameters)
    own = replace(separation, pairs=(replace(pair, effects=effects),))
    return float(np.sqrt(own.separations(Motion(q, v, vd))[0]))


def stands(diagnosis: Diagnosis, name: str) -> bool:
    """Return whether an effect is the best or indistinguishable from it."""
    return any(c.tied and name in c.effect.split(" + ") for c in diagnosis.candidates)


def verdict(case: Case, diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the verdict of a diagnosis on a case."""
    return {
        "told": stands(diagnosis, case.truth) and not stands(diagnosis, case.rival),
        "wrong": stands(diagnosis, case.rival) and not stands(diagnosis, case.truth),
        "tied": [c.effect for c in diagnosis.candidates if c.tied],
    }


LOGS = ("first", "random", "designed")


@dataclass(frozen=True)
class Plan:
    """Settings of a run."""

    cases: tuple[int, ...] = tuple(range(len(CASES)))
    wanted: int = 10  # robots of each case whose first log is ambiguous
    most: int = 30  # robots of each case that are tried at most
    iterations: int = 20  # most iterations of the solver, in each of its two stages
    seed: int = 0


def draws_of(
    plan: Plan, parser: argparse.ArgumentParser, options: argparse.Namespace
) -> list[dict[str, Any]]:
    """Return robots of every case, until enough first logs are ambiguous."""
    task = partial(run, iterations=plan.iterations)
    rows: list[dict[str, Any]] = []
    tried = dict.fromkeys(plan.cases, 0)
    while True:
        draws = []
        for case in plan.cases:
            found = sum(row["ambiguous"] for row in rows if row["case"] == case)
            more = min(plan.wanted - found, plan.most - tried[case])
            draws += [Draw(case, plan.seed + tried[case] + k) for k in range(more)]
            tried[case] += max(more, 0)
        if not draws:
            return rows
        rows += run_draws(parser, options, task, draws, iterations=plan.iterations)


def summary(case: int, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return how many of a case's robots are ambiguous, and how many of these are distinguished."""
    own = [row for row in rows if row["case"] == case]
    ambiguous = [row for row in own if row["ambiguous"]]
    result: dict[str, Any] = {
        "truth": CASES[case].truth,
        "rival": CASES[case].rival,
        "first_motion": MOTIONS[CASES[case].motion][1],
        "robots": len(own),
        "ambiguous": len(ambiguous),
    }
    for log in LOGS:
        values = [row[f"{log}_deviations"] for row in ambiguous]
        result[log] = {
            "told": sum(row[log]["told"] for row in ambiguous),
            "wrong": sum(row[log]["wrong"] for row in ambiguous),
            "deviations": float(np.median(values)) if values else None,
        }
    return result


def tell(rows: Sequence[dict[str, Any]]) -> None:
    """Print the table."""
    lines = [
        {
            "robot has": effect_label(row["truth"]),
            "taken for": effect_label(row["rival"]),
            **{name: value for name, value in row.items() if name not in ("truth", "rival")},
        }
        for row in rows
    ]
    show("Effects told apart, and by how many deviations they differ", lines)
    for log in ("random", "designed"):
        count = sum(row[log]["told"] for row in rows)
        total = sum(row["ambiguous"] for row in rows)
        print(f"The {log} motions distinguish {count} of {total} ambiguous pairs.")


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--wanted", type=int, help="ambiguous robots of each case (10)")
    options = parser.parse_args()
    plan = Plan(seed=options.seed, wanted=options.wanted or 10)
    if options.quick:
        plan = Plan((0,), options.wanted or 1, 3, 5, options.seed)
    draws = draws_of(plan, parser, options)
    rows = [summary(case, draws) for case in plan.cases]
    tell(rows)
    write(options, {"plan": plan, "rows": rows, "draws": draws})


if __name__ == "__main__":
    main()
