"""Detection of mistakes in the columns of logs, before any model effect is considered."""

from geodrake.diagnosis.columns.check import MOST_JOINTS, check_columns
from geodrake.diagnosis.columns.corrections import corrected, with_motor_limits
from geodrake.diagnosis.columns.finding import ColumnFinding

__all__ = [
    "MOST_JOINTS",
    "ColumnFinding",
    "check_columns",
    "corrected",
    "with_motor_limits",
]
