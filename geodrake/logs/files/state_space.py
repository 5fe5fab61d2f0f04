"""Assign columns without joint names: states and inputs of simulations, and of cart-poles."""

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
_FOLLOWS = 0.2  # largest tracking error, as a fraction of the standard deviation of a position


def state_columns(
    table: LogTable, names: Sequence[str], named: Sequence[Meaning], reading: Reading
) -> Iterator[Meaning]:
    """Yield columns of states and inputs with their joints, in the order of the model.

    States with twice as many numbers as joints are positions and velocities. Inputs are commands
    if all positions follow them, otherwise efforts of joints with motors, unless they are
    velocities. `named` contains the columns that name their joints.
    """
    joints, sliding = reading.joints, [j for j in reading.joints if j in reading.sliding]
    quantities = {m.log_quantity.replace("command", "effort") for m in named if m.role < OTHER}
    positions = [m for m in named if m.quantity == "position" and m.role < OTHER]
    words = [re.sub("[^a-z]", "", name.lower()) for name in names]
    count = Counter(words)  # x1 to x4 are not x
    letters = {word: name for word, name in zip(words, names, strict=True) if count[word] == 1}
    turning = [joint for joint in joints if joint not in sliding]
    states = list[Meaning]()
    if len(sliding) == len(turning) == 1 and not any(m.joint for m in positions):
        for group, vocabulary in ((sliding, _OF_SLIDING), (turning, _OF_TURNING)):
            columns = {what: letters[word] for word, what in vocabulary.items() if word in letters}
            states += [_meaning(name, what, group[0]) for what, name in columns.items()]
    if not states and not positions:
        states = [*_states(table, names, joints)]
    yield from states
    driven = [j for j in joints if j not in reading.motorless and reading.kinds.get(j) != PASSIVE]
    inputs = [] if "effort" in quantities else [name for name in names if _INPUT.fullmatch(name)]
    driven = sliding if len(inputs) == 1 < len(driven) and states else driven
    places = [m.column for m in (*named, *states) if m.quantity == "position" and m.role < DESIRED]
    values = table.read([*inputs, *places], skip=True)[0] if inputs else {}
    are_rates = all(any(_has_rate(values[q], values[u]) for q in places) for u in inputs)
    followed = [follows(values[q], values[u]) for q, u in zip(places, inputs, strict=False)]
    quantity = "command" if len(places) == len(inputs) and all(followed) else "effort"
    if len(inputs) == len(driven) and not are_rates:
        for name, joint in zip(inputs, driven, strict=True):
            yield _meaning(name, quantity, joint, DESIRED)


def _states(table: LogTable, names: Sequence[str], joints: Sequence[str]) -> Iterator[Meaning]:
    """Yield positions and velocities among numbered states."""
    states = [name for name in names if _STATE.fullmatch(name)]
    if len(states) != 2 * len(joints) or not states:
        return
    x = [*table.read(states, skip=True)[0].values()]
    count = np.arange(len(states))
    for place, rate in (count.reshape(2, -1), count.reshape(-1, 2).T):
        if all(_has_rate(x[i], x[k]) for i, k in zip(place, rate, strict=True)):
            for what, order in (("position", place), ("velocity", rate)):
                pairs = zip(order, joints, strict=True)
                yield from (_meaning(states[k], what, joint) for k, joint in pairs)
            return


def follows(position: Array, target: Array) -> bool:
    """Return whether a position stays close to a target."""
    error = np.nanstd(target - position) + abs(np.nanmean(target - position))
    return bool(error < _FOLLOWS * np.nanstd(position))


def _has_rate(position: Array, velocity: Array) -> bool:
    """Return whether the second column is the rate of change of the first."""
    steps, means = np.diff(position), velocity[1:] + velocity[:-1]
    valid = np.isfinite(steps) & np.isfinite(means)
    steps, means = steps[valid], means[valid]
    if len(steps) < 2 or not min(np.std(steps), np.std(means)) > 0.0:
        return False
    return bool(np.corrcoef(steps, means)[0, 1] > _ALIKE)


def _meaning(column: str, quantity: str, joint: str, role: int = PLAIN) -> Meaning:
    style = ("of states", quantity)
    return Meaning(column, quantity, joint, words_of(joint), role, style=style)
