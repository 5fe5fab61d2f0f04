"""Servos of unknown gains: what `geodrake explain` says of logs without efforts.

Pinocchio and MuJoCo simulate arms of one to seven joints whose servos follow commands. Stiffness,
damping, delay, dry and viscous friction and armature are random. geodrake gets a log of positions
and commands, and the model file. Reported are how often it names all hidden effects, how often its
intervals (two standard deviations) contain true values, how far values are off, and the time.

    python -m diagrams.benchmarks.servo_gains --json servo_gains.json

With `--integral`, the servos have an integral, too; with `--limited`, they reach their torque
limit, which the model file states, for part of each log. With `--backlash`, links have play of 0.1
to 1 degree against their motors, by MuJoCo alone; with `--hobby`, logs have 50 rows a second and
encoders of 4096 steps a turn.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated.engines import (
    ENGINES,
    Array,
    PinocchioEngine,
    RobotFile,
    number_of,
    robot_file,
    robot_names,
)
from diagrams.benchmarks.simulated.motions import FAST, make_motion
from diagrams.benchmarks.simulated.servos import STEP, Servos, simulated
from diagrams.harness import positive_number, run_draws, script_parser, show_values, sines, write
from geodrake.control.rollout import commanded_motions, roll_out
from geodrake.diagnosis import Explanation, explain
from geodrake.effects import FittedEffect, make_effect
from geodrake.logs.motion import JointLog
from geodrake.model import EffortSignal, RobotModel

PENDULUM = "pendulum"
_EVERY = 0.004  # s, between rows of a log
_SETTLED = 1.0  # s, after which a log begins
_NOISE = 1e-5  # rad
_LIMIT = 0.75  # of the largest torque
_SLOW, _COUNTS = 0.02, 4096  # s between rows, and steps of an encoder in a turn, of a hobby arm
_SHAKES = 3  # sines of each joint's command that are faster than its motion


@dataclass(frozen=True)
class ServoDraw:
    """One log."""

    robot: str
    engine: str
    knows_rate: bool  # whether the servos' damping acts on the command's rate less the velocity
    number: int
    seed: int
    duration: float = 40.0
    integral: bool = False
    limited: bool = False  # whether their torques have limits, which the model file states
    backlash: bool = False  # whether links have play
    hobby: bool = False  # whether logs are slow, and of encoders with few steps


@dataclass(frozen=True)
class ServoLog:
    """A log and its truth."""

    servos: Servos
    log: JointLog
    torques: Array  # (N, n) what the servos gave, N·m


def servo_draws(logs: int, seed: int, **fixed: object) -> list[ServoDraw]:
    """Return logs of every robot, kind of servo and engine in turn; play needs MuJoCo."""
    engines = ("mujoco",) if fixed.get("backlash") else ENGINES
    robots = (PENDULUM, *(name for name in robot_names() if name != "arm6"))
    return [
        ServoDraw(
            robots[k % len(robots)],
            engines[(k // len(robots)) % len(engines)],
            bool((k // len(robots) // len(engines)) % 2),
            k,
            seed,
            **fixed,  # type: ignore[arg-type]
        )
        for k in range(logs)
    ]


def make_servo_log(draw: ServoDraw) -> ServoLog:
    """Return the log of a draw.

    Stiffness makes a servo follow within 15 to 40 rad/s of bandwidth; damping is 0.4 to 1 of what
    is critical. Friction is 5 to 30 % of the efforts' deviation, the armature 10 to 50 % of the
    inertia that the joint moves, the delay 0 to 12 ms, and the integral, if there is one, has a
    time kp / ki of 0.3 to 2 s. A limit is three quarters of the largest torque that the servo gives
    without.
    """
    words = f"{draw.robot} {draw.engine} {draw.knows_rate}"
    rng = np.random.default_rng([draw.seed, draw.number, number_of(words)])
    file = servo_file(draw.robot)
    engine = PinocchioEngine(file)
    time = np.arange(0.0, draw.duration + _SETTLED, STEP)
    command, v, a = make_motion(FAST, engine, time, rng)
    coarse = slice(None, None, round(0.02 / STEP))
    efforts = engine.efforts(command[coarse], v[coarse], a[coarse]).std(axis=0)
    speeds, inertia = v.std(axis=0), _inertia(engine, command[:: round(1.0 / STEP)])
    n = len(efforts)
    armature = inertia * rng.uniform(0.1, 0.5, n)
    pace = rng.uniform(15.0, 40.0, n)
    stiffness = (inertia + armature) * pace**2
    servos = Servos(
        stiffness=stiffness,
        damping=2.0 * rng.uniform(0.4, 1.0, n) * stiffness / pace,
        knows_rate=draw.knows_rate,
        delay=0.001 * int(rng.integers(0, 13)),
        viscous=efforts * rng.uniform(0.05, 0.3, n) / speeds,
        coulomb=efforts * rng.uniform(0.05, 0.3, n),
        armature=armature,
        limit=np.full(n, 1e6),
        integral=np.zeros(n),
        play=np.deg2rad(10.0 ** rng.uniform(-1.0, 0.0, n)) if draw.backlash else np.zeros(n),
    )
    command = command + _shaking(time, n, rng)
    if draw.integral:
        servos = replace(servos, integral=stiffness / rng.uniform(0.3, 2.0, n))
    q, _, torques = simulated(draw.engine, file.text, servos, command)
    if draw.limited:
        servos = replace(servos, limit=_LIMIT * np.abs(torques).max(axis=0))
        q, _, torques = simulated(draw.engine, file.text, servos, command)
    every = _SLOW if draw.hobby else _EVERY
    rows = slice(round(_SETTLED / STEP), None, round(every / STEP))
    measured = (q + _NOISE * rng.normal(size=q.shape))[rows]
    if draw.hobby:
        step = 2.0 * np.pi / _COUNTS
        measured = step * np.round(measured / step)
    log = JointLog(
        f"servo_{draw.number}",
        engine.joints,
        time[rows],
        measured,
        np.full(measured.shape, np.nan),
        command=command[rows],
    )
    return ServoLog(servos, log, torques[rows])


def _inertia(engine: PinocchioEngine, q: Array) -> Array:
    """Return (n,) inertia that each joint moves, the mean over some positions."""
    still, n = np.zeros_like(q), q.shape[1]
    base = engine.efforts(q, still, still)
    moved = [engine.efforts(q, still, still + np.eye(n)[j])[:, j] - base[:, j] for j in range(n)]
    return np.mean(moved, axis=1)


def _shaking(time: Array, n: int, rng: np.random.Generator) -> Array:
    """Return (N, n) small fast sines, up to 5 Hz, which reveal a servo's lag."""
    rate = 2.0 * np.pi * rng.uniform(1.5, 5.0, (_SHAKES, n))
    phase = rng.uniform(0.0, 2.0 * np.pi, (_SHAKES, n))
    size = 3.0 * rng.uniform(0.5, 1.0, (_SHAKES, n)) / rate**2  # 3 rad/s² each
    return sines(time, size, rate, phase)[0]


@cache
def servo_file(name: str) -> RobotFile:
    """Return the model file of a robot: one of the benchmark of effects, or a pendulum."""
    if name != PENDULUM:
        return robot_file(name)
    return robot_file("double_pendulum").holding(name, ["elbow"])


ARMATURE = "rotor_inertia"
HIDDEN = {"coulomb_friction": "coulomb", "viscous_friction": "viscous", ARMATURE: "inertia"}
"""Effects that every joint has, and the parameter of each that is reported."""

_NOTABLE = 0.05  # of a joint's torque, above which a hidden effect is to be named
_WINDOWS = 6  # of rollouts
_SIDES = 2.0  # standard deviations of an interval


def score_servo(draw: ServoDraw) -> dict[str, Any]:
    """Return a row of the table."""
    made, model = make_servo_log(draw), servo_file(draw.robot).model
    if draw.limited:
        limits = map(repr, made.servos.limit.tolist())
        stated = dict(zip(made.log.joints, limits, strict=True))
        model = servo_file(draw.robot).changed(f"{draw.robot}_limited", effort=stated).model
    began = time.process_time()
    found = explain(model, [made.log])
    seconds = time.process_time() - began
    own = ["backlash"] if draw.backlash else []
    return {
        **asdict(draw),
        "joints": len(model.joints),
        "samples": len(made.log),
        "seconds": seconds,
        "verdict": found.verdict,
        "at limit": np.mean(np.abs(made.torques) >= made.servos.limit, axis=0).tolist(),
        "limits found": [bool(np.isfinite(s.limit)) for s in found.model.effort_signals],
        "steps": [[step.effect, list(step.where)] for step in found.steps],
        "extra": sorted({s.effect for s in found.steps} - {*HIDDEN, "effort_delay", *own}),
        "play named": [j for s in found.steps if s.effect in own for j in s.where],
        "nrms": [found.start.nrms, found.refitted.nrms, found.end.nrms],
        **_in_set(made, found),
        **_motion(made, model, found),
        "values": [*_gains(made, found.model), *_effects(made, found)],
    }


def _truths(
    made: ServoLog, signals: Sequence[EffortSignal] = ()
) -> Mapping[str, Mapping[str, float]]:
    """Return effect -> joint -> true value, in the order of the model's joints.

    Damping of the velocity alone is viscous friction of the joint, unless a servo was found that
    makes its damping within a limit.
    """
    servos, names = made.servos, made.log.joints
    within = [servos.knows_rate or joint in _damping(signals) for joint in names]
    viscous = servos.viscous + np.where(within, 0.0, servos.damping)
    values = {
        "coulomb_friction": servos.coulomb,
        "viscous_friction": viscous,
        ARMATURE: servos.armature,
    }
    return {e: dict(zip(names, v.tolist(), strict=True)) for e, v in values.items()}


def _damping(signals: Sequence[EffortSignal]) -> list[str]:
    """Return joints whose servos make their damping, within a limit."""
    return [s.joint for s in signals if s.damping and np.isfinite(s.limit)]


def _in_set(made: ServoLog, found: Explanation) -> dict[str, Any]:
    """Return whether every notable effect was found or is indistinguishable from the found ones."""
    position = made.log.position
    velocity = np.gradient(position, made.log.time, axis=0)
    motions = {
        "coulomb_friction": np.sign(velocity),
        "viscous_friction": velocity,
        ARMATURE: np.gradient(velocity, made.log.time, axis=0),
    }
    torque = made.torques.std(axis=0)
    named = {name for s in found.steps for name in (s.effect, *s.indistinguishable_from)}
    missing = []
    for effect, values in _truths(made, found.model.effort_signals).items():
        share = motions[effect].std(axis=0) * np.array([*values.values()]) / torque
        if effect == ARMATURE:
            share[0] = 0.0  # at the first joint it is as if its link were heavier
        if share.max() > _NOTABLE and effect not in named:
            missing.append(effect)
    return {"in_set": not missing, "missing": missing}


def _motion(made: ServoLog, model: RobotModel, found: Explanation) -> dict[str, Any]:
    """Return errors of the motions of the findings and of the truth under the commands.

    They are relative to the motion of each joint; those on the way are before and after every step.
    """
    servos = made.servos
    signals = [
        EffortSignal(
            joint,
            "command",
            float(servos.stiffness[j]),
            damping=float(servos.damping[j]),
            delay=servos.delay,
            integral=float(servos.integral[j]),
            limit=float(servos.limit[j]),
            rate_share=float(servos.knows_rate),
        )
        for j, joint in enumerate(made.log.joints)
    ]
    effects = [
        FittedEffect(make_effect(name, (joint,)), np.array([value]))
        for name, values in _truths(made, signals).items()
        for joint, value in values.items()
    ]
    truth = replace(model, effects=tuple(effects), effort_signals=tuple(signals))
    between = [step.model for step in found.steps if step.model is not None]
    began = time.process_time()
    motions = commanded_motions(model, found.model, [made.log], between=between)
    seconds = time.process_time() - began
    if motions is None:
        raise RuntimeError("A log of commands has servos.")
    best = roll_out(truth, [made.log], most=_WINDOWS, commands=True)
    on_the_way = [[joint.relative for joint in motion.joints] for motion in motions]
    return {
        "seconds of motions": seconds,
        "motion": on_the_way[-1],
        "motion on the way": on_the_way,
        "motion of the true model": [joint.relative for joint in best.joints],
    }


def _gains(made: ServoLog, model: RobotModel) -> list[dict[str, Any]]:
    """Return stiffness, damping and the integral, if there is or was found one, with the truth."""
    rows, servos, within = [], made.servos, _damping(model.effort_signals)
    for signal in model.effort_signals:
        at, joint = made.log.joints.index(signal.joint), signal.joint
        damps = np.hypot(signal.damping_deviation, signal.uncertainty * signal.damping)
        sums = np.hypot(signal.integral_deviation, signal.uncertainty * signal.integral)
        gains = [("kp", signal.gain, signal.deviation, servos.stiffness)]
        if servos.knows_rate or joint in within:
            gains.append(("kd", signal.damping, float(damps), servos.damping))
        if servos.integral[at] or signal.integral:
            gains.append(("ki", signal.integral, float(sums), servos.integral))
        rows += [_row(what, joint, x, spread, float(true[at])) for what, x, spread, true in gains]
    return rows


def _effects(made: ServoLog, found: Explanation) -> list[dict[str, Any]]:
    """Return values of effects with the truth."""
    rows = []
    truths = _truths(made, found.model.effort_signals)
    for step in found.steps:
        if step.effect not in truths:
            continue
        name = HIDDEN[step.effect]
        for joint, values in step.parameters.items():
            key = name if name in values else next(iter(values))
            spread = np.hypot(
                step.deviations.get(joint, {}).get(key, np.nan),
                step.systematic.get(joint, {}).get(key, 0.0),
            )
            truth = truths[step.effect][joint]
            rows.append(_row(step.effect, joint, values[key], float(spread), truth))
    return rows


def _row(what: str, joint: str, value: float, spread: float, truth: float) -> dict[str, Any]:
    return {
        "what": what,
        "joint": joint,
        "value": value,
        "deviation": spread,
        "truth": truth,
        "inside": bool(abs(value - truth) <= _SIDES * spread),
        "ratio": value / truth if truth else None,
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return shares and medians over all logs; errors of motions are RMS over joints."""
    values = [value for row in rows for value in row["values"]]

    def departs(row: Mapping[str, Any], at: int) -> float:
        return float(np.sqrt(np.square(row["motion on the way"][at]).mean()))

    first, second, last = ([departs(row, at) for row in rows] for at in (0, 1, -1))
    best = [np.sqrt(np.square(row["motion of the true model"]).mean()) for row in rows]
    seconds = np.array([(row["seconds"], row["seconds of motions"]) for row in rows])
    table: dict[str, Any] = {
        "logs": len(rows),
        "all effects in the set": float(np.mean([row["in_set"] for row in rows])),
        "other effects named, a log": float(np.mean([len(row["extra"]) for row in rows])),
        "departure over that of the true model, median": float(np.median(np.divide(last, best))),
        "departure over the motion before, median": float(np.median(first)),
        "after the first step": float(np.median(second)),
        "at the end": float(np.median(last)),
        "seconds a log, median": float(np.median(seconds[:, 0])),
        "with motions before, on the way and after, most": float(seconds.sum(axis=1).max()),
    }
    if any(row["backlash"] for row in rows):
        table["joints whose play is named"] = sum(len(row["play named"]) for row in rows)
    for what in dict.fromkeys(value["what"] for value in values):
        same = [value for value in values if value["what"] == what]
        ratios = np.array([value["ratio"] for value in same if value["ratio"]])
        table[what] = {
            "inside": float(np.mean([value["inside"] for value in same])),
            "median error": float(np.median(np.abs(ratios - 1.0))),
            "values": len(same),
        }
    return table


def main() -> None:
    """Run from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--logs", type=positive_number, default=40, help="(%(default)s)")
    parser.add_argument("--integral", action="store_true", help="servos have an integral")
    parser.add_argument("--limited", action="store_true", help="torques have a limit")
    parser.add_argument("--backlash", action="store_true", help="links have play")
    parser.add_argument("--hobby", action="store_true", help="50 Hz, and encoders of few steps")
    options = parser.parse_args()
    kinds = {name: getattr(options, name) for name in ("integral", "limited", "backlash", "hobby")}
    draws = servo_draws(options.logs, options.seed, **kinds)
    if options.quick:
        first = ServoDraw("double_pendulum", "mujoco", False, 0, options.seed, duration=6.0)
        draws = [replace(first, **kinds)]
    rows = run_draws(parser, options, score_servo, draws)
    table = summary(rows)
    show_values("Servos of unknown gains", table)
    write(options, {"summary": table, "rows": rows})


if __name__ == "__main__":
    main()
