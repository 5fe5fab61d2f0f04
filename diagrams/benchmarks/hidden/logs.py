"""Logs of robots with hidden effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from diagrams.benchmarks.hidden.draws import COLOURED, OFF, OFF_BY, Draw
from diagrams.benchmarks.hidden.engines import Engine, congruent, make_engine
from diagrams.benchmarks.hidden.motions import make_motion
from diagrams.benchmarks.hidden.outside import OTHER, OWN, Outside
from diagrams.benchmarks.hidden.robots import robot_file
from diagrams.benchmarks.hidden.table import truth_of
from diagrams.benchmarks.hidden.truths import (
    BODY,
    JOINT,
    PAIR,
    ROBOT,
    Array,
    Hidden,
    Seen,
    Site,
    Truth,
    smooth_sign,
)
from geodrake.logs import JointLog

_ENCODER, _TACHO = 1e-5, 2e-4  # rad, rad/s
_COLOURS = (0.005, 0.05)  # s, time constants of coloured noise
_LATE, _HELD = "effort_delay", "payload"
_TURN = {_HELD: 0, _LATE: 2}
_CLOSE = 0.03
_ACTED_UPON = 0.5
_ONE_AT_A_JOINT: tuple[set[str], ...] = (
    {"joint_spring", "effort_offset"},
    {"asymmetric_friction", "effort_offset"},
    {"asymmetric_friction", "coulomb_friction"},
    {"asymmetric_friction", "viscous_friction"},
)
"""A spring with an offset is one of another rest; asymmetric friction with an offset, or with more
friction, is asymmetric friction of other heights and slopes."""
_TURNS = 6  # changes of the load's sign
_RUBBING = 0.08


@dataclass(frozen=True, eq=False)
class Secret:
    """What a log hides.

    Attributes:
        name: The effect.
        where: Joints or body that are to be named; none for one of the whole robot.
        joints: Joints that it acts upon most.
        share: Its RMS as a share of the deviation of the effort, as in `Draw.shares`.
        values: Parameters that geodrake should find.
        follows: For an effect of no catalogue, joints and signals that it goes with.
    """

    name: str
    where: tuple[str, ...]
    joints: tuple[str, ...]
    share: float
    values: Mapping[str, float]
    follows: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """A log with its secrets.

    Attributes:
        log: The log.
        secrets: What it hides.
        bare: The log of the same motion and noise if the robot were that of the model file.
        known: A log of the same robot before, without the effects; None where the model file is
            all that is known.
    """

    log: JointLog
    secrets: tuple[Secret, ...]
    bare: JointLog
    known: JointLog | None = None


def make_recording(draw: Draw, bodies: tuple[str, ...]) -> Recording:
    """The log of a draw.

    Args:
        draw: The draw; its shares may be other ones for the same log otherwise.
        bodies: Names that geodrake has for the bodies, in the order of the joints.
    """
    key = f"{draw.case} {draw.hidden} {draw.robot}"
    seeds = np.random.SeedSequence([draw.seed, crc32(key.encode()), draw.number]).spawn(4)
    on_robot, on_motion, on_site, on_noise = map(np.random.default_rng, seeds)
    engine = make_engine(draw.engine, robot_file(draw.robot))
    file = engine.bodies()
    if draw.prior == OFF:
        engine.set_bodies(congruent(engine.bodies(), OFF_BY, on_robot))
    seen = _seen(draw, engine, on_motion)
    kinds = [truth_of(name) for name in draw.hidden]
    known = None
    if any(isinstance(kind, Truth) and kind.needs_known_inertia for kind in kinds):
        before = _seen(draw, engine, on_motion)
        sizes = _RUBBING * before.load.std(0)
        known = _measured(draw, before, before.load + _rubbing(before, sizes), on_noise)
        seen = replace(seen, load=seen.load + _rubbing(seen, sizes))
    sites = _sites(kinds, seen.load, on_site)
    total, secrets = seen.load.copy(), dict[int, Secret]()
    # Gears bear what the last body holds; a delay, in the measurement, is that of all efforts.
    for k in sorted(range(len(kinds)), key=lambda k: _TURN.get(kinds[k].name, 1)):
        if kinds[k].name == _LATE:
            seen = replace(seen, load=total)
        effort, secrets[k] = _hide(kinds[k], sites[k], draw.shares[k], seen, bodies)
        total = total + effort
        if kinds[k].name == _HELD:
            seen = replace(seen, load=total)
    log = _measured(draw, seen, total, on_noise)
    engine.set_bodies(file)
    bare = replace(log, effort=log.effort - total + engine.efforts(seen.q, seen.v, seen.a))
    return Recording(log, tuple(secrets[k] for k in range(len(kinds))), bare, known)


def _seen(draw: Draw, engine: Engine, rng: np.random.Generator) -> Seen:
    time = np.arange(0.0, draw.duration, 1.0 / draw.rate)
    q, v, a = make_motion(draw.motion, engine, time, rng)
    return Seen(time, q, v, a, engine.efforts(q, v, a), engine)


def _rubbing(seen: Seen, sizes: Array) -> Array:
    """Dry and viscous friction at all joints."""
    return np.asarray(sizes * (smooth_sign(seen.v) + 0.7 * seen.v))


def _measured(draw: Draw, seen: Seen, effort: Array, rng: np.random.Generator) -> JointLog:
    """What sensors make of it."""
    noise = rng.normal(size=effort.shape)
    if draw.colour == COLOURED:
        constant = np.exp(rng.uniform(*np.log(_COLOURS)))
        memory = np.exp(-1.0 / (draw.rate * constant))
        noise *= np.sqrt(1.0 - memory**2)
        noise[0] /= np.sqrt(1.0 - memory**2)
        for k in range(1, len(noise)):
            noise[k] += memory * noise[k - 1]
    return JointLog(
        f"{draw.robot} {draw.number}",
        seen.engine.joints,
        seen.time,
        seen.q + _ENCODER * rng.normal(size=effort.shape),
        effort + draw.noise * effort.std(0) * noise,
        seen.v + _TACHO * rng.normal(size=effort.shape),
        effort_uncertainty=0.0,  # of a simulated sensor
    )


def _sites(kinds: list[Truth | Outside], load: Array, rng: np.random.Generator) -> list[Site]:
    """Where effects act; two on joints share one in half of the logs."""
    found: list[Site] = []
    n, turns = load.shape[1], (np.diff(np.sign(load), axis=0) != 0).sum(0)
    turning = np.flatnonzero(turns >= min(_TURNS, turns.max()))
    for kind in kinds:
        own = rng.spawn(1)[0]
        joint = int(rng.integers(n))
        if found and rng.random() < 0.5:
            joint = found[0].joint
        if found and joint == found[0].joint and {kind.name for kind in kinds} in _ONE_AT_A_JOINT:
            joint = (joint + 1) % n
        other = int(rng.choice([j for j in range(n) if j != joint]))
        if isinstance(kind, Truth) and kind.reverses:
            joint = int(turning[joint % len(turning)])
        elif isinstance(kind, Truth) and kind.places == PAIR:
            joint = min(joint, n - 2)
            other = joint + 1
        elif isinstance(kind, Truth) and kind.places == BODY and kind.name != "wrong_inertia":
            joint = n - 1 if kind.name == _HELD else int(rng.integers(n // 2, n))
        elif isinstance(kind, Outside) and kind.in_link:
            joint = int(rng.integers(n // 2, n))
        found.append(Site(joint, other, own))
    return found


def _hide(
    kind: Truth | Outside, site: Site, share: float, seen: Seen, bodies: tuple[str, ...]
) -> tuple[Array, Secret]:
    """Effort of an effect of a share, and what is to be found of it."""
    hidden: Hidden = kind.make(site)
    unit, largest = (kind.unit, kind.largest) if isinstance(kind, Truth) else (1.0, np.inf)
    everywhere = kind.places in (BODY, ROBOT) if isinstance(kind, Truth) else kind.in_link
    size = min(unit, largest)
    for _ in range(10):
        effort = hidden.effort(seen, size)
        shares = np.sqrt(np.mean(effort**2, 0)) / seen.load.std(0)
        reached = float(
            np.median(shares[shares > 1e-3 * shares.max()]) if everywhere else shares.max()
        )
        wanted = min(size * share / reached, largest)
        if abs(wanted / size - 1.0) < _CLOSE:
            break
        size = wanted
    joints = seen.engine.joints
    acted = tuple(joints[j] for j in np.flatnonzero(shares >= _ACTED_UPON * shares.max()))
    places = kind.places if isinstance(kind, Truth) else JOINT
    where = {
        JOINT: (joints[site.joint],),
        PAIR: (joints[site.joint], joints[site.other]),
        BODY: (bodies[site.joint],),
        ROBOT: (),
    }[places]
    values = {name: float(size * value) for name, value in hidden.values.items()}
    follows: tuple[tuple[str, str], ...] = ()
    if isinstance(kind, Outside):
        names = {OWN: joints[site.joint], OTHER: joints[site.other]}
        follows = tuple((names.get(whose, whose), what) for whose, what in kind.follows)
    return effort, Secret(kind.name, where, acted, reached, values, follows)
