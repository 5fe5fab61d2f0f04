"""Benchmark of everyday logs: what `geodrake explain` says of arms driven as people drive them.

Nine public arms, simulated by Pinocchio or MuJoCo, move by Fourier series, trapezoidal speeds,
teleoperation, from point to point, or one joint after the other, in one to three logs of 20 to
60 s. All, some or no joints have friction; there may be rotors, effort offsets and a tool. Gains of
efforts are a few per cent off, efforts may be late, the file's bodies are 15 or 30 % off, and noise
is white or coloured. Reported is how much of this is named, and what else is.

    python -m diagrams.benchmarks.everyday_robots --draws 45 --json everyday.json

With `--spoiled`, each robot's logs have one to three faults of recording, such as lost rows, held
or filtered efforts, spikes and few digits. With `--unusual`, each robot has an unusual effect
beside, such as a spring, ripple, backlash or a pair of coupled rotors.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated.engines import (
    ENGINES,
    Array,
    Generator,
    RobotFile,
    congruent,
    make_engine,
    robot_file,
)
from diagrams.benchmarks.simulated.faults import FAULTS, LATE_BY, spoiled
from diagrams.benchmarks.simulated.motions import EVERYDAY, FINE, POINTS
from diagrams.benchmarks.simulated.recording import (
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
    is_sure_and_wrong,
    median,
    share,
    tell_draws,
)
from diagrams.benchmarks.simulated.truths import (
    DRY,
    HELD,
    LATE,
    OFFSET,
    ROTOR,
    TRUTHS,
    WET,
    WRONG_INERTIA,
    Seen,
    Site,
    scaled,
)
from diagrams.harness import positive_number, run_draws, script_parser
from geodrake.logs import JointLog

ARMS = ("ur3", "ur10", "panda", "so101", "baxter", "tiago", "kinova", "ur5", "z1")
_PARTS = {"baxter": "left_", "tiago": "arm_"}  # how joints are called that are not held
_THIN = ("tiago",)  # whose bodies MuJoCo refuses
# Asymmetric friction is friction with an offset; gains need a known inertia.
_USUAL = (DRY, WET, ROTOR, OFFSET, HELD, LATE, "asymmetric_friction", "effort_scale")
_RATES = (50.0, 100.0, 125.0, 250.0, 500.0)


@dataclass(frozen=True)
class Draw:
    """A robot and the seed of its random conditions."""

    robot: str
    number: int
    seed: int
    duration: float | None = None  # s; drawn if None
    is_spoiled: bool = False  # whether logs have faults
    unusual: str = ""  # name of an effect beside the usual ones


@cache
def arm(name: str) -> RobotFile:
    """Return the file of an arm, with all other joints held."""
    file = robot_file(name)
    if name not in _PARTS:
        return file
    joints = [joint.get("name", "") for joint in ET.fromstring(file.text).iter("joint")]
    return file.holding(f"{name}_arm", [j for j in joints if not j.startswith(_PARTS[name])])


def make_recording(draw: Draw) -> tuple[Recording, dict[str, Any]]:
    """Return the logs of a draw with their truth, and the random conditions."""
    rng, file = np.random.default_rng([draw.seed, draw.number]), arm(draw.robot)
    kind = str(rng.choice(ENGINES)) if draw.robot not in _THIN else "pinocchio"
    engine, model = make_engine(kind, file), file.model
    known = np.asarray(model.effort_limits)
    limits = np.where(np.isfinite(known) & (known > 0.0), known, 50.0)
    off, rate = float(rng.choice((0.0, 0.0, 0.15, 0.3))), float(rng.choice(_RATES))
    off *= draw.unusual != WRONG_INERTIA  # where every body is wrong, none is more so
    bodies = congruent(engine.bodies(), off, rng) if off else engine.bodies()
    mass = 0.0
    if rng.random() >= 0.5:
        mass = rng.uniform(0.04, 0.15) * float(bodies[:, 3, 3].sum())
        bodies[-1] += random_tool(mass, 0.12, 0.06, rng)
    engine.set_bodies(bodies)
    duration = draw.duration or float(rng.choice((20.0, 30.0, 40.0, 60.0)))
    kinds = [str(kind) for kind in rng.choice([*EVERYDAY, POINTS], int(rng.integers(1, 4)))]
    time, pace = np.arange(0.0, duration, 1.0 / FINE), float(rng.choice((0.3, 0.6, 1.0)))
    motions = [Seen.of(engine, kind, time, rng, pace=pace) for kind in kinds]
    sizes = _sizes(Sizes.of(motions, limits), rng)
    hidden = {
        name: tuple(joint for joint, each in zip(engine.joints, own, strict=True) if each)
        for name, own in sizes.items()
        if np.any(own)
    }
    if mass:
        hidden[HELD] = (model.bodies[-1],)
    breakaway, late = float(between((0.003, 0.02), rng)), int(rng.choice((0, 0, 0, 1, 2)))
    dry, wet, rotors, offsets = sizes.values()
    efforts = []
    for seen in motions:
        effort = seen.load + dry * np.tanh(seen.v / breakaway) + wet * seen.v
        effort += rotors * seen.a + offsets
        efforts.append(effort)
    hidden, beside, share = _with_unusual(draw, motions, efforts, hidden, model.bodies)
    efforts = [np.concatenate([e[:1]] * late + [e[: len(e) - late]]) for e in efforts]
    logs, noise = _measured(kinds, motions, efforts, (rate, limits), rng)
    beside |= {LATE: engine.joints} if late else {}
    recording = Recording(logs, hidden, beside, mass)
    drawn = {
        "off": off,
        "share": share,
        "rate": rate,
        "kinds": kinds,
        "noise": noise,
        "late": late / FINE,
    }
    return (_spoiled(recording, draw, limits, drawn) if draw.is_spoiled else recording), drawn


def _with_unusual(
    draw: Draw,
    motions: Sequence[Seen],
    efforts: list[Array],
    hidden: dict[str, tuple[str, ...]],
    bodies: tuple[str, ...],
) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]], float]:
    """Add an unusual effect to efforts; return what is hidden, what is right beside, and its share.

    The share of the deviation of loads is random, from 5 to 20 %.
    """
    if not draw.unusual:
        return hidden, {}, 0.0
    truth, engine = TRUTHS[draw.unusual], motions[0].engine
    seeds = np.random.SeedSequence([draw.seed, draw.number, len(TRUTHS)]).spawn(2)
    rng, numbers = map(np.random.default_rng, seeds)
    joint, other = truth.placed(int(rng.integers(len(engine.joints))), motions[0].load, rng)
    site = Site(joint, other, numbers)
    deviation = np.concatenate([seen.load for seen in motions]).std(0)
    deviation = np.maximum(deviation, 0.1 * deviation.max())
    share = float(between((0.05, 0.2), rng))

    def reached(size: float) -> float:
        law = np.concatenate([truth.law(seen, site, size) for seen in motions])
        return float(np.max(np.sqrt(np.mean(law**2, 0)) / deviation))

    size = scaled(share, reached, truth, close=0.03, tries=10)
    for k, seen in enumerate(motions):
        efforts[k] += truth.law(seen, site, size)
    where = truth.where(site, engine.joints, bodies)
    beside = {name: where for name in truth.companions if name not in hidden}
    places = dict.fromkeys([*hidden.get(draw.unusual, ()), *where])
    return hidden | {draw.unusual: tuple(places)}, beside, share


def _spoiled(recording: Recording, draw: Draw, limits: Array, drawn: dict[str, Any]) -> Recording:
    """Return a recording with the faults of its conditions."""
    rng = np.random.default_rng([draw.seed, draw.number, len(FAULTS)])
    chosen = rng.choice([*FAULTS], int(rng.integers(1, 4)), replace=False)
    drawn["faults"] = faults = tuple(map(str, chosen))
    logs = tuple(spoiled(log, faults, limits, rng) for log in recording.logs)
    late = {LATE: logs[0].joints} if LATE_BY & {*faults} else recording.beside
    return replace(recording, logs=logs, beside=late)


def _sizes(usual: Sizes, rng: Generator) -> dict[str, Array]:
    """Return sizes (n,) of dry and viscous friction, rotors and offsets; 0 where there is none."""
    n = len(usual.range)
    rubs = rng.random(n) < float(rng.choice((0.0, 0.4, 1.0), p=(0.15, 0.25, 0.6)))
    dry, wet = usual.friction(rng)
    rotors = (rng.random() < 0.4) * usual.rotors(rng)
    shifted = (rng.random() < 0.3) & (rng.random(n) < 0.4)
    offsets = shifted * rng.choice((-1.0, 1.0), n) * rng.uniform(0.02, 0.1, n) * usual.range
    return {DRY: rubs * dry, WET: rubs * wet, ROTOR: rotors, OFFSET: offsets}


def _measured(
    kinds: Sequence[str],
    motions: Sequence[Seen],
    efforts: Sequence[Array],
    drive: tuple[float, Array],  # samples a second, limits of efforts (n,)
    rng: Generator,
) -> tuple[tuple[JointLog, ...], float]:
    """Return measured motions and efforts, and their noise as a share of efforts."""
    rate, limits = drive
    gains = 1.0 + float(rng.choice((0.0, 0.01, 0.02))) * rng.normal(size=len(limits))
    noise, memory = float(between((0.004, 0.03), rng)), float(rng.uniform(0.005, 0.03))
    encoder, tacho = float(between((1e-5, 2e-4), rng)), 1e-3 if rng.random() < 0.6 else None
    colour = (lambda rng: memory) if rng.random() < 0.3 else None
    sensors = Sensors(noise, encoder, tacho, 0.005 * limits, colour, gains=gains)
    every = slice(None, None, int(FINE / rate))
    logs = [
        sensors.log(f"{kind} {k + 1}", seen.rows(every), effort[every], rng)
        for k, (kind, seen, effort) in enumerate(zip(kinds, motions, efforts, strict=True))
    ]
    return tuple(logs), noise


def score_draw(draw: Draw) -> dict[str, Any]:
    """Return the row of a draw: its truth, the named effects, and which are right."""
    recording, drawn = make_recording(draw)
    row = {**asdict(draw), **drawn, "hidden": recording.hidden, "mass": recording.mass}
    return row | explained(arm(draw.robot).model, recording, is_off=drawn["off"] > 0.0)


def _is_unusual_named(row: Row) -> bool:
    named = {step["effect"] for step in row["steps"] if step["right"]}
    return row["unusual"] in named and not any(row["unusual"] in words for words in row["missing"])


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Return all report lines."""
    tools = [row for row in rows if row["mass"]]
    found = [row for row in tools if "found_mass" in row]
    seconds = [row["seconds"] for row in rows if not row["failed"]]
    return [
        share("everyday: everything named", [not row["missing"] for row in rows]),
        share("everyday: nothing else named", [not row["wrong"] for row in rows]),
        share("a wrong name at > 0.9", [is_sure_and_wrong(row) for row in rows], most=True),
        share("unusual effect named", [_is_unusual_named(row) for row in rows if row["unusual"]]),
        share("tool named", ["found_mass" in row for row in tools]),
        share("tool's mass inside its interval", [row["mass_inside"] for row in found]),
        median("seconds of CPU, median", seconds),
        *calibration(rows),
    ]


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    number = {"type": positive_number, "metavar": "N"}
    parser.add_argument("--draws", default=len(ARMS), **number, help="draws, arms in turn")
    parser.add_argument("--spoiled", action="store_true", help="logs have faults")
    parser.add_argument("--unusual", action="store_true", help="robots have unusual effects")
    options = parser.parse_args()
    shared = {"seed": options.seed, "is_spoiled": options.spoiled}
    rare = [name for name in TRUTHS if name not in _USUAL] if options.unusual else [""]
    draws = [
        Draw(ARMS[k % len(ARMS)], k, unusual=rare[k % len(rare)], **shared)
        for k in range(options.draws)
    ]
    if options.quick:
        draws = [Draw("ur5", 1, duration=12.0, **shared)]
    rows = run_draws(parser, options, score_draw, draws)
    tell_draws(options, "Everyday logs", lines_of(rows), rows)


if __name__ == "__main__":
    main()
