"""One draw: explained by the command line, and compared with what it hides."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from diagrams.benchmarks.floating.draws import DRIVES, FOOT, GAIN, LIMB, PAYLOAD, QUIET, Draw
from diagrams.benchmarks.floating.simulation import Recording, simulate
from diagrams.harness import cpu_clock

Truth = Mapping[str, Sequence[str]]
_DRIVES = ("coulomb_friction", "viscous_friction", "rotor_inertia")


def score_draw(draw: Draw) -> dict[str, Any]:
    """Return a row of the table: the draw, what was named, and what of it is right."""
    with TemporaryDirectory() as folder:
        recording = simulate(draw, Path(folder))
        row = {
            **asdict(draw),
            "secret": asdict(recording.secret),
            "inverse_error": recording.inverse_error,
        }
        compared, row["compare_seconds"], _ = _said("compare", recording, Path(folder))
        told, row["explain_seconds"], error = _said("explain", recording, Path(folder))
    if told is None:
        return {**row, "failed": error, "steps": [], "missing": [draw.hidden], "wrong": []}
    truth = truth_of(draw, recording)
    steps = [_step_row(step, truth) for step in told["steps"]]
    return {
        **row,
        "failed": None,
        "verdict": told["verdict"],
        "compare_notes": [] if compared is None else compared["notes"],
        "notes": told["notes"],
        "steps": steps,
        "missing": _missing(draw, steps, truth),
        "wrong": [_words(step) for step in steps if not step["right"]],
        "start_error": _share(told["error"]["start"], recording.deviations),
        "end_error": _share(told["error"]["end"], recording.deviations),
        **_payload_row(draw, steps, recording),
    }


def _said(
    command: str, recording: Recording, folder: Path
) -> tuple[dict[str, Any] | None, float, str]:
    """Return what a command writes as JSON, None where it fails; its CPU time, and its error."""
    path = folder / f"{command}.json"
    began = cpu_clock()
    run = subprocess.run(
        [
            *(sys.executable, "-m", "geodrake", command, str(recording.model)),
            *(*map(str, recording.logs), "--floating", "--json", str(path), "-q"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = cpu_clock() - began
    if run.returncode or not path.exists():
        return None, seconds, (run.stderr.strip() or f"exit code {run.returncode}")
    return json.loads(path.read_text(encoding="utf-8")), seconds, ""


def truth_of(draw: Draw, recording: Recording) -> Truth:
    """Return the names that are right, with the places where they are."""
    secret = recording.secret
    match draw.hidden:
        case s if s == PAYLOAD:
            return {"payload": recording.same}
        case s if s == LIMB:
            return {"wrong_inertia": (secret.limb,), "payload": (secret.limb,)}
        case s if s == DRIVES:
            return dict.fromkeys(_DRIVES, tuple(recording.deviations))
        case s if s == GAIN and secret.gain is not None:
            return {"effort_scale": (secret.gain[0],)}
        case s if s == FOOT and secret.offset is not None:
            return {"wrench_offset": (secret.offset[0],)}
    return {}


def _step_row(step: Mapping[str, Any], truth: Truth) -> dict[str, Any]:
    wanted = ("effect", "where", "probability", "parameters", "deviations", "systematic")
    right = step["effect"] in truth and set(step["where"]) <= set(truth[step["effect"]])
    return {
        **{name: step[name] for name in wanted},
        "rivals": step["indistinguishable_from"],
        "right": right,
    }


def _words(step: Mapping[str, Any]) -> str:
    return f"{step['effect']} at {', '.join(step['where'])} ({step['probability']:.3f})"


def _missing(draw: Draw, steps: Sequence[Mapping[str, Any]], truth: Truth) -> list[str]:
    """Return what no step has: of friction and rotors place by place, of others any place."""
    found = {(step["effect"], place) for step in steps for place in step["where"]}
    if draw.hidden == DRIVES:
        wanted = [(name, place) for name, places in truth.items() for place in places]
        return [f"{name} at {place}" for name, place in wanted if (name, place) not in found]
    named = any(step["right"] for step in steps)
    return [] if named or draw.hidden == QUIET else [draw.hidden]


def _share(errors: Mapping[str, float], deviations: Mapping[str, float]) -> float | None:
    """Return the root mean square over joints of held-out errors over deviations of efforts."""
    squares = [(errors[joint] / deviations[joint]) ** 2 for joint in deviations if joint in errors]
    return math.sqrt(sum(squares) / len(squares)) if squares else None


def _payload_row(
    draw: Draw, steps: Sequence[Mapping[str, Any]], recording: Recording
) -> dict[str, Any]:
    """Return the payload's mass as found, and whether the truth is in its interval."""
    found = [step for step in steps if step["effect"] == "payload" and step["right"]]
    if draw.hidden != PAYLOAD or not found:
        return {}
    step, mass = found[-1], recording.secret.mass
    (place, *_) = step["where"]
    said = step["parameters"][place]["mass"]
    systematic = step["systematic"].get(place, {}).get("mass", 0.0)
    half = 2.0 * math.hypot(step["deviations"][place]["mass"], systematic)
    return {
        "found_mass": said,
        "mass_half_width": half / mass,
        "mass_inside": abs(said - mass) <= half,
        "mass_error": abs(said - mass) / mass,
    }


def is_missed(row: Mapping[str, Any]) -> bool:
    """Return whether anything is missing, or named and wrong."""
    return bool(row["failed"] or row["missing"] or row["wrong"])


def miss_words(row: Mapping[str, Any]) -> str:
    """Return what went wrong with a draw, in a line."""
    logged = [name for name in ("wrenches", "efforts") if row[name]]
    text = (
        f"seed {row['seed']} number {row['number']} {row['robot']} (contacts {row['contacts']}, "
        f"with {' and '.join(logged) or 'neither'}) hides {row['hidden']}"
    )
    if row["failed"]:
        return f"{text}; FAILED: {row['failed']}"
    for title, what in (("MISSING", row["missing"]), ("WRONG", row["wrong"])):
        text += f"; {title}: {', '.join(what)}" if what else ""
    right = "; ".join(_words(step) for step in row["steps"] if step["right"])
    return f"{text}; right: {right or 'nothing'}"
