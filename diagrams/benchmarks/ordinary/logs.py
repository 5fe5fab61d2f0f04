"""Logs of ordinary robots: two motions each, with friction, rotors and a tool as real arms have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagrams.benchmarks.hidden.engines import Engine, congruent, make_engine, pseudo
from diagrams.benchmarks.hidden.motions import FAST, POINTS, make_motion
from diagrams.benchmarks.hidden.robots import robot_file, robot_model
from diagrams.benchmarks.hidden.truths import Array, Effort, Seen
from diagrams.benchmarks.ordinary.draws import COLOURED, Draw
from diagrams.benchmarks.ordinary.uncatalogued import KINDS, Site
from geodrake.logs import JointLog

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
_SPEED = 4.0  # rad/s, where limits are looser


@dataclass(frozen=True, eq=False)
class Recording:
    """What was recorded, and what is true of it.

    Attributes:
        logs: The logs.
        hidden: Names of the effects of the catalogue that are hidden -> where.
        beside: Further names that are right -> where.
        mass: Mass of the tool, kg; 0 without one.
        joints: Joints of the effect of no catalogue.
        values: Effect -> what it is sized by, by joint: N·m, N·m·s, kg·m²; and "breakaway", rad/s.
    """

    logs: tuple[JointLog, ...]
    hidden: dict[str, tuple[str, ...]]
    beside: dict[str, tuple[str, ...]]
    mass: float
    joints: tuple[str, ...]
    values: dict[str, list[float]]


def make_recording(draw: Draw) -> Recording:
    """The logs of a draw, and its truth."""
    engine = make_engine(draw.engine, robot_file(draw.robot))
    model, limits = robot_model(draw.robot), _effort_limits(draw)
    rng = draw.rng("robot")
    if draw.off:
        engine.set_bodies(congruent(engine.bodies(), draw.off, rng))
    bodies, mass = engine.bodies(), 0.0
    if draw.tool:
        mass = draw.tool * float(bodies[:, 3, 3].sum())
        center = np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.03, 0.15)])
        radii = rng.uniform(0.02, 0.07, 3)
        inertia = mass * np.diag(radii @ radii - radii**2)
        bodies[-1] += pseudo(mass, center, inertia)
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
        inertias = _between(_ROTOR, rng, len(ranges)) * ranges / fastest
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
    """(n,) largest efforts by the model file."""
    return np.asarray(robot_model(draw.robot).effort_limits)


def _moved(draw: Draw, engine: Engine, kind: str) -> Seen:
    time = np.arange(0.0, draw.duration, 1.0 / draw.rate)
    q, v, a = make_motion(kind, engine, time, draw.rng(kind))
    return Seen(time, q, v, a, engine.efforts(q, v, a), engine)


def _between(bounds: tuple[float, float], rng: np.random.Generator, n: int | None = None) -> Array:
    """Numbers between bounds, alike for all magnitudes."""
    return np.exp(rng.uniform(*np.log(bounds), n))


def _friction(
    motions: list[Seen], ranges: Array, rng: np.random.Generator
) -> tuple[Effort, dict[str, list[float]]]:
    """Dry and viscous friction of all joints, by a draw's own smooth sign; its sizes."""
    dry = _between(_FRICTION, rng, len(ranges)) * ranges
    fastest = np.max([np.abs(seen.v).max(0) for seen in motions], 0)
    wet = dry * rng.uniform(*_WET, len(ranges)) / fastest
    width, is_tanh = float(_between(_BREAKAWAY, rng)), rng.random() < 0.5

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
    half = np.minimum((engine.high - engine.low) / 2.0, np.pi / 2.0)
    center = np.clip(0.0, engine.low + half, engine.high - half)
    speed = 0.6 * np.minimum(engine.fastest, _SPEED)
    return Site(joint, other, robot_file(draw.robot), center, 0.6 * half, speed, largest, rng)


def _sized(draw: Draw, site: Site, motions: list[Seen]) -> Effort:
    """An effect of no catalogue whose RMS in all motions is a drawn share of its joint's effort."""
    kind, wanted = KINDS[draw.kind], float(_between(_SHARE, draw.rng("size")))
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
            float(_between(each, self._rng)) for each in (_ENCODER, _TACHO)
        )

    def measured(self, name: str, seen: Seen, effort: Array) -> JointLog:
        """What they make of a motion and its efforts (N, n)."""
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
        """Noise of deviation one, white or coloured."""
        noise = self._rng.normal(size=shape)
        if self._draw.colour == COLOURED:
            memory = np.exp(-1.0 / (self._draw.rate * _between(_COLOURS, self._rng)))
            noise[1:] *= np.sqrt(1.0 - memory**2)
            for k in range(1, len(noise)):
                noise[k] += memory * noise[k - 1]
        return np.asarray(noise)
