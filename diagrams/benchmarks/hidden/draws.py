"""Random draws of the product robots × effects × motions × noise × prior, a fixed count a case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from diagrams.benchmarks.hidden.engines import ENGINES
from diagrams.benchmarks.hidden.motions import FAST, MOTIONS
from diagrams.benchmarks.hidden.robots import PLANAR, robot_names
from diagrams.benchmarks.hidden.table import COLOURED, KINDS, OUTSIDE, TRUTHS

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
    """One log.

    Attributes:
        case: Which question it belongs to.
        hidden: Names of the hidden effects.
        robot: Name of the robot.
        engine: Who makes the log.
        motion: Kind of motion.
        noise: Deviation of the effort's noise, as a share of that of the effort.
        colour: "white" or "coloured" noise.
        prior: Whether the model file's bodies are "exact", or "off" by 20 %.
        shares: RMS of every hidden effect, as a share of the deviation of the effort; at its joint,
            or at the median of the joints that an effect of a body or of the robot acts upon.
        number: Of the draw within its case.
        seed: Of the study.
        duration: Length of the log, s.
        rate: Samples a second.
    """

    case: str
    hidden: tuple[str, ...]
    robot: str
    engine: str
    motion: str
    noise: float
    colour: str
    prior: str
    shares: tuple[float, ...]
    number: int
    seed: int
    duration: float = 24.0
    rate: float = 200.0


def draw(case: str, hidden: Sequence[str], number: int, seed: int, **fixed: object) -> Draw:
    """A random draw of a case; `fixed` has the fields that are not left to chance."""
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
    """Two effects that may come together."""
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
    """Every case, `draws` logs an effect.

    Args:
        draws: Logs an effect of the catalogue; other counts follow from it.
        seed: Of everything.
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


def kind_draws(draws: int, seed: int, **fixed: object) -> list[Draw]:
    """Logs of the kinds that are hard."""
    return [
        draw(KIND, (name,), k, seed, **{**given, **fixed})
        for name, (_, given) in KINDS.items()
        for k in range(draws)
    ]


def timing_draws(seed: int) -> list[Draw]:
    """Logs of six joints and 10,000 samples."""
    fixed = {"robot": "arm6", "motion": FAST, "duration": 50.0, "rate": 200.0}
    return [draw(TIMING, (name,), 0, seed, **fixed) for name in ("coulomb_friction", "payload")]


def coverage_draws(
    draws: int, seed: int, *, effects: Sequence[str] = COVERED, **fixed: object
) -> list[Draw]:
    """Logs of one effect under coloured noise, large enough to be found."""
    sure = {"colour": COLOURED, "motion": FAST, "prior": EXACT, "shares": (0.1,)}
    return [
        draw(COVERAGE, (name,), k, seed, **{**sure, **fixed})
        for name in effects
        for k in range(draws)
    ]


def disturbed_draws(draws: int, seed: int, **fixed: object) -> list[Draw]:
    """The same with an effect beside that is in no catalogue."""
    sure = {"motion": FAST, "prior": EXACT, "shares": (0.1, 0.05)}
    found = []
    for at, name in enumerate(COVERED):
        for k in range(draws):
            beside = np.random.default_rng([seed, 3, at, k]).choice(tuple(OUTSIDE))
            found.append(draw(COVERAGE, (name, str(beside)), k, seed, **{**sure, **fixed}))
    return found


def smallest_draws(
    draws: int, seed: int, *, effects: Sequence[str] = tuple(TRUTHS), **fixed: object
) -> list[Draw]:
    """Logs in which the size of an effect is bisected, at 1 % noise."""
    sure = {"motion": FAST, "prior": EXACT, "noise": 0.01, "shares": ()}
    return [
        draw(SMALLEST, (name,), k, seed, **{**sure, **fixed})
        for name in effects
        for k in range(draws)
    ]
