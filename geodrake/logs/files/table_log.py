"""The log that a table is, once its columns are named as in a CSV."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.logs.files.column_names import QUANTITIES, Columns, Recording
from geodrake.logs.files.table import LogTable
from geodrake.logs.motion import JointLog

_NUMBERED = re.compile(rf"({'|'.join(QUANTITIES)})\[(\d+)\]")


def log_of_table(table: LogTable, joints: Sequence[str] | None) -> JointLog:
    """The log in a table.

    Args:
        table: Columns named `time` and `<joint>.<quantity>`, or `<quantity>[k]` of the k-th joint.
        joints: Names of the model's joints, which the log must have; None for its own.

    Raises:
        LogError: It lacks a column or a joint.
    """
    columns, names = dict(table.columns), {}
    numbered = {name: found for name in columns if (found := _NUMBERED.fullmatch(name))}
    count = 1 + max((int(found[2]) for found in numbered.values()), default=-1)
    notes = list(table.notes)
    if numbered:
        named = joints if joints is not None and len(joints) == count else None
        names = dict(enumerate(named or [f"joint_{k + 1}" for k in range(count)]))
        notes.append(f"joints without names taken to be {', '.join(names.values())}")
    for name, found in numbered.items():
        columns[f"{names[int(found[2])]}.{found[1]}"] = columns.pop(name)
    known = Columns.of(table.path, list(columns), joints)
    recording = Recording(known, len(table))
    for name in known.names:
        recording.put(name, slice(0, len(table)), np.asarray(columns[name]))
    log = recording.log(len(table))
    return replace(log, notes=(*notes, *log.notes))
