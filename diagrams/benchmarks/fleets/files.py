"""A fleet as a user has it: model files, a log a day of each robot, and a file that says so."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.fleets.draws import FleetDraw, type_file, type_model
from diagrams.benchmarks.fleets.simulation import robot_logs
from geodrake.boundary.whole_files import write_whole
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog

Times = TypeVar("Times", float, NDArray[np.float64])

FIRST, DAY = 1.7776e9 // 86400 * 86400, 86400.0
"""Seconds since 1970 of the first day of logs, and of a day."""


@dataclass(frozen=True)
class LogWriter:
    """Writes the logs of robots.

    Attributes:
        folder: Where each robot's folder is.
    """

    folder: Path

    def __call__(self, draw: FleetDraw) -> int:
        """The number of logs that were written; those of an earlier run are kept."""
        folder = self.folder / draw.name
        names = [f"{_date_name(FIRST + day * DAY)}.npz" for day in range(draw.days)]
        if (folder / names[-1]).is_file():
            return len(names)
        folder.mkdir(parents=True, exist_ok=True)
        joints = tuple(type_model(draw.kind).joints)
        for name, log in zip(names, robot_logs(draw), strict=True):
            where = folder / name
            write_log(JointLog(name, joints, log.time, log.position, log.effort), where)
        return len(names)


def write_fleet_file(folder: Path, draws: Sequence[FleetDraw]) -> Path:
    """Models of all types, and the file that names them and the robots.

    Args:
        folder: Where they go.
        draws: The robots.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kinds = sorted({draw.kind for draw in draws})
    for kind in kinds:
        write_whole(folder / f"{kind}.urdf", type_file(kind).text)
    said = {
        "to": "results",
        "types": {kind: {"model": f"{kind}.urdf"} for kind in kinds},
        "robots": [
            {
                "name": draw.name,
                "type": draw.kind,
                "logs": f"{draw.name}/*.npz",
                "dates": "%Y-%m-%d",
            }
            for draw in draws
        ],
    }
    path = folder / "fleet.yaml"
    write_whole(path, json.dumps(said, indent=1))
    return path


def _date_name(seconds: float) -> str:
    """A date such as 2026-05-01."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d")


def day_of(seconds: Times) -> Times:
    """Days since the first, of one instant or of several, s since 1970."""
    return (seconds - FIRST) / DAY
