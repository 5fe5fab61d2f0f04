"""What geodrake finds on public measurements of real robots, with the errors before and after.

The measurements are not part of the project. Without them the script says where they go.

    python -m diagrams.benchmarks.real_robots --json real_robots.json
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.harness import script_parser, show, show_values, write
from diagrams.public_data import add_folder_option, require
from geodrake import load_model, save_model
from geodrake.diagnosis import Candidate, Explanation, Step, add, compare, diagnose, explain
from geodrake.logs.files import Reading, read_log
from geodrake.logs.files.reading import ColumnMapping, MappedColumn
from geodrake.logs.motion import JointLog
from geodrake.model import RobotModel
from geodrake.model.logged_joints import reading_for

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Study:
    """One call of `explain`."""

    name: str  # name of the study, and of the model it saves for later ones
    model: str  # model file below `reference` or the checkout's `models`; or the name of a study
    logs: tuple[str, ...]
    blocks: int | None = None  # blocks into which a log is cut, None for the default
    mapping: ColumnMapping | None = None

    def read(self, model: RobotModel, shared: Path) -> list[JointLog]:
        """Return the logs for a model."""
        reading, joints = reading_for(model, Reading(mapping=self.mapping)), model.known_joints
        paths = [shared / "data" / log for log in self.logs]
        return [read_log(path, joints=joints, partial=True, reading=reading) for path in paths]


PENDULUM = tuple(f"double_pendulum_c1_{run}.csv" for run in (143339, 143524, 143601, 143704))
ACROMONK = ColumnMapping(
    {
        "virtul_joint_hook_1": {
            "position": MappedColumn("shoulder_meas_pos"),
            "effort": MappedColumn("passive"),
        },
        "joint_1": {
            "position": MappedColumn("elbow_meas_pos"),
            "effort": MappedColumn("elbow_meas_tau"),
        },
    },
    time=MappedColumn("meas_time"),
)
BRACHIATIONS = "acromonk/raw_FB_pd_1x_.csv", "acromonk/raw_ZB_tvlqr_1x.csv"
STUDIES = (
    Study("ur10e free", "ur10e.urdf", ("ur10e_free_a.csv", "ur10e_free_b.csv")),
    Study("ur10e again", "ur10e free", ("ur10e_free_c.csv",)),
    Study("ur10e changed", "ur10e free", ("ur10e_changed.csv",)),
    Study("ur10e another day", "ur10e free", ("ur10e_free_d.csv",)),
    Study("ur10e with 2.805 kg", "ur10e free", ("ur10e_load_d.csv",)),
    Study("ur10e point to point", "ur10e free", ("ur10e_ptp.csv",)),
    Study("tx40", "tx40.urdf", ("tx40.csv",), blocks=6),
    Study("emps", "emps_70kg.urdf", ("emps.csv",)),
    Study("lwr4", "lwr4.urdf", tuple(f"lwr4_{run}.csv" for run in (1, 2, 3))),
    Study("kr300", "kr300.urdf", tuple(f"kr300_{run}.csv" for run in "abc")),
    Study("acromonk", "acromonk.urdf", BRACHIATIONS, mapping=ACROMONK),
    Study("double pendulum", "double_pendulum.urdf", PENDULUM),
)
QUICK = (Study("double pendulum", "double_pendulum.urdf", PENDULUM[:2]),)
DAYS = "ur10e.urdf", tuple(f"ur10e_free_{day}.csv" for day in "abcd")
"""A robot on several days, on which nothing was changed."""
QUICK_DAYS = "double_pendulum.urdf", PENDULUM[:3]
QUICK_PAIRS = (PENDULUM[0:3:2],)
MEASUREMENTS = (
    *(f"reference/{name}.urdf" for name in ("ur10e", "tx40", "emps_70kg", "lwr4", "kr300")),
    *(f"data/{log}" for study in STUDIES[:-1] for log in study.logs),
    "data/double_pendulum_c1_*.csv",
)
ELSEWHERE = {"ur10e free": ("ur10e_free_c.csv", "ur10e_ptp.csv")}
"""Logs that took no part in a study, on which every one of its steps is to hold."""


def model_file(name: str, shared: Path) -> Path | None:
    """Return a model file of the checkout or of the references, None if there is none."""
    places = (ROOT / "models", shared / "reference", shared / "data" / Path(name).stem)
    places = tuple(folder / name for folder in places)
    return next((path for path in places if path.is_file()), None)


def run(study: Study, *, shared: Path, saved: Path) -> Explanation:
    """Explain the logs of one study and save its model for later ones."""
    path = model_file(study.model, shared) or saved / f"{study.model}.yaml"
    model = load_model(path)
    explanation = explain(model, study.read(model, shared), blocks=study.blocks)
    save_model(explanation.model, saved / f"{study.name}.yaml")
    return explanation


def named_afterwards(study: Study, *, shared: Path, saved: Path) -> list[str]:
    """Return what `diagnose` names on a study's logs with the model that `run` saved."""
    model = load_model(saved / f"{study.name}.yaml")
    found = diagnose(model, study.read(model, shared), blocks=study.blocks)
    return [placed(each) for each in found.candidates]


def placed(found: Candidate | Step) -> str:
    """Return an effect and its place."""
    return f"{found.effect} at {', '.join(found.where)}" if found.where else found.effect


def pairs_of_days(
    model: str, logs: Sequence[str], shared: Path, pairs: Sequence[Sequence[str]] | None = None
) -> list[dict[str, Any]]:
    """Return steps on each log with the model of another, and the nrms of the rest with them."""
    paths, file = {log: shared / "data" / log for log in logs}, model_file(model, shared)
    pairs = pairs or tuple(permutations(logs, 2))
    fits = {
        log: explain(load_model(file), [paths[log]]).model for log in {pair[0] for pair in pairs}
    }
    rows = []
    for fit, test in pairs:
        found = explain(fits[fit], [paths[test]])
        third = {
            log: [compare(m, [paths[log]]).errors.nrms for m in (fits[fit], found.model)]
            for log in logs
            if found.steps and log not in (fit, test)
        }
        steps = [placed(step) for step in found.steps]
        rows.append({"fit": fit, "test": test, "steps": steps, "third": third})
    return rows


def left_out(
    study: Study, explanation: Explanation, shared: Path
) -> list[tuple[str, dict[str, float]]]:
    """Return the nrms on logs that were not used, without each step of a study.

    Returns:
        "as found", "none", and each effect left out of a fit of all others, with the nrms by log.
    """

    def errors(model: RobotModel) -> dict[str, float]:
        paths = {name: shared / "data" / name for name in ELSEWHERE[study.name]}
        return {name: compare(model, [path]).errors.nrms for name, path in paths.items()}

    logs = [shared / "data" / log for log in study.logs]
    found = [("as found", errors(explanation.model))]
    for out in (None, *explanation.steps):
        model = load_model(shared / "reference" / study.model)
        for step in explanation.steps:
            if step is not out:
                where = step.where or None
                model = add(step.effect, model, logs, where=where, blocks=study.blocks).model
        found.append(("none" if out is None else out.effect, errors(model)))
    return found


def rows_of(study: Study, explanation: Explanation, seconds: float) -> list[dict[str, Any]]:
    """Return a row for each step of a study, the first for the model as it is.

    "nrms" is the held-out error over the effort's deviation, "pooled_rms" that of all joints, N·m.
    """
    start = explanation.start
    found: list[dict[str, Any]] = [
        {"step": "as it stands", "where": (), "nrms": start.nrms, "pooled_rms": start.pooled_rms}
        | {"parameters": {}, "deviations": {}}
    ]
    found += [
        {
            "step": step.effect,
            "where": step.where,
            "nrms": step.error_after,
            "pooled_rms": float(np.sqrt(np.mean(np.square(list(step.rms_after.values()))))),
            "parameters": step.parameters,
            "deviations": _total_deviations(step),
        }
        for step in explanation.steps
    ]
    whole = {"study": study.name, "verdict": explanation.verdict, "seconds": seconds}
    return [{**whole, **row, "floor_nrms": explanation.end.floor_nrms} for row in found]


def _total_deviations(step: Step) -> dict[str, dict[str, float]]:
    """Return deviations of a step's parameters by noise, gains and unexplained errors together."""
    return {
        place: {
            name: float(np.hypot(noise, step.systematic.get(place, {}).get(name, 0.0)))
            for name, noise in own.items()
        }
        for place, own in step.deviations.items()
    }


def main() -> None:
    """Run the studies from the command line."""
    parser = script_parser(__doc__, "only the double pendulum, some runs")
    add_folder_option(parser)
    options = parser.parse_args()
    rows, elsewhere, named = [], {}, {}
    require(parser, options.shared, *(MEASUREMENTS[-1:] if options.quick else MEASUREMENTS))
    with tempfile.TemporaryDirectory() as saved:
        for study in QUICK if options.quick else STUDIES:
            begin = time.perf_counter()
            explanation = run(study, shared=options.shared, saved=Path(saved))
            rows += rows_of(study, explanation, time.perf_counter() - begin)
            named[study.name] = named_afterwards(study, shared=options.shared, saved=Path(saved))
            if study.name in ELSEWHERE:
                elsewhere[study.name] = dict(left_out(study, explanation, options.shared))
    if options.quick:
        days = pairs_of_days(*QUICK_DAYS, options.shared, QUICK_PAIRS)
    else:
        days = pairs_of_days(*DAYS, options.shared)
    show("Steps of all studies", [{**row, "where": ", ".join(row["where"])} for row in rows])
    for name, errors in elsewhere.items():
        show_values(f"{name}: nrms of logs that took no part, without an effect", errors)
    after = {name: "; ".join(effects) or "nothing" for name, effects in named.items()}
    show_values("Named by diagnose afterwards", after)
    lines = [
        {"fit": pair["fit"], "test": pair["test"], "steps": ", ".join(pair["steps"]) or "no step"}
        | {
            log: " → ".join(f"{nrms:.4f}" for nrms in errors)
            for log, errors in pair["third"].items()
        }
        for pair in days
    ]
    show("Steps on another day, and nrms of further ones before and after", lines)
    told = {"rows": rows, "left_out": elsewhere, "named_afterwards": named, "days": days}
    write(options, told)


if __name__ == "__main__":
    main()
