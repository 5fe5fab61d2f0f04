"""Columns that name no joints: states x and inputs u of simulations, and of carts with a pole."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from geodrake.boundary.arguments import Array
from geodrake.logs.files.name_rules import DESIRED, OTHER, PLAIN, Meaning, words_of
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable
from geodrake.logs.motion import PASSIVE

_STATE = re.compile(r"(?:x|xs|states?|obs|observations?)[_ ]?\[?\d+\]?", re.IGNORECASE)
_INPUT = re.compile(r"(?:u|us|f|ctrl|inputs?)[_ ]?\[?\d*\]?", re.IGNORECASE)
_OF_SLIDING = {"x": "position", "xdot": "velocity", "dx": "velocity", "vx": "velocity"}
_OF_TURNING = {"theta": "position", "thetadot": "velocity", "dtheta": "velocity"}
_ALIKE = 0.99  # correlation of a velocity with the steps of its position
_FOLLOWS = 0.2  # of its deviation, by which a position may be off its target


def state_columns(
    table: LogTable, names: Sequence[str], told: Sequence[Meaning], reading: Reading
) -> Iterator[Meaning]:
    """Yield columns of states and inputs with their joints, in the order of the model.

    States of twice as many numbers as joints are positions, and velocities that go as these change.
    Inputs are efforts of joints with motors, or targets that all positions follow, but no
    velocities. `told` are columns that name their joints.
    """
    joints, sliding = reading.joints, [j for j in reading.joints if j in reading.sliding]
    known = {m.log_quantity.replace("command", "effort") for m in told if m.role < OTHER}
    moved = [m for m in told if m.quantity == "position" and m.role < OTHER]
    words = [re.sub("[^a-z]", "", name.lower()) for name in names]
    count = Counter(words)  # x1 to x4 are no x
    letters = {word: name for word, name in zip(words, names, strict=True) if count[word] == 1}
    turning = [joint for joint in joints if joint not in sliding]
    found = list[Meaning]()
    if len(sliding) == len(turning) == 1 and not any(m.joint for m in moved):
        for own, called in ((sliding, _OF_SLIDING), (turning, _OF_TURNING)):
            told_by = {what: letters[word] for word, what in called.items() if word in letters}
            found += [_meaning(name, what, own[0]) for what, name in told_by.items()]
    if not found and not moved:
        found = [*_of_states(table, names, joints)]
    yield from found
    driven = [j for j in joints if j not in reading.motorless and reading.kinds.get(j) != PASSIVE]
    inputs = [] if "effort" in known else [name for name in names if _INPUT.fullmatch(name)]
    driven = sliding if len(inputs) == 1 < len(driven) and found else driven
    places = [m.column for m in (*told, *found) if m.quantity == "position" and m.role < DESIRED]
    values = table.read([*inputs, *places], skip=True)[0] if inputs else {}
    are_rates = all(any(_goes_with(values[q], values[u]) for q in places) for u in inputs)
    followed = [follows(values[q], values[u]) for q, u in zip(places, inputs, strict=False)]
    quantity = "command" if len(places) == len(inputs) and all(followed) else "effort"
    if len(inputs) == len(driven) and not are_rates:
        for name, joint in zip(inputs, driven, strict=True):
            yield _meaning(name, quantity, joint, DESIRED)


def _of_states(table: LogTable, names: Sequence[str], joints: Sequence[str]) -> Iterator[Meaning]:
    """Yield positions and velocities among numbered states."""
    states = [name for name in names if _STATE.fullmatch(name)]
    if len(states) != 2 * len(joints) or not states:
        return
    x = [*table.read(states, skip=True)[0].values()]
    count = np.arange(len(states))
    for place, rate in (count.reshape(2, -1), count.reshape(-1, 2).T):
        if all(_goes_with(x[i], x[k]) for i, k in zip(place, rate, strict=True)):
            for what, order in (("position", place), ("velocity", rate)):
                both = zip(order, joints, strict=True)
                yield from (_meaning(states[k], what, joint) for k, joint in both)
            return


def follows(position: Array, target: Array) -> bool:
    """Return whether a position stays near a target."""
    off = np.nanstd(target - position) + abs(np.nanmean(target - position))
    return bool(off < _FOLLOWS * np.nanstd(position))


def _goes_with(position: Array, velocity: Array) -> bool:
    """Return whether a column changes as another one says."""
    steps, means = np.diff(position), velocity[1:] + velocity[:-1]
    there = np.isfinite(steps) & np.isfinite(means)
    steps, means = steps[there], means[there]
    if len(steps) < 2 or not min(np.std(steps), np.std(means)) > 0.0:
        return False
    return bool(np.corrcoef(steps, means)[0, 1] > _ALIKE)


def _meaning(column: str, quantity: str, joint: str, role: int = PLAIN) -> Meaning:
    style = ("of states", quantity)
    return Meaning(column, quantity, joint, words_of(joint), role, style=style)
