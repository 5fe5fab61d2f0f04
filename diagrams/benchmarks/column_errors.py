"""Benchmark of mistakes in columns: does geodrake name them, and nothing where columns are right?

Pinocchio or MuJoCo simulates five arms (double pendulum, arms of six and seven joints, UR5, Panda)
on fast, slow and point-to-point motions. Bodies are 20 % off in the geometric metric and gains 3 %;
efforts have 1 % of noise, and friction and rotors that the model file lacks. Then the columns get
one mistake: a sign, a unit, a gain, a zero, swapped joints, a part of the efforts removed, a wrong
time. It counts as named if the findings are that mistake at its joints and nothing else. Logs of
robots that differ in another way (payload, slope, springs) must give no finding.

    python -m diagrams.benchmarks.column_errors --json column_errors.json
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated.engines import (
    ENGINES,
    PENDULUM,
    Array,
    Engine,
    Generator,
    congruent,
    make_engine,
    number_of,
    pseudo,
    robot_file,
    robot_model,
    robot_names,
)
from diagrams.benchmarks.simulated.motions import MOTIONS
from diagrams.benchmarks.simulated.truths import DRY, ROTOR, WET, Seen, smooth_sign
from diagrams.harness import positive_number, run_draws, script_parser, show, write
from geodrake.diagnosis import check_columns
from geodrake.effects import FittedEffect, make_effect
from geodrake.logs import JointLog
from geodrake.model import RobotModel

_STEPS = 8  # between two rows
_STIFFNESS, _DAMPING = 150.0, 25.0  # 1/s² and 1/s, of the controller


def follow(motion: Motion, given: Callable[[Array, Array], Array]) -> tuple[Array, Array, Array]:
    """Return positions, velocities and requested efforts (N, n) under a partial computed torque.

    Accelerations solve (M + h F') a = given − bias − friction, by the slope F' of the friction over
    a step h; M and the bias are inverse dynamics of unit accelerations and of none. `given` returns
    the efforts (n,) of the motors from the requested ones and the velocities.
    """
    seen, time, inertia = motion.seen, motion.seen.time, motion.inertia
    step = float(time[1] - time[0]) / _STEPS
    fine = time[0] + step * np.arange((len(time) - 1) * _STEPS + 1)
    wanted = (seen.q, seen.v, seen.a)
    goals = [np.column_stack([np.interp(fine, time, own) for own in w.T]) for w in wanted]

    def friction(v: Array) -> Array:
        return motion.dry * smooth_sign(v) + motion.viscous * v

    q, v = goals[0][0].copy(), goals[1][0].copy()
    n, rows = len(q), []
    units = np.vstack([np.zeros(n), np.eye(n)])
    for k, (q_wanted, v_wanted, a_wanted) in enumerate(zip(*goals, strict=True)):
        found = seen.engine.efforts(np.tile(q, (n + 1, 1)), np.tile(v, (n + 1, 1)), units)
        bias, M = found[0], (found[1:] - found[0]).T + np.diag(inertia)
        a = a_wanted + _DAMPING * (v_wanted - v) + _STIFFNESS * (q_wanted - q)
        asked = M @ a + bias + friction(v)
        if k % _STEPS == 0:
            rows.append((q, v, asked))
        slope = (friction(v + 1e-4) - friction(v - 1e-4)) / 2e-4
        a = np.linalg.solve(M + step * np.diag(slope), given(asked, v) - bias - friction(v))
        v = v + step * a
        q = q + step * v
    q, v, asked = (np.array(column) for column in zip(*rows, strict=True))
    return q, v, asked


ENCODER, TACHO, NOISE = 1e-5, 2e-4, 0.01  # rad, rad/s, and a share of the effort's deviation
OFF = 0.2  # geometric distance of the bodies from those of the model file
USUAL_GAIN = 0.03  # deviation of the gains of all efforts
RATE, DURATION = 125.0, 20.0  # 1/s, s


@dataclass(frozen=True)
class WrongLog:
    """A log with a mistake in its columns."""

    mistake: str  # a name in `MISTAKES`, or in `RIGHT` where nothing is wrong
    robot: str
    engine: str
    motion: str
    number: int
    seed: int
    duration: float = DURATION


@dataclass(frozen=True, eq=False)
class Motion:
    """A robot's motion, and the parts of its efforts, (N, n) each."""

    seen: Seen  # its load is that of the bodies
    weight: Array  # efforts that hold the bodies against gravity
    friction: Array
    # ratios: Of gears; dry, viscous: of friction; inertia: of rotors, kg·m²; (n,) each.
    ratios: Array
    dry: Array
    viscous: Array
    inertia: Array

    @property
    def rotors(self) -> Array:
        """Efforts of rotors."""
        return self.inertia * self.seen.a

    @property
    def effort(self) -> Array:
        """Efforts of the joints."""
        return self.seen.load + self.friction + self.rotors


@dataclass(frozen=True, eq=False)
class Secret:
    """The mistake that geodrake should name: kind, joints (none for all) and value."""

    kind: str
    joints: tuple[int, ...]
    value: float | None = None


Found = tuple[JointLog, tuple[Secret, ...]]
Wrong = Callable[[JointLog, Motion, Generator], Found]


def _at_joint(
    quantities: tuple[str, ...], kind: str, factor: Callable[[Generator], float]
) -> Wrong:
    """Multiply one joint's columns."""

    def wrong(columns: JointLog, motion: Motion, rng: Generator) -> Found:
        j, by = int(rng.integers(motion.weight.shape[1])), factor(rng)
        changed = {name: getattr(columns, name).copy() for name in quantities}
        for values in changed.values():
            values[:, j] *= by
        return replace(columns, **changed), (Secret(kind, (j,), 1.0 / by),)

    return wrong


def _swapped(quantities: tuple[str, ...], kind: str) -> Wrong:
    """Swap two joints' columns."""

    def wrong(columns: JointLog, motion: Motion, rng: Generator) -> Found:
        i, j = sorted(rng.choice(motion.weight.shape[1], 2, replace=False).tolist())
        order = np.arange(motion.weight.shape[1])
        order[[i, j]] = j, i
        changed = {name: getattr(columns, name)[:, order] for name in quantities}
        return replace(columns, **changed), (Secret(kind, (i, j)),)

    return wrong


def _other_zero(columns: JointLog, motion: Motion, rng: Generator) -> Found:
    """Shift the zero of a joint's position.

    The first joint would only turn the base, and the last one the body.
    """
    n = motion.weight.shape[1]
    j = int(rng.integers(1, n - 1)) if n > 2 else n - 1
    by = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.1), np.log(1.6)))
    position = columns.position.copy()
    position[:, j] += by
    return replace(columns, position=position), (Secret("position_zero", (j,), -by),)


def _taken_out(part: str, kind: str) -> Wrong:
    """Remove a part of the efforts, as drives that do not report it."""

    def wrong(columns: JointLog, motion: Motion, rng: Generator) -> Found:
        del rng
        return replace(columns, effort=columns.effort - getattr(motion, part)), (Secret(kind, ()),)

    return wrong


def _motor_side(columns: JointLog, motion: Motion, rng: Generator) -> Found:
    """Replace joint torques by motor torques."""
    del rng
    return replace(columns, effort=columns.effort / motion.ratios), (Secret("effort_gains", ()),)


def _limited(falling: bool) -> Wrong:
    """Replace efforts by requested ones that a motor cannot give, while it holds the robot."""

    def wrong(columns: JointLog, motion: Motion, rng: Generator) -> Found:
        share = rng.uniform(1.3, 2.0) if falling else np.inf
        fastest = share * np.abs(motion.seen.v).max(axis=0)
        needed = np.abs(motion.effort) / (1.0 - np.sign(motion.effort) * motion.seen.v / fastest)
        peak, held = needed.max(axis=0), _HELD * np.abs(motion.weight).max(axis=0)
        limits = np.maximum(rng.uniform(0.6, 0.8) * peak, held)
        able = np.flatnonzero(limits < _BITING * peak)
        j = int(rng.choice(able)) if len(able) else int(np.argmin(limits / peak))
        most, fastest = float(min(limits[j], _BITING * peak[j])), fastest[j]

        def given(asked: Array, velocity: Array) -> Array:
            found, share = asked.copy(), velocity[j] / fastest
            found[j] = max(min(asked[j], most * (1.0 - share)), -most * (1.0 + share))
            return found

        q, v, asked = follow(motion, given)
        given_size, size = (np.abs(each).sum(axis=0) for each in (columns.effort, motion.effort))
        gains = given_size / size
        changed = replace(columns, position=q, velocity=v, effort=asked * gains)
        return changed, (Secret("effort_limit", (j,), float(most * gains[j])),)

    return wrong


def _all_times(quantities: tuple[str, ...], kind: str, values: tuple[float, ...]) -> Wrong:
    """Multiply all columns of some quantities."""

    def wrong(columns: JointLog, motion: Motion, rng: Generator) -> Found:
        del motion
        by = float(rng.choice(values))
        changed = {quantity: getattr(columns, quantity) * by for quantity in quantities}
        return replace(columns, **changed), (Secret(kind, (), 1.0 / by),)

    return wrong


def _two(first: Wrong, second: Wrong) -> Wrong:
    """Make two mistakes at once."""

    def wrong(columns: JointLog, motion: Motion, rng: Generator) -> Found:
        columns, one = first(columns, motion, rng)
        columns, other = second(columns, motion, rng)
        return columns, (*one, *other)

    return wrong


def _gain(rng: Generator) -> float:
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
    """Return the robot of the model file, the log of a draw, and the mistake in its columns."""
    key = f"{draw.mistake} {draw.robot} {draw.engine} {draw.motion}"
    seeds = np.random.SeedSequence([draw.seed, number_of(key), draw.number]).spawn(4)
    on_robot, on_motion, on_mistake, on_noise = map(np.random.default_rng, seeds)
    engine = make_engine(draw.engine, robot_file(draw.robot))
    motion = _moved(draw, engine, on_robot, on_motion)
    model = robot_model(draw.robot)
    if draw.mistake in STATED:
        model = _stating(model, motion)
    gains = np.exp(USUAL_GAIN * on_noise.normal(size=motion.weight.shape[1]))
    effort = motion.effort * gains
    name = f"{draw.robot} {draw.number}"
    seen = motion.seen
    columns = JointLog(name, engine.joints, seen.time, seen.q, effort, seen.v)
    secrets: tuple[Secret, ...] = ()
    if draw.mistake in MISTAKES:
        columns, secrets = MISTAKES[draw.mistake](columns, motion, on_mistake)
    noise = on_noise.normal(size=(3, *motion.weight.shape))
    size = np.abs(columns.position).max(axis=0) / np.maximum(np.abs(seen.q).max(axis=0), 1e-9)
    size = np.where(size > 10.0, size, 1.0)  # of degrees
    log = replace(
        columns,
        position=columns.position + ENCODER * size * noise[0],
        effort=columns.effort + NOISE * columns.effort.std(0) * noise[1],
        velocity=columns.velocity + TACHO * size * noise[2],
    )
    return model, log, secrets


def _moved(draw: WrongLog, engine: Engine, on_robot: Generator, on_motion: Generator) -> Motion:
    """Return a motion of a robot that differs from its file, with friction and rotors."""
    file = engine.bodies()
    off = 3.0 * OFF if draw.mistake == "bodies far off" else OFF
    bodies = congruent(file, off, on_robot)
    if draw.mistake == "payload":
        mass = float(on_robot.uniform(0.05, 0.15)) * file[:, 3, 3].sum()
        center = np.append(on_robot.uniform(-0.05, 0.05, 2), 0.1)
        bodies[-1] += pseudo(mass, center, mass * 2e-3 * np.eye(3))
    engine.set_bodies(bodies)
    if draw.mistake == "tilted base":
        leaning = np.sin(on_robot.choice([-1.0, 1.0], 2) * on_robot.uniform(0.05, 0.3, 2))
        down = -np.sqrt(1.0 - np.square(leaning).sum())
        engine.set_gravity(9.81 * np.append(leaning, down))
    time = np.arange(0.0, draw.duration, 1.0 / RATE)
    seen = Seen.of(engine, draw.motion, time, on_motion)
    q, v, load, still = seen.q, seen.v, seen.load, 0.0 * seen.q
    n = q.shape[1]
    dry = load.std(0) * on_robot.uniform(0.05, 0.25, n)
    viscous = 0.5 * dry * on_robot.uniform(0.3, 1.5, n)
    friction = dry * smooth_sign(v) + viscous * v
    if draw.mistake == "spring":
        j = int(on_robot.integers(n))
        friction[:, j] += 0.3 * load[:, j].std() / q[:, j].std() * (q[:, j] - q[:, j].mean())
    if draw.mistake == "load friction":
        friction += 0.1 * np.abs(load) * smooth_sign(v)
    inertia = load.std(0) * on_robot.uniform(0.1, 0.3, n) / seen.a.std(0)
    ratios = on_robot.uniform(50.0, 160.0, n)
    weight = engine.efforts(q, still, still)
    return Motion(seen, weight, friction, ratios, dry, viscous, inertia)


def _stating(model: RobotModel, motion: Motion) -> RobotModel:
    """Return the model with friction and rotors stated, off by a fifth."""
    rng, effects = np.random.default_rng(len(motion.weight)), []
    for j, joint in enumerate(model.joints):
        v, a = motion.seen.v[:, j], motion.seen.a[:, j]
        X = np.column_stack([np.sign(v), v])
        dry, viscous = np.linalg.lstsq(X, motion.friction[:, j], rcond=None)[0].tolist()
        rotor = float(motion.rotors[:, j] @ a / (a @ a))
        for name, value in ((DRY, dry), (WET, viscous), (ROTOR, rotor)):
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
    """Return `count` logs of every mistake, with robots, engines and motions in turn.

    A pendulum has no joint between others: another zero of its joints is a slope, or a body that
    has turned.
    """
    engines, found = tuple(ENGINES), list[WrongLog]()
    for mistake in (*MISTAKES, *RIGHT):
        able = [r for r in robot_names() if (mistake, r) != ("another zero", PENDULUM)]
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
    """Return a report line for each mistake."""
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
            WrongLog(mistake, PENDULUM, "pinocchio", MOTIONS[0], 0, options.seed, 8.0)
            for mistake in QUICK
        ]
    rows = run_draws(parser, options, run_draw, wanted)
    lines = lines_of(rows)
    show("Mistakes in columns", lines)
    write(options, {"lines": lines, "rows": rows})


if __name__ == "__main__":
    main()
