"""Benchmark of floating bases: what `geodrake explain` says of quadrupeds and a humanoid.

MuJoCo makes two logs each of robots that sway on planted feet or trot in place, with noise of
encoders, IMU, efforts and the estimate of the base. Hidden is a payload on the trunk, a link
heavier than its file says, friction and rotors at all joints, a wrong gain of a joint's effort, an
offset of a foot's sensor, or nothing. Contacts are logged, logged with errors, or missing;
wrenches of the feet and efforts of the joints are logged or missing.

    python -m diagrams.benchmarks.floating_robots --json floating.json
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from diagrams.benchmarks.simulated import legged, truths
from diagrams.benchmarks.simulated.scoring import (
    Line,
    Places,
    Row,
    calibration,
    judged,
    median,
    not_found,
    share,
    step_row,
    tell_draws,
)
from diagrams.harness import cpu_clock, positive_number, run_draws, script_parser
from geodrake.model.ground_contacts import contact_frames
from geodrake.model.robot_model import load_description


def score_draw(draw: legged.Draw) -> dict[str, Any]:
    """Return the row of a draw: the named effects, and which are right."""
    with TemporaryDirectory() as folder:
        recording = legged.simulate(draw, Path(folder))
        row = {
            **asdict(draw),
            "secret": asdict(recording.secret),
            "inverse_error": recording.inverse_error,
        }
        truth = truth_of(draw, recording)
        compared, row["compare_seconds"], _ = _said("compare", recording, Path(folder))
        told, row["explain_seconds"], error = _said("explain", recording, Path(folder))
    if told is None:
        return {**row, "failed": error, "steps": [], "missing": [draw.hidden], "wrong": []}
    steps = [step_row(step, truth) for step in told["steps"]]
    missing = [draw.hidden]  # until it is named at any place; friction and rotors at every one
    if draw.hidden == legged.DRIVES:
        missing = not_found(steps, truth)
    elif draw.hidden == legged.QUIET or any(step["right"] for step in steps):
        missing = []
    held_by = truth[truths.HELD] if draw.hidden == legged.PAYLOAD else ()
    return {
        **row,
        "failed": None,
        "verdict": told["verdict"],
        "compare_notes": [] if compared is None else compared["notes"],
        "compared": None if compared is None else _of_deviations(compared, recording.deviations),
        "notes": told["notes"],
        "start_error": _share(told["error"]["start"], recording.deviations),
        "end_error": _share(told["error"]["end"], recording.deviations),
        **judged(steps, missing, held_by, recording.secret.mass),
    }


def _said(
    command: str, recording: legged.Recording, folder: Path
) -> tuple[dict[str, Any] | None, float, str]:
    """Return a command's JSON (None if it fails), its CPU time, and its error."""
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


def truth_of(draw: legged.Draw, recording: legged.Recording) -> Places:
    """Return the right names with their places."""
    secret = recording.secret
    if draw.hidden == legged.FOOT and secret.offset is not None:
        model = load_description(recording.model, floating=True)
        return {"wrench_offset": (contact_frames(model, secret.offset[:1])[0].body,)}
    joints, gained = tuple(recording.deviations), (secret.gain or ("",))[:1]
    return {
        legged.PAYLOAD: {truths.HELD: recording.same},
        legged.LIMB: {truths.WRONG_INERTIA: (secret.limb,), truths.HELD: (secret.limb,)},
        legged.DRIVES: dict.fromkeys((truths.DRY, truths.WET, truths.ROTOR), joints),
        legged.GAIN: {"effort_scale": gained},
    }.get(draw.hidden, {})


def _share(errors: Mapping[str, float], deviations: Mapping[str, float]) -> float | None:
    """Return the RMS over joints of held-out errors, relative to deviations of efforts."""
    squares = [(errors[joint] / deviations[joint]) ** 2 for joint in deviations if joint in errors]
    return math.sqrt(sum(squares) / len(squares)) if squares else None


def _of_deviations(compared: Mapping[str, Any], joints: Collection[str]) -> float | None:
    """Return the RMS over joints of errors, relative to deviations in the same rows.

    Where forces at feet are unknown, these are the rows of limbs in the air.
    """
    squares = [of["nrms"] ** 2 for joint, of in compared["joints"].items() if joint in joints]
    return math.sqrt(sum(squares) / len(squares)) if squares else None


_EXACT = 1e-9


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Return all report lines."""
    hiding = [row for row in rows if row["hidden"] != legged.QUIET]
    quiet = [row for row in rows if row["hidden"] == legged.QUIET]
    loads = [row for row in rows if row["hidden"] == legged.PAYLOAD]
    found = [row for row in loads if "found_mass" in row]
    told = [row for row in rows if not row["failed"] and row["end_error"] is not None]
    measured = [row["end_error"] for row in told if row["wrenches"]]
    unknown = [row["end_error"] for row in told if not row["wrenches"]]
    exact = [row["compared"] for row in quiet if not row["wrenches"] and row.get("compared")]
    return [
        share(
            "efforts agree with inverse dynamics", [r["inverse_error"] < _EXACT for r in rows], 1.0
        ),
        share("read and explained", [not row["failed"] for row in rows], 1.0),
        share("truth named and placed", [_is_named(row) for row in hiding], 0.9),
        share("… and nothing else", [_is_named(row) and not row["wrong"] for row in hiding]),
        *(
            share(f"{hidden} named", [_is_named(row) for row in hiding if row["hidden"] == hidden])
            for hidden in (legged.LIMB, legged.GAIN, legged.FOOT)
        ),
        *(
            share(f"places of {legged.DRIVES}, {words}", _places_named(hiding, biped=biped))
            for words, biped in (("quadrupeds", False), ("a humanoid", True))
        ),
        share("payload named", ["found_mass" in row for row in loads]),
        share("… mass inside its interval", [row["mass_inside"] for row in found], 0.9),
        share("… mass within 5 %", [row["mass_error"] <= 0.05 for row in found], 0.9),
        share("nothing hidden: something named", [bool(r["steps"]) for r in quiet], 0.0, most=True),
        median("held-out joint error, unknown wrenches", unknown, 0.2),
        median("held-out joint error, measured wrenches", measured, 0.1),
        median("exact models, over deviations of limbs in the air", exact),
        median("seconds of CPU of compare", [row["compare_seconds"] for row in told], 5.0),
        median("seconds of CPU of explain", [row["explain_seconds"] for row in told], 30.0),
        *calibration(rows),
    ]


def _places_named(rows: Sequence[Row], *, biped: bool) -> list[bool]:
    """Return whether friction and rotor of each joint are named."""
    drives = [row for row in rows if row["hidden"] == legged.DRIVES and not row["failed"]]
    drives = [row for row in drives if (row["robot"] == "talos") == biped]
    named = sum(len(step["where"]) for row in drives for step in row["steps"] if step["right"])
    return [True] * named + [False] * sum(len(row["missing"]) for row in drives)


def _is_named(row: Row) -> bool:
    return not (row["failed"] or row["missing"])


def quick_draws(seed: int) -> list[legged.Draw]:
    """Return short logs of the smallest robot, with and without a payload."""
    short = {"contacts": legged.FLAGS, "wrenches": True, "duration": 4.0, "seed": seed}
    return [
        legged.Draw("a1", legged.PAYLOAD, motions=(legged.SWAY,), number=0, **short),  # type: ignore[arg-type]
        legged.Draw("a1", legged.QUIET, motions=(legged.TROT,), number=1, **short),  # type: ignore[arg-type]
    ]


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--most", type=positive_number, metavar="N", help="only the first N draws")
    options = parser.parse_args()
    wanted = (
        quick_draws(options.seed)
        if options.quick
        else legged.all_draws(options.seed)[: options.most]
    )
    rows = run_draws(parser, options, score_draw, wanted)
    tell_draws(options, "Floating bases", lines_of(rows), rows)


if __name__ == "__main__":
    main()
