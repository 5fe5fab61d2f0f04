"""Random servos behind arms, and the logs that they leave: commands and positions, no efforts."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import numpy as np

from diagrams.benchmarks.hidden.engines import ENGINES, PinocchioEngine
from diagrams.benchmarks.hidden.motions import FAST, make_motion
from diagrams.benchmarks.hidden.robots import RobotFile, robot_file, robot_names
from diagrams.benchmarks.servos.simulation import STEP, Array, Servos, simulated
from geodrake import load_model
from geodrake.logs.motion import JointLog
from geodrake.model import RobotModel

PENDULUM = "pendulum"
_EVERY = 0.004  # s, between rows of a log
_SETTLED = 1.0  # s, after which a log begins
_NOISE = 1e-5  # rad
_LIMIT = 0.75  # of the largest torque
_SHAKES = 3  # sines of each joint's command that are faster than its motion


@dataclass(frozen=True)
class ServoDraw:
    """One log.

    Attributes:
        robot: Name of the robot.
        engine: Who simulates it.
        knows_rate: Whether the servos' damping acts on the command's rate less the velocity.
        number: Of the log.
        seed: Of the study.
        duration: Length of the log, s.
        integral: Whether the servos have an integral, too.
        limited: Whether their torques have limits, which the model file states.
    """

    robot: str
    engine: str
    knows_rate: bool
    number: int
    seed: int
    duration: float = 40.0
    integral: bool = False
    limited: bool = False


@dataclass(frozen=True)
class ServoLog:
    """A log, and what was hidden.

    Attributes:
        servos: What moved the robot.
        log: Commands and positions.
        torques: (N, n) what the servos gave, N·m.
    """

    servos: Servos
    log: JointLog
    torques: Array


def servo_draws(logs: int, seed: int, **fixed: object) -> list[ServoDraw]:
    """Logs of every robot, kind of servo and engine in turn."""
    robots = (PENDULUM, *(name for name in robot_names() if name != "arm6"))
    return [
        ServoDraw(
            robots[k % len(robots)],
            ENGINES[(k // len(robots)) % len(ENGINES)],
            bool((k // len(robots) // len(ENGINES)) % 2),
            k,
            seed,
            **fixed,  # type: ignore[arg-type]
        )
        for k in range(logs)
    ]


def make_servo_log(draw: ServoDraw) -> ServoLog:
    """The log of a draw.

    Stiffness makes a servo follow within 15 to 40 rad/s of bandwidth; damping is 0.4 to 1 of what
    is critical. Friction is 5 to 30 % of the efforts' deviation, the armature 10 to 50 % of the
    inertia that the joint moves, the delay 0 to 12 ms, and the integral, if there is one, has a
    time kp / ki of 0.3 to 2 s. A limit is three quarters of the largest torque that the servo gives
    without.
    """
    words = f"{draw.robot} {draw.engine} {draw.knows_rate}"
    rng = np.random.default_rng([draw.seed, draw.number, crc32(words.encode())])
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
    )
    command = command + _shaking(time, n, rng)
    if draw.integral:
        servos = replace(servos, integral=stiffness / rng.uniform(0.3, 2.0, n))
    q, _, torques = simulated(draw.engine, file.text, servos, command)
    if draw.limited:
        servos = replace(servos, limit=_LIMIT * np.abs(torques).max(axis=0))
        q, _, torques = simulated(draw.engine, file.text, servos, command)
    rows = slice(round(_SETTLED / STEP), None, round(_EVERY / STEP))
    measured = (q + _NOISE * rng.normal(size=q.shape))[rows]
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
    """(n,) inertia that each joint moves, the mean over some positions."""
    still, n = np.zeros_like(q), q.shape[1]
    base = engine.efforts(q, still, still)
    moved = [engine.efforts(q, still, still + np.eye(n)[j])[:, j] - base[:, j] for j in range(n)]
    return np.mean(moved, axis=1)


def _shaking(time: Array, n: int, rng: np.random.Generator) -> Array:
    """(N, n) small fast sines, up to 5 Hz, at which a servo's lag shows."""
    rate = 2.0 * np.pi * rng.uniform(1.5, 5.0, (_SHAKES, n))
    phase = rng.uniform(0.0, 2.0 * np.pi, (_SHAKES, n))
    size = 3.0 * rng.uniform(0.5, 1.0, (_SHAKES, n)) / rate**2  # 3 rad/s² each
    return np.asarray((size * np.sin(rate * time[:, None, None] + phase)).sum(axis=1))


@cache
def servo_file(name: str) -> RobotFile:
    """The model file of a robot: one of the benchmark of effects, or a pendulum."""
    if name != PENDULUM:
        return robot_file(name)
    root = ET.fromstring(robot_file("double_pendulum").text)
    for joint in root.iter("joint"):
        if joint.get("name") == "elbow":
            joint.set("type", "fixed")
    return RobotFile(name, ET.tostring(root, encoding="unicode"))


@cache
def servo_model(name: str) -> RobotModel:
    """What geodrake knows of a robot: its model file."""
    return _loaded(name, servo_file(name).text)


def limited_model(name: str, joints: Sequence[str], limits: Array) -> RobotModel:
    """The same with limits (n,) of torques, N·m, in the file."""
    root, largest = ET.fromstring(servo_file(name).text), dict(zip(joints, limits, strict=True))
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        if limit is not None and joint.get("name") in largest:
            limit.set("effort", repr(float(largest[joint.get("name", "")])))
    return _loaded(f"{name}_limited", ET.tostring(root, encoding="unicode"))


def _loaded(name: str, text: str) -> RobotModel:
    path = Path(_folder().name) / f"{name}.urdf"
    path.write_text(text, encoding="utf-8")
    return load_model(path)


@cache
def _folder() -> TemporaryDirectory[str]:
    """Where model files are as long as the process runs, as simulations read them again."""
    return TemporaryDirectory()
