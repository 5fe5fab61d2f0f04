"""Many logs of many robots: digests, and detection of changes by robot, joint and time.

A log is represented by weighted normal matrices of its joints (`history`). `type_learning` learns
the common parameters of a robot type, and `changes` detects changes of a robot. `run_fleet` goes
from a fleet file to findings.
"""

from geodrake.fleet.digest import Digest, digest_content, merge, read_digest
from geodrake.fleet.digest_folder import digest_files, digest_logs
from geodrake.fleet.digest_log import LogFacts, digest_dataset, make_digest, make_settings
from geodrake.fleet.fleet_file import read_fleet
from geodrake.fleet.fleet_result import (
    FleetFinding,
    FleetResult,
)
from geodrake.fleet.fleet_run import FleetWork, run_fleet

__all__ = [
    "Digest",
    "FleetFinding",
    "FleetResult",
    "FleetWork",
    "LogFacts",
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
