"""Many logs of many robots: digests, and detection of changes by robot, joint and time.

A log comes as weighted normal matrices of its joints (`history`). `type_learning` learns what
robots of a type share, `changes` finds what changed in one; both take arrays and give arrays.
`run_fleet` leads from a fleet's file to its findings.
"""

from geodrake.fleet.digest import Digest, digest_content, merge, read_digest
from geodrake.fleet.digest_folder import DigestRun, digest_files, digest_logs
from geodrake.fleet.digest_log import LogFacts, digest_dataset, make_digest, make_settings
from geodrake.fleet.fleet_file import Fleet, read_fleet
from geodrake.fleet.fleet_result import (
    ChangedParameter,
    FleetFinding,
    FleetResult,
    OwnParameter,
    ParameterHistory,
    RobotResult,
    UnusedLog,
)
from geodrake.fleet.fleet_run import FleetWork, run_fleet
from geodrake.fleet.settings import DigestSettings

__all__ = [
    "ChangedParameter",
    "Digest",
    "DigestRun",
    "DigestSettings",
    "Fleet",
    "FleetFinding",
    "FleetResult",
    "FleetWork",
    "LogFacts",
    "OwnParameter",
    "ParameterHistory",
    "RobotResult",
    "UnusedLog",
    "digest_content",
    "digest_dataset",
    "digest_files",
    "digest_logs",
    "make_digest",
    "make_settings",
    "merge",
    "read_digest",
    "read_fleet",
    "run_fleet",
]
