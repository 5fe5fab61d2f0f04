"""One draw: explained as `geodrake explain` does, and compared with what it hides."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from diagrams.benchmarks.hidden.robots import robot_model
from diagrams.benchmarks.ordinary.draws import ORDINARY, Draw
from diagrams.benchmarks.ordinary.logs import TOOL, Recording, make_recording
from geodrake.diagnosis import Step, explain
from geodrake.errors import GeodrakeError

WRONG_INERTIA = "wrong_inertia"


def score_draw(draw: Draw) -> dict[str, Any]:
    """A row of the table: the draw, what it hid, what was named, and what of it is right."""
    return score(draw, make_recording(draw))


def score(draw: Draw, recording: Recording) -> dict[str, Any]:
    """The same of a recording that was made."""
    row = {**asdict(draw), "hidden": recording.hidden, "beside": recording.beside}
    row |= {"mass": recording.mass, "joints": recording.joints, "values": recording.values}
    model = robot_model(draw.robot)
    began = time.process_time()
    try:
        explanation = explain(model, list(recording.logs))
    except GeodrakeError as error:
        return {**row, "failed": str(error), "steps": [], "missing": ["everything"], "wrong": []}
    seconds = time.process_time() - began
    steps = [_step_row(step, draw, recording) for step in explanation.steps]
    return {
        **row,
        "failed": None,
        "seconds": seconds,
        "verdict": explanation.verdict,
        "start_nrms": explanation.start.nrms,
        "end_nrms": explanation.end.nrms,
        "notes": list(explanation.notes),
        "steps": steps,
        "missing": _missing(explanation.steps, recording.hidden),
        "wrong": [_words(step) for step in steps if not step["right"]],
        **_tool_row(explanation.steps, recording),
    }


def _step_row(step: Step, draw: Draw, recording: Recording) -> dict[str, Any]:
    truth: Mapping[str, Sequence[str]] = {**recording.beside, **recording.hidden}
    right = step.effect in truth and set(step.where) <= set(truth[step.effect])
    return {
        "effect": step.effect,
        "where": list(step.where),
        "probability": float(step.probability),
        "rivals": list(step.indistinguishable_from),
        "parameters": {place: dict(values) for place, values in step.parameters.items()},
        "right": right or (step.effect == WRONG_INERTIA and draw.off > 0.0),
    }


def _words(step: Mapping[str, Any]) -> str:
    return f"{step['effect']} at {', '.join(step['where'])} ({step['probability']:.3f})"


def _missing(steps: Sequence[Step], hidden: Mapping[str, Sequence[str]]) -> list[str]:
    """What no step has, place by place."""
    found = {(step.effect, place) for step in steps for place in step.where}
    return [
        f"{name} at {place}"
        for name, places in hidden.items()
        for place in places
        if (name, place) not in found
    ]


def _tool_row(steps: Sequence[Step], recording: Recording) -> dict[str, Any]:
    """The tool's mass as found, and how well it is said to be known; nothing without a tool."""
    (body,) = recording.hidden.get(TOOL, (None,))
    found = [step for step in steps if step.effect == TOOL and body in step.where]
    if body is None or not found:
        return {}
    step = found[-1]
    deviation = step.deviations[body]["mass"]
    systematic = step.systematic.get(body, {}).get("mass", 0.0)
    off = abs(step.parameters[body]["mass"] - recording.mass)
    half = 2.0 * float(np.hypot(deviation, systematic))
    return {
        "found_mass": step.parameters[body]["mass"],
        "mass_deviation": deviation,
        "mass_systematic": systematic,
        "mass_inside": bool(off <= half),
        "mass_half_width": half / recording.mass,
        "mass_error": off / recording.mass,
    }


def is_missed(row: Mapping[str, Any]) -> bool:
    """Whether a name is wrong or, of an ordinary robot, something is missing."""
    return bool(row["wrong"] or row["failed"] or (row["missing"] and row["case"] == ORDINARY))


def miss_words(row: Mapping[str, Any]) -> str:
    """What went wrong with a draw, in a line."""
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
    if row["failed"]:
        return f"{text}; FAILED: {row['failed']}"
    if row["missing"]:
        text += f"; MISSING: {', '.join(row['missing'])}"
    if row["wrong"]:
        text += f"; WRONG: {'; '.join(row['wrong'])}"
    if row["case"] == ORDINARY or row["steps"]:
        named = "; ".join(_words(step) for step in row["steps"] if step["right"])
        text += f"; right: {named or 'nothing'}"
    return f"{text}; nrms {row['start_nrms']:.3g} → {row['end_nrms']:.3g}, {row['seconds']:.1f} s"
