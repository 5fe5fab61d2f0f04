"""Measurements of a robot: read, checked, filtered, prepared, and cut into blocks."""

from geodrake.logs.files import Reading, log_of_frame, read_log, write_log
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog, Motion

__all__ = [
    "JointLog",
    "KnownPayload",
    "Motion",
    "Reading",
    "log_of_frame",
    "read_log",
    "write_log",
]
