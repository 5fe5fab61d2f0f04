"""Benchmark of mistakes in columns: does geodrake name them, and nothing where columns are right?

Pinocchio or MuJoCo make logs of five arms (double pendulum, arms of six and seven joints, UR5,
Panda) on fast, slow and point-to-point motions; bodies are 20 % off in the geometric metric, gains
3 %, efforts have 1 % of noise, friction and rotors that the model file does not state. Then a
mistake is made in the columns: a sign, a unit, a gain, a zero, swapped joints, a part of the
efforts taken out, a wrong time. It counts as named if the findings are it, at its joints, and
nothing else. Logs of which the robot differs otherwise (payload, slope, springs) must give none.

    python -m diagrams.benchmarks.column_errors --json column_errors.json
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.hidden.robots import (
    ENGINES,
    MOTIONS,
    Engine,
    congruent,
    make_engine,
    make_motion,
    robot_file,
    robot_model,
    robot_names,
)
from diagrams.benchmarks.hidden.truths import smooth_sign
from diagrams.harness import positive_number, run_draws, script_parser, show, write
from geodrake.diagnosis import check_columns
from geodrake.effects import FittedEffect, make_effect
from geodrake.logs import JointLog
from geodrake.model import RobotModel

Array = NDArray[np.float64]

_STEPS = 8  # between two rows
_STIFFNESS, _DAMPING = 150.0, 25.0  # 1/s² and 1/s, of the controller


@dataclass(frozen=True, eq=False)
class Limited:
    """A controlled motion: positions, velocities and what was asked for, (N, n) each."""

    q: Array
    v: Array
    asked: Array


def follow(
    engine: Engine,
    wanted: tuple[Array, Array, Array, Array],
    friction: Callable[[Array], Array],
    inertia: Array,
    given: Callable[[Array, Array], Array],
) -> Limited:
    """Return forward dynamics under a computed torque that the motors give in part.

    Accelerations solve (M + h F') a = given − bias − friction, by the slope F' of the friction over
    a step h; M and the bias are inverse dynamics of unit accelerations and of none.

    Args:
        wanted: Instants (N,), positions, velocities and accelerations (N, n).
        friction: Efforts (n,) of friction at velocities.
        inertia: (n,) of the rotors, kg·m².
        given: Efforts (n,) that the motors give, by what is asked for and the velocities.
    """
    time, *motion = wanted
    step = float(time[1] - time[0]) / _STEPS
    fine = time[0] + step * np.arange((len(time) - 1) * _STEPS + 1)
    goals = [np.column_stack([np.interp(fine, time, own) for own in w.T]) for w in motion]
    q, v = goals[0][0].copy(), goals[1][0].copy()
    n, rows = len(q), []
    units = np.vstack([np.zeros(n), np.eye(n)])
    for k, (q_wanted, v_wanted, a_wanted) in enumerate(zip(*goals, strict=True)):
        found = engine.efforts(np.tile(q, (n + 1, 1)), np.tile(v, (n + 1, 1)), units)
        bias, M = found[0], (found[1:] - found[0]).T + np.diag(inertia)
        a = a_wanted + _DAMPING * (v_wanted - v) + _STIFFNESS * (q_wanted - q)
        asked = M @ a + bias + friction(v)
        if k % _STEPS == 0:
            rows.append((q, v, asked))
        slope = (friction(v + 1e-4) - friction(v - 1e-4)) / 2e-4
        a = np.linalg.solve(M + step * np.diag(slope), given(asked, v) - bias - friction(v))
        v = v + step * a
        q = q + step * v
    return Limited(*(np.array(column) for column in zip(*rows, strict=True)))


ENCODER, TACHO, NOISE = 1e-5, 2e-4, 0.01  # rad, rad/s, and a share of the effort's deviation
OFF = 0.2  # geometric distance of the bodies from those of the model file
USUAL_GAIN = 0.03  # deviation of the gains of all efforts
RATE, DURATION = 125.0, 20.0  # 1/s, s


@dataclass(frozen=True)
class WrongLog:
    """What is drawn."""

    mistake: str  # a name in `MISTAKES`, or in `RIGHT` where nothing is wrong
    robot: str
    engine: str
    motion: str
    number: int
    seed: int
    duration: float = DURATION


@dataclass(frozen=True, eq=False)
class Motion:
    """A robot's motion, and what its joints' efforts are made of, (N, n) each."""

    time: Array  # (N,) instants, s
    q: Array
    v: Array
    a: Array
    bodies: Array
    weight: Array  # those that hold them against gravity
    friction: Array
    rotors: Array
    ratios: Array  # (n,) gear ratios
    engine: Engine
    # dry, viscous: (n,) coefficients of the friction.
    dry: Array
    viscous: Array
    inertia: Array  # (n,) of the rotors

    @property
    def effort(self) -> Array:
        """Efforts of the joints."""
        return self.bodies + self.friction + self.rotors


@dataclass(frozen=True, eq=False)
class Secret:
    """What is wrong, as geodrake is to name it: kind, joints (none for all) and value."""

    kind: str
    joints: tuple[int, ...]
    value: float | None = None


Found = tuple[JointLog, tuple[Secret, ...]]
Wrong = Callable[[JointLog, Motion, np.random.Generator], Found]


def _at_joint(
    quantities: tuple[str, ...], kind: str, factor: Callable[[np.random.Generator], float]
) -> Wrong:
    """Return one joint's columns multiplied."""

    def wrong(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
        j, by = int(rng.integers(motion.q.shape[1])), factor(rng)
        changed = {name: getattr(columns, name).copy() for name in quantities}
        for values in changed.values():
            values[:, j] *= by
        return replace(columns, **changed), (Secret(kind, (j,), 1.0 / by),)

    return wrong


def _swapped(quantities: tuple[str, ...], kind: str) -> Wrong:
    """Return two joints' columns swapped."""

    def wrong(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
        i, j = sorted(rng.choice(motion.q.shape[1], 2, replace=False).tolist())
        order = np.arange(motion.q.shape[1])
        order[[i, j]] = j, i
        changed = {name: getattr(columns, name)[:, order] for name in quantities}
        return replace(columns, **changed), (Secret(kind, (i, j)),)

    return wrong


def _other_zero(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
    """Return a joint whose position is counted from elsewhere.

    Not the first one, of which that is a turned base, nor the last, of which it is a turned body.
    """
    n = motion.q.shape[1]
    j = int(rng.integers(1, n - 1)) if n > 2 else n - 1
    by = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.1), np.log(1.6)))
    position = columns.position.copy()
    position[:, j] += by
    return replace(columns, position=position), (Secret("position_zero", (j,), -by),)


def _taken_out(part: str, kind: str) -> Wrong:
    """Return a part of the efforts that the drives do not report."""

    def wrong(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
        del rng
        return replace(columns, effort=columns.effort - getattr(motion, part)), (Secret(kind, ()),)

    return wrong


def _motor_side(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
    """Return torques of the motors in place of those of the joints."""
    del rng
    return replace(columns, effort=columns.effort / motion.ratios), (Secret("effort_gains", ()),)


def _limited(falling: bool) -> Wrong:
    """Return efforts that were asked for of a motor that cannot give them, but holds the robot."""

    def wrong(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
        share = rng.uniform(1.3, 2.0) if falling else np.inf
        fastest = share * np.abs(motion.v).max(axis=0)
        needed = np.abs(motion.effort) / (1.0 - np.sign(motion.effort) * motion.v / fastest)
        peak, held = needed.max(axis=0), _HELD * np.abs(motion.weight).max(axis=0)
        limits = np.maximum(rng.uniform(0.6, 0.8) * peak, held)
        able = np.flatnonzero(limits < _BITING * peak)
        j = int(rng.choice(able)) if len(able) else int(np.argmin(limits / peak))
        most, fastest = float(min(limits[j], _BITING * peak[j])), fastest[j]

        def given(asked: Array, velocity: Array) -> Array:
            found, share = asked.copy(), velocity[j] / fastest
            found[j] = max(min(asked[j], most * (1.0 - share)), -most * (1.0 + share))
            return found

        moved = follow(
            motion.engine,
            (motion.time, motion.q, motion.v, motion.a),
            lambda rate: motion.dry * smooth_sign(rate) + motion.viscous * rate,
            motion.inertia,
            given,
        )
        given_size, size = (np.abs(each).sum(axis=0) for each in (columns.effort, motion.effort))
        gains = given_size / size
        changed = replace(columns, position=moved.q, velocity=moved.v, effort=moved.asked * gains)
        return changed, (Secret("effort_limit", (j,), float(most * gains[j])),)

    return wrong


def _all_times(quantities: tuple[str, ...], kind: str, values: tuple[float, ...]) -> Wrong:
    """Return all columns of some quantities multiplied."""

    def wrong(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
        del motion
        by = float(rng.choice(values))
        changed = {quantity: getattr(columns, quantity) * by for quantity in quantities}
        return replace(columns, **changed), (Secret(kind, (), 1.0 / by),)

    return wrong


def _two(first: Wrong, second: Wrong) -> Wrong:
    """Return two mistakes at once."""

    def wrong(columns: JointLog, motion: Motion, rng: np.random.Generator) -> Found:
        columns, one = first(columns, motion, rng)
        columns, other = second(columns, motion, rng)
        return columns, (*one, *other)

    return wrong


def _gain(rng: np.random.Generator) -> float:
    return float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(np.log(1.6), np.log(4.0))))


_BOTH = ("position", "velocity")
_HELD, _BITING = 1.15, 0.85  # limits of motors, of the weight to be held and of what is needed
MISTAKES: Mapping[str, Wrong] = {
    "sign of an effort": _at_joint(("effort",), "effort_sign", lambda rng: -1.0),
    "sign of a position": _at_joint(_BOTH, "position_sign", lambda rng: -1.0),
    "efforts swapped": _swapped(("effort",), "swapped_efforts"),
    "positions swapped": _swapped(_BOTH, "swapped_positions"),
    "joints swapped": _swapped((*_BOTH, "effort"), "swapped_joints"),
    "another zero": _other_zero,
    "torque of the motors": _motor_side,
    "gain of a joint": _at_joint(("effort",), "effort_gain", _gain),
    "N·mm at a joint": _at_joint(("effort",), "effort_unit", lambda rng: 1e3),
    "N·mm at all joints": _all_times(("effort",), "effort_unit", (1e3, 1e-3)),
    "degrees at a joint": _at_joint(_BOTH, "position_unit", lambda rng: 180.0 / np.pi),
    "degrees at all joints": _all_times(_BOTH, "position_unit", (180.0 / np.pi,)),
    "without gravity": _taken_out("weight", "without_gravity"),
    "without friction": _taken_out("friction", "without_friction"),
    "without rotors": _taken_out("rotors", "without_rotor_inertia"),
    "wrong time": _all_times(("time",), "time", (1.0 / 20.0, 0.1, 4.0, 60.0)),
    "wrong velocities": _all_times(("velocity",), "velocity_factor", (20.0, 180.0 / np.pi, -1.0)),
    "limit of a motor": _limited(falling=False),
    "limit that falls with speed": _limited(falling=True),
    "two at once": _two(
        _at_joint(("effort",), "effort_sign", lambda rng: -1.0),
        _swapped(("effort",), "swapped_efforts"),
    ),
}
"""What is wrong with columns."""

STATED = ("without friction", "without rotors")
"""Mistakes that only a model that states friction and rotors can show."""

RIGHT = ("as it is", "payload", "tilted base", "bodies far off", "spring", "load friction")
"""Logs whose columns are right, and whose robots differ from the model in other ways."""


def make_log(draw: WrongLog) -> tuple[RobotModel, JointLog, tuple[Secret, ...]]:
    """Return the model file's robot, the log of a draw, and what is wrong with its columns."""
    key = f"{draw.mistake} {draw.robot} {draw.engine} {draw.motion}"
    seeds = np.random.SeedSequence([draw.seed, crc32(key.encode()), draw.number]).spawn(4)
    on_robot, on_motion, on_mistake, on_noise = map(np.random.default_rng, seeds)
    engine = make_engine(draw.engine, robot_file(draw.robot))
    motion = _moved(draw, engine, on_robot, on_motion)
    model = robot_model(draw.robot)
    if draw.mistake in STATED:
        model = _stating(model, motion)
    gains = np.exp(USUAL_GAIN * on_noise.normal(size=motion.q.shape[1]))
    effort = motion.effort * gains
    name = f"{draw.robot} {draw.number}"
    columns = JointLog(name, engine.joints, motion.time, motion.q, effort, motion.v)
    secrets: tuple[Secret, ...] = ()
    if draw.mistake in MISTAKES:
        columns, secrets = MISTAKES[draw.mistake](columns, motion, on_mistake)
    noise = on_noise.normal(size=(3, *motion.q.shape))
    size = np.abs(columns.position).max(axis=0) / np.maximum(np.abs(motion.q).max(axis=0), 1e-9)
    size = np.where(size > 10.0, size, 1.0)  # of degrees
    log = replace(
        columns,
        position=columns.position + ENCODER * size * noise[0],
        effort=columns.effort + NOISE * columns.effort.std(0) * noise[1],
        velocity=columns.velocity + TACHO * size * noise[2],
    )
    return model, log, secrets


def _moved(
    draw: WrongLog, engine: Engine, on_robot: np.random.Generator, on_motion: np.random.Generator
) -> Motion:
    """Return a motion of a robot that is not that of its file, with friction and rotors."""
    file = engine.bodies()
    off = 3.0 * OFF if draw.mistake == "bodies far off" else OFF
    bodies = congruent(file, off, on_robot)
    if draw.mistake == "payload":
        mass = float(on_robot.uniform(0.05, 0.15)) * file[:, 3, 3].sum()
        center = np.append(on_robot.uniform(-0.05, 0.05, 2), [0.1, 1.0])
        held = mass * (np.outer(center, center) + np.diag([1e-3, 1e-3, 1e-3, 0.0]))
        bodies[-1] = bodies[-1] + held
    engine.set_bodies(bodies)
    if draw.mistake == "tilted base":
        leaning = np.sin(on_robot.choice([-1.0, 1.0], 2) * on_robot.uniform(0.05, 0.3, 2))
        down = -np.sqrt(1.0 - np.square(leaning).sum())
        engine.set_gravity(9.81 * np.append(leaning, down))
    time = np.arange(0.0, draw.duration, 1.0 / RATE)
    q, v, a = make_motion(draw.motion, engine, time, on_motion)
    load, weight = engine.efforts(q, v, a), engine.efforts(q, 0.0 * q, 0.0 * q)
    n = q.shape[1]
    size = load.std(0) * on_robot.uniform(0.05, 0.25, n)
    viscous = 0.5 * size * on_robot.uniform(0.3, 1.5, n)
    friction = size * smooth_sign(v) + viscous * v
    if draw.mistake == "spring":
        j = int(on_robot.integers(n))
        friction[:, j] += 0.3 * load[:, j].std() / q[:, j].std() * (q[:, j] - q[:, j].mean())
    if draw.mistake == "load friction":
        friction += 0.1 * np.abs(load) * smooth_sign(v)
    inertia = load.std(0) * on_robot.uniform(0.1, 0.3, n) / a.std(0)
    ratios, own = on_robot.uniform(50.0, 160.0, n), (engine, size, viscous, inertia)
    return Motion(time, q, v, a, load, weight, friction, inertia * a, ratios, *own)


def _stating(model: RobotModel, motion: Motion) -> RobotModel:
    """Return the model with friction and rotors stated, off by a fifth."""
    rng, effects = np.random.default_rng(len(motion.time)), []
    for j, joint in enumerate(model.joints):
        X = np.column_stack([np.sign(motion.v[:, j]), motion.v[:, j]])
        dry, viscous = np.linalg.lstsq(X, motion.friction[:, j], rcond=None)[0].tolist()
        rotor = float(motion.rotors[:, j] @ motion.a[:, j] / (motion.a[:, j] @ motion.a[:, j]))
        for name, value in (
            ("coulomb_friction", dry),
            ("viscous_friction", viscous),
            ("rotor_inertia", rotor),
        ):
            stated = value * np.exp(0.2 * rng.normal())
            effects.append(FittedEffect(make_effect(name, (joint,)), np.array([stated])))
    return replace(model, effects=tuple(effects))


QUICK = ("sign of an effort", "efforts swapped", "another zero", "as it is")


def run_draw(draw: WrongLog) -> dict[str, Any]:
    """Return a row of the table."""
    model, log, secrets = make_log(draw)
    start = time.process_time()
    found = check_columns(model, [log])
    seconds = time.process_time() - start
    wanted = sorted(
        (secret.kind, tuple(model.joints[j] for j in secret.joints) or tuple(model.joints))
        for secret in secrets
    )
    return {
        "mistake": draw.mistake,
        "robot": draw.robot,
        "motion": draw.motion,
        "named": sorted((each.kind, each.joints) for each in found) == wanted,
        "first": bool(found) and (found[0].kind, found[0].joints) in wanted,
        "kinds": [f"{each.kind} of {', '.join(each.joints)}" for each in found],
        "probabilities": [each.probability for each in found],
        "joints": len(model.joints),
        "seconds": seconds,
    }


def draws(count: int, seed: int) -> list[WrongLog]:
    """Return so many logs of everything, over all robots, engines and motions in turn.

    A pendulum has no joint between others: another zero of its joints is a slope, or a body that
    has turned.
    """
    engines, found = tuple(ENGINES), list[WrongLog]()
    for mistake in (*MISTAKES, *RIGHT):
        able = [r for r in robot_names() if (mistake, r) != ("another zero", "double_pendulum")]
        found += [
            WrongLog(
                mistake,
                able[k % len(able)],
                engines[k // len(able) % len(engines)],
                MOTIONS[k % len(MOTIONS)],
                k,
                seed,
                DURATION,
            )
            for k in range(count)
        ]
    return found


def lines_of(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a line of the table for each mistake."""
    found = []
    for mistake in dict.fromkeys(row["mistake"] for row in rows):
        own = [row for row in rows if row["mistake"] == mistake]
        right = mistake in RIGHT
        found.append(
            {
                "columns": mistake,
                "logs": len(own),
                "named": None if right else sum(row["named"] for row in own),
                "first": None if right else sum(row["first"] for row in own),
                "alarms": sum(bool(row["kinds"]) for row in own) if right else None,
                "seconds": max(row["seconds"] for row in own),
            }
        )
    return found


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--logs", type=positive_number, default=10, help="of each mistake")
    options = parser.parse_args()
    wanted = draws(options.logs, options.seed)
    if options.quick:
        wanted = [
            WrongLog(mistake, "double_pendulum", "pinocchio", MOTIONS[0], 0, options.seed, 8.0)
            for mistake in QUICK
        ]
    rows = run_draws(parser, options, run_draw, wanted)
    lines = lines_of(rows)
    show("Mistakes in columns", lines)
    write(options, {"lines": lines, "rows": rows})


if __name__ == "__main__":
    main()
