"""Logs of robots with hidden effects, and how they are drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from diagrams.benchmarks.hidden.robots import (
    ENGINES,
    FAST,
    MOTIONS,
    PLANAR,
    Engine,
    coloured,
    congruent,
    make_engine,
    robot_file,
    robot_names,
)
from diagrams.benchmarks.hidden.truths import (
    BODY,
    COLOURED,
    JOINT,
    KINDS,
    OTHER,
    OUTSIDE,
    OWN,
    PAIR,
    ROBOT,
    TRUTHS,
    Array,
    Hidden,
    Outside,
    Seen,
    Site,
    Truth,
    smooth_sign,
    truth_of,
)
from geodrake.logs import JointLog

ONE, TWO, NONE, UNKNOWN = "one", "two", "none", "outside"
COVERAGE, SMALLEST, TIMING = "coverage", "smallest", "timing"
KIND = "kind"
WHITE = "white"
EXACT, OFF = "exact", "off"
NOISES = (0.005, 0.01, 0.02)
LEAST_SHARE, MOST_SHARE = 0.03, 0.25
_LEAST_OF_TWO = 0.05
OFF_BY = 0.2
WRONG_INERTIA = "wrong_inertia"
COVERED = ("viscous_friction", "coulomb_friction", "effort_offset", "rotor_inertia", "payload")
_MOTION_ODDS = (0.45, 0.25, 0.3)
_EXACT_ODDS = 0.7
_FIRST_COLOURED = 100_000


@dataclass(frozen=True)
class Draw:
    """One log."""

    case: str
    hidden: tuple[str, ...]
    robot: str
    engine: str
    motion: str
    noise: float  # deviation of the effort's noise, as a share of that of the effort
    colour: str
    prior: str  # whether the model file's bodies are "exact", or "off" by 20 %
    # RMS of every hidden effect, as a share of the deviation of the effort; at its joint, or at the
    # median of the joints that an effect of a body or of the robot acts upon.
    shares: tuple[float, ...]
    number: int
    seed: int
    duration: float = 24.0
    rate: float = 200.0


def draw(case: str, hidden: Sequence[str], number: int, seed: int, **fixed: object) -> Draw:
    """Return a random draw of a case; `fixed` has the fields that are not left to chance."""
    rng = np.random.default_rng([seed, crc32(f"{case} {' '.join(hidden)}".encode()), number])
    least = _LEAST_OF_TWO if len(hidden) > 1 else LEAST_SHARE
    robots = robot_names()
    if any(name in OUTSIDE and OUTSIDE[name].in_space for name in hidden):
        robots = tuple(name for name in robots if name not in PLANAR)
    shares = np.exp(rng.uniform(np.log(least), np.log(MOST_SHARE), len(hidden)))
    chosen = {
        "robot": str(rng.choice(robots)),
        "engine": str(rng.choice(ENGINES)),
        "motion": str(rng.choice(MOTIONS, p=_MOTION_ODDS)),
        "noise": float(rng.choice(NOISES)),
        "colour": WHITE,
        "prior": EXACT if rng.random() < _EXACT_ODDS else OFF,
        "shares": tuple(shares.round(4).tolist()),
    }
    values = {**chosen, **fixed}
    return Draw(case, tuple(hidden), number=number, seed=seed, **values)  # type: ignore[arg-type]


def pair(number: int, seed: int) -> tuple[str, str]:
    """Return two effects that may come together."""
    rng = np.random.default_rng([seed, 2, number])
    names = [name for name, truth in TRUTHS.items() if not truth.alone]
    first, second = rng.choice(names, 2, replace=False)
    return str(first), str(second)


def all_draws(
    draws: int,
    seed: int,
    *,
    effects: Sequence[str] = tuple(TRUTHS),
    outside: Sequence[str] = tuple(OUTSIDE),
    others: tuple[int, int] | None = None,
    **fixed: object,
) -> list[Draw]:
    """Return every case, `draws` logs an effect.

    Args:
        draws: Logs an effect of the catalogue; other counts follow from it.
        effects: Effects that are hidden alone.
        outside: Effects of no catalogue; finding words for them takes longest.
        others: Logs that hide two effects, and that hide none, of either colour; 4 and 6 times
            `draws` if None.
        fixed: Fields of the draws that are not left to chance.
    """
    pairs, empty = others or (4 * draws, 6 * draws)
    found = []
    for name in effects:
        # Where every body is wrong, the one that is more so is no truth to be found.
        sure = {"prior": EXACT} if name == WRONG_INERTIA else {}
        found += [draw(ONE, (name,), k, seed, **{**fixed, **sure}) for k in range(draws)]
    for name in outside:
        found += [draw(UNKNOWN, (name,), k, seed, **fixed) for k in range((draws + 1) // 2)]
    found += [draw(TWO, pair(k, seed), k, seed, **fixed) for k in range(pairs)]
    for colour in (WHITE, COLOURED):
        sure = {"colour": colour, "prior": EXACT, "shares": ()}
        # The number says which log: that of the other colour is another one.
        first = 0 if colour == WHITE else _FIRST_COLOURED
        found += [draw(NONE, (), first + k, seed, **{**fixed, **sure}) for k in range(empty)]
    return found


_SURE = {"motion": FAST, "prior": EXACT}
STUDIES: Mapping[str, tuple[str, Sequence[str], Mapping[str, object]]] = {
    "kinds": (KIND, tuple(KINDS), {}),
    "coverage": (COVERAGE, COVERED, {**_SURE, "colour": COLOURED, "shares": (0.1,)}),
    "disturbed": (COVERAGE, COVERED, {**_SURE, "shares": (0.1, 0.05)}),
    "smallest": (SMALLEST, tuple(TRUTHS), {**_SURE, "noise": 0.01, "shares": ()}),
    "timing": (
        TIMING,
        ("coulomb_friction", "payload"),
        {"robot": "arm6", "motion": FAST, "duration": 50.0, "rate": 200.0},
    ),
}
"""Further studies: the case, its effects, and what is not left to chance.

Those of coverage are large enough to be found, and have one of no catalogue beside if disturbed.
"""


def study_draws(
    study: str, draws: int, seed: int, *, effects: Sequence[str] = (), **fixed: object
) -> list[Draw]:
    """Return the draws of a study, so many logs for each of its effects or of some."""
    case, names, sure = STUDIES[study]
    found = []
    for at, name in enumerate(effects or names):
        given = {**sure, **(KINDS[name][1] if case == KIND else {}), **fixed}
        for k in range(draws):
            hidden = (name,)
            if study == "disturbed":
                beside = np.random.default_rng([seed, 3, at, k]).choice(tuple(OUTSIDE))
                hidden = (name, str(beside))
            found.append(draw(case, hidden, k, seed, **given))
    return found


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
    """What a log hides."""

    name: str
    where: tuple[str, ...]  # joints or body that are to be named; none for one of the whole robot
    joints: tuple[str, ...]
    share: float  # its RMS as a share of the deviation of the effort, as in `Draw.shares`
    values: Mapping[str, float]  # parameters that geodrake should find
    # For an effect of no catalogue, joints and signals that it varies with.
    follows: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """A log with its secrets."""

    log: JointLog
    secrets: tuple[Secret, ...]  # what it hides
    bare: JointLog  # the log of the same motion and noise if the robot were that of the model file
    # A log of the same robot before, without the effects; None where the model file is all that is
    # known.
    known: JointLog | None = None


def make_recording(draw: Draw, bodies: tuple[str, ...]) -> Recording:
    """Return the log of a draw.

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
    return Seen.of(engine, draw.motion, np.arange(0.0, draw.duration, 1.0 / draw.rate), rng)


def _rubbing(seen: Seen, sizes: Array) -> Array:
    """Return dry and viscous friction at all joints."""
    return np.asarray(sizes * (smooth_sign(seen.v) + 0.7 * seen.v))


def _measured(draw: Draw, seen: Seen, effort: Array, rng: np.random.Generator) -> JointLog:
    """Return what sensors make of it."""
    noise = rng.normal(size=effort.shape)
    if draw.colour == COLOURED:
        constant = np.exp(rng.uniform(*np.log(_COLOURS)))
        noise = coloured(noise, np.exp(-1.0 / (draw.rate * constant)))
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
    """Return the effort of an effect of a share, and what is to be found of it."""
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
