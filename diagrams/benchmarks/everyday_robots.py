"""Benchmark of everyday logs: what `geodrake explain` says of arms driven as people drive them.

Nine public arms move by periodic Fourier series, moves with trapezoidal speeds, teleoperation, from
point to point, or one joint after the other, in one to three logs of 20 to 60 s. Friction is at
all joints, at some or at none; rotors, offsets of efforts and a tool may be there; gains of efforts
are up to some per cent off, efforts may be late, bodies of the file 15 or 30 % off, and noise white
or coloured. Dynamics are Pinocchio's or MuJoCo's. Told is what of it is named, and what else.

    python -m diagrams.benchmarks.everyday_robots --draws 45 --json everyday.json
"""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from diagrams.benchmarks.hidden.bars import Line, median, share, tell_draws, told
from diagrams.benchmarks.hidden.robots import (
    ENGINES,
    POINTS,
    Engine,
    Motion,
    RobotFile,
    coloured,
    congruent,
    make_engine,
    make_motion,
    motion_range,
    robot_file,
)
from diagrams.benchmarks.ordinary.logs import DRY, ROTOR, WET, Recording, between, random_tool
from diagrams.benchmarks.ordinary_robots import calibration, judged, judged_words
from diagrams.harness import positive_number, run_draws, script_parser, write
from geodrake.diagnosis import explain
from geodrake.errors import GeodrakeError
from geodrake.logs import JointLog

Array = NDArray[np.float64]

ARMS = ("ur3", "ur10", "panda", "so101", "baxter", "tiago", "kinova", "ur5", "z1")
_PARTS = {"baxter": "left_", "tiago": "arm_"}  # how joints are called that are not held
_THIN = ("tiago",)  # whose bodies MuJoCo refuses
_FINE, _RATES = 500.0, (50.0, 100.0, 125.0, 250.0, 500.0)
_SMOOTHED = 0.08  # s, over which a drive rounds off its moves


@dataclass(frozen=True)
class Draw:
    """A robot and what is drawn for it from a seed."""

    robot: str
    number: int
    seed: int
    duration: float | None = None  # s; drawn if None


@cache
def arm(name: str) -> RobotFile:
    """Return the file of an arm, all other joints held."""
    file = robot_file(name)
    if name not in _PARTS:
        return file
    joints = [joint.get("name", "") for joint in ET.fromstring(file.text).iter("joint")]
    held = [joint for joint in joints if not joint.startswith(_PARTS[name])]
    return RobotFile.holding(f"{name}_arm", file, held)


def _derived(q: Array) -> tuple[Array, Array, Array]:
    v = np.gradient(q, 1.0 / _FINE, axis=0)
    return q, v, np.gradient(v, 1.0 / _FINE, axis=0)


def _scaled(q: Array, reach: Array, speed: Array) -> Array:
    v = np.gradient(q, 1.0 / _FINE, axis=0)
    return q / np.maximum(np.abs(q).max(0) / reach, np.abs(v).max(0) / speed)


def _fourier(t: Array, reach: Array, speed: Array, rng: np.random.Generator) -> Array:
    order, base = np.arange(1, 6), rng.uniform(0.08, 0.2)
    sizes = rng.normal(size=(5, len(reach))) / order[:, None]
    phases = rng.uniform(0.0, 2.0 * np.pi, sizes.shape)
    waves = np.sin(2.0 * np.pi * base * t[:, None, None] * order[:, None] + phases)
    return _scaled((sizes * waves).sum(axis=1), reach, speed)


def _trapezoids(t: Array, reach: Array, speed: Array, rng: np.random.Generator) -> Array:
    rows, at = [], np.zeros(len(reach))
    while sum(map(len, rows)) < len(t):
        goal = reach * rng.uniform(-1.0, 1.0, len(reach))
        seconds = max(1.25 * float(np.max(np.abs(goal - at) / speed)), 0.6)
        s = np.linspace(0.0, 1.0, int(seconds * _FINE))
        ramp = np.select(
            [s < 0.2, s > 0.8], [s**2 / 0.32, 1.0 - (1.0 - s) ** 2 / 0.32], (s - 0.1) / 0.8
        )
        rows += [at + (goal - at) * ramp[:, None]]
        rows += [np.tile(goal, (int(rng.uniform(0.0, 1.0) * _FINE), 1))]
        at = goal
    window = np.hanning(int(_SMOOTHED * _FINE) + 2)[1:-1]
    padded = np.pad(np.concatenate(rows)[: len(t)], ((len(window),) * 2, (0, 0)), "edge")
    smooth = [np.convolve(each, window / window.sum(), "same") for each in padded.T]
    return np.stack(smooth, 1)[len(window) : -len(window)]


def _teleoperated(t: Array, reach: Array, speed: Array, rng: np.random.Generator) -> Array:
    low_pass = butter(4, rng.uniform(0.15, 0.5) * 2.0 / _FINE, output="sos")
    wandering = sosfiltfilt(low_pass, rng.normal(size=(len(t) + 2000, len(reach))), axis=0)
    return _scaled(wandering[1000 : 1000 + len(t)], reach, speed)


def _in_turn(t: Array, reach: Array, speed: Array, rng: np.random.Generator) -> Array:
    q, each = np.zeros((len(t), len(reach))), t[-1] / len(reach)
    for joint, size in enumerate(0.8 * reach):
        since = t - joint * each
        moves = (since >= 0.0) & (since < each)
        rate = min(0.7 * speed[joint] / size, 4.0) * rng.uniform(0.5, 1.0)
        bump = np.sin(np.pi * since[moves] / each) ** 2
        q[moves, joint] = size * np.sin(rate * since[moves]) * bump
    return q


MOTIONS: Mapping[str, Callable[[Array, Array, Array, np.random.Generator], Array]] = {
    "Fourier series": _fourier,
    "trapezoids": _trapezoids,
    "teleoperated": _teleoperated,
    "in turn": _in_turn,
}


def _motion(
    kind: str, engine: Engine, t: Array, pace: float, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    if kind == POINTS:
        return make_motion(POINTS, engine, t, rng)
    center, reach, speed = motion_range(engine)
    return _derived(center + MOTIONS[kind](t, reach, pace * speed, rng))


def _with_tool(bodies: Array, rng: np.random.Generator) -> float:
    """Put a tool on the last of bodies (n, 4, 4) in every other case; return its mass or 0, kg."""
    if rng.random() < 0.5:
        return 0.0
    mass = rng.uniform(0.04, 0.15) * float(bodies[:, 3, 3].sum())
    bodies[-1] += random_tool(mass, 0.12, 0.06, rng)
    return mass


def make_recording(draw: Draw) -> tuple[Recording, dict[str, Any]]:
    """Return the logs of a draw with their truth, and the conditions that were drawn."""
    rng, file = np.random.default_rng([draw.seed, draw.number]), arm(draw.robot)
    kind = str(rng.choice(ENGINES)) if draw.robot not in _THIN else "pinocchio"
    engine, model = make_engine(kind, file), file.model
    joints = engine.joints
    known = np.asarray(model.effort_limits)
    limits = np.where(np.isfinite(known) & (known > 0.0), known, 50.0)
    off, rate = float(rng.choice((0.0, 0.0, 0.15, 0.3))), float(rng.choice(_RATES))
    bodies = congruent(engine.bodies(), off, rng) if off else engine.bodies()
    mass = _with_tool(bodies, rng)
    engine.set_bodies(bodies)
    duration = draw.duration or float(rng.choice((20.0, 30.0, 40.0, 60.0)))
    kinds = [str(kind) for kind in rng.choice([*MOTIONS, POINTS], int(rng.integers(1, 4)))]
    time_, pace = np.arange(0.0, duration, 1.0 / _FINE), float(rng.choice((0.3, 0.6, 1.0)))
    motions = [_motion(kind, engine, time_, pace, rng) for kind in kinds]
    loads = [engine.efforts(*motion) for motion in motions]
    sizes = _sizes(motions, loads, limits, rng)
    hidden = {
        name: tuple(joint for joint, each in zip(joints, own, strict=True) if each)
        for name, own in sizes.items()
        if np.any(own)
    }
    if mass:
        hidden["payload"] = (model.bodies[-1],)
    breakaway, late = float(between((0.003, 0.02), rng)), int(rng.choice((0, 0, 0, 1, 2)))
    efforts = []
    for (_, v, a), load in zip(motions, loads, strict=True):
        dry, wet, rotors, offsets = sizes.values()
        effort = load + dry * np.tanh(v / breakaway) + wet * v + rotors * a + offsets
        efforts.append(np.concatenate([effort[:1]] * late + [effort[: len(effort) - late]]))
    logs, noise = _measured(kinds, motions, efforts, (joints, rate, limits), rng)
    recording = Recording(logs, hidden, {"effort_delay": joints} if late else {}, mass, (), {})
    drawn = {"off": off, "rate": rate, "kinds": kinds, "noise": noise, "late": late / _FINE}
    return recording, drawn


def _sizes(
    motions: Sequence[Motion], loads: Sequence[Array], limits: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Return sizes (n,) of dry and viscous friction, rotors and offsets; 0 where there is none.

    They are shares of the largest effort of a joint, or of a tenth of its limit (n,) if that is
    more.
    """
    largest, fastest, hardest = (
        np.max([np.abs(each).max(axis=0) for each in values], axis=0)
        for values in (loads, [v for _, v, _ in motions], [a for _, _, a in motions])
    )
    ranges, n = np.maximum(largest, 0.1 * limits), len(limits)
    rubs = rng.random(n) < float(rng.choice((0.0, 0.4, 1.0), p=(0.15, 0.25, 0.6)))
    dry = rubs * between((0.02, 0.15), rng, n) * ranges
    wet = dry * rng.uniform(0.3, 1.5, n) / fastest
    rotors = (rng.random() < 0.4) * between((0.03, 0.2), rng, n) * ranges / hardest
    shifted = (rng.random() < 0.3) & (rng.random(n) < 0.4)
    offsets = shifted * rng.choice((-1.0, 1.0), n) * rng.uniform(0.02, 0.1, n) * ranges
    return {DRY: dry, WET: wet, ROTOR: rotors, "effort_offset": offsets}


def _measured(
    kinds: Sequence[str],
    motions: Sequence[Motion],
    efforts: Sequence[Array],
    drive: tuple[tuple[str, ...], float, Array],  # joints, samples a second, limits of efforts (n,)
    rng: np.random.Generator,
) -> tuple[tuple[JointLog, ...], float]:
    """Return what sensors make of motions and efforts, and their noise as a share of efforts."""
    joints, rate, limits = drive
    gains = 1.0 + float(rng.choice((0.0, 0.01, 0.02))) * rng.normal(size=len(joints))
    noise, memory = float(between((0.004, 0.03), rng)), float(rng.uniform(0.005, 0.03))
    encoder, has_velocities = float(between((1e-5, 2e-4), rng)), bool(rng.random() < 0.6)
    is_coloured, step, logs = bool(rng.random() < 0.3), int(_FINE / rate), list[JointLog]()
    for k, ((q, v, _), whole) in enumerate(zip(motions, efforts, strict=True)):
        effort, time_ = whole[::step], np.arange(len(q))[::step] / _FINE
        errors = rng.normal(size=effort.shape)
        errors = coloured(errors, float(np.exp(-1.0 / (rate * memory)))) if is_coloured else errors
        size = noise * np.maximum(effort.std(axis=0), 0.005 * limits)
        position = q[::step] + encoder * rng.normal(size=effort.shape)
        velocity = v[::step] + 1e-3 * rng.normal(size=effort.shape) if has_velocities else None
        u = gains * effort + size * errors
        logs.append(JointLog(f"{kinds[k]} {k + 1}", joints, time_, position, u, velocity))
    return tuple(logs), noise


def score_draw(draw: Draw) -> dict[str, Any]:
    """Return a row of the table: the draw, what it hid, what was named, and what of it is right."""
    recording, drawn = make_recording(draw)
    row = {**asdict(draw), **drawn, "hidden": recording.hidden, "mass": recording.mass}
    began = time.process_time()
    try:
        found = explain(arm(draw.robot).model, list(recording.logs))
    except GeodrakeError as error:
        return {**row, "failed": str(error), "steps": [], "missing": ["everything"], "wrong": []}
    row |= {"seconds": time.process_time() - began, "end_nrms": found.end.nrms, "failed": None}
    return {**row, **judged(found.steps, recording, is_off=drawn["off"] > 0.0)}


def lines_of(rows: list[dict[str, Any]]) -> list[Line]:
    """Return all lines."""
    tools = [row for row in rows if row["mass"]]
    found = [row for row in tools if "found_mass" in row]
    sure = [any(s["probability"] > 0.9 and not s["right"] for s in row["steps"]) for row in rows]
    seconds = [row["seconds"] for row in rows if not row["failed"]]
    return [
        share("everyday: everything named", [not row["missing"] for row in rows]),
        share("everyday: nothing else named", [not row["wrong"] for row in rows]),
        share("a wrong name at > 0.9", sure, most=True),
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
    options = parser.parse_args()
    draws = [Draw(ARMS[k % len(ARMS)], k, options.seed) for k in range(options.draws)]
    if options.quick:
        draws = [Draw("ur5", 1, options.seed, duration=12.0)]
    rows = run_draws(parser, options, score_draw, draws)
    lines = lines_of(rows)
    missed = [_words(row) for row in rows if row["missing"] or row["wrong"]]
    tell_draws("Everyday logs", lines, missed, len(rows))
    write(options, {"lines": told(lines), "rows": rows})


def _words(row: Mapping[str, Any]) -> str:
    """Return what went wrong with a draw, in a line."""
    what = f"{row['off']:.0%} off, {row['rate']:.0f} Hz, noise {row['noise']:.1%}"
    what += f", {1e3 * row['late']:.0f} ms late, {row['mass']:.2f} kg, {', '.join(row['kinds'])}"
    text = f"{row['robot']} number {row['number']} ({what}) hides {', '.join(row['hidden'])}"
    return judged_words(text, row)


if __name__ == "__main__":
    main()
