"""Many logs of many robots: digests of them, and which robot changed, where, since when.

A log comes as weighted normal matrices of its joints (`RobotHistory`). Of these all is array in,
array out: scales and common parameters by `learn_type`, changes by `find_changes`, parameters over
time by `parameter_levels`. `run_fleet` leads from a fleet's file to its findings.
"""

from geodrake.fleet.changes import ChangeRival, RobotChange
from geodrake.fleet.columns import Spread, TypeColumns, body_spread, column_spreads
from geodrake.fleet.digest import Digest, DigestedLog, JointDigest, merge
from geodrake.fleet.digest_dataset import digest_dataset
from geodrake.fleet.digest_file import digest_content, read_digest
from geodrake.fleet.digest_folder import DigestRow, DigestRun, digest_files, digest_logs
from geodrake.fleet.fleet_changes import FleetChanges, find_changes
from geodrake.fleet.fleet_file import Fleet, FleetRobot, FleetType, read_fleet
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
from geodrake.fleet.history import JointHistory, LogEquations, RobotHistory, weighted_history
from geodrake.fleet.hypotheses import ChangeHypothesis, body_change, column_change
from geodrake.fleet.levels import ParameterLevels, parameter_levels
from geodrake.fleet.making import LogFacts, Wanted, make_digest, make_settings
from geodrake.fleet.model_hash import model_hash
from geodrake.fleet.settings import (
    DigestColumn,
    DigestEffect,
    DigestSettings,
    read_settings,
)
from geodrake.fleet.type_learning import learn_type
from geodrake.fleet.type_model import TypeModel, own_parameters

__all__ = [
    "ChangeHypothesis",
    "ChangeRival",
    "ChangedParameter",
    "Digest",
    "DigestColumn",
    "DigestEffect",
    "DigestRow",
    "DigestRun",
    "DigestSettings",
    "DigestedLog",
    "Fleet",
    "FleetChanges",
    "FleetFinding",
    "FleetResult",
    "FleetRobot",
    "FleetType",
    "FleetWork",
    "JointDigest",
    "JointHistory",
    "LogEquations",
    "LogFacts",
    "OwnParameter",
    "ParameterHistory",
    "ParameterLevels",
    "RobotChange",
    "RobotHistory",
    "RobotResult",
    "Spread",
    "TypeColumns",
    "TypeModel",
    "UnusedLog",
    "Wanted",
    "body_change",
    "body_spread",
    "column_change",
    "column_spreads",
    "digest_content",
    "digest_dataset",
    "digest_files",
    "digest_logs",
    "find_changes",
    "learn_type",
    "make_digest",
    "make_settings",
    "merge",
    "model_hash",
    "own_parameters",
    "parameter_levels",
    "read_digest",
    "read_fleet",
    "read_settings",
    "run_fleet",
    "weighted_history",
]
