"""Which findings were told before: a finding is new once, however often a fleet is looked at."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import read_regular
from geodrake.boundary.whole_files import write_whole
from geodrake.errors import FleetError
from geodrake.fleet.fleet_result import FleetFinding
from geodrake.fleet.robot_logs import DAY

_FILE = "told_findings.json"
_NEAR = 2.0 * DAY  # by which the interval of a finding may move with further logs


@dataclass(frozen=True)
class ToldFinding:
    """What was told of a finding.

    Attributes:
        earliest: Beginning of its interval, s since 1970.
    """

    robot: str
    effect: str
    where: str
    earliest: float
    latest: float

    @classmethod
    def of(cls, finding: FleetFinding) -> ToldFinding:
        """That of a finding."""
        return cls(finding.robot, finding.effect, finding.where, *finding.interval)

    def is_of(self, finding: FleetFinding) -> bool:
        """Return whether a finding is the same, seen with other logs."""
        same = (self.robot, self.effect, self.where)
        low, high = finding.interval
        near = low <= self.latest + _NEAR and self.earliest <= high + _NEAR
        return same == (finding.robot, finding.effect, finding.where) and near


def new_findings(folder: Path, findings: Sequence[FleetFinding]) -> list[FleetFinding]:
    """Findings that were not told before.

    Raises:
        FleetError: What was told before cannot be read.
    """
    told = _read(folder / _FILE)
    return [finding for finding in findings if not any(old.is_of(finding) for old in told)]


def keep_told(folder: Path, findings: Sequence[FleetFinding]) -> None:
    """Remember that findings were told.

    Raises:
        OutputError: That cannot be written.
    """
    told = [*_read(folder / _FILE), *map(ToldFinding.of, findings)]
    lines = ",\n".join(json.dumps(vars(each)) for each in told)
    write_whole(folder / _FILE, f"[\n{lines}\n]\n")


def _read(path: Path) -> list[ToldFinding]:
    if not path.exists():
        return []
    try:
        said = json.loads(read_regular(path, "file", FleetError))
        return [
            ToldFinding(
                str(each["robot"]),
                str(each["effect"]),
                str(each["where"]),
                float(each["earliest"]),
                float(each["latest"]),
            )
            for each in said
        ]
    except (FleetError, ValueError, KeyError, TypeError) as error:
        raise FleetError(
            f"{path}, which says what was told before, cannot be read: {one_line(error)}.",
            advice="Delete it; then all findings are new.",
        ) from error
