"""Many logs of many robots: digests of them, and which robot changed, where, since when."""

from geodrake.fleet.digest import Digest, DigestedLog, JointDigest, merge
from geodrake.fleet.digest_dataset import digest_dataset
from geodrake.fleet.digest_file import digest_content, read_digest
from geodrake.fleet.digest_folder import DigestRow, DigestRun, digest_files, digest_logs
from geodrake.fleet.fleet_file import Fleet, FleetRobot, FleetType, read_fleet
from geodrake.fleet.fleet_result import (
    ChangedParameter,
    FailedLog,
    FleetFinding,
    FleetResult,
    OwnParameter,
    ParameterHistory,
    RobotResult,
)
from geodrake.fleet.fleet_run import FleetWork, run_fleet
from geodrake.fleet.making import LogFacts, Wanted, make_digest, make_settings
from geodrake.fleet.model_hash import model_hash
from geodrake.fleet.settings import (
    DigestColumn,
    DigestEffect,
    DigestSettings,
    read_settings,
)

__all__ = [
    "ChangedParameter",
    "Digest",
    "DigestColumn",
    "DigestEffect",
    "DigestRow",
    "DigestRun",
    "DigestSettings",
    "DigestedLog",
    "FailedLog",
    "Fleet",
    "FleetFinding",
    "FleetResult",
    "FleetRobot",
    "FleetType",
    "FleetWork",
    "JointDigest",
    "LogFacts",
    "OwnParameter",
    "ParameterHistory",
    "RobotResult",
    "Wanted",
    "digest_content",
    "digest_dataset",
    "digest_files",
    "digest_logs",
    "make_digest",
    "make_settings",
    "merge",
    "model_hash",
    "read_digest",
    "read_fleet",
    "read_settings",
    "run_fleet",
]
