"""Benchmark of ordinary robots: what `geodrake explain` says of arms as they are.

Pinocchio or MuJoCo makes two logs each of four public arms with friction at every joint, often with
rotors at every joint and a tool. The model file is exact, or 15 or 30 % off; logs have 50 to 500
samples a second, with or without velocities. Other robots hide an effect of no catalogue, for which
every name is wrong, or nothing. Reported are whether everything is named and nothing else, the
tool's mass with its interval, CPU seconds, and calibration: of all that is said with a
probability, how much is true.

    python -m diagrams.benchmarks.ordinary_robots --seeds 10 --json ordinary.json
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated.engines import (
    ENGINES,
    Generator,
    congruent,
    make_engine,
    number_of,
    robot_file,
    robot_model,
)
from diagrams.benchmarks.simulated.motions import FAST, POINTS, motion_range
from diagrams.benchmarks.simulated.recording import (
    TIME_CONSTANTS,
    Recording,
    Sensors,
    Sizes,
    between,
    random_tool,
)
from diagrams.benchmarks.simulated.scoring import (
    Line,
    Row,
    calibration,
    explained,
    is_clean,
    is_sure_and_wrong,
    quantiles,
    share,
    tell_draws,
)
from diagrams.benchmarks.simulated.truths import (
    COLOURED,
    DRY,
    HELD,
    IN_A_LINK,
    OF_ALL_MOTIONS,
    ROTOR,
    WET,
    Seen,
    Site,
    Usual,
    scaled,
)
from diagrams.harness import positive_number, run_draws, script_parser
from geodrake.logs import JointLog

ORDINARY, OUTSIDE, QUIET = "ordinary", "outside", "quiet"
ARMS = ("ur5", "xarm7", "z1", "kinova")
WHITE = "white"
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

    def rng(self, purpose: str) -> Generator:
        """Return a generator of random numbers for a purpose of this draw."""
        words = f"{self.case} {self.robot} {self.kind} {purpose}"
        return np.random.default_rng([self.seed, self.number, number_of(words)])


def draw(case: str, robot: str, number: int, seed: int, **fixed: object) -> Draw:
    """Return a random draw of a case, except for the `fixed` fields."""
    rng = np.random.default_rng([seed, number, number_of(f"{case} {robot}")])
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
    """Return a seed's draws, with the cases in turn, so that the first few have some of each."""
    ordinary = [draw(ORDINARY, arm, k, seed, **fixed) for k, arm in enumerate(ARMS)]
    outside = [
        draw(
            OUTSIDE,
            ARMS[(k + seed) % len(ARMS)],
            k,
            seed,
            **{"kind": kind, "engine": "mujoco", "friction": (k + seed) % 2 == 0, **fixed},
        )
        for k, kind in enumerate(OF_ALL_MOTIONS)
    ]
    quiet = [
        draw(QUIET, ARMS[(k + seed) % len(ARMS)], k, seed, **{"colour": COLOURS[k % 2], **fixed})
        for k in range(_QUIET * len(COLOURS))
    ]
    # As many of the many between two of the few.
    groups = zip_longest(ordinary, outside[0::3], outside[1::3], quiet, outside[2::3])
    return [each for group in groups for each in group if each is not None]


_BREAKAWAY = (0.005, 0.02)  # rad/s
_SHARE = (0.05, 0.25)  # of an effect of no catalogue
_LEAST_USUAL = 0.05  # N·m
_ENCODER, _TACHO = (1e-5, 5e-5), (2e-4, 2e-3)  # rad, rad/s
_LEAST_NOISY = 0.005  # of the motor's limit: sensors are noisy at joints without load, too


def make_recording(draw: Draw) -> Recording:
    """Return the logs of a draw, and its truth."""
    engine, model = make_engine(draw.engine, robot_file(draw.robot)), robot_model(draw.robot)
    limits, rng = np.asarray(model.effort_limits), draw.rng("robot")
    if draw.off:
        engine.set_bodies(congruent(engine.bodies(), draw.off, rng))
    bodies, mass = engine.bodies(), 0.0
    if draw.tool:
        mass = draw.tool * float(bodies[:, 3, 3].sum())
        bodies[-1] += random_tool(mass, 0.15, 0.07, rng)
        engine.set_bodies(bodies)
    time = np.arange(0.0, draw.duration, 1.0 / draw.rate)
    motions = [Seen.of(engine, kind, time, draw.rng(kind)) for kind in (FAST, POINTS)]
    totals, sizes = [seen.load.copy() for seen in motions], Sizes.of(motions, limits)
    hidden: dict[str, tuple[str, ...]] = {}
    values: dict[str, list[float]] = {}
    if draw.friction:
        dry, wet = sizes.friction(rng)
        width, is_tanh = float(between(_BREAKAWAY, rng)), rng.random() < 0.5
        for k, seen in enumerate(motions):
            sign = np.tanh(seen.v / width) if is_tanh else seen.v / np.hypot(seen.v, width)
            totals[k] += dry * sign + wet * seen.v
        values = {DRY: dry.tolist(), WET: wet.tolist(), "breakaway": [width]}
        hidden |= dict.fromkeys((DRY, WET), model.joints)
    if draw.rotors:
        inertias = sizes.rotors(rng)
        for k, seen in enumerate(motions):
            totals[k] += inertias * seen.a
        hidden[ROTOR], values[ROTOR] = model.joints, inertias.tolist()
    if draw.tool:
        hidden[HELD] = (model.bodies[-1],)
    joints: tuple[str, ...] = ()
    if draw.kind:
        joints = _hide(draw, motions, totals, sizes)
    companions = OF_ALL_MOTIONS[draw.kind].companions if draw.kind else ()
    logs = _measured(draw, motions, totals, limits)
    return Recording(logs, hidden, dict.fromkeys(companions, joints[:1]), mass, joints, values)


def _hide(
    draw: Draw, motions: Sequence[Seen], totals: list[np.ndarray], sizes: Sizes
) -> tuple[str, ...]:
    """Add an effect of no catalogue to efforts, and return its joints.

    Its RMS in all motions is a drawn share of its joint's effort.
    """
    kind, rng, engine = OF_ALL_MOTIONS[draw.kind], draw.rng("site"), motions[0].engine
    n = len(engine.joints)
    joint, other = (int(k) for k in rng.choice(n, 2, replace=False))
    if draw.kind == IN_A_LINK:
        joint = int(rng.integers(n // 2, n))
    usual = Usual(robot_file(draw.robot), *motion_range(engine), sizes.load)
    site = Site(joint, other, rng, usual)
    loads = np.concatenate([seen.load for seen in motions]).std(0)

    def reached(size: float) -> float:
        efforts = np.concatenate([kind.law(seen, site, size) for seen in motions])
        return float(np.max(np.sqrt(np.mean(efforts**2, 0)) / np.maximum(loads, _LEAST_USUAL)))

    wanted = float(between(_SHARE, draw.rng("size")))
    size = scaled(wanted, reached, kind, close=0.05, tries=6)
    for k, seen in enumerate(motions):
        totals[k] += kind.law(seen, site, size)
    return engine.joints[joint], engine.joints[other]


def _measured(
    draw: Draw, motions: Sequence[Seen], totals: Sequence[np.ndarray], limits: np.ndarray
) -> tuple[JointLog, ...]:
    """Return measured motions and efforts, with the same sensors in all logs of a draw."""
    rng = draw.rng("sensors")
    encoder, tacho = (float(between(each, rng)) for each in (_ENCODER, _TACHO))
    memory = partial(between, TIME_CONSTANTS) if draw.colour == COLOURED else None
    least = _LEAST_NOISY * limits
    sensors = Sensors(draw.noise, encoder, tacho, least, memory, quantised=draw.quantised)
    stated = {"effort_uncertainty": 0.0} if draw.calibrated else {}
    logs = []
    for k, (seen, total) in enumerate(zip(motions, totals, strict=True)):
        log = sensors.log(f"log {k + 1}", seen, total, rng, **stated)
        logs.append(log if draw.velocities else replace(log, velocity=None))
    return tuple(logs)


def score_draw(draw: Draw) -> dict[str, Any]:
    """Return the row of a draw: its truth, the named effects, and which are right."""
    recording = make_recording(draw)
    truth = ("hidden", "beside", "mass", "joints", "values")
    row = {**asdict(draw), **{name: getattr(recording, name) for name in truth}}
    return row | explained(robot_model(draw.robot), recording, is_off=draw.off > 0.0)


def is_missed(row: Row) -> bool:
    """Return whether a name is wrong or, for an ordinary robot, missing."""
    return bool(row["wrong"] or row["failed"] or (row["missing"] and row["case"] == ORDINARY))


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Return all report lines."""
    ordinary = [row for row in rows if row["case"] == ORDINARY]
    outside = [row for row in rows if row["case"] == OUTSIDE]
    tools = [row for row in ordinary if row["mass"]]
    found = [row for row in tools if "found_mass" in row]
    seconds = [row["seconds"] for row in ordinary if not row["failed"]]
    said = [row for row in found if row["calibrated"]]
    widths = [row["mass_half_width"] for row in found]
    return [
        share("ordinary: everything named", [not row["missing"] for row in ordinary], 0.95),
        share("ordinary: nothing else named", [is_clean(row) for row in ordinary], 0.95),
        share("… both", [not row["missing"] and is_clean(row) for row in ordinary], 0.95),
        share("tool named", ["found_mass" in row for row in tools], 0.98),
        share(
            "tool's mass inside its interval",
            [row["mass_inside"] for row in found],
            0.9,
            highest=0.98,
        ),
        share("… of calibrated efforts", [row["mass_inside"] for row in said]),
        *quantiles("half width of a tool's mass", widths, 0.15),
        *quantiles("… calibrated", [row["mass_half_width"] for row in said], 0.15),
        *quantiles("error of a tool's mass", [row["mass_error"] for row in found]),
        *quantiles("seconds of CPU", seconds, 5.0),
        share(
            "no catalogue has it: a wrong name at > 0.9",
            [is_sure_and_wrong(row) for row in outside],
            0.1,
            most=True,
        ),
        share("… a wrong name at all", [not is_clean(row) for row in outside], most=True),
        *(
            share(
                f"nothing hidden, {colour} noise: something named",
                [bool(r["steps"]) for r in rows if r["case"] == QUIET and r["colour"] == colour],
                0.01,
                most=True,
            )
            for colour in COLOURS
        ),
        *calibration(rows),
    ]


def quick_draws(seed: int) -> list[Draw]:
    """Return a short draw of every case, of the fastest arm."""
    short = {"duration": 10.0, "rate": 100.0, "velocities": True, "noise": 0.005}
    return [
        draw(ORDINARY, "ur5", 0, seed, **short, tool=0.1, off=0.0, rotors=False),
        draw(OUTSIDE, "ur5", 0, seed, **short, kind=IN_A_LINK),
        draw(QUIET, "ur5", 0, seed, **short),
    ]


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    number = {"type": positive_number, "metavar": "N"}
    parser.add_argument("--seeds", default=1, **number, help="seeds, from --seed on")
    parser.add_argument("--most", default=None, **number, help="only the first N draws")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.seeds)
    wanted = [each for seed in seeds for each in all_draws(seed)][: options.most]
    wanted = quick_draws(options.seed) if options.quick else wanted
    rows = run_draws(parser, options, score_draw, wanted)
    tell_draws(options, "Ordinary robots", lines_of(rows), rows, is_missed)


if __name__ == "__main__":
    main()
