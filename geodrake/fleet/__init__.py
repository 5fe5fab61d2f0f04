"""Fleets of robots: what a type shares, how each robot differs, and what changed since when.

A log comes as weighted normal matrices of its joints (`RobotHistory`). All else is array in, array
out: scales and common parameters by `learn_type`, changes by `find_changes`, parameters over time
by `parameter_levels`.
"""

from geodrake.fleet.changes import ChangeRival, RobotChange
from geodrake.fleet.columns import Spread, TypeColumns, body_spread, column_spreads
from geodrake.fleet.fleet_changes import FleetChanges, find_changes
from geodrake.fleet.history import LogEquations, RobotHistory, weighted_history
from geodrake.fleet.hypotheses import ChangeHypothesis, body_change, column_change
from geodrake.fleet.levels import ParameterLevels, parameter_levels
from geodrake.fleet.type_learning import learn_type
from geodrake.fleet.type_model import TypeModel, own_parameters

__all__ = [
    "ChangeHypothesis",
    "ChangeRival",
    "FleetChanges",
    "LogEquations",
    "ParameterLevels",
    "RobotChange",
    "RobotHistory",
    "Spread",
    "TypeColumns",
    "TypeModel",
    "body_change",
    "body_spread",
    "column_change",
    "column_spreads",
    "find_changes",
    "learn_type",
    "own_parameters",
    "parameter_levels",
    "weighted_history",
]
