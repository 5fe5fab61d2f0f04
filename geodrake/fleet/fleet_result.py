"""The result for a fleet: which robot changed, where, in what, since when, and what is new."""

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
    unit: str  # empty for shares
    size: float  # change; of a ramp up to the last log
    deviation: float
    share: float  # the change as a share of the robot's own value; NaN where there is no such


@dataclass(frozen=True)
class ChangeRival:
    """Another change that may explain a finding."""

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
        kind: "step", or "ramp" for what goes on changing.
        date: First log after the step, or at which the ramp begins, s since 1970.
        interval: When that is with a probability of 95 %, s since 1970.
        probability: Probability of effect, place and kind, given that something changed.
        rivals: What else it may be, most probable first.
        false_alarm_probability: At most by what chance logs of a robot in which nothing more
            changed say so much for a change.
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
    values: Array  # (T,) values as each log has them, in its unit
    deviations: Array  # (T,) their standard deviations, with what logs scatter beyond noise
    # (T,) whether the log says more of it than that the robot is one of the type.
    shown: NDArray[np.bool_]


@dataclass(frozen=True)
class OwnParameter:
    """A parameter of a robot without its changes, compared with other robots."""

    parameter: FleetParameter
    value: float
    deviation: float
    common: float  # what robots of the type share
    spread: float  # by how much they differ, one standard deviation
    of_model: float  # what the robot's model file says, or its type's; NaN where that says nothing

    @property
    def apart(self) -> float:
        """Distance of the robot from the others, in spreads."""
        return (self.value - self.common) / self.spread if self.spread > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class RobotResult(Short):
    """Results of one robot."""

    robot: str
    type: str
    logs: int
    # (T,) when its logs were recorded, s since 1970; neighbours together if they are many.
    dates: Array
    findings: tuple[FleetFinding, ...] = ()  # what changed, the surest first
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
        """Return the parameter that is farthest from those of others."""
        return max(self.own, key=lambda each: abs(each.apart), default=None)


@dataclass(frozen=True, eq=False)
class FleetResult(Short):
    """Results of a fleet.

    Attributes:
        robots: The robots, worst first.
        unused: Records of logs that findings are not of: invalid, or with the content of another.
        settings: Type -> hash of the settings of its digests.
        repairs: What of the model files is not believed.
        folder: Where digests and results are.
        made: Logs that were digested for it.
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
        """Return how many robots are in a state."""
        return sum(robot.state == state for robot in self.robots)


_REPORTED_FILE = "told_findings.json"
_NEAR = 2.0 * DAY  # by which the interval of a finding may move with further logs


@dataclass(frozen=True)
class ReportedFinding:
    """A finding as an earlier report contained it."""

    robot: str
    effect: str
    where: str
    earliest: float  # beginning of its interval, s since 1970
    latest: float

    def is_of(self, finding: FleetFinding) -> bool:
        """Return whether a finding is the same, seen with other logs."""
        same = (self.robot, self.effect, self.where)
        low, high = finding.interval
        near = low <= self.latest + _NEAR and self.earliest <= high + _NEAR
        return same == (finding.robot, finding.effect, finding.where) and near


def new_findings(folder: Path, findings: Sequence[FleetFinding]) -> list[FleetFinding]:
    """Return findings that were not reported before."""
    reported = _read_reported(folder / _REPORTED_FILE)
    return [finding for finding in findings if not any(old.is_of(finding) for old in reported)]


def keep_reported(folder: Path, findings: Sequence[FleetFinding]) -> None:
    """Remember that findings were reported."""
    new = (
        ReportedFinding(each.robot, each.effect, each.where, *each.interval) for each in findings
    )
    reported = [*_read_reported(folder / _REPORTED_FILE), *new]
    lines = ",\n".join(json.dumps(vars(each)) for each in reported)
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
