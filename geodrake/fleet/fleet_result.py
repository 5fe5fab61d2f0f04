"""Results for a fleet: changes of robots by place, effect and date, and new findings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import read_regular
from geodrake.boundary.showing import Short
from geodrake.boundary.whole_files import write_whole
from geodrake.errors import FleetError
from geodrake.fleet.fleet_logs import LogRecord
from geodrake.fleet.history import DAY
from geodrake.fleet.type_layout import FleetParameter
from geodrake.inertia import Array

CHANGED, STEADY, UNKNOWN = "changed", "steady", "no logs"
"""The status of a robot."""


@dataclass(frozen=True)
class ChangedParameter:
    """Change of a parameter."""

    name: str
    unit: str  # empty for relative values
    size: float  # change; of a ramp up to the last log
    deviation: float
    share: float  # relative to the robot's value; NaN if not applicable


@dataclass(frozen=True)
class ChangeRival:
    """Another possible explanation of a finding."""

    effect: str
    where: str
    kind: str
    probability: float


@dataclass(frozen=True)
class FleetFinding(Short):
    """A change of a robot.

    Attributes:
        effect: Name of the effect that changed, or of several, joined by `+`.
        where: Its joint or body.
        kind: "step", or "ramp" for an ongoing change.
        date: Date of the first log after the step, or at the start of the ramp, s since 1970.
        interval: 95 % interval of this date, s since 1970.
        probability: Probability of effect, place and kind, given that something changed.
        rivals: Other explanations, most probable first.
        false_alarm_probability: Upper bound of the probability of such evidence without a further
            change.
    """

    robot: str
    effect: str
    where: str
    kind: str
    date: float
    interval: tuple[float, float]
    parameters: tuple[ChangedParameter, ...]
    probability: float
    rivals: tuple[ChangeRival, ...]
    false_alarm_probability: float


@dataclass(frozen=True, eq=False)
class ParameterHistory(Short):
    """A parameter of a robot over time."""

    parameter: FleetParameter
    values: Array  # (T,) value by each log, in its unit
    deviations: Array  # (T,) standard deviations, including scatter of logs beyond noise
    shown: NDArray[np.bool_]  # (T,) whether the log is more informative than the type's prior


@dataclass(frozen=True)
class OwnParameter:
    """A parameter of a robot without its changes, compared with other robots."""

    parameter: FleetParameter
    value: float
    deviation: float
    common: float  # common value of the type
    spread: float  # standard deviation between robots
    of_model: float  # value in the model file of the robot or its type; NaN if missing

    @property
    def apart(self) -> float:
        """Difference from the common value, in standard deviations between robots."""
        return (self.value - self.common) / self.spread if self.spread > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class RobotResult(Short):
    """Results of one robot."""

    robot: str
    type: str
    logs: int
    dates: Array  # (T,) dates of its logs, s since 1970, with neighbouring logs combined if many
    findings: tuple[FleetFinding, ...] = ()  # most significant first
    histories: tuple[ParameterHistory, ...] = ()
    own: tuple[OwnParameter, ...] = ()

    @property
    def state(self) -> str:
        """`changed`, `steady`, or `no logs`."""
        if not self.logs:
            return UNKNOWN
        return CHANGED if self.findings else STEADY

    @property
    def farthest(self) -> OwnParameter | None:
        """The parameter with the largest difference from the common value."""
        return max(self.own, key=lambda parameter: abs(parameter.apart), default=None)


@dataclass(frozen=True, eq=False)
class FleetResult(Short):
    """Results of a fleet.

    Attributes:
        robots: The robots, worst first.
        unused: Records of unused logs: invalid, or with the content of another log.
        settings: Type -> hash of the settings of its digests.
        repairs: Repairs of the model files.
        folder: Folder of digests and results.
        made: Number of newly digested logs.
    """

    robots: tuple[RobotResult, ...]
    unused: tuple[LogRecord, ...]
    false_alarms: float
    settings: dict[str, str]
    repairs: tuple[str, ...] = ()
    folder: Path | None = None
    made: int = 0

    @property
    def findings(self) -> tuple[FleetFinding, ...]:
        """Findings of all robots, worst first."""
        return tuple(finding for robot in self.robots for finding in robot.findings)

    def count(self, state: str) -> int:
        """Return the number of robots in a state."""
        return sum(robot.state == state for robot in self.robots)


_REPORTED_FILE = "told_findings.json"
_TOLERANCE = 2.0 * DAY  # for changes of a finding's interval due to further logs


@dataclass(frozen=True)
class ReportedFinding:
    """A finding in an earlier report."""

    robot: str
    effect: str
    where: str
    earliest: float  # start of its interval, s since 1970
    latest: float  # end of its interval

    def is_of(self, finding: FleetFinding) -> bool:
        """Return whether a finding is the same, possibly with other logs."""
        place = (self.robot, self.effect, self.where)
        low, high = finding.interval
        overlaps = low <= self.latest + _TOLERANCE and self.earliest <= high + _TOLERANCE
        return place == (finding.robot, finding.effect, finding.where) and overlaps


def new_findings(folder: Path, findings: Sequence[FleetFinding]) -> list[FleetFinding]:
    """Return findings that were not reported before."""
    reported = _read_reported(folder / _REPORTED_FILE)
    return [finding for finding in findings if not any(old.is_of(finding) for old in reported)]


def keep_reported(folder: Path, findings: Sequence[FleetFinding]) -> None:
    """Add findings to the file of reported findings."""
    new = (ReportedFinding(f.robot, f.effect, f.where, *f.interval) for f in findings)
    reported = [*_read_reported(folder / _REPORTED_FILE), *new]
    lines = ",\n".join(json.dumps(vars(finding)) for finding in reported)
    write_whole(folder / _REPORTED_FILE, f"[\n{lines}\n]\n")


def _read_reported(path: Path) -> list[ReportedFinding]:
    if not path.exists():
        return []
    try:
        data = read_regular(path, "file", FleetError)
        return msgspec.json.decode(data, type=list[ReportedFinding])
    except (FleetError, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise FleetError(
            f"{path}, which has the findings that were reported before, cannot be read: "
            f"{one_line(error)}.",
            advice="Delete it; all findings are then new.",
        ) from error
