"""Ordinary robots and their logs: two motions each, with friction, rotors and a tool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import zip_longest
from zlib import crc32

import mujoco
import numpy as np

from diagrams.benchmarks.hidden.robots import (
    ENGINES,
    FAST,
    POINTS,
    Engine,
    RobotFile,
    coloured,
    congruent,
    make_engine,
    motion_range,
    pseudo,
    robot_file,
    robot_model,
)
from diagrams.benchmarks.hidden.truths import Array, Effort, Seen, smooth_sign, with_bodies
from geodrake.logs import JointLog

_FINE = 1e-3  # s, longest step of a pendulum


@dataclass(frozen=True, eq=False)
class Site:
    """Where an effect acts, and what is known of the robot's motions, the same for all logs."""

    # joint, other: Numbers of its joints.
    joint: int
    other: int
    file: RobotFile  # the robot's model file
    # center, half: (n,) middle and half width of the positions of the motions, rad.
    center: Array
    half: Array
    speed: Array  # (n,) highest speeds, rad/s
    load: Array  # (n,) largest efforts, N·m
    rng: np.random.Generator

    def place(self, seen: Seen, joint: int) -> Array:
        """Return (N,) position of a joint in the range of its motions, from −1 to 1."""
        return np.asarray((seen.q[:, joint] - self.center[joint]) / self.half[joint])


@dataclass(frozen=True, eq=False)
class Kind:
    """An effect of no catalogue."""

    make: Callable[[Site], Effort]
    # Names that are right beside it, at its joint: it has a part that they describe.
    comes_with: tuple[str, ...] = ()
    largest: float = np.inf


def _cubic_coupling(site: Site) -> Effort:
    """Return a spring between two joints of energy x y³."""

    def effort(seen: Seen, size: float) -> Array:
        x, y = site.place(seen, site.joint), site.place(seen, site.other)
        return size * (seen.at(site.joint, y**3) + seen.at(site.other, 3.0 * x * y**2))

    return effort


def _growing_friction(site: Site) -> Effort:
    def effort(seen: Seen, size: float) -> Array:
        grip = 1.2 + site.place(seen, site.joint)
        return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))

    return effort


def _pendulum(site: Site) -> Effort:
    """A weight that swings in a link, less the same weight at the hinge, where the file has it.

    A weight that hangs quietly pulls at its hinge: what is left is the swing.
    """
    length, damping = site.rng.uniform(0.05, 0.2), site.rng.uniform(0.05, 0.3)
    spec = mujoco.MjSpec.from_string(site.file.text)
    axis, at = site.rng.normal(size=3), site.rng.uniform(-0.1, 0.1, 3)
    down = np.cross(axis, site.rng.normal(size=3))
    weight = spec.joints[site.joint].parent.add_body(name="weight", pos=at)
    weight.mass, weight.ipos = 1.0, length * down / np.linalg.norm(down)
    weight.inertia, weight.explicitinertial = np.full(3, 1e-4), True
    weight.add_joint(name="swing", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model = spec.compile()
    data, free = mujoco.MjData(model), int(model.joint("swing").dofadr[0])
    arm = np.flatnonzero(np.arange(model.nv) != free)
    inertia = length**2 + 1e-4
    drag = 2.0 * damping * inertia * np.sqrt(9.81 / length)

    def needed(motion: tuple[Array, Array, Array], swing: tuple[float, float, float]) -> Array:
        signals = (data.qpos, data.qvel, data.qacc)
        for signal, values, own in zip(signals, motion, swing, strict=True):
            signal[arm], signal[free] = values, own
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    def effort(seen: Seen, size: float) -> Array:
        period = float(np.median(np.diff(seen.time)))
        steps = int(np.ceil(period / _FINE))
        found, angle, rate = seen.zeros(), 0.0, 0.0
        ahead = [np.vstack([x[1:], x[-1:]]) for x in (seen.q, seen.v, seen.a)]
        for k in range(len(found)):
            now = (seen.q[k], seen.v[k], seen.a[k])
            for i in range(steps):
                part = i / steps
                between = tuple(
                    (1.0 - part) * x + part * y[k] for x, y in zip(now, ahead, strict=True)
                )
                torque = needed(between, (angle, rate, 0.0))  # type: ignore[arg-type]
                bend = -(drag * rate + torque[free]) / inertia
                if i == 0:
                    found[k] = needed(now, (angle, rate, bend))[arm]
                rate += bend * period / steps
                angle += rate * period / steps
        bodies = seen.engine.bodies()
        bodies[site.joint] += pseudo(1.0, at, 1e-4 * np.eye(3))
        return size * (found - seen.load - with_bodies(seen, bodies))

    return effort


def _saturation(site: Site) -> Effort:
    """Return what a drive commands more and its motor does not give, at high speed under load."""
    edge = site.rng.uniform(0.5, 0.8)

    def effort(seen: Seen, size: float) -> Array:
        load = seen.load[:, site.joint]
        power = np.abs(seen.v[:, site.joint]) / site.speed[site.joint]
        beyond = np.logaddexp(0.0, (power + np.abs(load) / site.load[site.joint] - edge) / 0.05)
        return seen.at(site.joint, size * np.sign(load) * beyond * np.abs(load))

    return effort


def _taut_hose(site: Site) -> Effort:
    """Return a hose on the difference of two angles, which pulls only when it is taut."""
    slack = site.rng.uniform(0.1, 0.5)

    def effort(seen: Seen, size: float) -> Array:
        stretch = site.place(seen, site.joint) - site.place(seen, site.other)
        pull = size * 0.05 * np.logaddexp(0.0, (stretch - slack) / 0.05)
        return seen.at(site.joint, pull) - seen.at(site.other, pull)

    return effort


def _slipping_belt(site: Site) -> Effort:
    """Return a link that falls behind its motor by a little more each time the load is high."""
    most = site.rng.uniform(0.4, 0.7)

    def effort(seen: Seen, size: float) -> Array:
        over = np.abs(seen.load[:, site.joint]) / site.load[site.joint] - most
        rate = size * np.maximum(over, 0.0) * np.sign(seen.load[:, site.joint])
        behind = np.cumsum(rate * np.gradient(seen.time))
        q, v = seen.q.copy(), seen.v.copy()
        q[:, site.joint] -= behind
        v[:, site.joint] -= rate
        return seen.engine.efforts(q, v, seen.a) - seen.load

    return effort


def _cable_drag(site: Site) -> Effort:
    """Return a cable that drags in one direction only, in some postures more."""
    phase = site.rng.uniform(0.0, 2.0 * np.pi)

    def effort(seen: Seen, size: float) -> Array:
        going = 0.5 * (1.0 + smooth_sign(seen.v[:, site.joint]))
        posture = np.cos(2.5 * site.place(seen, site.joint) - phase)
        return seen.at(site.joint, size * going * posture)

    return effort


def _eccentric_gear(site: Site) -> Effort:
    waves, phase = site.rng.uniform(3.0, 9.0), site.rng.uniform(0.0, 2.0 * np.pi)

    def effort(seen: Seen, size: float) -> Array:
        turn = seen.q[:, site.joint] + seen.q[:, site.other]
        wave = size * np.sin(waves * turn + phase)
        return seen.at(site.joint, wave) + seen.at(site.other, wave)

    return effort


def _sticking_places(site: Site) -> Effort:
    places = site.rng.uniform(-0.8, 0.8, 4)

    def effort(seen: Seen, size: float) -> Array:
        away = (site.place(seen, site.joint)[:, None] - places) / 0.05
        grip = np.exp(-0.5 * away**2).sum(1)
        return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))

    return effort


def _neighbours_square(site: Site) -> Effort:
    def effort(seen: Seen, size: float) -> Array:
        other = seen.v[:, site.other] / site.speed[site.other]
        return seen.at(site.joint, size * other**2)

    return effort


KINDS = {
    "cubic coupling of two joints": Kind(_cubic_coupling),
    "friction that grows with position": Kind(_growing_friction, ("coulomb_friction",)),
    "pendulum in a link": Kind(_pendulum),
    "motor that saturates at high speed": Kind(_saturation),
    "taut hose on a difference of angles": Kind(_taut_hose),
    "slipping belt": Kind(_slipping_belt, largest=2.0),
    "cable that drags in one direction": Kind(_cable_drag),
    "eccentric gear on a sum of angles": Kind(_eccentric_gear),
    "a few places that stick": Kind(_sticking_places),
    "square of another joint's speed": Kind(_neighbours_square),
}
"""Effects by name."""


ORDINARY, OUTSIDE, QUIET = "ordinary", "outside", "quiet"
ARMS = ("ur5", "xarm7", "z1", "kinova")
WHITE, COLOURED = "white", "coloured"
COLOURS = (WHITE, COLOURED)
_OFF = (0.0, 0.15, 0.3)
_RATES = (50.0, 100.0, 200.0, 500.0)
_QUIET = 2  # logs a colour and seed


@dataclass(frozen=True)
class Draw:
    """A robot and its two logs."""

    case: str
    robot: str
    engine: str
    kind: str
    friction: bool  # whether there is dry and viscous friction at all joints
    rotors: bool
    tool: float  # mass of the tool at the last link, as a share of the robot's; 0 without one
    off: float  # how far bodies of the model file are off, as a share of their mass
    rate: float
    velocities: bool
    noise: float  # deviation of an effort's noise, as a share of that of the effort
    colour: str
    quantised: bool  # whether positions and efforts are multiples of a resolution
    calibrated: bool  # whether logs state that gains of efforts are exact, as they are in all
    number: int
    seed: int
    duration: float = 40.0

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a generator of random numbers for a purpose of this draw."""
        words = f"{self.case} {self.robot} {self.kind} {purpose}"
        return np.random.default_rng([self.seed, self.number, crc32(words.encode())])


def draw(case: str, robot: str, number: int, seed: int, **fixed: object) -> Draw:
    """Return a random draw of a case; `fixed` has the fields that are not left to chance."""
    rng = np.random.default_rng([seed, number, crc32(f"{case} {robot}".encode())])
    ordinary = case == ORDINARY
    has_tool = rng.random() < 2.0 / 3.0
    tool = round(float(rng.uniform(0.05, 0.15)), 4) if has_tool else 0.0
    chosen = {
        "engine": ENGINES[(number + seed) % 2],
        "kind": "",
        "friction": ordinary,
        "rotors": bool(rng.random() < 0.5) and ordinary,
        "tool": tool if ordinary else 0.0,
        "off": float(rng.choice(_OFF)) if ordinary else 0.0,
        "rate": float(rng.choice(_RATES)),
        "velocities": bool(rng.random() < 0.5),
        "noise": round(float(np.exp(rng.uniform(*np.log((0.005, 0.02))))), 4),
        "colour": WHITE,
        "quantised": bool(rng.random() < 1.0 / 3.0),
        "calibrated": bool(rng.random() < 0.5),
    }
    values = {**chosen, **fixed}
    return Draw(case, robot, number=number, seed=seed, **values)  # type: ignore[arg-type]


def all_draws(seed: int, **fixed: object) -> list[Draw]:
    """Return a seed's draws, the cases in turn, so that the first few show some of all of them."""
    ordinary = [draw(ORDINARY, arm, k, seed, **fixed) for k, arm in enumerate(ARMS)]
    outside = [
        draw(
            OUTSIDE,
            ARMS[(k + seed) % len(ARMS)],
            k,
            seed,
            **{"kind": kind, "engine": "mujoco", "friction": (k + seed) % 2 == 0, **fixed},
        )
        for k, kind in enumerate(KINDS)
    ]
    quiet = [
        draw(QUIET, ARMS[(k + seed) % len(ARMS)], k, seed, **{"colour": COLOURS[k % 2], **fixed})
        for k in range(_QUIET * len(COLOURS))
    ]
    # As many of the many between two of the few.
    groups = zip_longest(ordinary, outside[0::3], outside[1::3], quiet, outside[2::3])
    return [each for group in groups for each in group if each is not None]


DRY, WET, ROTOR, TOOL = "coulomb_friction", "viscous_friction", "rotor_inertia", "payload"
_FRICTION, _WET = (0.02, 0.15), (0.3, 1.5)
_ROTOR = (0.03, 0.2)
_LEAST_RANGE = 0.1  # of the motor's limit: gears rub in joints without load, too
_BREAKAWAY = (0.005, 0.02)  # rad/s
_SHARE = (0.05, 0.25)  # of an effect of no catalogue
_LEAST_USUAL = 0.05  # N·m
_ENCODER, _TACHO = (1e-5, 5e-5), (2e-4, 2e-3)  # rad, rad/s
_STEP, _COUNTS = 1.5, 2.0**17  # of an effort's noise, of a turn
_LEAST_NOISY = 0.005  # of the motor's limit: sensors are noisy at joints without load, too
_COLOURS = (0.005, 0.05)  # s, time constants of coloured noise


@dataclass(frozen=True, eq=False)
class Recording:
    """What was recorded, and what is true of it."""

    logs: tuple[JointLog, ...]
    # Names of the effects of the catalogue that are hidden -> where.
    hidden: dict[str, tuple[str, ...]]
    beside: dict[str, tuple[str, ...]]  # further names that are right -> where
    mass: float  # mass of the tool, kg; 0 without one
    joints: tuple[str, ...]
    # Effect -> what it is sized by, by joint: N·m, N·m·s, kg·m²; and "breakaway", rad/s.
    values: dict[str, list[float]]


def make_recording(draw: Draw) -> Recording:
    """Return the logs of a draw, and its truth."""
    engine = make_engine(draw.engine, robot_file(draw.robot))
    model, limits = robot_model(draw.robot), _effort_limits(draw)
    rng = draw.rng("robot")
    if draw.off:
        engine.set_bodies(congruent(engine.bodies(), draw.off, rng))
    bodies, mass = engine.bodies(), 0.0
    if draw.tool:
        mass = draw.tool * float(bodies[:, 3, 3].sum())
        bodies[-1] += random_tool(mass, 0.15, 0.07, rng)
        engine.set_bodies(bodies)
    motions = [_moved(draw, engine, kind) for kind in (FAST, POINTS)]
    largest = np.max([np.abs(seen.load).max(0) for seen in motions], 0)
    ranges = np.maximum(largest, _LEAST_RANGE * limits)
    hidden: dict[str, tuple[str, ...]] = {}
    beside: dict[str, tuple[str, ...]] = {}
    efforts: list[Effort] = []
    values: dict[str, list[float]] = {}
    if draw.friction:
        rubbing, values = _friction(motions, ranges, rng)
        efforts.append(rubbing)
        hidden |= dict.fromkeys((DRY, WET), model.joints)
    if draw.rotors:
        fastest = np.max([np.abs(seen.a).max(0) for seen in motions], 0)
        inertias = between(_ROTOR, rng, len(ranges)) * ranges / fastest
        efforts.append(lambda seen, size: size * inertias * seen.a)
        hidden[ROTOR], values[ROTOR] = model.joints, inertias.tolist()
    if draw.tool:
        hidden[TOOL] = (model.bodies[-1],)
    joints: tuple[str, ...] = ()
    if draw.kind:
        site = _site(draw, motions, largest)
        efforts.append(_sized(draw, site, motions))
        joints = tuple(model.joints[k] for k in (site.joint, site.other))
        beside = dict.fromkeys(KINDS[draw.kind].comes_with, joints[:1])
    totals = [seen.load + sum(effort(seen, 1.0) for effort in efforts) for seen in motions]
    sensors = _Sensors(draw)
    logs = tuple(
        sensors.measured(f"log {k + 1}", seen, total)
        for k, (seen, total) in enumerate(zip(motions, totals, strict=True))
    )
    return Recording(logs, hidden, beside, mass, joints, values)


def _effort_limits(draw: Draw) -> Array:
    """Return (n,) largest efforts by the model file."""
    return np.asarray(robot_model(draw.robot).effort_limits)


def _moved(draw: Draw, engine: Engine, kind: str) -> Seen:
    time = np.arange(0.0, draw.duration, 1.0 / draw.rate)
    return Seen.of(engine, kind, time, draw.rng(kind))


def random_tool(mass: float, farthest: float, largest: float, rng: np.random.Generator) -> Array:
    """Return the pseudo-inertia (4, 4) of a random tool of a mass, kg, in the link's frame.

    Its centre is at most `farthest` along z, m, and its radii of gyration are at most `largest`, m.
    """
    center = np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.03, farthest)])
    radii = rng.uniform(0.02, largest, 3)
    return pseudo(mass, center, mass * np.diag(radii @ radii - radii**2))


def between(bounds: tuple[float, float], rng: np.random.Generator, n: int | None = None) -> Array:
    """Return numbers between bounds, alike for all magnitudes."""
    return np.exp(rng.uniform(*np.log(bounds), n))


def _friction(
    motions: list[Seen], ranges: Array, rng: np.random.Generator
) -> tuple[Effort, dict[str, list[float]]]:
    """Return dry and viscous friction of all joints, by a draw's own smooth sign; its sizes."""
    dry = between(_FRICTION, rng, len(ranges)) * ranges
    fastest = np.max([np.abs(seen.v).max(0) for seen in motions], 0)
    wet = dry * rng.uniform(*_WET, len(ranges)) / fastest
    width, is_tanh = float(between(_BREAKAWAY, rng)), rng.random() < 0.5

    def effort(seen: Seen, size: float) -> Array:
        sign = np.tanh(seen.v / width) if is_tanh else seen.v / np.hypot(seen.v, width)
        return size * (dry * sign + wet * seen.v)

    return effort, {DRY: dry.tolist(), WET: wet.tolist(), "breakaway": [width]}


def _site(draw: Draw, motions: list[Seen], largest: Array) -> Site:
    rng, engine = draw.rng("site"), motions[0].engine
    n = len(largest)
    joint, other = (int(k) for k in rng.choice(n, 2, replace=False))
    if "pendulum" in draw.kind:
        joint = int(rng.integers(n // 2, n))
    return Site(joint, other, robot_file(draw.robot), *motion_range(engine), largest, rng)


def _sized(draw: Draw, site: Site, motions: list[Seen]) -> Effort:
    """An effect of no catalogue whose RMS in all motions is a drawn share of its joint's effort."""
    kind, wanted = KINDS[draw.kind], float(between(_SHARE, draw.rng("size")))
    effort, size = kind.make(site), min(1.0, kind.largest)
    usual = np.maximum(np.concatenate([seen.load for seen in motions]).std(0), _LEAST_USUAL)
    for _ in range(6):
        efforts = np.concatenate([effort(seen, size) for seen in motions])
        reached = float(np.max(np.sqrt(np.mean(efforts**2, 0)) / usual))
        better = min(size * wanted / reached, kind.largest)
        if abs(better / size - 1.0) < 0.05:
            break
        size = better
    return lambda each, scale: effort(each, scale * size)


class _Sensors:
    """A draw's sensors, the same for all its logs."""

    def __init__(self, draw: Draw) -> None:
        self._draw, self._rng = draw, draw.rng("sensors")
        self._encoder, self._tacho = (
            float(between(each, self._rng)) for each in (_ENCODER, _TACHO)
        )

    def measured(self, name: str, seen: Seen, effort: Array) -> JointLog:
        """Return what they make of a motion and its efforts (N, n)."""
        draw, rng = self._draw, self._rng
        size = draw.noise * np.maximum(effort.std(0), _LEAST_NOISY * _effort_limits(draw))
        u = effort + size * self._noise(effort.shape)
        q = seen.q + self._encoder * rng.normal(size=effort.shape)
        v = seen.v + self._tacho * rng.normal(size=effort.shape)
        if draw.quantised:
            q = np.round(q * _COUNTS / (2.0 * np.pi)) * 2.0 * np.pi / _COUNTS
            u = np.round(u / (_STEP * size)) * _STEP * size
        stated = {"effort_uncertainty": 0.0} if draw.calibrated else {}
        joints, velocity = seen.engine.joints, v if draw.velocities else None
        return JointLog(name, joints, seen.time, q, u, velocity, **stated)

    def _noise(self, shape: tuple[int, ...]) -> Array:
        """Return noise of deviation one, white or coloured."""
        noise = self._rng.normal(size=shape)
        if self._draw.colour == COLOURED:
            constant = between(_COLOURS, self._rng)
            return coloured(noise, np.exp(-1.0 / (self._draw.rate * constant)))
        return noise
