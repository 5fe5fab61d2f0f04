"""Logs of a robot: reading, checks, filtering, preparation, and validation blocks."""

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
