"""One robot of the study: a first log, what it leaves ambiguous, the motion that settles it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from diagrams.benchmarks.rivals.cases import CASES, CENTER, QUADRATIC, Case
from diagrams.benchmarks.rivals.simulation import Hidden, Reference, record, simulate, tilted
from diagrams.harness import MODELS
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
from geodrake.logs import Motion
from geodrake.model import RobotModel, load_model

Array = NDArray[np.float64]

ROBOT = MODELS / "double_pendulum.urdf"
NOISE = 0.06  # N·m, white, at 200 Hz
KNOWN = 0.01  # how well the inertias are known, as a geometric distance
FIRST = 16.0  # s, length of the first log
SECOND, PERIODS = 12.0, 3  # s, of the others; how often they repeat, so that each block tells
SAMPLES = 240  # by which separations are counted
SPEED, ACCELERATION, RANGE = 0.8, 4.0, 0.8  # rad/s, rad/s², rad about the first motion: allowed


@dataclass(frozen=True)
class Draw:
    """A robot of the study.

    Attributes:
        case: Number of the case.
        seed: Of its size, its first motion, noise and designs.
    """

    case: int
    seed: int


@cache
def known_model() -> RobotModel:
    """The model file, its inertias identified before to within 1 %."""
    model = load_model(ROBOT)
    information = pullback_information(model.phi, KNOWN)
    noise = np.full(len(model.joints), NOISE)
    return replace(model, information=information, effort_noise=noise)


def real_robot(hidden: Hidden) -> MultibodyPlant:
    """The robot itself: the model file on a base that may be tilted."""
    plant = MultibodyPlant(0.0)
    (arm,) = Parser(plant).AddModels(str(ROBOT))
    root = plant.get_body(plant.GetBodyIndices(arm)[0])
    plant.WeldFrames(plant.world_frame(), root.body_frame())
    tilted(plant, hidden.tilt)
    plant.Finalize()
    return plant


def allowed() -> MotionLimits:
    """What the robot may do."""
    joints = known_model().joints
    return motion_limits(
        known_model(),
        position={j: (q - RANGE, q + RANGE) for j, q in zip(joints, CENTER, strict=True)},
        velocity=dict.fromkeys(joints, SPEED),
        acceleration=dict.fromkeys(joints, ACCELERATION),
    )


@cache
def separation_of(case: Case) -> Separation:
    """What telling a case's two effects apart amounts to, both of unknown size."""
    model, limits = known_model(), allowed()
    rivals = []
    for name in (case.truth, case.rival):
        where = [case.joint] if effect_class(name).places == "joint" else []
        shape = {"exponent": 2.0} if name == QUADRATIC else None
        rivals.append(make_rival(name, model, limits, where=where, shape=shape))
    return make_separation(model, *rivals, sign_width=0.02 * limits.velocity)


def run(draw: Draw, *, iterations: int) -> dict[str, Any]:
    """What the first log leaves ambiguous, and, if that is the pair, what other motions show.

    Args:
        draw: The robot.
        iterations: Most iterations of the solver in each of its two stages.
    """
    case, rng = CASES[draw.case], np.random.default_rng([draw.seed, draw.case])
    size = case.drawn_size(rng)
    hidden, motion = case.robot(size), case.first_motion(rng)
    first = measured(draw, "first", hidden, motion, FIRST)
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
            reference = states_of(trajectory)
            found = measured(draw, name, hidden, reference, SECOND)
            row[name] = verdict(case, found)
            row[f"{name}_deviations"] = deviations(case, size, reference, SECOND)
    return row


def motions(case: Case, seed: int, iterations: int) -> dict[str, ExcitationTrajectory]:
    """A random motion that uses the limits, and the one designed from it."""
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


def states_of(trajectory: ExcitationTrajectory) -> Reference:
    """Position, velocity and acceleration by joint."""

    def motion(t: Array) -> tuple[Array, Array, Array]:
        q, v, vd = trajectory.states(np.minimum(t, trajectory.family.length))
        return q, v, vd

    return motion


def measured(
    draw: Draw, name: str, hidden: Hidden, motion: Callable[..., Any], duration: float
) -> Diagnosis:
    """A diagnosis of the log of a motion."""
    model = known_model()
    rows = simulate(real_robot(hidden), model, hidden, motion, duration)
    seed = 1000 * draw.seed + 10 * draw.case + len(name)
    log = record(name, model, rows, np.full(len(model.joints), NOISE), seed)
    return diagnose(model, [log])


def deviations(case: Case, size: float, motion: Reference, duration: float) -> float:
    """By how many deviations of the noise the robot differs from the best that its rival can do."""
    q, v, vd = motion(np.linspace(0.0, duration, SAMPLES))
    separation = separation_of(case)
    pair = next(p for p in separation.pairs if p.truth == case.truth)
    acting = np.flatnonzero(pair.effects.any(axis=0))
    effects = np.zeros((1, pair.effects.shape[1]))
    effects[0, acting] = size * np.array(case.parameters)
    own = replace(separation, pairs=(replace(pair, effects=effects),))
    return float(np.sqrt(own.separations(Motion(q, v, vd))[0]))


def stands(diagnosis: Diagnosis, name: str) -> bool:
    """Whether an effect is among those that a log cannot distinguish from the best."""
    return any(c.tied and name in c.effect.split(" + ") for c in diagnosis.candidates)


def verdict(case: Case, diagnosis: Diagnosis) -> dict[str, Any]:
    """What a diagnosis says of a case."""
    return {
        "told": stands(diagnosis, case.truth) and not stands(diagnosis, case.rival),
        "wrong": stands(diagnosis, case.rival) and not stands(diagnosis, case.truth),
        "tied": [c.effect for c in diagnosis.candidates if c.tied],
    }
