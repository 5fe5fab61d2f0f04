"""Benchmark of ordinary robots: what `geodrake explain` says of arms as they are.

Pinocchio or MuJoCo make two logs each of four public arms with friction at every joint, often
rotors at every joint and a tool, and a model file that is exact, or 15 or 30 % off; with 50 to
500 samples a second, with velocities or without. Other robots have an effect of no catalogue, for
which every name is wrong, or hide nothing. Told are whether everything is named and nothing else,
the tool's mass with its interval, the processor's seconds, and the calibration: of all that is said
with a probability, how much is true.

    python -m diagrams.benchmarks.ordinary_robots --seeds 10 --json ordinary.json
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from diagrams.benchmarks.hidden.bars import Line, share, tell_draws, told
from diagrams.benchmarks.hidden.robots import robot_model
from diagrams.benchmarks.ordinary.logs import (
    COLOURS,
    ORDINARY,
    OUTSIDE,
    QUIET,
    TOOL,
    Draw,
    Recording,
    all_draws,
    draw,
    make_recording,
)
from diagrams.harness import positive_number, run_draws, script_parser, write
from geodrake.diagnosis import Step, explain
from geodrake.errors import GeodrakeError

WRONG_INERTIA = "wrong_inertia"


def score_draw(draw: Draw) -> dict[str, Any]:
    """Return a row of the table: the draw, what it hid, what was named, and what of it is right."""
    recording = make_recording(draw)
    row = {**asdict(draw), "hidden": recording.hidden, "beside": recording.beside}
    row |= {"mass": recording.mass, "joints": recording.joints, "values": recording.values}
    model = robot_model(draw.robot)
    began = time.process_time()
    try:
        explanation = explain(model, list(recording.logs))
    except GeodrakeError as error:
        return {**row, "failed": str(error), "steps": [], "missing": ["everything"], "wrong": []}
    seconds = time.process_time() - began
    return {
        **row,
        "failed": None,
        "seconds": seconds,
        "verdict": explanation.verdict,
        "start_nrms": explanation.start.nrms,
        "end_nrms": explanation.end.nrms,
        "notes": list(explanation.notes),
        **judged(explanation.steps, recording, is_off=draw.off > 0.0),
    }


def judged(steps: Sequence[Step], recording: Recording, *, is_off: bool) -> dict[str, Any]:
    """Return rows of steps, what is missing and wrong among them, and the tool's mass.

    Where bodies of the file are off (`is_off`), wrong inertias are right.
    """
    rows = [_step_row(step, recording, is_off=is_off) for step in steps]
    return {
        "steps": rows,
        "missing": _missing(steps, recording.hidden),
        "wrong": [step_words(row) for row in rows if not row["right"]],
        **_tool_row(steps, recording),
    }


def _step_row(step: Step, recording: Recording, *, is_off: bool) -> dict[str, Any]:
    truth: Mapping[str, Sequence[str]] = {**recording.beside, **recording.hidden}
    right = step.effect in truth and set(step.where) <= set(truth[step.effect])
    return {
        "effect": step.effect,
        "where": list(step.where),
        "probability": float(step.probability),
        "rivals": list(step.indistinguishable_from),
        "parameters": {place: dict(values) for place, values in step.parameters.items()},
        "right": right or (step.effect == WRONG_INERTIA and is_off),
    }


def step_words(step: Mapping[str, Any]) -> str:
    """Return a step in writing."""
    return f"{step['effect']} at {', '.join(step['where'])} ({step['probability']:.3f})"


def _missing(steps: Sequence[Step], hidden: Mapping[str, Sequence[str]]) -> list[str]:
    """Return what no step has, place by place."""
    return not_found({(step.effect, place) for step in steps for place in step.where}, hidden)


def not_found(found: set[tuple[str, str]], wanted: Mapping[str, Sequence[str]]) -> list[str]:
    """Return wanted effects at places at which they were not found."""
    at = [(name, place) for name, places in wanted.items() for place in places]
    return [f"{name} at {place}" for name, place in at if (name, place) not in found]


def _tool_row(steps: Sequence[Step], recording: Recording) -> dict[str, Any]:
    """The tool's mass as found, and how well it is said to be known; nothing without a tool."""
    (body,) = recording.hidden.get(TOOL, (None,))
    found = [step for step in steps if step.effect == TOOL and body in step.where]
    if body is None or not found:
        return {}
    step = found[-1]
    systematic = step.systematic.get(body, {}).get("mass", 0.0)
    return mass_row(
        step.parameters[body]["mass"], (step.deviations[body]["mass"], systematic), recording.mass
    )


def mass_row(found: float, deviations: tuple[float, float], truth: float) -> dict[str, Any]:
    """Return a mass as found, with deviations of noise and of what is systematic, and the truth."""
    half = 2.0 * float(np.hypot(*deviations))
    return {
        "found_mass": found,
        "mass_deviation": deviations[0],
        "mass_systematic": deviations[1],
        "mass_inside": bool(abs(found - truth) <= half),
        "mass_half_width": half / truth,
        "mass_error": abs(found - truth) / truth,
    }


def is_missed(row: Mapping[str, Any]) -> bool:
    """Return whether a name is wrong or, of an ordinary robot, something is missing."""
    return bool(row["wrong"] or row["failed"] or (row["missing"] and row["case"] == ORDINARY))


def miss_words(row: Mapping[str, Any]) -> str:
    """Return what went wrong with a draw, in a line."""
    what = [f"{row['off']:.0%} off", f"{row['rate']:.0f} Hz", f"noise {row['noise']:.1%}"]
    what += [row["colour"]] if row["colour"] != "white" else []
    what += [name for name in ("velocities", "quantised", "calibrated") if row[name]]
    what += [f"tool {row['mass']:.2f} kg"] if row["mass"] else []
    hides = [*row["hidden"], *([f"{row['kind']} at {row['joints']}"] if row["kind"] else [])]
    if "breakaway" in row["values"]:
        what.append(f"breakaway {row['values']['breakaway'][0]:.3f} rad/s")
    text = (
        f"{row['case']} seed {row['seed']} number {row['number']} {row['robot']} {row['engine']} "
        f"({', '.join(what)}) hides {', '.join(hides) or 'nothing'}"
    )
    text = judged_words(text, row)
    if row["failed"]:
        return text
    return f"{text}; nrms {row['start_nrms']:.3g} → {row['end_nrms']:.3g}, {row['seconds']:.1f} s"


def judged_words(text: str, row: Mapping[str, Any]) -> str:
    """Return what was missed, and what was right, behind what it is about."""
    if row["failed"]:
        return f"{text}; FAILED: {row['failed']}"
    for title in ("missing", "wrong"):
        text += f"; {title.upper()}: {', '.join(row[title])}" if row[title] else ""
    right = "; ".join(step_words(step) for step in row["steps"] if step["right"])
    return f"{text}; right: {right or 'nothing'}"


Row = Mapping[str, Any]
BINS = ((0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.0))
SURE = 0.9


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Return all lines."""
    ordinary = [row for row in rows if row["case"] == ORDINARY]
    outside = [row for row in rows if row["case"] == OUTSIDE]
    tools = [row for row in ordinary if row["mass"]]
    found = [row for row in tools if "found_mass" in row]
    seconds = [row["seconds"] for row in ordinary if not row["failed"]]
    said = [row for row in found if row["calibrated"]]
    widths = [row["mass_half_width"] for row in found]
    return [
        share("ordinary: everything named", [not row["missing"] for row in ordinary], 0.95),
        share("ordinary: nothing else named", [_is_clean(row) for row in ordinary], 0.95),
        share("… both", [not row["missing"] and _is_clean(row) for row in ordinary], 0.95),
        share("tool named", ["found_mass" in row for row in tools], 0.98),
        share(
            "tool's mass inside its interval",
            [row["mass_inside"] for row in found],
            0.9,
            highest=0.98,
        ),
        share("… of calibrated efforts", [row["mass_inside"] for row in said]),
        *_quantiles("half width of a tool's mass", widths, 0.15),
        *_quantiles("… calibrated", [row["mass_half_width"] for row in said], 0.15),
        *_quantiles("error of a tool's mass", [row["mass_error"] for row in found], None),
        *_quantiles("seconds of CPU", seconds, 5.0),
        share(
            "no catalogue has it: a wrong name at > 0.9",
            [_is_sure_and_wrong(row) for row in outside],
            0.1,
            most=True,
        ),
        share("… a wrong name at all", [not _is_clean(row) for row in outside], most=True),
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


def calibration(rows: Sequence[Row]) -> list[Line]:
    """Return how many of the things said with a probability in a bin are true."""
    steps = [step for row in rows for step in row["steps"]]
    bars = {(0.9, 0.99): {"bar": 0.85, "highest": 0.99}}
    return [
        share(
            f"said at {low:g} – {high:g}: true" if high < 1.0 else f"said at > {low:g}: true",
            [step["right"] for step in steps if low < step["probability"] <= high],
            **bars.get((low, high), {}),
        )
        for low, high in BINS
    ]


def _is_clean(row: Row) -> bool:
    return not (row["wrong"] or row["failed"])


def _is_sure_and_wrong(row: Row) -> bool:
    return any(step["probability"] > SURE and not step["right"] for step in row["steps"])


def _quantiles(figure: str, values: Sequence[float], bar: float | None) -> list[Line]:
    """Return the median, which the bar is for, and what nine of ten are below."""
    levels = (("median", 0.5, bar), ("90 %", 0.9, None))
    return [
        Line(
            f"{figure}, {name}",
            most,
            True,
            float(np.quantile(values, level)) if values else None,
            *((min(values), max(values)) if values else (None, None)),
            len(values),
        )
        for name, level, most in levels
    ]


def quick_draws(seed: int) -> list[Draw]:
    """Return a short draw of every case, of the arm that moves fastest."""
    short = {"duration": 10.0, "rate": 100.0, "velocities": True, "noise": 0.005}
    return [
        draw(ORDINARY, "ur5", 0, seed, **short, tool=0.1, off=0.0, rotors=False),
        draw(OUTSIDE, "ur5", 0, seed, **short, kind="pendulum in a link"),
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
    lines = lines_of(rows)
    missed = [miss_words(row) for row in rows if is_missed(row)]
    tell_draws("Ordinary robots", lines, missed, len(rows))
    write(options, {"lines": told(lines), "rows": rows})


if __name__ == "__main__":
    main()
